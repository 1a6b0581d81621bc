//! LBP16 on the board's side: commands in a packet, data in the reply.
//!
//! A command is a 16-bit word, low byte first: bit 15 write, bit 14 an address follows, bit 13 information
//! about the space, bits 12 to 10 the space, bits 9 and 8 the width (8, 16, 32, 64 bits), bit 7 increment of
//! the address, bits 6 to 0 the count.

/// The memory that the protocol accesses.
pub(crate) trait Memory {
    /// Reads `bytes` bytes (1, 2, 4 or 8) of a space.
    fn read(&mut self, space: u8, address: u16, bytes: usize) -> u64;
    /// Writes `bytes` bytes of a space.
    fn write(&mut self, space: u8, address: u16, bytes: usize, value: u64);
    /// Reads the information about a space.
    fn information(&mut self, space: u8, address: u16) -> u16;
    /// Counts a command that cannot be carried out; the rest of the packet is dropped.
    fn refused(&mut self);
}

/// Carries out a packet. Returns the reply, which has the data of all reads in order and is empty without
/// any. `pointers` are the addresses at which commands without an address continue, one per space.
pub(crate) fn carry_out(
    mut packet: &[u8],
    pointers: &mut [u16; 8],
    memory: &mut impl Memory,
    reply: &mut Vec<u8>,
) {
    reply.clear();
    while !packet.is_empty() {
        let Some((command, rest)) = word(packet) else {
            return memory.refused();
        };
        packet = rest;
        let space = (command >> 10 & 7) as u8;
        let bytes = 1 << (command >> 8 & 3);
        let pointer = &mut pointers[usize::from(space)];
        if command & 1 << 14 != 0 {
            let Some((address, rest)) = word(packet) else {
                return memory.refused();
            };
            packet = rest;
            *pointer = address;
        }
        for _ in 0..command & 0x7F {
            let address = *pointer;
            if command & 1 << 15 != 0 {
                if packet.len() < bytes {
                    return memory.refused();
                }
                let (data, rest) = packet.split_at(bytes);
                packet = rest;
                let mut value = [0; 8];
                value[..bytes].copy_from_slice(data);
                memory.write(space, address, bytes, u64::from_le_bytes(value));
            } else if command & 1 << 13 != 0 {
                reply.extend(memory.information(space, address).to_le_bytes());
            } else {
                reply.extend(&memory.read(space, address, bytes).to_le_bytes()[..bytes]);
            }
            if command & 1 << 7 != 0 {
                *pointer = pointer.wrapping_add(bytes as u16);
            }
        }
    }
}

fn word(bytes: &[u8]) -> Option<(u16, &[u8])> {
    let (word, rest) = bytes.split_first_chunk::<2>()?;
    Some((u16::from_le_bytes(*word), rest))
}
