//! The corrections of a machine, cycle by cycle.

use evolvent_path::{AXES, Axes, Jet};

use crate::axis_compensation::AxisCompensation;
use crate::squareness::Squareness;

/// From ideal setpoints to corrected ones. Made by [`Design::compensation`](crate::Design::compensation).
///
/// One step a cycle, also at rest: a take-up goes on there to its end.
#[derive(Clone, Debug)]
pub struct Compensation {
    squareness: Squareness,
    axes: [Option<AxisCompensation>; AXES],
}

impl Compensation {
    pub(crate) fn new(squareness: Squareness, axes: [Option<AxisCompensation>; AXES]) -> Self {
        Self { squareness, axes }
    }

    /// The offset of an axis that is to be followed from the next step on, mm or degrees; within the largest of the settings. Of an
    /// axis without thermal offset it counts for nothing. Real-time safe.
    pub fn aim_thermal(&mut self, axis: usize, offset: f64) {
        if let Some(Some(axis)) = self.axes.get_mut(axis) {
            axis.aim_thermal(offset);
        }
    }

    /// The corrected setpoint of this cycle: position and three derivatives by time. Real-time safe.
    pub fn step(&mut self, ideal: &Jet) -> Jet {
        let mut corrected = Jet {
            position: self.squareness.slides(&ideal.position),
            first: self.squareness.slides(&ideal.first),
            second: self.squareness.slides(&ideal.second),
            third: self.squareness.slides(&ideal.third),
        };
        for (i, axis) in self.axes.iter_mut().enumerate() {
            let Some(axis) = axis else { continue };
            [
                corrected.position[i],
                corrected.first[i],
                corrected.second[i],
                corrected.third[i],
            ] = axis.step([
                corrected.position[i],
                corrected.first[i],
                corrected.second[i],
                corrected.third[i],
            ]);
        }
        corrected
    }

    /// The corrected position of an ideal one, as directions and offsets stand: where the last step would have left the drives if the
    /// machine rested there. Real-time safe.
    #[must_use]
    pub fn corrected_position(&self, ideal: &Axes) -> Axes {
        let mut corrected = self.squareness.slides(ideal);
        for (i, axis) in self.axes.iter().enumerate() {
            if let Some(axis) = axis {
                corrected[i] = axis.corrected(corrected[i]);
            }
        }
        corrected
    }

    /// Where the tool is when the drives are at `corrected`, as directions and offsets stand. Real-time safe.
    #[must_use]
    pub fn ideal_position(&self, corrected: &Axes) -> Axes {
        let mut slides = *corrected;
        for (i, axis) in self.axes.iter().enumerate() {
            if let Some(axis) = axis {
                slides[i] = axis.ideal(slides[i]);
            }
        }
        self.squareness.tool(&slides)
    }

    /// At rest: the same place has other coordinates. The directions stay. Real-time safe.
    pub fn relocate(&mut self, position: &Axes) {
        let slides = self.squareness.slides(position);
        for (i, axis) in self.axes.iter_mut().enumerate() {
            if let Some(axis) = axis {
                axis.relocate(slides[i]);
            }
        }
    }
}
