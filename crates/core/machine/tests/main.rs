//! Machine files and control rates, all in one executable.

mod figures;
mod machine_files;
mod rational_rate;
