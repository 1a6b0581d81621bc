//! Queues between the threads.

use rtrb::{Consumer, Producer, RingBuffer};

/// Seconds of setpoints and records that the queues of bus and trace hold.
const SECONDS: f64 = 2.0;
/// Bounds of their length.
const LENGTH: (usize, usize) = (4096, 65_536);

/// How many setpoints or records the queues of bus and trace hold at this rate.
pub(crate) fn queue_length(rate_hz: f64) -> usize {
    ((rate_hz * SECONDS) as usize).clamp(LENGTH.0, LENGTH.1)
}

/// Both ends, or none.
pub(crate) fn optional_ring<T>(wanted: bool, length: usize) -> (Option<Producer<T>>, Option<Consumer<T>>) {
    if !wanted {
        return (None, None);
    }
    let (producer, consumer) = RingBuffer::new(length);
    (Some(producer), Some(consumer))
}
