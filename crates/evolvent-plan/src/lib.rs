//! Blending, look-ahead and feed profile: path segments in, runs for the cycle out.

mod scurve;

pub use scurve::{Outcome, Profile, ScalarLimits, ScalarState, reachable_speed};
