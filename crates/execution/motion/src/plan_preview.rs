//! Samples of the plan ahead, by plan time.
//!
//! A slowdown acts on the time of a plan, so all it needs are the derivatives of every axis by plan time.
//! They are sampled where the time law changes and at most [`SPACING_S`] apart, once each, and only as far
//! ahead as requested: a sample costs one evaluation of the path.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes};
use evolvent_planner::{Step, TimedSegment};

use crate::queue::PlanConsumer;

/// Maximum distance of two samples, s of plan time. Tuned: 0.25 ms gives no shorter holds and keeps the limits
/// no better; 2.5 ms on machines that build up their acceleration in 0.5 s exceeded a jerk by 5 % at a rest.
const SPACING_S: f64 = 0.0005;
/// Minimum and maximum of the longest preview, s of plan time.
const RANGE_S: (f64, f64) = (0.4, 4.0);
/// The longest preview as a multiple of the time in which the slowest axis builds up its acceleration: in
/// twice that time it changes from its maximum acceleration in one direction to that in the other.
const RANGE_FACTOR: f64 = 3.0;
/// Number of stored samples for each that the longest preview has with its spacing: pieces of a plan are
/// often shorter. With the minimum of both times 2048.
const CAPACITY_FACTOR: f64 = 2.56;

/// Plan time for which the preview of a machine with these limits looks ahead at most, s. Machines that build
/// up their acceleration slowly need more.
pub(crate) fn longest_preview_s(limits: &Limits) -> f64 {
    let times = (0..AXES).filter_map(|axis| {
        let seconds = limits.acceleration[axis] / limits.jerk[axis];
        (limits.present[axis] && seconds.is_finite()).then_some(seconds)
    });
    (RANGE_FACTOR * times.fold(0.0, f64::max)).clamp(RANGE_S.0, RANGE_S.1)
}

/// The derivatives of the axes by plan time at one instant of the plan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    /// Plan time since the preview began, s.
    pub(crate) time: f64,
    pub(crate) first: Axes,
    pub(crate) second: Axes,
    pub(crate) third: Axes,
}

/// The piece that is sampled next, and the position in it.
#[derive(Clone, Copy, Debug)]
struct Frontier {
    step: u64,
    flow: TimedSegment,
    /// Plan time at which the piece starts; negative if the preview begins inside it.
    starts: f64,
    /// Time in the piece of the last sample, and the distance to the next one.
    at: f64,
    spacing: f64,
}

/// The samples. Real-time safe except for [`PlanPreview::new`], which allocates.
#[derive(Debug)]
pub(crate) struct PlanPreview {
    /// A power of two of them.
    samples: Box<[Sample]>,
    /// Plan time for which the preview looks ahead at most, s.
    longest_s: f64,
    /// Indices of the oldest stored sample and of the next one, counted from the start of the preview.
    oldest: usize,
    next: usize,
    frontier: Option<Frontier>,
    /// Plan time at which the plan rests, once the preview has reached it.
    rests_at: Option<f64>,
}

impl PlanPreview {
    pub(crate) fn new(limits: &Limits) -> Self {
        let longest_s = longest_preview_s(limits);
        let capacity = (CAPACITY_FACTOR * longest_s / SPACING_S) as usize;
        let sample = Sample {
            time: 0.0,
            first: Axes::zeros(),
            second: Axes::zeros(),
            third: Axes::zeros(),
        };
        Self {
            samples: vec![sample; capacity.next_power_of_two()].into_boxed_slice(),
            longest_s,
            oldest: 0,
            next: 0,
            frontier: None,
            rests_at: None,
        }
    }

    /// Begins `time` seconds after the start of `flow`, which is step number `step`.
    pub(crate) fn begin(&mut self, step: u64, flow: TimedSegment, time: f64) {
        (self.oldest, self.next) = (0, 0);
        self.rests_at = None;
        let rest = (flow.piece.duration_s - time).max(0.0);
        self.frontier = Some(Frontier {
            step,
            flow,
            starts: -time,
            at: time,
            spacing: spacing(rest),
        });
    }

    /// Plan time for which the preview looks ahead at most, s.
    pub(crate) fn longest_s(&self) -> f64 {
        self.longest_s
    }

    /// Maximum number of pieces of which the preview stores samples: each has one at its start and one at its end.
    pub(crate) fn max_pieces(&self) -> usize {
        self.samples.len() / 2
    }

    /// Plan time at which the plan rests, as far as it is known.
    pub(crate) fn rests_at(&self) -> Option<f64> {
        self.rests_at
    }

    /// Index of the oldest stored sample.
    pub(crate) fn oldest(&self) -> usize {
        self.oldest
    }

    /// Drops samples before plan time `time`, except the last of them.
    pub(crate) fn release(&mut self, time: f64) {
        while self.oldest + 1 < self.next && self.held(self.oldest + 1).time <= time {
            self.oldest += 1;
        }
    }

    fn held(&self, index: usize) -> &Sample {
        &self.samples[index & (self.samples.len() - 1)]
    }

    /// Sample number `index`; `None` after the end of the plan and beyond the range of the preview.
    pub(crate) fn sample(&mut self, index: usize, queue: &mut PlanConsumer) -> Option<&Sample> {
        while index >= self.next {
            self.extend(queue)?;
        }
        (index >= self.oldest).then(|| self.held(index))
    }

    /// Adds one sample.
    fn extend(&mut self, queue: &mut PlanConsumer) -> Option<()> {
        let mut frontier = self.frontier?;
        let first = self.next == 0;
        if self.next - self.oldest >= self.samples.len() {
            return None;
        }
        let duration = frontier.flow.piece.duration_s;
        if !first && frontier.at >= duration {
            let ends = frontier.starts + duration;
            // The preview ends at a rest: a slowdown of the plan stays there.
            if frontier.flow.rests_at_end() {
                self.rests_at = Some(ends);
                self.frontier = None;
                return None;
            }
            let (step, _) = queue.settle_successor(frontier.step, false);
            let Some(Step::TimedSegment(flow)) = queue.step(step) else {
                self.rests_at = Some(ends);
                self.frontier = None;
                return None;
            };
            frontier = Frontier {
                step,
                flow,
                starts: ends,
                at: 0.0,
                spacing: spacing(flow.piece.duration_s),
            };
        } else if !first {
            if frontier.starts + frontier.at - self.held(self.oldest).time > self.longest_s {
                return None;
            }
            let next = frontier.at + frontier.spacing;
            // Avoids a tiny interval at the end that rounding would leave.
            frontier.at = if next > duration - 0.5 * frontier.spacing {
                duration
            } else {
                next
            };
        }
        let piece = &frontier.flow.piece;
        let segment = queue.segment(piece.segment)?;
        let (state, jerk) = piece.law.at(frontier.at);
        let x = (piece.from + state.x).min(segment.length);
        let jet = segment.jet(x).compose(state.v, state.a, jerk);
        let slot = self.next & (self.samples.len() - 1);
        self.samples[slot] = Sample {
            time: frontier.starts + frontier.at,
            first: jet.first,
            second: jet.second,
            third: jet.third,
        };
        self.next += 1;
        self.frontier = Some(frontier);
        Some(())
    }
}

/// The distance of samples that divide `duration` evenly.
fn spacing(duration: f64) -> f64 {
    duration / (duration / SPACING_S).ceil().max(1.0)
}

const _: () = assert!(AXES == 9);
