//! The tests of whole runs, in one executable.

mod common;

mod adaptive;
mod holds;
mod overrides;
mod signals;
mod signals_bus;
mod surface_speed;
mod turning;
