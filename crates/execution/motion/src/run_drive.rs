//! Drives along the runs of a classic plan.
//!
//! The planner leaves every run with zero acceleration, so a profile is solved run by run. Stopping like that
//! takes much longer than necessary if runs are short: each sheds only a fraction of the speed. A stop is
//! therefore solved over as many runs as it needs, within the smallest of their limits, which hold for any
//! speed, acceleration and jerk up to them. It does not pass the start of a run with a step of curvature,
//! where acceleration has to be zero.
//!
//! From a state within such a stop the present run cannot be left with zero acceleration. To continue the
//! program, the acceleration is brought to zero over as many runs as needed; if the plan after them is too
//! slow for that, the stop continues.

use evolvent_planner::{Outcome, Profile, Run, ScalarLimits, ScalarState, Step};

use crate::cursor::{ActiveMotion, Cursor};
use crate::queue::PlanConsumer;

/// Maximum number of runs over which one profile is solved. Less than [`STEPS_AHEAD`](crate::STEPS_AHEAD) by
/// the number that one cycle may pass.
const MAX_RUNS: usize = 48;
/// Maximum number of attempts to slow down over fewer runs if no stop fits.
const MAX_ATTEMPTS: usize = 3;
/// Rounding of speeds and accelerations, as a fraction.
const ROUNDING: f64 = 1e-9;
/// Rounding of positions, parameter units.
const POSITION_ROUNDING: f64 = 1e-12;

/// A run and the profile that was solved for it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RunDrive {
    pub(crate) feed_u_s: f64,
    /// The profile was solved for braking.
    pub(crate) braking: bool,
    length: f64,
    segments: u32,
    limits: ScalarLimits,
    profile: Profile,
    /// Seconds since the profile's start.
    time: f64,
    /// Position of the profile at which the run starts.
    offset: f64,
    /// Number of runs after this one over which the profile extends.
    span: u32,
    /// The profile was solved over more than one run.
    is_long: bool,
    /// The profile ends within a run, with zero acceleration.
    levels: bool,
}

/// How a run is driven.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    /// Stop as soon as possible.
    pub(crate) brake: bool,
    pub(crate) feed_override: f64,
}

/// The outcome of a period on a run.
pub(crate) enum RunProgress {
    /// The run continues.
    Within,
    /// The profile has ended, and another one has to be solved from here.
    Levelled,
    /// The run has ended, and the next step begins with this state.
    Left(ScalarState),
}

/// A profile, and the number of runs after the present one over which it extends.
struct Solution {
    profile: Profile,
    span: usize,
    levels: bool,
}

impl RunDrive {
    fn new(run: &Run) -> Self {
        Self {
            feed_u_s: run.feed_u_s,
            braking: false,
            length: run.length,
            segments: run.segments,
            limits: run.limits,
            profile: Profile::at_rest(0.0),
            time: 0.0,
            offset: 0.0,
            span: 0,
            is_long: false,
            levels: false,
        }
    }

    /// Permitted speed with this multiple of the programmed feed.
    fn bound(&self, factor: f64) -> f64 {
        self.limits.velocity.min(self.feed_u_s * factor) * (1.0 + ROUNDING)
    }

    /// State and jerk, as a function of the parameter from the start of the run.
    pub(crate) fn now(&self) -> (ScalarState, f64) {
        let (mut state, jerk) = self.profile.at(self.time);
        state.x -= self.offset;
        (state, jerk)
    }

    /// Whether the axes are at rest before the end of the run.
    pub(crate) fn rests(&self) -> bool {
        self.profile.at(self.time).0.v == 0.0 && self.profile.outcome() == Outcome::Rests
    }

    /// The earliest stop; `None` if the present profile has to continue first.
    fn brake(
        &self,
        from: ScalarState,
        pace: Pace,
        at: RunIndex,
        queue: &mut PlanConsumer,
    ) -> Option<Solution> {
        let exits = queue.exit(at.step);
        let alone = || Solution::alone(Profile::brake(from, self.length, exits.doubled, &self.limits));
        if from.stopping_distance(&self.limits) <= self.length - from.x
            || !queue.record_lookup(queue.has_final(at.step, MAX_RUNS as u64))
        {
            return Some(alone()).filter(|solution| self.accepts(solution));
        }
        let mut chain = RunChain::new(self, from, pace, at, exits.doubled);
        let mut last_run = 0;
        while chain.extend(queue) {
            let last = chain.last();
            if from.stopping_distance(&last.limits) > last.end - from.x {
                last_run = chain.count - 1;
                continue;
            }
            let profile = Profile::brake(from, last.end, 0.0, &last.limits);
            match chain.first_too_fast(&profile, chain.count - 1) {
                None => {
                    return Some(Solution {
                        profile,
                        span: chain.count - 1,
                        levels: false,
                    });
                }
                Some(run) => {
                    last_run = run - 1;
                    break;
                }
            }
        }
        for _ in 0..MAX_ATTEMPTS {
            if last_run == 0 {
                break;
            }
            let RunEnd {
                end, limits, exit, ..
            } = chain.runs[last_run];
            let profile = Profile::brake(from, end, exit, &limits);
            let too_fast = chain.first_too_fast(&profile, last_run);
            if profile.outcome() != Outcome::Overruns && too_fast.is_none() {
                return Some(Solution {
                    profile,
                    span: last_run,
                    levels: false,
                });
            }
            last_run = too_fast.map_or(last_run / 2, |run| run - 1);
        }
        Some(alone()).filter(|solution| self.accepts(solution))
    }

    /// The continuation of the plan; `None` if the present profile has to continue first.
    fn go_on(
        &self,
        from: ScalarState,
        pace: Pace,
        at: RunIndex,
        queue: &mut PlanConsumer,
    ) -> Option<Solution> {
        let exits = queue.exit(at.step);
        let limits = ScalarLimits {
            velocity: self.limits.velocity.min(self.feed_u_s * pace.feed_override),
            ..self.limits
        };
        let desired = exits.at_override(pace.feed_override);
        let alone = Solution::alone(Profile::solve(from, self.length, desired, exits.doubled, &limits));
        if self.accepts(&alone) {
            return Some(alone);
        }
        if !queue.record_lookup(queue.has_final(at.step, MAX_RUNS as u64)) {
            return None;
        }
        let mut chain = RunChain::new(self, from, pace, at, exits.doubled);
        while chain.extend(queue) {
            let last = chain.last();
            let profile = Profile::level_off(from, &last.limits);
            let end = profile.end();
            if end.x > last.end - POSITION_ROUNDING {
                continue;
            }
            // The plan can be driven from there.
            let fits = end.v <= last.exit || end.stopping_distance(&last.limits) <= last.end - end.x;
            let permitted = fits && chain.first_too_fast(&profile, chain.count - 1).is_none();
            return permitted.then_some(Solution {
                profile,
                span: chain.count - 1,
                levels: true,
            });
        }
        None
    }

    /// Whether to drive a profile for the present run alone. A state within a profile over several runs may
    /// not permit one.
    fn accepts(&self, alone: &Solution) -> bool {
        !self.is_long || alone.profile.outcome() != Outcome::Overruns
    }

    fn solve(&mut self, from: ScalarState, pace: Pace, at: RunIndex, queue: &mut PlanConsumer) {
        let solution = if pace.brake {
            self.brake(from, pace, at, queue)
        } else {
            self.go_on(from, pace, at, queue)
        };
        if let Some(solution) = solution {
            self.profile = solution.profile;
            (self.time, self.offset) = (0.0, 0.0);
            self.span = solution.span as u32;
            self.is_long = solution.span > 0 || solution.levels;
            self.levels = solution.levels;
            self.braking = pace.brake;
        }
    }
}

impl Solution {
    fn alone(profile: Profile) -> Self {
        Self {
            profile,
            span: 0,
            levels: false,
        }
    }
}

/// Number of the step of a run, and of its first segment.
#[derive(Clone, Copy, Debug)]
struct RunIndex {
    step: u64,
    segment: u64,
}

/// The end of a run in a chain.
#[derive(Clone, Copy, Debug)]
struct RunEnd {
    /// Position from the start of the first run.
    end: f64,
    /// The minimum acceleration and jerk from the first run to this one.
    limits: ScalarLimits,
    /// Permitted speed at the end, with zero acceleration.
    exit: f64,
    /// Permitted speed in this run.
    bound: f64,
}

/// The present run and the following ones over which a profile may extend.
struct RunChain {
    runs: [RunEnd; MAX_RUNS],
    count: usize,
    from: ScalarState,
    /// Maximum speed of a profile.
    peak: f64,
    /// Feed as a multiple of the programmed one.
    factor: f64,
    /// The last run.
    at: RunIndex,
    segments: u32,
}

impl RunChain {
    fn new(run: &RunDrive, from: ScalarState, pace: Pace, at: RunIndex, exit: f64) -> Self {
        let peak = from.v.max(from.relaxed_speed(run.limits.jerk));
        // The speed may be left over from a higher override.
        let factor = pace.feed_override.max(peak / run.feed_u_s);
        let first = RunEnd {
            end: run.length,
            limits: run.limits,
            exit,
            bound: run.bound(factor).max(peak),
        };
        Self {
            runs: [first; MAX_RUNS],
            count: 1,
            from,
            peak,
            factor,
            at,
            segments: run.segments,
        }
    }

    fn last(&self) -> RunEnd {
        self.runs[self.count - 1]
    }

    /// Adds the next run. Returns `false` if the chain ends.
    fn extend(&mut self, queue: &mut PlanConsumer) -> bool {
        let before = self.last();
        let next = RunIndex {
            step: self.at.step + 1,
            segment: self.at.segment + u64::from(self.segments),
        };
        if self.count >= MAX_RUNS || before.exit <= 0.0 || !queue.is_final(next.step) {
            return false;
        }
        let Some(Step::Run(run)) = queue.step(next.step) else {
            return false;
        };
        let has_step = queue
            .segment(next.segment)
            .is_none_or(|segment| segment.marks.joint);
        let limits = ScalarLimits {
            velocity: run.limits.velocity,
            acceleration: run.limits.acceleration.min(before.limits.acceleration),
            jerk: run.limits.jerk.min(before.limits.jerk),
        };
        // A profile within these limits has to begin within them, must not run backwards, and must not become
        // too fast.
        let relaxed = self.from.relaxed_speed(limits.jerk);
        let begins = self.from.a.abs() <= limits.acceleration * (1.0 + ROUNDING)
            && (0.0..=self.runs[0].bound).contains(&relaxed);
        if has_step || !begins {
            return false;
        }
        self.peak = self.peak.max(relaxed);
        self.runs[self.count] = RunEnd {
            end: before.end + run.length,
            limits,
            exit: queue.exit(next.step).doubled,
            bound: RunDrive::new(&run).bound(self.factor),
        };
        self.count += 1;
        (self.at, self.segments) = (next, run.segments);
        true
    }

    /// The first run, up to number `last`, in which a profile that slows down is faster than permitted.
    fn first_too_fast(&self, profile: &Profile, last: usize) -> Option<usize> {
        (1..=last).find(|&k| {
            let bound = self.runs[k].bound;
            self.peak > bound && profile.falls_below(bound) > self.runs[k - 1].end
        })
    }
}

impl Cursor {
    /// Starts a run.
    pub(crate) fn enter_run(&mut self, run: &Run, from: ScalarState, pace: Pace, queue: &mut PlanConsumer) {
        let mut drive = RunDrive::new(run);
        drive.solve(from, pace, self.run_index(), queue);
        self.drive = ActiveMotion::Run(drive);
    }

    /// Solves the present run again.
    pub(crate) fn solve_run(&mut self, pace: Pace, queue: &mut PlanConsumer) {
        let at = self.run_index();
        if let ActiveMotion::Run(run) = &mut self.drive {
            let (now, _) = run.now();
            run.solve(now, pace, at, queue);
        }
    }

    fn run_index(&self) -> RunIndex {
        RunIndex {
            step: self.step,
            segment: self.run_segment,
        }
    }

    /// Drives a run for the rest of the period.
    pub(crate) fn advance_run(&mut self, left: &mut f64, queue: &mut PlanConsumer) -> RunProgress {
        let ActiveMotion::Run(run) = &mut self.drive else {
            return RunProgress::Within;
        };
        let rest = run.profile.duration() - run.time;
        if *left < rest || run.profile.outcome() == Outcome::Rests {
            run.time = (run.time + *left).min(run.profile.duration());
            self.pass_runs(false, queue);
            return RunProgress::Within;
        }
        *left -= rest.max(0.0);
        run.time = run.profile.duration();
        let levels = run.levels;
        self.pass_runs(!levels, queue);
        let ActiveMotion::Run(run) = &mut self.drive else {
            return RunProgress::Within;
        };
        if levels {
            // Zero acceleration, at a speed from which this run can be driven.
            run.is_long = false;
            return RunProgress::Levelled;
        }
        let (end, length, segments) = (run.now().0, run.length, run.segments);
        self.leave_run(length, segments);
        self.drive = ActiveMotion::Still;
        self.rest.x = end.x - length;
        RunProgress::Left(ScalarState {
            x: self.rest.x,
            ..end
        })
    }

    /// Passes the runs that a profile over several runs has left, or `all` of them before its last.
    fn pass_runs(&mut self, all: bool, queue: &mut PlanConsumer) {
        while let ActiveMotion::Run(run) = &self.drive
            && run.span > 0
            && (all || run.now().0.x >= run.length)
            && let Some(Step::Run(next)) = queue.step(self.step + 1)
        {
            let passed = *run;
            self.drive = ActiveMotion::Run(RunDrive {
                feed_u_s: next.feed_u_s,
                length: next.length,
                segments: next.segments,
                limits: next.limits,
                offset: passed.offset + passed.length,
                span: passed.span - 1,
                ..passed
            });
            self.leave_run(passed.length, passed.segments);
        }
    }

    /// Leaves a run; the next step begins after it.
    fn leave_run(&mut self, length: f64, segments: u32) {
        self.step += 1;
        self.travelled += length;
        self.segment_start -= length;
        self.run_segment += u64::from(segments);
    }
}
