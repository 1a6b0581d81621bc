//! The contents of a device's EEPROM (SubDevice information interface, ETG.2010): identity, names, mailbox,
//! process data, clock.
//!
//! The image comes from a device, so nothing in it is trusted: data beyond its end are skipped.

/// Bytes before the first category.
pub(crate) const HEAD_BYTES: usize = 0x80;
/// Maximum size of an image: 64 kbit, twice that of EEPROMs of drives.
pub(crate) const MAX_BYTES: usize = 8192;
/// Maximum number of PDOs per direction, and of entries per PDO.
const MAX_PDOS: usize = 64;

const STRINGS: u16 = 10;
const GENERAL: u16 = 30;
const INPUTS: u16 = 50;
const OUTPUTS: u16 = 51;
const CLOCK: u16 = 60;
const END: u16 = 0xFFFF;

/// An object in a PDO; index 0 fills a gap.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PdoEntry {
    /// Index.
    pub index: u16,
    /// Sub-index.
    pub sub_index: u8,
    /// Size.
    pub bits: u8,
    /// Name; empty for none.
    pub name: String,
    /// Unit from an ESI file; empty for none.
    pub unit: String,
}

/// A PDO with its mapping.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pdo {
    /// Index: from 1600h outputs of the MainDevice, from 1A00h inputs.
    pub index: u16,
    /// Name; empty for none.
    pub name: String,
    /// Its entries in their order.
    pub entries: Vec<PdoEntry>,
}

/// The contents of an EEPROM.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SiiContents {
    /// Vendor.
    pub vendor: u32,
    /// Product code.
    pub product: u32,
    /// Revision.
    pub revision: u32,
    /// Serial number; 0 for none.
    pub serial: u32,
    /// Station alias; 0 for none.
    pub alias: u16,
    /// Short name, as on the label; empty for none.
    pub order: String,
    /// Long name; empty for none.
    pub name: String,
    /// Whether it has a mailbox with CoE.
    pub has_coe: bool,
    /// Whether its process data can be written: assigned and mapped.
    pub is_mappable: bool,
    /// Whether it names modes of a distributed clock.
    pub has_clock: bool,
    /// Its outputs.
    pub outputs: Vec<Pdo>,
    /// Its inputs.
    pub inputs: Vec<Pdo>,
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    let bytes = bytes.get(at..at.checked_add(2)?)?;
    Some(u16::from_le_bytes(bytes.try_into().ok()?))
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes
        .get(at..at + 4)
        .and_then(|bytes| bytes.try_into().ok())
        .map_or(0, u32::from_le_bytes)
}

/// Categories with their data, up to the end of the image.
fn categories(image: &[u8]) -> impl Iterator<Item = (u16, &[u8])> {
    let mut at = HEAD_BYTES;
    core::iter::from_fn(move || {
        let (kind, words) = (u16_at(image, at)?, u16_at(image, at + 2)?);
        if kind == END {
            return None;
        }
        let begin = at + 4;
        at = begin + 2 * usize::from(words);
        Some((kind, image.get(begin..at)?))
    })
}

/// Number of bytes required to distinguish the next category from the end; `None` if the image is complete.
pub(crate) fn bytes_wanted(image: &[u8]) -> Option<usize> {
    let mut at = HEAD_BYTES;
    loop {
        if at + 4 > MAX_BYTES {
            return None;
        }
        let (Some(kind), Some(words)) = (u16_at(image, at), u16_at(image, at + 2)) else {
            return Some(at + 4);
        };
        if kind == END {
            return None;
        }
        at += 4 + 2 * usize::from(words);
    }
}

/// Text of a device on one line: unprintable characters become question marks.
pub(crate) fn printable(bytes: &[u8]) -> String {
    bytes
        .iter()
        .filter(|&&byte| byte != 0)
        .map(|&byte| {
            if byte == b' ' || byte.is_ascii_graphic() {
                char::from(byte)
            } else {
                '?'
            }
        })
        .collect()
}

fn strings(data: &[u8]) -> Vec<String> {
    let Some((&count, mut rest)) = data.split_first() else {
        return Vec::new();
    };
    let mut strings = Vec::new();
    for _ in 0..count {
        let Some((text, after)) = rest
            .split_first()
            .and_then(|(&length, text)| text.split_at_checked(usize::from(length)))
        else {
            break;
        };
        strings.push(printable(text));
        rest = after;
    }
    strings
}

fn pdos(data: &[u8], text: impl Fn(u8) -> String) -> Vec<Pdo> {
    let mut items = data.chunks_exact(8);
    let mut pdos = Vec::new();
    while let Some(&[i0, i1, entries, _, _, name, ..]) = items.next() {
        if pdos.len() == MAX_PDOS {
            break;
        }
        pdos.push(Pdo {
            index: u16::from_le_bytes([i0, i1]),
            name: text(name),
            entries: items
                .by_ref()
                .take(usize::from(entries))
                .filter_map(|entry| match *entry {
                    [i0, i1, sub_index, name, _, bits, ..] => Some(PdoEntry {
                        index: u16::from_le_bytes([i0, i1]),
                        sub_index,
                        bits,
                        name: text(name),
                        unit: String::new(),
                    }),
                    _ => None,
                })
                .collect(),
        });
    }
    pdos
}

impl SiiContents {
    /// Reads an image. Missing data are empty, zero or false.
    #[must_use]
    pub fn parse(image: &[u8]) -> Self {
        let find = |wanted| {
            categories(image)
                .find(|(kind, _)| *kind == wanted)
                .map_or(&[][..], |(_, data)| data)
        };
        let strings = strings(find(STRINGS));
        let text = |number: u8| {
            usize::from(number)
                .checked_sub(1)
                .and_then(|place| strings.get(place).cloned())
                .unwrap_or_default()
        };
        let general = find(GENERAL);
        let byte = |place: usize| general.get(place).copied().unwrap_or(0);
        // Word 1Ch: mailbox protocols, bit 2 is CoE. Byte 5 of `general`: bit 2 PDO assignment, bit 3 PDO
        // configuration.
        let has_coe = u16_at(image, 0x38).unwrap_or(0) & 1 << 2 != 0;
        Self {
            vendor: u32_at(image, 0x10),
            product: u32_at(image, 0x14),
            revision: u32_at(image, 0x18),
            serial: u32_at(image, 0x1C),
            alias: u16_at(image, 0x08).unwrap_or(0),
            order: text(byte(2)),
            name: text(byte(3)),
            has_coe,
            is_mappable: has_coe && byte(5) & 0b1100 == 0b1100,
            has_clock: categories(image).any(|(kind, _)| kind == CLOCK),
            outputs: pdos(find(OUTPUTS), text),
            inputs: pdos(find(INPUTS), text),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The required length grows until the end is found, and never beyond the bound, whatever an EEPROM
    /// contains.
    #[test]
    fn reading_ends() {
        let mut random = evolvent_random::Random::seeded(48);
        for _ in 0..evolvent_random::cases(2_000) {
            let bytes: Vec<u8> = (0..MAX_BYTES + 0x2_0000)
                .map(|place| {
                    if place % 2 == 1 && random.unit() < 0.95 {
                        0
                    } else {
                        random.bits() as u8
                    }
                })
                .take(MAX_BYTES)
                .collect();
            let (mut length, mut rounds) = (HEAD_BYTES, 0);
            while let Some(wanted) = bytes_wanted(&bytes[..length]) {
                assert!(wanted > length && wanted <= MAX_BYTES, "{wanted} after {length}");
                (length, rounds) = (wanted, rounds + 1);
            }
            assert!(rounds <= MAX_BYTES / 4);
            let _contents = SiiContents::parse(&bytes[..length]);
        }
    }
}
