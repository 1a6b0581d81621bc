//! The thread that owns the ports of the bus.

use core::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use core::time::Duration;
use std::path::PathBuf;

use evolvent_bus::{
    BusError, ClientBus, ClientConfig, Feedback, FeedbackSender, InputSender, MachineInputs, OutputReader,
    ReceiveError, SetpointReader, SpindleFeedback, SpindleSender, bus_folders,
};
use evolvent_path::{AxisLetter, AxisMask};
use rtrb::{Consumer, Producer};

use crate::bridge::{BridgeError, BridgeSettings, Hardware};
use crate::clock::monotonic_ns;
use crate::ends::Incoming;

/// After this time without a setpoint the connection to the core is made again, ns.
const RECONNECT_NS: u64 = 1_000_000_000;
/// Maximum duration of one attempt to find the core.
const ATTEMPT: Duration = Duration::from_millis(5);

struct Ports {
    setpoints: SetpointReader,
    feedback: FeedbackSender,
    /// If the hardware has signals.
    signals: Option<(OutputReader, InputSender)>,
    /// If the hardware measures spindles.
    spindles: Option<SpindleSender>,
    /// Ports are part of the client's node.
    _client: ClientBus,
}

/// The thread that owns the ports.
pub(crate) struct BusSide<'a, H> {
    pub(crate) settings: BridgeSettings<'a>,
    pub(crate) hardware: &'a H,
    pub(crate) stop: &'a AtomicBool,
    pub(crate) period_ns: &'a AtomicU64,
    pub(crate) incoming: &'a mut Producer<Incoming>,
    pub(crate) feedback: &'a mut Consumer<Feedback>,
    pub(crate) inputs: &'a mut Consumer<MachineInputs>,
    pub(crate) spindles: &'a mut Consumer<SpindleFeedback>,
    /// Folders of the bus that this thread may still access, each with data that distinguish it from a later
    /// folder of the same name.
    pub(crate) folders: Vec<(PathBuf, String)>,
    pub(crate) connections: u32,
}

impl<H: Hardware> BusSide<'_, H> {
    /// Passes messages on until the bridge stops. Returns the number of times that a core was found.
    pub(crate) fn serve(
        &mut self,
        notices: &mut Consumer<H::Notice>,
        failures: &std::sync::mpsc::Receiver<H::Failure>,
        mut tell: impl FnMut(&str),
    ) -> Result<u32, BridgeError> {
        let begin_ns = monotonic_ns();
        let over = |stop: &AtomicBool, duration: Option<Duration>| {
            let passed = Duration::from_nanos(monotonic_ns() - begin_ns);
            stop.load(Ordering::Relaxed) || duration.is_some_and(|duration| passed >= duration)
        };
        let mut ports: Option<Ports> = None;
        let mut is_awaited = false;
        let (mut heard_ns, mut last_failure) = (begin_ns, None);
        while !over(self.stop, self.settings.duration) {
            if ports.is_none() {
                match self.connect() {
                    Ok((found, letters, period_ns)) => {
                        self.check_axes(&letters)?;
                        self.connections += 1;
                        is_awaited = true;
                        heard_ns = monotonic_ns();
                        tell(&format!("core found: axes {letters}, {period_ns} ns"));
                        self.period_ns.store(period_ns, Ordering::Relaxed);
                        ports = Some(found);
                    }
                    Err(BusError::NoCore { .. } | BusError::Service { .. } | BusError::NoPlace { .. }) => {
                        self.check_folders()?;
                        if !is_awaited {
                            is_awaited = true;
                            tell(&format!("{}: waiting for its core", self.hardware.title()));
                        }
                    }
                    Err(error) => return Err(error.into()),
                }
            }
            let is_broken = match ports.as_mut() {
                Some(ports) => self.pass_on(ports, &mut heard_ns),
                None => {
                    // The next core must not receive messages for the previous one.
                    while self.feedback.pop().is_ok()
                        || self.inputs.pop().is_ok()
                        || self.spindles.pop().is_ok()
                    {}
                    false
                }
            };
            let is_silent = monotonic_ns().saturating_sub(heard_ns) > RECONNECT_NS;
            if ports.is_some() && (is_broken || is_silent) {
                let why = if is_broken {
                    "its connection ended"
                } else {
                    "no setpoints for 1 s"
                };
                tell(&format!("core lost: {why}"));
                ports = None;
            }
            while let Ok(notice) = notices.pop() {
                last_failure = None;
                tell(&self.hardware.text(notice));
            }
            while let Ok(failure) = failures.try_recv() {
                // A repeated message is reported once.
                if last_failure.as_ref() != Some(&failure) {
                    tell(&format!("{}: {failure}", H::NAME));
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

    /// Passes setpoints to the cycle and feedback to the bus. Returns whether the connection is broken.
    fn pass_on(&mut self, ports: &mut Ports, heard_ns: &mut u64) -> bool {
        loop {
            let incoming = match ports.setpoints.receive() {
                Ok(None) => break,
                Ok(Some(setpoint)) => Incoming::Setpoint(setpoint),
                Err(ReceiveError::Version { .. }) => Incoming::OtherVersion,
                Err(ReceiveError::Broken { .. }) => return true,
            };
            *heard_ns = monotonic_ns();
            // Full only while no session runs; old messages are then useless.
            let _full = self.incoming.push(incoming);
        }
        while let Ok(feedback) = self.feedback.pop() {
            // A message that is not sent is replaced by the next.
            let _lost = ports.feedback.send(&feedback);
        }
        if let Some((outputs, inputs)) = &mut ports.signals {
            // A damaged message is followed by a complete one.
            while let Ok(Some(message)) = outputs.receive() {
                let _full = self.incoming.push(Incoming::Outputs(message));
            }
            while let Ok(message) = self.inputs.pop() {
                let _lost = inputs.send(&message);
            }
        }
        if let Some(spindles) = &mut ports.spindles {
            while let Ok(message) = self.spindles.pop() {
                let _lost = spindles.send(&message);
            }
        }
        false
    }

    fn connect(&self) -> Result<(Ports, String, u64), BusError> {
        let name = self.settings.machine_name.unwrap_or(&self.settings.machine.name);
        let mut config = ClientConfig::new(name);
        config.prefix = self.settings.prefix.map(str::to_owned);
        config.wait = ATTEMPT;
        let client = ClientBus::open(&config)?;
        let (letters, period_ns) = (client.axes().to_owned(), client.period_ns());
        let ports = Ports {
            setpoints: client.bridge_setpoints()?,
            feedback: client.feedback_sender()?,
            signals: if self.hardware.has_signals() {
                Some((client.outputs()?, client.input_sender()?))
            } else {
                None
            },
            spindles: if self.hardware.measures_spindles() {
                Some(client.spindle_sender()?)
            } else {
                None
            },
            _client: client,
        };
        Ok((ports, letters, period_ns))
    }

    /// Checks the folders: this thread cannot access a new one.
    fn check_folders(&self) -> Result<(), BridgeError> {
        let found = bus_folders(self.settings.prefix).unwrap_or_default();
        match found.iter().find(|folder| !self.folders.contains(folder)) {
            None => Ok(()),
            Some((folder, _)) => Err(BridgeError::Folder {
                folder: folder.display().to_string(),
            }),
        }
    }

    fn check_axes(&self, letters: &str) -> Result<(), BridgeError> {
        let core: AxisMask = letters.chars().filter_map(AxisLetter::from_letter).collect();
        let driven = self.hardware.axes();
        if core == driven {
            return Ok(());
        }
        Err(BridgeError::Axes {
            core: letters.to_owned(),
            driven: driven.axes().map(|axis| AxisLetter::ALL[axis].letter()).collect(),
            file: H::NAME,
            entry: H::ENTRY,
        })
    }
}
