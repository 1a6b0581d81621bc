//! Deceleration in closed form, checked along the path.

use evolvent_path::AXES;

use crate::cell::Point;
use crate::change::{ScalarLimits, ScalarState};
use crate::grid::{Grid, PathPosition};
use crate::limits::PathLimits;
use crate::piece::{Ratios, TimeLawPiece};
use crate::profile::Profile;
use crate::time_law::TimeLaw;

/// Fractions of the axis limits along the tangent that are tried; the rest remains for the curvature.
const LIMIT_FRACTIONS: [f64; 8] = [1.0, 0.97, 0.93, 0.88, 0.8, 0.7, 0.55, 0.4];
/// Minimum number of samples along a deceleration at which the axis limits are checked.
const SAMPLES: f64 = 96.0;
/// Maximum ratios of a sample: of velocity and acceleration, and of jerk.
const MAX_RATIO: (f64, f64) = (1.0005, 1.004);
/// Number of points at which a section is sampled for its lowest cap.
const CAP_SAMPLES: u32 = 32;
/// Minimum speed during a deceleration, as a fraction of the target speed.
const MIN_DIP: f64 = 0.95;
/// Maximum length of a deceleration, as a fraction of the known path.
const MAX_LENGTH_FRACTION: f64 = 0.7;
/// Fraction of the jerk limit that is used.
const JERK_FRACTION: f64 = 0.999;

/// A position on the path that moves forward only.
pub(crate) struct PathCursor<'a> {
    grid: &'a Grid,
    until: u64,
    interval: u64,
    /// Distance from the start of the walk to the start of the interval.
    begin: f64,
}

impl<'a> PathCursor<'a> {
    pub(crate) fn new(grid: &'a Grid, from: PathPosition, until: u64) -> Self {
        Self {
            grid,
            until,
            interval: from.interval,
            begin: -from.x,
        }
    }

    /// Advances to distance `x` and returns the position there.
    fn to(&mut self, x: f64) -> PathPosition {
        while let Some(length) = self.grid.interval_length(self.interval) {
            if x < self.begin + length || self.interval + 1 >= self.until {
                break;
            }
            self.begin += length;
            self.interval += 1;
        }
        PathPosition {
            interval: self.interval,
            x: x - self.begin,
        }
    }

    fn point(&self, position: PathPosition) -> Option<Point> {
        let cell = self.grid.cell(position.interval)?;
        let segment = self.grid.segment(cell.segment)?;
        Some(Point::of(segment, cell.from + position.x, self.grid.limits()))
    }
}

/// The ratios of a state of motion at a point of the path.
fn ratios(point: &Point, state: &ScalarState, jerk: f64, limits: &PathLimits) -> Ratios {
    let axes = limits.axes();
    let (v, a) = (state.v, state.a);
    let mut out = Ratios {
        velocity: v / point.speed_u_s,
        ..Ratios::default()
    };
    for i in 0..AXES {
        if axes.present[i] {
            let (d1, d2, d3) = (point.first[i], point.second[i], point.third[i]);
            out.acceleration = out
                .acceleration
                .max((d2 * v * v + d1 * a).abs() / axes.acceleration[i]);
            let j = d3 * v * v * v + 3.0 * d2 * v * a + d1 * jerk;
            out.jerk = out.jerk.max(j.abs() / axes.jerk[i]);
        }
    }
    out
}

/// Length of the known path.
pub(crate) fn known_length(grid: &Grid, from: PathPosition, until: u64) -> f64 {
    (from.interval..until)
        .filter_map(|k| grid.interval_length(k))
        .sum::<f64>()
        - from.x
}

/// Distance of a stop.
fn distance(state: ScalarState, limits: &ScalarLimits) -> f64 {
    Profile::brake(state, f64::MAX, 0.0, limits).end().x
}

/// Approximate distance of a stop, from the axis limits on a straight line.
pub(crate) fn reach(grid: &Grid, from: PathPosition, v: f64, a: f64, until: u64) -> f64 {
    let state = ScalarState { x: 0.0, v, a };
    let known_length = known_length(grid, from, until);
    tangential(grid, from, until, 0.0).map_or(known_length, |limits| {
        distance(state, &limits).clamp(1e-9, known_length)
    })
}

/// Minimum of the axis limits along the tangent over a distance.
fn tangential(grid: &Grid, from: PathPosition, until: u64, reach: f64) -> Option<ScalarLimits> {
    let axes = grid.limits().axes();
    let mut walk = PathCursor::new(grid, from, until);
    let (mut acceleration, mut jerk) = (f64::INFINITY, f64::INFINITY);
    let last = if reach > 0.0 { 16 } else { 0 };
    for k in 0..=last {
        let position = walk.to(reach * f64::from(k) / 16.0);
        let point = walk.point(position)?;
        acceleration = acceleration.min(axes.acceleration_along(&point.first));
        jerk = jerk.min(axes.jerk_along(&point.first));
    }
    (acceleration.is_finite() && jerk.is_finite()).then_some(ScalarLimits {
        velocity: f64::MAX,
        acceleration,
        jerk,
    })
}

/// Maximum constant speed over a distance by limits and feed; each point has a cap.
pub(crate) fn min_cap(grid: &Grid, from: PathPosition, until: u64, reach: f64, factor: f64) -> Option<f64> {
    let mut walk = PathCursor::new(grid, from, until);
    let mut min = f64::INFINITY;
    for k in 0..=CAP_SAMPLES {
        let position = walk.to(reach * f64::from(k) / f64::from(CAP_SAMPLES));
        min = min.min(walk.point(position)?.cap(factor));
    }
    Some(min)
}

/// The fastest of several closed-form decelerations to a lower speed that keeps all limits.
pub(crate) fn slow_down(
    grid: &Grid,
    from: PathPosition,
    (v, a): (f64, f64),
    until: u64,
    speed: f64,
) -> Option<Profile> {
    let known_length = known_length(grid, from, until);
    let state = ScalarState { x: 0.0, v, a };
    let first = tangential(grid, from, until, 0.0)?;
    let reach = (1.5 * distance(state, &first)).min(known_length);
    let ScalarLimits {
        acceleration, jerk, ..
    } = tangential(grid, from, until, reach)?;
    for fraction in LIMIT_FRACTIONS {
        let limits = ScalarLimits {
            velocity: v,
            acceleration: (fraction * acceleration).max(a.abs()),
            jerk: fraction * JERK_FRACTION * jerk,
        };
        // After hard braking, releasing the acceleration would undershoot the speed or run backwards: no
        // closed form.
        if a < 0.0 && v - 0.5 * a * a / limits.jerk < MIN_DIP * speed {
            return None;
        }
        let profile = Profile::change(state, speed, &limits);
        if profile.end().x < MAX_LENGTH_FRACTION * known_length
            && is_within_limits(grid, from, until, &profile)
        {
            return Some(profile);
        }
    }
    None
}

/// Whether a deceleration keeps every limit.
///
/// Checks the ends and the middle of each part between two joints, ends of intervals or steps of jerk,
/// however short: a blend of 0.1 um has a curvature too. Longer parts have more samples.
fn is_within_limits(grid: &Grid, from: PathPosition, until: u64, profile: &Profile) -> bool {
    let mut before = from.interval;
    let step = profile.duration() / SAMPLES;
    pieces(grid, from, until, profile, |piece| {
        let Some(segment) = grid.segment(piece.segment) else {
            return false;
        };
        let entry = piece.law.at(0.0).0.v;
        while before < piece.interval {
            // The speed at a joint must not exceed its cap.
            if grid
                .cell(before)
                .is_none_or(|cell| entry > cell.joint * MAX_RATIO.0)
            {
                return false;
            }
            before += 1;
        }
        let parts = (piece.duration_s / step).ceil().clamp(2.0, SAMPLES);
        (0..=parts as u32).all(|k| {
            let (state, jerk) = piece.law.at(piece.duration_s * f64::from(k) / parts);
            let point = Point::of(segment, piece.from + state.x, grid.limits());
            let here = ratios(&point, &state, jerk, grid.limits());
            here.velocity.max(here.acceleration) <= MAX_RATIO.0 && here.jerk <= MAX_RATIO.1
        })
    })
}

/// Writes a profile as pieces, divided where intervals end. False if the grid does not contain an interval.
pub(crate) fn write(
    grid: &Grid,
    from: PathPosition,
    until: u64,
    profile: &Profile,
    out: &mut Vec<TimeLawPiece>,
) -> bool {
    pieces(grid, from, until, profile, |piece| {
        out.push(*piece);
        true
    })
}

/// Visits a profile piece by piece until `visit` returns false. False in that case, or if the grid does not
/// contain an interval.
fn pieces(
    grid: &Grid,
    from: PathPosition,
    until: u64,
    profile: &Profile,
    mut visit: impl FnMut(&TimeLawPiece) -> bool,
) -> bool {
    let mut position = from;
    for (start, duration, j) in profile.phase_states() {
        let (mut state, mut left) = (start, duration);
        while left > 0.0 {
            let Some(cell) = grid.cell(position.interval) else {
                return false;
            };
            let law = TimeLaw::ConstantJerk {
                v: state.v,
                a: state.a,
                j,
            };
            let known_length = cell.length - position.x;
            let reach = law.at(left).0.x;
            let leaves = reach > known_length && position.interval + 1 < until;
            let t = if leaves {
                law.time_to(known_length, left)
            } else {
                left
            };
            let length = if leaves { known_length } else { reach };
            if length > 0.0 {
                let piece = TimeLawPiece {
                    law,
                    length,
                    duration_s: t,
                    segment: cell.segment,
                    from: cell.from + position.x,
                    interval: position.interval,
                };
                if !visit(&piece) {
                    return false;
                }
            }
            let next = law.at(t).0;
            (state, left) = (next, left - t);
            position = if leaves {
                PathPosition {
                    interval: position.interval + 1,
                    x: 0.0,
                }
            } else {
                PathPosition {
                    x: position.x + length,
                    ..position
                }
            };
        }
    }
    true
}
