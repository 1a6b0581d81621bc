//! Slowdowns of a straight line.

#![allow(clippy::expect_used, reason = "a test may fail")]

use evolvent_path::{Axes, Curve, Line};
use evolvent_planner::{PlanSink, Segment, SegmentMarks, Step, TimedSegment};
use evolvent_timing::{TimeLaw, TimeLawPiece};

use super::*;
use crate::queue::plan_queue;

const A: f64 = 2000.0;
const J: f64 = 50_000.0;
const PERIOD_S: f64 = 0.0005;

fn limits() -> Limits {
    let mut present = [false; AXES];
    present[0] = true;
    Limits {
        present,
        velocity: Axes::repeat(300.0),
        acceleration: Axes::repeat(A),
        jerk: Axes::repeat(J),
        travel_min: Axes::repeat(-1e4),
        travel_max: Axes::repeat(1e4),
        home: Axes::zeros(),
    }
}

/// A line driven at `v` for `seconds`, in pieces of 10 ms.
fn cruise(v: f64, seconds: f64) -> (PlanConsumer, PlanPreview) {
    let (mut producer, queue) = plan_queue(|| false);
    let mut end = Axes::zeros();
    end[0] = v * seconds;
    let line = Line::new(Axes::zeros(), end).expect("line");
    let segment = Segment {
        curve: Curve::Line(line),
        from: 0.0,
        length: v * seconds,
        line: 1,
        block: 0,
        marks: SegmentMarks::default(),
    };
    producer.segment(&segment).expect("room");
    let flow = |k: f64| TimedSegment {
        piece: TimeLawPiece {
            law: TimeLaw::LinearAcceleration { v, b: 0.0, c: 0.0 },
            length: 0.01 * v,
            duration_s: 0.01,
            segment: 0,
            from: 0.01 * v * k,
            interval: 0,
        },
        path: 0.01 * v * k,
    };
    for k in 0..(100.0 * seconds) as u32 {
        producer
            .step(&Step::TimedSegment(flow(f64::from(k))))
            .expect("room");
    }
    producer.commit(u64::from((100.0 * seconds) as u32));
    let mut preview = PlanPreview::new(&limits());
    preview.begin(0, flow(0.0), 0.0);
    (queue, preview)
}

/// Advances until `done` and returns seconds and plan time; every sample keeps acceleration and jerk.
fn drive(
    slowdown: &mut Slowdown,
    v: f64,
    (queue, preview): &mut (PlanConsumer, PlanPreview),
    done: impl Fn(&Slowdown) -> bool,
) -> (f64, f64) {
    let (limits, mut seconds, mut time) = (limits(), 0.0, 0.0);
    while !done(slowdown) {
        let mut ahead = Ahead { preview, queue };
        time += slowdown.advance(PERIOD_S, &limits, &mut ahead);
        seconds += PERIOD_S;
        let Scale { rate, first, second } = slowdown.scale();
        assert!((0.0..=1.001).contains(&rate), "{rate}");
        assert!((first * v).abs() <= 1.001 * A && (second * v).abs() <= 1.01 * J);
        assert!(seconds < 2.0, "never done: {slowdown:?}");
    }
    (seconds, time)
}

#[test]
fn a_stop_from_a_cruise_takes_the_jerk_limited_time() {
    for v in [250.0_f64, 100.0, 40.0, 5.0, 0.5] {
        let mut plan = cruise(v, 2.0);
        let mut slowdown = Slowdown::new(0.0);
        let (seconds, time) = drive(&mut slowdown, v, &mut plan, Slowdown::is_at_rest);
        let least = if v > A * A / J {
            v / A + A / J
        } else {
            2.0 * (v / J).sqrt()
        };
        // For slow axes [`max_second`] determines the duration: at least eleven steps.
        let most = (1.03 * least + 2.0 * SHORTEST_STEP_S).max(0.014);
        assert!(
            seconds >= least - PERIOD_S && seconds <= most,
            "{v}: {seconds} of {least}"
        );
        // A stop from constant speed is symmetric in time: half of the distance is driven.
        assert!((time / seconds - 0.5).abs() < 0.05, "{v}: {time} in {seconds}");
    }
}

#[test]
fn a_rate_is_landed_on_exactly_and_leads_back_to_one() {
    let (v, mut plan) = (100.0, cruise(100.0, 3.0));
    let mut slowdown = Slowdown::new(0.37);
    let is_steady = |slowdown: &Slowdown| slowdown.steady_rate().is_some();
    drive(&mut slowdown, v, &mut plan, is_steady);
    assert_eq!(slowdown.steady_rate(), Some(0.37));
    assert_eq!(slowdown.lead_to(0.37), Lead::Same);
    assert_eq!(slowdown.lead_to(1.0), Lead::FromSteady);
    let again = plan.0.step(40).and_then(|step| match step {
        Step::TimedSegment(flow) => Some(flow),
        _ => None,
    });
    plan.1.begin(40, again.expect("a piece"), 0.0);
    drive(&mut slowdown, v, &mut plan, is_steady);
    assert_eq!(slowdown.steady_rate(), Some(1.0));
}

#[test]
fn a_landing_near_rate_zero_does_not_pass_zero() {
    for (v, cycles) in [150.0, 2.0]
        .into_iter()
        .flat_map(|v| (1..250).map(move |k| (v, k)))
    {
        let mut plan = cruise(v, 2.0);
        let mut slowdown = Slowdown::new(0.0);
        let limits = limits();
        for k in 0..3 * cycles {
            if k == cycles {
                let _led = slowdown.lead_to(0.0007);
            }
            let (queue, preview) = &mut plan;
            let mut ahead = Ahead { preview, queue };
            slowdown.advance(0.2 * PERIOD_S, &limits, &mut ahead);
            // A falling rate that is clamped at zero is a jump of the velocity.
            let Scale { rate, first, .. } = slowdown.scale();
            assert!(
                rate > 0.0 || first > -1e-6,
                "{v} mm/s, led elsewhere after {cycles}: {slowdown:?}"
            );
            if slowdown.steady_rate().is_some() {
                break;
            }
        }
    }
}

#[test]
fn jerk_between_samples_follows_acceleration() {
    // Acceleration t^3 - t, so the jerk is a parabola.
    let sample = |t: f64| Sample {
        time: t,
        first: Axes::repeat(0.25 * t.powi(4) - 0.5 * t * t),
        second: Axes::repeat(t.powi(3) - t),
        third: Axes::repeat(3.0 * t * t - 1.0),
    };
    for t in [0.0, 0.2, 0.5, 0.9, 1.0] {
        let found = between(&sample(0.0), &sample(1.0), t, 3);
        assert!((found.third[2] - sample(t).third[2]).abs() < 1e-12, "{found:?}");
        assert!((found.second[0] - sample(t).second[0]).abs() < 1e-12, "{found:?}");
    }
}

#[test]
fn a_stop_from_any_constant_rate_ends() {
    let rates = (0..=160).map(|k| 10.0_f64.powf(-0.05 * f64::from(k)));
    for (v, rate) in [250.0, 19.0, 3.0, 0.5]
        .into_iter()
        .flat_map(|v| rates.clone().map(move |rate| (v, rate)))
    {
        let mut plan = cruise(v, 2.0);
        let mut slowdown = Slowdown::new(0.0);
        slowdown.settle(rate);
        // As by `lead_to` from another target.
        (slowdown.phase, slowdown.left) = (Phase::Changing, 0.0);
        let (seconds, _) = drive(&mut slowdown, v, &mut plan, Slowdown::is_at_rest);
        let least = 2.0 * (v * rate / J).sqrt().max(v * rate / A);
        assert!(
            seconds < 1.2 * least + 0.014,
            "{v} mm/s at {rate}: {seconds} of {least}"
        );
    }
}

#[test]
fn a_stop_cancelled_and_requested_again_stops() {
    for turns in [3, 17, 60, 110] {
        let (v, mut plan) = (150.0, cruise(150.0, 4.0));
        let mut slowdown = Slowdown::new(0.0);
        let limits = limits();
        for k in 0..400 {
            let target = if k / turns % 2 == 0 { 0.0 } else { 1.0 };
            if slowdown.is_at_rest() || slowdown.steady_rate().is_some() {
                break;
            }
            let _led = slowdown.lead_to(target);
            let (queue, preview) = &mut plan;
            let mut ahead = Ahead { preview, queue };
            slowdown.advance(PERIOD_S, &limits, &mut ahead);
        }
        if slowdown.steady_rate().is_none() {
            let _led = slowdown.lead_to(0.0);
            drive(&mut slowdown, v, &mut plan, Slowdown::is_at_rest);
        }
    }
}

fn soft_limits(acceleration: f64, jerk: f64) -> Limits {
    Limits {
        acceleration: Axes::repeat(acceleration),
        jerk: Axes::repeat(jerk),
        velocity: Axes::repeat(1e4),
        ..limits()
    }
}

/// As [`cruise`], with the preview of a machine with these limits.
fn cruise_of(limits: &Limits, v: f64, seconds: f64) -> (PlanConsumer, PlanPreview) {
    let (mut queue, _) = cruise(v, seconds);
    let first = queue.step(0).and_then(|step| match step {
        Step::TimedSegment(flow) => Some(flow),
        _ => None,
    });
    let mut preview = PlanPreview::new(limits);
    preview.begin(0, first.expect("a piece"), 0.0);
    (queue, preview)
}

/// Counts the samples that a slowdown looks at.
struct Counted<'a> {
    ahead: Ahead<'a>,
    looks: u64,
}

impl Lookahead for Counted<'_> {
    fn oldest(&self) -> usize {
        self.ahead.oldest()
    }

    fn release(&mut self, time: f64) {
        self.ahead.release(time);
    }

    fn sample(&mut self, index: usize) -> Option<&Sample> {
        self.looks += 1;
        self.ahead.sample(index)
    }

    fn rests_at(&self) -> Option<f64> {
        self.ahead.rests_at()
    }
}

/// Machines build up their acceleration in 10 ms to 3 s, and a stop is as short and as cheap on each.
#[test]
fn stops_are_short_and_cheap_at_any_ratio_of_jerk() {
    for (a, ratio_s) in [300.0, 2000.0, 10_000.0]
        .into_iter()
        .flat_map(|a| [0.01, 0.04, 0.1, 0.3, 1.0, 3.0].map(|ratio_s| (a, ratio_s)))
    {
        let j = a / ratio_s;
        let limits = soft_limits(a, j);
        // The acceleration reaches its limit at the second of these.
        for v in [0.01, 0.1, 0.5, 1.0, 1.5].map(|part| part * a * ratio_s) {
            let least = if v > a * ratio_s {
                v / a + ratio_s
            } else {
                2.0 * (v / j).sqrt()
            };
            let (mut queue, mut preview) = cruise_of(&limits, v, 2.0 * least + 0.1);
            let mut slowdown = Slowdown::new(0.0);
            let (mut seconds, mut worst, mut peak) = (0.0, 0, 0);
            let mut recent = [0_u64; 64];
            for cycle in 0.. {
                let ahead = Ahead {
                    preview: &mut preview,
                    queue: &mut queue,
                };
                let mut counted = Counted { ahead, looks: 0 };
                slowdown.advance(PERIOD_S, &limits, &mut counted);
                recent[cycle % recent.len()] = counted.looks;
                worst = worst.max(recent.iter().sum());
                peak = peak.max(counted.looks);
                seconds += PERIOD_S;
                let Scale { first, second, .. } = slowdown.scale();
                assert!((first * v).abs() <= 1.001 * a && (second * v).abs() <= 1.01 * j);
                assert!(seconds < 2.0 * least + 0.1, "never done: {slowdown:?}");
                if slowdown.is_at_rest() {
                    break;
                }
            }
            let per_ms = worst as f64 / (1e3 * PERIOD_S * recent.len() as f64);
            // With steps of one length it was 5 times as much at 0.5 s.
            assert!(peak < 8000, "{a} {ratio_s} {v}: {peak} samples in a cycle");
            assert!(per_ms < 1000.0, "{a} {ratio_s} {v}: {per_ms} samples per ms");
            assert!(
                seconds <= 1.15 * least + 0.015,
                "{a} {ratio_s} {v}: {seconds} of {least}"
            );
        }
    }
}

/// The target changes while the rate lands, on machines with long steps: from there it is a stop from a
/// constant rate.
#[test]
fn a_stop_requested_in_a_landing_is_short() {
    for (a, ratio_s) in [300.0, 3000.0]
        .into_iter()
        .flat_map(|a| [0.1, 0.5, 1.0].map(|ratio_s| (a, ratio_s)))
    {
        let j = a / ratio_s;
        let limits = soft_limits(a, j);
        for part in [0.02, 0.1, 0.3] {
            let v = a * ratio_s;
            let (mut queue, mut preview) = cruise_of(&limits, v, 6.0 * ratio_s);
            let mut slowdown = Slowdown::new(part);
            let (mut seconds, mut since) = (0.0, None);
            while !slowdown.is_at_rest() {
                let mut ahead = Ahead {
                    preview: &mut preview,
                    queue: &mut queue,
                };
                slowdown.advance(PERIOD_S, &limits, &mut ahead);
                seconds += PERIOD_S;
                if since.is_none() && slowdown.phase == Phase::Landing && slowdown.left < 2.0 * PERIOD_S {
                    since = Some(seconds + slowdown.left);
                    assert_eq!(slowdown.lead_to(0.0), Lead::Other);
                }
                let Scale { first, second, .. } = slowdown.scale();
                assert!((first * v).abs() <= 1.001 * a && (second * v).abs() <= 1.01 * j);
                assert!(seconds < 10.0 * ratio_s, "{a} {ratio_s} {part}: {slowdown:?}");
            }
            let least = 2.0 * (part * v / j).sqrt().max(part * v / a);
            let took = seconds - since.expect("a landing");
            assert!(
                took <= 1.15 * least + 0.015,
                "{a} {ratio_s} {part}: {took} of {least}"
            );
        }
    }
}
