//! The consequences of a second derivative of the rate: a recovery over the plan ahead, within the limits.

use evolvent_machine::Limits;
use evolvent_path::AXES;

use super::{
    ALLOWED, AT_TARGET, EARLY_ALLOWED, EARLY_FRACTION, LONGEST_RECOVERY, Lookahead, NO_TIME_S, ROUNDING,
    RateState, STILL, between, max_second,
};
use crate::plan_preview::Sample;

/// The outcome of a step with a certain `s''`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outlook {
    /// The rate can become constant without passing the target.
    Safe,
    /// The rate can become constant only after it has passed the target.
    Past,
    /// An axis would exceed a limit, or the plan is not known far enough.
    Unsafe,
}

/// The range of `s''` within the limits in one step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) lower: f64,
    pub(super) upper: f64,
    /// Amount by which a bound may be exceeded between instants.
    slack: f64,
    /// Duration of the steps of the recovery, s.
    step_s: f64,
}

impl Bounds {
    /// The value that brings `s'` to zero as soon as possible.
    pub(super) fn recovery(&self, from: RateState) -> f64 {
        let most = max_second(self.step_s);
        let needed = (-from.first / self.step_s).clamp(-most, most);
        // An empty range has infinite bounds.
        if from.first > 0.0 {
            needed.max(self.lower.min(most))
        } else {
            needed.min(self.upper.max(-most))
        }
    }

    fn allow(&self, second: f64) -> bool {
        (self.lower - self.slack..=self.upper + self.slack).contains(&second)
    }
}

/// Simulates a slowdown over the plan ahead.
pub(super) struct Follower<'a, A> {
    pub(super) ahead: &'a mut A,
    pub(super) limits: &'a Limits,
    /// Number of axes; the others are absent.
    pub(super) axes: usize,
    pub(super) target: f64,
    /// Duration of the steps of a recovery, s.
    pub(super) step_s: f64,
}

impl<A: Lookahead> Follower<'_, A> {
    /// Whether the rate can become constant after `span` seconds with this `s''`.
    pub(super) fn outlook(&mut self, from: RateState, begin: usize, second: f64, span: f64) -> Outlook {
        self.recovered(from, begin, second, span).0
    }

    /// As [`Self::outlook`], and the number of steps after which the outcome is known.
    pub(super) fn recovered(
        &mut self,
        from: RateState,
        begin: usize,
        second: f64,
        span: f64,
    ) -> (Outlook, u32) {
        let falls = self.target < from.rate;
        let (mut now, mut index, mut second) = (from, begin, second);
        for step in 0..LONGEST_RECOVERY {
            let span = if step == 0 { span } else { self.step_s };
            let Some((bounds, next)) = self.bounds(now, index, span) else {
                let outcome = if self.rests(now) {
                    Outlook::Safe
                } else {
                    Outlook::Unsafe
                };
                return (outcome, step);
            };
            if step > 0 {
                second = bounds.recovery(now);
            }
            if !bounds.allow(second) {
                return (Outlook::Unsafe, step);
            }
            now = now.after(span, second);
            index = next;
            // Before it has turned round it cannot have passed the target on this side.
            let towards = falls == (now.first < 0.0);
            let beyond = if falls {
                self.target - now.rate
            } else {
                now.rate - self.target
            };
            if towards && beyond > AT_TARGET {
                return (Outlook::Past, step);
            }
            // Only rates from 0 to 1 can be kept.
            if !(-AT_TARGET..=1.0 + AT_TARGET).contains(&now.rate) {
                return (Outlook::Unsafe, step);
            }
            if now.first.abs() <= STILL {
                let outcome = if beyond > AT_TARGET {
                    Outlook::Past
                } else {
                    Outlook::Safe
                };
                return (outcome, step);
            }
        }
        (Outlook::Unsafe, LONGEST_RECOVERY)
    }

    /// The constant `s''` that leads to the target, and its duration, if the limits are kept throughout.
    pub(super) fn landing(&mut self, from: RateState, begin: usize) -> Option<(f64, f64)> {
        let fall = from.rate - self.target;
        if fall * from.first >= 0.0 {
            return None;
        }
        let second = 0.5 * from.first * from.first / fall;
        let seconds = -2.0 * fall / from.first;
        let (mut now, mut index, mut left) = (from, begin, seconds);
        for _ in 0..LONGEST_RECOVERY {
            let span = left.min(self.step_s);
            let Some((bounds, next)) = self.bounds(now, index, span) else {
                return self.rests(now).then_some((second, seconds));
            };
            if !bounds.allow(second) {
                return None;
            }
            now = now.after(span, second);
            index = next;
            left -= span;
            if left <= NO_TIME_S {
                return Some((second, seconds));
            }
        }
        None
    }

    /// Whether the plan stops within the next step.
    fn rests(&self, now: RateState) -> bool {
        let end = now.time + self.step_s * now.rate;
        self.ahead.rests_at().is_some_and(|rest| rest <= end)
    }

    pub(super) fn sample(&mut self, index: usize) -> Option<&Sample> {
        self.ahead.sample(index)
    }

    /// The range for a step of `span` seconds, from the plan at its start, at its end and at the samples
    /// between, and the last sample before its end. `None` if the plan ends before the step, or within it
    /// other than at rest.
    pub(super) fn bounds(&mut self, from: RateState, begin: usize, span: f64) -> Option<(Bounds, usize)> {
        let end = from.time + span * (from.rate + 0.5 * span * from.first).max(0.0);
        let limits = self.limits;
        let axes = self.axes;
        let mut gathered = Gathered::new(limits, axes, from, span, self.step_s);
        let (mut index, mut left) = (begin, *self.sample(begin)?);
        // A step may end slightly before the time up to which its bounds were taken, and a jump of the plan
        // may lie between the two. The preview and the later step must see the same samples.
        while left.time > from.time && index > self.ahead.oldest() {
            index -= 1;
            left = *self.sample(index)?;
        }
        let mut right = *self.sample(index + 1)?;
        while right.time <= from.time {
            index += 1;
            (left, right) = (right, *self.sample(index + 1)?);
        }
        gathered.include(0.0, &between(&left, &right, from.time, axes));
        while right.time <= end {
            let share = (right.time - from.time) / (end - from.time);
            gathered.include(span * share, &right);
            index += 1;
            let Some(next) = self.sample(index + 1).copied() else {
                // The plan stays at its rest: up to there the limits apply as usual.
                let rests = self.ahead.rests_at().is_some_and(|rest| rest <= end);
                return rests.then(|| (gathered.bounds(), index));
            };
            (left, right) = (right, next);
        }
        gathered.include(span, &between(&left, &right, end, axes));
        Some((gathered.bounds(), index))
    }
}

/// One more than the index of the last present axis: axes after it cost nothing.
pub(super) fn axes_in_use(limits: &Limits) -> usize {
    limits
        .present
        .iter()
        .rposition(|&present| present)
        .map_or(0, |last| last + 1)
}

/// Bounds of `s''`, collected instant by instant.
struct Gathered<'a> {
    pub(super) limits: &'a Limits,
    pub(super) axes: usize,
    pub(super) from: RateState,
    span: f64,
    step_s: f64,
    pub(super) lower: f64,
    pub(super) upper: f64,
    slack: f64,
}

impl<'a> Gathered<'a> {
    pub(super) fn new(limits: &'a Limits, axes: usize, from: RateState, span: f64, step_s: f64) -> Self {
        Self {
            limits,
            axes,
            from,
            span,
            step_s,
            lower: f64::NEG_INFINITY,
            upper: f64::INFINITY,
            slack: f64::INFINITY,
        }
    }

    /// Adds the plan `seconds` after the start of the step.
    fn include(&mut self, seconds: f64, plan: &Sample) {
        let limits = self.limits;
        let (r, s) = (
            self.from.first,
            (self.from.rate + seconds * self.from.first).max(0.0),
        );
        for i in (0..self.axes.min(AXES)).filter(|&i| limits.present[i]) {
            let (v, a, j) = (plan.first[i], plan.second[i], plan.third[i]);
            let most_j = (limits.jerk[i] * ALLOWED.1).max(j.abs());
            let base = s * (s * s * j + 3.0 * r * a);
            // `s''` also changes `s` and `s'` within the step.
            let slope = v + 3.0 * seconds * (s * a + 0.5 * seconds * (s * s * j + r * a));
            self.bound(base, slope, most_j, (ROUNDING.1 - ALLOWED.1) * most_j);
            let early = seconds < EARLY_FRACTION * self.span;
            let allowed = if early { EARLY_ALLOWED } else { ALLOWED.0 };
            let most_a = (limits.acceleration[i] * allowed).max(a.abs());
            let slope = seconds * (v + s * seconds * a);
            self.bound(
                s * s * a + r * v,
                slope,
                most_a,
                (ROUNDING.0 - ALLOWED.0) * most_a,
            );
        }
    }

    /// Keeps `|base + s'' slope| <= most`.
    fn bound(&mut self, base: f64, slope: f64, most: f64, slack: f64) {
        let size = slope.abs();
        if size * max_second(self.step_s) < 1e-3 * most {
            // No choice of `s''` changes this.
            if base.abs() > most + slack + 1e-3 * most {
                self.lower = f64::INFINITY;
            }
            return;
        }
        let toward = if slope > 0.0 { base } else { -base };
        self.lower = self.lower.max((-most - toward) / size);
        self.upper = self.upper.min((most - toward) / size);
        self.slack = self.slack.min(slack / size);
    }

    pub(super) fn bounds(&self) -> Bounds {
        Bounds {
            lower: self.lower,
            upper: self.upper,
            slack: if self.slack.is_finite() { self.slack } else { 0.0 },
            step_s: self.step_s,
        }
    }
}
