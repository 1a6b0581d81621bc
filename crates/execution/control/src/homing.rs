//! Finding machine zero: the sequence of the axes.
//!
//! One axis after the other, each as [`HomingMethod`] says. Every way has an end, so a switch that is missing
//! or stuck, or an index pulse that does not come, ends the sequence with an alarm.

use evolvent_machine::HomingMethod;
use evolvent_path::{Axes, AxisLetter, AxisMask};

use crate::axis_homing::AxisHoming;
use crate::rejection::Rejection;

/// How one axis is homed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingAxis {
    /// The axis.
    pub axis: AxisLetter,
    /// By what it finds machine zero.
    pub method: HomingMethod,
    /// Its place in the sequence, the smallest first; equal ones in the order of the axes.
    pub order: u32,
    /// Where the switch, or the index pulse, is searched: 1 or -1.
    pub direction: f64,
    /// Speed of search, mm/s or degrees/s.
    pub search_velocity: f64,
    /// Speed of the second approach, and at which the index pulse is searched.
    pub latch_velocity: f64,
    /// Machine coordinate of what is found: of the edge at which the switch closes, or of the index pulse.
    pub reference: f64,
    /// Length of the travel.
    pub travel: f64,
    /// Where the axis goes in the end, machine coordinate.
    pub home: f64,
}

/// What the drives say, one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingSample {
    /// When it was taken, ns of any clock.
    pub time_ns: u64,
    /// Actual positions in the drives' own coordinates.
    pub position: Axes,
    /// Bit i set: the home switch of axis i is closed.
    pub switches: AxisMask,
    /// Bit i set: the limit switch at the negative, and at the positive end of axis i is pressed.
    pub limits: [AxisMask; 2],
    /// Bit i set: the position of axis i counts from machine zero.
    pub absolute: AxisMask,
    /// The request for an index pulse that the bridge has taken over; 0 for none.
    pub index_request: u32,
    /// Where the pulse was, once it has come.
    pub index_position: Option<f64>,
}

/// What is to be done next.
#[derive(Clone, Debug, PartialEq)]
pub enum HomingAction {
    /// Nothing new.
    Wait,
    /// Move one axis by so much at this speed; the axes rest. The soft limits do not count.
    Move {
        /// The axis.
        axis: AxisLetter,
        /// With its sign.
        distance: f64,
        /// Per s.
        speed: f64,
    },
    /// Bring the axis to rest.
    Stop,
    /// Have the next index pulse of the axis latched.
    LatchIndex {
        /// The axis.
        axis: AxisLetter,
        /// Number of the request.
        request: u32,
    },
    /// The axes rest: machine coordinate `coordinate` is where the drive says `position`.
    SetZero {
        /// The axis.
        axis: AxisLetter,
        /// In the drive's coordinates.
        position: f64,
        /// In machine coordinates.
        coordinate: f64,
        /// How far from the switch's edge the index pulse was, where both were looked for.
        from_switch: Option<f64>,
    },
    /// The axis is where its drive says.
    TakePosition {
        /// The axis.
        axis: AxisLetter,
    },
    /// Move the axis, whose zero is known, to this machine coordinate.
    Home {
        /// The axis.
        axis: AxisLetter,
        /// Machine coordinate.
        position: f64,
        /// Per s.
        speed: f64,
    },
    /// All are homed.
    Done,
    /// It cannot be done.
    Fail(Rejection),
}

/// The sequence.
#[derive(Clone, Debug)]
pub struct Homing {
    axes: Vec<AxisHoming>,
    at: usize,
}

impl Homing {
    /// A sequence of these axes. Requests for index pulses are numbered from `first_request` on, one for each
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

    /// The axis at work.
    #[must_use]
    pub fn axis(&self) -> Option<AxisLetter> {
        self.axes.get(self.at).map(|axis| axis.settings().axis)
    }

    /// Limit switches, at negative and positive ends, that the sequence itself looks at: where the axis at
    /// work searches its home switch, since one switch may be both. All others stop the axes as always.
    #[must_use]
    pub fn expected_limits(&self) -> [AxisMask; 2] {
        self.axes
            .get(self.at)
            .map_or([AxisMask::NONE; 2], AxisHoming::expected_limits)
    }

    /// Goes on with one sample of the drives. `at_rest`: the axes rest and no order of this sequence is under
    /// way.
    ///
    /// After [`HomingAction::Done`] and [`HomingAction::Fail`] it is over.
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
