//! The bridge of one network, on the bus.

use core::panic::AssertUnwindSafe;
use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;
use std::panic::catch_unwind;

use evolvent_bridge::{BridgeError, BridgeSettings, Hardware, run_bridge};
use evolvent_machine::Machine;
use evolvent_path::{AxisLetter, AxisMask};
use thiserror::Error;

use crate::clock_monitor::{ClockFigures, ClockMonitor};
use crate::cycle_times::CycleTimes;
use crate::dump::{self, DumpCounters, DumpSettings, DumpTrouble};
use crate::fault_text::fault_text_of;
use crate::network::Network;
use crate::scan::panic_text;
use crate::session::{Counters, Ends, Notice, SessionError, run_session};
use crate::socket::{InterfaceError, PacketSocket};
use crate::spindle_drive::SpindleNotice;

/// Settings of the bridge.
#[derive(Clone, Debug)]
pub struct RunSettings {
    /// The machine: name, axes, limits, priority.
    pub machine: Machine,
    /// Name on the bus, if it differs from the machine's.
    pub machine_name: Option<String>,
    /// The network.
    pub network: Network,
    /// The network interface.
    pub interface: String,
    /// iceoryx2's prefix, as for the core.
    pub prefix: Option<String>,
    /// Ends after this time; never if none.
    pub duration: Option<Duration>,
    /// Recording of the wire.
    pub dump: Option<DumpSettings>,
}

/// Counts of the bridge.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BridgeReport {
    /// Number of times that a core was found.
    pub connections: u32,
    /// Number of times that the network was brought up, or that it failed.
    pub sessions: u64,
    /// Number of times that all devices reached OP.
    pub ready: u64,
    /// Cycles of the network.
    pub cycles: u64,
    /// Frames that did not return in time.
    pub lost_frames: u64,
    /// Frames with a working counter that was too small.
    pub short_frames: u64,
    /// Recorded frames, including those that later ones have replaced.
    pub recorded_frames: u64,
    /// Frames that were not recorded because the disk was too slow.
    pub unrecorded_frames: u64,
    /// Distributed clocks; none without them, or if not all devices came to OP.
    pub clocks: Option<ClockFigures>,
}

/// Why the bridge cannot run.
#[derive(Debug, Error)]
pub enum RunError {
    /// The core does not match the network, or privileges cannot be dropped.
    #[error(transparent)]
    Bridge(#[from] BridgeError),
    /// The wire cannot be recorded.
    #[error("{file}: the wire cannot be recorded: {source}; check folder, permissions and free space")]
    Dump {
        /// The file.
        file: String,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The interface cannot be opened.
    #[error(transparent)]
    Interface(#[from] InterfaceError),
}

/// Runs until `stop` is set or the time is up. Waits for its core and its network, keeps running when either
/// ends, and connects to the next one. `tell` receives the messages for the log.
///
/// # Errors
/// The file of the recording or the interface cannot be opened, or the core does not match the network.
pub fn run(
    settings: &RunSettings,
    stop: &AtomicBool,
    tell: impl FnMut(&str),
) -> Result<BridgeReport, RunError> {
    run_measured(settings, stop, tell, None)
}

/// Like [`run`], and records the times of its cycles.
///
/// # Errors
/// As for [`run`].
pub fn run_measured(
    settings: &RunSettings,
    stop: &AtomicBool,
    mut tell: impl FnMut(&str),
    times: Option<&CycleTimes>,
) -> Result<BridgeReport, RunError> {
    let (counters, mut clocks) = (Counters::default(), ClockMonitor::new());
    let (recorded, is_over) = (DumpCounters::default(), AtomicBool::new(false));
    let dump_failed = |wanted: &DumpSettings, source| RunError::Dump {
        file: wanted.path.display().to_string(),
        source,
    };
    // Checked before the interface, which may come up later, because an unwritable path is a permanent error.
    // The last recording is kept until this one begins.
    if let Some(wanted) = &settings.dump {
        dump::check(wanted).map_err(|source| dump_failed(wanted, source))?;
    }
    let socket = PacketSocket::open(&settings.interface)?;
    let (mut sender, writer) = match &settings.dump {
        None => (None, None),
        Some(wanted) => {
            let (sender, writer) = dump::open(wanted, &settings.interface, &recorded)
                .map_err(|source| dump_failed(wanted, source))?;
            (Some(sender), Some(writer))
        }
    };
    let runs = std::thread::scope(|scope| {
        // Started before this thread drops the right to start threads.
        let writing = writer.map(|writer| scope.spawn(|| writer.run(&is_over)));
        let runs = run_bridge(settings.on_bus(), settings, stop, &mut tell, |bus| {
            let mut ends = Ends {
                bus,
                counters: &counters,
                clocks: &mut clocks,
                recorded: &recorded,
                times,
            };
            // ethercrab asserts on the replies of devices; drives then stop by their watchdogs.
            catch_unwind(AssertUnwindSafe(|| {
                let dump = sender.as_mut();
                run_session(&socket, &settings.network, &settings.machine, dump, &mut ends)
            }))
            .unwrap_or_else(|panic| {
                Err(SessionError::Library {
                    what: panic_text(panic.as_ref()),
                })
            })
        });
        is_over.store(true, Ordering::Release);
        let written = writing.map_or(Ok(()), |writing| {
            writing
                .join()
                .unwrap_or_else(|panic| Err(std::io::Error::other(panic_text(panic.as_ref()))))
        });
        if let Some(trouble) = recorded.take_trouble().filter(|_| written.is_ok()) {
            tell(&recording_text(trouble));
        }
        if let Err(error) = written {
            tell(&format!("the recording of the wire is incomplete: {error}"));
        }
        runs
    })?;
    Ok(BridgeReport {
        recorded_frames: recorded.written.load(Ordering::Relaxed),
        unrecorded_frames: recorded.lost.load(Ordering::Relaxed),
        connections: runs.connections,
        sessions: runs.sessions,
        ready: counters.ready.load(Ordering::Relaxed),
        cycles: counters.cycles.load(Ordering::Relaxed),
        lost_frames: counters.lost.load(Ordering::Relaxed),
        short_frames: counters.short.load(Ordering::Relaxed),
        clocks: clocks.figures(),
    })
}

fn recording_text(trouble: DumpTrouble) -> String {
    let error = std::io::Error::from_raw_os_error;
    match trouble {
        DumpTrouble::HalfDropped { errno } => format!(
            "the recording of the wire continues without its older half: {}; free space on its disk, or \
             record less (--dump-mib)",
            error(errno)
        ),
        DumpTrouble::Ended { errno } => format!(
            "the recording of the wire has ended: {}; the file contains what was recorded until now",
            error(errno)
        ),
    }
}

impl Hardware for RunSettings {
    type Notice = Notice;
    type Failure = SessionError;

    const NAME: &'static str = "network";
    const ENTRY: &'static str = "a device";

    fn axes(&self) -> AxisMask {
        self.network.axes_mask()
    }

    fn has_signals(&self) -> bool {
        self.network.has_signals()
    }

    fn measures_spindles(&self) -> bool {
        let mut spindles = self.network.devices.iter().filter_map(|device| device.spindle);
        spindles.any(|spindle| {
            let known = self.machine.signals.spindle(spindle.number as u32);
            known.is_some_and(|known| known.has_feedback())
        })
    }

    fn title(&self) -> String {
        let name = self.machine_name.as_ref().unwrap_or(&self.machine.name);
        format!("EtherCAT drives of {name} on {}", self.interface)
    }

    fn text(&self, notice: Notice) -> String {
        match notice {
            Notice::Operational { clocks: true } => {
                "network: all devices are in OP, drives follow their distributed clocks".to_owned()
            }
            Notice::Operational { clocks: false } => {
                "network: all devices are in OP, without distributed clocks".to_owned()
            }
            Notice::Limit(note) => note.to_string(),
            Notice::Recording(trouble) => recording_text(trouble),
            Notice::Clocks { figures } => format!("network: {}", self.clock_text(&figures)),
            Notice::Spindle { number, notice } => match notice {
                SpindleNotice::Encoder(fault) => format!("spindle {number}: {fault}"),
                SpindleNotice::DriveFault(code) => {
                    let mut devices = self.network.devices.iter();
                    let device =
                        devices.find(|device| device.spindle.is_some_and(|spindle| spindle.number == number));
                    let vendor = device.map_or(0, |device| device.vendor);
                    format!(
                        "drive of spindle {number}: fault {code:04X}h: {}",
                        fault_text_of(vendor, code)
                    )
                }
                SpindleNotice::NotOriented => format!(
                    "spindle {number}: M19 is not possible, because nothing turns it to an angle: give \
                     `orientation` at its [device.spindle] of the network file"
                ),
            },
            Notice::DriveFault { axis, code } => {
                let letter = AxisLetter::letter_of(axis);
                let mut devices = self.network.devices.iter();
                let device = devices.find(|device| device.axis.is_some_and(|listed| listed.axis == axis));
                let vendor = device.map_or(0, |device| device.vendor);
                format!(
                    "drive of {letter}: fault {code:04X}h: {}",
                    fault_text_of(vendor, code)
                )
            }
            Notice::Gantry { axis, fault } => format!("gantry of {}: {fault}", AxisLetter::letter_of(axis)),
            Notice::Squared { axis, by } => format!(
                "gantry of {}: homed by both switches; the second drive was {by:.3} from where it is on a \
                 square beam, and is moved there",
                AxisLetter::letter_of(axis)
            ),
            Notice::Homed { axis, found: true } => {
                format!(
                    "drive of {}: machine zero found; when all drives have found it, switch power off and on",
                    AxisLetter::letter_of(axis)
                )
            }
            Notice::Homed { axis, found: false } => format!(
                "drive of {}: homing failed: all drives stop; check its switch, method and timeout_s, then \
                 switch power off and on",
                AxisLetter::letter_of(axis)
            ),
            Notice::Emergency {
                device,
                code,
                register,
            } => {
                let vendor = self.network.devices.get(device).map_or(0, |device| device.vendor);
                format!(
                    "network: `{}` has sent an emergency message: {code:04X}h: {} (error register \
                     {register:02X}h)",
                    self.name_of(device),
                    fault_text_of(vendor, code)
                )
            }
            Notice::DeviceLost { device } => {
                let name = self.name_of(device);
                format!("network: `{name}` does not reply, or has left OP: all drives stop")
            }
            Notice::DeviceSilent { device } => {
                let name = self.name_of(device);
                format!("network: `{name}` is in OP and does not exchange process data: all drives stop")
            }
            Notice::Short { found, expected } => {
                format!("network: working counter {found} instead of {expected}: all drives stop")
            }
        }
    }
}

impl RunSettings {
    /// The name of a device in the network file.
    #[must_use]
    pub fn name_of(&self, device: usize) -> &str {
        let listed = self.network.devices.get(device);
        listed.map_or("?", |device| device.name.as_str())
    }

    /// The figures of the distributed clocks as a sentence.
    #[must_use]
    pub fn clock_text(&self, figures: &ClockFigures) -> String {
        let us = |ns: u64| ns as f64 * 1e-3;
        let difference = match figures.max_difference_device {
            Some(device) => format!(
                "clocks of devices within {} ns of the reference, `{}` furthest, now {} ns",
                figures.max_difference_ns.unsigned_abs(),
                self.name_of(device),
                figures.last_difference_ns.unsigned_abs()
            ),
            None => "no clock of a device was read".to_owned(),
        };
        let drift = figures.drift_ppm.map_or_else(
            || "the drift of this computer's clock is not known yet".to_owned(),
            |ppm| format!("this computer's clock {ppm:+.1} ppm against the reference"),
        );
        format!(
            "{difference}; frames {:+.1} us from the middle between two SYNC0, jitter {:.1} us (50 %), \
             {:.1} us (99.9 %), {:.1} us (maximum); {drift}",
            figures.shift_ns as f64 * 1e-3,
            us(figures.jitter_p50_ns),
            us(figures.jitter_p999_ns),
            us(figures.jitter_max_ns),
        )
    }

    fn on_bus(&self) -> BridgeSettings<'_> {
        BridgeSettings {
            machine: &self.machine,
            machine_name: self.machine_name.as_deref(),
            prefix: self.prefix.as_deref(),
            duration: self.duration,
        }
    }
}
