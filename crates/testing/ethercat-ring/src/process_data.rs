//! Process data: the positions of dictionary entries in the memory of a SyncManager.

use crate::fmmu::copy_bits;
use crate::object::Dictionary;

/// The assignment of the outputs, and of the inputs.
pub(crate) const OUTPUTS: u16 = 0x1C12;
pub(crate) const INPUTS: u16 = 0x1C13;

/// Mapped entries in order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct ProcessMap {
    entries: Vec<(u16, u8, u8)>,
    bits: u64,
}

impl ProcessMap {
    /// The present mapping of an assignment (1C12h or 1C13h).
    pub(crate) fn of(objects: &Dictionary, assignment: u16) -> Self {
        let mut map = Self::default();
        for pdo in Self::pdos(objects, assignment) {
            for entry in Self::mapped(objects, pdo) {
                map.bits += u64::from(entry.2);
                map.entries.push(entry);
            }
        }
        map
    }

    /// The PDOs of an assignment.
    pub(crate) fn pdos(objects: &Dictionary, assignment: u16) -> Vec<u16> {
        let count = objects.integer(assignment, 0).clamp(0, 255) as u8;
        (1..=count)
            .map(|sub_index| objects.integer(assignment, sub_index) as u16)
            .collect()
    }

    /// Index, sub-index and bits of the entries of a PDO.
    pub(crate) fn mapped(objects: &Dictionary, pdo: u16) -> Vec<(u16, u8, u8)> {
        let count = objects.integer(pdo, 0).clamp(0, 255) as u8;
        let decode = |value: i64| ((value >> 16) as u16, (value >> 8) as u8, value as u8);
        (1..=count)
            .map(|sub_index| decode(objects.integer(pdo, sub_index)))
            .collect()
    }

    pub(crate) const fn bytes(&self) -> usize {
        self.bits.div_ceil(8) as usize
    }

    /// Copies memory into the dictionary.
    pub(crate) fn take(&self, memory: &[u8], objects: &mut Dictionary) {
        let mut bit = 0;
        for &(index, sub_index, bits) in &self.entries {
            if let Some(entry) = objects.entry_mut(index, sub_index) {
                copy_bits(memory, bit, &mut entry.value, 0, u64::from(bits));
            }
            bit += u64::from(bits);
        }
    }

    /// Copies the dictionary into memory; gaps are zero.
    pub(crate) fn put(&self, objects: &Dictionary, memory: &mut [u8]) {
        let mut bit = 0;
        for &(index, sub_index, bits) in &self.entries {
            let value = objects
                .entry(index, sub_index)
                .map_or(&[0_u8; 8][..], |entry| &entry.value);
            copy_bits(value, 0, memory, bit, u64::from(bits));
            bit += u64::from(bits);
        }
    }
}
