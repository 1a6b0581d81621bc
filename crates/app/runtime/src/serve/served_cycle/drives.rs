//! The drives of a served machine: their positions, what is sent to them, and stops due to their alarms.

use evolvent_bus::Feedback;
use evolvent_drive::{DriveAlarm, DriveSetpoint, PowerRequest};
use evolvent_motion::Setpoint;
use evolvent_path::{Axes, AxisMask, Jet};

use super::{CycleState, ServedParts};
use crate::serve::orders::CycleEvent;
use crate::signal_loop::SignalLoop;

/// Maximum number of feedback messages that one cycle reads to find the newest.
const MAX_FEEDBACK: usize = 256;

impl ServedParts {
    pub(super) fn newest_feedback(&mut self) -> Option<Feedback> {
        let mut newest = None;
        for _ in 0..MAX_FEEDBACK {
            match self.feedback.pop() {
                Ok(feedback) => newest = Some(feedback),
                Err(_) => break,
            }
        }
        newest
    }

    /// Sets the core's position to that of the drives, which may be moved by hand while they have no power.
    pub(super) fn rebase_to_drives(&mut self, now: &mut CycleState, feedback: &Feedback, time_ns: u64) {
        let is_off = now.drive.power == PowerRequest::Off && now.is_idle();
        let is_believed = self.watch.believes(time_ns, feedback);
        if !is_off || !self.generator.is_at_rest() || !is_believed {
            return;
        }
        // A restarted core does not know the datum that the bridge uses.
        now.drive.datum = now.drive.datum.max(feedback.datum);
        if feedback.datum != now.drive.datum {
            return;
        }
        let mut position = self.generator.position();
        let known = AxisMask::from_bits(feedback.axes_mask);
        let found = match &self.corrections {
            Some(corrections) => corrections.found(&feedback.position, |axis| known.contains(axis)),
            None => Some(Axes::from(std::array::from_fn(|axis| {
                if known.contains(axis) {
                    feedback.position[axis]
                } else {
                    position[axis]
                }
            }))),
        };
        let Some(found) = found else { return };
        let mut moved = false;
        for i in 0..position.len() {
            if found[i] != position[i] {
                position[i] = found[i];
                // An axis beyond its travel may stay there and come back.
                self.limits.travel_min[i] = self.limits.travel_min[i].min(position[i]);
                self.limits.travel_max[i] = self.limits.travel_max[i].max(position[i]);
                moved = true;
            }
        }
        if moved {
            now.relocated = true;
            if let Some(corrections) = &mut self.corrections {
                corrections.relocate(&position);
            }
            self.generator.relocate(self.limits, position);
        }
    }

    /// The position sent to the drives for a setpoint.
    pub(super) fn correct(&mut self, now: &mut CycleState, setpoint: &Setpoint) -> Option<Jet> {
        let corrections = self.corrections.as_mut()?;
        let inputs = self.signals.as_ref().map(SignalLoop::inputs);
        let corrected = corrections.step(setpoint, inputs);
        if let Some(violation) = corrections.take_fault()
            && !now.faulted
        {
            let sequence = setpoint.sequence;
            self.report_once(now, CycleEvent::Guard { sequence, violation });
            now.stop_work();
        }
        Some(corrected)
    }

    pub(super) fn check_drives(
        &mut self,
        now: &mut CycleState,
        setpoint: &Setpoint,
        corrected: Option<&Jet>,
        time_ns: u64,
        feedback: Option<&Feedback>,
    ) {
        let (position, velocity) = corrected.map_or((setpoint.position, setpoint.velocity), |jet| {
            (jet.position, jet.first)
        });
        let command = DriveSetpoint {
            sequence: setpoint.sequence,
            position: Axes::into(position),
            velocity: Axes::into(velocity),
            datum: now.drive.datum,
            power: now.drive.power,
            fault_reset: now.drive.fault_reset,
            switches_expected: now.switches_expected,
        };
        match self.watch.step(time_ns, &command, feedback) {
            Ok(presence) => now.presence = presence,
            Err(alarm) => self.stop_for_drives(now, setpoint.sequence, alarm),
        }
        let axes = self.watch.take_reference_lost();
        if !axes.is_empty() {
            let sequence = setpoint.sequence;
            self.report(CycleEvent::ReferenceLost { sequence, axes });
        }
    }

    pub(super) fn stop_for_drives(&mut self, now: &mut CycleState, sequence: u64, alarm: DriveAlarm) {
        if now.drive.power != PowerRequest::On {
            return;
        }
        let follows = alarm.drives_follow();
        if follows && now.stops_for_drives {
            return;
        }
        // Whatever fault came first, the control thread must receive this one because it removes the power.
        now.stops_for_drives = true;
        now.faulted = true;
        self.report(CycleEvent::Drive { sequence, alarm });
        if follows {
            now.power_off_at_rest = true;
            now.stop_work();
        } else {
            self.emergency(now);
        }
    }
}
