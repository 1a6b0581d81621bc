//! The position of the axes when the probe changed.
//!
//! This is the position that the drives have latched, if they have; otherwise it is interpolated linearly
//! between the two samples of feedback around the time of the change. Within a period T at an acceleration a
//! the error of the interpolation is at most a T^2 / 8, in addition to the errors of feedback and time. If no
//! bridge sends feedback, setpoints are used instead.

use evolvent_path::AxisMask;
use std::collections::VecDeque;

use evolvent_bus::{AXES, Feedback};
use evolvent_drive::KnownProbe;

use crate::due_setpoint::DueSetpoint;

/// Number of samples kept: 0.1 s at 35 kHz, and more than a second below 3.5 kHz.
const SAMPLES: usize = 4096;
/// Maximum wait for the sample after the change, ns.
const PATIENCE_NS: u64 = 20_000_000;
/// Age beyond which feedback is not used, ns.
const STALE_NS: u64 = 100_000_000;

#[derive(Clone, Copy, Debug)]
struct Sample {
    time_ns: u64,
    datum: u64,
    position: [f64; AXES],
    /// For a setpoint: its correction.
    shift: [f64; AXES],
}

/// A change whose position is unknown yet.
#[derive(Clone, Copy, Debug)]
struct Change {
    time_ns: u64,
    latched_mask: u32,
    latched: [f64; AXES],
    /// When it was reported.
    reported_ns: u64,
}

/// Positions over time, and pending changes of the probe.
#[derive(Debug)]
pub(crate) struct ProbeLocator {
    axes_mask: u32,
    feedback: VecDeque<Sample>,
    setpoints: VecDeque<Sample>,
    changes: VecDeque<Change>,
}

impl ProbeLocator {
    pub(crate) fn new() -> Self {
        Self {
            axes_mask: u32::MAX,
            feedback: VecDeque::with_capacity(SAMPLES),
            setpoints: VecDeque::with_capacity(SAMPLES),
            changes: VecDeque::new(),
        }
    }

    /// Adds feedback of the drives; each sample once.
    pub(crate) fn observe_feedback(&mut self, feedback: &Feedback) {
        self.axes_mask = feedback.axes_mask;
        let sound = (0..AXES).all(|axis| {
            !AxisMask::from_bits(feedback.axes_mask).contains(axis) || feedback.position[axis].is_finite()
        });
        if sound {
            let shift = self.shift_at(feedback.time_ns);
            keep(
                &mut self.feedback,
                Sample {
                    time_ns: feedback.time_ns,
                    datum: feedback.datum,
                    position: std::array::from_fn(|axis| feedback.position[axis] - shift[axis]),
                    shift,
                },
            );
        }
    }

    /// Adds a setpoint; each once.
    pub(crate) fn observe_setpoint(&mut self, due: &DueSetpoint) {
        let [sent, ..] = due.sent();
        keep(
            &mut self.setpoints,
            Sample {
                time_ns: due.due_time_ns,
                datum: due.drive.datum,
                position: due.setpoint.position.into(),
                shift: (sent - due.setpoint.position).into(),
            },
        );
    }

    /// Adds a change of the probe.
    pub(crate) fn observe_change(&mut self, probe: &KnownProbe, now_ns: u64) {
        if self.changes.len() < SAMPLES {
            self.changes.push_back(Change {
                time_ns: probe.time_ns.unwrap_or(now_ns),
                latched_mask: probe.latched_mask,
                latched: probe.position,
                reported_ns: now_ns,
            });
        }
    }

    /// Returns the position of the oldest pending change, once, when it is known.
    pub(crate) fn next(&mut self, now_ns: u64) -> Option<[f64; AXES]> {
        let change = *self.changes.front()?;
        let mut position = [0.0; AXES];
        if change.latched_mask & self.axes_mask != self.axes_mask {
            position = self.at(&change, now_ns)?;
        }
        let shift = self.shift_at(change.time_ns);
        for (axis, value) in position.iter_mut().enumerate() {
            if AxisMask::from_bits(change.latched_mask).contains(axis) {
                *value = change.latched[axis] - shift[axis];
            }
        }
        self.changes.pop_front();
        Some(position)
    }

    /// The correction of the setpoint that was due at a time, or of the nearest one.
    fn shift_at(&self, time_ns: u64) -> [f64; AXES] {
        let after = self.setpoints.partition_point(|sample| sample.time_ns < time_ns);
        let newest = self.setpoints.back();
        (self.setpoints.get(after).or(newest)).map_or([0.0; AXES], |sample| sample.shift)
    }

    /// The position at a change; `None` while it may still become known.
    fn at(&self, change: &Change, now_ns: u64) -> Option<[f64; AXES]> {
        let has_drives = (self.feedback.back())
            .is_some_and(|sample| sample.time_ns.saturating_add(STALE_NS) >= change.time_ns);
        let samples = if has_drives {
            &self.feedback
        } else {
            &self.setpoints
        };
        let newest = samples.back()?;
        let is_over = now_ns.saturating_sub(change.reported_ns) > PATIENCE_NS;
        if newest.time_ns < change.time_ns && !is_over {
            return None;
        }
        Some(interpolate(samples, change.time_ns).unwrap_or(newest.position))
    }
}

fn keep(samples: &mut VecDeque<Sample>, sample: Sample) {
    // If the clock goes back or the datum changes, collection restarts.
    if samples
        .back()
        .is_some_and(|last| last.time_ns >= sample.time_ns || last.datum != sample.datum)
    {
        samples.clear();
    }
    if samples.len() == SAMPLES {
        samples.pop_front();
    }
    samples.push_back(sample);
}

/// Interpolates between the samples around a time; `None` if it is before or after all of them.
fn interpolate(samples: &VecDeque<Sample>, time_ns: u64) -> Option<[f64; AXES]> {
    let after = samples.partition_point(|sample| sample.time_ns < time_ns);
    let right = samples.get(after)?;
    if right.time_ns == time_ns {
        return Some(right.position);
    }
    let left = samples.get(after.checked_sub(1)?)?;
    let fraction = (time_ns - left.time_ns) as f64 / (right.time_ns - left.time_ns) as f64;
    Some(std::array::from_fn(|axis| {
        left.position[axis] + fraction * (right.position[axis] - left.position[axis])
    }))
}

#[cfg(test)]
mod tests {
    use evolvent_gcode::SPINDLES;
    use evolvent_motion::{MotionState, Setpoint};
    use evolvent_path::{Axes, Jet};

    use super::*;
    use crate::due_setpoint::DriveRequest;

    fn probe(time_ns: u64, latched_mask: u32) -> KnownProbe {
        KnownProbe {
            is_tripped: true,
            trips: 1,
            time_ns: Some(time_ns),
            position: [7.0; AXES],
            latched_mask,
            instance: 1,
        }
    }

    fn feedback(time_ns: u64, x: f64) -> Feedback {
        let mut feedback = Feedback {
            time_ns,
            axes_mask: 0b11,
            ..Feedback::default()
        };
        feedback.position[0] = x;
        feedback.position[1] = -x;
        feedback
    }

    #[test]
    fn a_contact_lies_between_the_samples_around_its_time() {
        let mut locator = ProbeLocator::new();
        locator.observe_feedback(&feedback(1_000_000, 1.0));
        locator.observe_change(&probe(1_250_000, 0), 1_300_000);
        assert_eq!(locator.next(1_300_000), None, "the sample behind it has not come");
        locator.observe_feedback(&feedback(2_000_000, 3.0));
        let position = locator.next(2_000_000).unwrap();
        assert_eq!(position[..2], [1.5, -1.5]);
        assert_eq!(locator.next(2_000_000), None, "each is told once");
    }

    #[test]
    fn latched_axes_take_precedence_over_interpolation() {
        let mut locator = ProbeLocator::new();
        locator.observe_feedback(&feedback(1_000_000, 1.0));
        locator.observe_feedback(&feedback(2_000_000, 3.0));
        locator.observe_change(&probe(1_500_000, 0b01), 2_000_000);
        assert_eq!(locator.next(2_000_000).unwrap()[..2], [7.0, -2.0]);
        // All axes are latched, so no sample is awaited.
        locator.observe_change(&probe(9_000_000, 0b11), 9_000_000);
        assert_eq!(locator.next(9_000_000).unwrap()[..2], [7.0, 7.0]);
    }

    #[test]
    fn a_missing_sample_is_not_awaited_forever() {
        let mut locator = ProbeLocator::new();
        locator.observe_feedback(&feedback(1_000_000, 1.0));
        locator.observe_change(&probe(2_000_000, 0), 2_000_000);
        assert_eq!(locator.next(2_000_000), None);
        assert_eq!(locator.next(2_000_000 + PATIENCE_NS + 1).unwrap()[0], 1.0);
    }

    /// Drives report corrected positions; a program needs the position of the tool.
    #[test]
    fn a_contact_is_at_the_tool_not_at_the_drives() {
        let mut locator = ProbeLocator::new();
        for (time_ns, x, shift) in [(1_000_000, 1.0, 0.25), (2_000_000, 3.0, 0.5)] {
            let mut position = Axes::zeros();
            position[0] = x;
            let mut sent = Jet::at_rest(position);
            sent.position[0] += shift;
            locator.observe_setpoint(&DueSetpoint {
                setpoint: Setpoint {
                    sequence: 0,
                    position,
                    velocity: Axes::zeros(),
                    acceleration: Axes::zeros(),
                    jerk: Axes::zeros(),
                    path_mm: 0.0,
                    feed_mm_s: 0.0,
                    feed_override: 1.0,
                    line: 0,
                    block: 0,
                    state: MotionState::Running,
                    flags: 0,
                    actions: 0,
                },
                corrected: Some(sent),
                due_time_ns: time_ns,
                drive: DriveRequest::ON,
                job: 0,
                spindle_overrides: [1.0; SPINDLES],
                override_off_mask: 0,
                is_of_program: true,
            });
            locator.observe_feedback(&feedback(time_ns, x + shift));
        }
        locator.observe_change(&probe(1_500_000, 0), 2_000_000);
        assert_eq!(locator.next(2_000_000).unwrap()[0], 2.0);
        // Latched at 7 by the drive, whose correction was half a millimetre.
        locator.observe_change(&probe(2_000_000, 0b11), 2_000_000);
        assert_eq!(locator.next(2_000_000).unwrap()[..2], [6.5, 7.0]);
    }
}
