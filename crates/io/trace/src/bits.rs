//! Numbers as bits: an adaptive Rice code.
//!
//! Numbers that are usually small and occasionally large take few bits on average (R. F. Rice, "Some
//! practical universal noiseless coding techniques", JPL 79-22, 1979): the upper part is in unary, the lower
//! `k` bits are unchanged. `k` follows the mean of the previous numbers, which both sides know. A number far
//! above the mean is written whole.

/// An upper part from here on is written as that many ones, a length of six bits and the number itself.
const ESCAPE: u32 = 20;

/// Follows the mean of the numbers, and gives the number of low bits that are written unchanged.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    /// Sixteen times the mean.
    sum: u64,
}

impl Mean {
    /// `k`, at most 48.
    fn low_bits(self) -> u32 {
        // The next `k` gives shorter codes from 0.69 of the mean on, for geometrically distributed numbers.
        (64 - (self.sum.saturating_mul(11) >> 8).leading_zeros()).min(48)
    }

    fn see(&mut self, value: u64, low_bits: u32) {
        // A single outlier does not spoil the numbers after it.
        let value = value.min(1 << (low_bits + 6));
        self.sum = self.sum - (self.sum >> 4) + value;
    }
}

/// Writes numbers.
#[derive(Debug, Default)]
pub(crate) struct BitWriter {
    bytes: Vec<u8>,
    open: u64,
    filled: u32,
    mean: Mean,
}

impl BitWriter {
    /// The lowest `count` bits, at most 56 of them.
    fn put(&mut self, bits: u64, count: u32) {
        self.open |= bits << self.filled;
        self.filled += count;
        while self.filled >= 8 {
            self.bytes.push(self.open as u8);
            self.open >>= 8;
            self.filled -= 8;
        }
    }

    /// Appends a number.
    pub(crate) fn number(&mut self, value: u64) {
        let low_bits = self.mean.low_bits();
        let upper = value >> low_bits;
        if upper < u64::from(ESCAPE) {
            let upper = upper as u32;
            self.put((1 << upper) - 1, upper + 1);
            self.put(value & ((1 << low_bits) - 1), low_bits);
        } else {
            self.put((1 << ESCAPE) - 1, ESCAPE);
            let length = 64 - value.leading_zeros();
            self.put(u64::from(length - 1), 6);
            self.put(value & 0xFFFF_FFFF, length.min(32));
            if length > 32 {
                self.put(value >> 32, length - 32);
            }
        }
        self.mean.see(value, low_bits);
    }

    /// All bytes written, the last padded with zeros.
    pub(crate) fn finish(mut self) -> Vec<u8> {
        if self.filled > 0 {
            self.bytes.push(self.open as u8);
        }
        self.bytes
    }
}

/// Reads numbers back.
#[derive(Debug)]
pub(crate) struct BitReader<'a> {
    bytes: &'a [u8],
    at: usize,
    mean: Mean,
}

impl<'a> BitReader<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self {
            bytes,
            at: 0,
            mean: Mean::default(),
        }
    }

    /// The next 56 bits or more; zeros after the end.
    fn peek(&self) -> u64 {
        let byte = self.at / 8;
        let word = match self.bytes.get(byte..byte + 8) {
            Some(eight) => eight.try_into().map_or(0, u64::from_le_bytes),
            None => {
                let mut eight = [0; 8];
                let rest = self.bytes.get(byte..).unwrap_or(&[]);
                eight[..rest.len()].copy_from_slice(rest);
                u64::from_le_bytes(eight)
            }
        };
        word >> (self.at % 8)
    }

    fn take(&mut self, count: u32) -> u64 {
        let bits = self.peek() & ((1 << count) - 1);
        self.at += count as usize;
        bits
    }

    /// The next number. After the end there are zeros: see [`Self::is_within`].
    pub(crate) fn number(&mut self) -> u64 {
        let low_bits = self.mean.low_bits();
        let upper = self.peek().trailing_ones();
        let value = if upper < ESCAPE {
            self.at += upper as usize + 1;
            u64::from(upper) << low_bits | self.take(low_bits)
        } else {
            self.at += ESCAPE as usize;
            let length = self.take(6) as u32 + 1;
            let low = self.take(length.min(32));
            if length > 32 {
                low | self.take(length - 32) << 32
            } else {
                low
            }
        };
        self.mean.see(value, low_bits);
        value
    }

    /// Whether nothing after the end was read.
    pub(crate) fn is_within(&self) -> bool {
        self.at <= self.bytes.len() * 8
    }
}

/// Maps 0, -1, 1, -2 ... to 0, 1, 2, 3 ..., so that numbers near zero are small.
pub(crate) const fn folded(value: i64) -> u64 {
    (value << 1 ^ value >> 63).cast_unsigned()
}

/// The inverse of [`folded`].
pub(crate) const fn unfolded(value: u64) -> i64 {
    (value >> 1).cast_signed() ^ -(value & 1).cast_signed()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_either_sign_are_folded_as_protobuf_says() {
        // The specification's own table, and the ends.
        for (number, wanted) in [
            (0, 0),
            (-1, 1),
            (1, 2),
            (-2, 3),
            (0x7FFF_FFFF, 0xFFFF_FFFE),
            (-0x8000_0000, 0xFFFF_FFFF),
            (i64::MAX, u64::MAX - 1),
            (i64::MIN, u64::MAX),
        ] {
            assert_eq!(folded(number), wanted, "{number}");
            assert_eq!(unfolded(wanted), number);
        }
    }

    #[test]
    fn numbers_of_every_size_and_order_come_back() {
        let mut random = evolvent_random::Random::from_state(0x2545_F491_4F6C_DD1D);
        let mut numbers = vec![0, u64::MAX, 0, 1, u64::MAX, u64::MAX, 1 << 63, 0, 0, 0];
        for n in 0..20_000_u32 {
            let state = random.bits();
            // Stretches of small, of large and of mixed numbers.
            let shift = match n / 1000 % 3 {
                0 => 58,
                1 => 20,
                _ => (state >> 8) % 64,
            };
            numbers.push(state >> shift);
        }
        let mut writer = BitWriter::default();
        numbers.iter().for_each(|&number| writer.number(number));
        let bytes = writer.finish();
        let mut reader = BitReader::new(&bytes);
        for (n, &number) in numbers.iter().enumerate() {
            assert_eq!(reader.number(), number, "number {n}");
        }
        assert!(reader.is_within());
        (0..9).for_each(|_| {
            reader.number();
        });
        assert!(!reader.is_within(), "reading on is noticed");
    }

    #[test]
    fn small_numbers_take_about_as_many_bits_as_they_hold() {
        // Uniform below 64 holds six bits; a Rice code spends less than one more.
        let mut writer = BitWriter::default();
        let mut random = evolvent_random::Random::from_state(1);
        for _ in 0..10_000 {
            writer.number(random.bits() >> 58);
        }
        let bits = writer.finish().len() * 8;
        assert!((60_000..70_000).contains(&bits), "{bits} bits for 60000");
    }
}
