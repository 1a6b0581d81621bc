//! The built page is part of the binary: a file that is added to it makes the crate new.

fn main() {
    println!("cargo::rerun-if-changed=page/dist");
}
