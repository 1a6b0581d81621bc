//! Drives a plan more slowly than it was made, without a planner: down to rest, to a part of its speed, and
//! back.
//!
//! Plan time `tau` passes at the rate `s = dtau/dt`, `0 <= s <= 1`. With the derivatives `q', q'', q'''` of
//! the plan by its own time, an axis has
//!
//! ```text
//!   acceleration  s^2 q'' + s' q'
//!   jerk          s^3 q''' + 3 s s' q'' + s'' q'
//! ```
//!
//! A plan at a constant rate up to 1 keeps every limit, so a change of the rate that can end at a constant
//! rate is safe. In every trial the cycle chooses the `s''` that changes the rate most towards the target
//! and is known to be safe: it follows the motion over the plan ahead, first with that `s''` for one trial
//! and then, in steps, with the `s''` that brings `s'` to zero soonest within the limits (the
//! *recovery*). It accepts the trial only if no axis exceeds a limit meanwhile and the rate does not pass the
//! target. Otherwise it drives one whole step of the recovery of the previous trial, so there is a next step
//! at every moment. If the recovery would pass the target, `s'' = s'^2/(2 (s - target))` reaches it with `s'
//! = 0`.
//!
//! Trials are shorter than the steps of a recovery because a constant `s''` must fit under every jerk peak of
//! the plan within its time: on dense contours the jerk of a plan reaches its limit several times per
//! millisecond.
//!
//! A step takes [`SHORTEST_STEP_S`], and a trial [`TRIAL_FRACTION`] of it. Where axes need long to change
//! their acceleration, recoveries are long: a recovery of more than [`MAX_STEPS`] steps doubles the step, and
//! one of fewer than [`MIN_STEPS`] halves it, each as soon as the recovery in the other steps is safe, too.
//!
//! On a straight line this is the time-optimal jerk-limited stop, except for the length of a step. Where the
//! plan itself brakes at the limits of an axis, the slowdown leaves it unchanged: nothing is faster there.
//!
//! Cost: at most [`TRIALS`] + 4 recoveries per trial, each over the part of the plan in which the axes change
//! from one acceleration to another. No allocation.

mod recovery;
#[cfg(test)]
mod tests;

use evolvent_machine::Limits;
use evolvent_path::AXES;

use self::recovery::{Follower, Outlook, axes_in_use};
use crate::plan_preview::{PlanPreview, Sample};
use crate::queue::PlanConsumer;
use crate::scale::Scale;

/// Minimum time for which `s''` is constant in a recovery. Tuned: 0.5 ms for both times stops earlier than
/// 0.25 ms for trials in some holds and later in more, for 1.4 times the work.
pub(crate) const SHORTEST_STEP_S: f64 = 0.001;
/// Maximum of that time: recoveries of up to [`MAX_STEPS`] of these take as long as the longest preview.
const LONGEST_STEP_S: f64 = 64.0 * SHORTEST_STEP_S;
/// Time for which the `s''` of a trial is constant, as a fraction of a step. Tuned on 360 holds on dense
/// contours with steps of 1 ms: compared with 1 ms, 0.5 ms stops 3.2 ms earlier on average and at most 29 ms
/// earlier, for 1.6 times the work; 0.25 ms another 1.9 ms and at most 16 ms, for 2.6 times the work.
const TRIAL_FRACTION: f64 = 0.25;
/// Numbers of steps of a recovery above which steps become longer, and below which they become shorter. The
/// first bounds the mean work per millisecond of a hold wherever the longer steps are safe; half of it is more
/// than the second, so that a change is not reversed.
const MAX_STEPS: u32 = 64;
const MIN_STEPS: u32 = 24;
/// Maximum number of steps of a recovery.
const LONGEST_RECOVERY: u32 = 256;
/// Number of values of `s''` between that of the recovery and the lowest that are tried in a step, and that
/// number in steps of more than [`LONG_STEP_S`]: all are tried in one cycle.
const TRIALS: u32 = 4;
const TRIALS_OF_LONG_STEPS: u32 = 1;
const LONG_STEP_S: f64 = 8.0 * SHORTEST_STEP_S;
/// Fractions of the acceleration and jerk limits that an axis may use. If the plan itself uses more, the same
/// as the plan.
const ALLOWED: (f64, f64) = (1.0, 1.002);
/// The fraction of a step at its start in which `s''` hardly changes the acceleration, and the fraction of
/// its limit that an axis may use there. The value is above the one at the end of the previous step, so that
/// a tiny excess over the limit does not require an excessive `s''`; it is so small that a jump of the plan's
/// jerk in this part does not hide a peak.
const EARLY_FRACTION: f64 = 0.3;
const EARLY_ALLOWED: f64 = 1.0004;
/// Factors by which a step may exceed these fractions between the instants of its bounds.
const ROUNDING: (f64, f64) = (1.0002, 1.004);
/// Relative change of the target that is ignored while a new plan is pending: overrides from a sensor change
/// all the time.
const NEARLY: f64 = 0.01;
/// Rounding at the end of a step, s.
const NO_TIME_S: f64 = 1e-9 * SHORTEST_STEP_S;
/// Tolerance within which a rate has reached the target, and `|s'|` below which the rate is constant, 1/s.
const AT_TARGET: f64 = 1e-9;
const STILL: f64 = 1e-9;

/// Maximum `|s''|`, 1/s2, with steps of `step_s`. A stop then takes at least eleven steps, however slow the
/// axes are, and `1.5 s''^2 t^3 q''`, which the bounds of a step neglect, stays below a hundredth of the jerk
/// limit where the plan has just started to move.
fn max_second(step_s: f64) -> f64 {
    1.0 / (32.0 * step_s * step_s)
}

/// The phase of a slowdown.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Towards the target, with another `s''` in every step.
    Changing,
    /// To the target with the present `s''`, for the remaining seconds.
    Landing,
    /// As `Landing`, but the target has changed since. Only the landing is known to be safe, for this many
    /// more seconds.
    Diverted(f64),
    /// At a constant rate.
    Steady,
}

/// The effect of a change of the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lead {
    /// The target is the same, or reached.
    Same,
    /// A change of the rate gets another target.
    Other,
    /// The rate was constant: the preview has to begin again.
    FromSteady,
}

/// A rate of plan time, its derivative, and the plan time that has passed.
#[derive(Clone, Copy, Debug, PartialEq)]
struct RateState {
    time: f64,
    rate: f64,
    first: f64,
}

impl RateState {
    fn after(self, seconds: f64, second: f64) -> Self {
        let t = seconds;
        Self {
            time: self.time + t * (self.rate + t * (0.5 * self.first + t * second / 6.0)),
            rate: self.rate + t * (self.first + 0.5 * t * second),
            first: self.first + t * second,
        }
    }
}

/// Samples of the plan ahead, by index in the order of plan time.
pub(crate) trait Lookahead {
    /// Index of the oldest stored sample.
    fn oldest(&self) -> usize;

    /// Drops the samples before plan time `time`, except the last of them.
    fn release(&mut self, time: f64);

    /// Sample number `index`; none after the plan's end or beyond the range of the look ahead.
    fn sample(&mut self, index: usize) -> Option<&Sample>;

    /// Plan time at which the plan rests, once the preview has reached it.
    fn rests_at(&self) -> Option<f64>;
}

/// The plan in the queue, as seen by the preview.
pub(crate) struct Ahead<'a> {
    pub(crate) preview: &'a mut PlanPreview,
    pub(crate) queue: &'a mut PlanConsumer,
}

impl Lookahead for Ahead<'_> {
    fn oldest(&self) -> usize {
        self.preview.oldest()
    }

    fn release(&mut self, time: f64) {
        self.preview.release(time);
    }

    fn sample(&mut self, index: usize) -> Option<&Sample> {
        self.preview.sample(index, self.queue)
    }

    fn rests_at(&self) -> Option<f64> {
        self.preview.rests_at()
    }
}

/// A slowdown. `Copy`: the samples are stored in a separate [`PlanPreview`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Slowdown {
    now: RateState,
    second: f64,
    /// Remaining seconds of `second`.
    left: f64,
    target: f64,
    phase: Phase,
    /// Duration of a step, s: [`SHORTEST_STEP_S`] times a power of two.
    step_s: f64,
    /// Number of steps of the recovery that is known to be safe.
    steps: u32,
}

impl Slowdown {
    /// A slowdown from the plan's own speed towards the rate `target`. The preview begins at the present
    /// position in the plan.
    pub(crate) fn new(target: f64) -> Self {
        Self {
            now: RateState {
                time: 0.0,
                rate: 1.0,
                first: 0.0,
            },
            second: 0.0,
            left: 0.0,
            target,
            phase: Phase::Changing,
            step_s: SHORTEST_STEP_S,
            steps: 0,
        }
    }

    /// The present scale. Real-time safe.
    pub(crate) fn scale(&self) -> Scale {
        Scale {
            rate: self.now.rate,
            first: self.now.first,
            second: self.second,
        }
    }

    /// Changes the target. If the rate was constant, the preview has to begin again at the present position
    /// in the plan, since its samples have been passed.
    #[must_use]
    pub(crate) fn lead_to(&mut self, target: f64) -> Lead {
        if target == self.target {
            return Lead::Same;
        }
        self.target = target;
        let was_steady = self.phase == Phase::Steady;
        if was_steady && (self.now.rate - target).abs() <= AT_TARGET {
            return Lead::Same;
        }
        self.phase = match self.phase {
            Phase::Landing => Phase::Diverted(self.left),
            Phase::Diverted(left) => Phase::Diverted(left),
            Phase::Changing | Phase::Steady => Phase::Changing,
        };
        if was_steady {
            (self.now.time, self.left) = (0.0, 0.0);
            (self.step_s, self.steps) = (SHORTEST_STEP_S, 0);
            return Lead::FromSteady;
        }
        if let Phase::Diverted(_) = self.phase {
            self.left = 0.0;
        }
        Lead::Other
    }

    /// Whether its target is so close to `target` that a pending plan is preferable.
    pub(crate) fn is_nearly(&self, target: f64) -> bool {
        (target - self.target).abs() <= NEARLY * self.target
    }

    /// Plan time since the start of the slowdown, s.
    pub(crate) fn plan_time(&self) -> f64 {
        self.now.time
    }

    /// Whether plan time has stopped.
    pub(crate) fn is_at_rest(&self) -> bool {
        self.phase == Phase::Steady && self.now.rate == 0.0
    }

    /// The rate, if it is constant until the target changes.
    pub(crate) fn steady_rate(&self) -> Option<f64> {
        (self.phase == Phase::Steady).then_some(self.now.rate)
    }

    /// Advances by `period`; returns the plan time that passes. Real-time safe.
    pub(crate) fn advance<A: Lookahead>(&mut self, period: f64, limits: &Limits, ahead: &mut A) -> f64 {
        let before = self.now.time;
        let mut rest = period;
        while rest > 0.0 {
            if self.phase == Phase::Steady {
                self.now.time += rest * self.now.rate;
                break;
            }
            // Avoids a tiny step if the period is a whole number of steps.
            if self.left <= NO_TIME_S {
                self.end_step(limits, ahead);
                continue;
            }
            let part = rest.min(self.left);
            self.now = self.now.after(part, self.second);
            self.left -= part;
            if let Phase::Diverted(left) = &mut self.phase {
                *left -= part;
            }
            rest -= part;
        }
        if self.phase == Phase::Landing && self.left <= NO_TIME_S {
            self.settle(self.target);
        }
        // A hold that arrives while the rate returns to 1 may turn it round within rounding of 1; clamping it
        // there would be a step.
        self.now.rate = self.now.rate.max(0.0);
        self.now.time - before
    }

    /// Continues at a constant rate.
    fn settle(&mut self, rate: f64) {
        (self.now.rate, self.now.first, self.second) = (rate, 0.0, 0.0);
        self.left = f64::INFINITY;
        self.phase = Phase::Steady;
    }

    /// Chooses the continuation after a step.
    fn end_step<A: Lookahead>(&mut self, limits: &Limits, ahead: &mut A) {
        let off = (self.now.rate - self.target).abs();
        if let Phase::Diverted(left) = self.phase
            && left <= NO_TIME_S
        {
            // The landing has ended at its original target.
            self.settle(self.now.rate);
            self.phase = Phase::Changing;
            self.left = 0.0;
        }
        if self.phase == Phase::Landing || (self.now.first.abs() <= STILL && off <= AT_TARGET) {
            self.settle(self.target);
        } else {
            self.next_step(limits, ahead);
        }
    }

    /// Chooses `s''` for the next step.
    fn next_step<A: Lookahead>(&mut self, limits: &Limits, ahead: &mut A) {
        let from = self.now;
        ahead.release(from.time);
        let begin = ahead.oldest();
        let mut follower = Follower {
            ahead,
            limits,
            axes: axes_in_use(limits),
            target: self.target,
            step_s: self.step_s,
        };
        self.resize_step(&mut follower, begin);
        let step_s = self.step_s;
        let (trial_s, max_second) = (TRIAL_FRACTION * step_s, max_second(step_s));
        self.left = step_s;
        let Some((bounds, _)) = follower.bounds(from, begin, step_s) else {
            // The plan stops within the step at its present rate.
            self.second = (-from.first / step_s).clamp(-max_second, max_second);
            return;
        };
        let recovery = bounds.recovery(from);
        if let Phase::Diverted(left) = self.phase {
            // A landing is closer to its target than a recovery could stop: if it passes the new target it
            // may also pass zero.
            match follower.outlook(from, begin, recovery, step_s) {
                Outlook::Safe => self.phase = Phase::Changing,
                Outlook::Past | Outlook::Unsafe => {
                    self.left = left.min(step_s);
                    return;
                }
            }
        }
        self.second = recovery;
        let Some((bounds, _)) = follower.bounds(from, begin, trial_s) else {
            return;
        };
        let most = if self.target < from.rate {
            bounds.lower.max(-max_second).min(recovery)
        } else {
            bounds.upper.min(max_second).max(recovery)
        };
        let outlook = self.attempt(&mut follower, begin, most);
        if outlook == Outlook::Safe {
            return;
        }
        let (mut safe, mut unsafe_second) = (recovery, most);
        if outlook == Outlook::Past {
            if let Some((second, seconds)) = follower.landing(from, begin) {
                (self.second, self.left, self.phase) = (second, seconds, Phase::Landing);
                return;
            }
            // The value after which a recovery of one step ends at the target. From rates near it, each of
            // the values below passes it.
            let off = self.target - from.rate - from.first * (trial_s + 0.5 * step_s);
            let exact = 2.0 * off / (trial_s * (trial_s + step_s));
            let between = (exact - most) * (exact - recovery) < 0.0;
            if between && self.attempt(&mut follower, begin, exact) == Outlook::Safe {
                safe = exact;
            }
        }
        let trials = if step_s > LONG_STEP_S {
            TRIALS_OF_LONG_STEPS
        } else {
            TRIALS
        };
        for _ in 0..trials {
            let middle = 0.5 * (safe + unsafe_second);
            if self.attempt(&mut follower, begin, middle) == Outlook::Safe {
                safe = middle;
            } else {
                unsafe_second = middle;
            }
        }
    }

    /// Follows a trial, and takes its `s''` if it is safe.
    fn attempt<A: Lookahead>(
        &mut self,
        follower: &mut Follower<'_, A>,
        begin: usize,
        second: f64,
    ) -> Outlook {
        let trial_s = TRIAL_FRACTION * self.step_s;
        let (outlook, steps) = follower.recovered(self.now, begin, second, trial_s);
        if outlook == Outlook::Safe {
            (self.second, self.left, self.steps) = (second, trial_s, steps);
        }
        outlook
    }

    /// Doubles or halves the step if the recovery of the last trial was long or short, and the recovery from
    /// here is safe in the other steps, too.
    fn resize_step<A: Lookahead>(&mut self, follower: &mut Follower<'_, A>, begin: usize) {
        let other = if self.steps > MAX_STEPS && self.step_s < LONGEST_STEP_S {
            2.0 * self.step_s
        } else if self.steps < MIN_STEPS && self.step_s > SHORTEST_STEP_S {
            0.5 * self.step_s
        } else {
            return;
        };
        follower.step_s = other;
        let from = self.now;
        let safe = follower.bounds(from, begin, other).and_then(|(bounds, _)| {
            let (outlook, steps) = follower.recovered(from, begin, bounds.recovery(from), other);
            (outlook == Outlook::Safe).then_some(steps)
        });
        match safe {
            Some(steps) => (self.step_s, self.steps) = (other, steps),
            None => follower.step_s = self.step_s,
        }
    }
}

/// The plan between two samples, for the first `axes` axes: cubic in velocity and acceleration, whose
/// derivatives are known too; the jerk is the derivative of that acceleration. Linear interpolation of the
/// jerk would be up to 0.04 of the limit too low on pieces with curved jerk.
pub(crate) fn between(left: &Sample, right: &Sample, time: f64, axes: usize) -> Sample {
    let length = right.time - left.time;
    let t = ((time - left.time) / length).clamp(0.0, 1.0);
    let (u, tt) = (1.0 - t, t * t);
    let (to, out_of, into) = (tt * (3.0 - 2.0 * t), length * t * u * u, -length * tt * u);
    let cubic = |from: f64, end: f64, slope: f64, end_slope: f64| {
        from + to * (end - from) + out_of * slope + into * end_slope
    };
    let (leaving, arriving, rise) = (u * (1.0 - 3.0 * t), t * (3.0 * t - 2.0), 6.0 * t * u / length);
    let mut plan = *left;
    for i in 0..axes.min(AXES) {
        plan.first[i] = cubic(left.first[i], right.first[i], left.second[i], right.second[i]);
        plan.second[i] = cubic(left.second[i], right.second[i], left.third[i], right.third[i]);
        plan.third[i] =
            leaving * left.third[i] + arriving * right.third[i] + rise * (right.second[i] - left.second[i]);
    }
    plan.time = time;
    plan
}
