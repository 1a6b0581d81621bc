//! Curves and their joints, all in one executable.

mod conformance;
mod degenerate;
mod hole;
mod random;
