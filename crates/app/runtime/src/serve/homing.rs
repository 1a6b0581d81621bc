//! The homing sequence on the operator's side.

use std::fmt::Write as _;

use evolvent_bus::Feedback;
use evolvent_control::{
    Activity, Alarm, CommandCode, Homing, HomingAction, HomingAxis, HomingSample, JobResult, Rejection,
};
use evolvent_drive::{IndexRequest, Presence};
use evolvent_machine::HomingMethod;
use evolvent_path::{Axes, AxisLetter, AxisMask, TURN_DEG};
use evolvent_transfer::AxesState;

use super::drive_view::Renaming;
use super::jog::{FOR_EVER, JogPlan, limits_here};
use super::jog_intent::JogIntent;
use super::operator::{Job, Operator};
use super::orders::CycleCommand;
use crate::news::ExternalEventKind;

impl Operator {
    pub(super) fn home(&mut self, wanted: AxisMask) -> Result<u64, Rejection> {
        let machine = &self.setup.machine;
        let axes: Vec<HomingAxis> = machine
            .homing
            .iter()
            .filter(|homing| wanted.contains(homing.axis.index()))
            .map(|homing| {
                let i = homing.axis.index();
                HomingAxis {
                    axis: homing.axis,
                    method: homing.method,
                    order: homing.order,
                    direction: if homing.negative { -1.0 } else { 1.0 },
                    search_velocity: homing.search_velocity,
                    latch_velocity: homing.latch_velocity,
                    reference: homing.reference,
                    travel: if self.unlimited.contains(i) {
                        TURN_DEG
                    } else {
                        self.limits.travel_max[i] - self.limits.travel_min[i]
                    },
                    home: self.limits.home[i],
                }
            })
            .collect();
        if !axes.is_empty() && self.view.presence != Presence::Operational {
            return Err(Rejection::new(
                Alarm::NoFeedback,
                "no bridge replies, so homing is not possible; start the bridge, then switch on",
            ));
        }
        // Axes that are homed again are unhomed until the sequence is complete.
        let unknown = axes.iter().map(|axis| axis.axis.index()).collect::<AxisMask>();
        self.state.set_homed(self.state.homed().without(unknown));
        self.drives.zeroed = AxisMask::NONE;
        self.relocate(self.view.setpoint.position, false);
        self.declare_zero(wanted);
        let number = self.state.job_begins(Activity::Homing);
        if axes.is_empty() && self.drives.zeroed.is_empty() {
            self.state.job_ends(JobResult::Done);
        } else {
            let requests = u32::try_from(axes.len()).unwrap_or(u32::MAX);
            let first_request = self.drives.next_index;
            self.drives.next_index = first_request.wrapping_add(requests).max(1);
            self.job = Job::Homing {
                homing: Homing::new(axes, first_request),
                steered: None,
                cancelled: None,
            };
        }
        Ok(number)
    }

    /// Cancels homing; the job ends with this result once its motion has ended.
    pub(super) fn cancel_homing(&mut self, result: JobResult) {
        if let Job::Homing {
            steered, cancelled, ..
        } = &mut self.job
        {
            // A fault after a stop determines the result.
            if cancelled.is_none() || result == JobResult::Fault {
                *cancelled = Some(result);
            }
            if steered.is_none() {
                self.end_job(result);
            }
        }
    }

    /// Cancels homing and stops its motion.
    pub(super) fn end_homing(&mut self) {
        if let Job::Homing { cancelled, .. } = &self.job {
            if cancelled.is_none() {
                self.message.tell(
                    "homing was stopped: the axes were not at rest when machine zero was to be set; \
                           home again",
                );
            }
            self.cancel_homing(JobResult::Stopped);
            self.order(CycleCommand::Stop);
        }
    }

    /// Axes without `[[homing]]` in the machine file.
    fn without_homing(&self) -> AxisMask {
        let homing = self.setup.machine.homing.iter();
        let homed_by_core = homing.map(|homing| homing.axis.index()).collect::<AxisMask>();
        let axes = self.setup.machine.axes.iter();
        axes.map(|axis| axis.letter.index())
            .collect::<AxisMask>()
            .without(homed_by_core)
    }

    /// Sets machine zero of those axes without `[[homing]]` that are not homed: the operator has moved them
    /// to their home position and declares it. Homed axes keep their coordinates.
    fn declare_zero(&mut self, wanted: AxisMask) {
        let declared = (self.without_homing() & wanted).without(self.state.homed());
        if declared.is_empty() {
            return;
        }
        let (mut renamed, mut home_offset) = (self.view.setpoint.position, self.drives.home_offset);
        for axis in declared.axes() {
            let shift = self.limits.home[axis] - renamed[axis];
            renamed[axis] += shift;
            home_offset[axis] -= shift;
            let letter = AxisLetter::ALL[axis].letter();
            self.record(
                ExternalEventKind::Command,
                CommandCode::Home as u32,
                format!("axis {letter}: its position is declared home, shifted by {shift:.6}"),
                Some(shift),
            );
        }
        self.view.setpoint.position = renamed;
        if self.view.presence == Presence::Absent {
            // Without feedback there are no drives whose coordinates have to follow.
            self.state.set_homed(self.state.homed() | declared);
        }
        self.rename(renamed, declared.without(self.state.homed()), home_offset);
    }

    /// Renames the position of the axes to `position`. The axes in `zeroed` are homed once the feedback shows
    /// it.
    pub(super) fn rename(&mut self, position: Axes, zeroed: AxisMask, home_offset: Axes) {
        let renaming = Renaming {
            datum: self.view.datum + 1,
            zeroed,
            stand: position,
            home_offset,
        };
        let order = self.relocate(position, true);
        self.drives.renames(order, &renaming);
    }

    /// Marks axes as homed once the drives report the new coordinates. Not earlier, because an emergency stop
    /// or a fault may come first.
    pub(super) fn take_zeroed(&mut self, feedback: &Feedback) {
        let machine = &self.setup.machine;
        let tolerance = |axis: usize| {
            let axis = machine.axes.iter().find(|known| known.letter.index() == axis);
            axis.map_or(0.0, |axis| axis.following_error)
        };
        let zeroed = self.drives.take_zeroed(feedback, tolerance);
        if !zeroed.is_empty() {
            self.state.set_homed(self.state.homed() | zeroed);
            let here = self.view.setpoint.position;
            let limits = limits_here(&self.limits, &here, self.state.homed());
            self.order(CycleCommand::Within(limits));
        }
    }

    /// Handles lost references: the drives' positions of these axes may count from another zero.
    pub(super) fn lose_reference(&mut self, sequence: u64, axes: AxisMask) {
        let lost = axes & (self.state.homed() | self.drives.zeroed);
        if lost.is_empty() {
            return;
        }
        self.state.set_homed(self.state.homed().without(lost));
        self.drives.zeroed = self.drives.zeroed.without(lost);
        self.cancel_homing(JobResult::Fault);
        if matches!(self.job, Job::None) {
            self.relocate(self.view.setpoint.position, false);
        }
        let text = reference_lost(lost, lost & self.without_homing(), &self.limits.home);
        // Other alarms of a lost link come first, and their RESET clears this one as well. The message
        // remains and says what to do.
        self.message.tell(&*text);
        self.raise(sequence, Alarm::ReferenceLost, text);
    }

    /// Axes homed by an absolute encoder are no longer homed once their drives no longer report one.
    pub(super) fn watch_absolute(&mut self, absolute: AxisMask) {
        let homing = self.setup.machine.homing.iter();
        let lost = homing
            .filter(|homing| homing.method == HomingMethod::Absolute)
            .map(|homing| homing.axis.index())
            .filter(|axis| self.state.homed().contains(*axis) && !absolute.contains(*axis))
            .collect::<AxisMask>();
        if !lost.is_empty() {
            self.lose_reference(self.view.setpoint.sequence, lost);
        }
    }

    /// Orders the cycle to take `position` as the axes' position, in the coordinates of the present or of a
    /// new datum.
    pub(super) fn relocate(&mut self, position: Axes, renames: bool) -> u64 {
        let limits = limits_here(&self.limits, &position, self.state.homed());
        self.order(CycleCommand::Relocate {
            position,
            limits,
            renames,
        })
    }

    pub(super) fn step_homing(&mut self, sample: &HomingSample) {
        let here = self.view.setpoint.position;
        let at_rest = self.view.at_rest;
        let Job::Homing {
            homing,
            steered,
            cancelled: None,
        } = &mut self.job
        else {
            return;
        };
        let before = homing.expected_limits();
        let action = homing.step(sample, steered.is_none() && at_rest);
        let expected = homing.expected_limits();
        if expected != before {
            // Sent before the motion that it belongs to.
            self.order(CycleCommand::ExpectSwitches(expected));
        }
        match action {
            HomingAction::Wait => {}
            HomingAction::Move {
                axis,
                distance,
                speed,
            } => self.homing_move(axis, here[axis.index()] + distance, speed),
            HomingAction::Home {
                axis,
                position,
                speed,
            } => self.homing_move(axis, position, speed),
            HomingAction::Stop => {
                self.order(CycleCommand::Stop);
            }
            HomingAction::LatchIndex { axis, request } => {
                let (number, axis) = (request, axis.index());
                self.drives.index_axis = Some(axis);
                self.order(CycleCommand::LatchIndex(IndexRequest { number, axis }));
            }
            HomingAction::TakePosition { axis } => {
                self.state
                    .set_homed(self.state.homed() | AxisMask::one(axis.index()));
                self.relocate(here, false);
                let text = format!("axis {}: machine zero is taken from the drive", axis.letter());
                self.record(ExternalEventKind::Command, CommandCode::Home as u32, text, None);
            }
            HomingAction::SetZero {
                axis,
                position,
                coordinate,
                from_switch,
            } => {
                let i = axis.index();
                let shift = coordinate - position;
                let mut renamed = here;
                renamed[i] += shift;
                let mut home_offset = self.drives.home_offset;
                home_offset[i] -= shift;
                self.view.setpoint.position = renamed;
                self.rename(renamed, AxisMask::one(i), home_offset);
                let mut text = format!("axis {}: machine zero set, shifted by {shift:.6}", axis.letter());
                if let Some(from_switch) = from_switch {
                    // Near 0, and near the distance between two pulses, the switch may select another pulse
                    // the next time.
                    let _infallible = write!(text, ", index pulse {from_switch:.6} from the switch");
                }
                self.record(
                    ExternalEventKind::Command,
                    CommandCode::Home as u32,
                    text,
                    Some(shift),
                );
            }
            HomingAction::Done => self.end_job(JobResult::Done),
            HomingAction::Fail(refusal) => {
                let sequence = self.view.setpoint.sequence;
                self.raise(sequence, refusal.alarm, refusal.text);
                self.end_job(JobResult::Fault);
            }
        }
    }

    pub(super) fn homing_move(&mut self, axis: AxisLetter, to: f64, speed: f64) {
        let here = self.view.setpoint.position;
        let limits = limits_here(&self.limits, &here, self.state.homed());
        let i = axis.index();
        let mut target = here;
        target[i] = to.clamp(limits.travel_min[i], limits.travel_max[i]);
        let jog = JogPlan {
            speed: JogPlan::speeds(&limits, AxisMask::one(i), speed),
            slows_down_first: false,
            limits,
            from: AxesState::at_rest(here),
            to: target,
            until_ns: FOR_EVER,
        };
        match self.steer(&jog, JogIntent::none(), None) {
            Ok(begun) => {
                self.book
                    .notes
                    .sends(begun.order, self.state.job(), jog.recorded(false));
                if let Job::Homing { steered, .. } = &mut self.job {
                    *steered = Some(begun);
                }
            }
            Err(refusal) => {
                let sequence = self.view.setpoint.sequence;
                self.raise(sequence, Alarm::HomeSwitchMissing, refusal.text);
                self.end_job(JobResult::Fault);
            }
        }
    }
}

/// The text of alarm 418; it fits into the status for any set of axes. `by_hand` are those axes of `lost`
/// without `[[homing]]`.
fn reference_lost(lost: AxisMask, by_hand: AxisMask, home: &Axes) -> String {
    let letter = |axis: usize| AxisLetter::ALL[axis].letter();
    let lost: String = lost.axes().map(letter).collect();
    let mut text = format!("the link to drives {lost} was lost or positions jumped: home {lost} again");
    if !by_hand.is_empty() {
        // Rounded to a micrometre: positions converted from inches have more decimals than anybody can jog
        // to.
        let homes: Vec<String> = by_hand
            .axes()
            .map(|axis| format!("{}{}", letter(axis), (home[axis] * 1000.0).round() / 1000.0))
            .collect();
        let _infallible = write!(
            text,
            "; jog to {} first (without [[homing]], HOME only declares it)",
            homes.join(" ")
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use evolvent_bus::SENTENCE_BYTES;

    use super::*;

    #[test]
    fn a_lost_reference_text_of_all_axes_fits_the_status() {
        let all = (0..AxisLetter::ALL.len()).collect::<AxisMask>();
        let home = Axes::from([-12_345.678_912_345; AxisLetter::ALL.len()]);
        let text = reference_lost(all, all, &home);
        assert!(text.len() <= SENTENCE_BYTES, "{} bytes: {text}", text.len());
        assert!(
            text.ends_with(" W-12345.679 first (without [[homing]], HOME only declares it)"),
            "{text}"
        );
        let two = [0, 2].into_iter().collect::<AxisMask>();
        assert_eq!(
            reference_lost(two, AxisMask::one(2), &Axes::default()),
            "the link to drives XZ was lost or positions jumped: home XZ again; jog to Z0 first (without \
             [[homing]], HOME only declares it)"
        );
    }
}
