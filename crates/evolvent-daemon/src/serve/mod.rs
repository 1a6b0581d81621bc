//! A machine that is served: one long-lived cycle, and jobs that come and go.

mod homing;
mod jobs;
mod jog;
mod keep;
mod live;
mod modes;
mod notify;
mod operator;
mod orders;
mod ports;
mod programs;
mod server;
mod snapshot;
mod track;

pub use keep::state_folder;
pub use server::{ServeConfig, ServeSummary, serve};
