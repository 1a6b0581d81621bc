//! Round trips of packets to a board: reads of its cookie, which change nothing.

use core::time::Duration;
use std::net::IpAddr;

use evolvent_bridge::{RoundTrips, measure_round_trips, monotonic_ns};

use crate::link::{Link, LinkError};
use crate::packet::{MAX_PACKET, Packet, Space};

/// Sends a packet in each period for the given duration.
///
/// # Errors
/// There is no route to the address, or no thread can be started.
pub fn round_trips(address: IpAddr, period: Duration, duration: Duration) -> Result<RoundTrips, LinkError> {
    let link = Link::open(address)?;
    let mut packet = Packet::new();
    packet.read(Space::HostMot2, 0x0100, 1)?;
    let mut buffer = [0; MAX_PACKET + 8];
    measure_round_trips(period, duration, |until_ns| {
        // Late replies.
        while link.receive(&mut buffer).is_some() {}
        link.send(&packet);
        loop {
            if let Some(bytes) = link.receive(&mut buffer)
                && bytes.len() == packet.reply_bytes()
            {
                return true;
            }
            let left_ns = until_ns.saturating_sub(monotonic_ns());
            if left_ns == 0 {
                return false;
            }
            link.wait(Duration::from_nanos(left_ns));
        }
    })
    .map_err(|error| LinkError::Socket {
        address,
        cause: error.to_string(),
    })
}
