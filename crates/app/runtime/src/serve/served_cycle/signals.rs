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
    /// What the handwheel says.
    pub(super) fn handwheel(&self) -> HandwheelView {
        match (&self.signals, self.wheel_counts) {
            (Some(signals), Some(counts)) => signals.handwheel(counts),
            _ => HandwheelView::default(),
        }
    }

    /// The spindle override of each spindle, where the program lets it count.
    pub(super) fn counted_overrides(&self, now: &CycleState) -> SpindleOverrides {
        let switches = self.signals.as_ref().map(SignalLoop::overrides);
        let counts = switches.unwrap_or_default().spindles;
        counts.map(|counts| if counts { now.spindle_override } else { 1.0 })
    }

    /// The spindles for which the program lets it not count, as bits.
    pub(super) fn override_off_mask(&self) -> u32 {
        let switches = self.signals.as_ref().map(SignalLoop::overrides);
        let counts = switches.unwrap_or_default().spindles;
        (0..counts.len()).fold(0, |mask, number| mask | u32::from(!counts[number]) << number)
    }

    /// Inputs that have come count for the next setpoint.
    pub(super) fn apply_inputs(&mut self) {
        if let Some(signals) = &mut self.signals {
            signals.apply_inputs(self.station.sequence(), self.period_ns, None);
            self.probe = signals.take_probe();
        }
    }

    /// An open chain stops everything, and the drives.
    pub(super) fn check_chain(&mut self, now: &mut CycleState) {
        let is_open = self.signals.as_ref().is_some_and(SignalLoop::is_estopped);
        if is_open && !now.is_estop {
            now.is_estop = true;
            let sequence = self.station.sequence();
            self.report(CycleEvent::EstopChain { sequence });
            self.emergency(now);
        }
    }

    /// What a program has scheduled is carried out from its first setpoint on.
    pub(super) fn begin_schedule(&mut self, job: &mut Following) {
        let Some(signals) = &mut self.signals else { return };
        if let Some(schedule) = job.schedule.take() {
            let before = signals.begin_program(schedule, job.first_block);
            if let Some(before) = before {
                self.report(CycleEvent::Spent(before));
            }
        }
    }

    /// The outputs that count with a setpoint. Returns whether one has changed.
    pub(super) fn set_outputs(&mut self, now: &CycleState, setpoint: &Setpoint) -> bool {
        let Some(signals) = &mut self.signals else {
            return false;
        };
        let is_of_program = now.notes.input_bits & recorded::FOLLOWS != 0;
        let phase = if now.is_estop || now.faulted || now.drive.power == PowerRequest::QuickStop {
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
