//! Messages between control thread and cycle, over wait-free queues.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use evolvent_control::JobResult;
use evolvent_drive::{DriveAlarm, IndexRequest, PowerRequest, Presence};
use evolvent_machine::Limits;
use evolvent_motion::{PathExecutor, PlanConsumer, Setpoint, TransferExecutor, Violation};
use evolvent_path::{Axes, AxisMask};
use evolvent_signals::{OutputChange, ProbeState, ScheduleConsumer};
use evolvent_trace::PhaseRecord;
use evolvent_turning::Reason;

use crate::due_setpoint::SpindleOverrides;
use crate::handwheel_view::HandwheelView;

/// A job along a plan, passed from the control thread to the cycle and back to be dropped.
pub(crate) struct Following {
    pub motion: PathExecutor,
    pub queue: PlanConsumer,
    pub flags: Arc<JobFlags>,
    /// The job's number.
    pub job: u64,
    /// The number of its first block.
    pub first_block: u32,
    /// Scheduled outputs and waits, if the machine has signals; taken when the job begins.
    pub schedule: Option<ScheduleConsumer>,
}

/// Flags shared by the planner and the control thread of one job.
#[derive(Debug, Default)]
pub(crate) struct JobFlags {
    /// The rest of the plan is not needed.
    pub abandoned: AtomicBool,
    /// The plan ends before the program does. Set before the end of the plan is passed on.
    pub failed: AtomicBool,
}

impl JobFlags {
    pub(crate) fn has_failed(&self) -> bool {
        self.failed.load(Ordering::Acquire)
    }
}

/// What moves the axes.
pub(crate) enum ActiveJob {
    None,
    Follow(Box<Following>),
    Steer(Box<TransferExecutor>),
}

/// An order to the cycle. If `id` is above 0, the cycle reports the setpoint with which it takes effect.
pub(crate) struct Order {
    pub id: u64,
    pub what: CycleCommand,
}

// `Limits` are not boxed: the cycle would have to free the box.
pub(crate) enum CycleCommand {
    /// Begin a job along a plan.
    Follow(Box<Following>),
    /// Begin a steered motion, or a transfer of the excursion if a program is held.
    Steer(Box<TransferExecutor>),
    /// Change to this motion after setpoint `after`; it may continue until `until_ns` of CLOCK_MONOTONIC.
    /// Reported once done.
    Turn {
        after: u64,
        until_ns: u64,
        steering: Box<TransferExecutor>,
    },
    /// Retrace the path of the held program by `back` block starts, or for 0 forwards to where the program is
    /// held.
    Retrace {
        back: u32,
    },
    Hold,
    /// End a hold, and continue after the program stop that is preceded by this number of actions, if the
    /// machine is stopped there.
    Resume(Option<u32>),
    /// Continue after a program stop without ending a hold.
    GoOn(u32),
    Stop,
    /// Stop a steered motion or the motion of an excursion; a held program stays held.
    StopSteering,
    Override(f64),
    SpindleOverride(f64),
    /// Stop each axis on its own; the drives perform their quick stop.
    Emergency,
    /// Leave the emergency stop, without power.
    LeaveEstop,
    /// Set outputs by hand. The moment of the change is ignored.
    Outputs(OutputChange),
    Power(PowerRequest),
    /// Clear faults of core and drives.
    Clear,
    /// Give the position at which the axes are at rest these coordinates, and set limits. `renames`: the
    /// drives must take over the new coordinates.
    Relocate {
        position: Axes,
        limits: Limits,
        renames: bool,
    },
    /// The steered motion may continue until this time, ns of CLOCK_MONOTONIC.
    KeepJogging(u64),
    /// The travel of the next job, at rest: the guard uses it from now on.
    Within(Limits),
    /// Limit switches at the negative and positive ends of these axes are used by the homing sequence.
    ExpectSwitches([AxisMask; 2]),
    /// Latch this index pulse.
    LatchIndex(IndexRequest),
    /// End the process once the axes are at rest.
    End,
}

/// Why a job has not begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NotBegun {
    /// The axes are at another position, or something else moves them.
    Elsewhere,
    /// No job may begin: an emergency stop, a fault or loss of power came first.
    Forbidden,
    /// A stop that was ordered later overtook it.
    Stopped,
}

/// An event of the cycle.
pub(crate) enum CycleEvent {
    /// The order took effect with this setpoint.
    Applied {
        id: u64,
        sequence: u64,
    },
    /// The job ended with this setpoint. `ActiveJob` is returned to be dropped.
    Ended {
        sequence: u64,
        result: JobResult,
        work: ActiveJob,
    },
    /// A motion of an excursion was rejected; the order has no effect.
    NotLeft {
        sequence: u64,
        work: ActiveJob,
    },
    /// A motion of an excursion has ended.
    AwayEnded {
        sequence: u64,
        result: JobResult,
        work: ActiveJob,
    },
    /// The excursion has ended: the program has the axes again.
    IsBack {
        sequence: u64,
    },
    /// Returned to be dropped.
    Returned(ActiveJob),
    /// A change of a motion is over: it was reported as applied before, or has no effect. Its motion is
    /// returned to be dropped.
    TurnReturned {
        id: u64,
        work: ActiveJob,
    },
    /// Returned to be dropped.
    Spent(ScheduleConsumer),
    /// The emergency-stop chain is open or unknown: each axis stops on its own, and so do the drives.
    EstopChain {
        sequence: u64,
    },
    /// The job did not begin at the present position.
    Misplaced {
        sequence: u64,
        cause: NotBegun,
        work: ActiveJob,
    },
    Guard {
        sequence: u64,
        violation: Violation,
    },
    PlannerGone {
        sequence: u64,
    },
    /// A spindle is in fault, or its feedback stopped.
    Spindle {
        sequence: u64,
        spindle: u32,
    },
    /// A turning cycle has failed.
    Turning {
        sequence: u64,
        reason: Reason,
    },
    Late {
        sequence: u64,
    },
    Drive {
        sequence: u64,
        alarm: DriveAlarm,
    },
    /// The drives' positions may count from another zero: the link was lost, or an encoder value jumped.
    ReferenceLost {
        sequence: u64,
        axes: AxisMask,
    },
}

/// The state after the newest cycle, for the control thread and the status.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CycleView {
    pub setpoint: Setpoint,
    /// The correction of the position for the drives, if corrections are in use.
    pub shift: Option<Axes>,
    pub lateness_ns: u64,
    pub work_ns: u64,
    pub presence: Presence,
    pub power: PowerRequest,
    /// Number of the last order for power that was carried out or rejected; 0 before the first.
    pub power_order: u64,
    pub datum: u64,
    pub late_cycles: u64,
    pub dropped_records: u64,
    pub dropped_setpoints: u64,
    pub at_rest: bool,
    /// The program waits at rest for an input (M66).
    pub at_wait: bool,
    /// The emergency-stop chain is open or unknown; `false` without a chain.
    pub is_chain_open: bool,
    /// `Unknown` without a probe.
    pub probe: ProbeState,
    /// Factor on the commanded speed of each spindle.
    pub spindle_overrides: SpindleOverrides,
    pub handwheel: HandwheelView,
    pub leaving: LeavingView,
    /// How the cycle follows the drives' clock, if a phase error was reported.
    pub phase: Option<PhaseRecord>,
}

/// Whether and how the axes may leave a held program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LeavingView {
    /// The program is held at a position where it may be left.
    pub may_leave: bool,
    /// The axes have left the program, or are about to.
    pub is_away: bool,
    /// The last position at rest on the path differs from the position at which the program is held.
    pub is_retraced: bool,
    /// Number of block starts that a retrace can reach.
    pub blocks_before: u32,
}

impl CycleEvent {
    /// The setpoint that the event belongs to; 0 if irrelevant.
    pub(crate) fn sequence(&self) -> u64 {
        match self {
            Self::Returned(_) | Self::TurnReturned { .. } | Self::Spent(_) => 0,
            Self::Applied { sequence, .. }
            | Self::Ended { sequence, .. }
            | Self::Misplaced { sequence, .. }
            | Self::Guard { sequence, .. }
            | Self::PlannerGone { sequence }
            | Self::NotLeft { sequence, .. }
            | Self::AwayEnded { sequence, .. }
            | Self::IsBack { sequence }
            | Self::EstopChain { sequence }
            | Self::Spindle { sequence, .. }
            | Self::Turning { sequence, .. }
            | Self::Late { sequence }
            | Self::Drive { sequence, .. }
            | Self::ReferenceLost { sequence, .. } => *sequence,
        }
    }
}
