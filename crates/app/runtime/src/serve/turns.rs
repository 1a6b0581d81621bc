//! Unlimited rotary axes: where they rest far from zero, whole turns are taken off their coordinates.

use evolvent_drive::Presence;
use evolvent_motion::State;
use evolvent_path::{AxisLetter, whole_turns};

use super::operator::{Job, Operator};
use crate::news::ExternalEventKind;

/// Farther than this an axis does not rest, degrees: a hundred turns. A double tells 7e-12 degrees apart there.
const FAR_DEG: f64 = 36_000.0;
/// Of the command that such an event belongs to: none.
const NO_COMMAND: u32 = 0;

impl Operator {
    /// Takes whole turns off coordinates that have grown, where nothing moves and nothing is about to. The drives take that over as
    /// they take the datum of homing, without motion.
    pub(super) fn remove_whole_turns(&mut self) {
        if self.unlimited.is_empty() || !matches!(self.job, Job::None) || !self.is_idle() {
            return;
        }
        let view = &self.view;
        // What was ordered is carried out, and drives that are there follow, so that they take the new names over.
        let is_settled = view.datum >= self.drives.datum && matches!(view.setpoint.state, State::Idle);
        let follow = matches!(view.presence, Presence::Operational | Presence::Absent);
        if !is_settled || !follow || self.stops.ending {
            return;
        }
        let here = view.setpoint.position;
        let mut renamed = here;
        let mut removed = Vec::new();
        for axis in self.unlimited.axes() {
            if here[axis].abs() > FAR_DEG {
                let turns = whole_turns(here[axis]);
                renamed[axis] -= turns;
                self.drives.home_offset[axis] += turns;
                removed.push(format!("{turns} degrees off {}", AxisLetter::ALL[axis].letter()));
            }
        }
        if renamed == here {
            return;
        }
        self.drives.datum = view.datum + 1;
        self.drives.renaming = renamed - here;
        self.view.setpoint.position = renamed;
        self.relocate(renamed, true);
        let text = format!("whole turns: {}", removed.join(", "));
        self.record(ExternalEventKind::Command, NO_COMMAND, text, None);
    }
}
