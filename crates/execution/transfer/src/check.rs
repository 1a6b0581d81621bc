//! Checks of the input and of the result.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, AxisLetter};

use crate::error::{Quantity, TransferEnd, TransferError};
use crate::state::{AxesState, AxisLimits, AxisState};
use crate::track::Track;

/// Fraction of a limit by which a state may exceed it: states come from plans and are rounded.
const SLACK: f64 = 1e-6;
/// Fraction of a limit by which a move may exceed it.
const MARGIN: f64 = 3e-6;
/// Tolerance of positions, mm or degrees.
const POSITION_TOLERANCE: f64 = 1e-9;
/// Valid range of a machine's limits.
const USABLE: std::ops::RangeInclusive<f64> = 1e-6..=1e12;

/// Checks limits and both states.
pub(crate) fn entry(limits: &Limits, from: &AxesState, to: &AxesState) -> Result<(), TransferError> {
    for axis in AxisLetter::ALL {
        let i = axis.index();
        let start = AxisState::of(from, i);
        let target = AxisState::of(to, i);
        for (end, state) in [(TransferEnd::Start, start), (TransferEnd::Target, target)] {
            finite(axis, end, state)?;
        }
        if !limits.present[i] {
            if start != target || !start.is_at_rest() {
                return Err(TransferError::NoSuchAxis { axis });
            }
            continue;
        }
        for (quantity, value) in [
            (Quantity::Velocity, limits.velocity[i]),
            (Quantity::Acceleration, limits.acceleration[i]),
            (Quantity::Jerk, limits.jerk[i]),
        ] {
            if !USABLE.contains(&value) {
                return Err(TransferError::Limit {
                    axis,
                    quantity,
                    value,
                });
            }
        }
        for (end, state) in [(TransferEnd::Start, start), (TransferEnd::Target, target)] {
            within(limits, axis, end, state)?;
        }
    }
    Ok(())
}

fn finite(axis: AxisLetter, end: TransferEnd, state: AxisState) -> Result<(), TransferError> {
    for (quantity, value) in [
        (Quantity::Position, state.p),
        (Quantity::Velocity, state.v),
        (Quantity::Acceleration, state.a),
    ] {
        if !value.is_finite() {
            return Err(TransferError::NotFinite {
                axis,
                end,
                quantity,
                value,
            });
        }
    }
    Ok(())
}

fn within(
    limits: &Limits,
    axis: AxisLetter,
    end: TransferEnd,
    state: AxisState,
) -> Result<(), TransferError> {
    let i = axis.index();
    let (min, max) = (limits.travel_min[i], limits.travel_max[i]);
    // Negated so that a travel that is not a number is rejected.
    if !(state.p >= min - POSITION_TOLERANCE && state.p <= max + POSITION_TOLERANCE) {
        return Err(TransferError::OutsideTravel {
            axis,
            end,
            position: state.p,
            min,
            max,
        });
    }
    let unavoidable = unavoidable_speed(end, state, limits.jerk[i]);
    for (quantity, value, limit) in [
        (Quantity::Acceleration, state.a, limits.acceleration[i]),
        (Quantity::Velocity, state.v, limits.velocity[i]),
        (Quantity::Velocity, unavoidable, limits.velocity[i]),
    ] {
        if value.abs() > limit * (1.0 + SLACK) {
            return Err(TransferError::BeyondLimit {
                axis,
                end,
                quantity,
                value,
                limit,
            });
        }
    }
    Ok(())
}

/// The speed at which the acceleration can first be zero: after the start, or before the target.
fn unavoidable_speed(end: TransferEnd, state: AxisState, jerk: f64) -> f64 {
    match end {
        TransferEnd::Start => state.relaxed_speed(jerk),
        TransferEnd::Target => AxisState { a: -state.a, ..state }.relaxed_speed(jerk),
    }
}

/// The limits of an axis.
pub(crate) fn limits_of(limits: &Limits, axis: usize) -> AxisLimits {
    AxisLimits {
        v: limits.velocity[axis],
        a: limits.acceleration[axis],
        j: limits.jerk[axis],
    }
}

/// Checks every limit, the travel, both ends and the continuity of the pieces, from the pieces alone.
pub(crate) fn exit(
    limits: &Limits,
    from: &AxesState,
    to: &AxesState,
    tracks: &[Track; AXES],
) -> Result<(), TransferError> {
    for axis in AxisLetter::ALL {
        let i = axis.index();
        if let Some(track) = tracks.get(i).filter(|_| limits.present[i]) {
            axis_exit(limits, axis, AxisState::of(from, i), AxisState::of(to, i), track)?;
        }
    }
    Ok(())
}

/// Maximum magnitudes over a track, and its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Extremes {
    pub v: f64,
    pub a: f64,
    pub j: f64,
    pub min: f64,
    pub max: f64,
}

/// The extremes of all pieces: at their ends, and where the next derivative is zero inside.
pub(crate) fn extremes(track: &Track) -> Extremes {
    let end = track.end();
    let mut found = Extremes {
        v: end.v.abs(),
        a: end.a.abs(),
        j: 0.0,
        min: end.p,
        max: end.p,
    };
    for piece in track.pieces() {
        let mut see = |t: f64| {
            if (0.0..=piece.duration_s).contains(&t) {
                let state = piece.state().after(t, piece.jerk);
                found.v = found.v.max(state.v.abs());
                found.a = found.a.max(state.a.abs());
                found.min = found.min.min(state.p);
                found.max = found.max.max(state.p);
            }
        };
        see(0.0);
        see(piece.duration_s);
        see(-piece.acceleration / piece.jerk);
        // v + a t + j t^2 / 2 = 0, in the form without cancellation.
        let (a, v, half) = (piece.acceleration, piece.velocity, 0.5 * piece.jerk);
        let root = (a * a - 4.0 * half * v).max(0.0).sqrt();
        let q = -0.5 * (a + root.copysign(a));
        see(q / half);
        see(v / q);
        found.j = found.j.max(piece.jerk.abs());
    }
    found
}

fn axis_exit(
    limits: &Limits,
    axis: AxisLetter,
    from: AxisState,
    to: AxisState,
    track: &Track,
) -> Result<(), TransferError> {
    let i = axis.index();
    let found = extremes(track);
    for (quantity, value, limit) in [
        (Quantity::Velocity, found.v, limits.velocity[i]),
        (Quantity::Acceleration, found.a, limits.acceleration[i]),
        (Quantity::Jerk, found.j, limits.jerk[i]),
    ] {
        // Negated so that NaN fails.
        if !(value <= limit * (1.0 + MARGIN)) {
            return Err(TransferError::Unsolved {
                axis,
                quantity,
                value,
                limit,
            });
        }
    }
    // The pieces are continuous, begin at the start and end at the target.
    let mut state = track.pieces().first().map_or(track.end(), |piece| piece.state());
    differs(limits, axis, state, from)?;
    let mut time = 0.0;
    for piece in track.pieces() {
        differs(limits, axis, piece.state(), state)?;
        if (piece.start_s - time).abs() > 1e-9 * (1.0 + time) || !(piece.duration_s > 0.0) {
            return Err(unfit(axis, Quantity::Position, f64::NAN, 0.0));
        }
        state = piece.state().after(piece.duration_s, piece.jerk);
        time = piece.start_s + piece.duration_s;
    }
    differs(limits, axis, state, to)?;
    let (min, max) = (limits.travel_min[i], limits.travel_max[i]);
    for position in [found.min, found.max] {
        if !(position >= min - 2.0 * POSITION_TOLERANCE && position <= max + 2.0 * POSITION_TOLERANCE) {
            return Err(TransferError::LeavesTravel {
                axis,
                position,
                min,
                max,
            });
        }
    }
    Ok(())
}

fn unfit(axis: AxisLetter, quantity: Quantity, value: f64, limit: f64) -> TransferError {
    TransferError::Unsolved {
        axis,
        quantity,
        value,
        limit,
    }
}

fn differs(limits: &Limits, axis: AxisLetter, is: AxisState, wanted: AxisState) -> Result<(), TransferError> {
    let i = axis.index();
    for (quantity, value, wanted, tolerance) in [
        (Quantity::Position, is.p, wanted.p, POSITION_TOLERANCE),
        (
            Quantity::Velocity,
            is.v,
            wanted.v,
            POSITION_TOLERANCE * limits.velocity[i].max(1.0),
        ),
        (
            Quantity::Acceleration,
            is.a,
            wanted.a,
            POSITION_TOLERANCE * limits.acceleration[i].max(1.0),
        ),
    ] {
        if !((value - wanted).abs() <= tolerance) {
            return Err(unfit(axis, quantity, value, wanted));
        }
    }
    Ok(())
}

/// The axes that have to move; none if the state is the target already, at rest or moving.
pub(crate) fn moving(limits: &Limits, from: &AxesState, to: &AxesState) -> Vec<usize> {
    if from == to {
        return Vec::new();
    }
    (0..AXES)
        .filter(|&i| {
            let (start, target) = (AxisState::of(from, i), AxisState::of(to, i));
            limits.present[i] && (start != target || !start.is_at_rest())
        })
        .collect()
}

/// Maximum magnitude of the listed axes.
pub(crate) fn largest(values: &Axes, axes: &[usize]) -> f64 {
    axes.iter().fold(0.0, |max, &i| values[i].abs().max(max))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extremes_between_the_ends_of_a_piece_are_found() {
        // p = t^3/6 - t^2/2 + 3t/8 from rest at 0: v = (t - 1/2)(t - 3/2)/2, extremes of p at 1/2 and 3/2, of
        // v at 1.
        let start = AxisState {
            p: 0.0,
            v: 0.375,
            a: -1.0,
        };
        let end = start.after(2.0, 1.0);
        let track = Track::through(start, end, &[(2.0, 1.0)]).unwrap();
        let found = extremes(&track);
        let at = |t: f64| t * t * t / 6.0 - t * t / 2.0 + 0.375 * t;
        assert!((found.max - at(0.5).max(at(2.0))).abs() < 1e-15);
        assert!((found.min - at(1.5).min(0.0)).abs() < 1e-15);
        assert_eq!((found.v, found.a, found.j), (0.375, 1.0, 1.0));
        // A case in which the maximum speed is inside the piece.
        let start = AxisState {
            p: 0.0,
            v: 0.0,
            a: 1.0,
        };
        let track = Track::through(start, start.after(2.0, -1.0), &[(2.0, -1.0)]).unwrap();
        assert!((extremes(&track).v - 0.5).abs() < 1e-15);
    }

    #[test]
    fn a_track_that_is_wrong_anywhere_is_refused() {
        let mut limits = Limits {
            present: [false; AXES],
            velocity: Axes::repeat(1.0),
            acceleration: Axes::repeat(1.0),
            jerk: Axes::repeat(1.0),
            travel_min: Axes::repeat(-10.0),
            travel_max: Axes::repeat(10.0),
            home: Axes::zeros(),
        };
        limits.present[0] = true;
        let rest = AxisState::default();
        let good = [(1.0, 1.0), (1.0, -1.0)];
        let end = rest.after(1.0, 1.0).after(1.0, -1.0);
        let verdict = |limits: &Limits, from: AxisState, to: AxisState, steps: &[(f64, f64)]| {
            let track = Track::through(rest, end, steps).unwrap();
            axis_exit(limits, AxisLetter::X, from, to, &track)
        };
        assert_eq!(verdict(&limits, rest, end, &good), Ok(()));
        // Another start, another target, a derivative above its limit, a position outside the travel.
        let other = AxisState { v: 1e-6, ..rest };
        assert!(verdict(&limits, other, end, &good).is_err());
        assert!(verdict(&limits, rest, AxisState { a: 1e-6, ..end }, &good).is_err());
        assert!(verdict(&limits, rest, end, &[(1.0, 1.0), (1.000_001, -1.0)]).is_err());
        for quantity in [Quantity::Velocity, Quantity::Acceleration, Quantity::Jerk] {
            let mut tight = limits;
            match quantity {
                Quantity::Velocity => tight.velocity[0] = 0.999,
                Quantity::Acceleration => tight.acceleration[0] = 0.999,
                _ => tight.jerk[0] = 0.999,
            }
            let error = verdict(&tight, rest, end, &good).unwrap_err();
            assert!(
                matches!(error, TransferError::Unsolved { quantity: named, .. } if named == quantity),
                "{error}"
            );
        }
        limits.travel_max[0] = 0.9;
        assert!(matches!(
            verdict(&limits, rest, end, &good),
            Err(TransferError::LeavesTravel { .. })
        ));
    }
}
