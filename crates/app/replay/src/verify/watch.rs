//! Independent checks of the recorded cycles: limits, travel, path.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::Receiver;

use evolvent_trace::{CycleRecord, inputs as bits};
use evolvent_verifier::{Allowances, Judge, Kind, Verdict};

use super::Verified;
use evolvent_inspect::LimitCheck;
use evolvent_inspect::TravelFrom;
use evolvent_motion::flags;

/// Tolerance of the feed: while slowing down from a rapid, a period may extend over both sides of the joint.
const FEED: f64 = 1.002;
const STATE_DONE: u8 = 9;

/// Independent checks of the recorded cycles.
pub(super) struct Watch<'a> {
    pub(super) check: LimitCheck,
    pub(super) judge: Option<Judge<'a>>,
    /// Travels of jogs and homing on axes that are not homed.
    pub(super) travels: VecDeque<TravelFrom>,
    pub(super) max_override: f64,
    pub(super) end: End,
    pub(super) last_sequence: Option<u64>,
    pub(super) cycles: u64,
    pub(super) missing: u64,
    pub(super) first_starved: Option<u64>,
    pub(super) first_missed: Option<u64>,
}

impl<'a> Watch<'a> {
    pub(super) fn new(check: LimitCheck, judge: Option<Judge<'a>>, travels: VecDeque<TravelFrom>) -> Self {
        Self {
            check,
            judge,
            travels,
            max_override: 0.0,
            end: End::Stopped,
            last_sequence: None,
            cycles: 0,
            missing: 0,
            first_starved: None,
            first_missed: None,
        }
    }

    /// Evaluates every cycle received.
    pub(super) fn run(mut self, lots: &Receiver<Arc<Vec<CycleRecord>>>) -> Self {
        while let Ok(lot) = lots.recv() {
            lot.iter().for_each(|record| self.see(record));
        }
        self
    }

    fn see(&mut self, record: &CycleRecord) {
        while self
            .travels
            .front()
            .is_some_and(|(from, ..)| *from <= record.sequence)
        {
            if let Some((_, low, high)) = self.travels.pop_front() {
                self.check.set_travel(&low, &high);
            }
        }
        let next = self.last_sequence.map_or(0, |last| last + 1);
        self.missing += record.sequence.saturating_sub(next);
        if record.sequence != next {
            // There are no differences across a gap, and the judge does not know gaps.
            self.judge = None;
        }
        self.last_sequence = Some(record.sequence);
        self.cycles += 1;
        self.check.cycle(record);
        if let Some(judge) = &mut self.judge {
            judge.sample(&record.position.into());
        }
        self.max_override = self.max_override.max(record.override_);
        self.end = End::at(record);
        if record.flags & flags::STARVED != 0 {
            self.first_starved.get_or_insert(record.sequence);
        }
        if record.inputs & (bits::WAITED | bits::REFUSED) != 0 && record.feed_mm_s > 0.0 {
            self.first_missed.get_or_insert(record.sequence);
        }
    }

    /// Adds possible explanations of a difference.
    fn explain(&self, verified: &mut Verified) {
        let Some(first) = verified
            .first_difference
            .as_ref()
            .map(|difference| difference.sequence)
        else {
            return;
        };
        if let Some(starved) = self.first_starved.filter(|starved| first >= *starved) {
            verified.explanations.push(format!(
                "the planner of the recorded run had not finished in time at cycle {starved} (flag \
                 STARVED): the progress of a classic planner is not recorded, so the run may be recomputed \
                 only up to there"
            ));
        }
        if let Some(missed) = self.first_missed.filter(|missed| first >= *missed) {
            verified.explanations.push(format!(
                "the planner of the recorded run was late in motion at cycle {missed}, with the reply to \
                 another override or with the continuation of a window: traces of version 0.1 may not \
                 contain enough of that to recompute it"
            ));
        }
    }

    pub(super) fn conclude(self, verified: &mut Verified) {
        self.explain(verified);
        verified.cycles = self.cycles;
        verified.missing = self.missing;
        verified.limit_violations = self.check.broken();
        if let Some((sequence, line, text)) = self.check.first_broken() {
            verified
                .violations
                .push(format!("{text} (cycle {sequence}, line {line})"));
        }
        let Some(judge) = self.judge else {
            if self.missing > 0 {
                verified
                    .notes
                    .push("the path was not checked: cycles are missing".to_owned());
            }
            return;
        };
        judged(&judge.finish(), self.end, self.max_override, "", verified);
    }
}

/// How a program ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    Done,
    Stopped,
    /// In motion: each axis stopped on its own after this cycle, or the trace was cut off. For the judge this
    /// is a motion that stops abruptly.
    BrokenOff,
}

impl End {
    /// The end if this cycle is the last one.
    pub(super) fn at(record: &CycleRecord) -> Self {
        if record.state == STATE_DONE {
            Self::Done
        } else if record.velocity.iter().all(|value| *value == 0.0) {
            Self::Stopped
        } else {
            Self::BrokenOff
        }
    }
}

/// Adds the judge's findings about the path. A run that was stopped has no end; braking after a fault may
/// leave the path.
pub(super) fn judged(verdict: &Verdict, end: End, max_override: f64, whose: &str, verified: &mut Verified) {
    let max = verified.max_path_error_mm.unwrap_or(0.0);
    verified.max_path_error_mm = Some(verdict.deviation_mm.value.max(max));
    let allowances = Allowances {
        feed: FEED * max_override.max(1.0),
        ..Allowances::default()
    };
    let unfinished = [Kind::Missed, Kind::Rest, Kind::End];
    // The check of limits reports velocity, acceleration and jerk; joints follow the guard's rule there.
    let said = [Kind::Velocity, Kind::Acceleration, Kind::Jerk, Kind::Travel];
    for violation in verdict.violations(&allowances) {
        let is_meant = !said.contains(&violation.kind)
            && (end == End::Done || !unfinished.contains(&violation.kind))
            && (end != End::BrokenOff || violation.kind != Kind::Chord);
        // In blending mode a rounded corner is what the tolerance permits, and the planner guarantees the
        // chord error.
        if is_meant {
            verified.violations.push(format!("{whose}{violation}"));
        }
    }
}
