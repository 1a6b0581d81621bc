//! Curves and their joints, all in one executable.

mod conformance;
mod degenerate;
mod gallery;
mod hole;
mod involutes;
mod random;
