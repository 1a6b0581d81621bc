//! A bridge on the bus, in real time: a thread for the bus, one for the cycle.

use core::fmt::Display;
use core::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use core::time::Duration;
use std::path::PathBuf;

use evolvent_bus::{BusError, bus_folders, writable_folders};
use evolvent_machine::Machine;
use evolvent_path::AxisMask;
use rtrb::RingBuffer;
use thiserror::Error;

use crate::bus_side::BusSide;
use crate::confinement::{ThreadRole, confine};
use crate::ends::BusEnds;
use crate::privileges::{lock_memory, raise_priority};

/// Interval between two attempts to start a session.
const RETRY: Duration = Duration::from_millis(500);
/// Capacity for messages in each direction.
const CAPACITY: usize = 4096;
/// Capacity for notices.
const ROOM_FOR_NOTICES: usize = 64;

/// Settings of a bridge.
#[derive(Clone, Copy, Debug)]
pub struct BridgeSettings<'a> {
    /// The machine: name, axes, limits, priority.
    pub machine: &'a Machine,
    /// Name on the bus, if it differs from the machine's.
    pub machine_name: Option<&'a str>,
    /// iceoryx2's prefix, as for the core.
    pub prefix: Option<&'a str>,
    /// Ends after this time; never if none.
    pub duration: Option<Duration>,
}

/// The hardware of a bridge.
pub trait Hardware {
    /// An event of a session, for the log.
    type Notice: Send;
    /// Why a session did not start, or why it ended.
    type Failure: Display + PartialEq + Send;

    /// Its name in messages, as in `network`.
    const NAME: &'static str;
    /// What its file has for each axis, as in `a device`.
    const ENTRY: &'static str;
    /// Whether sessions open UDP sockets. Otherwise all their sockets are open before the bridge runs.
    const OPENS_UDP: bool = false;

    /// The axes that it drives.
    fn axes(&self) -> AxisMask;

    /// Whether it has inputs or outputs of the machine.
    fn has_signals(&self) -> bool;

    /// Whether it measures a spindle of the machine.
    fn measures_spindles(&self) -> bool;

    /// The kind of bridge and its machine, for the log.
    fn title(&self) -> String {
        Self::NAME.to_owned()
    }

    /// A notice as a sentence.
    fn text(&self, notice: Self::Notice) -> String;
}

/// Counts of a bridge on the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BridgeRuns {
    /// Number of times that a core was found.
    pub connections: u32,
    /// Number of times that a session was started, or that the start failed.
    pub sessions: u64,
}

/// Why a bridge cannot run.
#[derive(Debug, Error)]
pub enum BridgeError {
    /// The bus does not match.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Capabilities cannot be dropped.
    #[error("capabilities cannot be dropped: {0}")]
    Privileges(std::io::Error),
    /// The bus has a new folder, to which the bridge has no access any more.
    #[error(
        "the bus's folder {folder} was created, or created again, after the bridge had dropped its rights to \
         other folders: restart the bridge"
    )]
    Folder {
        /// The folder.
        folder: String,
    },
    /// Core and hardware have different axes.
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

/// Runs a bridge until `stop` is set or the time is up. Waits for its core, keeps running when the core ends,
/// and connects to the next one. `tell` receives the messages for the log.
///
/// The calling thread, which serves the bus, permanently gives up all capabilities, all files except those of
/// the bus, and all system calls that it does not need: call this on a thread that does little else
/// afterwards. Rights that this kernel cannot remove are reported.
///
/// Both threads run with `SCHED_FIFO`, below the core's priority, and memory is locked if the machine file
/// says so, as far as the system permits. Missing permissions are reported.
///
/// `session` is called, in a thread with even fewer rights, once a core is known and again whenever it has
/// returned. It sets up the hardware and runs its cycle until the session ends; it returns `Ok` if a stop was
/// requested.
///
/// # Errors
/// The core does not match the hardware, or privileges cannot be dropped.
pub fn run_bridge<H: Hardware>(
    settings: BridgeSettings<'_>,
    hardware: &H,
    stop: &AtomicBool,
    mut tell: impl FnMut(&str),
    mut session: impl FnMut(&mut BusEnds<'_, H::Notice>) -> Result<(), H::Failure> + Send,
) -> Result<BridgeRuns, BridgeError> {
    let (period_ns, sessions) = (AtomicU64::new(0), AtomicU64::new(0));
    let ended = AtomicBool::new(false);
    let (mut incoming_in, mut incoming) = RingBuffer::new(CAPACITY);
    let (mut feedback, mut feedback_out) = RingBuffer::new(CAPACITY);
    let (mut inputs, mut inputs_out) = RingBuffer::new(CAPACITY);
    let (mut spindles, mut spindles_out) = RingBuffer::new(CAPACITY);
    let (mut notices, mut notices_out) = RingBuffer::new(ROOM_FOR_NOTICES);
    let (failures, failures_out) = std::sync::mpsc::channel::<H::Failure>();
    let (remarks, remarks_out) = std::sync::mpsc::channel::<String>();
    let writable = writable_folders(settings.prefix)?;
    let folders = bus_folders(settings.prefix)?;
    let realtime = &settings.machine.realtime;
    // Below the cycle and the publisher of the core, which must run first.
    let priority = realtime.priority.saturating_sub(2).max(1);
    // Before the threads give up their rights: locked memory stays locked.
    let mut own_remarks: Vec<String> = Vec::new();
    if realtime.lock_memory
        && let Err(note) = lock_memory()
    {
        own_remarks.push(format!("note: {note}"));
    }
    std::thread::scope(|scope| {
        let (period_ns, sessions, ended) = (&period_ns, &sessions, &ended);
        scope.spawn(move || {
            // If this thread cannot drop capabilities, neither can the other, which reports it.
            let role = ThreadRole::Session {
                opens_udp: H::OPENS_UDP,
            };
            for remark in enter_role(priority, role, &[]).unwrap_or_default() {
                let _nobody = remarks.send(remark);
            }
            drop(remarks);
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
                    spindles: &mut spindles,
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
            spindles: &mut spindles_out,
            folders,
            connections: 0,
        };
        // Setpoints pass through this thread: without its priority, other work on the computer would stop the
        // machine.
        let result = enter_role(priority, ThreadRole::Bus, &writable)
            .map_err(BridgeError::Privileges)
            .and_then(|remarks| {
                own_remarks.extend(remarks);
                for remark in remarks_out {
                    if !own_remarks.contains(&remark) {
                        own_remarks.push(remark);
                    }
                }
                for remark in own_remarks {
                    tell(&remark);
                }
                bus.serve(&mut notices_out, &failures_out, tell)
            });
        ended.store(true, Ordering::Relaxed);
        result.map(|connections| BridgeRuns {
            connections,
            sessions: sessions.load(Ordering::Relaxed),
        })
    })
}

/// Gives the calling thread its priority, then removes its rights. Returns the permissions that the system
/// does not grant, and the rights that it cannot remove.
fn enter_role(priority: u8, role: ThreadRole, folders: &[PathBuf]) -> std::io::Result<Vec<String>> {
    let mut remarks = Vec::new();
    if let Err(note) = raise_priority(priority) {
        remarks.push(format!("note: {note}"));
    }
    let gaps = confine(role, folders)?;
    remarks.extend(gaps.into_iter().map(|gap| format!("rights: {gap}")));
    Ok(remarks)
}
