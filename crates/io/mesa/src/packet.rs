//! The client side of LBP16: writes commands into a packet and reads data from a reply.

use thiserror::Error;

/// Maximum packet size, bytes: below the payload of one Ethernet frame.
pub const MAX_PACKET: usize = 1400;
/// Maximum number of values per command.
const MAX_COUNT: usize = 127;

/// A memory space of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Space {
    /// Registers of HostMot2, 32 bits each.
    HostMot2 = 0,
    /// EEPROM of the Ethernet interface, 16 bits.
    Eeprom = 2,
    /// Timers and scratch words, 16 bits.
    Timer = 4,
    /// Counters and settings of the protocol, 16 bits.
    Communication = 6,
    /// Information about the board, 16 bits.
    Board = 7,
}

impl Space {
    /// Bytes of one value.
    const fn width(self) -> usize {
        match self {
            Self::HostMot2 => 4,
            _ => 2,
        }
    }
}

/// The commands or their replies exceed a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the packet is full: {MAX_PACKET} bytes are the maximum that one frame carries")]
pub struct PacketFull;

const fn command(space: Space, count: usize, is_write: bool) -> u16 {
    let width = match space.width() {
        4 => 2,
        _ => 1,
    };
    // An address follows (bit 14) and is incremented (bit 7).
    (is_write as u16) << 15 | 1 << 14 | (space as u16) << 10 | width << 8 | 1 << 7 | count as u16
}

/// Commands to a board. Does not allocate.
///
/// ```
/// use evolvent_mesa::{Packet, Space};
///
/// let mut packet = Packet::new();
/// packet.read(Space::HostMot2, 0x0100, 1)?;
/// assert_eq!(packet.bytes(), [0x81, 0x42, 0x00, 0x01]);
/// assert_eq!(packet.reply_bytes(), 4);
/// # Ok::<(), evolvent_mesa::PacketFull>(())
/// ```
#[derive(Clone, Debug)]
pub struct Packet {
    bytes: [u8; MAX_PACKET],
    length: usize,
    reply_bytes: usize,
}

impl Default for Packet {
    fn default() -> Self {
        Self::new()
    }
}

impl Packet {
    /// An empty packet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            bytes: [0; MAX_PACKET],
            length: 0,
            reply_bytes: 0,
        }
    }

    /// Removes all commands.
    pub const fn clear(&mut self) {
        (self.length, self.reply_bytes) = (0, 0);
    }

    /// The bytes to send.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }

    /// Length of the reply, bytes; 0 if the packet has none.
    #[must_use]
    pub const fn reply_bytes(&self) -> usize {
        self.reply_bytes
    }

    fn push(&mut self, bytes: &[u8]) -> Result<(), PacketFull> {
        let end = self.length + bytes.len();
        self.bytes
            .get_mut(self.length..end)
            .ok_or(PacketFull)?
            .copy_from_slice(bytes);
        self.length = end;
        Ok(())
    }

    /// Reads `count` values starting at an address.
    ///
    /// # Errors
    /// The packet or the reply is full.
    pub fn read(&mut self, space: Space, mut address: u16, mut count: usize) -> Result<(), PacketFull> {
        let bytes = count * space.width();
        if self.reply_bytes + bytes > MAX_PACKET {
            return Err(PacketFull);
        }
        while count > 0 {
            let some = count.min(MAX_COUNT);
            self.push(&command(space, some, false).to_le_bytes())?;
            self.push(&address.to_le_bytes())?;
            address = address.wrapping_add((some * space.width()) as u16);
            count -= some;
        }
        self.reply_bytes += bytes;
        Ok(())
    }

    /// Writes values of 32 bits starting at an address of HostMot2.
    ///
    /// # Errors
    /// The packet is full.
    pub fn write(&mut self, mut address: u16, values: &[u32]) -> Result<(), PacketFull> {
        for some in values.chunks(MAX_COUNT) {
            self.push(&command(Space::HostMot2, some.len(), true).to_le_bytes())?;
            self.push(&address.to_le_bytes())?;
            for value in some {
                self.push(&value.to_le_bytes())?;
            }
            address = address.wrapping_add(4 * some.len() as u16);
        }
        Ok(())
    }

    /// Writes a word of another space.
    ///
    /// # Errors
    /// The packet is full.
    pub fn write_word(&mut self, space: Space, address: u16, value: u16) -> Result<(), PacketFull> {
        self.push(&command(space, 1, true).to_le_bytes())?;
        self.push(&address.to_le_bytes())?;
        self.push(&value.to_le_bytes())
    }
}

/// Values of a reply in the order of the reads. Missing values read as zero; compare the lengths first.
#[derive(Clone, Copy, Debug)]
pub struct Reply<'a> {
    rest: &'a [u8],
}

impl<'a> Reply<'a> {
    /// Wraps the bytes of a reply.
    #[must_use]
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    /// The next value of 32 bits.
    pub fn value(&mut self) -> u32 {
        let Some((value, rest)) = self.rest.split_first_chunk() else {
            return 0;
        };
        self.rest = rest;
        u32::from_le_bytes(*value)
    }

    /// The next word of 16 bits.
    pub fn word(&mut self) -> u16 {
        let Some((word, rest)) = self.rest.split_first_chunk() else {
            return 0;
        };
        self.rest = rest;
        u16::from_le_bytes(*word)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_those_of_the_protocol() {
        // 4983h 0002h: three words of the EEPROM starting at 2, as LinuxCNC's driver reads the hardware
        // address.
        let mut packet = Packet::new();
        packet.read(Space::Eeprom, 2, 3).expect("room");
        assert_eq!(packet.bytes(), [0x83, 0x49, 0x02, 0x00]);
        // 5D88h: eight words of the board's name, likewise.
        packet.clear();
        packet.read(Space::Board, 0, 8).expect("room");
        assert_eq!(packet.bytes(), [0x88, 0x5D, 0x00, 0x00]);
        assert_eq!(packet.reply_bytes(), 16);
    }

    #[test]
    fn a_packet_that_is_full_says_so() {
        let mut packet = Packet::new();
        assert_eq!(packet.read(Space::HostMot2, 0, 351), Err(PacketFull));
        assert_eq!(packet.write(0, &[0; 350]), Err(PacketFull));
    }
}
