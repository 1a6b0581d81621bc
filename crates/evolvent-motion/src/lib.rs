//! The cycle: a pure, allocation-free step from inputs to one setpoint.
//!
//! [`Motion::step`] advances the path parameter by one period along the plan, evaluates the path there, has the
//! [`Guard`] check the result, and returns a [`Setpoint`]. Time enters only as the period. The plan comes through a
//! wait-free queue ([`plan_queue`]); feed hold, override and stop come as [`Inputs`].
//!
//! A near-optimal plan is a law that is only evaluated. For a hold or another override the step asks the planner for
//! a plan from the place where it will be 10 ms later; a hold that nobody answers slows path time itself. The runs of
//! a classic plan are solved here in closed form, so there a wish takes effect in the same step.
//!
//! Jog and homing have no path: a [`Steering`] drives a transfer that was solved before. A [`Station`] carries sequence
//! numbers and the guard's memory from job to job.
//!
//! Where the plan says so, a [`Turning`] cycle takes over at rest, finds its passes from the cutting load in the inputs,
//! and comes back to the same place; its setpoints pass the same guard.
//!
//! Whatever happens to the planner, the queue ends at rest on the path. Should a plan be wrong, the guard refuses
//! the setpoint, the machine brakes on the path, and if that breaks a limit as well, each axis stops by itself.

mod advance;
mod asking;
mod cursor;
mod ease;
mod easing;
mod guard;
mod motion;
mod queue;
mod quick_stop;
mod setpoint;
mod slow;
mod state;
mod station;
mod steering;
mod turning;

pub use guard::{Extremes, Guard, Quantity, Violation};
pub use motion::Motion;
pub use queue::{PlanConsumer, PlanProducer, QueueClosed, STEPS_AHEAD, TurningSender, plan_queue};
pub use setpoint::{Inputs, Setpoint};
pub use state::{State, flags};
pub use station::Station;
pub use steering::Steering;
pub use turning::{Turning, TurningFrame};
