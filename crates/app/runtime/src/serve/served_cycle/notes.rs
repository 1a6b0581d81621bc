//! Data of a cycle for the trace, besides its setpoint.

use evolvent_bus::Feedback;
use evolvent_drive::Presence;
use evolvent_machine::LoadSample;
use evolvent_path::{AXES, AxisMask};
use evolvent_trace::{CycleRecord, PhaseRecord, inputs as recorded};
use evolvent_turning::Transition;

/// Maximum age of a cutting load that is recorded.
const LOAD_AGE_NS: u64 = 1_000_000_000;

/// Data of the present cycle, and earlier data on which later cycles depend.
pub(super) struct CycleNotes {
    /// Inputs of the step, as bits of the trace.
    pub(super) input_bits: u32,
    /// How the cycle follows the drives' clock; `None` if no phase error was reported with this cycle.
    pub(super) phase: Option<PhaseRecord>,
    /// The drives' last report; NaN without a reply.
    pub(super) following_error: [f64; AXES],
    /// Number of the newest cutting load, and the setpoint that first used it.
    load_seen: (u64, u64),
    /// The change of state of a turning cycle.
    pub(super) turned: Option<Transition>,
}

impl Default for CycleNotes {
    fn default() -> Self {
        Self {
            input_bits: 0,
            phase: None,
            following_error: [f64::NAN; AXES],
            load_seen: (0, 0),
            turned: None,
        }
    }
}

impl CycleNotes {
    /// Records the cutting load that this cycle used; NaN if the sensor has been silent for too long.
    pub(super) fn note_load(&mut self, record: &mut CycleRecord, load: Option<LoadSample>, period_ns: u64) {
        let Some(newest) = load else { return };
        if newest.sequence != self.load_seen.0 {
            self.load_seen = (newest.sequence, record.sequence);
            record.inputs |= recorded::LOAD;
        }
        if newest.value >= newest.range_max {
            record.inputs |= recorded::LOAD_AT_END;
        }
        let is_old = (record.sequence - self.load_seen.1).saturating_mul(period_ns) > LOAD_AGE_NS;
        record.load = if is_old { f64::NAN } else { newest.value };
    }

    /// Records the drives' following error.
    pub(super) fn note_following_error(&mut self, presence: Presence, feedback: Option<&Feedback>) {
        if presence == Presence::Absent {
            self.following_error = [f64::NAN; AXES];
        }
        let Some(feedback) = feedback.filter(|feedback| feedback.is_finite()) else {
            return;
        };
        for (i, error) in self.following_error.iter_mut().enumerate() {
            let is_there = AxisMask::from_bits(feedback.axes_mask).contains(i);
            *error = if is_there {
                feedback.following_error[i]
            } else {
                f64::NAN
            };
        }
    }
}
