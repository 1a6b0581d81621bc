//! Cutting force laws and their files, all in one executable.

mod law_files;
mod laws;
