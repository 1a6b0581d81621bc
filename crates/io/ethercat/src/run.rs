//! The bridge on the bus, in real time: a thread for the bus, one for the cycle.

use core::panic::AssertUnwindSafe;
use core::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use core::time::Duration;
use std::panic::catch_unwind;

use evolvent_bus::{
    BusError, ClientBus, ClientConfig, Feedback, FeedbackSender, InputSender, MachineInputs, OutputReader,
    ReceiveError, SetpointReader,
};
use evolvent_machine::Machine;
use evolvent_path::{AxisLetter, AxisMask};
use rtrb::{Consumer, Producer, RingBuffer};
use thiserror::Error;

use crate::cycle_times::CycleTimes;
use crate::fault_text::fault_text;
use crate::network::Network;
use crate::privileges::{drop_capabilities, raise_priority};
use crate::scan::panic_text;
use crate::session::{Counters, Ends, Incoming, Notice, SessionError, run_session};
use crate::socket::PacketSocket;
use crate::time_driver::monotonic_ns;

/// Without a setpoint for so long the connection to the core is made anew, ns.
const RECONNECT_NS: u64 = 1_000_000_000;
/// How long one attempt to find the core may take.
const ATTEMPT: Duration = Duration::from_millis(5);
/// Between two attempts to bring the network up.
const RETRY: Duration = Duration::from_millis(500);
/// Setpoints, feedback and notices that may wait.
const ROOM: usize = 4096;

/// How the bridge is run.
#[derive(Clone, Debug)]
pub struct RunSettings {
    /// The machine: name, axes, limits, priority.
    pub machine: Machine,
    /// Name on the bus, where it is another than the machine's.
    pub machine_name: Option<String>,
    /// The network.
    pub network: Network,
    /// The network interface.
    pub interface: String,
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
    /// Times at which the network was brought up, or tried to.
    pub sessions: u64,
    /// Cycles of the network.
    pub cycles: u64,
    /// Frames that did not come back in time.
    pub lost_frames: u64,
    /// Frames with a working counter that was too small.
    pub short_frames: u64,
}

/// Why the bridge cannot run.
#[derive(Debug, Error)]
pub enum RunError {
    /// The bus does not fit.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The interface cannot be opened.
    #[error(
        "the network interface {interface} cannot be opened: {source}; raw sockets need CAP_NET_RAW, and the interface must be up"
    )]
    Interface {
        /// Its name.
        interface: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// Capabilities cannot be given up.
    #[error("capabilities cannot be given up: {0}")]
    Privileges(std::io::Error),
    /// Another set of axes.
    #[error(
        "the core drives the axes {core}, the network file has {network}: give each axis of the machine a device"
    )]
    Axes {
        /// Of the core.
        core: String,
        /// Of the network.
        network: String,
    },
}

struct Ports {
    setpoints: SetpointReader,
    feedback: FeedbackSender,
    /// Where the network has signals.
    signals: Option<(OutputReader, InputSender)>,
    /// Ports live in the client's node.
    _client: ClientBus,
}

/// Runs until `stop` is set or time is up. Waits for its core and its network as long as that takes, outlives both, and finds the
/// next ones. `tell` is called with what people should know.
///
/// # Errors
/// The interface cannot be opened, or the core does not fit the network.
pub fn run(
    settings: &RunSettings,
    stop: &AtomicBool,
    tell: impl FnMut(&str),
) -> Result<BridgeReport, RunError> {
    run_measured(settings, stop, tell, None)
}

/// As [`run`], and takes the times of its cycles.
///
/// # Errors
/// As there.
pub fn run_measured(
    settings: &RunSettings,
    stop: &AtomicBool,
    tell: impl FnMut(&str),
    times: Option<&CycleTimes>,
) -> Result<BridgeReport, RunError> {
    let interface = settings.interface.clone();
    let socket =
        PacketSocket::open(&interface).map_err(|source| RunError::Interface { interface, source })?;
    let (period_ns, counters, sessions) = (AtomicU64::new(0), Counters::default(), AtomicU64::new(0));
    let ended = AtomicBool::new(false);
    let (mut setpoints_in, mut setpoints) = RingBuffer::new(ROOM);
    let (mut feedback, mut feedback_out) = RingBuffer::new(ROOM);
    let (mut inputs, mut inputs_out) = RingBuffer::new(ROOM);
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
                let mut ends = Ends {
                    setpoints: &mut setpoints,
                    feedback: &mut feedback,
                    inputs: &mut inputs,
                    notices: &mut notices,
                    counters: &counters,
                    times,
                    stop: &ended,
                    period_ns: &period_ns,
                };
                // ethercrab asserts what devices answer; drives stop by their watchdogs then.
                let ended = catch_unwind(AssertUnwindSafe(|| {
                    run_session(&socket, &settings.network, &settings.machine, &mut ends)
                }))
                .unwrap_or_else(|panic| {
                    Err(SessionError::Library {
                        what: panic_text(panic.as_ref()),
                    })
                });
                if let Err(error) = ended {
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
            lost_frames: counters.lost.load(Ordering::Relaxed),
            short_frames: counters.short.load(Ordering::Relaxed),
        })
    })
}

/// The thread that owns the ports.
struct BusSide<'a> {
    settings: &'a RunSettings,
    stop: &'a AtomicBool,
    period_ns: &'a AtomicU64,
    setpoints: &'a mut Producer<Incoming>,
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
            let is_broken = match ports.as_mut() {
                Some(ports) => self.pass_on(ports, &mut heard_ns),
                None => {
                    // The next core shall not hear what was meant for the last.
                    while self.feedback.pop().is_ok() || self.inputs.pop().is_ok() {}
                    false
                }
            };
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
                    tell(&format!("network: {failure}"));
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
        while let Ok(feedback) = self.feedback.pop() {
            // What does not leave is replaced by the next.
            let _lost = ports.feedback.send(&feedback);
        }
        if let Some((outputs, inputs)) = &mut ports.signals {
            // What comes damaged is followed by a message that is complete.
            while let Ok(Some(message)) = outputs.receive() {
                let _full = self.setpoints.push(Incoming::Outputs(message));
            }
            while let Ok(message) = self.inputs.pop() {
                let _lost = inputs.send(&message);
            }
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
            signals: if self.settings.network.has_signals() {
                Some((client.outputs()?, client.input_sender()?))
            } else {
                None
            },
            _client: client,
        };
        Ok((ports, letters, period_ns))
    }

    fn check_axes(&self, letters: &str) -> Result<(), RunError> {
        let core: AxisMask = letters.chars().filter_map(AxisLetter::from_letter).collect();
        let driven = self.settings.network.axes_mask();
        if core == driven {
            return Ok(());
        }
        let network = driven.axes().map(|axis| AxisLetter::ALL[axis].letter()).collect();
        Err(RunError::Axes {
            core: letters.to_owned(),
            network,
        })
    }

    fn text(&self, notice: Notice) -> String {
        match notice {
            Notice::Operational { clocks: true } => {
                "network: all devices are in OP, drives follow their distributed clocks".to_owned()
            }
            Notice::Operational { clocks: false } => {
                "network: all devices are in OP, without distributed clocks".to_owned()
            }
            Notice::DriveFault { axis, code } => {
                let letter = letter(axis);
                format!("drive of {letter}: fault {code:04X}h: {}", fault_text(code))
            }
            Notice::Apart { axis, by } => format!(
                "gantry of {}: the second drive is {by:.3} from the first, more than max_difference: all drives stop; find what holds it, then make the beam square by hand or home again",
                letter(axis)
            ),
            Notice::Homed { axis, found: true } => {
                format!(
                    "drive of {}: machine zero found; when all have, switch power off and on",
                    letter(axis)
                )
            }
            Notice::Homed { axis, found: false } => format!(
                "drive of {}: homing failed: all drives stop; check its switch, method and timeout_s, then switch power off and on",
                letter(axis)
            ),
            Notice::DeviceLost { device } => {
                let name = self
                    .settings
                    .network
                    .devices
                    .get(device)
                    .map_or("?", |device| device.name.as_str());
                format!("network: `{name}` does not answer, or has left OP: all drives stop")
            }
            Notice::Short { found, expected } => {
                format!("network: working counter {found} instead of {expected}: all drives stop")
            }
        }
    }
}

fn letter(axis: usize) -> char {
    AxisLetter::ALL
        .iter()
        .find(|letter| letter.index() == axis)
        .map_or('?', |letter| letter.letter())
}
