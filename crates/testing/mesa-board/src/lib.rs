//! A TEST SIMULATOR: a Mesa Ethernet board (HostMot2 over LBP16, UDP) in a process, with motors at its pins.
//!
//! ```
//! use evolvent_mesa_board::{Board, BoardModel};
//!
//! let mut board = Board::new(BoardModel::B7i96s, 0);
//! // Read one register of 32 bits of HostMot2 (space 0), at 0x0100: the cookie of a configuration.
//! let mut replies = Vec::new();
//! board.receive(1_000, &[0x01, 0x42, 0x00, 0x01], |reply| replies.push(reply.to_vec()));
//! assert_eq!(replies, [0x55AA_CAFE_u32.to_le_bytes()]);
//! ```
//!
//! [`Board`] is a pure model: it takes packets and times and returns packets. [`BoardServer`] connects it to
//! a socket. Registers follow Mesa's register map of HostMot2. Step generators count as on the real board;
//! their motors follow the pulses only while the pins are outputs of the generator. [`Fault`]s are simulated
//! on demand.
//!
//! A [`Beam`] is a gantry: two motors, each with its home switch. A [`Spindle`] has inertia and an encoder
//! with an index.
//!
//! Smart serial has one device, a 7I76 at the first channel. Not simulated: the DPLL, flash and
//! configuration.

mod beam;
mod board;
mod encoder;
mod fault;
mod field_pins;
mod layout;
mod lbp16;
mod server;
mod smart_serial;
mod spindle;
mod step_generator;
mod switch;

pub use beam::{Beam, BeamMotor, BeamSide};
pub use board::{Board, Traffic};
pub use fault::{Fault, FaultError, FaultKind};
pub use layout::BoardModel;
pub use server::{BoardServer, PORT, SharedBoard, now_ns, serve};
pub use spindle::{Spindle, SpindleCommand};
pub use switch::Switch;
