//! Velocity, acceleration and jerk as differences of positions, compared with the limits of every axis.

use evolvent_machine::Machine;
use evolvent_path::{AXES, Axes};

/// Ratios of one setpoint's differences to the limits, each for the worst axis.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Ratios {
    /// Velocity, acceleration, jerk: ratio and axis.
    pub(crate) orders: [(f64, usize); 3],
    /// Change of acceleration over three periods, relative to the change that the jerk limit permits in three
    /// periods plus the joint time. A step takes two periods to appear in second differences, and three at
    /// any phase.
    pub(crate) joint: (f64, usize),
    /// Distance between the chord of the middle two of the last four setpoints and the curve through them,
    /// mm.
    pub(crate) chord_mm: f64,
    /// Distance beyond the travel, mm or degrees.
    pub(crate) beyond: (f64, usize),
}

/// Keeps the last four positions.
#[derive(Clone, Debug)]
pub(crate) struct Differences {
    last: [Axes; 4],
    /// The last four second differences.
    bends: [Axes; 4],
    limits: [Axes; 3],
    travel: [Axes; 2],
    present: [bool; AXES],
    period_s: f64,
    joint_time_s: f64,
}

impl Differences {
    /// Starts with a machine that has been at rest at `start`.
    pub(crate) fn new(machine: &Machine, period_s: f64, start: Axes) -> Self {
        let limits = machine.limits();
        Self {
            last: [start; 4],
            bends: [Axes::zeros(); 4],
            limits: [limits.velocity, limits.acceleration, limits.jerk],
            travel: [limits.travel_min, limits.travel_max],
            present: limits.present,
            period_s,
            joint_time_s: machine.path.joint_time_s,
        }
    }

    pub(crate) fn push(&mut self, position: &Axes) -> Ratios {
        self.last.rotate_left(1);
        self.last[3] = *position;
        self.bends.rotate_left(1);
        let mut ratios = Ratios::default();
        let t = self.period_s;
        for axis in 0..AXES {
            let [d, c, b, a] = [0, 1, 2, 3].map(|i: usize| self.last[i][axis]);
            // This order rounds least: differences of neighbours are exact or nearly so.
            let (now, before, first) = (a - b, b - c, c - d);
            let differences = [now, now - before, (now - before) - (before - first)];
            // One unit in the last place of the largest position, for each unit of the differences' weights.
            let size = a.abs().max(b.abs()).max(c.abs()).max(d.abs());
            let rounding = f64::EPSILON * size;
            for order in 0..3 {
                let noise = rounding * [2.0, 4.0, 8.0][order];
                let difference = (differences[order].abs() - noise).max(0.0);
                let limit = if self.present[axis] {
                    self.limits[order][axis]
                } else {
                    0.0
                };
                let ratio = over(difference / [t, t * t, t * t * t][order], limit);
                ratios.orders[order] = worse(ratios.orders[order], (ratio, axis));
                if order == 1 {
                    self.bends[3][axis] = differences[1];
                }
                if order == 2 {
                    let change = (self.bends[3][axis] - self.bends[0][axis]).abs();
                    let allowed = limit * (self.joint_time_s + 3.0 * t);
                    let ratio = over((change - noise).max(0.0) / (t * t), allowed);
                    ratios.joint = worse(ratios.joint, (ratio, axis));
                }
            }
            if self.present[axis] {
                let beyond = (self.travel[0][axis] - a).max(a - self.travel[1][axis]);
                ratios.beyond = worse(ratios.beyond, (beyond, axis));
            }
        }
        ratios.chord_mm = self.chord();
        ratios
    }

    /// Chord error: the cubic through four positions, half-way between the middle two, minus the midpoint of
    /// their chord, perpendicular to the chord.
    fn chord(&self) -> f64 {
        let [d, c, b, a] = [0, 1, 2, 3].map(|i: usize| self.last[i].fixed_rows::<3>(0).into_owned());
        let along = b - c;
        let off = ((c - d) - (a - b)) / 16.0;
        let size = along.norm();
        if size > 0.0 {
            let unit = along / size;
            (off - unit * off.dot(&unit)).norm()
        } else {
            off.norm()
        }
    }
}

fn over(value: f64, limit: f64) -> f64 {
    if value > 0.0 { value / limit } else { 0.0 }
}

fn worse(a: (f64, usize), b: (f64, usize)) -> (f64, usize) {
    if b.0 > a.0 { b } else { a }
}
