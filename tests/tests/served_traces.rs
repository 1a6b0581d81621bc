//! The jobs of a served machine are recomputed from its trace with the same result.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]

use std::path::{Path, PathBuf};
use std::time::Duration;

use evolvent_bus::ControlRequest;
use evolvent_inspect::write_report;
use evolvent_replay::{Verified, verify};
use evolvent_tests::job_result::DONE;
use evolvent_tests::{Domain, Drives, HOMING, Operator, Served, Workshop, command, unless_disturbed};
use evolvent_trace::{CycleRecord, EventKind, Recorder, TraceFile, TraceMessage, inputs};

const PROGRAM: &str = "\
G17 G21 G90 G94 G64 P0.02 F6000
M3 S1000
G0 X0 Y0 Z0
o<there_and_back> call [40] [20]
G1 X-20 Y10
G2 X-10 Y0 R12
G4 P0.05
o<there_and_back> call [60] [-30]
G10 L2 P1 X1
G54 G1 X5 Y5
M30
";

const SUBROUTINE: &str = "\
o<there_and_back> sub
G1 X#1 Y#2
G1 X[-#1] Y[-#2]
G1 X#1 Y#2
o<there_and_back> endsub
";

fn jog(axis: usize, distance: f64, speed: f64) -> ControlRequest {
    let mut request = ControlRequest {
        axes_mask: 1 << axis,
        // An increment, not a continuous jog.
        index: 1,
        amount: speed,
        ..command("JOG")
    };
    request.values[axis] = distance;
    request
}

/// Homing, MDI, jogs that reverse, a program with subroutines from a folder, overrides, holds and an
/// emergency stop.
fn session(workshop: &Workshop, cycles: &str) -> PathBuf {
    let domain = Domain::new();
    let name = format!("sv-{cycles}");
    let shipped = workshop.mill(&name, &[]);
    let text = std::fs::read_to_string(shipped).expect("a machine file");
    let text = text
        .replace("feedback_timeout_ms = 20", "feedback_timeout_ms = 1000")
        .replace("[trace]\n", &format!("[trace]\ncycles = \"{cycles}\"\n"))
        // Before the first table: where subroutines are.
        + "\n[program]\nsubroutines = [\"library\"]\n";
    let folder = workshop.path("library");
    std::fs::create_dir_all(&folder).expect("a folder");
    std::fs::write(folder.join("there_and_back.ngc"), SUBROUTINE).expect("a file");
    let machine = workshop.write(&format!("{name}.toml"), format!("{text}\n{HOMING}"));
    let program = workshop.write("part.ngc", PROGRAM);
    let trace = workshop.path(&format!("{name}.mcap"));
    let options = ["--trace", trace.to_str().expect("UTF-8")];
    let served = Served::start(&machine, &name, &domain, &workshop.path("state"), &options);
    let drives = Drives::start(&machine, &domain, &["--reference-offset", "3.5"]);
    let mut operator = Operator::join(&name, &domain);
    operator.waits("drives", |status| status.feedback_age_ns < 1_000_000_000);
    operator.brings_up();
    operator.says_number("MODE", 1);
    let job = operator.says("HOME").job;
    assert_eq!(operator.sees_end(job).job_result, DONE);
    for (axis, distance) in [(0, 12.5), (1, -8.25)] {
        let job = operator.does(&jog(axis, distance, 30.0)).job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
    }
    // Reversed while it moves.
    operator.does(&jog(0, 60.0, 40.0));
    std::thread::sleep(Duration::from_millis(300));
    let job = operator.does(&jog(0, -30.0, 20.0)).job;
    std::thread::sleep(Duration::from_millis(300));
    operator.says("JOG_STOP");
    operator.sees_end(job);
    operator.says_number("MODE", 2);
    for text in [
        "G0 X20 Y1",
        "G91 G1 F3000 X-5",
        "G90 G10 L20 P1 X0",
        "G2 X4 Y1 I2 F2000",
    ] {
        let job = operator.says_text("MDI", text).job;
        assert_eq!(operator.sees_end(job).job_result, DONE, "{text}");
    }
    operator.says_number("MODE", 0);
    operator.says_text("LOAD", program.to_str().expect("UTF-8"));
    let job = operator.says("START").job;
    operator.waits("motion", |status| status.feed_mm_s > 50.0);
    operator.does(&ControlRequest {
        amount: 0.6,
        ..command("FEED_OVERRIDE")
    });
    std::thread::sleep(Duration::from_millis(400));
    operator.says("HOLD");
    std::thread::sleep(Duration::from_millis(400));
    operator.says("RESUME");
    let ended = operator.sees_end(job);
    assert_eq!(ended.job_result, DONE, "{}", ended.alarm_sentence());
    let job = operator.says("START").job;
    operator.waits("motion", |status| status.feed_mm_s > 30.0);
    operator.says("ESTOP");
    operator.sees_end(job);
    operator.waits("no power", |status| status.power == 0 && status.enabled_mask == 0);
    operator.brings_up();
    operator.says_number("MODE", 2);
    let job = operator.says_text("MDI", "G0 X3").job;
    assert_eq!(operator.sees_end(job).job_result, DONE);
    drop(operator);
    drop(drives);
    served.end().expect_code(&[0, 3]);
    trace
}

/// Returns `false` if the host was so busy that planning was late, which is not recorded.
fn came_in_time(trace: &Path) -> bool {
    let mut file = TraceFile::open(trace).expect("a trace");
    let is_late = |cycle: &CycleRecord| {
        cycle.flags & 32 != 0
            || (cycle.inputs & (inputs::WAITED | inputs::REFUSED) != 0 && cycle.feed_mm_s > 0.0)
    };
    let late = file.cycles().any(|cycle| is_late(&cycle.expect("a cycle")));
    if late {
        println!("not measured: the planner was too slow on this machine");
    }
    !late
}

/// The same trace with changed cycles.
fn altered(trace: &Path, name: &str, change: impl FnMut(&mut CycleRecord)) -> PathBuf {
    copied(trace, name, change, |_| true)
}

/// The same trace with changed cycles and some of its events.
fn copied(
    trace: &Path,
    name: &str,
    mut change: impl FnMut(&mut CycleRecord),
    keeps: impl Fn(EventKind) -> bool,
) -> PathBuf {
    let mut file = TraceFile::open(trace).expect("a trace");
    let mut info = file.info().run.clone().expect("a run");
    let machine = file.attachment(&info.machine_file_name).expect("readable");
    info.machine_file = String::from_utf8(machine.expect("there")).expect("UTF-8");
    let output = trace.with_file_name(format!("{name}.mcap"));
    let mut recorder = Recorder::create(&output, &info).expect("a recorder");
    let names: Vec<String> = file
        .info()
        .attachments
        .iter()
        .map(|(name, _)| name.clone())
        .collect();
    for name in names.iter().filter(|name| name.starts_with("job-")) {
        let text = file.attachment(name).expect("readable").expect("there");
        recorder.attach_text(name, 0, &text).expect("room");
    }
    let messages: Vec<_> = file
        .messages()
        .map(|message| message.expect("a message"))
        .collect();
    for message in messages {
        match message {
            TraceMessage::Cycle(mut cycle) => {
                change(&mut cycle);
                recorder.cycle(&cycle).expect("room");
            }
            TraceMessage::Event(event) if keeps(event.kind) => recorder.event(&event).expect("room"),
            _ => {}
        }
    }
    recorder.finish(&std::collections::BTreeMap::new()).expect("room");
    output
}

fn is_the_same(verified: &Verified) -> bool {
    verified.holds() && !verified.lacks_data() && verified.compared == verified.cycles
}

#[test]
fn every_job_is_recomputed_and_one_wrong_bit_is_found() {
    unless_disturbed(|| {
        for cycles in ["messages", "columns"] {
            let workshop = Workshop::new();
            let trace = session(&workshop, cycles);
            // Only the trace is needed.
            std::fs::remove_dir_all(workshop.path("library")).expect("a folder");
            std::fs::remove_file(workshop.path("part.ngc")).expect("a file");
            let mut file = TraceFile::open(&trace).expect("a trace");
            let names: Vec<String> = file
                .info()
                .attachments
                .iter()
                .map(|(name, _)| name.clone())
                .collect();
            let has = |end: &str| names.iter().filter(|name| name.ends_with(end)).count();
            assert_eq!(
                (
                    has("/part.ngc"),
                    has("mdi.ngc"),
                    has("subroutines/there_and_back.ngc")
                ),
                (1, 5, 2),
                "{names:?}"
            );
            let jobs: Vec<_> = file
                .events()
                .map(|event| event.expect("an event"))
                .filter(|event| event.kind == EventKind::Job)
                .collect();
            let page = workshop.path("page.html");
            write_report(&trace, &page).expect("a page");
            let page = std::fs::read_to_string(&page).expect("the page");
            assert!(
                page.contains("Emergency stop was pressed once"),
                "the verdict tells of it"
            );
            // Texts come from the blocks: there is no single program. Its fifth line belongs to no other.
            assert!(
                page.contains(r#""text":"G1 X-20 Y10""#),
                "lines without their text: {}",
                page.split("\"slowest\":").nth(1).unwrap_or_default()
            );
            let verified = verify(&trace).expect("a readable trace");
            println!("{verified:?}");
            if !came_in_time(&trace) {
                assert!(
                    verified.holds() || !verified.explanations.is_empty(),
                    "{verified:?}"
                );
                continue;
            }
            assert!(is_the_same(&verified), "{verified:#?}");
            assert_eq!(verified.jobs as usize, jobs.len());
            assert!(
                verified
                    .max_path_error_mm
                    .is_some_and(|max| max > 0.0 && max <= 0.021)
            );
            // During homing, a jog, MDI and the program.
            let all: Vec<CycleRecord> = file.cycles().map(|cycle| cycle.expect("a cycle")).collect();
            let moving = |cycle: &&CycleRecord| cycle.feed_mm_s > 5.0;
            let kinds = [inputs::STEERS, inputs::FOLLOWS];
            for (n, kind) in kinds.into_iter().enumerate() {
                let of_kind: Vec<&CycleRecord> = all
                    .iter()
                    .filter(moving)
                    .filter(|cycle| cycle.inputs & kind != 0)
                    .collect();
                let victim = of_kind[of_kind.len() / 3].sequence;
                let copy = altered(&trace, &format!("bit-{n}"), |cycle| {
                    if cycle.sequence == victim {
                        cycle.velocity[0] = f64::from_bits(cycle.velocity[0].to_bits() ^ 1);
                    }
                });
                let verified = verify(&copy).expect("a readable trace");
                let first = verified.first_difference.as_ref().expect("a difference");
                assert_eq!(
                    (verified.differing, first.sequence, first.quantity.as_str()),
                    (1, victim, "velocity X")
                );
            }
            // A point at which the machine was at rest.
            let at_rest = all
                .iter()
                .rev()
                .find(|cycle| cycle.inputs & (inputs::STEERS | inputs::FOLLOWS | inputs::RELOCATED) == 0)
                .expect("a cycle at rest")
                .sequence;
            let copy = altered(&trace, "moved", |cycle| {
                if cycle.sequence == at_rest {
                    cycle.position[1] += 1e-9;
                }
            });
            let verified = verify(&copy).expect("a readable trace");
            assert!(verified.differing >= 1, "{verified:?}");
        }
    });
}

#[test]
fn subroutine_folders_are_not_needed_to_recompute() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let machine = workshop.mill("sub-mill", &[]);
        let folder = workshop.path("library");
        std::fs::create_dir_all(&folder).expect("a folder");
        std::fs::write(folder.join("there_and_back.ngc"), SUBROUTINE).expect("a file");
        let program = workshop.write("part.ngc", PROGRAM);
        let trace = workshop.path("run.mcap");
        let folder_name = folder.to_str().expect("UTF-8");
        evolvent_tests::Launch::in_virtual_time(&program, &machine)
            .with(&["--subroutines", folder_name])
            .trace(&trace)
            .finish()
            .expect_code(&[0]);
        std::fs::remove_dir_all(&folder).expect("a folder");
        let verified = verify(&trace).expect("a readable trace");
        assert!(is_the_same(&verified), "{verified:?}");
        assert!(verified.max_path_error_mm.is_some(), "the path was checked too");
    });
}

/// Thousands of dwells of zero time fill the queue of the plan, so that the planner cannot read far ahead of
/// the machine.
fn read_bit_by_bit() -> String {
    let mut text = "G21 G90 G64 P0.02 F6000\nG1 X0 Y0 Z0\n".to_owned();
    for round in 0..50 {
        text += &format!(
            "G1 X{}\n/G1 Y{}\nG0 X3 Y3\nM1\nG1 X0 Y0\n",
            1 + round % 3,
            1 + round % 4
        );
        text += &format!("o{round} repeat [3000]\nG4 P0\no{round} endrepeat\n");
    }
    text + "M2\n"
}

#[test]
fn switches_during_a_program_recompute_by_line() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let (domain, name) = (Domain::new(), "sv-switch");
        let machine = workshop.mill(name, &[]);
        let program = workshop.write("bits.ngc", read_bit_by_bit());
        let trace = workshop.path("switched.mcap");
        let options = ["--trace", trace.to_str().expect("UTF-8")];
        let served = Served::start(&machine, name, &domain, &workshop.path("state"), &options);
        let mut operator = Operator::join(name, &domain);
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let job = operator.says("STEP").job;
        let number = |name: &str, index| ControlRequest {
            index,
            ..command(name)
        };
        let rapid = |amount| ControlRequest {
            amount,
            ..command("RAPID_OVERRIDE")
        };
        let mut switches = std::collections::VecDeque::from([
            (20, number("SINGLE_STEP", 0)),
            (40, number("BLOCK_DELETE", 1)),
            (60, rapid(0.3)),
            (90, number("OPTIONAL_STOP", 1)),
            (150, number("BLOCK_DELETE", 0)),
            (200, number("OPTIONAL_STOP", 0)),
            (250, rapid(0.8)),
        ]);
        let program_stop = 7;
        loop {
            let next = switches.front().map_or(u32::MAX, |(line, _)| *line);
            let at = operator.waits("a stop, a line or the end", |status| {
                status.job_result != 0 || status.line >= next || status.state == program_stop
            });
            if at.job_result != 0 {
                assert_eq!(at.job_result, DONE, "line {}: {}", at.line, at.alarm_sentence());
                break;
            }
            if at.line >= next {
                let (_, request) = switches.pop_front().expect("a switch");
                operator.does(&request);
                // Two changes that the planner sees at once count as one.
                operator.now();
                operator.now();
            } else {
                // It may continue on its own, if single step was switched off.
                operator.request(&command("RESUME"));
                std::thread::sleep(Duration::from_millis(5));
            }
        }
        operator.sees_end(job);
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let mut file = TraceFile::open(&trace).expect("a trace");
        let switched = file
            .events()
            .map(|event| event.expect("an event"))
            .filter(|event| event.kind == EventKind::Switched)
            .inspect(|event| println!("{} {}", event.sequence, event.text))
            .count();
        // The planner is about 80 lines ahead: each change counts separately.
        assert!(switches.is_empty() && switched == 7, "{switched}");
        let verified = verify(&trace).expect("a readable trace");
        if !came_in_time(&trace) {
            return;
        }
        assert!(is_the_same(&verified), "{verified:#?}");
        assert!(verified.max_path_error_mm.is_some(), "the path was checked too");
        let unknown = copied(&trace, "unknown", |_| {}, |kind| kind != EventKind::Switched);
        let verified = verify(&unknown).expect("a readable trace");
        assert!(verified.differing > 0, "{verified:?}");
    });
}

/// Earlier blocks have set so many parameters that the text of a block exceeds 64 KiB.
#[test]
fn a_block_after_thousands_of_parameters_is_recorded() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let mill = std::fs::read_to_string(workshop.mill("sv-many", &[])).expect("a machine file");
        let machine = workshop.write(
            "sv-many.toml",
            format!("{mill}\n[program]\nsubroutines = [\".\"]\n"),
        );
        // 116 kB of parameters, none of which can be written with fewer digits.
        let _file = workshop.write(
            "fill.ngc",
            "o<fill> sub\n#100 = 100\no<each> while [#100 LT 4990]\n#100 = [#100 + 1]\n\
             #[#100] = [#100 / 7 + 0.123456789]\no<each> endwhile\no<fill> endsub\n",
        );
        let trace = workshop.path("sv-many.mcap");
        let options = ["--trace", trace.to_str().expect("UTF-8")];
        let served = Served::start(&machine, "sv-many", &domain, &workshop.path("state"), &options);
        let mut operator = Operator::join("sv-many", &domain);
        operator.brings_up();
        operator.says_number("MODE", 2);
        for text in ["o<fill> call", "G0 X[-#4500 / 100] Y[-#101 / 10]"] {
            let job = operator.says_text("MDI", text).job;
            assert_eq!(operator.sees_end(job).job_result, DONE, "{text}");
        }
        let at = operator.now().position_machine;
        let expected = [4500.0, 101.0].map(|number: f64| number / 7.0 + 0.123_456_789);
        assert!(
            (at[0] + expected[0] / 100.0).abs() < 1e-9 && (at[1] + expected[1] / 10.0).abs() < 1e-9,
            "{at:?}"
        );
        // Rejected at once, as after few parameters.
        let mut beyond = command("MDI");
        assert!(beyond.set_text("G0 X[-#4500 * 100]"));
        let answer = operator.request(&beyond);
        assert_eq!((answer.verdict, answer.alarm), (1, 919), "{}", answer.text());
        drop(operator);
        served.end().expect_code(&[0, 3]);
        if came_in_time(&trace) {
            let verified = verify(&trace).expect("a trace");
            assert!(verified.holds() && !verified.lacks_data(), "{verified:?}");
        }
    });
}
