//! A machine that is served: one long-lived cycle, and jobs that come and go.

mod jobs;
mod jog;
mod keep;
mod live;
mod modes;
mod notify;
mod operator;
mod orders;
mod ports;
mod server;
mod snapshot;
mod track;

pub use keep::state_folder;
pub use server::{ServeConfig, ServeSummary, serve};
