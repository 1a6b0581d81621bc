//! M100 to M199: user-defined programs, executed while the axes are at rest.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use evolvent_tests::job_result::{DONE, FAILED};
use evolvent_tests::{Domain, Finished, Launch, Operator, Served, Workshop, command, unless_disturbed};

/// Moves 30 mm along X, calls M101, and returns.
const PROGRAM: &str = "G21 G90 F6000\nG1 X30\nM101 P2.5 Q-3\nG1 X0\nM2\n";
/// Longer than any command takes that ends on its own, s.
const PATIENCE_S: u32 = 60;

struct Shop {
    workshop: Workshop,
    machine: PathBuf,
    program: PathBuf,
}

impl Shop {
    /// A machine with M101 and M102; M101 is this script, in which `said` is replaced by the path of a file of the shop.
    fn new(name: &str, script: &str, timeout_s: u32) -> Self {
        let workshop = Workshop::new();
        let shipped = workshop.mill(name, &[]);
        let text = std::fs::read_to_string(shipped).expect("a machine file");
        let program = format!(
            "\n[program]\nuser_codes = [101, 102]\nuser_code_folder = \"codes\"\n\
             user_code_timeout_s = {timeout_s}\n"
        );
        let machine = workshop.write(&format!("{name}.toml"), format!("{text}{program}"));
        std::fs::create_dir(workshop.path("codes")).expect("a folder");
        let log = workshop.path("said");
        let script = script.replace("said", log.to_str().expect("UTF-8"));
        let file = workshop.write("codes/M101", format!("#!/bin/sh\n{script}\n"));
        std::fs::set_permissions(file, PermissionsExt::from_mode(0o755)).expect("permissions");
        let program = workshop.write("part.ngc", PROGRAM);
        Self {
            workshop,
            machine,
            program,
        }
    }

    fn logged(&self) -> String {
        std::fs::read_to_string(self.workshop.path("said")).unwrap_or_default()
    }

    fn runs(&self, domain: &Domain) -> Finished {
        Launch::in_real_time(&self.program, &self.machine, domain)
            .trace(&self.workshop.path("run.mcap"))
            .finish()
    }
}

/// Whether a process is the `sleep` that the script becomes. Between the two it has for a moment no command
/// line, or that of the script.
fn is_sleeping(process: &str) -> bool {
    let line = std::fs::read_to_string(format!("/proc/{process}/cmdline")).unwrap_or_default();
    line.starts_with("sleep")
}

#[test]
fn a_run_executes_a_user_command_at_rest() {
    unless_disturbed(|| {
        let (domain, shop) = (
            Domain::new(),
            Shop::new(
                "uc-run",
                "echo \"$1 $2\" >> said; echo clamped; sleep 0.5",
                PATIENCE_S,
            ),
        );
        let summary = shop.runs(&domain).expect_code(&[0, 3]).json();
        assert_eq!(shop.logged(), "2.5 -3\n");
        assert_eq!(summary["outcome"], "done");
        assert_eq!(summary["end_position"][0], 0.0);
        let mut trace =
            evolvent_trace::TraceFile::open(&shop.workshop.path("run.mcap")).expect("a complete trace");
        let events: Vec<(u64, String)> = (trace.events())
            .map(|event| event.expect("a readable event"))
            .filter(|event| event.text.contains("M101"))
            .map(|event| (event.sequence, event.text))
            .collect();
        let texts: Vec<&str> = events.iter().map(|(_, text)| text.as_str()).collect();
        assert_eq!(texts, ["M101 P2.5 Q-3", "M101: clamped"]);
        // It was at the end of the block all the time.
        let period_s = summary["period_ns"].as_f64().expect("a number") * 1e-9;
        let cycles: Vec<_> = trace
            .cycles()
            .map(|cycle| cycle.expect("a readable cycle"))
            .collect();
        let resting = (cycles.iter()).filter(|cycle| cycle.position[0] == 30.0 && cycle.feed_mm_s == 0.0);
        let seconds = resting.count() as f64 * period_s;
        // Cycles with which a busy host has to catch up are counted after it.
        assert!((0.3..30.0).contains(&seconds), "{seconds} s at the stop");
        let at = &cycles[events[1].0 as usize];
        assert_eq!((at.position[0], at.feed_mm_s), (30.0, 0.0));
    });
}

#[test]
fn a_failed_user_command_stops_with_its_alarm() {
    unless_disturbed(|| {
        for (name, script, timeout_s, expected) in [
            ("uc-fails", "echo said; exit 3", PATIENCE_S, "exit code 3"),
            ("uc-hangs", "sleep 300", 2, "did not end within 2 s"),
            ("uc-killed", "kill -9 $$", PATIENCE_S, "killed by signal 9"),
        ] {
            let (domain, shop) = (Domain::new(), Shop::new(name, script, timeout_s));
            let finished = shop.runs(&domain).expect_code(&[1]);
            assert!(finished.err.contains(expected), "{name}: {}", finished.err);
            let summary = finished.json();
            assert_eq!(summary["alarm"], 102, "{name}");
            assert_eq!(summary["outcome"], "failed", "{name}");
            assert_eq!(summary["end_position"][0], 30.0, "{name}: it stays where it is");
        }
        let (domain, shop) = (Domain::new(), Shop::new("uc-missing", "", PATIENCE_S));
        std::fs::remove_file(shop.workshop.path("codes/M101")).expect("removed");
        let summary = shop.runs(&domain).expect_code(&[1]).json();
        let error = summary["error"].to_string();
        assert!(error.contains("G0803") && error.contains("M101"), "{error}");
        // It is found before anything moves.
        assert_eq!(summary["cycles"], 0);
        for (name, options, code) in [
            ("check", &[][..], 1),
            ("run", &["--clock", "virtual", "--no-trace"], 0),
        ] {
            let finished = evolvent_tests::run(
                [
                    name.as_ref(),
                    shop.program.as_os_str(),
                    "--machine".as_ref(),
                    shop.machine.as_os_str(),
                ]
                .into_iter()
                .chain(options.iter().map(std::ffi::OsStr::new)),
            )
            .expect_code(&[code]);
            assert_eq!(
                finished.err.contains("M101") || finished.out.contains("M101"),
                code == 1,
                "{name}"
            );
        }
    });
}

#[test]
fn where_time_is_not_real_no_command_is_carried_out() {
    let shop = Shop::new("uc-virtual", "echo no > said", PATIENCE_S);
    let summary = Launch::in_virtual_time(&shop.program, &shop.machine)
        .no_trace()
        .finish()
        .expect_code(&[0])
        .json();
    assert_eq!(summary["end_position"][0], 0.0);
    let notes = summary["notes"].to_string();
    assert!(notes.contains("1 user-defined M codes"), "{notes}");
    evolvent_tests::run([
        "check".as_ref(),
        shop.program.as_os_str(),
        "--machine".as_ref(),
        shop.machine.as_os_str(),
    ])
    .expect_code(&[0]);
    assert_eq!(shop.logged(), "");
}

#[test]
fn a_served_user_command_is_ended_only_by_a_stop() {
    unless_disturbed(|| {
        let (domain, shop) = (
            Domain::new(),
            Shop::new(
                "uc-serve",
                "echo $$ > said; [ \"$1\" = 7 ] && exit 4; echo at work; exec sleep $1",
                PATIENCE_S,
            ),
        );
        let text = "G21 G90 F6000\nG1 X10\nM0\nM101 P4\nM0\nG1 X20\nM101 P1.9\nM101 P0.1\nG1 X0\nM2\n";
        let program = shop.workshop.write("two.ngc", text);
        let served = Served::start(
            &shop.machine,
            "uc-serve",
            &domain,
            &shop.workshop.path("state"),
            &[],
        );
        let mut operator = Operator::join("uc-serve", &domain);
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let stop = |status: &evolvent_bus::Status| status.state == 7;
        let job = operator.says("START").job;
        operator.waits("M0", stop);
        // Twice, by accident: the second one does not apply to the command after the stop.
        operator.says("RESUME");
        let _second = operator.request(&command("RESUME"));
        operator.waits("the command", |status| {
            status.operator_message().contains("at work")
        });
        let begun = Instant::now();
        let refused = operator.request(&command("RESUME"));
        assert_eq!(refused.alarm, 920, "{}", refused.text());
        // A hold and its end do not continue it either.
        operator.says("HOLD");
        std::thread::sleep(Duration::from_millis(100));
        operator.says("RESUME");
        let status = operator.waits("the second M0", |status| stop(status) && status.line == 5);
        assert!(
            begun.elapsed() > Duration::from_millis(500),
            "{:?}",
            begun.elapsed()
        );
        assert_eq!(status.position_machine[0], 10.0);
        operator.says("RESUME");
        let status = operator.sees_end(job);
        assert_eq!((status.job_result, status.position_machine[0]), (DONE, 0.0));

        // A stop ends it.
        let before = shop.logged();
        let job = operator.says("START").job;
        operator.waits("M0", stop);
        operator.says("RESUME");
        // Its earlier message to the operator may still be there.
        operator.waits("the command", |_| {
            let logged = shop.logged();
            logged.ends_with('\n') && logged != before
        });
        let process = shop.logged().trim().to_owned();
        operator.waits("the sleep", |_| is_sleeping(&process));
        operator.says("STOP");
        let status = operator.sees_end(job);
        assert_eq!((status.job_result, status.alarm_count), (2, 0));
        assert!(!is_sleeping(&process), "{process} is left");

        // A failure is an alarm that stays.
        let program = shop
            .workshop
            .write("fails.ngc", "G21 G90 F6000\nG1 X5\nM101 P7\nG1 X0\nM2\n");
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let job = operator.says("START").job;
        let status = operator.sees_end(job);
        assert_eq!(status.job_result, FAILED);
        assert_eq!(status.listed_alarms(), [102], "{}", status.alarm_sentence());
        assert!(
            status.alarm_sentence().contains("exit code 4"),
            "{}",
            status.alarm_sentence()
        );
        assert_eq!(status.position_machine[0], 5.0);
        assert_eq!(operator.request(&command("START")).alarm, 918);
        operator.says("CLEAR_ALARMS");
        // And in a block of MDI.
        operator.says_number("MODE", 2);
        let job = operator.says_text("MDI", "M101 P0.05").job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        drop(operator);
        served.end().expect_code(&[0, 3]);
    });
}
