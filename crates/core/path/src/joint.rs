//! Where two curves meet.

use std::f64::consts::PI;

use crate::jet::xyz;
use crate::{Axes, Jet};

/// The left and the right jet at a joint of two curves, by arc length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// End of the curve before.
    pub left: Jet,
    /// Start of the curve after.
    pub right: Jet,
    /// Angle between the two tangents in rad, 0..=pi.
    ///
    /// Of XYZ where XYZ moves on both sides, of all axes where it moves on neither; pi (a full stop) where it
    /// moves on one side only.
    pub angle_rad: f64,
    /// Jump of the second derivative by arc length, right less left; infinite at an involute's base-circle point.
    pub second_jump: Axes,
    /// Distance between the two points: the largest over the axes, in mm or degrees.
    pub gap: f64,
}

/// How smoothly two curves meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum JointKind {
    /// The tangent turns at once: velocity would jump at any speed.
    Corner,
    /// Equal tangents, different second derivatives: acceleration would jump.
    Tangent,
    /// Equal tangents and second derivatives: acceleration is continuous.
    Curvature,
}

impl Joint {
    /// Compares two jets, given by any regular parameter. Cycle: yes.
    #[must_use]
    pub fn between(left: &Jet, right: &Jet) -> Self {
        let (left, right) = (left.by_arc_length(), right.by_arc_length());
        let (a, b) = (left.tangent(), right.tangent());
        let angle_rad = match (a.norm() > 0.0, b.norm() > 0.0) {
            (true, true) => angle((a - b).norm(), (a + b).norm()),
            (false, false) => {
                let (a, b) = (unit(&left.first), unit(&right.first));
                angle((a - b).norm(), (a + b).norm())
            }
            _ => PI,
        };
        Self {
            angle_rad,
            second_jump: right.second - left.second,
            gap: (right.position - left.position).amax(),
            left,
            right,
        }
    }

    /// Jump of the curvature vector of the XYZ curve in 1/mm.
    #[must_use]
    pub fn curvature_jump(&self) -> f64 {
        xyz(&self.second_jump).norm()
    }

    /// How smooth the joint is, with the angle up to which tangents count as equal in rad, and the jump up to
    /// which second derivatives do, on every axis (1/mm, or degrees per mm^2).
    #[must_use]
    pub fn kind(&self, angle_tolerance_rad: f64, second_tolerance: f64) -> JointKind {
        // Written so that a NaN counts as the worst case.
        if !(self.angle_rad <= angle_tolerance_rad) {
            JointKind::Corner
        } else if !self.second_jump.iter().all(|jump| jump.abs() <= second_tolerance) {
            JointKind::Tangent
        } else {
            JointKind::Curvature
        }
    }
}

/// The angle between two unit vectors from their difference and sum: exact near 0 and pi, where the arc cosine
/// of the scalar product loses half the digits (Kahan, "How futile are mindless assessments of roundoff", 2006).
fn angle(difference: f64, sum: f64) -> f64 {
    2.0 * libm::atan2(difference, sum)
}

fn unit(axes: &Axes) -> Axes {
    let norm = axes.norm();
    if norm > 0.0 { axes / norm } else { Axes::zeros() }
}
