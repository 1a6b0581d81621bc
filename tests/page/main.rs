//! The page of the screen: the committed build matches its sources, and a browser operates it.
#![expect(
    clippy::print_stdout,
    clippy::expect_used,
    reason = "tests fail and talk as tests do"
)]

use std::io::{BufRead, BufReader, Read};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::Duration;

use evolvent_bus::MachineInputs;
use evolvent_runtime::MonotonicClock;
use evolvent_tests::{Domain, Scene, Served, Workshop, evolvent, repository};
use rustix::process::{Pid, Signal, kill_process};

/// Runs a command at the root of the repository and prints its output. Returns whether it was skipped for
/// lack of npm or a browser.
fn measured(command: &mut Command) -> bool {
    let output = command
        .current_dir(repository())
        .output()
        .expect("a command that starts");
    let printed = [output.stdout, output.stderr].concat();
    let printed = String::from_utf8_lossy(&printed);
    println!("{printed}");
    assert!(
        output.status.success(),
        "{command:?}: {}\n{printed}",
        output.status
    );
    !printed.contains("not measured")
}

/// Whether the page can be built and a browser is available. The first call installs what is needed.
fn is_buildable() -> bool {
    static BUILDABLE: OnceLock<bool> = OnceLock::new();
    *BUILDABLE.get_or_init(|| measured(Command::new(repository().join("tools/build-page")).arg("--check")))
}

#[test]
fn the_committed_page_matches_its_sources_and_runs() {
    if is_buildable() {
        // The other cases run on a machine, in the next test.
        let _measured =
            measured(Command::new("node").args(["crates/app/screen/page/tests/made-up.mjs", "--rest"]));
    }
}

#[test]
fn a_browser_operates_a_machine_by_the_page() {
    if !is_buildable() {
        return;
    }
    // Browser and concurrent tests delay the simulated drives; how soon their silence is noticed is tested
    // elsewhere.
    let patience = [("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 200 ")];
    let options = ["--screen=127.0.0.1:0", "--trace-limit=1"];
    let mut scene = Scene::with_changes("screen-page", &patience, &options);
    let [address, _] = scene.served.as_mut().expect("a core").screen();
    // The values on the page have passed through drives, as on a machine.
    let drives = scene.drives(&[]);
    let mut operator = scene.operator();
    operator.waits("the drives", |status| status.feedback_age_ns < 1_000_000_000);
    drop(operator);
    let mut command = against(&address, &scene.workshop.path("state"));
    command.env("EVOLVENT_CTL", ctl(&scene));
    let _measured = measured(&mut command);
    let served = scene.served.take().expect("a core");
    served.end().expect_code(&[0, 3]);
    drop(drives);
}

/// The words of `evolvent ctl` for a scene, as JSON: another client that commands it.
fn ctl(scene: &Scene) -> String {
    let binary = evolvent();
    let binary = binary.get_program().to_string_lossy();
    let words = [
        &*binary,
        "ctl",
        "--machine-name",
        scene.name(),
        "--bus-prefix",
        scene.domain.prefix.as_str(),
    ];
    serde_json::to_string(&words).expect("JSON")
}

/// A page that stays open; `None` without a browser. Its first line says that it is open.
fn staying(address: &str, texts: &[&str]) -> Option<(Child, BufReader<ChildStdout>)> {
    let mut command = Command::new("node");
    command
        .arg("crates/app/screen/page/tests/ending.mjs")
        .arg(address)
        .args(texts);
    let mut child = command
        .current_dir(repository())
        .stdout(Stdio::piped())
        .spawn()
        .expect("node to start");
    let mut output = BufReader::new(child.stdout.take().expect("its output"));
    let mut line = String::new();
    output.read_line(&mut line).expect("a line");
    if line.contains("not measured") {
        child.wait().expect("a process that ends");
        return None;
    }
    assert_eq!(line, "open\n");
    Some((child, output))
}

/// Waits until a page shows a text.
fn shows((_, output): &mut (Child, BufReader<ChildStdout>), text: &str) {
    let mut line = String::new();
    output.read_line(&mut line).expect("a line");
    assert_eq!(line.trim_end(), text);
}

fn ends((mut child, mut output): (Child, BufReader<ChildStdout>)) {
    let mut rest = String::new();
    output.read_to_string(&mut rest).expect("its output");
    assert!(child.wait().expect("a process that ends").success(), "{rest}");
    assert_eq!(rest, "ok\n");
}

/// The key of a service changes with every start: an open page must not try to reconnect for ever.
#[test]
fn an_open_page_reports_a_restart_and_an_ended_run() {
    if !is_buildable() {
        return;
    }
    let free = TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr());
    let option = format!("--screen={}", free.expect("a free port"));
    let mut scene = Scene::with("screen-again", &[&option]);
    let [address, _] = scene.served.as_mut().expect("a core").screen();
    let texts = ["The service has ended", "was restarted and has a new key"];
    let Some(mut page) = staying(&address, &texts) else {
        return;
    };
    scene.served.take().expect("a core").end().expect_code(&[0, 3]);
    shows(&mut page, texts[0]);
    scene.restart_with(&[&option]);
    let [_, _] = scene.served.as_mut().expect("a core").screen();
    shows(&mut page, texts[1]);
    ends(page);
    scene.end();

    let (workshop, domain) = (Workshop::new(), Domain::new());
    let machine = workshop.mill("screen-run-end", &[]);
    let mut run = evolvent()
        .arg("run")
        .arg(workshop.long_program(600))
        .arg("--machine")
        .arg(machine)
        .args(["--bus-prefix", &domain.prefix, "--screen=127.0.0.1:0"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary to start");
    let mut lines = BufReader::new(run.stderr.take().expect("its notes"))
        .lines()
        .map_while(Result::ok);
    let address = lines.find_map(|line| Some(line.trim().strip_prefix("screen: ")?.to_owned()));
    std::thread::spawn(move || lines.for_each(drop));
    let text = "The run has ended";
    let page = staying(&address.expect("an address"), &[text]);
    let process = Pid::from_raw(run.id().cast_signed()).expect("a process");
    kill_process(process, Signal::INT).expect("a living process");
    run.wait().expect("a run that ends");
    if let Some(mut page) = page {
        shows(&mut page, text);
        ends(page);
    }
}

/// The cases against a page; macros are written next to the state of the service.
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
            // The file is empty while it is being written.
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
    if !is_buildable() {
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
        let _measured = measured(command.arg(case).env("EVOLVENT_WHEEL", &counts));
    }
    is_over.store(true, Ordering::Release);
    bridge.join().expect("a bridge that ends");
    served.end().expect_code(&[0, 3]);
}

#[test]
fn a_lathe_shows_its_passes_and_the_limits_of_chatter() {
    if !is_buildable() {
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
    let _measured = measured(command.arg("lathe"));
    served.end().expect_code(&[0, 3]);
}

#[test]
fn a_browser_operates_over_an_encrypted_connection() {
    if !is_buildable() {
        return;
    }
    let mut scene = Scene::with("screen-encrypted", &["--screen=0.0.0.0:0", "--trace-limit=1"]);
    let [address, _] = scene.served.as_mut().expect("a core").screen();
    let state = scene.workshop.path("state");
    let mut command = against(&address, &state);
    command.env("EVOLVENT_CERTIFICATE", state.join("screen/certificate.pem"));
    let _measured = measured(command.arg("an encrypted page"));
    scene.end();
}
