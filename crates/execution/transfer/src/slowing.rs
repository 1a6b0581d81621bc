//! Moves to rest of axes that may start faster than the move permits: each slows down first.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, AxisLetter};

use crate::check;
use crate::error::{Quantity, TransferError};
use crate::fallback::stop;
use crate::landing::{Steps, land};
use crate::state::{AxesState, AxisLimits, AxisState};
use crate::track::Track;
use crate::transfer::{Sync, Transfer};

/// Fraction by which a speed may exceed the cruise speed without being reduced first: it comes from motion at
/// that speed.
const SLACK: f64 = 1e-9;

/// The first part of the move of an axis that is too fast.
#[derive(Clone, Copy, PartialEq, Eq)]
enum First {
    /// It slows down to its cruise speed.
    SlowsDown,
    /// It stops: used if slowing down would take it out of its travel.
    Stops,
}

impl AxesState {
    /// Positions at which the axes would stop if each braked as fast as its acceleration and jerk permit.
    #[must_use]
    pub fn stopped(&self, limits: &Limits) -> Axes {
        Axes::from_fn(|i, _| {
            let state = AxisState::of(self, i);
            if !limits.present[i] || state.is_at_rest() {
                return state.p;
            }
            run(state, &stop(state, &check::limits_of(limits, i))).p
        })
    }

    /// The speed of each axis when its acceleration has been brought to zero as fast as possible. The axis
    /// cannot avoid this speed.
    #[must_use]
    pub fn unavoidable_speed(&self, limits: &Limits) -> Axes {
        Axes::from_fn(|i, _| {
            let state = AxisState::of(self, i);
            if limits.present[i] {
                state.v.abs().max(state.relaxed_speed(limits.jerk[i]).abs())
            } else {
                0.0
            }
        })
    }
}

impl Transfer {
    /// A move to rest at `to`, with each axis on its own. An axis that is faster than `cruise` slows down to
    /// it first, at once, and stays within it. An axis whose target is nearer than that, or in the other
    /// direction, stops first.
    ///
    /// Calls [`Transfer::solve`] once, or twice if slowing down fails; same accuracy and errors. `limits`
    /// must permit the present velocities of the axes.
    ///
    /// # Errors
    /// As for [`Transfer::solve`].
    pub fn solve_slowing(
        limits: &Limits,
        cruise: &Axes,
        from: &AxesState,
        to: &Axes,
    ) -> Result<Self, TransferError> {
        let target = AxesState::at_rest(*to);
        check::entry(limits, from, &target)?;
        first_then_go(limits, cruise, from, &target, First::SlowsDown)
            .or_else(|_| first_then_go(limits, cruise, from, &target, First::Stops))
    }
}

fn first_then_go(
    limits: &Limits,
    cruise: &Axes,
    from: &AxesState,
    to: &AxesState,
    first: First,
) -> Result<Transfer, TransferError> {
    let mut rest = *limits;
    let mut begins = *from;
    let mut slowing: [Option<[(f64, f64); 3]>; AXES] = [None; AXES];
    for i in (0..AXES).filter(|i| limits.present[*i]) {
        rest.velocity[i] = limits.velocity[i].min(cruise[i]);
        let state = AxisState::of(from, i);
        let all = check::limits_of(limits, i);
        let relaxed = state.relaxed_speed(all.j);
        if state.v.abs().max(relaxed.abs()) <= rest.velocity[i] * (1.0 + SLACK) {
            continue;
        }
        let retained = rest.velocity[i] * relaxed.signum();
        let slowed = run(state, &slow_down(state, retained, &all));
        let ahead = (to.position[i] - run(slowed, &stop(slowed, &all)).p) * relaxed.signum();
        // If the target is too near or in the other direction, slowing down would only go farther past it.
        let slows_down = first == First::SlowsDown && relaxed.abs() > rest.velocity[i] && ahead >= 0.0;
        let retained = if slows_down { retained } else { 0.0 };
        let steps = slow_down(state, retained, &all);
        let reached = run(state, &steps);
        // Exact except for rounding, which the landing corrects.
        (begins.position[i], begins.velocity[i], begins.acceleration[i]) = (reached.p, retained, 0.0);
        slowing[i] = Some(steps);
    }
    let go = Transfer::solve(&rest, &begins, to, Sync::None)?;
    if slowing.iter().all(Option::is_none) {
        return Ok(go);
    }
    let mut tracks: [Track; AXES] = AxisLetter::ALL.map(|axis| *go.track(axis));
    for (i, first) in slowing.iter().enumerate() {
        let Some(first) = first else { continue };
        let (from, to) = (AxisState::of(from, i), AxisState::of(to, i));
        let mut steps: Steps = first.to_vec();
        steps.extend(
            tracks[i]
                .pieces()
                .iter()
                .map(|piece| (piece.duration_s, piece.jerk)),
        );
        land(&mut steps, from, to);
        tracks[i] = Track::through(from, to, &steps).ok_or(TransferError::Unsolved {
            axis: AxisLetter::ALL[i],
            quantity: Quantity::Jerk,
            value: f64::NAN,
            limit: limits.jerk[i],
        })?;
    }
    check::exit(limits, from, to, &tracks)?;
    Ok(Transfer::of_tracks(tracks, go.method()))
}

/// The fastest change to a constant velocity.
fn slow_down(from: AxisState, velocity: f64, limits: &AxisLimits) -> [(f64, f64); 3] {
    let relative = AxisState {
        v: from.v - velocity,
        ..from
    };
    stop(relative, limits)
}

fn run(state: AxisState, steps: &[(f64, f64)]) -> AxisState {
    steps.iter().fold(state, |state, &(t, jerk)| state.after(t, jerk))
}

#[cfg(test)]
mod tests {
    use evolvent_random::Random;

    use super::*;

    fn machine() -> Limits {
        let mut present = [false; AXES];
        present[..3].fill(true);
        Limits {
            present,
            velocity: Axes::repeat(500.0),
            acceleration: Axes::repeat(5000.0),
            jerk: Axes::repeat(200_000.0),
            travel_min: Axes::repeat(-400.0),
            travel_max: Axes::repeat(400.0),
            home: Axes::zeros(),
        }
    }

    /// A state within the limits from which the axis can still stop within its travel.
    fn moving(random: &mut Random, limits: &Limits) -> AxesState {
        loop {
            let mut state = AxesState::at_rest(Axes::zeros());
            for i in 0..3 {
                state.position[i] = random.between(-400.0, 400.0);
                state.velocity[i] = random.between(-400.0, 400.0);
                state.acceleration[i] = random.between(-4000.0, 4000.0);
            }
            let speed = state.unavoidable_speed(limits);
            let stopped = state.stopped(limits);
            if (0..3).all(|i| speed[i] < 490.0 && stopped[i].abs() < 399.0 && state.position[i].abs() < 399.0)
            {
                return state;
            }
        }
    }

    #[test]
    fn an_axis_slows_at_once_and_never_speeds_up() {
        let limits = machine();
        let mut random = Random::seeded(2311);
        for _ in 0..400 {
            let from = moving(&mut random, &limits);
            let to = Axes::from_fn(|i, _| if i < 3 { random.between(-399.0, 399.0) } else { 0.0 });
            let cruise = Axes::from_fn(|_, _| random.log(0.1, 500.0));
            let transfer = match Transfer::solve_slowing(&limits, &cruise, &from, &to) {
                Ok(transfer) => transfer,
                Err(error) => panic!("{error}: {from:?} to {to:?} at {cruise:?}"),
            };
            let speed = from.unavoidable_speed(&limits);
            for i in 0..3 {
                // The maximum time that slowing down, or stopping, may take.
                let slow_s = speed[i] / 5000.0 + 5000.0 / 200_000.0 + 4000.0 / 200_000.0;
                for k in 0..=2000 {
                    let t = transfer.duration_s() * f64::from(k) / 2000.0;
                    let v = transfer.at(t).velocity[i].abs();
                    let bound = if t > slow_s {
                        cruise[i]
                    } else {
                        cruise[i].max(speed[i])
                    };
                    assert!(
                        v <= bound * (1.0 + 1e-4) + 1e-6,
                        "axis {i}: {v} of {bound} at {t}, {from:?} to {to:?}"
                    );
                }
            }
            let end = transfer.at(transfer.duration_s());
            assert!((end.position - to).iter().take(3).all(|off| off.abs() < 1e-9));
        }
    }

    #[test]
    fn axes_stop_within_their_own_stopping_times() {
        let limits = machine();
        let mut random = Random::seeded(2312);
        for _ in 0..400 {
            let from = moving(&mut random, &limits);
            let stopped = from.stopped(&limits);
            let speed = from.unavoidable_speed(&limits);
            let mut to = stopped;
            to[1] = random.between(-399.0, 399.0);
            let mut cruise = speed;
            cruise[1] = 3.0;
            let wide = Limits {
                velocity: limits.velocity.map(|v| v.max(1e-3)),
                ..limits
            };
            let cruise = cruise.map(|v| (1.0001 * v).max(1e-3));
            let transfer = Transfer::solve_slowing(&wide, &cruise, &from, &to).unwrap();
            for axis in [AxisLetter::X, AxisLetter::Z] {
                let i = axis.index();
                let bound = check::limits_of(&limits, i);
                let shortest: f64 = stop(AxisState::of(&from, i), &bound)
                    .iter()
                    .map(|step| step.0)
                    .sum();
                let takes = transfer.track(axis).duration_s();
                assert!(
                    takes <= shortest + 2e-3,
                    "{takes} s instead of {shortest} s, {from:?}"
                );
            }
        }
    }
}
