//! Tests of whole runs, in one executable.

mod common;

mod adaptive;
mod empty_programs;
mod holds;
mod overrides;
mod signals;
mod signals_bus;
mod surface_speed;
mod turning;
mod unhomed;
