//! The interval between two stations of the time law.

/// Number of stations per interval.
pub(super) const STATIONS: usize = 2;
/// Number of coefficients of the time law that affect an interval.
pub(super) const LAW: usize = STATIONS + 2;

/// The interval between two stations: time law and path as functions of their coefficients at both ends.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    pub(super) width: f64,
    /// Derivatives of `a` and `b` by three coefficients of the law, at both ends; of `c`; of `a` in the
    /// middle.
    pub(super) a: [[f64; 3]; 2],
    pub(super) b: [[f64; 3]; 2],
    pub(super) c: [f64; 3],
    pub(super) middle: [f64; 3],
    /// First to third derivative of the four basis functions, at both ends.
    pub(super) path: [[[f64; 4]; 3]; 2],
    /// Upper bound of `a`.
    pub(super) cap: f64,
}

/// Jerk, acceleration and velocity of one axis at one end of an interval, relative to the limits.
#[derive(Clone, Copy)]
pub(super) struct Motion {
    pub(super) q: [f64; 3],
    pub(super) jerk: f64,
    pub(super) acceleration: f64,
    pub(super) velocity2: f64,
}

pub(super) fn of3(weights: &[f64; 3], values: &[f64]) -> f64 {
    weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2]
}

pub(super) fn of4(weights: &[f64; 4], values: &[f64; 4]) -> f64 {
    weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2] + weights[3] * values[3]
}

impl Cell {
    pub(super) fn motion(&self, end: usize, law: [f64; 3], points: &[f64; 4], scale: [f64; 3]) -> Motion {
        let q: [f64; 3] = std::array::from_fn(|order| of4(&self.path[end][order], points));
        let [a, b, c] = law;
        let v = q[0] * scale[0];
        Motion {
            q,
            jerk: a.sqrt() * (q[2] * a + 3.0 * q[1] * b + q[0] * c) * scale[2],
            acceleration: (q[1] * a + q[0] * b) * scale[1],
            velocity2: a * v * v,
        }
    }

    pub(super) fn law(&self, end: usize, alpha: &[f64]) -> [f64; 3] {
        [
            of3(&self.a[end], alpha),
            of3(&self.b[end], alpha),
            of3(&self.c, alpha),
        ]
    }
}
