//! Homing: the sequence of the axes.
//!
//! The axes are homed one after the other, each by its [`HomingMethod`]. Every move has a maximum distance,
//! so a switch that is missing or stuck, or an index pulse that does not come, ends the sequence with an
//! alarm.

use evolvent_machine::HomingMethod;
use evolvent_path::{Axes, AxisLetter, AxisMask};

use crate::axis_homing::AxisHoming;
use crate::rejection::Rejection;

/// How one axis is homed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingAxis {
    /// The axis.
    pub axis: AxisLetter,
    /// How it finds machine zero.
    pub method: HomingMethod,
    /// Position in the sequence, the smallest first; axes with the same number in the order of the axes.
    pub order: u32,
    /// Direction in which the switch or the index pulse is searched: 1 or -1.
    pub direction: f64,
    /// Speed of the search, mm/s or degrees/s.
    pub search_velocity: f64,
    /// Speed of the second approach and of the search for the index pulse.
    pub latch_velocity: f64,
    /// Machine coordinate of the edge at which the switch closes, or of the index pulse.
    pub reference: f64,
    /// Length of the travel.
    pub travel: f64,
    /// Final position of the axis, machine coordinate.
    pub home: f64,
}

/// One sample of the drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingSample {
    /// Time of the sample, ns of any clock.
    pub time_ns: u64,
    /// Actual positions in the coordinates of the drives.
    pub position: Axes,
    /// Bit i set: the home switch of axis i is closed.
    pub switches: AxisMask,
    /// Bit i set: the limit switch of axis i is pressed; at the negative and at the positive end.
    pub limits: [AxisMask; 2],
    /// Bit i set: the position of axis i counts from machine zero.
    pub absolute: AxisMask,
    /// The request for an index pulse that the bridge has accepted; 0 for none.
    pub index_request: u32,
    /// Position of the pulse, once it has come.
    pub index_position: Option<f64>,
}

/// The next action of the caller.
#[derive(Clone, Debug, PartialEq)]
pub enum HomingAction {
    /// Nothing new.
    Wait,
    /// Move one axis, which is at rest, by this distance at this speed. The soft limits do not apply.
    Move {
        /// The axis.
        axis: AxisLetter,
        /// Signed distance.
        distance: f64,
        /// Per s.
        speed: f64,
    },
    /// Stop the axis.
    Stop,
    /// Request the next index pulse of the axis from the bridge.
    LatchIndex {
        /// The axis.
        axis: AxisLetter,
        /// Number of the request.
        request: u32,
    },
    /// The axes are at rest: `position` of the drive is machine coordinate `coordinate`.
    SetZero {
        /// The axis.
        axis: AxisLetter,
        /// In the coordinates of the drive.
        position: f64,
        /// In machine coordinates.
        coordinate: f64,
        /// Distance of the index pulse from the edge of the switch, if both were searched.
        from_switch: Option<f64>,
    },
    /// Take over the position that the drive reports for the axis.
    TakePosition {
        /// The axis.
        axis: AxisLetter,
    },
    /// Move the axis, which is homed, to this machine coordinate.
    Home {
        /// The axis.
        axis: AxisLetter,
        /// Machine coordinate.
        position: f64,
        /// Per s.
        speed: f64,
    },
    /// All axes are homed.
    Done,
    /// The sequence has failed.
    Fail(Rejection),
}

/// The homing sequence.
#[derive(Clone, Debug)]
pub struct Homing {
    axes: Vec<AxisHoming>,
    at: usize,
}

impl Homing {
    /// A sequence of these axes. Requests for index pulses are numbered from `first_request`, one number per
    /// axis.
    #[must_use]
    pub fn new(mut axes: Vec<HomingAxis>, first_request: u32) -> Self {
        axes.sort_by_key(|axis| (axis.order, axis.axis.index()));
        let numbered = axes.into_iter().zip(0..);
        Self {
            axes: numbered
                .map(|(axis, i)| AxisHoming::new(axis, first_request.wrapping_add(i)))
                .collect(),
            at: 0,
        }
    }

    /// The axis that is being homed.
    #[must_use]
    pub fn axis(&self) -> Option<AxisLetter> {
        self.axes.get(self.at).map(|axis| axis.settings().axis)
    }

    /// The limit switches, at negative and positive ends, that the sequence handles itself while an axis
    /// searches its home switch, since one switch may be both. All others stop the axes as always.
    #[must_use]
    pub fn expected_limits(&self) -> [AxisMask; 2] {
        self.axes
            .get(self.at)
            .map_or([AxisMask::NONE; 2], AxisHoming::expected_limits)
    }

    /// Processes one sample of the drives. `at_rest`: the axes are at rest and no order of this sequence is
    /// in progress.
    ///
    /// After [`HomingAction::Done`] and [`HomingAction::Fail`] the sequence is over.
    pub fn step(&mut self, sample: &HomingSample, at_rest: bool) -> HomingAction {
        let Some(axis) = self.axes.get_mut(self.at) else {
            return HomingAction::Done;
        };
        match axis.step(sample, at_rest) {
            HomingAction::Done => {
                self.at += 1;
                if self.at == self.axes.len() {
                    HomingAction::Done
                } else {
                    HomingAction::Wait
                }
            }
            action => action,
        }
    }
}

#[cfg(test)]
mod tests;
