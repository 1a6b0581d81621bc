//! The cycle: a pure, allocation-free step from inputs to one setpoint.
//!
//! [`Motion::step`] advances the path parameter by one period along the profile of the present run, evaluates
//! the path there, has the [`Guard`] check the result, and returns a [`Setpoint`]. Time enters only as the
//! period. The plan comes through a wait-free queue ([`plan_queue`]); feed hold, override and stop come as
//! [`Inputs`] and take effect in the same step: the profile of the present run is solved again in closed form,
//! from the present speed and acceleration, within the limits of the run.
//!
//! Whatever happens to the planner, the queue ends at rest on the path. Should a plan be wrong, the guard refuses
//! the setpoint, the machine brakes on the path, and if that breaks a limit as well, each axis stops by itself.

mod advance;
mod asking;
mod cursor;
mod guard;
mod motion;
mod queue;
mod quick_stop;
mod setpoint;
mod slow;
mod state;

pub use guard::{Extremes, Guard, Quantity, Violation};
pub use motion::Motion;
pub use queue::{PlanConsumer, PlanProducer, QueueClosed, STEPS_AHEAD, plan_queue};
pub use setpoint::{Inputs, Setpoint};
pub use state::{State, flags};
