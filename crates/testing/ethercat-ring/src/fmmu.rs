//! A fieldbus memory management unit, which maps bits of the logical address space to bits of the
//! controller's memory.

/// Number of units of a controller.
pub(crate) const FMMUS: u16 = 8;
/// Bytes of one unit's registers.
pub(crate) const FMMU_BYTES: usize = 16;

/// One unit, decoded (ETG.1000.4, section 6.6).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fmmu {
    /// First bit in the logical address space.
    logical_bit: u64,
    /// Number of bits.
    bits: u64,
    /// First bit in the controller's memory.
    physical_bit: u64,
    pub(crate) reads: bool,
    pub(crate) writes: bool,
}

/// The part of a datagram that a unit maps to memory, in bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Mapped {
    pub(crate) datagram_bit: u64,
    pub(crate) physical_bit: u64,
    pub(crate) bits: u64,
}

impl Mapped {
    /// First byte of memory that is accessed, and the number of bytes.
    pub(crate) const fn physical_bytes(self) -> (u64, u64) {
        let first = self.physical_bit / 8;
        (first, (self.physical_bit + self.bits).div_ceil(8) - first)
    }
}

impl Fmmu {
    /// Decodes the registers of a unit; `None` if it is not active or maps nothing.
    pub(crate) fn decode(registers: &[u8]) -> Option<Self> {
        let registers: &[u8; FMMU_BYTES] = registers.try_into().ok()?;
        let [
            l0,
            l1,
            l2,
            l3,
            n0,
            n1,
            start_bit,
            end_bit,
            p0,
            p1,
            physical_start,
            kind,
            active,
            ..,
        ] = *registers;
        let (start_bit, end_bit) = (u64::from(start_bit & 7), u64::from(end_bit & 7));
        let bytes = u64::from(u16::from_le_bytes([n0, n1]));
        let bits = (bytes * 8).checked_sub(start_bit + 7 - end_bit)?;
        if active & 1 == 0 || bits == 0 || bytes == 0 {
            return None;
        }
        Some(Self {
            logical_bit: u64::from(u32::from_le_bytes([l0, l1, l2, l3])) * 8 + start_bit,
            bits,
            physical_bit: u64::from(u16::from_le_bytes([p0, p1])) * 8 + u64::from(physical_start & 7),
            reads: kind & 1 != 0,
            writes: kind & 2 != 0,
        })
    }

    /// The part of a datagram at a logical address that this unit maps.
    pub(crate) fn map(&self, logical: u32, length: usize) -> Option<Mapped> {
        let begin = u64::from(logical) * 8;
        let end = begin + length as u64 * 8;
        let first = begin.max(self.logical_bit);
        let last = end.min(self.logical_bit + self.bits);
        (first < last).then(|| Mapped {
            datagram_bit: first - begin,
            physical_bit: self.physical_bit + (first - self.logical_bit),
            bits: last - first,
        })
    }
}

/// Copies bits from one array to another, least significant first.
pub(crate) fn copy_bits(from: &[u8], from_bit: u64, to: &mut [u8], to_bit: u64, bits: u64) {
    if [from_bit, to_bit, bits].iter().all(|bit| bit.is_multiple_of(8)) {
        let (source, target, count) = (
            (from_bit / 8) as usize,
            (to_bit / 8) as usize,
            (bits / 8) as usize,
        );
        if let (Some(source), Some(target)) = (
            from.get(source..source + count),
            to.get_mut(target..target + count),
        ) {
            target.copy_from_slice(source);
        }
        return;
    }
    for i in 0..bits {
        let (source, target) = (from_bit + i, to_bit + i);
        let bit = from
            .get((source / 8) as usize)
            .map_or(0, |byte| byte >> (source % 8) & 1);
        if let Some(byte) = to.get_mut((target / 8) as usize) {
            *byte = *byte & !(1 << (target % 8)) | bit << (target % 8);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit(
        logical: u32,
        length: u16,
        start: u8,
        end: u8,
        physical: u16,
        physical_start: u8,
        kind: u8,
    ) -> Fmmu {
        let mut bytes = [0_u8; FMMU_BYTES];
        bytes[..4].copy_from_slice(&logical.to_le_bytes());
        bytes[4..6].copy_from_slice(&length.to_le_bytes());
        (bytes[6], bytes[7]) = (start, end);
        bytes[8..10].copy_from_slice(&physical.to_le_bytes());
        (bytes[10], bytes[11], bytes[12]) = (physical_start, kind, 1);
        Fmmu::decode(&bytes).expect("an active unit")
    }

    /// The example of the ET1100's data sheet: 6 bits from logical 00010011h bit 3 to 00010012h bit 0, at
    /// 0F01h bit 1.
    #[test]
    fn the_example_of_the_data_sheet() {
        let fmmu = unit(0x0001_0011, 2, 3, 0, 0x0F01, 1, 2);
        let mapped = fmmu.map(0x0001_0010, 4).expect("overlaps");
        assert_eq!((mapped.datagram_bit, mapped.bits), (8 + 3, 6));
        assert_eq!(mapped.physical_bit, 0x0F01 * 8 + 1);
        let datagram = [0, 0b1010_1000, 0b0000_0001, 0];
        let mut memory = [0b1000_0001_u8];
        copy_bits(&datagram, mapped.datagram_bit, &mut memory, 1, mapped.bits);
        assert_eq!(memory, [0b1110_1011]);
    }

    #[test]
    fn a_datagram_that_holds_a_part_maps_that_part() {
        let fmmu = unit(100, 10, 0, 7, 0x1100, 0, 1);
        assert_eq!(fmmu.map(90, 10), None);
        let mapped = fmmu.map(96, 8).expect("overlaps");
        assert_eq!((mapped.datagram_bit, mapped.bits), (32, 32));
        let mapped = fmmu.map(104, 100).expect("overlaps");
        assert_eq!((mapped.physical_bit, mapped.bits), (0x1104 * 8, 48));
    }
}
