//! Ordinary and degenerate curves.

#![expect(
    clippy::expect_used,
    clippy::too_many_arguments,
    reason = "the gallery is a fixture of the tests"
)]

use evolvent_path::{Arc, Axes, Blend, Curve, Involute, Jet, Line, Plane, Sense};

/// A curve of the gallery.
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) curve: Curve,
    /// Largest magnitude among the inputs.
    pub(crate) scale: f64,
}

pub(crate) fn axes(values: &[f64]) -> Axes {
    let mut axes = Axes::zeros();
    for (axis, value) in axes.iter_mut().zip(values) {
        *axis = *value;
    }
    axes
}

pub(crate) fn arc(
    name: &'static str,
    plane: Plane,
    start: Axes,
    end: Axes,
    centre: [f64; 2],
    sense: Sense,
    turns: u32,
    scale: f64,
) -> Case {
    let curve = Arc::new(plane, start, end, centre, sense, turns)
        .expect(name)
        .into();
    Case { name, curve, scale }
}

/// An involute by definition: base circle, direction of its start on the base circle, roll angles.
pub(crate) struct Rolled {
    pub(crate) plane: Plane,
    pub(crate) centre: [f64; 2],
    pub(crate) r: f64,
    pub(crate) root: f64,
    pub(crate) phi: [f64; 2],
    pub(crate) climb: f64,
    pub(crate) rest: f64,
    pub(crate) handed: f64,
}

impl Rolled {
    /// Equation (2) of the paper, shifted and rotated: the independent formula.
    pub(crate) fn point(&self, phi: f64) -> Axes {
        let (sin, cos) = (self.handed * phi + self.root).sin_cos();
        let (first, second, normal) = self.plane.axes();
        let fraction = (phi * phi - self.phi[0] * self.phi[0]) / (self.phi[1].powi(2) - self.phi[0].powi(2));
        let mut p = Axes::repeat(self.rest * fraction);
        p[first] = self.centre[0] + self.r * (cos + self.handed * phi * sin);
        p[second] = self.centre[1] + self.r * (sin - self.handed * phi * cos);
        p[normal] = self.climb * fraction;
        p
    }

    pub(crate) fn curve(&self, tolerance: f64) -> Involute {
        let outward = self.phi[1] > self.phi[0];
        // Inwards the tangent rotates against the involute's own sense.
        let turning = if outward { self.handed } else { -self.handed };
        let sense = if turning > 0.0 {
            Sense::CounterClockwise
        } else {
            Sense::Clockwise
        };
        let (start, end) = (self.point(self.phi[0]), self.point(self.phi[1]));
        Involute::new(self.plane, start, end, self.centre, self.r, sense, tolerance)
            .expect("planted involute")
    }

    pub(crate) fn case(&self, name: &'static str) -> Case {
        let scale =
            self.r * (1.0 + self.phi[0].max(self.phi[1])) + self.centre[0].abs() + self.centre[1].abs();
        Case {
            name,
            curve: self.curve(1e-9 * scale).into(),
            scale,
        }
    }
}

pub(crate) const ROLLED: Rolled = Rolled {
    plane: Plane::Xy,
    centre: [0.0, 0.0],
    r: 0.628_662_025,
    root: 0.3,
    phi: [0.0, 125.66],
    climb: 0.0,
    rest: 0.0,
    handed: 1.0,
};

pub(crate) fn gallery() -> Vec<Case> {
    use Plane::{Xy, Yz, Zx};
    use Sense::{Clockwise as Cw, CounterClockwise as Ccw};
    let line = |name, a: &[f64], b: &[f64], scale| Case {
        name,
        curve: Line::new(axes(a), axes(b)).expect(name).into(),
        scale,
    };
    let mut all = vec![
        line(
            "line",
            &[1.0, 2.0, 3.0, 10.0],
            &[-40.0, 25.0, 3.0, -80.0, 0.0, 5.0, 1.0],
            100.0,
        ),
        line(
            "line of rotary axes only",
            &[1.0; 9],
            &[1.0, 1.0, 1.0, 91.0, 0.0, 1.0, 1.0, 1.0, 1.0],
            100.0,
        ),
        line(
            "line of UVW and rotary axes",
            &[0.0; 9],
            &[0.0, 0.0, 0.0, 360.0, 0.0, 0.0, 3.0, 4.0, 0.0],
            360.0,
        ),
        line("line of 1 nm", &[1.0], &[1.000_001], 1.0),
        arc(
            "quarter",
            Xy,
            axes(&[10.0]),
            axes(&[0.0, 10.0]),
            [0.0; 2],
            Ccw,
            0,
            10.0,
        ),
        arc(
            "three quarters",
            Zx,
            axes(&[0.0, 0.0, 10.0]),
            axes(&[10.0]),
            [0.0; 2],
            Cw,
            0,
            10.0,
        ),
        arc(
            "full circle",
            Yz,
            axes(&[0.0, -25.0]),
            axes(&[0.0, -25.0]),
            [0.0; 2],
            Ccw,
            0,
            25.0,
        ),
        arc(
            "helix",
            Xy,
            axes(&[10.0]),
            axes(&[10.0, 0.0, -20.0, 90.0, 0.0, 0.0, 7.0]),
            [5.0, 0.0],
            Cw,
            4,
            90.0,
        ),
        // Many turns: the rounding of the angle times the radius is the error.
        arc(
            "helix of 1000 turns",
            Xy,
            axes(&[3.0]),
            axes(&[-3.0, 0.0, 500.0]),
            [0.0; 2],
            Ccw,
            1000,
            19_000.0,
        ),
        // Radii that differ, as in rounded programs: the arc becomes a spiral that meets both ends.
        arc(
            "arc with two radii",
            Xy,
            axes(&[10.0]),
            axes(&[0.0, 10.004]),
            [0.0; 2],
            Ccw,
            1,
            10.0,
        ),
        arc(
            "helix with two radii",
            Yz,
            axes(&[0.0, 10.0]),
            axes(&[9.0, 0.0, 9.98]),
            [0.0; 2],
            Cw,
            0,
            10.0,
        ),
        // A radius of 1 um far from the origin: coordinates are rounded to 1e-11, 1e-8 of the radius.
        arc(
            "1 um",
            Xy,
            axes(&[0.001]),
            axes(&[0.0, 0.001]),
            [0.0; 2],
            Ccw,
            0,
            0.001,
        ),
        arc(
            "1 um at 1e5 mm",
            Xy,
            axes(&[1e5 + 0.001, 1e5]),
            axes(&[1e5, 1e5 + 0.001]),
            [1e5; 2],
            Ccw,
            0,
            2e5,
        ),
        // A radius of 100 km over 10 m: sine and versine of 1e-4 rad; the rounding of the centre must not
        // show.
        arc(
            "100 km",
            Xy,
            axes(&[]),
            axes(&[1e4, 0.5]),
            [0.0, 1e8],
            Ccw,
            0,
            1e4,
        ),
        // 1e-9 rad of a circle of 10 mm: a chord of 1e-8 mm.
        arc(
            "1e-9 rad",
            Xy,
            axes(&[0.0]),
            axes(&[1e-8, 5e-18]),
            [0.0, 10.0],
            Ccw,
            0,
            1e-8,
        ),
        arc(
            "far away",
            Xy,
            axes(&[1e5 + 20.0, -1e5]),
            axes(&[1e5, 20.0 - 1e5]),
            [1e5, -1e5],
            Ccw,
            0,
            1e5,
        ),
    ];
    let rolled = |name, rolled: Rolled| rolled.case(name);
    all.extend([
        rolled("involute of 20 turns from its base circle", ROLLED),
        rolled(
            "involute clockwise",
            Rolled {
                handed: -1.0,
                phi: [0.2, 12.0],
                centre: [3.0, -7.0],
                ..ROLLED
            },
        ),
        rolled(
            "involute inwards",
            Rolled {
                phi: [20.0, 2.0],
                r: 3.0,
                ..ROLLED
            },
        ),
        rolled(
            "involute inwards to its base circle",
            Rolled {
                phi: [20.0, 0.0],
                handed: -1.0,
                ..ROLLED
            },
        ),
        rolled(
            "involute in ZX",
            Rolled {
                plane: Zx,
                phi: [0.0, 9.0],
                climb: -4.0,
                rest: 30.0,
                ..ROLLED
            },
        ),
        rolled(
            "involute in YZ inwards",
            Rolled {
                plane: Yz,
                phi: [9.0, 0.1],
                climb: 40.0,
                rest: 1.0,
                ..ROLLED
            },
        ),
        // Entirely inside the section in which the regular parameter is not arc length.
        rolled(
            "involute of half a radian",
            Rolled {
                phi: [0.0, 0.5],
                r: 20.0,
                ..ROLLED
            },
        ),
        rolled(
            "involute just below the regular start",
            Rolled {
                phi: [0.499, 30.0],
                ..ROLLED
            },
        ),
        rolled(
            "involute just above the regular start",
            Rolled {
                phi: [0.501, 30.0],
                ..ROLLED
            },
        ),
        rolled(
            "involute of 1e-4 rad",
            Rolled {
                phi: [0.0, 1e-4],
                r: 10.0,
                ..ROLLED
            },
        ),
        // A base radius of 1 um: 50 turns reach a third of a millimetre.
        rolled(
            "involute of 1 um",
            Rolled {
                phi: [0.0, 314.0],
                r: 0.001,
                ..ROLLED
            },
        ),
        rolled(
            "involute of 100 km",
            Rolled {
                phi: [0.01, 0.011],
                r: 1e8,
                ..ROLLED
            },
        ),
        rolled(
            "involute far away",
            Rolled {
                phi: [0.0, 60.0],
                centre: [1e5, -1e5],
                ..ROLLED
            },
        ),
    ]);
    let jet = |p: &[f64], v: &[f64], a: &[f64]| Jet {
        first: axes(v),
        second: axes(a),
        ..Jet::at_rest(axes(p))
    };
    let corner = Blend::hermite(
        &jet(&[-1.0, 0.0, 0.0, 5.0], &[1.0, 0.0, 0.0, 2.0], &[]),
        &jet(&[0.0, 1.0, 0.1, 6.0], &[0.0, 1.0], &[0.1, 0.0, 0.3]),
        1.8,
    );
    let rotary = Blend::hermite(
        &jet(&[1.0, 1.0, 1.0, 5.0], &[0.0, 0.0, 0.0, 2.0], &[]),
        &jet(&[1.0, 1.0, 1.0, 9.0, 1.0], &[0.0, 0.0, 0.0, 1.0, 1.0], &[]),
        2.0,
    );
    all.push(Case {
        name: "blend of a corner",
        curve: corner.expect("blend").into(),
        scale: 10.0,
    });
    all.push(Case {
        name: "blend of rotary axes",
        curve: rotary.expect("blend").into(),
        scale: 20.0,
    });
    all
}

/// Speed in the feed metric, by definition.
pub(crate) fn speed(first: &Axes) -> f64 {
    let group = |i: usize| first.fixed_rows::<3>(i).norm();
    [0, 6, 3]
        .into_iter()
        .map(group)
        .find(|&speed| speed > 0.0)
        .unwrap_or(0.0)
}
