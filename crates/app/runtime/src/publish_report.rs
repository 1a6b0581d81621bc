//! What the publisher counts.

use evolvent_bus::CoreBus;
use evolvent_drive::{InputFault, SpindleFault};

/// What the publisher counted.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PublishReport {
    /// Setpoints that left after they were due.
    pub late: u64,
    /// Setpoints that did not leave.
    pub failed: u64,
    /// Readers of setpoints and bridges that were connected at the same time, at most.
    pub listeners: usize,
    /// Messages of inputs that were refused, and what was wrong with the last.
    pub refused_inputs: Option<(u64, InputFault)>,
    /// The same of spindles.
    pub refused_spindles: Option<(u64, SpindleFault)>,
}

impl PublishReport {
    /// What became of messages that were refused.
    pub(crate) fn refusal_notes(&self) -> impl Iterator<Item = String> {
        let note = |what: &str, count: u64, fault: String| {
            format!(
                "{count} messages of {what} were refused, the last because {fault}: see the bridge that \
                 sends them"
            )
        };
        let inputs = self.refused_inputs;
        let spindles = self.refused_spindles;
        [
            inputs.map(|(count, fault)| note("inputs", count, fault.to_string())),
            spindles.map(|(count, fault)| note("spindles", count, fault.to_string())),
        ]
        .into_iter()
        .flatten()
    }

    /// Readers of setpoints that are connected now.
    pub(crate) fn observe_listeners(&mut self, bus: &CoreBus) {
        self.listeners = self.listeners.max(bus.setpoint_subscribers());
    }
}
