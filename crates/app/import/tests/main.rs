//! Tests of configurations of other controls, in one executable.

mod configurations;
mod hostile;
mod reports;
