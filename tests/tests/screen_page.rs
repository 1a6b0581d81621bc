//! The page of the screen: the committed build is what its sources give, and a browser operates it.
#![expect(
    clippy::print_stdout,
    clippy::expect_used,
    reason = "tests fail and talk as tests do"
)]

use std::path::Path;
use std::process::Command;

use evolvent_tests::{Domain, Scene, Served, Workshop, repository};

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
    let mut scene = Scene::with("screen-page", &["--screen=127.0.0.1:0", "--trace-limit=1"]);
    let [address, _] = scene.served.as_mut().expect("a core").screen();
    let _said = measured(&mut against(&address, &scene.workshop.path("state")));
    scene.end();
}

/// The cases against a page; macros are written beside the service's state.
fn against(address: &str, state: &Path) -> Command {
    let mut command = Command::new("node");
    command
        .arg("crates/app/screen/page/tests/against.mjs")
        .arg(address)
        .env("EVOLVENT_MACROS", state.join("macros.toml"));
    command
}

#[test]
fn a_lathe_shows_its_passes_and_the_limits_of_chatter() {
    if !measured(Command::new(repository().join("tools/build-page")).arg("--check")) {
        return;
    }
    let (workshop, domain) = (Workshop::new(), Domain::new());
    let shipped = std::fs::read_to_string(repository().join("config/machines/lathe-2axis.toml"));
    let text = shipped.expect("the shipped lathe");
    let text = text.replace("name = \"lathe-2axis\"", "name = \"screen-lathe\"");
    let machine = workshop.write("screen-lathe.toml", text);
    let [turning, lobes] = ["turn-shaft.toml", "lobes-turning.toml"].map(|name| {
        format!(
            "--process={}",
            repository().join("config/processes").join(name).display()
        )
    });
    let state = workshop.path("state");
    let options = ["--screen=127.0.0.1:0", &turning, &lobes];
    let mut served = Served::start(&machine, "screen-lathe", &domain, &state, &options);
    let [address, _] = served.screen();
    let mut command = against(&address, &state);
    let _said = measured(command.arg("lathe"));
    served.end().expect_code(&[0, 3]);
}
