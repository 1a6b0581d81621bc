//! Whole numbers in as many bytes as they need, seven bits in each, the lowest first; numbers of either sign folded first. Both as in
//! protobuf (<https://protobuf.dev/programming-guides/encoding/>).

/// Appends a number.
pub(crate) fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Takes a number off the front. `None` where the bytes end within it, or go on behind 64 bits.
pub(crate) fn take_varint(rest: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let (&byte, tail) = rest.split_first()?;
        *rest = tail;
        value |= u64::from(byte & 0x7F) << shift;
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}

/// 0, -1, 1, -2 ... as 0, 1, 2, 3 ...: what is near zero is small.
pub(crate) const fn folded(value: i64) -> u64 {
    (value << 1 ^ value >> 63).cast_unsigned()
}

/// The number that was folded.
pub(crate) const fn unfolded(value: u64) -> i64 {
    (value >> 1).cast_signed() ^ -(value & 1).cast_signed()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_protobuf_and_come_back() {
        let numbers = (0..64).flat_map(|bit| [(1 << bit) - 1, 1 << bit]);
        for number in numbers.chain([150, u64::MAX]) {
            let (mut bytes, mut by_prost) = (Vec::new(), Vec::new());
            put_varint(&mut bytes, number);
            prost::encoding::encode_varint(number, &mut by_prost);
            assert_eq!(bytes, by_prost, "{number}");
            for cut in 0..bytes.len() {
                assert_eq!(take_varint(&mut &bytes[..cut]), None, "{number} cut at {cut}");
            }
            bytes.push(7);
            let mut rest = bytes.as_slice();
            assert_eq!(
                (take_varint(&mut rest), rest),
                (Some(number), &[7][..]),
                "{number}"
            );
        }
        // Ten bytes that go on hold more than 64 bits.
        assert_eq!(take_varint(&mut &[0xFF; 20][..]), None);
    }

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
}
