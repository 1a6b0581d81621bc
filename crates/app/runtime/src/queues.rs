//! Queues between the threads.

use rtrb::{Consumer, Producer, RingBuffer};

/// Capacity of the queues to bus and trace, in seconds.
const SECONDS: f64 = 2.0;
/// Minimum and maximum of that capacity.
const LENGTH: (usize, usize) = (4096, 65_536);

/// Capacity of the queues to bus and trace at this rate, in setpoints or records.
pub(crate) fn queue_length(rate_hz: f64) -> usize {
    ((rate_hz * SECONDS) as usize).clamp(LENGTH.0, LENGTH.1)
}

/// Both ends of a queue, or none.
pub(crate) fn optional_ring<T>(wanted: bool, length: usize) -> (Option<Producer<T>>, Option<Consumer<T>>) {
    if !wanted {
        return (None, None);
    }
    let (producer, consumer) = RingBuffer::new(length);
    (Some(producer), Some(consumer))
}
