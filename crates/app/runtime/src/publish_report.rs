//! Counts of the publisher.

use evolvent_drive::{InputFault, SpindleFault};

/// Counts of the publisher.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PublishReport {
    /// Setpoints published after their due time.
    pub late: u64,
    /// Setpoints that could not be published.
    pub failed: u64,
    /// Maximum number of readers of setpoints and bridges connected at the same time.
    pub listeners: usize,
    /// Number of rejected messages of inputs, and the fault of the last one.
    pub refused_inputs: Option<(u64, InputFault)>,
    /// The same for spindles.
    pub refused_spindles: Option<(u64, SpindleFault)>,
}

impl PublishReport {
    /// Notes about rejected messages.
    pub(crate) fn refusal_notes(&self) -> impl Iterator<Item = String> {
        let note = |what: &str, count: u64, fault: String| {
            format!(
                "{count} messages of {what} were rejected, the last because {fault}: check the bridge that \
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

    /// Notes the number of readers of setpoints that are connected now.
    pub(crate) fn observe_listeners(&mut self, connected: usize) {
        self.listeners = self.listeners.max(connected);
    }
}
