//! The object dictionary of a device.

use std::collections::BTreeMap;

/// Data types of CANopen, by their numbers.
pub mod data_type {
    /// One bit.
    pub const BOOLEAN: u16 = 0x01;
    /// `i8`
    pub const INTEGER8: u16 = 0x02;
    /// `i16`
    pub const INTEGER16: u16 = 0x03;
    /// `i32`
    pub const INTEGER32: u16 = 0x04;
    /// `u8`
    pub const UNSIGNED8: u16 = 0x05;
    /// `u16`
    pub const UNSIGNED16: u16 = 0x06;
    /// `u32`
    pub const UNSIGNED32: u16 = 0x07;
    /// Text.
    pub const VISIBLE_STRING: u16 = 0x09;
}

/// Object codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ObjectCode {
    Variable = 7,
    Array = 8,
    Record = 9,
}

/// Who may write an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    ReadOnly,
    ReadWrite,
    /// In PRE-OP only.
    Configuration,
}

/// PDOs into which an entry may be mapped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mapping {
    Never,
    /// PDOs of outputs, which the MainDevice writes.
    Output,
    /// PDOs of inputs, which the MainDevice reads.
    Input,
}

/// One sub-index.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Entry {
    pub(crate) name: &'static str,
    pub(crate) data_type: u16,
    pub(crate) access: Access,
    pub(crate) mapping: Mapping,
    pub(crate) value: Vec<u8>,
    /// Bits in a PDO.
    pub(crate) bits: u8,
}

impl Entry {
    /// Creates an integer of a data type.
    pub(crate) fn integer(name: &'static str, data_type: u16, value: i64) -> Self {
        let bits: u8 = match data_type {
            data_type::BOOLEAN => 1,
            data_type::INTEGER8 | data_type::UNSIGNED8 => 8,
            data_type::INTEGER16 | data_type::UNSIGNED16 => 16,
            _ => 32,
        };
        Self {
            name,
            data_type,
            access: Access::ReadOnly,
            mapping: Mapping::Never,
            value: value.to_le_bytes()[..usize::from(bits).div_ceil(8)].to_vec(),
            bits,
        }
    }

    pub(crate) fn text(name: &'static str, text: &str) -> Self {
        Self {
            name,
            data_type: data_type::VISIBLE_STRING,
            access: Access::ReadOnly,
            mapping: Mapping::Never,
            value: text.as_bytes().to_vec(),
            bits: 0,
        }
    }

    pub(crate) fn writable(self) -> Self {
        Self {
            access: Access::ReadWrite,
            ..self
        }
    }

    pub(crate) fn configuration(self) -> Self {
        Self {
            access: Access::Configuration,
            ..self
        }
    }

    pub(crate) fn output(self) -> Self {
        Self {
            access: Access::ReadWrite,
            mapping: Mapping::Output,
            ..self
        }
    }

    pub(crate) fn input(self) -> Self {
        Self {
            mapping: Mapping::Input,
            ..self
        }
    }

    /// Access bits of the SDO information service: read in PRE-OP, SAFE-OP, OP; write likewise; RxPDO; TxPDO.
    pub(crate) fn access_bits(&self) -> u16 {
        let write = match self.access {
            Access::ReadOnly => 0,
            Access::ReadWrite => 0b11_1000,
            Access::Configuration => 0b00_1000,
        };
        let map = match self.mapping {
            Mapping::Never => 0,
            Mapping::Output => 1 << 6,
            Mapping::Input => 1 << 7,
        };
        0b111 | write | map
    }
}

/// One index.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Object {
    pub(crate) name: &'static str,
    pub(crate) code: ObjectCode,
    /// By sub-index.
    pub(crate) entries: Vec<Entry>,
}

/// All objects of a device.
#[derive(Clone, Debug, Default)]
pub struct Dictionary {
    objects: BTreeMap<u16, Object>,
}

impl Dictionary {
    /// Adds a variable.
    pub(crate) fn variable(&mut self, index: u16, entry: Entry) {
        let object = Object {
            name: entry.name,
            code: ObjectCode::Variable,
            entries: vec![entry],
        };
        self.objects.insert(index, object);
    }

    /// Adds an array or record; sub-index 0 is the number of the others.
    pub(crate) fn compound(&mut self, index: u16, name: &'static str, code: ObjectCode, entries: Vec<Entry>) {
        let count = Entry::integer("Highest sub-index", data_type::UNSIGNED8, entries.len() as i64);
        let entries = core::iter::once(count).chain(entries).collect();
        self.objects.insert(index, Object { name, code, entries });
    }

    pub(crate) fn object(&self, index: u16) -> Option<&Object> {
        self.objects.get(&index)
    }

    pub(crate) fn entry(&self, index: u16, sub_index: u8) -> Option<&Entry> {
        self.objects.get(&index)?.entries.get(usize::from(sub_index))
    }

    pub(crate) fn entry_mut(&mut self, index: u16, sub_index: u8) -> Option<&mut Entry> {
        self.objects
            .get_mut(&index)?
            .entries
            .get_mut(usize::from(sub_index))
    }

    pub(crate) fn indices(&self) -> impl Iterator<Item = u16> + '_ {
        self.objects.keys().copied()
    }

    /// The value of an integer; 0 if it does not exist.
    #[must_use]
    pub fn integer(&self, index: u16, sub_index: u8) -> i64 {
        let Some(entry) = self.entry(index, sub_index) else {
            return 0;
        };
        let mut bytes = [0_u8; 8];
        let count = entry.value.len().min(8);
        bytes[..count].copy_from_slice(&entry.value[..count]);
        let value = i64::from_le_bytes(bytes);
        match entry.data_type {
            data_type::INTEGER8 => i64::from(value as i8),
            data_type::INTEGER16 => i64::from(value as i16),
            data_type::INTEGER32 => i64::from(value as i32),
            _ => value,
        }
    }

    /// Sets the value of an integer, truncated to its size.
    pub fn set_integer(&mut self, index: u16, sub_index: u8, value: i64) {
        if let Some(entry) = self.entry_mut(index, sub_index) {
            let count = entry.value.len().min(8);
            entry.value[..count].copy_from_slice(&value.to_le_bytes()[..count]);
        }
    }
}
