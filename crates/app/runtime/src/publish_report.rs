//! What the publisher counts.

use evolvent_bus::CoreBus;
use evolvent_drive::InputFault;

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
}

impl PublishReport {
    /// What became of messages of inputs that were refused.
    pub(crate) fn refusal_note(&self) -> Option<String> {
        let (count, fault) = self.refused_inputs?;
        Some(format!(
            "{count} messages of inputs were refused, the last because {fault}: see the bridge that sends them"
        ))
    }

    /// Readers of setpoints that are connected now.
    pub(crate) fn see_listeners(&mut self, bus: &CoreBus) {
        self.listeners = self.listeners.max(bus.setpoint_subscribers());
    }
}
