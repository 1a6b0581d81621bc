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

/// How the path is followed, apart from the axis limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathRules {
    /// Tolerance of G64 without P, mm.
    pub blend_tolerance_mm: f64,
    /// Time in which the jerk limit compensates a step of acceleration in exact-path mode, s.
    pub joint_time_s: f64,
    /// The planner.
    pub planner: PlannerKind,
    /// Feed override at the start; 1 is 100 %.
    pub feed_override: f64,
}

/// The reason why a move cannot be planned.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PlanError<E> {
    /// The move exceeds the travel of an axis.
    #[error(
        "axis {} would go to {reached:.4}, beyond its travel limit of {limit:.4}; \
         move the work offset or the part, or change the program",
        axis.letter()
    )]
    Travel {
        /// The axis.
        axis: AxisLetter,
        /// Extreme machine coordinate of the move, mm or degrees.
        reached: f64,
        /// The limit that it exceeds.
        limit: f64,
    },
    /// The feed of a move is not a positive number.
    #[error("the feed of this move is {feed_mm_s} mm/s; a move needs a feed above 0")]
    Feed {
        /// The feed.
        feed_mm_s: f64,
    },
    /// A move does not start at the end of the previous one.
    #[error("axis {} jumps by {distance:.3e} between two moves", axis.letter())]
    Gap {
        /// The axis.
        axis: AxisLetter,
        /// Size of the gap.
        distance: f64,
    },
    /// No motion from rest was found.
    #[error(
        "no motion within the limits of the axes was found from line {line} on; the machine stops before it. \
         Try `planner = \"classic\"`, and please report the program and the machine file"
    )]
    NoMotion {
        /// Line of the block at which planning failed.
        line: u32,
    },
    /// The consumer of the plan has gone.
    #[error("the consumer of the plan has gone")]
    Sink(E),
}

/// Plans one program.
#[derive(Debug)]
pub struct Planner<S> {
    kind: Kind<S>,
    validator: MoveValidator,
}

#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "there is one of it")]
enum Kind<S> {
    Classic(Classic<S>),
    Optimal(Optimal<S>),
}

/// Path stage and timing stage.
#[derive(Debug)]
struct Optimal<S> {
    path_stage: PathStage,
    timing_stage: TimingStage<S>,
}

impl<S: PlanSink> Planner<S> {
    /// Starts at rest at the beginning of the first move.
    #[must_use]
    pub fn new(limits: PathLimits, rules: PathRules, sink: S) -> Self {
        let validator = MoveValidator::new(limits.axes());
        let kind = match rules.planner {
            PlannerKind::Classic => Kind::Classic(Classic::new(limits, rules, sink)),
            PlannerKind::Optimal => Kind::Optimal(Optimal {
                path_stage: PathStage::new(&limits, rules),
                timing_stage: TimingStage::new(&limits, &rules, sink),
            }),
        };
        Self { kind, validator }
    }

    /// The sink of the plan.
    #[must_use]
    pub fn sink(&self) -> &S {
        match &self.kind {
            Kind::Classic(classic) => classic.sink(),
            Kind::Optimal(optimal) => optimal.timing_stage.sink(),
        }
    }

    /// The sink of the plan.
    pub fn sink_mut(&mut self) -> &mut S {
        match &mut self.kind {
            Kind::Classic(classic) => classic.sink_mut(),
            Kind::Optimal(optimal) => optimal.timing_stage.sink_mut(),
        }
    }

    /// Maximum distance so far between the planned path and the programmed one, mm.
    #[must_use]
    pub fn deviation_mm(&self) -> f64 {
        match &self.kind {
            Kind::Classic(classic) => classic.deviation_mm(),
            Kind::Optimal(optimal) => optimal.path_stage.deviation_mm(),
        }
    }

    /// Sets the start of the next move after a probing move ([`Step::Probe`]) or a thread ([`Step::Thread`])
    /// has moved the axes.
    pub fn set_position(&mut self, position: &evolvent_path::Axes) {
        self.validator.set_position(position);
    }

    /// Appends a move. A rejected move has no effect.
    ///
    /// # Errors
    /// [`PlanError`] if the move exceeds the travel, has no feed, or does not start at the end of the last
    /// one; or if planning of earlier path has failed.
    pub fn push(&mut self, motion: &Move, line: u32, block: u32) -> Result<(), PlanError<S::Error>> {
        self.validator.validate(motion)?;
        match &mut self.kind {
            Kind::Classic(classic) => classic.push(motion, line, block),
            Kind::Optimal(optimal) => {
                if let Some(line) = optimal.timing_stage.failed_at() {
                    return Err(PlanError::NoMotion { line });
                }
                optimal
                    .path_stage
                    .push(motion, line, block, &mut optimal.timing_stage);
                optimal.timing_stage.poll()
            }
        }
        .map_err(PlanError::Sink)
    }

    /// Stops the path and appends a step at rest.
    ///
    /// # Errors
    /// Those of the sink.
    pub fn rest(&mut self, step: &Step) -> Result<(), S::Error> {
        match &mut self.kind {
            Kind::Classic(classic) => classic.rest(step),
            Kind::Optimal(optimal) => optimal.rest(*step),
        }
    }

    /// Stops the path; everything planned becomes final.
    ///
    /// # Errors
    /// Those of the sink.
    pub fn finish(&mut self, line: u32) -> Result<(), S::Error> {
        match &mut self.kind {
            Kind::Classic(classic) => classic.finish(line),
            Kind::Optimal(optimal) => optimal.rest(Step::End { line }),
        }
    }

    /// Replies to the requests of the cycle since the last call. Call it often.
    ///
    /// # Errors
    /// Those of the sink.
    pub fn poll(&mut self) -> Result<(), S::Error> {
        match &mut self.kind {
            Kind::Classic(_) => Ok(()),
            Kind::Optimal(optimal) => optimal.timing_stage.poll(),
        }
    }

    /// After [`finish`](Self::finish): replies to the cycle until it has gone.
    pub fn serve_until_closed(&mut self) {
        if let Kind::Optimal(optimal) = &mut self.kind {
            // Ends only when the consumer has gone.
            let _gone = optimal.timing_stage.serve_until_closed();
        }
    }
}

impl<S: PlanSink> Optimal<S> {
    fn rest(&mut self, step: Step) -> Result<(), S::Error> {
        self.path_stage.rest(step, &mut self.timing_stage);
        self.timing_stage.poll()
    }
}
