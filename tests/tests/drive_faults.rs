//! A machine that is served, with simulated drives that fail: over the real bus, in real time. Every kind of fault ends at
//! rest, with the alarm that names it. At 50 random moments each, by simulated time, it is tried in `evolvent-bridge-sim`.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use evolvent_tests::{Domain, Finished, Workshop, evolvent};
use serde_json::Value;

/// Core and drives of one machine; ended when it is dropped.
struct Machine {
    name: &'static str,
    domain: Domain,
    workshop: Workshop,
    core: Option<Child>,
    drives: Option<Child>,
}

impl Machine {
    fn start(name: &'static str, drive_options: &[&str]) -> Self {
        let (domain, workshop) = (Domain::new(), Workshop::new());
        // Busy machines: feedback may be old, and setpoints are sent long before they are due.
        let file = workshop.mill(
            name,
            &[
                ("lead_cycles = 2 ", "lead_cycles = 60 "),
                ("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 400 "),
            ],
        );
        let mut machine = Self {
            name,
            domain,
            workshop,
            core: None,
            drives: None,
        };
        machine.core = Some(machine.serve(&file));
        machine.drives = Some(machine.sim(drive_options));
        machine
    }

    fn spawn(command: &mut Command) -> Child {
        command
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the binary to start")
    }

    fn serve(&self, file: &Path) -> Child {
        Self::spawn(
            evolvent()
                .args([
                    "serve",
                    "--rate",
                    "500",
                    "--bus-prefix",
                    &self.domain.prefix,
                    "--machine",
                ])
                .arg(file)
                .arg("--state")
                .arg(self.workshop.path("state")),
        )
    }

    fn sim(&self, options: &[&str]) -> Child {
        let name = [
            "bridge",
            "sim",
            "--machine-name",
            self.name,
            "--bus-prefix",
            &self.domain.prefix,
        ];
        Self::spawn(evolvent().args(name).args(options))
    }

    fn ctl(&self, words: &[&str]) -> Finished {
        evolvent()
            .args([
                "ctl",
                "--machine-name",
                self.name,
                "--bus-prefix",
                &self.domain.prefix,
                "--json",
            ])
            .args(["--patience", "20"])
            .args(words)
            .output()
            .expect("the binary to start")
            .into()
    }

    fn status(&self) -> Value {
        let whole = self.ctl(&["status"]).expect_code(&[0]).json();
        // The status may stand in an object of its own.
        whole.get("status").cloned().unwrap_or(whole)
    }

    fn until(&self, what: &str, seen: impl Fn(&Value) -> bool) -> Value {
        let deadline = Instant::now() + Duration::from_secs(20);
        loop {
            let status = self.status();
            if seen(&status) {
                return status;
            }
            assert!(Instant::now() < deadline, "{what}: not seen in {status}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        for child in [&mut self.core, &mut self.drives].into_iter().flatten() {
            let _sent = Command::new("kill")
                .arg("-TERM")
                .arg(child.id().to_string())
                .status();
            let _ended = child.wait();
        }
    }
}

fn stands(status: &Value) -> bool {
    let velocity = status["velocity"].as_object().expect("velocities");
    velocity
        .values()
        .all(|value| value.as_f64().is_some_and(|value| value.abs() < 1e-6))
}

/// Brings a machine up, lets it move, and waits for the alarm of a fault 4 s after the drives came into operation.
fn alarm_of(name: &'static str, fault: &str) -> (u64, Value) {
    let machine = Machine::start(name, &["--fault", fault, "--bridge-cycles", "50"]);
    machine.until("a bridge", |status| !status["feedback_age_ns"].is_null());
    machine.ctl(&["up"]).expect_code(&[0]);
    machine.ctl(&["home"]).expect_code(&[0]);
    machine
        .ctl(&["mdi", "G1 X200 Y100 F2400", "--no-wait"])
        .expect_code(&[0]);
    let status = machine.until("an alarm", |status| {
        status["alarms"].as_array().is_some_and(|list| !list.is_empty())
    });
    let alarm = status["alarms"][0].as_u64().expect("a number");
    let rest = machine.until("rest", stands);
    // It stays until it is cleared, and nothing moves before.
    let refused = machine.ctl(&["mdi", "G0 X0", "--no-wait"]);
    assert_ne!(refused.code, Some(0), "{}", refused.out);
    (alarm, rest)
}

#[test]
fn drives_that_fail_on_the_bus_stop_the_machine_with_the_alarm_that_names_the_fault() {
    let cases: [(&str, &str, &[u64]); 6] = [
        ("silent", "silent@4", &[401]),
        ("frozen", "frozen@4", &[402]),
        ("faulted", "fault@4:Y", &[406]),
        ("off", "off@4:X", &[407]),
        ("jump", "jump@4:X", &[409]),
        ("nan", "nan@4:X", &[404]),
    ];
    for (name, fault, expected) in cases {
        let (alarm, status) = alarm_of(name, fault);
        assert!(expected.contains(&alarm), "{fault}: {alarm} in {status}");
    }
}
