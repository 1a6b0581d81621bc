//! The cycle: a pure, allocation-free step from inputs to one setpoint.

mod state;

pub use state::{State, flags};
