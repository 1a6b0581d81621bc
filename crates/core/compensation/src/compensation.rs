//! The corrections of a machine, one step per cycle.

use evolvent_path::{AXES, Axes, Jet};

use crate::axis_compensation::AxisCompensation;
use crate::squareness::Squareness;

/// Converts ideal setpoints into corrected ones. Created by
/// [`Design::compensation`](crate::Design::compensation).
///
/// Call [`step`](Self::step) once per cycle, also at rest: a running take-up of the backlash then continues
/// to its end.
#[derive(Clone, Debug)]
pub struct Compensation {
    squareness: Squareness,
    axes: [Option<AxisCompensation>; AXES],
}

impl Compensation {
    pub(crate) fn new(squareness: Squareness, axes: [Option<AxisCompensation>; AXES]) -> Self {
        Self { squareness, axes }
    }

    /// Sets the thermal offset of an axis in mm or degrees, clamped to the maximum of its settings; the next
    /// steps follow it at the permitted rate. No effect on an axis without thermal offset. Real-time safe.
    pub fn set_thermal_offset(&mut self, axis: usize, offset: f64) {
        if let Some(Some(axis)) = self.axes.get_mut(axis) {
            axis.set_thermal_offset(offset);
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

    /// The corrected position that belongs to an ideal one for the present directions and offsets: the
    /// position of the drives if the machine were at rest there. Real-time safe.
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

    /// The position of the tool when the drives are at `corrected`, for the present directions and offsets.
    /// Real-time safe.
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

    /// Changes the coordinates of the present position to `position`, at rest. Directions are kept. Real-time
    /// safe.
    pub fn rebase_position(&mut self, position: &Axes) {
        let slides = self.squareness.slides(position);
        for (i, axis) in self.axes.iter_mut().enumerate() {
            if let Some(axis) = axis {
                axis.rebase_position(slides[i]);
            }
        }
    }
}
