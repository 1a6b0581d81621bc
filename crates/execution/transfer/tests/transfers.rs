//! Random transfers, verified by sampling and by quadrature without code of the crate.

#![expect(
    clippy::panic,
    clippy::print_stdout,
    reason = "a test may fail, and tells its figures"
)]

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, AxisLetter};
use evolvent_transfer::{AxesState, Method, Sync, Transfer};

use crate::common::{campaign, limits, state};

/// Checks a transfer by samples and their differences only.
fn verify(limits: &Limits, from: &AxesState, to: &AxesState, transfer: &Transfer, what: &str) {
    let duration = transfer.duration_s();
    assert!(duration.is_finite() && duration >= 0.0, "{what}");
    let close = |is: &AxesState, wanted: &AxesState, at: &str| {
        for i in 0..AXES {
            let off = [
                (is.position[i] - wanted.position[i]).abs(),
                (is.velocity[i] - wanted.velocity[i]).abs() / limits.velocity[i].max(1.0),
                (is.acceleration[i] - wanted.acceleration[i]).abs() / limits.acceleration[i].max(1.0),
            ];
            assert!(
                off.iter().all(|off| *off <= 1e-9),
                "{what}: axis {i} at the {at} is off by {off:?}"
            );
        }
    };
    let state = |t: f64| {
        let point = transfer.at(t);
        AxesState {
            position: point.position,
            velocity: point.velocity,
            acceleration: point.acceleration,
        }
    };
    close(&state(0.0), from, "start");
    close(&state(duration), to, "end");
    // The last piece itself ends at the target, not only the clamped end of at().
    for letter in AxisLetter::ALL {
        let i = letter.index();
        if let Some(last) = transfer.track(letter).pieces().last() {
            let end = transfer.track(letter).duration_s();
            let before = transfer.at(end * (1.0 - 1e-12));
            let margin = 1e-9 + limits.velocity[i] * end * 2e-12;
            assert!(
                (before.position[i] - to.position[i]).abs() <= margin,
                "{what}: axis {i} jumps at its end"
            );
            assert!(last.duration_s > 0.0, "{what}");
        }
    }
    let steps = 400;
    let mut previous: Option<(f64, AxesState)> = None;
    for k in 0..=steps {
        let t = duration * f64::from(k) / f64::from(steps);
        let point = transfer.at(t);
        for i in (0..AXES).filter(|&i| limits.present[i]) {
            let within = |value: f64, limit: f64| value.abs() <= limit * (1.0 + 5e-6);
            assert!(
                within(point.velocity[i], limits.velocity[i])
                    && within(point.acceleration[i], limits.acceleration[i])
                    && within(point.jerk[i], limits.jerk[i]),
                "{what}: axis {i} at {t}: {} {} {}",
                point.velocity[i],
                point.acceleration[i],
                point.jerk[i]
            );
            let travel = limits.travel_min[i] - 1e-6..=limits.travel_max[i] + 1e-6;
            assert!(
                travel.contains(&point.position[i]),
                "{what}: axis {i} leaves its travel"
            );
        }
        let now = state(t);
        if let Some((last, before)) = previous {
            // The maximum change that a derivative within its limit permits in this time.
            let dt = t - last;
            for i in (0..AXES).filter(|&i| limits.present[i]) {
                let steady = |change: f64, limit: f64| {
                    change.abs() <= limit * dt * (1.0 + 1e-5) + 1e-9 * limit.max(1.0)
                };
                assert!(
                    steady(now.position[i] - before.position[i], limits.velocity[i])
                        && steady(now.velocity[i] - before.velocity[i], limits.acceleration[i])
                        && steady(now.acceleration[i] - before.acceleration[i], limits.jerk[i]),
                    "{what}: axis {i} jumps at {t}"
                );
            }
        }
        previous = Some((t, now));
    }
}

/// Statistics of a campaign.
#[derive(Debug, Default)]
struct Tally {
    ruckig: usize,
    stop_and_go: usize,
}

fn campaign_of(seed: u64, cases: usize, sync: Sync) -> Tally {
    let (mut random, cases) = campaign(seed, cases);
    let mut tally = Tally::default();
    for case in 0..cases {
        let axes = 1 + (random.unit() * 9.0) as usize;
        let limits = limits(&mut random, axes);
        let rest = if sync == Sync::Phase { 1.0 } else { 0.4 };
        let from = state(&mut random, &limits, &Axes::zeros(), rest);
        let arriving = if sync == Sync::Time { 0.4 } else { 1.0 };
        let to = state(&mut random, &limits, &from.position, arriving);
        let what = format!("case {case} {sync:?} {axes} axes");
        let transfer = match Transfer::solve(&limits, &from, &to, sync) {
            Ok(transfer) => transfer,
            Err(error) => panic!("{what}: {error}\n{from:?}\n{to:?}\n{limits:?}"),
        };
        verify(&limits, &from, &to, &transfer, &what);
        match transfer.method() {
            Method::Ruckig => tally.ruckig += 1,
            Method::StopAndGo => tally.stop_and_go += 1,
        }
    }
    println!("{sync:?}: {tally:?}");
    tally
}

#[test]
fn synchronised_transfers_keep_every_limit() {
    let tally = campaign_of(0x7a_0001, 1500, Sync::Time);
    assert!(tally.stop_and_go * 100 <= tally.ruckig, "{tally:?}");
}

#[test]
fn unsynchronised_transfers_to_rest_keep_every_limit() {
    campaign_of(0x7a_0002, 500, Sync::None);
}

#[test]
fn straight_transfers_keep_every_limit() {
    campaign_of(0x7a_0003, 500, Sync::Phase);
}

/// Minutes in release: `cargo test --release -p evolvent-transfer -- --ignored`.
#[test]
#[ignore = "takes minutes; run it in release after a change of the solver or of ruckig"]
fn a_quarter_of_a_million_transfers_keep_every_limit() {
    campaign_of(0x7a_0004, 262_144, Sync::Time);
}

#[test]
fn synchronised_axes_arrive_together() {
    let (mut random, cases) = campaign(0x7a_0005, 200);
    for case in 0..cases {
        let limits = limits(&mut random, 3);
        let from = state(&mut random, &limits, &Axes::zeros(), 0.5);
        let to = state(&mut random, &limits, &from.position, 0.5);
        let transfer = solved(&limits, &from, &to, Sync::Time);
        for letter in AxisLetter::ALL {
            let track = transfer.track(letter);
            let off = (track.duration_s() - transfer.duration_s()).abs();
            assert!(
                track.pieces().is_empty() || off <= 1e-9 * transfer.duration_s(),
                "case {case}: {letter:?} is off by {off} s"
            );
        }
    }
}

#[test]
fn axes_by_themselves_arrive_as_if_they_were_alone() {
    let (mut random, cases) = campaign(0x7a_0006, 200);
    for case in 0..cases {
        let limits = limits(&mut random, 4);
        let from = state(&mut random, &limits, &Axes::zeros(), 0.5);
        let to = state(&mut random, &limits, &from.position, 1.0);
        let all = solved(&limits, &from, &to, Sync::None);
        for letter in AxisLetter::ALL.into_iter().take(4) {
            let mut one = limits;
            let (mut start, mut target) = (
                AxesState::at_rest(Axes::zeros()),
                AxesState::at_rest(Axes::zeros()),
            );
            let i = letter.index();
            one.present = [false; AXES];
            one.present[i] = true;
            start.position[i] = from.position[i];
            start.velocity[i] = from.velocity[i];
            start.acceleration[i] = from.acceleration[i];
            target.position[i] = to.position[i];
            let alone = solved(&one, &start, &target, Sync::Time);
            let (is, wanted) = (all.track(letter).duration_s(), alone.duration_s());
            // With other digits the solver may give other last digits.
            assert!(
                (is - wanted).abs() <= 1e-9 + 1e-6 * wanted,
                "case {case} {letter:?}: {is} for {wanted}"
            );
        }
    }
}

#[test]
fn a_straight_transfer_of_moving_states_is_straight() {
    let (mut random, cases) = campaign(0x7a_0007, 300);
    for case in 0..cases {
        let limits = limits(&mut random, 5);
        let mut distance = Axes::zeros();
        for i in 0..5 {
            distance[i] = crate::common::sign(&mut random) * random.log(0.01, 300.0);
        }
        let mut from = AxesState::at_rest(Axes::zeros());
        let mut to = AxesState::at_rest(distance);
        if case % 2 == 0 {
            // Half of the maximum speed along the line that its tightest axis permits.
            let max = (0..5)
                .map(|i| limits.velocity[i] / distance[i].abs())
                .fold(f64::INFINITY, f64::min);
            from.velocity = distance * (0.5 * max * random.unit());
            to.velocity = distance * (0.5 * max * random.unit());
        }
        let transfer = solved(&limits, &from, &to, Sync::Phase);
        for k in 0..=100 {
            let position = transfer.at(transfer.duration_s() * f64::from(k) / 100.0).position;
            let along = position.dot(&distance) / distance.norm_squared();
            let off = (position - distance * along).amax();
            assert!(
                off <= 1e-9 * distance.norm().max(1.0),
                "case {case}: {off} mm off the line"
            );
        }
    }
}

#[test]
fn before_and_after_there_is_the_start_and_the_target() {
    let (mut random, _) = campaign(0x7a_0008, 1);
    let limits = limits(&mut random, 3);
    let from = state(&mut random, &limits, &Axes::zeros(), 0.0);
    let to = state(&mut random, &limits, &Axes::repeat(20.0), 0.0);
    let mut target = to;
    for i in 3..AXES {
        target.position[i] = 0.0;
    }
    let transfer = solved(&limits, &from, &target, Sync::Time);
    assert_eq!(transfer.at(-1.0), transfer.at(0.0));
    for late in [
        transfer.duration_s(),
        transfer.duration_s() + 1.0,
        f64::INFINITY,
        f64::NAN,
    ] {
        let point = transfer.at(late);
        assert_eq!(
            (point.position, point.velocity, point.acceleration, point.jerk),
            (
                target.position,
                target.velocity,
                target.acceleration,
                Axes::zeros()
            )
        );
    }
}

#[test]
fn the_same_input_gives_the_same_bits() {
    let (mut random, cases) = campaign(0x7a_0009, 100);
    for _ in 0..cases {
        let limits = limits(&mut random, 6);
        let from = state(&mut random, &limits, &Axes::zeros(), 0.4);
        let to = state(&mut random, &limits, &from.position, 0.4);
        assert_eq!(
            solved(&limits, &from, &to, Sync::Time),
            solved(&limits, &from, &to, Sync::Time)
        );
    }
}

fn solved(limits: &Limits, from: &AxesState, to: &AxesState, sync: Sync) -> Transfer {
    match Transfer::solve(limits, from, to, sync) {
        Ok(transfer) => transfer,
        Err(error) => panic!("{error}\n{from:?}\n{to:?}\n{limits:?}"),
    }
}
