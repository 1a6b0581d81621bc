//! The screen of a machine: a web server beside a running core, a client of its bus like any other.
//!
//! Pages and server talk by [`messages`]: JSON over one WebSocket, samples and path in binary. `PROTOCOL.md` beside this crate has
//! the addresses and the order of messages.

pub mod messages;
