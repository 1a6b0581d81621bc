//! The tests of the bridge to EtherCAT drives, in one executable.

mod support;

mod bridge;
mod campaign;
mod clocks;
mod drive_limits;
mod drive_outputs;
mod drives;
mod dump;
mod esi;
mod faults;
mod gantry;
mod index;
mod network_files;
mod offsets;
mod round_trips;
mod scan;
mod signals;
mod startup;
