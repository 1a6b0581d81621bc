//! The page of the screen: the committed build is what its sources give, and a browser operates it.
#![expect(
    clippy::print_stdout,
    clippy::expect_used,
    reason = "tests fail and talk as tests do"
)]

use std::process::Command;

use evolvent_tests::{Scene, repository};

/// Runs a command at the root of the repository and hands on what it says; whether it was left out for want of npm or a browser.
fn measured(command: &mut Command) -> bool {
    let output = command
        .current_dir(repository())
        .output()
        .expect("a command that starts");
    let said = [output.stdout, output.stderr].concat();
    let said = String::from_utf8_lossy(&said);
    println!("{said}");
    assert!(output.status.success(), "{command:?}: {}\n{said}", output.status);
    !said.contains("not measured")
}

#[test]
fn the_committed_page_is_what_its_sources_give_and_a_browser_operates_it() {
    if !measured(Command::new(repository().join("tools/build-page")).arg("--check")) {
        return;
    }
    let _said = measured(Command::new("node").arg("crates/app/screen/page/tests/made-up.mjs"));
    let mut scene = Scene::with("screen-page", &["--screen=127.0.0.1:0"]);
    let [address, _] = scene.served.as_mut().expect("a core").screen();
    let _said = measured(
        Command::new("node")
            .arg("crates/app/screen/page/tests/against.mjs")
            .arg(&address),
    );
    scene.end();
}
