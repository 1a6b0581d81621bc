//! The bridge on the bus, in real time.

use core::time::Duration;
use std::sync::atomic::{AtomicBool, Ordering};

use evolvent_bus::{
    AXES, BusError, ClientBus, ClientConfig, FeedbackSender, InputSender, Load, LoadSender, OutputReader,
    ReceiveError, Setpoint, SetpointReader, SpindleSender,
};
use evolvent_drive::{OutputFollower, SettingsError};
use thiserror::Error;

use crate::bridge::SimBridge;
use crate::clock::{DriveClock, monotonic_ns};
use crate::event::{FollowWatch, SimEvent};
use crate::input_messages::{InputMessages, Signalling};
use crate::probe::{ProbeSettings, SimProbe};
use crate::settings::SimSettings;
use crate::spindle::{SimSpindle, SpindleSimulation};

/// Time without a setpoint after which the bridge reconnects: another core may have started.
const RECONNECT_NS: u64 = 1_000_000_000;
/// Time limit of one attempt to find the core.
const ATTEMPT: Duration = Duration::from_millis(5);
/// Delay up to which a late wake-up catches up with the ticks, ns; older ticks are skipped.
const CATCH_UP_NS: u64 = 200_000_000;
/// Kind of a load that is a force.
const FORCE_N: u32 = 1;
/// Maximum sleep, ns.
const POLL_INTERVAL_NS: u64 = 1_000_000;

/// Settings of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunSettings {
    /// The machine's name.
    pub machine_name: String,
    /// iceoryx2's prefix, the same as the core's.
    pub prefix: Option<String>,
    /// The drives; if `None`, default drives for the axes and the period of the core.
    pub drives: Option<SimSettings>,
    /// Faults of the default drives.
    pub faults: Vec<crate::Fault>,
    /// Spindles whose feedback is sent every period.
    pub spindles: Vec<SpindleSimulation>,
    /// The probe, if there is one. Its messages need [`Signalling`].
    pub probe: Option<ProbeSettings>,
    /// Excess of the drives' period over the core's, ppm.
    pub drift_ppm: f64,
    /// Duration of the run; unlimited if `None`.
    pub duration: Option<Duration>,
}

/// Counts of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SimReport {
    /// Number of periods of the drives.
    pub periods: u64,
    /// Number of setpoints received.
    pub setpoints: u64,
    /// Number of setpoints that were missing, late or refused.
    pub missed: u32,
    /// Number of feedback messages sent.
    pub answers: u64,
    /// Number of cutting loads sent.
    pub loads: u64,
    /// Number of messages of inputs sent.
    pub inputs: u64,
    /// Number of messages of spindles sent.
    pub spindles: u64,
    /// Number of times that a core was found.
    pub connections: u32,
}

/// Why a bridge cannot run.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum RunError {
    /// The bus cannot be used.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A limit is invalid.
    #[error(transparent)]
    Settings(#[from] SettingsError),
}

struct Ports {
    setpoints: SetpointReader,
    feedback: FeedbackSender,
    load: Option<LoadSender>,
    outputs: Option<OutputReader>,
    inputs: Option<InputSender>,
    spindles: Option<SpindleSender>,
    /// Ports live in the client's node.
    _client: ClientBus,
}

/// The simulated cut, called once a period with the true positions of the axes. Returns the reading of the
/// load sensor and the end of its range, or `None` for no reading.
pub type Cutting = Box<dyn FnMut(&[f64; AXES]) -> Option<(f64, f64)>>;

/// Like [`run_cutting`] without a cut. `on_core` is called with the axes and the period in ns each time a
/// core is found.
///
/// # Errors
/// As for [`run_cutting`].
pub fn run(
    settings: &RunSettings,
    stop: &AtomicBool,
    mut on_core: impl FnMut(&str, u64),
) -> Result<SimReport, RunError> {
    let on_event = |event: &SimEvent| {
        if let SimEvent::Core { axes, period_ns } = event {
            on_core(axes, *period_ns);
        }
    };
    run_cutting(settings, stop, on_event, |_| None, None)
}

/// Runs until `stop` is set or the duration is over. Waits for a core without a time limit, keeps running
/// when the core ends, and connects to the next one. `on_event` receives the events. `cutting` is called
/// once, when a core is found, with the period in ns; the cut that it returns is evaluated every period and its
/// load is published. `signalling` reads the inputs, if there are any; they are sent when they change, and
/// every 5 ms.
///
/// # Errors
/// The core does not fit the drives, the bus cannot be used, or a limit is invalid.
pub fn run_cutting(
    settings: &RunSettings,
    stop: &AtomicBool,
    mut on_event: impl FnMut(&SimEvent),
    cutting: impl FnOnce(u64) -> Option<Cutting>,
    signalling: Option<Signalling>,
) -> Result<SimReport, RunError> {
    let begin_ns = monotonic_ns();
    let end_ns = settings
        .duration
        .map(|duration| begin_ns.saturating_add(u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)));
    let over = || stop.load(Ordering::Relaxed) || end_ns.is_some_and(|end_ns| monotonic_ns() >= end_ns);
    let mut machine = SimMachine::new(settings, begin_ns, signalling);
    let mut cutting = Some(cutting);
    let mut model: Option<(SimBridge, DriveClock)> = None;
    let (mut follow_watch, mut is_awaited) = (FollowWatch::default(), false);
    while !over() {
        if let Some((letters, period_ns)) = machine.find_core(cutting.is_some())? {
            is_awaited = true;
            on_event(&SimEvent::Core {
                axes: letters.clone(),
                period_ns,
            });
            if model.is_none() {
                let drives = drives(settings, &letters, period_ns, begin_ns);
                let clock = DriveClock::new(monotonic_ns(), drives.period_ns, settings.drift_ppm);
                model = Some((SimBridge::new(&drives)?, clock));
                machine.cutting = cutting.take().and_then(|cutting| cutting(drives.period_ns));
            }
        }
        let Some((bridge, clock)) = &mut model else {
            if !is_awaited {
                is_awaited = true;
                on_event(&SimEvent::Waiting);
            }
            std::thread::sleep(Duration::from_millis(10));
            continue;
        };
        let now_ns = monotonic_ns();
        if clock.next_ns().saturating_add(CATCH_UP_NS) < now_ns {
            clock.skip_to(now_ns);
        }
        // Received messages count as received by the next tick: a late wake-up of this thread must not make a
        // setpoint late.
        let is_broken = machine.receive(bridge, clock.next_ns(), now_ns);
        while clock.next_ns() <= now_ns {
            machine.step(bridge, clock.tick());
            if let Some(event) = follow_watch.step(bridge) {
                on_event(&event);
            }
        }
        machine.send_inputs(now_ns);
        machine.report.missed = bridge.missed();
        machine.leave_lost_core(is_broken, now_ns);
        let nap_ns = clock
            .next_ns()
            .saturating_sub(monotonic_ns())
            .min(POLL_INTERVAL_NS);
        std::thread::sleep(Duration::from_nanos(nap_ns));
    }
    Ok(machine.report)
}

/// All of the machine but the drives, and the ports.
struct SimMachine<'a> {
    settings: &'a RunSettings,
    ports: Option<Ports>,
    /// Time of the last message of the core.
    received_ns: u64,
    setpoint: Option<Setpoint>,
    outputs: OutputFollower,
    spindles: Vec<SimSpindle>,
    probe: Option<SimProbe>,
    cutting: Option<Cutting>,
    inputs: Option<InputMessages>,
    report: SimReport,
}

impl<'a> SimMachine<'a> {
    fn new(settings: &'a RunSettings, begin_ns: u64, signalling: Option<Signalling>) -> Self {
        let spindles = settings.spindles.iter();
        Self {
            settings,
            ports: None,
            received_ns: begin_ns,
            setpoint: None,
            outputs: OutputFollower::default(),
            spindles: spindles
                .map(|spindle| SimSpindle::new(*spindle, begin_ns))
                .collect(),
            probe: settings.probe.clone().map(SimProbe::new),
            cutting: None,
            inputs: signalling.map(|read| InputMessages::new(read, begin_ns)),
            report: SimReport::default(),
        }
    }

    /// Looks for a core and returns the axes and the period of one that it finds. `may_cut` says that a cut
    /// may follow once the period is known.
    fn find_core(&mut self, may_cut: bool) -> Result<Option<(String, u64)>, RunError> {
        if self.ports.is_some() {
            return Ok(None);
        }
        let measures = may_cut || self.cutting.is_some();
        match connect(self.settings, measures, self.inputs.is_some()) {
            Ok((ports, letters, period_ns)) => {
                self.report.connections += 1;
                self.received_ns = monotonic_ns();
                self.ports = Some(ports);
                Ok(Some((letters, period_ns)))
            }
            Err(BusError::NoCore { .. } | BusError::Service { .. } | BusError::NoPlace { .. }) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// Receives the messages of the core. Returns whether the connection is broken.
    fn receive(&mut self, bridge: &mut SimBridge, tick_ns: u64, now_ns: u64) -> bool {
        let Some(ports) = &mut self.ports else {
            return false;
        };
        let is_broken = loop {
            match ports.setpoints.receive() {
                Ok(None) => break false,
                Ok(Some(setpoint)) => {
                    self.received_ns = now_ns;
                    self.report.setpoints += 1;
                    self.setpoint = Some(setpoint);
                    bridge.offer(tick_ns, &setpoint);
                }
                Err(ReceiveError::Version { .. }) => {
                    self.received_ns = now_ns;
                    bridge.refuse_version();
                }
                Err(ReceiveError::Broken { .. }) => break true,
            }
        };
        if let Some(reader) = &mut ports.outputs {
            // A damaged message is followed by a complete one.
            while let Ok(Some(message)) = reader.receive() {
                let _damaged = self.outputs.offer(now_ns, &message);
            }
        }
        is_broken
    }

    /// Simulates one period of the drives. A message that is not sent is replaced by that of the next period.
    fn step(&mut self, bridge: &mut SimBridge, tick_ns: u64) {
        self.report.periods += 1;
        let in_force = self.outputs.step(tick_ns);
        for spindle in &mut self.spindles {
            let faults = bridge.spindle_faults(tick_ns);
            let feedback = spindle.step(tick_ns, &in_force, &faults);
            if let (Some(feedback), Some(sender)) = (
                feedback,
                self.ports.as_mut().and_then(|open| open.spindles.as_mut()),
            ) {
                self.report.spindles += u64::from(sender.send(&feedback).is_ok());
            }
        }
        let feedback = bridge.step(tick_ns);
        if let Some(probe) = &mut self.probe {
            probe.step(tick_ns, &bridge.true_positions(), &bridge.shown_positions());
        }
        let reading = self
            .cutting
            .as_mut()
            .and_then(|cut| cut(&bridge.true_positions()));
        if let Some(reading) = reading.and_then(|reading| bridge.load_reading(tick_ns, reading))
            && let Some(sender) = self.ports.as_mut().and_then(|open| open.load.as_mut())
        {
            let message = load(self.report.periods, tick_ns, reading);
            self.report.loads += u64::from(sender.send(&message).is_ok());
        }
        if let (Some(feedback), Some(open)) = (feedback, &mut self.ports) {
            self.report.answers += u64::from(open.feedback.send(&feedback).is_ok());
        }
    }

    fn send_inputs(&mut self, now_ns: u64) {
        if let (Some(inputs), Some(sender)) = (
            &mut self.inputs,
            self.ports.as_mut().and_then(|open| open.inputs.as_mut()),
        ) {
            let outputs = self.outputs.step(now_ns);
            let setpoint = self.setpoint.as_ref();
            self.report.inputs += inputs.send(now_ns, setpoint, &outputs, self.probe.as_mut(), sender);
        }
    }

    /// Closes the ports if the core has ended: the next core may have others.
    fn leave_lost_core(&mut self, is_broken: bool, now_ns: u64) {
        if is_broken || now_ns.saturating_sub(self.received_ns) > RECONNECT_NS {
            self.received_ns = now_ns;
            self.ports = None;
        }
    }
}

/// A force at the tool, as a sensor of the user would send it.
fn load(sequence: u64, time_ns: u64, (value, range_max): (f64, f64)) -> Load {
    Load {
        sequence,
        time_ns,
        kind: FORCE_N,
        source: 16,
        value,
        range_min: -range_max,
        range_max,
        ..Load::default()
    }
}

fn connect(settings: &RunSettings, measures: bool, signals: bool) -> Result<(Ports, String, u64), BusError> {
    let mut config = ClientConfig::new(&settings.machine_name);
    config.prefix.clone_from(&settings.prefix);
    config.wait = ATTEMPT;
    let client = ClientBus::open(&config)?;
    let (letters, period_ns) = (client.axes().to_owned(), client.period_ns());
    let has_spindles = !settings.spindles.is_empty();
    let ports = Ports {
        setpoints: client.bridge_setpoints()?,
        feedback: client.feedback_sender()?,
        load: if measures {
            Some(client.load_sender()?)
        } else {
            None
        },
        outputs: if signals || has_spindles {
            Some(client.outputs()?)
        } else {
            None
        },
        inputs: if signals {
            Some(client.input_sender()?)
        } else {
            None
        },
        spindles: if has_spindles {
            Some(client.spindle_sender()?)
        } else {
            None
        },
        _client: client,
    };
    Ok((ports, letters, period_ns))
}

fn drives(settings: &RunSettings, letters: &str, period_ns: u64, instance: u64) -> SimSettings {
    let mut drives = settings
        .drives
        .clone()
        .unwrap_or_else(|| SimSettings::usual(letters, period_ns));
    // The core may run at a rate other than that of its machine file.
    drives.period_ns = period_ns;
    drives.faults.extend(settings.faults.iter().copied());
    drives.instance = instance;
    drives
}
