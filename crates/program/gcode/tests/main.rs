//! The language, its errors and its cycles, all in one executable.

mod assumed_contacts;
mod bad_input;
mod blocks;
mod contours;
mod curves;
mod cutters;
mod dialect_values;
mod dialects;
mod drilling_cycles;
mod error_reports;
mod fanuc_threads;
mod flow;
mod interpreted;
mod language;
mod lathe_dialects;
mod linuxcnc;
mod mutations;
mod o_words;
mod probing_cycles;
mod programs;
mod random;
mod random_tools;
mod reference;
#[path = "common/rs274.rs"]
mod rs274;
mod saved_modes;
mod spindles;
mod surface_speed;
mod tapping;
mod thread_cycles;
mod tool_change;
mod tool_tables;
mod turning;
mod turning_passes;
mod unknown_start;
mod unlimited;
