//! The bridge between one board and the bus.

use core::sync::atomic::{AtomicBool, Ordering};
use core::time::Duration;

use evolvent_bridge::{BridgeError, BridgeSettings, Hardware, run_bridge};
use evolvent_machine::Machine;
use evolvent_path::{AxisLetter, AxisMask};

use crate::axis::{APART, COMMUNICATION, EXTERNAL};
use crate::board_settings::BoardSettings;
use crate::link::Link;
use crate::session::{Counters, Ends, Notice, SessionError, run_session};
use crate::spindle::SpindleNotice;

/// Options of the bridge.
#[derive(Clone, Debug)]
pub struct RunSettings {
    /// The machine: name, axes, limits, priority.
    pub machine: Machine,
    /// Name on the bus, if it differs from that of the machine.
    pub machine_name: Option<String>,
    /// The board.
    pub board: BoardSettings,
    /// Prefix of iceoryx2, the same as that of the core.
    pub prefix: Option<String>,
    /// Run time; `None` runs until stopped.
    pub duration: Option<Duration>,
}

/// Counters of a bridge run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BridgeReport {
    /// Number of connections to a core.
    pub connections: u32,
    /// Number of attempts to set the board up.
    pub sessions: u64,
    /// Number of times that it was set up.
    pub ready: u64,
    /// Cycles.
    pub cycles: u64,
    /// Replies that were late or lost.
    pub lost_replies: u64,
    /// Writes that did not reach the board.
    pub lost_writes: u64,
    /// Replies that were too late, duplicate or truncated.
    pub stale_replies: u64,
}

/// Runs until `stop` is set or the run time is over. Waits for its core and its board without a time limit,
/// and reconnects when either of them restarts. `tell` receives the notes for the user.
///
/// # Errors
/// The core does not fit the board file.
pub fn run(
    settings: &RunSettings,
    stop: &AtomicBool,
    tell: impl FnMut(&str),
) -> Result<BridgeReport, BridgeError> {
    run_measured(settings, stop, tell, None)
}

/// As [`run`]; `measure` receives the computing time of each cycle in ns, without sleep and without the wait
/// for the reply.
///
/// # Errors
/// As [`run`].
pub fn run_measured(
    settings: &RunSettings,
    stop: &AtomicBool,
    tell: impl FnMut(&str),
    mut measure: Option<&mut (dyn FnMut(u64) + Send)>,
) -> Result<BridgeReport, BridgeError> {
    let counters = Counters::default();
    let runs = run_bridge(settings.on_bus(), settings, stop, tell, |bus| {
        let link = Link::open(settings.board.address)?;
        let board = link.explore()?;
        let mut ends = Ends {
            bus,
            counters: &counters,
            measure: match &mut measure {
                Some(measure) => Some(&mut **measure),
                None => None,
            },
        };
        run_session(&link, &board, &settings.board, &settings.machine, &mut ends)
    })?;
    Ok(BridgeReport {
        connections: runs.connections,
        sessions: runs.sessions,
        ready: counters.ready.load(Ordering::Relaxed),
        cycles: counters.cycles.load(Ordering::Relaxed),
        lost_replies: counters.lost.load(Ordering::Relaxed),
        lost_writes: counters.unheard.load(Ordering::Relaxed),
        stale_replies: counters.stale.load(Ordering::Relaxed),
    })
}

impl Hardware for RunSettings {
    type Notice = Notice;
    type Failure = SessionError;

    const NAME: &'static str = "board";
    const ENTRY: &'static str = "an entry";
    const OPENS_UDP: bool = true;

    fn axes(&self) -> AxisMask {
        self.board.axes_mask()
    }

    fn has_signals(&self) -> bool {
        true
    }

    fn measures_spindles(&self) -> bool {
        self.board.spindles.iter().any(|spindle| {
            let known = self.machine.signals.spindle(spindle.number as u32);
            spindle.angle.is_some() && known.is_some_and(|known| known.has_feedback())
        })
    }

    fn title(&self) -> String {
        let name = self.machine_name.as_ref().unwrap_or(&self.machine.name);
        format!("Mesa board of {name} at {}", self.board.address)
    }

    fn text(&self, notice: Notice) -> String {
        match notice {
            Notice::Spindle { number, notice } => match notice {
                SpindleNotice::Encoder(fault) => format!("spindle {number}: {fault}"),
                SpindleNotice::DriveFault => {
                    format!("spindle {number}: its drive reports a fault at the board's input")
                }
                SpindleNotice::NotOriented(None) => format!(
                    "spindle {number}: M19 is not possible, because nothing turns it to an angle: give \
                     `orientation`, or `orient` and `oriented`, at its [[spindle]] of the board file"
                ),
                SpindleNotice::NotOriented(Some(angle_deg)) => format!(
                    "spindle {number}: M19 is possible at R{angle_deg} only, the angle of its drive \
                     (oriented_deg)"
                ),
            },
            Notice::Operational => format!("board at {}: set up", self.board.address),
            Notice::Gantry { axis, fault } => format!("gantry of {}: {fault}", AxisLetter::letter_of(axis)),
            Notice::Squared { axis, by } => format!(
                "gantry of {}: homed by both switches; the second drive was {by:.3} from where it is on a \
                 square beam, and is moved there",
                AxisLetter::letter_of(axis)
            ),
            Notice::DriveFault {
                axis,
                is_second,
                code,
            } => {
                let what = match code {
                    APART => "it stops with the other drive of its gantry",
                    EXTERNAL => "its drive reports a fault at the board's input",
                    COMMUNICATION => "the board does not reply, or its data are implausible",
                    _ => "fault",
                };
                let second = if is_second { ", second drive" } else { "" };
                format!("{}{second}: {code:04X}h: {what}", AxisLetter::letter_of(axis))
            }
        }
    }
}

impl RunSettings {
    fn on_bus(&self) -> BridgeSettings<'_> {
        BridgeSettings {
            machine: &self.machine,
            machine_name: self.machine_name.as_deref(),
            prefix: self.prefix.as_deref(),
            duration: self.duration,
        }
    }
}
