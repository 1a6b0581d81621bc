//! The screen of a machine: a web server next to a running core, and an ordinary client of its bus.
//!
//! Pages and server exchange [`messages`]: JSON over one WebSocket, samples and path in binary. `PROTOCOL.md`
//! in this crate has the addresses and the order of messages.
//!
//! ```
//! use evolvent_screen::messages::FromPage;
//!
//! let message: FromPage = serde_json::from_str(r#"{ "type": "take", "force": true }"#)?;
//! assert_eq!(message, FromPage::Take { force: true });
//! # Ok::<(), serde_json::Error>(())
//! ```

mod chatter;
mod command;
mod config;
mod connection;
mod dispatch;
mod documents;
mod event_log;
mod gate;
mod hub;
mod kept;
mod listener;
mod loaded_program;
mod macro_file;
pub mod messages;
mod names;
mod orders;
mod pace;
mod path_stream;
mod program_store;
mod programmed_path;
mod programs;
mod restart;
mod routes;
mod sampled_signals;
mod sampling;
mod screen;
mod server;
mod signal_board;
mod slots;
mod streaming;
mod tls;
mod traces;
mod turns;
mod upload;
mod watcher;

pub use config::{ScreenConfig, ScreenError, ScreenScope};
pub use macro_file::{macros_schema, parse_macros};
pub use screen::Screen;
