//! How far a plan goes on after a hold, measured on the plan without driving it.
//!
//! A [`StoppingDistance`] receives the setpoints of a plan that is driven without interruption. At most
//! [`SPACING_S`] of path time apart, or [`SPACING_FRACTION`] of the time that holds take, it starts a hold
//! there, with the slowdown of the cycle on the derivatives of the setpoints, and keeps the one with the
//! longest path. Not real-time safe: it is for planning.

use std::collections::VecDeque;

use evolvent_machine::Limits;
use evolvent_path::AXES;

use crate::plan_preview::{LONGEST_PREVIEW_S, Sample};
use crate::setpoint::Setpoint;
use crate::slowdown::{Lookahead, STEP_S, Slowdown, between};

/// Path time from one hold to the next, s.
const SPACING_S: f64 = 0.01;
/// Path time from one hold to the next as a fraction of the time that holds take, where that is more: with
/// jerk limits so low that a hold takes seconds, the work would grow with the square of that time. A hold
/// that comes between two of them rests no farther than the later one, so the path between the two is added.
const SPACING_FRACTION: f64 = 1.0 / 32.0;
/// Least path time from one sample of the plan to the next, s: that of the cycle's preview, whatever the
/// rate.
const SAMPLE_S: f64 = 0.0005;
/// What a hold in the cycle may need beyond the one that is computed here: fractions where setpoints are no
/// farther apart than samples and where they are, and the path of a time. Measured on 240 random dense
/// contours: up to 1.082 of what is computed at 4 kHz, up to 1.154 at 1 kHz, where several chords lie between
/// two setpoints.
const MARGIN: (f64, f64) = (1.1, 1.2);
const MARGIN_S: f64 = 0.001;

/// The hold of a plan that needs the longest path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LongestStop {
    /// Path from the hold to rest, mm.
    pub path_mm: f64,
    /// Time from the hold to rest, s.
    pub duration_s: f64,
    /// Line of the program at the hold.
    pub line: u32,
    /// Number of the setpoint after which the hold comes.
    pub sequence: u64,
}

/// A hold that is being followed.
#[derive(Clone, Copy, Debug)]
struct Hold {
    slowdown: Slowdown,
    /// Time since the hold, s.
    seconds: f64,
    /// Plan time of the hold, s, and its sample.
    from: f64,
    begin: usize,
    path_mm: f64,
    speed: f64,
    /// Path from the hold before it, where that is farther back than [`SPACING_S`].
    unseen_mm: f64,
    line: u32,
    sequence: u64,
}

/// Finds the hold that needs the longest path.
#[derive(Debug)]
pub struct StoppingDistance {
    limits: Limits,
    period_s: f64,
    /// The plan since the last rest, as far as holds look at it: derivatives and path.
    samples: VecDeque<(Sample, f64)>,
    /// Number of the first of them.
    first: usize,
    rests_at: Option<f64>,
    holds: VecDeque<Hold>,
    /// Setpoints since the last sample and since the last hold.
    since_sample: f64,
    since_hold: f64,
    /// The path at the last hold.
    last_hold_mm: f64,
    time: f64,
    longest: Option<LongestStop>,
}

impl StoppingDistance {
    /// For plans of a machine with these limits, at this control period.
    #[must_use]
    pub fn new(limits: Limits, period_s: f64) -> Self {
        Self {
            limits,
            period_s,
            samples: VecDeque::new(),
            first: 0,
            rests_at: None,
            holds: VecDeque::new(),
            since_sample: f64::INFINITY,
            since_hold: f64::INFINITY,
            last_hold_mm: 0.0,
            time: 0.0,
            longest: None,
        }
    }

    /// Takes the next setpoint of the plan.
    pub fn push(&mut self, setpoint: &Setpoint) {
        self.time += self.period_s;
        self.since_sample += self.period_s;
        self.since_hold += self.period_s;
        let rests = setpoint.velocity.amax() == 0.0 && setpoint.acceleration.amax() == 0.0;
        // A sum of periods misses a multiple by rounding.
        let half = 0.5 * self.period_s;
        if !rests && self.since_sample + half < SAMPLE_S {
            return;
        }
        self.since_sample = 0.0;
        if rests {
            self.end_stretch(setpoint);
        }
        let sample = Sample {
            time: self.time,
            first: setpoint.velocity,
            second: setpoint.acceleration,
            third: setpoint.jerk,
        };
        self.refine(&sample, setpoint.path_mm);
        self.samples.push_back((sample, setpoint.path_mm));
        let spacing = self.spacing();
        if !rests && self.since_hold + half >= spacing {
            let is_wide = self.since_hold < f64::INFINITY && spacing > SPACING_S;
            let from_last_mm = setpoint.path_mm - self.last_hold_mm;
            (self.since_hold, self.last_hold_mm) = (0.0, setpoint.path_mm);
            self.holds.push_back(Hold {
                slowdown: Slowdown::new(0.0),
                seconds: 0.0,
                from: self.time,
                begin: self.first + self.samples.len() - 1,
                path_mm: setpoint.path_mm,
                speed: setpoint.feed_mm_s,
                unseen_mm: if is_wide { from_last_mm } else { 0.0 },
                line: setpoint.line,
                sequence: setpoint.sequence,
            });
        }
        self.follow();
    }

    fn spacing(&self) -> f64 {
        let seconds = self.holds.iter().map(|hold| hold.seconds);
        SPACING_S.max(SPACING_FRACTION * seconds.fold(0.0, f64::max))
    }

    /// The hold with the longest path, of all that were followed to rest. The path includes a margin for what
    /// lies between setpoints: 10 % from 2 kHz on, 20 % below, and 1 ms. None where nothing moves.
    #[must_use]
    pub fn longest(&self) -> Option<LongestStop> {
        self.longest
    }

    /// The plan rests at this setpoint: every hold ends here at the latest.
    fn end_stretch(&mut self, setpoint: &Setpoint) {
        if self.samples.is_empty() {
            return;
        }
        let sample = Sample {
            time: self.time,
            first: setpoint.velocity,
            second: setpoint.acceleration,
            third: setpoint.jerk,
        };
        self.refine(&sample, setpoint.path_mm);
        self.samples.push_back((sample, setpoint.path_mm));
        self.rests_at = Some(self.time);
        self.follow();
        self.samples.clear();
        self.holds.clear();
        (self.first, self.rests_at, self.time) = (0, None, 0.0);
    }

    /// Puts a sample in the middle where setpoints lie far apart: its jerk is that of the parabola which
    /// changes the acceleration as both setpoints have it.
    fn refine(&mut self, right: &Sample, path: f64) {
        let Some((left, path_before)) = self.samples.back().copied() else {
            return;
        };
        let length = right.time - left.time;
        if length < 1.5 * SAMPLE_S {
            return;
        }
        let mut middle = between(&left, right, left.time + 0.5 * length, AXES);
        middle.third = (right.second - left.second) * (1.5 / length) - (left.third + right.third) * 0.25;
        self.samples.push_back((middle, 0.5 * (path_before + path)));
    }

    /// Follows every hold as far as the plan is known.
    fn follow(&mut self) {
        let Some(newest) = self.samples.back().map(|(sample, _)| sample.time) else {
            return;
        };
        let mut k = 0;
        while k < self.holds.len() {
            let mut hold = self.holds[k];
            let mut ended = false;
            loop {
                let now = hold.from + hold.slowdown.plan_time();
                if hold.slowdown.is_at_rest() || self.rests_at.is_some_and(|rest| now >= rest) {
                    ended = true;
                    break;
                }
                // As far ahead as the cycle looks.
                if self.rests_at.is_none()
                    && newest < now + LONGEST_PREVIEW_S + 2.0 * self.period_s.max(SAMPLE_S)
                {
                    break;
                }
                let mut window = Window {
                    samples: &self.samples,
                    first: self.first,
                    begin: hold.begin,
                    from: hold.from,
                    rests_at: self.rests_at,
                    shifted: None,
                };
                let before = hold.slowdown.plan_time();
                hold.slowdown.advance(STEP_S, &self.limits, &mut window);
                hold.begin = window.begin;
                hold.seconds += STEP_S;
                // A slowdown that the plan's own braking has brought to nothing.
                if hold.slowdown.plan_time() <= before && hold.slowdown.is_at_rest() {
                    ended = true;
                    break;
                }
            }
            if ended {
                self.record(&hold);
                let _ended = self.holds.remove(k);
            } else {
                self.holds[k] = hold;
                k += 1;
            }
        }
        let keep = self.holds.iter().map(|hold| hold.begin).min();
        let end = self.first + self.samples.len() - 1;
        while self.first < keep.unwrap_or(end) {
            let _passed = self.samples.pop_front();
            self.first += 1;
        }
    }

    fn record(&mut self, hold: &Hold) {
        let path = self.path_at(hold.from + hold.slowdown.plan_time());
        let margin = if self.period_s < 1.5 * SAMPLE_S {
            MARGIN.0
        } else {
            MARGIN.1
        };
        let path_mm = (path - hold.path_mm) * margin + MARGIN_S * hold.speed + hold.unseen_mm;
        if self.longest.is_none_or(|longest| path_mm > longest.path_mm) {
            self.longest = Some(LongestStop {
                path_mm,
                duration_s: hold.seconds,
                line: hold.line,
                sequence: hold.sequence,
            });
        }
    }

    /// The path at a plan time that is held.
    fn path_at(&self, time: f64) -> f64 {
        let after = self.samples.partition_point(|(sample, _)| sample.time <= time);
        let at = |k: usize| self.samples.get(k).copied();
        match (after.checked_sub(1).and_then(at), at(after)) {
            (Some((left, from)), Some((right, to))) => {
                from + (to - from) * (time - left.time) / (right.time - left.time)
            }
            (Some((_, path)), None) | (None, Some((_, path))) => path,
            (None, None) => 0.0,
        }
    }
}

/// The samples as one hold sees them: by the plan time since the hold.
struct Window<'a> {
    samples: &'a VecDeque<(Sample, f64)>,
    first: usize,
    begin: usize,
    from: f64,
    rests_at: Option<f64>,
    shifted: Option<Sample>,
}

impl Lookahead for Window<'_> {
    fn oldest(&self) -> usize {
        self.begin
    }

    fn release(&mut self, time: f64) {
        let later = |index: usize| self.samples.get(index - self.first);
        while later(self.begin + 1).is_some_and(|(sample, _)| sample.time - self.from <= time) {
            self.begin += 1;
        }
    }

    fn sample(&mut self, index: usize) -> Option<&Sample> {
        let (oldest, _) = self.samples.get(self.begin.checked_sub(self.first)?)?;
        let (sample, _) = self.samples.get(index.checked_sub(self.first)?)?;
        if index > self.begin + 1 && sample.time - oldest.time > LONGEST_PREVIEW_S {
            return None;
        }
        let mut shifted = *sample;
        shifted.time -= self.from;
        Some(self.shifted.insert(shifted))
    }

    fn rests_at(&self) -> Option<f64> {
        self.rests_at.map(|rest| rest - self.from)
    }
}
