//! A bridge on the bus, in real time: a thread for the bus, one for the cycle.

use core::fmt::Display;
use core::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use core::time::Duration;

use evolvent_bus::BusError;
use evolvent_machine::Machine;
use evolvent_path::AxisMask;
use rtrb::RingBuffer;
use thiserror::Error;

use crate::bus_side::BusSide;
use crate::ends::BusEnds;
use crate::privileges::{drop_capabilities, raise_priority};

/// Between two attempts to begin a session.
const RETRY: Duration = Duration::from_millis(500);
/// Messages that may wait in each direction.
const ROOM: usize = 4096;
/// Notices that may wait.
const ROOM_FOR_NOTICES: usize = 64;

/// How a bridge is run.
#[derive(Clone, Copy, Debug)]
pub struct BridgeSettings<'a> {
    /// The machine: name, axes, limits, priority.
    pub machine: &'a Machine,
    /// Name on the bus, where it is another than the machine's.
    pub machine_name: Option<&'a str>,
    /// iceoryx2's prefix, as of the core.
    pub prefix: Option<&'a str>,
    /// Ends by itself after so long; never if none.
    pub duration: Option<Duration>,
}

/// What is at the other end of the wire.
pub trait Hardware {
    /// What happens during a session, for people.
    type Notice: Send;
    /// Why a session did not begin, or why it ended.
    type Failure: Display + PartialEq + Send;

    /// What people call it, as in `network`.
    const NAME: &'static str;
    /// What the file that describes it has for each axis, as in `a device`.
    const ENTRY: &'static str;

    /// The axes that it drives.
    fn axes(&self) -> AxisMask;

    /// Whether it has inputs or outputs of the machine.
    fn has_signals(&self) -> bool;

    /// A notice as a sentence.
    fn text(&self, notice: Self::Notice) -> String;
}

/// What a bridge did on the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BridgeRuns {
    /// Times at which a core was found.
    pub connections: u32,
    /// Times at which a session was begun, or tried to.
    pub sessions: u64,
}

/// Why a bridge cannot run.
#[derive(Debug, Error)]
pub enum BridgeError {
    /// The bus does not fit.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Capabilities cannot be given up.
    #[error("capabilities cannot be given up: {0}")]
    Privileges(std::io::Error),
    /// Another set of axes.
    #[error(
        "the core drives the axes {core}, the {file} file has {driven}: give each axis of the machine {entry}"
    )]
    Axes {
        /// Of the core.
        core: String,
        /// Of the file that describes the hardware.
        driven: String,
        /// What that file describes: [`Hardware::NAME`].
        file: &'static str,
        /// What it has for each axis: [`Hardware::ENTRY`].
        entry: &'static str,
    },
}

/// Runs a bridge until `stop` is set or time is up. Waits for its core as long as that takes, outlives it, and finds the next
/// one. `tell` is called with what people should know.
///
/// `session` is called, in a thread with `SCHED_FIFO` and without capabilities, once a core is known and again whenever it has
/// returned. It sets the hardware up and runs its cycle until something ends it; `Ok` where it was asked to stop.
///
/// # Errors
/// The core does not fit the hardware, or rights cannot be given up.
pub fn run_bridge<H: Hardware>(
    settings: BridgeSettings<'_>,
    hardware: &H,
    stop: &AtomicBool,
    tell: impl FnMut(&str),
    mut session: impl FnMut(&mut BusEnds<'_, H::Notice>) -> Result<(), H::Failure> + Send,
) -> Result<BridgeRuns, BridgeError> {
    let (period_ns, sessions) = (AtomicU64::new(0), AtomicU64::new(0));
    let ended = AtomicBool::new(false);
    let (mut incoming_in, mut incoming) = RingBuffer::new(ROOM);
    let (mut feedback, mut feedback_out) = RingBuffer::new(ROOM);
    let (mut inputs, mut inputs_out) = RingBuffer::new(ROOM);
    let (mut notices, mut notices_out) = RingBuffer::new(ROOM_FOR_NOTICES);
    let (failures, failures_out) = std::sync::mpsc::channel::<H::Failure>();
    std::thread::scope(|scope| {
        let (period_ns, sessions, ended) = (&period_ns, &sessions, &ended);
        scope.spawn(move || {
            raise_priority(settings.machine.realtime.priority.saturating_sub(2).max(1));
            // What cannot be given up here could not be given up by the other thread either, which tells.
            let _told = drop_capabilities();
            while !ended.load(Ordering::Relaxed) {
                if period_ns.load(Ordering::Relaxed) == 0 {
                    std::thread::sleep(Duration::from_millis(5));
                    continue;
                }
                sessions.fetch_add(1, Ordering::Relaxed);
                let result = session(&mut BusEnds {
                    incoming: &mut incoming,
                    feedback: &mut feedback,
                    inputs: &mut inputs,
                    notices: &mut notices,
                    stop: ended,
                    period_ns,
                });
                if let Err(error) = result {
                    let _nobody = failures.send(error);
                    std::thread::sleep(RETRY);
                }
            }
        });
        let mut bus = BusSide {
            settings,
            hardware,
            stop,
            period_ns,
            incoming: &mut incoming_in,
            feedback: &mut feedback_out,
            inputs: &mut inputs_out,
            connections: 0,
        };
        let result = drop_capabilities()
            .map_err(BridgeError::Privileges)
            .and_then(|()| bus.serve(&mut notices_out, &failures_out, tell));
        ended.store(true, Ordering::Relaxed);
        result.map(|connections| BridgeRuns {
            connections,
            sessions: sessions.load(Ordering::Relaxed),
        })
    })
}
