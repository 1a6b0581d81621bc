//! An involute: the curve of the end of a taut thread that unwinds from a circle.

use evolvent_path::{Axes, Involute, Sense};

use crate::measure::{linear, rotary};

/// With base circle r about c and roll angle phi, the thread's direction at theta = theta0 + h phi:
/// p = c + r (cos theta + h phi sin theta, sin theta - h phi cos theta), h = 1 counter-clockwise, -1
/// clockwise on the way out; the path from the base circle is r phi^2 / 2 long.
#[derive(Clone, Debug)]
pub(crate) struct InvolutePiece {
    axes: [usize; 2],
    inner: Axes,
    along: Axes,
    centre: [f64; 2],
    base: f64,
    angle: f64,
    handed: f64,
    /// Roll angle at the inner end.
    roll: f64,
    /// In-plane length.
    planar: f64,
    /// Deviation of the programmed end from the curve, distributed over its length.
    gap: [f64; 2],
    inward: bool,
    length: f64,
}

impl InvolutePiece {
    pub(crate) fn of(involute: &Involute, sense: Sense, start: Axes, end: Axes) -> Self {
        let (first, second, _) = involute.plane().axes();
        let centre = involute.centre_mm();
        let base = involute.base_radius_mm();
        let inward = involute.is_inward();
        let (from, to) = involute.roll_angles_rad();
        let (inner, outer, roll, last) = if inward {
            (end, start, to, from)
        } else {
            (start, end, from, to)
        };
        let handed = if inward { -sense.sign() } else { sense.sign() };
        let arm = [inner[first] - centre[0], inner[second] - centre[1]];
        let angle = libm::atan2(arm[1], arm[0]) - handed * (roll - libm::atan(roll));
        let planar = 0.5 * base * (last - roll) * (last + roll);
        let mut unrolled = Self {
            axes: [first, second],
            inner,
            along: outer - inner,
            centre,
            base,
            angle,
            handed,
            roll,
            planar,
            gap: [0.0, 0.0],
            inward,
            length: planar,
        };
        let met = unrolled.outward(planar);
        unrolled.gap = [outer[first] - met[first], outer[second] - met[second]];
        let mut others = unrolled.along;
        others[first] = planar + libm::hypot(unrolled.gap[0], unrolled.gap[1]);
        others[second] = 0.0;
        unrolled.length = linear(&others).max(rotary(&others));
        unrolled
    }

    pub(crate) fn length(&self) -> f64 {
        self.length
    }

    fn fraction(&self, u: f64) -> f64 {
        let x = u / self.length;
        if self.inward { 1.0 - x } else { x }
    }

    fn theta(&self, s: f64) -> (f64, f64) {
        let roll = (self.roll * self.roll + 2.0 * s / self.base).max(0.0).sqrt();
        (roll, self.angle + self.handed * roll)
    }

    fn outward(&self, s: f64) -> Axes {
        let (roll, theta) = self.theta(s);
        let (sin, cos) = libm::sincos(theta);
        let x = s / self.planar;
        let thread = self.handed * roll;
        let mut point = self.inner + self.along * x;
        point[self.axes[0]] = self.centre[0] + self.base * (cos + thread * sin) + self.gap[0] * x;
        point[self.axes[1]] = self.centre[1] + self.base * (sin - thread * cos) + self.gap[1] * x;
        point
    }

    pub(crate) fn point(&self, u: f64) -> Axes {
        self.outward(self.fraction(u) * self.planar)
    }

    pub(crate) fn tangent(&self, u: f64) -> Axes {
        let (_, theta) = self.theta(self.fraction(u) * self.planar);
        let (sin, cos) = libm::sincos(theta);
        let mut tangent = self.along;
        tangent[self.axes[0]] = self.planar * cos + self.gap[0];
        tangent[self.axes[1]] = self.planar * sin + self.gap[1];
        tangent * (if self.inward { -1.0 } else { 1.0 } / self.length)
    }
}
