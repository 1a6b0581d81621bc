//! Self-oscillation and stability lobes, all in one executable.

mod common;

mod case_files;
mod figures;
mod followed;
mod lobes;
mod lobes_simulated;
mod properties;
mod published_cuts;
mod radial_law;
mod verdicts;
