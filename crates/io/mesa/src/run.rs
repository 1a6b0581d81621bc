//! The bridge on the bus, in real time: a thread for the bus, one for the cycle.

use core::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use core::time::Duration;

use evolvent_bus::{
    BusError, ClientBus, ClientConfig, Feedback, FeedbackSender, InputSender, MachineInputs, MachineOutputs,
    OutputReader, ReceiveError, SetpointReader,
};
use evolvent_machine::Machine;
use evolvent_path::{AxisLetter, AxisMask};
use rtrb::{Consumer, Producer, RingBuffer};
use thiserror::Error;

use crate::axis::{COMMUNICATION, EXTERNAL};
use crate::board_file::BoardSettings;
use crate::clock::monotonic_ns;
use crate::link::Link;
use crate::privileges::{drop_capabilities, raise_priority};
use crate::session::{Counters, Ends, Incoming, Notice, SessionError, run_session};

/// Without a setpoint for so long the connection to the core is made anew, ns.
const RECONNECT_NS: u64 = 1_000_000_000;
/// How long one attempt to find the core may take.
const ATTEMPT: Duration = Duration::from_millis(5);
/// Between two attempts to set the board up.
const RETRY: Duration = Duration::from_millis(500);
/// Setpoints, feedback and notices that may wait.
const ROOM: usize = 4096;
/// Messages of outputs and inputs that may wait.
const ROOM_FOR_SIGNALS: usize = 256;

/// How the bridge is run.
#[derive(Clone, Debug)]
pub struct RunSettings {
    /// The machine: name, axes, limits, priority.
    pub machine: Machine,
    /// Name on the bus, where it is another than the machine's.
    pub machine_name: Option<String>,
    /// The board.
    pub board: BoardSettings,
    /// iceoryx2's prefix, as of the core.
    pub prefix: Option<String>,
    /// Ends by itself after so long; never if none.
    pub duration: Option<Duration>,
}

/// What the bridge did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BridgeReport {
    /// Times at which a core was found.
    pub connections: u32,
    /// Times at which the board was set up, or tried to.
    pub sessions: u64,
    /// Cycles.
    pub cycles: u64,
    /// Replies that did not come in time.
    pub lost_replies: u64,
    /// Writes that did not reach the board.
    pub lost_writes: u64,
    /// Replies that came too late, twice, or cut short.
    pub stale_replies: u64,
}

/// Why the bridge cannot run.
#[derive(Debug, Error)]
pub enum RunError {
    /// The bus does not fit.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// Capabilities cannot be given up.
    #[error("capabilities cannot be given up: {0}")]
    Privileges(std::io::Error),
    /// Another set of axes.
    #[error(
        "the core drives the axes {core}, the board file has {board}: give each axis of the machine an entry"
    )]
    Axes {
        /// Of the core.
        core: String,
        /// Of the board file.
        board: String,
    },
}

struct Ports {
    setpoints: SetpointReader,
    feedback: FeedbackSender,
    outputs: OutputReader,
    inputs: InputSender,
    /// Ports live in the client's node.
    _client: ClientBus,
}

/// Runs until `stop` is set or time is up. Waits for its core and its board as long as that takes, outlives both, and finds the
/// next ones. `tell` is called with what people should know.
///
/// # Errors
/// The core does not fit the board file.
pub fn run(
    settings: &RunSettings,
    stop: &AtomicBool,
    tell: impl FnMut(&str),
) -> Result<BridgeReport, RunError> {
    run_measured(settings, stop, tell, None)
}

/// As [`run`]; `measure` is called by the cycle with its own work in ns, without sleep and without the wait for the reply.
///
/// # Errors
/// As there.
pub fn run_measured(
    settings: &RunSettings,
    stop: &AtomicBool,
    tell: impl FnMut(&str),
    mut measure: Option<&mut (dyn FnMut(u64) + Send)>,
) -> Result<BridgeReport, RunError> {
    let (period_ns, counters, sessions) = (AtomicU64::new(0), Counters::default(), AtomicU64::new(0));
    let ended = AtomicBool::new(false);
    let (mut setpoints_in, mut setpoints) = RingBuffer::new(ROOM);
    let (mut outputs_in, mut outputs) = RingBuffer::new(ROOM_FOR_SIGNALS);
    let (mut feedback, mut feedback_out) = RingBuffer::new(ROOM);
    let (mut inputs, mut inputs_out) = RingBuffer::new(ROOM_FOR_SIGNALS);
    let (mut notices, mut notices_out) = RingBuffer::new(64);
    let (failures, failures_out) = std::sync::mpsc::channel::<SessionError>();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            raise_priority(settings.machine.realtime.priority.saturating_sub(2).max(1));
            // What cannot be given up here could not be given up by the other thread either, which tells.
            let _told = drop_capabilities();
            while !ended.load(Ordering::Relaxed) {
                if period_ns.load(Ordering::Relaxed) == 0 {
                    std::thread::sleep(Duration::from_millis(5));
                    continue;
                }
                sessions.fetch_add(1, Ordering::Relaxed);
                let result = Link::open(settings.board.address)
                    .and_then(|link| link.explore().map(|board| (link, board)))
                    .map_err(SessionError::from)
                    .and_then(|(link, board)| {
                        let mut ends = Ends {
                            setpoints: &mut setpoints,
                            outputs: &mut outputs,
                            feedback: &mut feedback,
                            inputs: &mut inputs,
                            notices: &mut notices,
                            counters: &counters,
                            stop: &ended,
                            period_ns: &period_ns,
                            measure: match &mut measure {
                                Some(measure) => Some(&mut **measure),
                                None => None,
                            },
                        };
                        run_session(&link, &board, &settings.board, &settings.machine, &mut ends)
                    });
                if let Err(error) = result {
                    let _nobody = failures.send(error);
                    std::thread::sleep(RETRY);
                }
            }
        });
        let mut bus = BusSide {
            settings,
            stop,
            period_ns: &period_ns,
            setpoints: &mut setpoints_in,
            outputs: &mut outputs_in,
            feedback: &mut feedback_out,
            inputs: &mut inputs_out,
            connections: 0,
        };
        let result = drop_capabilities()
            .map_err(RunError::Privileges)
            .and_then(|()| bus.serve(&mut notices_out, &failures_out, tell));
        ended.store(true, Ordering::Relaxed);
        result.map(|connections| BridgeReport {
            connections,
            sessions: sessions.load(Ordering::Relaxed),
            cycles: counters.cycles.load(Ordering::Relaxed),
            lost_replies: counters.lost.load(Ordering::Relaxed),
            lost_writes: counters.unheard.load(Ordering::Relaxed),
            stale_replies: counters.stale.load(Ordering::Relaxed),
        })
    })
}

/// The thread that owns the ports.
struct BusSide<'a> {
    settings: &'a RunSettings,
    stop: &'a AtomicBool,
    period_ns: &'a AtomicU64,
    setpoints: &'a mut Producer<Incoming>,
    outputs: &'a mut Producer<MachineOutputs>,
    feedback: &'a mut Consumer<Feedback>,
    inputs: &'a mut Consumer<MachineInputs>,
    connections: u32,
}

impl BusSide<'_> {
    fn serve(
        &mut self,
        notices: &mut Consumer<Notice>,
        failures: &std::sync::mpsc::Receiver<SessionError>,
        mut tell: impl FnMut(&str),
    ) -> Result<u32, RunError> {
        let begin_ns = monotonic_ns();
        let over = |stop: &AtomicBool, duration: Option<Duration>| {
            let passed = Duration::from_nanos(monotonic_ns() - begin_ns);
            stop.load(Ordering::Relaxed) || duration.is_some_and(|duration| passed >= duration)
        };
        let mut ports: Option<Ports> = None;
        let (mut heard_ns, mut last_failure) = (begin_ns, None);
        while !over(self.stop, self.settings.duration) {
            if ports.is_none() {
                match self.connect() {
                    Ok((found, letters, period_ns)) => {
                        self.check_axes(&letters)?;
                        self.connections += 1;
                        heard_ns = monotonic_ns();
                        tell(&format!("core found: axes {letters}, {period_ns} ns"));
                        self.period_ns.store(period_ns, Ordering::Relaxed);
                        ports = Some(found);
                    }
                    Err(BusError::NoCore { .. } | BusError::Service { .. } | BusError::NoPlace { .. }) => {}
                    Err(error) => return Err(error.into()),
                }
            }
            let is_broken = ports
                .as_mut()
                .is_some_and(|ports| self.pass_on(ports, &mut heard_ns));
            if is_broken || ports.is_some() && monotonic_ns().saturating_sub(heard_ns) > RECONNECT_NS {
                ports = None;
            }
            while let Ok(notice) = notices.pop() {
                last_failure = None;
                tell(&self.text(notice));
            }
            while let Ok(failure) = failures.try_recv() {
                // The same again and again is told once.
                if last_failure.as_ref() != Some(&failure) {
                    tell(&format!("board: {failure}"));
                }
                last_failure = Some(failure);
            }
            let period_ns = self.period_ns.load(Ordering::Relaxed).max(1);
            let nap_ns = if ports.is_some() {
                (period_ns / 5).clamp(20_000, 200_000)
            } else {
                2_000_000
            };
            std::thread::sleep(Duration::from_nanos(nap_ns));
        }
        Ok(self.connections)
    }

    /// Setpoints to the cycle, feedback to the bus; whether the connection is broken.
    fn pass_on(&mut self, ports: &mut Ports, heard_ns: &mut u64) -> bool {
        loop {
            let incoming = match ports.setpoints.receive() {
                Ok(None) => break,
                Ok(Some(setpoint)) => Incoming::Setpoint(setpoint),
                Err(ReceiveError::Version { .. }) => Incoming::OtherVersion,
                Err(ReceiveError::Broken { .. }) => return true,
            };
            *heard_ns = monotonic_ns();
            // Full only while no session runs; what is old then is of no use.
            let _full = self.setpoints.push(incoming);
        }
        // What comes damaged is followed by a message that is complete.
        while let Ok(Some(message)) = ports.outputs.receive() {
            let _full = self.outputs.push(message);
        }
        // What does not leave is replaced by the next.
        while let Ok(feedback) = self.feedback.pop() {
            let _lost = ports.feedback.send(&feedback);
        }
        while let Ok(inputs) = self.inputs.pop() {
            let _lost = ports.inputs.send(&inputs);
        }
        false
    }

    fn connect(&self) -> Result<(Ports, String, u64), BusError> {
        let name = self
            .settings
            .machine_name
            .as_ref()
            .unwrap_or(&self.settings.machine.name);
        let mut config = ClientConfig::new(name);
        config.prefix.clone_from(&self.settings.prefix);
        config.wait = ATTEMPT;
        let client = ClientBus::open(&config)?;
        let (letters, period_ns) = (client.axes().to_owned(), client.period_ns());
        let ports = Ports {
            setpoints: client.bridge_setpoints()?,
            feedback: client.feedback_sender()?,
            outputs: client.outputs()?,
            inputs: client.input_sender()?,
            _client: client,
        };
        Ok((ports, letters, period_ns))
    }

    fn check_axes(&self, letters: &str) -> Result<(), RunError> {
        let core: AxisMask = letters.chars().filter_map(AxisLetter::from_letter).collect();
        let driven = self.settings.board.axes_mask();
        if core == driven {
            return Ok(());
        }
        let board = driven.axes().map(|axis| AxisLetter::ALL[axis].letter()).collect();
        Err(RunError::Axes {
            core: letters.to_owned(),
            board,
        })
    }

    fn text(&self, notice: Notice) -> String {
        match notice {
            Notice::Operational => format!("board at {}: set up", self.settings.board.address),
            Notice::DriveFault { axis, code } => {
                let letter = AxisLetter::ALL
                    .iter()
                    .find(|letter| letter.index() == axis)
                    .map_or('?', |letter| letter.letter());
                let what = match code {
                    EXTERNAL => "its drive reports a fault at the board's input",
                    COMMUNICATION => "the board does not answer, or cannot be trusted",
                    _ => "fault",
                };
                format!("{letter}: {code:04X}h: {what}")
            }
        }
    }
}
