//! The ring on a network interface, in real time.

use core::time::Duration;
use std::collections::VecDeque;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use rustix::time::{ClockId, clock_gettime};

use crate::ring::{Returned, Ring};
use crate::socket::PacketSocket;

/// Maximum wait for a frame: devices continue without frames.
const PATIENCE_NS: u64 = 1_000_000;

/// Above any thread of a MainDevice.
const PRIORITY: i32 = 90;

/// CLOCK_MONOTONIC in ns: the simulator's time.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}

/// Sets `SCHED_FIFO` for the calling thread, if the system permits it: real devices reply independent of the
/// host's load.
fn raise_priority() {
    let parameters = libc::sched_param {
        sched_priority: PRIORITY,
    };
    // SAFETY: the parameters live through the call; 0 is the calling thread.
    let _normal = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) };
}

/// Replies to frames until `stop` is set. The ring is locked for each frame only, so that other threads can
/// read it or add faults.
///
/// # Errors
/// The interface is gone.
pub fn run(ring: &Mutex<Ring>, socket: &PacketSocket, stop: &AtomicBool) -> io::Result<()> {
    raise_priority();
    let mut waiting: VecDeque<Returned> = VecDeque::new();
    let mut last_ns = monotonic_ns();
    while !stop.load(Ordering::Relaxed) {
        let until_ns = waiting.front().map_or(PATIENCE_NS, |first| {
            first.due_ns.saturating_sub(monotonic_ns()).min(PATIENCE_NS)
        });
        let received = socket.receive(Duration::from_nanos(until_ns))?;
        let now_ns = monotonic_ns();
        {
            let mut ring = ring.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(frame) = received {
                last_ns = now_ns;
                waiting.extend(ring.exchange(now_ns, frame));
            } else {
                ring.advance(now_ns);
                let released = ring.release(now_ns.saturating_sub(last_ns));
                waiting.extend(released.map(|frame| Returned {
                    due_ns: now_ns,
                    frame,
                }));
            }
        }
        while waiting.front().is_some_and(|first| first.due_ns <= now_ns) {
            if let Some(returned) = waiting.pop_front() {
                // A frame that does not fit into the send buffer is lost, as on any wire.
                let _lost = socket.send(&returned.frame);
            }
        }
    }
    Ok(())
}
