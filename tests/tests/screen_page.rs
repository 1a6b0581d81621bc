//! The page of the screen: the committed build is what its sources give, and a browser operates it.
#![expect(
    clippy::print_stdout,
    clippy::expect_used,
    reason = "tests fail and talk as tests do"
)]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use evolvent_bus::MachineInputs;
use evolvent_runtime::MonotonicClock;
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

/// Signals and a handwheel whose axis is selected by command.
const SIGNALS: &str = "
[signals]
input_timeout_ms = 500
[[input]]
name = \"door-closed\"
number = 0
[[input]]
name = \"air-pressure-bar\"
kind = \"analog\"
number = 2
[[input]]
name = \"wheel\"
kind = \"analog\"
number = 3
[[output]]
name = \"dust-extraction\"
number = 0
[[output]]
name = \"laser-power\"
kind = \"analog\"
number = 0
max = 10
[handwheel]
counts = \"wheel\"
";

/// Sends inputs until `is_over` is set: a closed door, and a wheel whose counts are in a file.
fn inputs_of(domain: &Domain, name: &str, counts: PathBuf, is_over: Arc<AtomicBool>) -> JoinHandle<()> {
    let client = domain.client(name);
    std::thread::spawn(move || {
        let mut sender = client.input_sender().expect("inputs");
        let (mut sequence, mut count) = (0, 0.0);
        while !is_over.load(Ordering::Acquire) {
            let text = std::fs::read_to_string(&counts).unwrap_or_default();
            // While the file is being written it is empty.
            count = text.trim().parse().unwrap_or(count);
            sequence += 1;
            let mut message = MachineInputs {
                sequence,
                instance: 78,
                time_ns: MonotonicClock::now_ns(),
                digital_mask: 1,
                digital: 1,
                analog_mask: 0b1100,
                ..MachineInputs::default()
            };
            (message.analog[2], message.analog[3]) = (6.25, count);
            let _gone = sender.send(&message);
            std::thread::sleep(Duration::from_millis(2));
        }
    })
}

#[test]
fn outputs_and_the_handwheel_are_set_at_the_page() {
    if !measured(Command::new(repository().join("tools/build-page")).arg("--check")) {
        return;
    }
    let (workshop, domain, name) = (Workshop::new(), Domain::new(), "screen-signals");
    let mill = workshop.mill(name, &[]);
    let text = std::fs::read_to_string(&mill).expect("the mill");
    let machine = workshop.write("signals.toml", format!("{text}{SIGNALS}"));
    let counts = workshop.write("counts", "123456");
    let state = workshop.path("state");
    let mut served = Served::start(&machine, name, &domain, &state, &["--screen=127.0.0.1:0"]);
    let [address, _] = served.screen();
    let is_over = Arc::new(AtomicBool::new(false));
    let bridge = inputs_of(&domain, name, counts.clone(), Arc::clone(&is_over));
    for case in ["outputs are set", "the handwheel moves"] {
        let mut command = against(&address, &state);
        let _said = measured(command.arg(case).env("EVOLVENT_WHEEL", &counts));
    }
    is_over.store(true, Ordering::Release);
    bridge.join().expect("a bridge that ends");
    served.end().expect_code(&[0, 3]);
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

#[test]
fn a_browser_operates_over_an_encrypted_connection() {
    if !measured(Command::new(repository().join("tools/build-page")).arg("--check")) {
        return;
    }
    let mut scene = Scene::with("screen-encrypted", &["--screen=0.0.0.0:0", "--trace-limit=1"]);
    let [address, _] = scene.served.as_mut().expect("a core").screen();
    let state = scene.workshop.path("state");
    let mut command = against(&address, &state);
    command.env("EVOLVENT_CERTIFICATE", state.join("screen/certificate.pem"));
    let _said = measured(command.arg("an encrypted page"));
    scene.end();
}
