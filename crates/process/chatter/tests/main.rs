//! Self-oscillation and stability lobes, all in one executable.

mod common;

mod case_files;
mod figures;
mod lobes;
mod properties;
mod radial_law;
mod verdicts;
