//! The screen of a machine: a web server beside a running core, a client of its bus like any other.
//!
//! Pages and server talk by [`messages`]: JSON over one WebSocket, samples and path in binary. `PROTOCOL.md` beside this crate has
//! the addresses and the order of messages.

mod command;
mod config;
mod connection;
mod gate;
mod hub;
mod listener;
pub mod messages;
mod orders;
mod programs;
mod routes;
mod server;
mod tls;
mod upload;
mod watcher;

pub use config::{ScreenConfig, ScreenError, ScreenScope};
pub use server::Screen;
