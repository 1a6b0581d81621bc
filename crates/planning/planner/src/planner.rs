//! Moves in, plan out.

use evolvent_machine::PlannerKind;
use evolvent_path::{AxisLetter, Move};
use evolvent_timing::PathLimits;
use thiserror::Error;

use crate::classic::Classic;
use crate::move_validator::MoveValidator;
use crate::path_stage::PathStage;
use crate::step::{PlanSink, Step};
use crate::timing_stage::TimingStage;

/// How the path is to be followed, the limits of the axes aside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathRules {
    /// Tolerance of G64 without P, mm.
    pub blend_tolerance_mm: f64,
    /// Time in which the jerk limit undoes a step of acceleration in exact-path mode, s.
    pub joint_time_s: f64,
    /// Which planner.
    pub planner: PlannerKind,
    /// Feed override in force at the start, 1 at 100 %.
    pub feed_override: f64,
}

/// Why a move cannot be planned.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PlanError<E> {
    /// The move leaves the travel of an axis.
    #[error(
        "axis {} would go to {reached:.4}, beyond its travel limit of {limit:.4}; \
         move the work offset or the part, or change the program",
        axis.letter()
    )]
    Travel {
        /// The axis.
        axis: AxisLetter,
        /// Farthest machine coordinate of the move, mm or degrees.
        reached: f64,
        /// The limit that it passes.
        limit: f64,
    },
    /// The feed of a move is not a positive number.
    #[error("the feed of this move is {feed_mm_s} mm/s; a move needs a feed above 0")]
    Feed {
        /// The feed.
        feed_mm_s: f64,
    },
    /// A move starts elsewhere than the one before ended.
    #[error("axis {} jumps by {distance:.3e} between two moves", axis.letter())]
    Gap {
        /// The axis.
        axis: AxisLetter,
        /// Size of the jump.
        distance: f64,
    },
    /// No motion is found from rest.
    #[error(
        "no motion within the limits of the axes is found from line {line} on; the machine stands before it. Try \
         `planner = \"classic\"` there, and please report the program and the machine file"
    )]
    NoMotion {
        /// Line of the block where the plan has come to.
        line: u32,
    },
    /// The consumer of the plan does not take more.
    #[error("the plan is not taken any more")]
    Sink(E),
}

/// Plans one program.
#[derive(Debug)]
pub struct Planner<S> {
    kind: Kind<S>,
    admission: MoveValidator,
}

#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one of it")]
enum Kind<S> {
    Classic(Classic<S>),
    Optimal(Optimal<S>),
}

/// Path, then time law.
#[derive(Debug)]
struct Optimal<S> {
    shaper: PathStage,
    pacer: TimingStage<S>,
}

impl<S: PlanSink> Planner<S> {
    /// At rest at the start of the first move.
    #[must_use]
    pub fn new(limits: PathLimits, rules: PathRules, sink: S) -> Self {
        let admission = MoveValidator::new(limits.axes());
        let kind = match rules.planner {
            PlannerKind::Classic => Kind::Classic(Classic::new(limits, rules, sink)),
            PlannerKind::Optimal => Kind::Optimal(Optimal {
                shaper: PathStage::new(&limits, rules),
                pacer: TimingStage::new(&limits, &rules, sink),
            }),
        };
        Self { kind, admission }
    }

    /// Where the plan goes.
    #[must_use]
    pub fn sink(&self) -> &S {
        match &self.kind {
            Kind::Classic(classic) => classic.sink(),
            Kind::Optimal(optimal) => optimal.pacer.sink(),
        }
    }

    /// Where the plan goes.
    pub fn sink_mut(&mut self) -> &mut S {
        match &mut self.kind {
            Kind::Classic(classic) => classic.sink_mut(),
            Kind::Optimal(optimal) => optimal.pacer.sink_mut(),
        }
    }

    /// Largest distance of the path planned so far from the programmed one, mm.
    #[must_use]
    pub fn deviation_mm(&self) -> f64 {
        match &self.kind {
            Kind::Classic(classic) => classic.deviation_mm(),
            Kind::Optimal(optimal) => optimal.shaper.deviation_mm(),
        }
    }

    /// The next move starts here: a probing move ([`Step::Probe`]) or a thread ([`Step::Thread`]) has brought the axes there.
    pub fn stand_at(&mut self, position: &evolvent_path::Axes) {
        self.admission.stand_at(position);
    }

    /// Appends a move. Nothing is planned of a move that is refused.
    ///
    /// # Errors
    /// The move leaves the travel, has no feed, or does not start where the last one ended; or nothing can be planned
    /// any more of what came before.
    pub fn push(&mut self, motion: &Move, line: u32, block: u32) -> Result<(), PlanError<S::Error>> {
        self.admission.admit(motion)?;
        match &mut self.kind {
            Kind::Classic(classic) => classic.push(motion, line, block),
            Kind::Optimal(optimal) => {
                if let Some(line) = optimal.pacer.failed_at() {
                    return Err(PlanError::NoMotion { line });
                }
                optimal.shaper.push(motion, line, block, &mut optimal.pacer);
                optimal.pacer.poll()
            }
        }
        .map_err(PlanError::Sink)
    }

    /// Brings the path to rest and appends a step there.
    ///
    /// # Errors
    /// As the sink's.
    pub fn rest(&mut self, step: &Step) -> Result<(), S::Error> {
        match &mut self.kind {
            Kind::Classic(classic) => classic.rest(step),
            Kind::Optimal(optimal) => optimal.rest(*step),
        }
    }

    /// Brings the path to rest; everything planned becomes final.
    ///
    /// # Errors
    /// As the sink's.
    pub fn finish(&mut self, line: u32) -> Result<(), S::Error> {
        match &mut self.kind {
            Kind::Classic(classic) => classic.finish(line),
            Kind::Optimal(optimal) => optimal.rest(Step::End { line }),
        }
    }

    /// Answers what the cycle has asked since the last call: holds and overrides. Call it often.
    ///
    /// # Errors
    /// As the sink's.
    pub fn poll(&mut self) -> Result<(), S::Error> {
        match &mut self.kind {
            Kind::Classic(_) => Ok(()),
            Kind::Optimal(optimal) => optimal.pacer.poll(),
        }
    }

    /// After [`finish`](Self::finish): answers the cycle until it has gone.
    pub fn attend(&mut self) {
        if let Kind::Optimal(optimal) = &mut self.kind {
            // The only way out is that nobody asks any more.
            let _gone = optimal.pacer.attend();
        }
    }
}

impl<S: PlanSink> Optimal<S> {
    fn rest(&mut self, step: Step) -> Result<(), S::Error> {
        self.shaper.rest(step, &mut self.pacer);
        self.pacer.poll()
    }
}
