//! Spindles, inputs and outputs at each setpoint, for the scope.

use std::collections::VecDeque;

use evolvent_bus::{MachineInputs, MachineOutputs, SpindleFeedback};
use evolvent_machine::SignalSettings;

use crate::sampling::{STALE_NS, push};
use crate::signal_board::SignalBoard;

/// The values are computed again after this time even without changes, because old inputs become unknown.
const REFRESH_NS: u64 = 1_000_000;
/// Messages farther ahead of the newest setpoint than this belong to another clock. Setpoints are sampled up
/// to a second late.
const MAX_AHEAD_NS: u64 = 10_000_000_000;
/// Figures of a spindle: commanded speed, measured speed, angle.
const SPINDLE_FIGURES: usize = 3;

/// Messages waiting for the setpoints of their time, and the values at the last setpoint.
#[derive(Debug)]
pub(crate) struct SampledSignals {
    board: SignalBoard,
    /// Numbers of the spindles, in the order of the machine.
    spindles: Vec<u32>,
    outputs: VecDeque<MachineOutputs>,
    inputs: VecDeque<MachineInputs>,
    feedback: VecDeque<SpindleFeedback>,
    /// For each spindle: time of the measurement, speed and angle.
    measured: Vec<(u64, [f64; 2])>,
    values: Vec<f64>,
    /// Due time for which the values were computed.
    computed_ns: Option<u64>,
    /// Due time of the newest requested setpoint.
    newest_ns: Option<u64>,
}

/// Number of values per sample, of spindles, inputs and outputs.
pub(crate) fn values_of(settings: &SignalSettings) -> usize {
    SPINDLE_FIGURES * settings.spindles.len() + settings.inputs.len() + settings.outputs.len()
}

impl SampledSignals {
    pub(crate) fn new(settings: &SignalSettings) -> Self {
        let spindles: Vec<u32> = settings.spindles.iter().map(|spindle| spindle.number).collect();
        let count = values_of(settings);
        Self {
            board: SignalBoard::new(settings.clone()),
            measured: vec![(0, [f64::NAN; 2]); spindles.len()],
            spindles,
            outputs: VecDeque::new(),
            inputs: VecDeque::new(),
            feedback: VecDeque::new(),
            values: vec![f64::NAN; count],
            computed_ns: None,
            newest_ns: None,
        }
    }

    /// Number of values per sample.
    pub(crate) fn len(&self) -> usize {
        self.values.len()
    }

    pub(crate) fn take_outputs(&mut self, message: MachineOutputs) {
        push(&mut self.outputs, message);
    }

    pub(crate) fn take_inputs(&mut self, message: MachineInputs) {
        if self.may_come_due(message.time_ns) {
            push(&mut self.inputs, message);
        }
    }

    pub(crate) fn take_spindle(&mut self, message: SpindleFeedback) {
        if message.is_valid() && self.may_come_due(message.time_ns) {
            push(&mut self.feedback, message);
        }
    }

    /// Whether setpoints will soon reach a time of a bridge. A message from the far future would block all
    /// others.
    fn may_come_due(&self, time_ns: u64) -> bool {
        self.newest_ns
            .is_none_or(|newest| time_ns <= newest.saturating_add(MAX_AHEAD_NS))
    }

    /// The values with a setpoint. Sequence and due time must not decrease.
    pub(crate) fn at(&mut self, sequence: u64, due_time_ns: u64) -> &[f64] {
        if self.newest_ns.is_none() {
            // Messages before the first setpoint could not be checked at that time.
            self.inputs
                .retain(|message| message.time_ns <= due_time_ns.saturating_add(MAX_AHEAD_NS));
            self.feedback
                .retain(|message| message.time_ns <= due_time_ns.saturating_add(MAX_AHEAD_NS));
        }
        self.newest_ns = self.newest_ns.max(Some(due_time_ns));
        let mut has_changed = false;
        while let Some(message) = pop_due(&mut self.outputs, |message| message.cycle <= sequence) {
            self.board.take_outputs(message);
            has_changed = true;
        }
        while let Some(message) = pop_due(&mut self.inputs, |message| message.time_ns <= due_time_ns) {
            self.board.take_inputs(message);
            has_changed = true;
        }
        let is_old = self
            .computed_ns
            .is_none_or(|computed| due_time_ns.saturating_sub(computed) >= REFRESH_NS);
        let (spindles, signals) = self.values.split_at_mut(SPINDLE_FIGURES * self.spindles.len());
        if has_changed || is_old {
            self.computed_ns = Some(due_time_ns);
            let values = self.board.values(due_time_ns);
            for (value, known) in signals
                .iter_mut()
                .zip(values.inputs.iter().chain(&values.outputs))
            {
                *value = known.unwrap_or(f64::NAN);
            }
            let commanded = spindles.iter_mut().step_by(SPINDLE_FIGURES);
            for (value, known) in commanded.zip(&values.spindles_rpm) {
                *value = known.unwrap_or(f64::NAN);
            }
        }
        while let Some(message) = pop_due(&mut self.feedback, |message| message.time_ns <= due_time_ns) {
            if let Some(at) = self.spindles.iter().position(|number| *number == message.spindle) {
                self.measured[at] = (message.time_ns, [message.speed_rpm, 360.0 * message.fraction]);
            }
        }
        for (figures, (time_ns, measured)) in spindles.chunks_mut(SPINDLE_FIGURES).zip(&self.measured) {
            let is_fresh = due_time_ns.saturating_sub(*time_ns) <= STALE_NS;
            figures[1..].copy_from_slice(if is_fresh { measured } else { &[f64::NAN; 2] });
        }
        &self.values
    }
}

/// The oldest message, if it is due.
fn pop_due<T>(waiting: &mut VecDeque<T>, is_due: impl Fn(&T) -> bool) -> Option<T> {
    if waiting.front().is_some_and(is_due) {
        waiting.pop_front()
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal_board::tests::settings;

    fn signals() -> SampledSignals {
        let mut settings = settings();
        (settings.inputs, settings.outputs) = (settings.inputs[..1].to_vec(), settings.outputs[..1].to_vec());
        SampledSignals::new(&settings)
    }

    const MS: u64 = 1_000_000;

    #[test]
    fn a_message_from_the_far_future_delays_no_other() {
        let inputs = |time_ns, digital| MachineInputs {
            time_ns,
            digital_mask: 0b1000,
            digital,
            ..MachineInputs::default()
        };
        let feedback = |time_ns| SpindleFeedback {
            time_ns,
            speed_rpm: 790.0,
            ..SpindleFeedback::default()
        };
        // Before the first setpoint, and after it.
        for first_setpoint in [1, 3] {
            let mut signals = signals();
            if first_setpoint == 1 {
                signals.at(1, MS);
            }
            signals.take_inputs(inputs(u64::MAX, 0));
            signals.take_spindle(feedback(u64::MAX - 1));
            signals.take_inputs(inputs(2 * MS, 0b1000));
            signals.take_spindle(feedback(2 * MS));
            let values = signals.at(3, 3 * MS);
            assert_eq!((values[1], values[3]), (790.0, 1.0), "{values:?}");
        }
    }

    #[test]
    fn each_setpoint_has_the_signals_of_its_time() {
        let mut signals = signals();
        assert_eq!(signals.len(), 5);
        assert!(signals.at(1, MS).iter().all(|value| value.is_nan()));
        for (time_ns, digital) in [(3 * MS, 0), (5 * MS, 0b1000)] {
            signals.take_inputs(MachineInputs {
                time_ns,
                digital_mask: 0b1000,
                digital,
                ..MachineInputs::default()
            });
        }
        for (cycle, digital, direction) in [(2, 0, 1), (4, 1 << 63, 2)] {
            let mut outputs = MachineOutputs {
                cycle,
                digital_mask: 1 << 63,
                digital,
                spindle_mask: 1,
                ..MachineOutputs::default()
            };
            (outputs.spindle_rpm[0], outputs.spindle_direction[0]) = (800.0, direction);
            signals.take_outputs(outputs);
        }
        for (time_ns, fraction) in [(4 * MS, 0.25), (6 * MS, 0.75)] {
            signals.take_spindle(SpindleFeedback {
                time_ns,
                fraction,
                speed_rpm: 790.0,
                ..SpindleFeedback::default()
            });
        }
        // Commanded, measured, angle, door, clamp; -1 is unknown.
        let mut sampled = |ms: u64| -> Vec<f64> {
            let values = signals.at(ms, ms * MS).iter();
            values
                .map(|value| if value.is_nan() { -1.0 } else { *value })
                .collect()
        };
        assert_eq!(sampled(2), [800.0, -1.0, -1.0, -1.0, 0.0]);
        assert_eq!(sampled(3), [800.0, -1.0, -1.0, 0.0, 0.0]);
        assert_eq!(sampled(4), [-800.0, 790.0, 90.0, 0.0, 1.0]);
        assert_eq!(sampled(5), [-800.0, 790.0, 90.0, 1.0, 1.0]);
        assert_eq!(sampled(6), [-800.0, 790.0, 270.0, 1.0, 1.0]);
        // Signals that are no longer reported are unknown; outputs keep their command.
        assert_eq!(sampled(200), [-800.0, -1.0, -1.0, -1.0, 1.0]);
    }
}
