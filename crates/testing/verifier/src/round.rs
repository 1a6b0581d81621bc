//! An arc or a helix, whose radius may change linearly.

use evolvent_path::{Arc, Axes};

use crate::measure::{linear, rotary};

/// An arc about a centre, all other axes in proportion to the angle.
#[derive(Clone, Debug)]
pub(crate) struct Round {
    axes: [usize; 2],
    start: Axes,
    along: Axes,
    centre: [f64; 2],
    angle: f64,
    sweep: f64,
    radius: f64,
    drift: f64,
    length: f64,
}

impl Round {
    pub(crate) fn of(arc: &Arc, start: Axes, end: Axes) -> Self {
        let (first, second, _) = arc.plane().axes();
        let centre = arc.centre_mm();
        let arm = |point: &Axes| [point[first] - centre[0], point[second] - centre[1]];
        let (from, to) = (arm(&start), arm(&end));
        let radius = libm::hypot(from[0], from[1]);
        let drift = libm::hypot(to[0], to[1]) - radius;
        let sweep = arc.sweep_rad();
        let along = end - start;
        let mut others = along;
        others[first] = drift;
        others[second] = radius.max(radius + drift) * sweep;
        // The largest distance of any group of axes, so that no point moves faster than the parameter.
        let length = linear(&others).max(rotary(&others));
        Self {
            axes: [first, second],
            start,
            along,
            centre,
            angle: libm::atan2(from[1], from[0]),
            sweep,
            radius,
            drift,
            length,
        }
    }

    pub(crate) fn length(&self) -> f64 {
        self.length
    }

    pub(crate) fn point(&self, u: f64) -> Axes {
        let x = u / self.length;
        let (sin, cos) = libm::sincos(self.angle + self.sweep * x);
        let radius = self.radius + self.drift * x;
        let mut point = self.start + self.along * x;
        point[self.axes[0]] = self.centre[0] + radius * cos;
        point[self.axes[1]] = self.centre[1] + radius * sin;
        point
    }

    pub(crate) fn tangent(&self, u: f64) -> Axes {
        let x = u / self.length;
        let (sin, cos) = libm::sincos(self.angle + self.sweep * x);
        let radius = self.radius + self.drift * x;
        let mut tangent = self.along;
        tangent[self.axes[0]] = self.drift * cos - radius * self.sweep * sin;
        tangent[self.axes[1]] = self.drift * sin + radius * self.sweep * cos;
        tangent / self.length
    }
}
