//! The SubDevice information interface: an EEPROM with categories, and its registers.

use crate::registers::{Registers, address};

const READ: u16 = 1 << 8;
const WRITE: u16 = 1 << 9;
const RELOAD: u16 = 1 << 10;
const COMMANDS: u16 = READ | WRITE | RELOAD;
const WRITE_ENABLE: u16 = 1;
const READS_EIGHT: u16 = 1 << 6;
const TWO_ADDRESS_BYTES: u16 = 1 << 7;
const COMMAND_ERROR: u16 = 1 << 13;
const WRITE_ENABLE_ERROR: u16 = 1 << 14;
/// Words of the EEPROM: 16 kbit.
const WORDS: usize = 1024;

/// Identity, as in words 8 to 15 and object 1018h.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Vendor.
    pub vendor: u32,
    /// Product code.
    pub product: u32,
    /// Revision.
    pub revision: u32,
    /// Serial number.
    pub serial: u32,
}

/// A SyncManager, as in category 41.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SiiSyncManager {
    pub(crate) start: u16,
    pub(crate) length: u16,
    pub(crate) control: u8,
    pub(crate) enable: u8,
    /// 1 mailbox out, 2 mailbox in, 3 outputs, 4 inputs.
    pub(crate) usage: u8,
}

/// An entry of a PDO, as in categories 50 and 51.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct SiiEntry {
    pub(crate) index: u16,
    pub(crate) sub_index: u8,
    pub(crate) name: &'static str,
    pub(crate) data_type: u8,
    pub(crate) bits: u8,
}

/// A PDO, as in categories 50 (inputs) and 51 (outputs).
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct SiiPdo {
    pub(crate) index: u16,
    pub(crate) sync_manager: u8,
    pub(crate) name: &'static str,
    pub(crate) is_input: bool,
    pub(crate) entries: Vec<SiiEntry>,
}

/// Contents of the EEPROM.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Contents {
    pub(crate) identity: Identity,
    pub(crate) alias: u16,
    pub(crate) order: &'static str,
    pub(crate) name: &'static str,
    /// Standard mailbox: receive offset and size, send offset and size.
    pub(crate) mailbox: Option<[u16; 4]>,
    pub(crate) fmmus: Vec<u8>,
    pub(crate) sync_managers: Vec<SiiSyncManager>,
    pub(crate) pdos: Vec<SiiPdo>,
    pub(crate) has_clock: bool,
}

/// CRC-8, polynomial 07h, start FFh, over the first 14 bytes.
fn checksum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0xFF, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc: u8, _| {
            if crc & 0x80 == 0 {
                crc << 1
            } else {
                crc << 1 ^ 0x07
            }
        })
    })
}

#[derive(Default)]
struct Strings(Vec<&'static str>);

impl Strings {
    /// The number of a string, from 1; 0 for none.
    fn number(&mut self, text: &'static str) -> u8 {
        if text.is_empty() {
            return 0;
        }
        let index = self.0.iter().position(|&other| other == text).unwrap_or_else(|| {
            self.0.push(text);
            self.0.len() - 1
        });
        u8::try_from(index + 1).unwrap_or(0)
    }
}

impl Contents {
    /// The image of the EEPROM (ETG.2010).
    pub(crate) fn image(&self) -> Vec<u8> {
        let mut image = vec![0_u8; 0x80];
        image[0] = 0x80; // PDI: on-chip bus
        image[8..10].copy_from_slice(&self.alias.to_le_bytes());
        image[14] = checksum(&image[..14]);
        let Identity {
            vendor,
            product,
            revision,
            serial,
        } = self.identity;
        for (offset, number) in (16..).step_by(4).zip([vendor, product, revision, serial]) {
            image[offset..offset + 4].copy_from_slice(&number.to_le_bytes());
        }
        if let Some(mailbox) = self.mailbox {
            for (offset, number) in (0x30..).step_by(2).zip(mailbox) {
                image[offset..offset + 2].copy_from_slice(&number.to_le_bytes());
            }
            image[0x38] = 0x04; // CoE
        }
        image[0x7C..0x7E].copy_from_slice(&(WORDS as u16 * 16 / 1024 - 1).to_le_bytes());
        image[0x7E] = 1;
        let mut strings = Strings::default();
        let general = self.general(&mut strings);
        let inputs = self.pdo_category(true, &mut strings);
        let outputs = self.pdo_category(false, &mut strings);
        let clock = self.clock_category(&mut strings);
        let mut text = vec![u8::try_from(strings.0.len()).unwrap_or(0)];
        for string in &strings.0 {
            text.push(u8::try_from(string.len()).unwrap_or(0));
            text.extend_from_slice(string.as_bytes());
        }
        let sync_managers: Vec<u8> = self
            .sync_managers
            .iter()
            .flat_map(|manager| {
                let ([s0, s1], [l0, l1]) = (manager.start.to_le_bytes(), manager.length.to_le_bytes());
                [s0, s1, l0, l1, manager.control, 0, manager.enable, manager.usage]
            })
            .collect();
        let categories = [
            (10, text),
            (30, general),
            (40, self.fmmus.clone()),
            (41, sync_managers),
            (50, inputs),
            (51, outputs),
            (60, clock),
        ];
        for (kind, mut data) in categories {
            if data.is_empty() {
                continue;
            }
            if data.len() % 2 == 1 {
                data.push(0);
            }
            image.extend_from_slice(&u16::to_le_bytes(kind));
            image.extend_from_slice(&((data.len() / 2) as u16).to_le_bytes());
            image.extend_from_slice(&data);
        }
        image.extend_from_slice(&[0xFF; 4]);
        image.resize(WORDS * 2, 0xFF);
        image
    }

    fn general(&self, strings: &mut Strings) -> Vec<u8> {
        let mut general = vec![0_u8; 32];
        general[2] = strings.number(self.order);
        general[3] = strings.number(self.name);
        if self.mailbox.is_some() {
            // SDO, SDO information, PDO assignment, PDO configuration, complete access.
            general[5] = 0b10_1111;
        }
        general[0x10] = 0x11; // ports 0 and 1: MII
        general
    }

    fn pdo_category(&self, inputs: bool, strings: &mut Strings) -> Vec<u8> {
        let mut data = Vec::new();
        for pdo in self.pdos.iter().filter(|pdo| pdo.is_input == inputs) {
            data.extend_from_slice(&pdo.index.to_le_bytes());
            data.extend_from_slice(&[
                pdo.entries.len() as u8,
                pdo.sync_manager,
                0,
                strings.number(pdo.name),
                0,
                0,
            ]);
            for entry in &pdo.entries {
                data.extend_from_slice(&entry.index.to_le_bytes());
                data.extend_from_slice(&[
                    entry.sub_index,
                    strings.number(entry.name),
                    entry.data_type,
                    entry.bits,
                    0,
                    0,
                ]);
            }
        }
        data
    }

    fn clock_category(&self, strings: &mut Strings) -> Vec<u8> {
        if !self.has_clock {
            return Vec::new();
        }
        let mut data = vec![0_u8; 24];
        data[14..16].copy_from_slice(&0x0300_u16.to_le_bytes()); // AssignActivate: SYNC0
        data[18] = strings.number("DC");
        data
    }
}

/// The EEPROM, accessed through registers 0500h to 050Fh.
#[derive(Clone, Debug)]
pub(crate) struct Sii {
    image: Vec<u8>,
    /// Persistent status bits: errors.
    errors: u16,
}

impl Sii {
    pub(crate) fn new(contents: &Contents) -> Self {
        Self {
            image: contents.image(),
            errors: 0,
        }
    }

    /// What the controller loads at power-up.
    pub(crate) fn load(&self, registers: &mut Registers) {
        registers.set(address::STATION_ALIAS, &self.image[8..10]);
        registers.set(
            address::SII_CONTROL,
            &(READS_EIGHT | TWO_ADDRESS_BYTES).to_le_bytes(),
        );
    }

    /// Carries out a command that a write of the MainDevice from `begin` on contained.
    pub(crate) fn after_write(&mut self, registers: &mut Registers, begin: u16, length: usize) {
        let last = address::SII_CONTROL + 1;
        if begin > last || usize::from(begin) + length <= usize::from(last) {
            return;
        }
        let control = registers.u16(address::SII_CONTROL);
        let word = registers.u32(address::SII_ADDRESS) as usize;
        self.errors = 0;
        match control & COMMANDS {
            READ => {
                let mut data = [0xFF_u8; 8];
                if let Some(source) = self.image.get(word * 2..) {
                    let count = source.len().min(8);
                    data[..count].copy_from_slice(&source[..count]);
                }
                registers.set(address::SII_DATA, &data);
            }
            WRITE if control & WRITE_ENABLE == 0 => self.errors = WRITE_ENABLE_ERROR,
            WRITE => {
                let data = registers.u16(address::SII_DATA).to_le_bytes();
                match self.image.get_mut(word * 2..word * 2 + 2) {
                    Some(target) => target.copy_from_slice(&data),
                    None => self.errors = COMMAND_ERROR,
                }
            }
            RELOAD => registers.set(address::STATION_ALIAS, &self.image[8..10]),
            0 => {}
            _ => self.errors = COMMAND_ERROR,
        }
        let status = READS_EIGHT | TWO_ADDRESS_BYTES | self.errors;
        registers.set(address::SII_CONTROL, &status.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ETG.1000.6 specifies the polynomial `x^8 + x^2 + x + 1` and the start value FFh. The test computes it
    /// independently, by long division of the message with its first byte inverted.
    #[test]
    fn the_checksum_is_the_remainder_of_a_division() {
        for message in [b"123456789".as_slice(), &[0x05, 0x0E, 0x03, 0x44], &[0; 14]] {
            let mut bits: Vec<bool> = message
                .iter()
                .enumerate()
                .flat_map(|(i, byte)| {
                    (0..8)
                        .rev()
                        .map(move |bit| (byte ^ if i == 0 { 0xFF } else { 0 }) >> bit & 1 == 1)
                })
                .chain([false; 8])
                .collect();
            for i in 0..message.len() * 8 {
                if bits[i] {
                    for (j, term) in [true, false, false, false, false, false, true, true, true]
                        .into_iter()
                        .enumerate()
                    {
                        bits[i + j] ^= term;
                    }
                }
            }
            let remainder = bits[message.len() * 8..]
                .iter()
                .fold(0_u8, |value, &bit| value << 1 | u8::from(bit));
            assert_eq!(checksum(message), remainder);
        }
    }
}
