//! What control and cycle tell one another, over wait-free queues.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use evolvent_control::JobResult;
use evolvent_drive::{DriveAlarm, IndexRequest, PowerRequest, Presence};
use evolvent_machine::Limits;
use evolvent_motion::{PathExecutor, PlanConsumer, Setpoint, TransferExecutor, Violation};
use evolvent_path::{Axes, AxisMask};
use evolvent_signals::{Change, ProbeState, ScheduleConsumer};
use evolvent_trace::PhaseRecord;
use evolvent_turning::Reason;

use crate::due_setpoint::SpindleOverrides;
use crate::handwheel_view::HandwheelView;

/// A job along a plan, from the control thread to the cycle and back to be dropped.
pub(crate) struct Following {
    pub motion: PathExecutor,
    pub queue: PlanConsumer,
    pub flags: Arc<JobFlags>,
    /// The job's number.
    pub job: u64,
    /// The number of its first block.
    pub first_block: u32,
    /// What it schedules of outputs and waits, where the machine has any; until it begins.
    pub schedule: Option<ScheduleConsumer>,
}

/// What planner and control of one job tell each other.
#[derive(Debug, Default)]
pub(crate) struct JobFlags {
    /// The planner need not go on.
    pub abandoned: AtomicBool,
    /// The plan ends before the program does. Set before the plan's end is handed on.
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

/// One order to the cycle. Those with an `id` above 0 are reported with the setpoint from which they count.
pub(crate) struct Order {
    pub id: u64,
    pub what: CycleCommand,
}

// Limits are no box: that would have to be freed in the cycle.
pub(crate) enum CycleCommand {
    /// Begin a job along a plan.
    Follow(Box<Following>),
    /// Begin a steered motion, or a transfer of the excursion if a program is held.
    Steer(Box<TransferExecutor>),
    /// Change to this steering right after setpoint `after`, which may go on until `until_ns` of
    /// CLOCK_MONOTONIC. Reported where that has been done.
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
    /// Ends a hold, and continues after the program stop that is preceded by this number of actions, if the
    /// machine is stopped there.
    Resume(Option<u32>),
    /// The same without ending a hold.
    GoOn(u32),
    Stop,
    /// Stop a steered motion or the motion of an excursion; a held program stays held.
    StopSteering,
    Override(f64),
    SpindleOverride(f64),
    /// Every axis stops by itself, and the drives stop by themselves.
    Emergency,
    /// Out of the emergency stop, without power yet.
    LeaveEstop,
    /// Outputs by hand. Its moment counts for nothing.
    Outputs(Change),
    Power(PowerRequest),
    /// Faults of core and drives are over.
    Clear,
    /// The axes stand; this place has these coordinates and limits. `renames`: the drives must take over the
    /// new names.
    Relocate {
        position: Axes,
        limits: Limits,
        renames: bool,
    },
    /// The steered motion may go on until this time, ns of CLOCK_MONOTONIC.
    KeepJogging(u64),
    /// The next job has this travel: the guard checks it from now on, at rest.
    Within(Limits),
    /// Limit switches of these axes, at negative and positive ends, are looked at by the homing sequence.
    ExpectSwitches([AxisMask; 2]),
    /// This index pulse is to be latched.
    LatchIndex(IndexRequest),
    /// The process ends once the axes rest.
    End,
}

/// Why a job has not begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NotBegun {
    /// The axes stand elsewhere, or something else moves them.
    Elsewhere,
    /// Nothing may begin: an emergency stop, a fault or the loss of power came before it.
    Forbidden,
    /// A stop that was ordered after it has overtaken it.
    Stopped,
}

/// What has happened in the cycle.
pub(crate) enum CycleEvent {
    /// The order counts from this setpoint on.
    Applied {
        id: u64,
        sequence: u64,
    },
    /// The job has ended with this setpoint; what moved the axes is handed back.
    Ended {
        sequence: u64,
        result: JobResult,
        work: ActiveJob,
    },
    /// A motion of an excursion was refused; the order has no effect.
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
    /// Something to be dropped.
    Returned(ActiveJob),
    /// A turn is over: it was applied before this, or has no effect. Its motion is to be dropped.
    TurnReturned {
        id: u64,
        work: ActiveJob,
    },
    /// The same.
    Spent(ScheduleConsumer),
    /// The emergency-stop chain is open, or not known: every axis stops by itself, and the drives.
    EstopChain {
        sequence: u64,
    },
    /// The job did not begin where the axes stand.
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
    /// A spindle is in fault, or its feedback has stopped.
    Spindle {
        sequence: u64,
        spindle: u32,
    },
    /// A turning cycle has given up.
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
    /// The drives' positions may count from another zero: the link was lost, or an encoder jumped.
    ReferenceLost {
        sequence: u64,
        axes: AxisMask,
    },
}

/// The last cycle, for control and status.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CycleView {
    pub setpoint: Setpoint,
    /// By how much it was corrected for the drives, where that is done.
    pub shift: Option<Axes>,
    pub lateness_ns: u64,
    pub work_ns: u64,
    pub presence: Presence,
    pub power: PowerRequest,
    /// Number of the last order for power that has been carried out or refused; 0 before the first.
    pub power_order: u64,
    pub datum: u64,
    pub late_cycles: u64,
    pub dropped_records: u64,
    pub dropped_setpoints: u64,
    pub at_rest: bool,
    /// The program rests until an input has come (M66).
    pub at_wait: bool,
    /// The emergency-stop chain is open or not known; never where there is none.
    pub is_chain_open: bool,
    /// Unknown where there is none.
    pub probe: ProbeState,
    /// By what the commanded speed of each spindle is multiplied.
    pub spindle_overrides: SpindleOverrides,
    pub handwheel: HandwheelView,
    pub leaving: LeavingView,
    /// How the cycle follows the drives' clock, where a phase error has come.
    pub phase: Option<PhaseRecord>,
}

/// Whether and how the axes may leave a held program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LeavingView {
    /// The program is held where it may be left.
    pub may_leave: bool,
    /// The axes have left it, or are about to.
    pub is_away: bool,
    /// Their last position at rest on the path is not the one at which the program is held.
    pub is_retraced: bool,
    /// Number of block starts that can be reached backwards.
    pub blocks_before: u32,
}

impl CycleEvent {
    /// The setpoint that it belongs to; 0 where that does not matter.
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
