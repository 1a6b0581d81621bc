//! Where the cycle is in the plan.

use evolvent_path::Axes;
use evolvent_planner::{ScalarState, TimedSegment};

use crate::run_drive::RunDrive;
use crate::slowdown::Slowdown;
use crate::state::State;
use crate::takeover::Takeover;

/// What moves the axes at the moment.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ActiveMotion {
    /// Nothing: at rest at this parameter of the present segment's stretch.
    Still,
    /// A run of the classic planner, solved here.
    Run(RunDrive),
    /// A piece of the near-optimal planner's law, `time` seconds after its start.
    TimedSegment { flow: TimedSegment, time: f64 },
}

/// Where and why the axes are at rest.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RestState {
    /// Parameter of the drive.
    pub(crate) x: f64,
    /// Seconds of dwell left.
    pub(crate) dwell: f64,
    /// Steps at rest passed.
    pub(crate) passed: u64,
    /// At rest for this cycle, whatever comes next.
    pub(crate) stays: bool,
    /// At rest where another motion takes over.
    pub(crate) takeover: Option<Takeover>,
    /// At rest here and not at the end of the path: a probing move or a pass of threading has ended here.
    pub(crate) position: Option<Axes>,
}

/// Where the cycle is in the plan. `Copy`: a step is computed on a copy and kept only if the guard agrees.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cursor {
    pub(crate) drive: ActiveMotion,
    /// The step that drives, or at rest the next one.
    pub(crate) step: u64,
    /// Segment in which the axes are.
    pub(crate) segment: u64,
    /// The first segment of the run that drives, or of the next one.
    pub(crate) run_segment: u64,
    /// Parameter of the drive (0 where it starts) at which that segment starts.
    pub(crate) segment_start: f64,
    /// Segment of the present or last piece, and the piece's start in it.
    pub(crate) piece_at: Option<(u64, f64)>,
    /// The first mark of a block's start that lies ahead.
    pub(crate) mark: u64,
    /// Grid interval of the plan that has been reached.
    pub(crate) interval: u64,
    /// Parameter length of all runs passed, or of the path to the present piece.
    pub(crate) travelled: f64,
    pub(crate) state: State,
    pub(crate) actions: u32,
    pub(crate) line: u32,
    pub(crate) block: u32,
    pub(crate) starved: bool,
    /// A step of curvature was passed in this cycle.
    pub(crate) joint: bool,
    /// The plan is driven more slowly than it was made: for a hold or a lower override.
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
            state: State::Idle,
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

    /// The path parameter since the drive's start and its derivatives by time: speed, acceleration, jerk.
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

    /// Programmed path travelled, by the path parameter.
    pub(crate) fn path(&self) -> f64 {
        match &self.drive {
            ActiveMotion::Still => self.travelled,
            ActiveMotion::Run(_) => self.travelled + self.now().0.x,
            ActiveMotion::TimedSegment { flow, .. } => flow.path + self.now().0.x,
        }
    }
}
