//! The checked-in code and descriptors match the `.proto` files.
//!
//! After an edit of a `.proto` file: `EVOLVENT_REGENERATE=1 cargo test -p evolvent-trace schema::`.
//! Generated code is checked in so that a build needs no protobuf compiler, not even one written in Rust.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail as tests do"
)]

use std::fs;
use std::path::{Path, PathBuf};

use prost::Message as _;

fn crate_folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn check(path: &Path, wanted: &[u8]) {
    if std::env::var_os("EVOLVENT_REGENERATE").is_some() {
        fs::write(path, wanted).expect("writing generated file");
    }
    let found = fs::read(path).unwrap_or_default();
    assert!(
        found == wanted,
        "{} is not what the .proto file says; regenerate it with \
         EVOLVENT_REGENERATE=1 cargo test -p evolvent-trace schema::",
        path.display()
    );
}

fn check_package(proto: &str, package: &str) {
    let mut files =
        protox::compile([proto], [crate_folder().join("proto")]).expect("the .proto file compiles");
    // Comments go into the Rust code as documentation, but not into every trace.
    let out = tempfile::tempdir().expect("temporary folder");
    prost_build::Config::new()
        .out_dir(out.path())
        .compile_fds(files.clone())
        .expect("the descriptors become Rust code");
    let code = fs::read(out.path().join(format!("{package}.rs"))).expect("generated code");
    let generated = crate_folder().join("src/generated");
    check(&generated.join(format!("{package}.rs")), &code);
    for file in &mut files.file {
        file.source_code_info = None;
    }
    check(&generated.join(format!("{package}.fds")), &files.encode_to_vec());
}

#[test]
fn generated_code_matches_the_evolvent_schema() {
    check_package("evolvent/v1/trace.proto", "evolvent.v1");
}

#[test]
fn generated_code_matches_the_foxglove_schema() {
    check_package("foxglove/foxglove.proto", "foxglove");
}
