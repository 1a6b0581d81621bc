//! The path in, plan out: the second half of the near-optimal planner.

use evolvent_timing::PathLimits;

use crate::horizon::Horizon;
use crate::path_stage::PathSink;
use crate::planner::PathRules;
use crate::step::{BlockMark, PlanSink, Segment, Step};

/// Share of the permitted chord error that stations of the near-optimal plan may use.
const CHORD_FRACTION: f64 = 0.94;

/// Gives the path of one program its time law. The plan depends on the path and on what the cycle asks, not on when the
/// path arrives.
#[derive(Debug)]
pub struct TimingStage<S> {
    horizon: Horizon<S>,
}

impl<S: PlanSink> TimingStage<S> {
    /// At rest at the start of the path.
    #[must_use]
    pub fn new(limits: &PathLimits, rules: &PathRules, sink: S) -> Self {
        Self {
            horizon: Horizon::new(
                &limits.with_chord_share(CHORD_FRACTION),
                rules.feed_override,
                sink,
            ),
        }
    }

    /// Where the plan goes.
    #[must_use]
    pub fn sink(&self) -> &S {
        self.horizon.sink()
    }

    /// Where the plan goes.
    pub fn sink_mut(&mut self) -> &mut S {
        self.horizon.sink_mut()
    }

    /// Plans what can be planned of the path that has come, and answers what the cycle has asked. Call it after every
    /// move, and often.
    ///
    /// # Errors
    /// As the sink's.
    pub fn poll(&mut self) -> Result<(), S::Error> {
        self.horizon.advance()
    }

    /// After the path's end: answers the cycle until it has gone.
    ///
    /// # Errors
    /// As the sink's: the cycle has gone.
    pub fn attend(&mut self) -> Result<(), S::Error> {
        self.horizon.attend()
    }

    /// The line from which no motion is found, if so; 0 where it is not known. Nothing more is planned then.
    #[must_use]
    pub fn failed_at(&self) -> Option<u32> {
        self.horizon.failed_at()
    }
}

impl<S: PlanSink> PathSink for TimingStage<S> {
    fn segment(&mut self, segment: Segment, feed: f64) {
        self.horizon.segment(segment, feed);
    }

    fn cap(&mut self, speed: f64) {
        self.horizon.cap(speed);
    }

    fn mark(&mut self, mark: BlockMark) {
        self.horizon.mark(mark);
    }

    fn rest(&mut self, step: Step) {
        self.horizon.rest(step);
    }
}
