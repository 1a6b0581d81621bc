//! Look-ahead: from segments to runs with final exit speeds.
//!
//! Short segments with similar limits are combined into runs, because acceleration is zero at every boundary
//! between runs and a chain of tiny runs would be slow. A backward pass from rest at the end of the known
//! path gives each boundary the highest speed from which everything after it can be executed. A boundary
//! whose speed equals its own cap cannot gain from path that is not known yet: it and everything before it
//! are final. So the plan does not depend on how the program text arrives.

use std::collections::VecDeque;

use evolvent_path::Curve;

use crate::step::{ExitSpeeds, PlanSink, Run, Segment, Step};
use evolvent_timing::{
    DerivativeBounds, PathLimits, Profile, ScalarLimits, ScalarState, append_cells, monotone_reachable_speed,
    reachable_speed,
};

/// Number of steps without final exit speed from which the older half is made final.
const MAX_PENDING: usize = 4096;
/// The same for segments.
const MAX_PENDING_SEGMENTS: usize = 8192;
/// Number of new steps between two backward passes.
const PASS_EVERY: usize = 64;
/// Maximum number of cells of one run, which bounds the work of closing it.
const MAX_CELLS: usize = 512;
/// Maximum number of segments of one run.
const MAX_SEGMENTS: u32 = 128;
/// Minimum ratio of the slowest to the fastest speed of the segments of a run.
const MIN_SPEED_RATIO: f64 = 0.8;
/// A curve is divided in two if the speeds permitted on its halves differ by more than this fraction.
const MIN_SPLIT_DIFFERENCE: f64 = 0.12;
/// Minimum duration for a division, s: below it there is no time to change the speed.
const MIN_SPLIT_TIME_S: f64 = 0.01;
/// Minimum duration of a run, s, so that even the slowest loop passes only a few of them per cycle.
const MIN_RUN_S: f64 = 0.002;
/// Maximum depth of the bisection of one segment.
const MAX_SPLITS: u32 = 12;

/// Maximum number of unconsumed steps of a plan before any of them is final.
pub const PENDING_STEPS: usize = MAX_PENDING + PASS_EVERY;
/// Maximum number of unconsumed segments of a plan before any of them is final.
pub const PENDING_SEGMENTS: usize = MAX_PENDING_SEGMENTS + MAX_SEGMENTS as usize + 64;

#[derive(Clone, Copy, Debug)]
struct PendingStep {
    /// `None` for a step at rest.
    motion: Option<Run>,
    segments: usize,
    /// Caps of the exit speed at the programmed and at the doubled feed.
    cap: ExitSpeeds,
    exit: ExitSpeeds,
}

#[derive(Debug, Default)]
struct RunBuilder {
    cells: Vec<DerivativeBounds>,
    segments: u32,
    length: f64,
    feed_u_s: f64,
    /// Minimum speed over all cells, without the feed word.
    cap: f64,
    /// Slowest and fastest segment, with the feed word.
    min_speed: f64,
    fastest: f64,
    /// Approximate stopping distance from the slowest speed.
    stop_distance: f64,
}

/// The look-ahead of one program.
#[derive(Debug)]
pub struct Lookahead<S> {
    limits: PathLimits,
    sink: S,
    pending: VecDeque<PendingStep>,
    pending_segments: usize,
    since_pass: usize,
    /// Number of steps that are final.
    final_steps: u64,
    gathering: RunBuilder,
    /// Speed at the end of the last final step, at the programmed feed.
    nominal_speed: f64,
    scratch: Vec<DerivativeBounds>,
}

impl<S: PlanSink> Lookahead<S> {
    /// Starts at rest, without path.
    #[must_use]
    pub fn new(limits: PathLimits, sink: S) -> Self {
        Self {
            limits,
            sink,
            pending: VecDeque::with_capacity(PENDING_STEPS),
            pending_segments: 0,
            since_pass: 0,
            final_steps: 0,
            gathering: RunBuilder::default(),
            nominal_speed: 0.0,
            scratch: Vec::new(),
        }
    }

    /// The limits of the plan.
    #[must_use]
    pub fn limits(&self) -> &PathLimits {
        &self.limits
    }

    /// The sink of the plan.
    #[must_use]
    pub fn sink(&self) -> &S {
        &self.sink
    }

    /// The sink of the plan.
    pub fn sink_mut(&mut self) -> &mut S {
        &mut self.sink
    }

    /// Appends a path segment. `feed_mm_s` is the programmed speed along the curve, infinite for rapids.
    ///
    /// # Errors
    /// Those of the sink.
    pub fn segment(&mut self, segment: Segment, feed_mm_s: f64) -> Result<(), S::Error> {
        self.split(segment, feed_mm_s, MAX_SPLITS)
    }

    /// Limits the speed at the present end of the path; 0 is a stop.
    ///
    /// # Errors
    /// Those of the sink.
    pub fn boundary(&mut self, cap: f64) -> Result<(), S::Error> {
        self.close_run(cap)
    }

    /// Appends a step at rest.
    ///
    /// # Errors
    /// Those of the sink.
    pub fn rest(&mut self, step: &Step) -> Result<(), S::Error> {
        self.close_run(0.0)?;
        self.sink.step(step)?;
        self.append(PendingStep {
            motion: None,
            segments: 0,
            cap: ExitSpeeds::REST,
            exit: ExitSpeeds::REST,
        });
        if matches!(
            step,
            Step::InputWait { .. } | Step::Probe { .. } | Step::Thread { .. }
        ) {
            // Nothing follows before the cycle has executed all of this.
            self.pass();
            self.commit(self.pending.len());
        }
        Ok(())
    }

    /// Ends the path at rest and makes everything final.
    ///
    /// # Errors
    /// Those of the sink.
    pub fn finish(&mut self, line: u32) -> Result<(), S::Error> {
        self.rest(&Step::End { line })?;
        self.pass();
        self.commit(self.pending.len());
        Ok(())
    }

    fn split(&mut self, segment: Segment, feed_mm_s: f64, depth: u32) -> Result<(), S::Error> {
        let (from, to) = (segment.from, segment.from + segment.length);
        if depth > 0 && !segment.marks.blend && !matches!(segment.curve, Curve::Line(_)) {
            let middle = 0.5 * (from + to);
            let (left, right) = (
                self.speed_over(&segment.curve, from, middle),
                self.speed_over(&segment.curve, middle, to),
            );
            let doubled_feed_u_s = 2.0 * feed_mm_s / metric_speed(&segment.curve, from, to);
            let differ = (left - right).abs() > MIN_SPLIT_DIFFERENCE * left.max(right);
            let lasts = segment.length > MIN_SPLIT_TIME_S * left.min(right).min(doubled_feed_u_s);
            // If the feed word limits both halves there is nothing to gain.
            if differ && lasts && left.min(right) < doubled_feed_u_s {
                let first = Segment {
                    length: middle - from,
                    ..segment
                };
                let mut second = Segment {
                    from: middle,
                    length: to - middle,
                    ..segment
                };
                second.marks.joint = false;
                self.split(first, feed_mm_s, depth - 1)?;
                return self.split(second, feed_mm_s, depth - 1);
            }
        }
        self.add_to_run(segment, feed_mm_s)
    }

    /// Permitted speed of the parameter, per second.
    fn speed_over(&mut self, curve: &Curve, from: f64, to: f64) -> f64 {
        self.scratch.clear();
        append_cells(curve, from, to, &mut self.scratch);
        self.scratch
            .iter()
            .map(|cell| self.limits.speed(cell))
            .fold(f64::INFINITY, f64::min)
    }

    fn add_to_run(&mut self, segment: Segment, feed_mm_s: f64) -> Result<(), S::Error> {
        let (from, to) = (segment.from, segment.from + segment.length);
        let feed_u_s = feed_mm_s / metric_speed(&segment.curve, from, to);
        let cap = self.speed_over(&segment.curve, from, to);
        let speed = cap.min(feed_u_s);
        let run = &self.gathering;
        let like =
            speed.min(run.min_speed) >= MIN_SPEED_RATIO * speed.max(run.fastest) && feed_u_s == run.feed_u_s;
        let full = run.segments >= MAX_SEGMENTS || run.cells.len() + self.scratch.len() > MAX_CELLS;
        // Too short for a run of its own; the slower speed for both costs negligible time.
        let slower = speed.min(run.min_speed);
        let extra =
            run.length * (1.0 / slower - 1.0 / run.min_speed) + segment.length * (1.0 / slower - 1.0 / speed);
        let short = run.length.min(segment.length) < MIN_RUN_S * slower && extra < MIN_RUN_S;
        if run.segments > 0 && (full || !(short || like && run.length < 2.0 * run.stop_distance)) {
            self.close_run(f64::INFINITY)?;
        }
        let own = self
            .scratch
            .iter()
            .map(|cell| self.limits.tangential(cell, cap.min(2.0 * feed_u_s)))
            .map(|(a, j)| (0.5 * speed * (speed / a + a / j)).min(speed * (speed / j).sqrt()))
            .fold(0.0, f64::max);
        let run = &mut self.gathering;
        if run.segments == 0 {
            (run.length, run.stop_distance, run.feed_u_s) = (0.0, 0.0, feed_u_s);
            (run.cap, run.min_speed, run.fastest) = (cap, speed, speed);
        }
        run.cells.append(&mut self.scratch);
        run.segments += 1;
        run.length += segment.length;
        run.feed_u_s = run.feed_u_s.min(feed_u_s);
        run.cap = run.cap.min(cap);
        run.min_speed = run.min_speed.min(speed);
        run.fastest = run.fastest.max(speed);
        run.stop_distance = run.stop_distance.max(own);
        self.sink.segment(&segment)
    }

    fn close_run(&mut self, joint_cap: f64) -> Result<(), S::Error> {
        let run = &mut self.gathering;
        if run.segments == 0 {
            if let Some(last) = self.pending.back_mut() {
                last.cap.nominal = last.cap.nominal.min(joint_cap);
                last.cap.doubled = last.cap.doubled.min(joint_cap);
            }
            return Ok(());
        }
        // The minimum duration applies even if the run could not be extended.
        let cap = run
            .cap
            .min(2.0 * run.feed_u_s)
            .min(run.length / (0.25 * MIN_RUN_S));
        let limits = self.limits.over(&run.cells, cap);
        let nominal = limits.velocity.min(run.feed_u_s);
        let motion = Run {
            length: run.length,
            segments: run.segments,
            limits,
            feed_u_s: run.feed_u_s,
        };
        // The boundary into this run must not be faster than the run itself.
        if let Some(before) = self.pending.back_mut() {
            before.cap.nominal = before.cap.nominal.min(nominal);
            before.cap.doubled = before.cap.doubled.min(limits.velocity);
        }
        let pending = PendingStep {
            motion: Some(motion),
            segments: run.segments as usize,
            cap: ExitSpeeds {
                nominal: nominal.min(joint_cap),
                doubled: limits.velocity.min(joint_cap),
            },
            exit: ExitSpeeds::REST,
        };
        run.segments = 0;
        run.cells.clear();
        self.sink.step(&Step::Run(motion))?;
        self.append(pending);
        Ok(())
    }

    fn append(&mut self, pending: PendingStep) {
        self.pending_segments += pending.segments;
        self.pending.push_back(pending);
        self.since_pass += 1;
        let full = self.pending.len() >= MAX_PENDING || self.pending_segments >= MAX_PENDING_SEGMENTS;
        if self.since_pass >= PASS_EVERY || full {
            let count = self.pass();
            self.commit(count);
            if self.pending.len() >= MAX_PENDING || self.pending_segments >= MAX_PENDING_SEGMENTS {
                self.commit(self.pending.len() / 2);
            }
        }
    }

    /// Backward pass; returns the number of steps from the front that are final.
    fn pass(&mut self) -> usize {
        self.since_pass = 0;
        let (mut nominal_final, mut doubled_final) = (0, 0);
        let mut speed = ExitSpeeds::REST;
        for k in (0..self.pending.len()).rev() {
            let before_cap = if k > 0 {
                self.pending[k - 1].cap
            } else {
                ExitSpeeds::REST
            };
            let step = &mut self.pending[k];
            // The cap of the last step is unknown until its successor is known, unless it is at rest.
            let exit = speed;
            if exit.nominal >= step.cap.nominal {
                nominal_final = nominal_final.max(k + 1);
            }
            if exit.doubled >= step.cap.doubled {
                doubled_final = doubled_final.max(k + 1);
            }
            step.exit = exit;
            self.sink.exit(self.final_steps + k as u64, exit);
            speed = match step.motion {
                None => ExitSpeeds::REST,
                Some(run) => {
                    // A later increase must not invalidate a final speed.
                    let entry = |exit: f64, cap: f64, settled: bool| {
                        if settled {
                            reachable_speed(exit, run.length, &run.limits)
                        } else {
                            monotone_reachable_speed(exit, cap, run.length, &run.limits)
                        }
                    };
                    let nominal = entry(exit.nominal, step.cap.nominal, nominal_final > k);
                    let doubled = entry(exit.doubled, step.cap.doubled, doubled_final > k);
                    ExitSpeeds {
                        nominal: nominal.min(before_cap.nominal),
                        doubled: doubled.min(before_cap.doubled),
                    }
                }
            };
        }
        nominal_final.min(doubled_final)
    }

    fn commit(&mut self, count: usize) {
        for _ in 0..count {
            let Some(step) = self.pending.pop_front() else {
                break;
            };
            self.final_steps += 1;
            self.pending_segments -= step.segments;
            let mut duration = 0.0;
            if let Some(run) = step.motion {
                let from = ScalarState {
                    x: 0.0,
                    v: self.nominal_speed,
                    a: 0.0,
                };
                let limits = ScalarLimits {
                    velocity: run.limits.velocity.min(run.feed_u_s),
                    ..run.limits
                };
                let profile = Profile::solve(from, run.length, step.exit.nominal, step.exit.nominal, &limits);
                self.nominal_speed = profile.exit_speed();
                duration = profile.duration();
            }
            self.sink.planned(self.final_steps - 1, duration);
        }
        self.sink.commit(self.final_steps);
    }
}

/// Maximum speed of the feed metric per unit of parameter speed. It differs from 1 near an involute's base
/// circle, where the parameter advances faster than the path, and on blends.
fn metric_speed(curve: &Curve, from: f64, to: f64) -> f64 {
    let at = |u: f64| {
        let first = curve.jet(u).first;
        (first[0] * first[0] + first[1] * first[1] + first[2] * first[2]).sqrt()
    };
    match curve {
        Curve::Line(_) | Curve::Arc(_) => 1.0,
        // Monotone over the section in which it is not 1.
        Curve::Involute(_) => at(from).max(at(to)).clamp(1e-6, 1.0),
        Curve::Blend(_) | Curve::Spline(_) => {
            let max = (0..=16)
                .map(|k| at(from + (to - from) * f64::from(k) / 16.0))
                .fold(1.0, f64::max);
            if max > 1.0 { max * (1.0 + 1e-4) } else { 1.0 }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use evolvent_path::{Arc, Involute, Line, Plane, Sense};

    use super::*;
    use crate::SegmentMarks;
    use crate::recorder::{Recorder, equal_axes, point};

    fn ahead() -> Lookahead<Recorder> {
        let limits = PathLimits::new(equal_axes(500.0, 2000.0, 50_000.0), 1000.0, 1e-3);
        Lookahead::new(limits, Recorder::default())
    }

    fn straight(from: f64, to: f64) -> Segment {
        let curve = Curve::Line(Line::new(point(from, 0.0), point(to, 0.0)).expect("line"));
        whole(curve)
    }

    fn whole(curve: Curve) -> Segment {
        Segment {
            curve,
            from: 0.0,
            length: curve.domain(),
            line: 1,
            block: 0,
            marks: SegmentMarks::default(),
        }
    }

    /// Distance of a change of speed with zero acceleration at both ends: `(v0 + v1)/2 T`.
    fn distance(v0: f64, v1: f64, limits: &ScalarLimits) -> f64 {
        let (dv, a, j) = ((v0 - v1).abs(), limits.acceleration, limits.jerk);
        let time = if dv <= a * a / j {
            2.0 * (dv / j).sqrt()
        } else {
            a / j + dv / a
        };
        0.5 * (v0 + v1) * time
    }

    #[test]
    fn a_line_takes_the_time_of_its_limits() {
        let mut ahead = ahead();
        ahead.segment(straight(0.0, 100.0), 50.0).expect("plan");
        ahead.finish(2).expect("finish");
        // Each change takes 2 sqrt(V/J) and the distance of half of both at V; 1 % of the jerk is kept as a
        // margin.
        let expected = 100.0 / 50.0 + 2.0 * (50.0_f64 / 49_500.0).sqrt();
        let took: f64 = ahead.sink().durations.iter().sum();
        assert!((took - expected).abs() < 1e-9, "{took} {expected}");
    }

    #[test]
    fn durations_follow_the_boundary_speeds() {
        let mut ahead = ahead();
        ahead.segment(straight(0.0, 200.0), 100.0).expect("plan");
        ahead.segment(straight(200.0, 400.0), 30.0).expect("plan");
        ahead.finish(2).expect("finish");
        let limits = ScalarLimits {
            velocity: 500.0,
            acceleration: 2000.0,
            jerk: 49_500.0,
        };
        // Up to 100, down to 30 at the boundary, then to rest at the end; constant speed in between.
        let braking = |v0: f64, v1: f64| distance(v0, v1, &limits);
        let time = |v0: f64, v1: f64| 2.0 * braking(v0, v1) / (v0 + v1);
        let first = time(0.0, 100.0)
            + time(100.0, 30.0)
            + (200.0 - braking(0.0, 100.0) - braking(100.0, 30.0)) / 100.0;
        let second = time(30.0, 0.0) + (200.0 - braking(30.0, 0.0)) / 30.0;
        let took = &ahead.sink().durations;
        assert!(
            (took[0] - first).abs() < 1e-9 && (took[1] - second).abs() < 1e-9,
            "{took:?} {first} {second}"
        );
    }

    #[test]
    fn a_boundary_has_the_lower_of_both_feeds() {
        let mut ahead = ahead();
        ahead.segment(straight(0.0, 200.0), 100.0).expect("plan");
        ahead.segment(straight(200.0, 400.0), 30.0).expect("plan");
        ahead.segment(straight(400.0, 600.0), 300.0).expect("plan");
        ahead.finish(2).expect("finish");
        let exits = &ahead.sink().exits;
        assert_eq!(exits.len(), 4);
        for exit in &exits[..2] {
            assert!(
                (exit.nominal - 30.0).abs() < 1e-9 && (exit.doubled - 60.0).abs() < 1e-9,
                "{exit:?}"
            );
        }
    }

    #[test]
    fn a_boundary_cap_holds_from_either_side() {
        let mut ahead = ahead();
        ahead.segment(straight(0.0, 200.0), 100.0).expect("plan");
        ahead.boundary(7.0).expect("plan");
        ahead.boundary(5.0).expect("plan");
        ahead.boundary(6.0).expect("plan");
        ahead.segment(straight(200.0, 400.0), 100.0).expect("plan");
        ahead.finish(2).expect("finish");
        let exit = ahead.sink().exits[0];
        assert!(
            (exit.nominal - 5.0).abs() < 1e-12 && (exit.doubled - 5.0).abs() < 1e-12,
            "{exit:?}"
        );
    }

    #[test]
    fn short_blocks_of_equal_feed_form_one_run() {
        let mut ahead = ahead();
        for k in 0..100 {
            let x = f64::from(k) * 0.01;
            ahead.segment(straight(x, x + 0.01), 20.0).expect("plan");
        }
        ahead.finish(2).expect("finish");
        let runs = ahead.sink().runs();
        assert_eq!(runs.len(), 1);
        assert_eq!(runs[0].0.segments, 100);
        assert!((runs[0].0.length - 1.0).abs() < 1e-12 && (runs[0].0.feed_u_s - 20.0).abs() < 1e-12);
    }

    #[test]
    fn every_boundary_speed_is_reachable_and_maximal() {
        // Blocks of random length and feed; the limits on a straight line are those of the axis.
        let seed = 0x100c_0001_u64;
        println!("seed {seed:#x}");
        let mut random = evolvent_random::Random::from_state(seed);
        let mut unit = || random.unit();
        let mut ahead = ahead();
        let mut at = 0.0;
        for _ in 0..1500 {
            let length = 0.5 * 20.0_f64.powf(unit());
            ahead
                .segment(straight(at, at + length), 5.0 * 60.0_f64.powf(unit()))
                .expect("plan");
            at += length;
        }
        ahead.finish(2).expect("finish");
        let runs = ahead.sink().runs();
        assert!(runs.len() > 1000, "{}", runs.len());
        for (k, (run, entry, exit)) in runs.iter().enumerate() {
            let limits = &run.limits;
            assert!((limits.acceleration - 2000.0).abs() < 1e-9 && (limits.jerk - 49_500.0).abs() < 1e-6);
            let top = limits.velocity.min(run.feed_u_s) * (1.0 + 1e-12);
            assert!(
                *entry <= top && *exit <= top,
                "run {k}: {entry} {exit} above {top}"
            );
            if entry > exit {
                let needs = distance(*entry, *exit, limits);
                assert!(
                    needs <= run.length * (1.0 + 1e-9),
                    "run {k}: {needs} of {}",
                    run.length
                );
            }
            // The entry speed is at one of its bounds: this run's, the previous run's, or the braking
            // distance.
            if k > 0 {
                let before = &runs[k - 1].0;
                let bound = top.min(before.limits.velocity.min(before.feed_u_s) * (1.0 + 1e-12));
                let faster = entry * (1.0 + 1e-6) + 1e-9;
                let could = faster <= bound && distance(faster, *exit, limits) <= run.length;
                assert!(!could, "run {k}: {entry} could be faster, bound {bound}");
            }
        }
    }

    #[test]
    fn a_curve_is_divided_where_its_halves_differ() {
        // A narrow involute: the permitted speed grows with the radius of curvature.
        let radius = 2.0;
        let position = |phi: f64| {
            let (sin, cos) = phi.sin_cos();
            point(radius * (cos + phi * sin), radius * (sin - phi * cos))
        };
        let involute = Involute::new(
            Plane::Xy,
            position(0.5),
            position(9.0),
            [0.0, 0.0],
            radius,
            Sense::CounterClockwise,
            1e-9,
        );
        let curve = Curve::Involute(involute.expect("involute"));
        let mut ahead = ahead();
        let mut one = whole(curve);
        one.marks.joint = true;
        ahead.segment(one, 400.0).expect("plan");
        ahead.finish(2).expect("finish");
        let segments = &ahead.sink().segments;
        assert!(segments.len() > 3, "{}", segments.len());
        let mut at = 0.0;
        for (k, segment) in segments.iter().enumerate() {
            assert!((segment.from - at).abs() < 1e-12 * curve.domain());
            assert_eq!(
                segment.marks.joint,
                k == 0,
                "only the first piece starts at the joint"
            );
            at += segment.length;
        }
        assert!((at - curve.domain()).abs() < 1e-12 * at);
        let counted: u32 = ahead.sink().runs().iter().map(|run| run.0.segments).sum();
        assert_eq!(counted as usize, segments.len());
        // A full circle is uniform, and a feed that limits everywhere leaves nothing to gain.
        let circle = Arc::new(
            Plane::Xy,
            point(0.0, 0.0),
            point(0.0, 0.0),
            [5.0, 0.0],
            Sense::Clockwise,
            0,
        );
        for (curve, feed) in [(Curve::Arc(circle.expect("arc")), 400.0), (curve, 2.0)] {
            let mut ahead = self::ahead();
            ahead.segment(whole(curve), feed).expect("plan");
            ahead.finish(2).expect("finish");
            assert_eq!(ahead.sink().segments.len(), 1);
        }
    }
}
