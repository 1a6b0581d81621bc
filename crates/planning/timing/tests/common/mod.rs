//! Paths, and a checker of plans that uses positions only.
#![allow(dead_code, reason = "each test uses a part")]
#![allow(clippy::expect_used, clippy::panic, reason = "a test may fail")]

use std::f64::consts::PI;

use evolvent_machine::Limits;
use evolvent_path::{AXES, Arc, Axes, Blend, Curve, Involute, Line, Plane, Sense};
#[allow(unused_imports, reason = "each test uses a part")]
pub(crate) use evolvent_random::Random;
use evolvent_timing::{Grid, PathLimits, TimeLawPiece};

/// Equal limits on the first `count` axes.
pub(crate) fn axes(count: usize, velocity: f64, acceleration: f64, jerk: f64) -> Limits {
    let mut present = [false; AXES];
    present[..count].fill(true);
    Limits {
        present,
        velocity: Axes::repeat(velocity),
        acceleration: Axes::repeat(acceleration),
        jerk: Axes::repeat(jerk),
        travel_min: Axes::repeat(-1e5),
        travel_max: Axes::repeat(1e5),
        home: Axes::zeros(),
    }
}

/// Limits along the path at a rate and chord error that are never active.
pub(crate) fn relaxation(limits: Limits) -> PathLimits {
    PathLimits::new(limits, 1e5, 1.0)
}

pub(crate) fn point(x: f64, y: f64, z: f64) -> Axes {
    let mut point = Axes::zeros();
    (point[0], point[1], point[2]) = (x, y, z);
    point
}

/// A chain of curves, each used from a parameter over a length, with a feed.
#[derive(Clone, Default)]
pub(crate) struct Path {
    pub(crate) parts: Vec<(Curve, f64, f64, f64)>,
}

impl Path {
    pub(crate) fn one(curve: impl Into<Curve>) -> Self {
        let curve = curve.into();
        Self {
            parts: vec![(curve, 0.0, curve.domain(), f64::INFINITY)],
        }
    }

    /// Curves whose corners are blended by quintics within `tolerance` of the corner.
    pub(crate) fn blended(curves: &[Curve], tolerance: f64, feed: f64) -> Self {
        let mut parts = Vec::new();
        let mut from = 0.0;
        for (k, left) in curves.iter().enumerate() {
            let Some(right) = curves.get(k + 1) else {
                parts.push((*left, from, left.domain() - from, feed));
                break;
            };
            let turn = (right.jet(0.0).first - left.jet(left.domain()).first).norm();
            let available = 0.499 * left.domain().min(right.domain());
            let h = (16.0 / 3.0 * 0.98 * tolerance / turn.max(1e-9)).min(available);
            let cut = left.domain() - h;
            parts.push((*left, from, cut - from, feed));
            let blend = Blend::hermite(&left.jet(cut), &right.jet(h), 2.0 * h).expect("blend");
            parts.push((Curve::Blend(blend), 0.0, 2.0 * h, feed));
            from = h;
        }
        Self { parts }
    }

    pub(crate) fn polyline(points: &[Axes], tolerance: f64, feed: f64) -> Self {
        let lines: Vec<Curve> = points
            .windows(2)
            .map(|pair| Line::new(pair[0], pair[1]).expect("line").into())
            .collect();
        Self::blended(&lines, tolerance, feed)
    }

    pub(crate) fn push_to(&self, grid: &mut Grid) {
        for (curve, from, length, feed) in &self.parts {
            grid.push(curve, *from, *length, *feed);
        }
    }

    pub(crate) fn length(&self) -> f64 {
        self.parts.iter().map(|part| part.2).sum()
    }
}

/// Rotates a point about the origin in the XY plane.
pub(crate) fn turned(p: Axes, degrees: f64) -> Axes {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let mut out = p;
    (out[0], out[1]) = (cos * p[0] - sin * p[1], sin * p[0] + cos * p[1]);
    out
}

pub(crate) fn circle(radius: f64, degrees: f64) -> Path {
    let start = turned(point(radius, 0.0, 0.0), degrees);
    let arc = Arc::new(Plane::Xy, start, start, [0.0, 0.0], Sense::CounterClockwise, 0);
    Path::one(arc.expect("arc"))
}

pub(crate) fn helix(radius: f64, pitch: f64, turns: u32, degrees: f64) -> Path {
    let start = turned(point(radius, 0.0, 0.0), degrees);
    let mut end = start;
    end[2] += pitch * f64::from(turns);
    let arc = Arc::new(Plane::Xy, start, end, [0.0, 0.0], Sense::Clockwise, turns - 1);
    Path::one(arc.expect("arc"))
}

/// An involute from its base circle outwards over `turns`.
pub(crate) fn involute(base: f64, turns: f64, degrees: f64) -> Path {
    let phi = 2.0 * PI * turns;
    let start = turned(point(base, 0.0, 0.0), degrees);
    let end = turned(
        point(
            base * (phi.cos() + phi * phi.sin()),
            base * (phi.sin() - phi * phi.cos()),
            0.0,
        ),
        degrees,
    );
    let curve = Involute::new(
        Plane::Xy,
        start,
        end,
        [0.0, 0.0],
        base,
        Sense::CounterClockwise,
        1e-3,
    );
    Path::one(curve.expect("involute"))
}

pub(crate) fn square(side: f64, tolerance: f64, degrees: f64) -> Path {
    let corner = |x: f64, y: f64| turned(point(side * x, side * y, 0.0), degrees);
    Path::polyline(
        &[
            corner(0.0, 0.0),
            corner(1.0, 0.0),
            corner(1.0, 1.0),
            corner(0.0, 1.0),
            corner(0.0, 0.0),
        ],
        tolerance,
        f64::INFINITY,
    )
}

/// Maximum ratio of a finite difference to its limit over the axes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Measured {
    pub(crate) velocity: f64,
    pub(crate) acceleration: f64,
    pub(crate) jerk: f64,
    /// Time of the maximum, s.
    pub(crate) at: f64,
    pub(crate) jerk_at: f64,
}

/// Positions of a motion at a fixed rate, from pieces that may be replaced during the motion.
pub(crate) struct Player<'a> {
    pub(crate) grid: &'a Grid,
    pub(crate) pieces: &'a [TimeLawPiece],
}

impl Player<'_> {
    pub(crate) fn duration(&self) -> f64 {
        self.pieces.iter().map(|piece| piece.duration_s).sum()
    }

    /// Positions at `rate` from `phase` periods, at rest for four periods before and after the motion.
    pub(crate) fn positions(&self, rate: f64, phase: f64) -> Vec<Axes> {
        let duration = self.duration();
        let (mut index, mut begin) = (0, 0.0);
        let count = (duration * rate).ceil() as i64 + 5;
        let mut out = Vec::new();
        for k in -4..count {
            let t = ((k as f64 + phase) / rate).clamp(0.0, duration);
            while index + 1 < self.pieces.len() && t > begin + self.pieces[index].duration_s {
                begin += self.pieces[index].duration_s;
                index += 1;
            }
            let piece = &self.pieces[index];
            let x = piece
                .law
                .at((t - begin).min(piece.duration_s))
                .0
                .x
                .min(piece.length);
            out.push(
                self.grid
                    .position(piece.segment, piece.from + x)
                    .expect("stretch"),
            );
        }
        out
    }
}

/// Finite differences of positions against limits.
pub(crate) fn measure(positions: &[Axes], rate: f64, limits: &Limits) -> Measured {
    let mut out = Measured::default();
    let mut worst = 0.0;
    for (k, p) in positions.windows(4).enumerate() {
        let jerk_step = p[3] - 3.0 * p[2] + 3.0 * p[1] - p[0];
        let second = p[3] - 2.0 * p[2] + p[1];
        let first = p[3] - p[2];
        for i in (0..AXES).filter(|&i| limits.present[i]) {
            let v = first[i].abs() * rate / limits.velocity[i];
            let a = second[i].abs() * rate * rate / limits.acceleration[i];
            // The jerk that rounding of positions produces is not the plan's.
            let noise = 8.0 * f64::EPSILON * p[0][i].abs().max(p[3][i].abs());
            let j = (jerk_step[i].abs() - noise).max(0.0) * rate * rate * rate / limits.jerk[i];
            if v.max(a).max(j) > worst {
                worst = v.max(a).max(j);
                out.at = k as f64 / rate;
            }
            out.velocity = out.velocity.max(v);
            out.acceleration = out.acceleration.max(a);
            if j > out.jerk {
                out.jerk = j;
                out.jerk_at = k as f64 / rate;
            }
        }
    }
    out
}

/// Maximum over several rates.
pub(crate) fn measure_all(player: &Player<'_>, limits: &Limits, rates: &[f64]) -> Measured {
    let mut out = Measured::default();
    for rate in rates {
        let one = measure(&player.positions(*rate, 0.37), *rate, limits);
        out.velocity = out.velocity.max(one.velocity);
        out.acceleration = out.acceleration.max(one.acceleration);
        if one.jerk > out.jerk {
            out.jerk = one.jerk;
            out.jerk_at = one.jerk_at;
        }
    }
    out
}

/// Asserts that pieces are contiguous, cover `length` and end at rest.
pub(crate) fn assert_chained(pieces: &[TimeLawPiece], from: (f64, f64), length: f64, what: &str) {
    let (mut v, mut a, mut covered) = (from.0, from.1, 0.0);
    let top = pieces.iter().map(|p| p.law.at(0.0).0.v).fold(0.0, f64::max);
    let push = pieces.iter().map(|p| p.law.at(0.0).0.a.abs()).fold(0.0, f64::max);
    for (k, piece) in pieces.iter().enumerate() {
        let start = piece.law.at(0.0).0;
        assert!(
            (start.v - v).abs() <= 1e-9 * top,
            "{what}: piece {k} starts at {} after {v}",
            start.v
        );
        assert!(
            (start.a - a).abs() <= 1e-7 * push,
            "{what}: piece {k} starts with {} after {a}",
            start.a
        );
        let end = piece.law.at(piece.duration_s).0;
        assert!(
            (end.x - piece.length).abs() <= 1e-10 * piece.length + 1e-13,
            "{what}: piece {k} ends at {} of {}",
            end.x,
            piece.length
        );
        (v, a) = (end.v, end.a);
        covered += piece.length;
    }
    assert!(v <= 1e-7 * top + 1e-12, "{what}: ends at speed {v}");
    assert!(
        (covered - length).abs() <= 1e-9 * length,
        "{what}: covers {covered} of {length}"
    );
}
