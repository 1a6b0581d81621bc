//! The cycle: a pure, allocation-free step from inputs to one setpoint.
//!
//! [`PathExecutor::step`] advances the path parameter by one period along the plan, evaluates the path there,
//! has the [`Guard`] check the result, and returns a [`Setpoint`]. Time enters only as the period. The plan
//! comes through a wait-free queue ([`plan_queue`]); feed hold, override and stop come as [`Inputs`].
//!
//! ```
//! use evolvent_machine::{Limits, PlannerKind};
//! use evolvent_motion::{Inputs, PathExecutor, plan_queue};
//! use evolvent_path::{AXES, Axes, Line, Move, MoveKind, PathMode};
//! use evolvent_planner::{PathLimits, PathRules, Planner};
//!
//! let limits = Limits {
//!     present: [true; AXES],
//!     velocity: Axes::repeat(100.0),
//!     acceleration: Axes::repeat(1000.0),
//!     jerk: Axes::repeat(20_000.0),
//!     travel_min: Axes::repeat(-500.0),
//!     travel_max: Axes::repeat(500.0),
//!     home: Axes::zeros(),
//! };
//! let (start, mut end) = (Axes::zeros(), Axes::zeros());
//! end[0] = 10.0;
//! // The planner's side: one line, planned to its end.
//! let (producer, mut queue) = plan_queue(|| false);
//! let rules = PathRules {
//!     blend_tolerance_mm: 0.01,
//!     joint_time_s: 0.001,
//!     planner: PlannerKind::Classic,
//!     feed_override: 1.0,
//! };
//! let mut planner = Planner::new(PathLimits::new(limits, 1000.0, 0.001), rules, producer);
//! let line = Move {
//!     curve: Line::new(start, end).unwrap().into(),
//!     kind: MoveKind::Feed,
//!     feed_mm_s: 50.0,
//!     path_mode: PathMode::ExactPath,
//! };
//! planner.push(&line, 1, 0).unwrap();
//! planner.finish(2).unwrap();
//! // The cycle: a setpoint each millisecond until the plan is over.
//! let mut executor = PathExecutor::new(limits, 1_000_000, start);
//! let mut last = executor.step(&Inputs::default(), &mut queue);
//! while !executor.is_over() {
//!     last = executor.step(&Inputs::default(), &mut queue);
//! }
//! assert_eq!((last.position, last.velocity), (end, Axes::zeros()));
//! ```
//! A time-optimal plan is only evaluated. For a hold, a stop or a lower override the step itself slows the
//! plan down, starting with the setpoint in which the input arrives, without the planner. For a higher
//! override, and to return to full speed after a lower one, it requests another plan from the position that
//! it will reach 10 ms later. The runs of a classic plan are solved here in closed form.
//!
//! Jog and homing have no path: a [`TransferExecutor`] drives a transfer that was solved before. A
//! [`SetpointGenerator`] carries sequence numbers and the memory of the guard from job to job.
//!
//! An [`Excursion`] moves the axes away from a held program, by jogs or backwards along the [`DrivenPath`],
//! and back. The program continues as without it.
//!
//! At a probing step of the plan, a [`Probing`] move takes over at rest, stops when the probe in the inputs
//! trips, and returns its result. The plan continues from the position of the axes.
//!
//! At a threading step of the plan, a pass of [`Threading`] takes over at rest and follows the angle of the
//! spindle in the inputs.
//!
//! At a turning step of the plan, a [`ProcessCycle`] takes over at rest, determines its motion from the
//! cutting load in the inputs, and ends where it began. Its setpoints pass the same guard. This crate does
//! not know the processes.
//!
//! Whatever happens to the planner, the plan in the queue ends at rest on the path. If a plan is wrong, the
//! guard rejects the setpoint and the machine brakes on the path. If that violates a limit as well, each axis
//! stops on its own.

mod advance;
mod cursor;
mod driven_path;
mod excursion;
mod guard;
mod path_executor;
mod plan_preview;
mod probing;
mod process_cycle;
mod queue;
mod quick_stop;
mod replan;
mod replay;
mod run_drive;
mod scale;
mod setpoint;
mod setpoint_generator;
mod slowdown;
mod state;
mod stopping_distance;
mod takeover;
mod thread_cam;
mod thread_follower;
mod thread_landing;
mod thread_retreat;
mod thread_ripple;
mod threading;
mod transfer_executor;

pub use driven_path::DrivenPath;
pub use evolvent_wire::flags;
pub use excursion::{Excursion, ExcursionEnd};
pub use guard::{BrokenLimit, Extremes, Guard, Violation};
pub use path_executor::PathExecutor;
pub use probing::{ProbeMove, ProbeResult, ProbeVerdict, Probing};
pub use process_cycle::{ProcessCycle, ProcessInputs, ProcessStatus};
pub use queue::{PlanConsumer, PlanProducer, QueueClosed, STEPS_AHEAD, plan_queue};
pub use replay::PlannerLag;
pub use setpoint::{Inputs, Setpoint};
pub use setpoint_generator::SetpointGenerator;
pub use state::MotionState;
pub use stopping_distance::{LongestStop, StoppingDistance};
pub use takeover::{ProbingSender, ProcessSender, TakeoverSender, ThreadingSender};
pub use thread_cam::{ThreadLeg, ThreadObjection};
pub use threading::{TapReturn, ThreadPass, ThreadResult, ThreadVerdict, Threading};
pub use transfer_executor::TransferExecutor;
