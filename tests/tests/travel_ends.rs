//! Homing and jogs at the ends of the travel, and on axes whose zero is unknown, are recomputed from their
//! trace.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::{Path, PathBuf};
use std::time::Duration;

use evolvent_bus::ControlRequest;
use evolvent_replay::verify;
use evolvent_tests::{Domain, Drives, HOMING, Operator, Served, Workshop, command, unless_disturbed};
use evolvent_trace::{Recorder, RunInfo, TraceFile};

fn jog(axis: usize, distance: Option<f64>, speed: f64) -> ControlRequest {
    let mut request = ControlRequest {
        axes_mask: 1 << axis,
        index: u32::from(distance.is_some()),
        amount: speed,
        ..command("JOG")
    };
    request.values[axis] = distance.unwrap_or(1.0);
    request
}

/// Jogs beyond the travel before homing, homing with a switch at the end of the travel, and stops on the last
/// millimetres.
fn session(workshop: &Workshop, lead: u32) -> PathBuf {
    let domain = Domain::new();
    let name = format!("ends-{lead}");
    let shipped = workshop.mill(&name, &[]);
    let text = std::fs::read_to_string(shipped).expect("a machine file");
    let homing = HOMING.replace("switch_mm = -384", "switch_mm = -399.5");
    let text = text
        .replace("# lead_ms = 2 ", &format!("lead_cycles = {lead} # "))
        .replace("feedback_timeout_ms = 20", "feedback_timeout_ms = 1000");
    let machine = workshop.write(&format!("{name}.toml"), format!("{text}\n{homing}"));
    let trace = workshop.path(&format!("{name}.mcap"));
    let options = ["--trace", trace.to_str().expect("UTF-8")];
    let served = Served::start(&machine, &name, &domain, &workshop.path("state"), &options);
    let drives = Drives::start(&machine, &domain, &["--reference-offset", "3.5"]);
    let mut operator = Operator::join(&name, &domain);
    operator.waits("drives", |status| status.feedback_age_ns < 1_000_000_000);
    operator.brings_up();
    operator.says_number("MODE", 1);
    // X is not homed: it may move by the length of its travel in either direction, here onto the limit switch
    // beyond its end.
    let job = operator.does(&jog(0, Some(450.0), 400.0)).job;
    let status = operator.sees_end(job);
    assert_eq!(status.listed_alarms(), [411], "{}", status.alarm_sentence());
    operator.waits("no power", |status| status.power == 0);
    operator.says("CLEAR_ALARMS");
    operator.says("ON");
    operator.waits("power", |status| status.machine_state == 2);
    let job = operator.does(&jog(0, Some(-430.0), 400.0)).job;
    operator.sees_end(job);
    let job = operator.says("HOME").job;
    operator.sees_end(job);
    // Towards the end of the travel, and stopped where the motion already slows down for it.
    for distance in [246.4, -20.0, 19.0] {
        let job = operator.does(&jog(1, Some(distance), 300.0)).job;
        operator.sees_end(job);
    }
    operator.does(&jog(1, Some(1.0), 20.0));
    std::thread::sleep(Duration::from_millis(60));
    operator.says("JOG_STOP");
    operator.waits("rest", |status| status.activity == 0);
    operator.does(&jog(1, None, 30.0));
    std::thread::sleep(Duration::from_millis(40));
    operator.waits("rest", |status| status.activity == 0);
    operator.says_number("MODE", 1);
    drop(operator);
    drop(drives);
    served.end().expect_code(&[0, 3]);
    trace
}

#[test]
fn jogs_and_homing_at_the_ends_of_the_travel_verify() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        for lead in [2, 4] {
            let trace = session(&workshop, lead);
            let verified = verify(&trace).expect("a trace");
            assert!(verified.holds(), "lead {lead}: {verified:?}");
            assert_eq!(verified.uncompared, 0, "lead {lead}: {:?}", verified.notes);
            assert!(verified.jobs > 8, "{}", verified.jobs);
        }
    });
}

#[test]
fn a_trace_without_cycles_is_not_the_same_as_anything() {
    let workshop = Workshop::new();
    let trace = session_of_nothing(&workshop.path("empty.mcap"), &workshop);
    let verified = verify(&trace).expect("a trace");
    assert_eq!((verified.cycles, verified.compared), (0, 0));
    assert!(verified.lacks_data());
    let finished =
        evolvent_tests::run(["trace".as_ref(), "verify".as_ref(), trace.as_os_str()]).expect_code(&[3]);
    assert!(!finished.out.contains("the same"), "{}", finished.out);
    assert!(finished.out.contains("nothing was compared"), "{}", finished.out);
}

/// A session whose cycles were all lost: the description of another trace without contents.
fn session_of_nothing(path: &Path, workshop: &Workshop) -> PathBuf {
    let machine = workshop.mill("nothing", &[]);
    let recorded = workshop.path("recorded.mcap");
    evolvent_tests::Launch::in_virtual_time(&workshop.short_program(), &machine)
        .trace(&recorded)
        .finish()
        .expect_code(&[0]);
    let mut file = TraceFile::open(&recorded).expect("a trace");
    let mut run: RunInfo = file.info().run.clone().expect("a run");
    run.machine_file = String::from_utf8(
        file.attachment(&run.machine_file_name)
            .expect("readable")
            .expect("a machine file"),
    )
    .expect("UTF-8");
    Recorder::create(path, &run)
        .and_then(|recorder| recorder.finish(&std::collections::BTreeMap::new()))
        .expect("a trace")
}
