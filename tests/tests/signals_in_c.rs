//! Signals of a served machine, sent by a client in C and listed by `ctl io`.

use std::process::{Child, Command, Stdio};

use evolvent_bus::ControlRequest;
use evolvent_tests::job_result::DONE;
use evolvent_tests::{
    Domain, Finished, Operator, Served, Workshop, c_example, command, evolvent, unless_disturbed,
};
use serde_json::{Value, json};

const MDI: u32 = 2;

const SIGNALS: &str = "
[signals]
input_timeout_ms = 1000
[[output]]
name = \"lamp\"
number = 1
on_end = \"keep\"
[[output]]
name = \"laser\"
kind = \"analog\"
number = 3
on_end = \"keep\"
[[input]]
name = \"lamp-burns\"
number = 1
[[input]]
name = \"light\"
kind = \"analog\"
number = 3
[[input]]
name = \"door\"
number = 9
";

/// Killed on drop.
struct Client(Child);

impl Drop for Client {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _gone = self.0.wait();
    }
}

#[test]
fn a_c_client_reads_outputs_and_sends_inputs() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let text = std::fs::read_to_string(workshop.mill("signals-c", &[])).expect("a machine file");
        let machine = workshop.write("signals-c.toml", text + SIGNALS);
        let program = c_example("signals", workshop.folder());
        let served = Served::start(&machine, "signals-c", &domain, &workshop.path("state"), &[]);
        let mut operator = Operator::join("signals-c", &domain);
        operator.brings_up();
        let listed = || -> Value {
            let output = evolvent()
                .args(["ctl", "--json", "--bus-prefix", &domain.prefix, "io", "--machine"])
                .arg(&machine)
                .output();
            let finished = Finished::from(output.expect("the binary to start")).expect_code(&[0]);
            serde_json::from_str(&finished.out).expect("JSON")
        };
        let value = |all: &Value, list: &str, name: &str| {
            let signals = all[list].as_array().expect("a list").iter();
            let mut found = signals.filter(|signal| signal["name"] == name);
            found.next().expect("a signal of this name")["value"].clone()
        };
        // Without a bridge outputs are known, and no input is.
        let all = listed();
        assert_eq!(value(&all, "outputs", "lamp"), 0.0, "{all}");
        assert_eq!(value(&all, "inputs", "lamp-burns"), json!(null), "{all}");
        let client = Client(
            Command::new(program)
                .env("EVOLVENT_MACHINE_NAME", "signals-c")
                .env("EVOLVENT_BUS_PREFIX", &domain.prefix)
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .expect("the client to start"),
        );
        let mut lamp = ControlRequest {
            amount: 1.0,
            ..command("SET_OUTPUT")
        };
        assert!(lamp.set_text("lamp"));
        operator.does(&lamp);
        operator.says_number("MODE", MDI);
        // The input shows that the lamp is on, and the brightness of the laser as it was set.
        let job = operator.says_text("MDI", "M66 P1 L3 Q60").job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        let job = operator.says_text("MDI", "M68 E3 Q4.5").job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        let all = listed();
        assert_eq!(value(&all, "inputs", "lamp-burns"), 1.0, "{all}");
        assert_eq!(value(&all, "inputs", "light"), 4.5, "{all}");
        assert_eq!(value(&all, "outputs", "laser"), 4.5, "{all}");
        let output = evolvent()
            .args([
                "top",
                "signals-c",
                "--bus-prefix",
                &domain.prefix,
                "--once",
                "--machine",
            ])
            .arg(&machine)
            .output();
        let shown = Finished::from(output.expect("the binary to start"))
            .expect_code(&[0])
            .out;
        let line = |heading: &str| shown.lines().find(|line| line.starts_with(heading));
        assert_eq!(
            line("inputs"),
            Some("inputs   lamp-burns on   door unknown   light 4.5"),
            "{shown}"
        );
        assert_eq!(line("outputs"), Some("outputs   lamp on   laser 4.5"), "{shown}");
        // No client reports this one.
        assert_eq!(value(&all, "inputs", "door"), json!(null), "{all}");
        drop(client);
        drop(operator);
        served.end().expect_code(&[0, 3]);
    });
}
