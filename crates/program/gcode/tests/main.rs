//! The language, its errors and its cycles, all in one executable.

mod assumed_contacts;
mod bad_input;
mod contours;
mod curves;
mod cutters;
mod dialect_values;
mod dialects;
mod drilling_cycles;
mod fanuc_threads;
mod flow;
mod interpreted;
mod language;
mod linuxcnc;
mod mutations;
mod o_words;
mod probing_cycles;
mod programs;
mod random;
mod reference;
mod saved_modes;
mod spindles;
mod surface_speed;
mod tool_change;
mod turning;
mod turning_passes;
mod unlimited;
