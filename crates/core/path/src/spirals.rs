//! Other paths that clear a hole, for comparison with the involute: half circles, Archimedean spiral, helix.
//!
//! All lengths refer to the tool centre. [`Hole`](crate::Hole) mills along involutes only; programs with
//! these paths serve as benchmarks.

use std::f64::consts::{PI, TAU};

/// A spiral whose distance from the centre is proportional to the angle: `rho = pitch theta / (2 pi)`.
///
/// It meets the final circle at an angle of `atan(pitch / (2 pi R))`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Archimedean {
    /// Radial growth per turn, mm.
    pub pitch_mm: f64,
    /// Distance from the centre at the start, mm.
    pub from_mm: f64,
    /// Distance from the centre at the end, mm.
    pub to_mm: f64,
}

impl Archimedean {
    /// Angles of start and end, rad.
    #[must_use]
    pub fn angles_rad(&self) -> (f64, f64) {
        let growth = self.pitch_mm / TAU;
        (self.from_mm / growth, self.to_mm / growth)
    }

    /// The position at an angle, mm relative to the centre.
    #[must_use]
    pub fn at(&self, angle_rad: f64) -> [f64; 2] {
        let rho = self.pitch_mm / TAU * angle_rad;
        let (sin, cos) = libm::sincos(angle_rad);
        [rho * cos, rho * sin]
    }

    /// Length in mm, in closed form: `a/2 (theta sqrt(1 + theta^2) + asinh theta)`, where `a` is the growth
    /// per radian.
    #[must_use]
    pub fn length_mm(&self) -> f64 {
        let (from, to) = self.angles_rad();
        let part = |angle: f64| angle * libm::sqrt(1.0 + angle * angle) + libm::asinh(angle);
        0.5 * self.pitch_mm / TAU * (part(to) - part(from))
    }

    /// Angles of a polyline that deviates from the spiral by at most `tolerance_mm`, from start to end.
    #[must_use]
    pub fn polyline_rad(&self, tolerance_mm: f64) -> Vec<f64> {
        let (mut angle, end) = self.angles_rad();
        let growth = self.pitch_mm / TAU;
        let mut angles = vec![angle];
        while angle < end {
            // The radius of curvature exceeds half the growth per radian everywhere and approaches the
            // distance far out.
            let square = 1.0 + angle * angle;
            let radius = growth * square * libm::sqrt(square) / (1.0 + square);
            let step = libm::sqrt(8.0 * tolerance_mm * radius) / (growth * libm::sqrt(square));
            angle = (angle + step.min(0.5)).min(end);
            angles.push(angle);
        }
        angles
    }
}

/// Radii in mm of the half circles that fill a circle of `radius_mm` in this number of turns, in ascending
/// order. They alternate between two centres; at each joint the tangent is continuous and the curvature
/// steps.
#[must_use]
pub fn half_circle_radii_mm(radius_mm: f64, turns: u32) -> Vec<f64> {
    let count = 2 * turns;
    (1..=count)
        .map(|k| radius_mm * f64::from(k) / f64::from(count))
        .collect()
}

/// Length of the half circles in mm: `pi` times the sum of their radii.
#[must_use]
pub fn half_circles_length_mm(radius_mm: f64, turns: u32) -> f64 {
    PI * half_circle_radii_mm(radius_mm, turns).iter().sum::<f64>()
}

/// Length in mm of a helix of this radius and depth, at the given pitch per turn rounded down to whole turns.
#[must_use]
pub fn helix_length_mm(radius_mm: f64, depth_mm: f64, pitch_mm: f64) -> f64 {
    let turns = (depth_mm / pitch_mm - 1e-9).ceil().max(1.0);
    turns * libm::hypot(TAU * radius_mm, depth_mm / turns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closed_form_lengths_agree_with_fine_polylines() {
        for (pitch_mm, from_mm, to_mm) in [(3.95, 0.0, 79.0), (4.0, 12.5, 80.0), (0.2, 0.0, 3.0)] {
            let spiral = Archimedean {
                pitch_mm,
                from_mm,
                to_mm,
            };
            let angles = spiral.polyline_rad(1e-7);
            let sum: f64 = angles
                .windows(2)
                .map(|pair| {
                    let (a, b) = (spiral.at(pair[0]), spiral.at(pair[1]));
                    libm::hypot(b[0] - a[0], b[1] - a[1])
                })
                .sum();
            assert!((sum / spiral.length_mm() - 1.0).abs() < 1e-6, "{sum}");
            // The distance of each chord's middle from the spiral, sampled densely.
            let tolerance = 1e-3;
            for pair in spiral.polyline_rad(tolerance).windows(2) {
                let (a, b) = (spiral.at(pair[0]), spiral.at(pair[1]));
                let middle = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
                let off = (0..=100)
                    .map(|i| spiral.at(pair[0] + (pair[1] - pair[0]) * f64::from(i) / 100.0))
                    .map(|p| libm::hypot(p[0] - middle[0], p[1] - middle[1]))
                    .fold(f64::INFINITY, f64::min);
                assert!(off <= 1.3 * tolerance, "{off} at {pair:?}");
            }
        }
        // 40 half circles of 1.975 mm to 79 mm.
        assert!((half_circles_length_mm(79.0, 20) - PI * 1.975 * 820.0).abs() < 1e-9);
        assert!((helix_length_mm(30.0, 10.0, 3.0) - 4.0 * libm::hypot(TAU * 30.0, 2.5)).abs() < 1e-12);
    }
}
