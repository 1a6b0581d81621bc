//! Configurations of other controls, all in one executable.

mod configurations;
mod hostile;
mod reports;
