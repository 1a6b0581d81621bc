//! Machine files and control rates, all in one executable.

mod common;
mod corrections;
mod figures;
mod handwheel;
mod homing;
mod machine_files;
mod plausible;
mod random_text;
mod rational_rate;
mod signals;
mod unlimited;
