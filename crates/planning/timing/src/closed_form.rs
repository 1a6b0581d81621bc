//! Slowing down in closed form, checked along the path.

use evolvent_path::AXES;

use crate::cell::Point;
use crate::change::{ScalarLimits, ScalarState};
use crate::grid::{Grid, Place};
use crate::limits::PathLimits;
use crate::piece::{Piece, Ratios};
use crate::profile::Profile;
use crate::time_law::TimeLaw;

/// Shares of the axes' limits along the tangent that are tried: what curvature takes, nothing on lines.
const SHARES: [f64; 8] = [1.0, 0.97, 0.93, 0.88, 0.8, 0.7, 0.55, 0.4];
/// Samples along a way down at which the axes' limits are checked, at least.
const SAMPLES: f64 = 96.0;
/// What a sample may have: of velocity and acceleration, of jerk.
const ALLOWED: (f64, f64) = (1.0005, 1.004);
/// Places at which a stretch is looked at for its lowest cap.
const CAP_SAMPLES: u32 = 32;
/// Share of a lower speed below which a way down to it may not lead.
const MIN_DIP: f64 = 0.95;
/// Share of the path known within which a way down to a lower speed has to end.
const SLOW_ROOM: f64 = 0.7;
/// Share of the jerk limit that is used.
const JERK_FRACTION: f64 = 0.999;

/// A place on the path with its interval's cell: walks forward only.
pub(crate) struct Walk<'a> {
    grid: &'a Grid,
    until: u64,
    interval: u64,
    /// Distance of the interval's start from where the walk began.
    begin: f64,
}

impl<'a> Walk<'a> {
    pub(crate) fn new(grid: &'a Grid, from: Place, until: u64) -> Self {
        Self {
            grid,
            until,
            interval: from.interval,
            begin: -from.x,
        }
    }

    /// Goes on to distance `x`: the interval and the offset in it.
    fn to(&mut self, x: f64) -> Place {
        while let Some(length) = self.grid.interval_length(self.interval) {
            if x < self.begin + length || self.interval + 1 >= self.until {
                break;
            }
            self.begin += length;
            self.interval += 1;
        }
        Place {
            interval: self.interval,
            x: x - self.begin,
        }
    }

    fn point(&self, place: Place) -> Option<Point> {
        let cell = self.grid.cell(place.interval)?;
        let stretch = self.grid.stretch(cell.stretch)?;
        Some(Point::of(stretch, cell.from + place.x, self.grid.limits()))
    }
}

/// The ratios of a state of motion at a point of the path.
fn ratios(point: &Point, state: &ScalarState, jerk: f64, limits: &PathLimits) -> Ratios {
    let axes = limits.axes();
    let (v, a) = (state.v, state.a);
    let mut out = Ratios {
        velocity: v / point.speed,
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
pub(crate) fn room(grid: &Grid, from: Place, until: u64) -> f64 {
    (from.interval..until)
        .filter_map(|k| grid.interval_length(k))
        .sum::<f64>()
        - from.x
}

/// How far a stop goes.
fn distance(state: ScalarState, limits: &ScalarLimits) -> f64 {
    Profile::brake(state, f64::MAX, 0.0, limits).end().x
}

/// About how far a stop will go that the axes allow on a straight line.
pub(crate) fn reach(grid: &Grid, from: Place, v: f64, a: f64, until: u64) -> f64 {
    let state = ScalarState { x: 0.0, v, a };
    let room = room(grid, from, until);
    tangential(grid, from, until, 0.0).map_or(room, |limits| distance(state, &limits).clamp(1e-9, room))
}

/// The least of the axes' limits along the tangent over a distance.
fn tangential(grid: &Grid, from: Place, until: u64, reach: f64) -> Option<ScalarLimits> {
    let axes = grid.limits().axes();
    let mut walk = Walk::new(grid, from, until);
    let (mut acceleration, mut jerk) = (f64::INFINITY, f64::INFINITY);
    let last = if reach > 0.0 { 16 } else { 0 };
    for k in 0..=last {
        let place = walk.to(reach * f64::from(k) / 16.0);
        let point = walk.point(place)?;
        for i in (0..AXES).filter(|&i| axes.present[i]) {
            acceleration = acceleration.min(axes.acceleration[i] / point.first[i].abs());
            jerk = jerk.min(axes.jerk[i] / point.first[i].abs());
        }
    }
    (acceleration.is_finite() && jerk.is_finite()).then_some(ScalarLimits {
        velocity: f64::MAX,
        acceleration,
        jerk,
    })
}

/// The lowest speed that limits and feed allow a constant speed over a distance: that of every place is a cap.
pub(crate) fn least_cap(grid: &Grid, from: Place, until: u64, reach: f64, factor: f64) -> Option<f64> {
    let mut walk = Walk::new(grid, from, until);
    let mut least = f64::INFINITY;
    for k in 0..=CAP_SAMPLES {
        let place = walk.to(reach * f64::from(k) / f64::from(CAP_SAMPLES));
        least = least.min(walk.point(place)?.cap(factor));
    }
    Some(least)
}

/// The quickest of several closed-form ways down to a lower speed that keeps all limits.
pub(crate) fn slow_down(
    grid: &Grid,
    from: Place,
    (v, a): (f64, f64),
    until: u64,
    speed: f64,
) -> Option<Profile> {
    let room = room(grid, from, until);
    let state = ScalarState { x: 0.0, v, a };
    let first = tangential(grid, from, until, 0.0)?;
    let reach = (1.5 * distance(state, &first)).min(room);
    let ScalarLimits {
        acceleration, jerk, ..
    } = tangential(grid, from, until, reach)?;
    for share in SHARES {
        let limits = ScalarLimits {
            velocity: v,
            acceleration: (share * acceleration).max(a.abs()),
            jerk: share * JERK_FRACTION * jerk,
        };
        // Who brakes so hard that letting go carries far below the speed, or backwards, has another plan already.
        if a < 0.0 && v - 0.5 * a * a / limits.jerk < MIN_DIP * speed {
            return None;
        }
        let profile = Profile::change(state, speed, &limits);
        if profile.end().x < SLOW_ROOM * room && keeps_limits(grid, from, until, &profile) {
            return Some(profile);
        }
    }
    None
}

/// Whether a way down keeps every limit.
///
/// Looked at are the ends and the middle of every part of it between two joints, ends of intervals or steps of jerk,
/// however short: a blend of a tenth of a micrometre has a curvature as well. Longer parts have more samples.
fn keeps_limits(grid: &Grid, from: Place, until: u64, profile: &Profile) -> bool {
    let mut before = from.interval;
    let step = profile.duration() / SAMPLES;
    pieces(grid, from, until, profile, |piece| {
        let Some(stretch) = grid.stretch(piece.stretch) else {
            return false;
        };
        let entry = piece.law.at(0.0).0.v;
        while before < piece.interval {
            // Joints are passed at no more than the speed there.
            if grid
                .cell(before)
                .is_none_or(|cell| entry > cell.joint * ALLOWED.0)
            {
                return false;
            }
            before += 1;
        }
        let parts = (piece.duration / step).ceil().clamp(2.0, SAMPLES);
        (0..=parts as u32).all(|k| {
            let (state, jerk) = piece.law.at(piece.duration * f64::from(k) / parts);
            let point = Point::of(stretch, piece.from + state.x, grid.limits());
            let here = ratios(&point, &state, jerk, grid.limits());
            here.velocity.max(here.acceleration) <= ALLOWED.0 && here.jerk <= ALLOWED.1
        })
    })
}

/// A profile as pieces, cut where intervals end. False where the grid does not know an interval.
pub(crate) fn write(grid: &Grid, from: Place, until: u64, profile: &Profile, out: &mut Vec<Piece>) -> bool {
    pieces(grid, from, until, profile, |piece| {
        out.push(*piece);
        true
    })
}

/// Shows a profile piece by piece, as long as `visit` wants to go on. False where it does not, or the grid does not
/// know an interval.
fn pieces(
    grid: &Grid,
    from: Place,
    until: u64,
    profile: &Profile,
    mut visit: impl FnMut(&Piece) -> bool,
) -> bool {
    let mut place = from;
    for (start, duration, j) in profile.phases() {
        let (mut state, mut left) = (start, duration);
        while left > 0.0 {
            let Some(cell) = grid.cell(place.interval) else {
                return false;
            };
            let law = TimeLaw::Jerk {
                v: state.v,
                a: state.a,
                j,
            };
            let room = cell.length - place.x;
            let reach = law.at(left).0.x;
            let leaves = reach > room && place.interval + 1 < until;
            let t = if leaves { law.time_to(room, left) } else { left };
            let length = if leaves { room } else { reach };
            if length > 0.0 {
                let piece = Piece {
                    law,
                    length,
                    duration: t,
                    stretch: cell.stretch,
                    from: cell.from + place.x,
                    interval: place.interval,
                };
                if !visit(&piece) {
                    return false;
                }
            }
            let next = law.at(t).0;
            (state, left) = (next, left - t);
            place = if leaves {
                Place {
                    interval: place.interval + 1,
                    x: 0.0,
                }
            } else {
                Place {
                    x: place.x + length,
                    ..place
                }
            };
        }
    }
    true
}
