//! Round trips of EtherCAT frames: broadcast reads, which change nothing.

use core::time::Duration;

use evolvent_bridge::{RoundTrips, measure_round_trips, monotonic_ns};

use crate::socket::{InterfaceError, PacketSocket};

/// Broadcast read.
const BRD: u8 = 7;
/// First index of the datagrams; MainDevices on the same wire use lower ones.
const FIRST_INDEX: u8 = 0xF0;
/// Source address of the frames, locally administered.
const SOURCE: [u8; 6] = [0x02, 0, 0, 0, 0, 0x45];

/// A frame with one read of register 0 (controller type).
fn frame(index: u8) -> [u8; 60] {
    let mut frame = [0; 60];
    frame[..6].fill(0xFF);
    frame[6..12].copy_from_slice(&SOURCE);
    frame[12..14].copy_from_slice(&0x88A4_u16.to_be_bytes());
    // 13 bytes of datagrams: header, one byte of data, working counter.
    frame[14..16].copy_from_slice(&(1_u16 << 12 | 13).to_le_bytes());
    (frame[16], frame[17], frame[22]) = (BRD, index, 1);
    frame
}

/// Sends a frame in each period for the given duration. Also returns the number of devices that replied.
///
/// # Errors
/// The interface cannot be opened, or another MainDevice uses it.
pub fn round_trips(
    interface: &str,
    period: Duration,
    duration: Duration,
) -> Result<(RoundTrips, u16), InterfaceError> {
    let socket = PacketSocket::open(interface)?;
    let (mut index, mut buffer, mut found) = (0_u8, [0; 1600], 0_u16);
    let trips = measure_round_trips(period, duration, |until_ns| {
        index = (index + 1) % 16;
        let number = FIRST_INDEX | index;
        if socket.send(&frame(number)).is_err() {
            return false;
        }
        loop {
            while let Some(bytes) = socket.receive(&mut buffer) {
                if bytes.len() >= 29 && bytes[16] == BRD && bytes[17] == number {
                    found = u16::from_le_bytes([bytes[27], bytes[28]]);
                    return true;
                }
            }
            let now_ns = monotonic_ns();
            if now_ns >= until_ns {
                return false;
            }
            socket.wait(until_ns - now_ns);
        }
    })
    .map_err(|source| InterfaceError::Closed {
        interface: interface.to_owned(),
        source,
    })?;
    Ok((trips, found))
}
