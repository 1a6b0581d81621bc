//! The position of the cycle in the plan.

use evolvent_path::Axes;
use evolvent_planner::{ScalarState, TimedSegment};

use crate::run_drive::RunDrive;
use crate::slowdown::Slowdown;
use crate::state::MotionState;
use crate::takeover::Takeover;

/// The element of the plan that moves the axes.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ActiveMotion {
    /// Nothing: at rest at this parameter of the present segment.
    Still,
    /// A run of the classic planner, solved by the cycle.
    Run(RunDrive),
    /// A timed segment of the time-optimal planner, `time` seconds after its start.
    TimedSegment { flow: TimedSegment, time: f64 },
}

/// Position and reason of the axes being at rest.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RestState {
    /// Parameter, from the start of the last timed segment or run.
    pub(crate) x: f64,
    /// Remaining seconds of the dwell.
    pub(crate) dwell: f64,
    /// Number of rest steps passed.
    pub(crate) passed: u64,
    /// Stays at rest for this cycle, whatever comes next.
    pub(crate) stays: bool,
    /// The motion that takes over from the plan at rest.
    pub(crate) takeover: Option<Takeover>,
    /// Position at rest if it is not the end of the path: a probing move or a pass of threading has ended
    /// here.
    pub(crate) position: Option<Axes>,
}

/// The position of the cycle in the plan. `Copy`: a step is computed on a copy, which is kept only if the
/// guard accepts it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cursor {
    pub(crate) drive: ActiveMotion,
    /// The step that moves the axes; at rest, the next one.
    pub(crate) step: u64,
    /// The segment that contains the position.
    pub(crate) segment: u64,
    /// The first segment of the run that moves the axes, or of the next one.
    pub(crate) run_segment: u64,
    /// Parameter, from the start of the timed segment or run, at which that segment starts.
    pub(crate) segment_start: f64,
    /// Segment of the present or last piece, and the offset of the piece in it.
    pub(crate) piece_at: Option<(u64, f64)>,
    /// The first block mark ahead.
    pub(crate) mark: u64,
    /// Grid interval of the plan that has been reached.
    pub(crate) interval: u64,
    /// Parameter length of all runs passed, or of the path up to the present piece.
    pub(crate) travelled: f64,
    pub(crate) state: MotionState,
    pub(crate) actions: u32,
    pub(crate) line: u32,
    pub(crate) block: u32,
    pub(crate) starved: bool,
    /// A step of curvature has been passed in this cycle.
    pub(crate) joint: bool,
    /// The slowdown of the plan: for a hold or a lower override.
    pub(crate) slowdown: Option<Slowdown>,
    pub(crate) rest: RestState,
}

impl Cursor {
    pub(crate) fn at_start() -> Self {
        Self {
            drive: ActiveMotion::Still,
            step: 0,
            segment: 0,
            run_segment: 0,
            segment_start: 0.0,
            piece_at: None,
            mark: 0,
            interval: 0,
            travelled: 0.0,
            state: MotionState::Idle,
            actions: 0,
            line: 0,
            block: 0,
            starved: false,
            joint: false,
            slowdown: None,
            rest: RestState::default(),
        }
    }

    pub(crate) fn is_still(&self) -> bool {
        matches!(self.drive, ActiveMotion::Still)
    }

    /// The path parameter since the start of the timed segment or run, and its time derivatives: speed,
    /// acceleration, jerk.
    pub(crate) fn now(&self) -> (ScalarState, f64) {
        match &self.drive {
            ActiveMotion::Still => {
                let x = self.rest.x;
                (ScalarState { x, v: 0.0, a: 0.0 }, 0.0)
            }
            ActiveMotion::Run(run) => run.now(),
            ActiveMotion::TimedSegment { flow, time } => {
                let (now, jerk) = flow.piece.law.at(*time);
                match &self.slowdown {
                    None => (now, jerk),
                    Some(slowdown) => slowdown.scale().apply(now, jerk),
                }
            }
        }
    }

    /// Distance along the programmed path, in the path parameter.
    pub(crate) fn path(&self) -> f64 {
        match &self.drive {
            ActiveMotion::Still => self.travelled,
            ActiveMotion::Run(_) => self.travelled + self.now().0.x,
            ActiveMotion::TimedSegment { flow, .. } => flow.path + self.now().0.x,
        }
    }
}
