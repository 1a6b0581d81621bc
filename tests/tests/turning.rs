//! Turning by the cutting load, in real time over the real bus: simulated drives cut a simulated stock.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

use evolvent_tests::{Domain, Launch, Workshop, evolvent, repository};

/// Drives and the stock under them, in a process of their own; killed when dropped.
struct Drives(Child);

impl Drives {
    fn start(machine: &Path, process: &Path, domain: &Domain) -> Self {
        let child = evolvent()
            .args([
                "bridge",
                "sim",
                "--bus-prefix",
                &domain.prefix,
                "--bridge-cycles",
                "100",
                "--machine",
            ])
            .arg(machine)
            .arg("--process")
            .arg(process)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the binary to start");
        Self(child)
    }
}

impl Drop for Drives {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _gone = self.0.wait();
    }
}

/// A lathe at 500 Hz that is never stopped for lateness, and a short stock. Busy hosts deliver readings late: a reading may
/// be half a second old, which a slow spindle allows.
fn scene(workshop: &Workshop, name: &str) -> (PathBuf, PathBuf) {
    let read = |file: &str| std::fs::read_to_string(repository().join(file)).expect("a shipped file");
    let machine = read("config/machines/lathe-2axis.toml")
        .replace("name = \"lathe-2axis\"", &format!("name = {name:?}"))
        .replace("rate = \"rational\"", "rate = 500")
        + "\n[realtime]\nmax_late_cycles = 0\n";
    let process = read("config/processes/turn-shaft.toml")
        .replace("length_mm = 200.0", "length_mm = 4.0")
        .replace("spindle_rpm = 500.0", "spindle_rpm = 100.0")
        .replace("[[0.0, 10.0], [200.0, 5.0]]", "[[0.0, 3.0], [4.0, 2.5]]")
        .replace("stale_ms = 10.0", "stale_ms = 300.0");
    (
        workshop.write("lathe.toml", machine),
        workshop.write("process.toml", process),
    )
}

#[test]
fn a_cycle_finds_its_passes_from_the_load_that_simulated_drives_measure() {
    let (workshop, domain) = (Workshop::new(), Domain::new());
    let (machine, process) = scene(&workshop, "turn-real");
    let program = workshop.write(
        "turn.ngc",
        "G21 G18 G90 G94 G8\nS100 M3\nG4 P2\nG0 Z308\nG0 X33.5\nG0 Z300\nF200\nG82 X60 Z296 Q1\nM2\n",
    );
    let _drives = Drives::start(&machine, &process, &domain);
    let trace = workshop.path("turn.mcap");
    let finished = Launch::in_real_time(&program, &machine, &domain)
        .with(&["--wait-for-clients", "1", "--process"])
        .with(&[process.to_str().expect("UTF-8")])
        .trace(&trace)
        .finish();
    let summary = finished.expect_code(&[0, 3]).json();
    assert_eq!(summary["outcome"], "done", "{summary}");
    // The tool has cut: there were readings far above noise, and every change has its reason.
    let table = workshop.path("events.csv");
    let exported = evolvent()
        .args(["trace", "export", "--channel", "events", "-o"])
        .arg(&table)
        .arg(&trace)
        .output()
        .expect("the binary to start");
    assert!(
        exported.status.success(),
        "{}",
        String::from_utf8_lossy(&exported.stderr)
    );
    let events = std::fs::read_to_string(table).expect("a table");
    for expected in ["contact", "settled", "end of the pass", "everything is at size"] {
        assert!(events.contains(expected), "{expected}: {events}");
    }
}
