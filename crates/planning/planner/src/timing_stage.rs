//! Path in, plan out: the second stage of the time-optimal planner.

use evolvent_machine::PlannerKind;
use evolvent_path::Feed;
use evolvent_timing::PathLimits;

use crate::horizon::Horizon;
use crate::path_stage::PathSink;
use crate::planner::PathRules;
use crate::step::{BlockMark, PlanSink, Segment, Step};

/// Plans the time law for the path of one program. The plan depends on the path and on the requests of the
/// cycle, not on when the path arrives.
#[derive(Debug)]
pub struct TimingStage<S> {
    horizon: Horizon<S>,
}

impl<S: PlanSink> TimingStage<S> {
    /// Starts at rest at the beginning of the path.
    #[must_use]
    pub fn new(limits: &PathLimits, rules: &PathRules, sink: S) -> Self {
        Self {
            horizon: Horizon::new(
                &limits.with_chord_fraction(PlannerKind::Optimal.chord_fraction()),
                rules.feed_override,
                sink,
            ),
        }
    }

    /// The sink of the plan.
    #[must_use]
    pub fn sink(&self) -> &S {
        self.horizon.sink()
    }

    /// The sink of the plan.
    pub fn sink_mut(&mut self) -> &mut S {
        self.horizon.sink_mut()
    }

    /// Plans as much of the received path as possible, and replies to requests of the cycle. Call it after
    /// every move, and often.
    ///
    /// # Errors
    /// Those of the sink.
    pub fn poll(&mut self) -> Result<(), S::Error> {
        self.horizon.advance()
    }

    /// After the end of the path: replies to the cycle until it has gone.
    ///
    /// # Errors
    /// Those of the sink: the cycle has gone.
    pub fn serve_until_closed(&mut self) -> Result<(), S::Error> {
        self.horizon.serve_until_closed()
    }

    /// The line from which no motion was found, if planning has failed; 0 if unknown.
    #[must_use]
    pub fn failed_at(&self) -> Option<u32> {
        self.horizon.failed_at()
    }
}

impl<S: PlanSink> PathSink for TimingStage<S> {
    fn segment(&mut self, segment: Segment, feed: Feed) {
        self.horizon.segment(segment, feed);
    }

    fn cap(&mut self, speed_u_s: f64) {
        self.horizon.cap(speed_u_s);
    }

    fn mark(&mut self, mark: BlockMark) {
        self.horizon.mark(mark);
    }

    fn rest(&mut self, step: Step) {
        self.horizon.rest(step);
    }
}
