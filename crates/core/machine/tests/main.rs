//! Machine files and control rates, all in one executable.

mod corrections;
mod figures;
mod machine_files;
mod rational_rate;
