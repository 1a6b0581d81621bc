//! Clients in another language receive the commanded setpoints on the bus and in the trace, every cycle and
//! every bit.

use std::fs;
use std::io::{BufRead, BufReader};
use std::process::Stdio;

use evolvent_tests::{Domain, Finished, Launch, Workshop, cycles, python, unless_disturbed, wait};

/// Python subscribes before the run starts; the run waits for it. The three dumps contain sequence and nine
/// positions of every cycle, 80 bytes each: from the bus, from the trace, and from a run with the virtual
/// clock.
#[test]
fn python_reads_the_same_bits_from_bus_and_trace() {
    unless_disturbed(|| {
        let (Some(mut bus_client), Some(mut trace_client)) =
            (python("read_setpoints.py"), python("read_trace.py"))
        else {
            return;
        };
        let domain = Domain::new();
        let workshop = Workshop::new();
        let program = workshop.short_program();
        let machine = workshop.mill("foreign", &[]);
        let (on_bus, in_trace) = (workshop.path("bus.dump"), workshop.path("trace.dump"));
        let trace = workshop.path("run.mcap");

        let mut reader = bus_client
            .args([
                "--machine",
                "foreign",
                "--prefix",
                &domain.prefix,
                "--until-last",
                "--json",
                "--dump",
            ])
            .arg(&on_bus)
            .stdout(Stdio::piped())
            .spawn()
            .expect("Python to start");
        let mut lines = BufReader::new(reader.stdout.take().expect("its output")).lines();
        assert_eq!(lines.next().expect("a line").expect("text"), "ready");

        let finished = Launch::in_real_time(&program, &machine, &domain)
            .with(&["--wait-for-clients", "1"])
            .trace(&trace)
            .finish();
        let run_summary = finished.expect_code(&[0, 3]).json();
        let client_summary: serde_json::Value =
            serde_json::from_str(&lines.next().expect("a summary").expect("text")).expect("JSON");
        assert!(reader.wait().expect("its end").success(), "{client_summary}");

        assert_eq!(client_summary["once_and_in_order"], true, "{client_summary}");
        assert_eq!(client_summary["first"], 0);
        assert_eq!(
            client_summary["count"], run_summary["cycles"],
            "every cycle, none more"
        );
        assert_eq!(client_summary["axes"], "XYZ");
        assert_eq!(client_summary["period_ns"], run_summary["period_ns"]);
        assert_eq!(run_summary["dropped_setpoints"], 0);
        assert_eq!(run_summary["dropped_records"], 0);

        let read: Finished = trace_client
            .arg(&trace)
            .arg("--json")
            .arg("--dump")
            .arg(&in_trace)
            .output()
            .expect("Python")
            .into();
        let read = read.expect_code(&[0]).json();
        assert_eq!(read["cycles"], run_summary["cycles"]);
        assert_eq!(
            read["attachments"].as_object().map(serde_json::Map::len),
            Some(2),
            "program and machine file"
        );

        let bus = fs::read(&on_bus).expect("the dump of the bus");
        assert_eq!(
            bus.len() as u64,
            80 * run_summary["cycles"].as_u64().expect("a count")
        );
        assert!(
            bus == fs::read(&in_trace).expect("the dump of the trace"),
            "bus and trace differ"
        );

        let virtual_trace = workshop.path("virtual.mcap");
        Launch::in_virtual_time(&program, &machine)
            .trace(&virtual_trace)
            .finish()
            .expect_code(&[0]);
        let computed: Vec<u8> = cycles(&virtual_trace)
            .iter()
            .flat_map(|cycle| {
                let positions = cycle.position.into_iter().flat_map(f64::to_le_bytes);
                cycle
                    .sequence
                    .to_le_bytes()
                    .into_iter()
                    .chain(positions)
                    .collect::<Vec<_>>()
            })
            .collect();
        assert!(bus == computed, "real and virtual clock differ");
    });
}

/// A client that is suspended during a run delays neither the run nor other clients.
#[test]
fn a_client_that_stops_reading_delays_nobody() {
    unless_disturbed(|| {
        let domain = Domain::new();
        let workshop = Workshop::new();
        let program = workshop.short_program();
        let machine = workshop.mill("lazy", &[]);
        let running = Launch::in_real_time(&program, &machine, &domain)
            .no_trace()
            .with(&["--wait-for-clients", "2"])
            .start();
        let client = domain.client("lazy");
        // Subscribed, but never read.
        let lazy = client.setpoints().expect("a subscription");
        let mut eager = client.setpoints().expect("a subscription");
        let mut next = 0;
        let summary = std::thread::scope(|scope| {
            let end = scope.spawn(|| wait(running));
            loop {
                let over = end.is_finished();
                while let Some(setpoint) = eager.receive().expect("the bus") {
                    assert_eq!(setpoint.sequence, next);
                    next += 1;
                }
                if over {
                    break;
                }
                std::thread::sleep(std::time::Duration::from_millis(1));
            }
            end.join().expect("the run").expect_code(&[0, 3]).json()
        });
        assert_eq!(summary["cycles"], next);
        assert_eq!(summary["dropped_setpoints"], 0);
        drop(lazy);
    });
}
