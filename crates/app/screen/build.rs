//! The built page is part of the binary, so the crate is rebuilt when a file of the page is added.

fn main() {
    println!("cargo::rerun-if-changed=page/dist");
}
