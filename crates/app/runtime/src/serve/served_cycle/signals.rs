//! Inputs and outputs of a served machine.

use evolvent_drive::PowerRequest;
use evolvent_motion::Setpoint;
use evolvent_signals::Phase;
use evolvent_trace::inputs as recorded;

use super::{CycleState, ServedParts};
use crate::due_setpoint::SpindleOverrides;
use crate::handwheel_view::HandwheelView;
use crate::serve::orders::{CycleEvent, Following};
use crate::signal_loop::{SignalLoop, phase_of};

impl ServedParts {
    /// The state of the handwheel.
    pub(super) fn handwheel(&self) -> HandwheelView {
        match (&self.signals, self.wheel_counts) {
            (Some(signals), Some(counts)) => signals.handwheel(counts),
            _ => HandwheelView::default(),
        }
    }

    /// The override of each spindle, 1 where the program has switched it off.
    pub(super) fn counted_overrides(&self, now: &CycleState) -> SpindleOverrides {
        let switches = self.signals.as_ref().map(SignalLoop::overrides);
        let counts = switches.unwrap_or_default().spindles;
        counts.map(|counts| if counts { now.spindle_override } else { 1.0 })
    }

    /// Bit mask of the spindles whose override the program has switched off.
    pub(super) fn override_off_mask(&self) -> u32 {
        let switches = self.signals.as_ref().map(SignalLoop::overrides);
        let counts = switches.unwrap_or_default().spindles;
        (0..counts.len()).fold(0, |mask, number| mask | u32::from(!counts[number]) << number)
    }

    /// Applies received inputs to the next setpoint.
    pub(super) fn apply_inputs(&mut self) {
        if let Some(signals) = &mut self.signals {
            signals.apply_inputs(self.generator.sequence(), self.period_ns, None);
            self.probe = signals.take_probe();
        }
    }

    /// Stops everything, including the drives, if the chain is open.
    pub(super) fn check_chain(&mut self, now: &mut CycleState) {
        let is_open = self.signals.as_ref().is_some_and(SignalLoop::is_estopped);
        if is_open && !now.is_estop {
            now.is_estop = true;
            let sequence = self.generator.sequence();
            self.report(CycleEvent::EstopChain { sequence });
            self.emergency(now);
        }
    }

    /// Starts the schedule of a program with its first setpoint.
    pub(super) fn begin_schedule(&mut self, job: &mut Following) {
        let Some(signals) = &mut self.signals else { return };
        if let Some(schedule) = job.schedule.take() {
            let before = signals.begin_program(schedule, job.first_block);
            if let Some(before) = before {
                self.report(CycleEvent::Spent(before));
            }
        }
    }

    /// Sets the outputs that take effect with a setpoint. Returns whether one has changed.
    pub(super) fn set_outputs(&mut self, now: &mut CycleState, setpoint: &Setpoint) -> bool {
        let Some(signals) = &mut self.signals else {
            return false;
        };
        let is_of_program = now.notes.input_bits & recorded::FOLLOWS != 0;
        let phase = if now.is_estop || now.faulted || now.drive.power == PowerRequest::QuickStop {
            now.notes.input_bits |= recorded::OUTPUTS_SAFE;
            Phase::Fault
        } else if is_of_program {
            phase_of(setpoint.state)
        } else {
            Phase::Runs
        };
        if now.stops.has_left_wait {
            signals.go_on();
        }
        let is_switched = signals.step(setpoint, phase);
        if now.program.is_end
            && let Some(schedule) = signals.end_program()
        {
            self.report(CycleEvent::Spent(schedule));
        }
        is_switched
    }
}
