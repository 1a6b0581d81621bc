//! The names of parameters: case and spaces are ignored, and names are stored as small numbers.
//!
//! Names that start with `_` are global; some of those are predefined and read-only
//! ([`System`](crate::parameters::system::System)). All others are local to a subroutine.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use crate::parameters::system::System;

/// Maximum length of a name without spaces.
const MAX_BYTES: usize = 100;

/// Maximum number of names in a program.
const MAX_NAMES: usize = 100_000;

/// The number of a name.
pub(crate) type NameId = u32;

/// The scope of a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NameKind {
    Local,
    Global,
    System(System),
}

/// All names so far.
#[derive(Debug, Default)]
pub(crate) struct Names {
    ids: HashMap<Box<[u8]>, NameId, BuildHasherDefault<Fnv>>,
    kinds: Vec<NameKind>,
}

/// A normalised name: lower case, without spaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NormalizedName {
    bytes: [u8; MAX_BYTES],
    length: usize,
}

impl NormalizedName {
    /// `None` if the name is empty, too long or not plain ASCII.
    pub(crate) fn new(text: &[u8]) -> Option<Self> {
        let mut bytes = [0; MAX_BYTES];
        let mut length = 0;
        for byte in text {
            if matches!(byte, b' ' | b'\t') {
                continue;
            }
            if !byte.is_ascii_graphic() {
                return None;
            }
            *bytes.get_mut(length)? = byte.to_ascii_lowercase();
            length += 1;
        }
        (length > 0).then_some(Self { bytes, length })
    }

    /// The name that equals an integer.
    pub(crate) fn of_number(mut number: u32) -> Self {
        let mut reversed = [0; 10];
        let mut length = 0;
        loop {
            reversed[length] = b'0' + (number % 10) as u8;
            length += 1;
            number /= 10;
            if number == 0 {
                break;
            }
        }
        let mut bytes = [0; MAX_BYTES];
        for (index, digit) in reversed[..length].iter().rev().enumerate() {
            bytes[index] = *digit;
        }
        Self { bytes, length }
    }

    fn as_bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }

    pub(crate) fn as_str(&self) -> &str {
        std::str::from_utf8(&self.bytes[..self.length]).unwrap_or_default()
    }
}

impl Names {
    /// The number of a known name; predefined names are always known.
    pub(crate) fn find(&self, name: &NormalizedName) -> Option<(NameId, NameKind)> {
        if let Some(&id) = self.ids.get(name.as_bytes()) {
            return Some((id, self.kinds[id as usize]));
        }
        System::of(name.as_str()).map(|system| (NameId::MAX, NameKind::System(system)))
    }

    /// The number of a name, added if needed; `None` if there are too many.
    pub(crate) fn intern(&mut self, name: &NormalizedName) -> Option<(NameId, NameKind)> {
        if let Some(found) = self.find(name) {
            return Some(found);
        }
        self.add(name)
    }

    /// The number of the name of an O-word; none of them is predefined.
    pub(crate) fn intern_label(&mut self, name: &NormalizedName) -> Option<NameId> {
        if let Some(&id) = self.ids.get(name.as_bytes()) {
            return Some(id);
        }
        self.add(name).map(|(id, _)| id)
    }

    /// The text of a name.
    pub(crate) fn name(&self, id: NameId) -> Option<&str> {
        self.all()
            .find(|(_, other, _)| *other == id)
            .map(|(name, ..)| name)
    }

    /// All names so far, in no particular order, including those of O-words.
    pub(crate) fn all(&self) -> impl Iterator<Item = (&str, NameId, NameKind)> {
        self.ids.iter().filter_map(|(name, id)| {
            let name = std::str::from_utf8(name).ok()?;
            Some((name, *id, self.kinds[*id as usize]))
        })
    }

    fn add(&mut self, name: &NormalizedName) -> Option<(NameId, NameKind)> {
        if self.kinds.len() >= MAX_NAMES {
            return None;
        }
        let id = self.kinds.len() as NameId;
        let kind = if name.as_str().starts_with('_') {
            NameKind::Global
        } else {
            NameKind::Local
        };
        self.ids.insert(name.as_bytes().into(), id);
        self.kinds.push(kind);
        Some((id, kind))
    }
}

/// Fowler-Noll-Vo hash: suits short keys without secrets, and is the same on every machine.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fnv(u64);

impl Default for Fnv {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Hasher for Fnv {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_ignore_case_and_blanks() {
        let mut names = Names::default();
        let id = |names: &mut Names, text: &str| {
            names
                .intern(&NormalizedName::new(text.as_bytes()).unwrap())
                .unwrap()
        };
        let first = id(&mut names, "Tool Width");
        assert_eq!(first, id(&mut names, "tool\twidth"));
        assert_ne!(first.0, id(&mut names, "toolwidth2").0);
        assert_eq!(id(&mut names, "_global").1, NameKind::Global);
        assert!(matches!(id(&mut names, "_LINE").1, NameKind::System(_)));
    }

    #[test]
    fn numbers_are_valid_names() {
        for number in [0, 7, 10, 1234, u32::MAX] {
            assert_eq!(NormalizedName::of_number(number).as_str(), number.to_string());
        }
    }

    #[test]
    fn names_are_ascii_of_limited_length() {
        assert!(NormalizedName::new(b"  ").is_none());
        assert!(NormalizedName::new(b"caf\xc3\xa9").is_none());
        assert!(NormalizedName::new(&[b'a'; MAX_BYTES]).is_some());
        assert!(NormalizedName::new(&[b'a'; MAX_BYTES + 1]).is_none());
    }
}
