//! The newest messages of inputs and outputs on the bus.

use evolvent_bus::{BusError, ClientBus, InputReader, MachineInputs, MachineOutputs, OutputReader, Status};
use evolvent_machine::SignalSettings;
use evolvent_runtime::{MonotonicClock, objection_to_inputs};

use crate::ctl_io::Periphery;

/// Maximum age of a message of inputs without a machine file, s.
const MAX_AGE_S: f64 = 0.5;

/// Follows inputs and outputs.
#[derive(Debug)]
pub(crate) struct SignalWatch {
    /// Names, and the age at which inputs are unknown.
    settings: Option<SignalSettings>,
    outputs: OutputReader,
    inputs: InputReader,
    last_outputs: Option<MachineOutputs>,
    /// The newest message of each bridge.
    bridges: Vec<MachineInputs>,
}

impl SignalWatch {
    pub(crate) fn open(bus: &ClientBus, settings: Option<SignalSettings>) -> Result<Self, BusError> {
        Ok(Self {
            settings,
            outputs: bus.outputs()?,
            inputs: bus.inputs()?,
            last_outputs: None,
            bridges: Vec::new(),
        })
    }

    /// Receives what has arrived.
    pub(crate) fn poll(&mut self) -> Result<(), Box<dyn std::error::Error>> {
        while let Some(message) = self.outputs.receive()? {
            self.last_outputs = Some(message);
        }
        while let Some(message) = self.inputs.receive()? {
            self.bridges.retain(|known| known.instance != message.instance);
            self.bridges.push(message);
        }
        Ok(())
    }

    /// The present state, as far as the core knows it: messages that are too old or that it discards are left
    /// out.
    pub(crate) fn periphery(&mut self, status: Option<&Status>) -> Periphery {
        let now_ns = MonotonicClock::now_ns();
        let max_age_s = (self.settings.as_ref()).map_or(MAX_AGE_S, |settings| settings.input_timeout_s);
        self.bridges
            .retain(|message| now_ns.saturating_sub(message.time_ns) as f64 * 1e-9 <= max_age_s);
        let (inputs, discarded) = accepted(self.settings.as_ref(), &self.bridges, now_ns);
        let mut found = Periphery::of(
            self.settings.as_ref(),
            self.last_outputs.as_ref(),
            &inputs,
            status,
        );
        found.discarded = discarded;
        found
    }
}

/// The messages that the core uses, and the reasons why it discards the others. The inputs are known only
/// with the machine file.
pub(crate) fn accepted(
    settings: Option<&SignalSettings>,
    messages: &[MachineInputs],
    now_ns: u64,
) -> (Vec<MachineInputs>, Vec<String>) {
    let mut discarded = Vec::new();
    let objection = |message: &MachineInputs| {
        // Their age is already checked, and includes the time of collecting.
        let fresh = MachineInputs {
            time_ns: now_ns,
            ..*message
        };
        settings.and_then(|settings| objection_to_inputs(settings, &fresh, now_ns))
    };
    let used = messages
        .iter()
        .filter(|message| match objection(message) {
            Some(text) => {
                discarded.push(text);
                false
            }
            None => true,
        })
        .copied()
        .collect();
    (used, discarded)
}
