//! A served machine with simulated drives that fail, over the real bus and in real time. Every kind of fault,
//! at random moments, ends at rest with the alarm that names it. `evolvent-bridge-sim` tests each kind at 50
//! random moments in simulated time.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::sync::Mutex;
use std::time::Instant;

use evolvent_replay::verify;
use evolvent_tests::job_result::FAULT;
use evolvent_tests::{Domain, Drives, Operator, Random, Served, Workshop, command, unless_disturbed};

/// Number of concurrent machines.
const AT_ONCE: usize = 2;

/// Kinds of faults, the axis if the fault has one, and the alarms that may name it.
const KINDS: [(&str, &str, &[u32]); 9] = [
    ("late", "", &[401]),
    ("silent", "", &[401]),
    ("frozen", "", &[402]),
    // The first of the two depends on the speed of the axis.
    ("stuck", ":X", &[403, 410]),
    ("fault", ":Y", &[406]),
    ("off", ":X", &[407]),
    ("jump", ":X", &[409]),
    ("blocked", ":X", &[410, 403]),
    ("nan", ":X", &[404]),
];

/// An output that the program switches on and a fault switches off.
const LAMP: &str = "
[[output]]
name = \"lamp\"
number = 1
";

/// One fault, this number of seconds after the drives became operational, during a motion of both axes.
/// Returns what was observed.
fn fails(number: usize, kind: &str, axis: &str, moment: f64, expected: &[u32]) -> String {
    let (domain, workshop) = (Domain::new(), Workshop::new());
    let name = format!("df{number}-{kind}");
    // For busy machines feedback may be old, and setpoints are sent long before they are due. Feedback that
    // is 100 ms late must still be too old.
    let timeout = if kind == "late" { 60 } else { 400 };
    let file = workshop.mill(
        &name,
        &[
            ("# lead_ms = 2 ", "lead_cycles = 60 # "),
            (
                "feedback_timeout_ms = 20 ",
                &format!("feedback_timeout_ms = {timeout} "),
            ),
        ],
    );
    let text = std::fs::read_to_string(&file).expect("a machine file");
    let file = workshop.write("machine.toml", text + LAMP);
    let trace = workshop.path("session.mcap");
    let trace_option = trace.display().to_string();
    let options = ["--rate", "500", "--trace", &trace_option];
    let served = Served::start(&file, &name, &domain, &workshop.path("state"), &options);
    let fault = format!("{kind}@{moment:.3}{axis}");
    let options = ["--bridge-cycles", "50", "--fault", &fault];
    let drives = Drives::start(&file, &domain, &options);
    let mut operator = Operator::join(&name, &domain);
    operator.waits("drives", |status| status.feedback_age_ns < 1_000_000_000);
    operator.brings_up();
    let on = Instant::now();
    operator.says_number("MODE", 2);
    let job = operator.says_text("MDI", "M64 P1 G1 X200 Y100 F2400").job;
    let status = operator.waits(&fault, |status| status.alarm_count > 0);
    let after = on.elapsed().as_secs_f64();
    assert!(
        expected.contains(&status.listed_alarms()[0]),
        "{fault}: {} {}",
        status.listed_alarms()[0],
        status.alarm_sentence()
    );
    assert!(after > moment - 0.3, "{fault}: alarm after {after:.2} s");
    assert_eq!(operator.sees_end(job).job_result, FAULT, "{fault}");
    operator.waits("rest without power", |status| {
        status.velocity == [0.0; 9] && status.power == 0 && status.machine_state == 1
    });
    // The alarm stays until it is cleared, and nothing moves before.
    assert_eq!(operator.request(&command("ON")).alarm, 918, "{fault}");
    drop((operator, drives));
    served.end().expect_code(&[0, 3]);
    // The lamp goes off in the cycle that finds the fault.
    let again = verify(&trace).expect("a readable trace");
    assert!(again.missing > 0 || again.holds(), "{fault}: {again:?}");
    format!("{fault}: alarm {} after {after:.2} s", status.listed_alarms()[0])
}

#[test]
fn a_drive_failure_stops_with_the_alarm_of_its_fault() {
    let moments: usize = std::env::var("EVOLVENT_CASES")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(1);
    let mut random = Random::new();
    let mut trials = Vec::new();
    for (kind, axis, expected) in KINDS {
        for _ in 0..moments {
            // While both axes move: the motion takes 5.6 s, and begins when the machine is on.
            trials.push((trials.len(), kind, axis, random.between(1.0, 4.5), expected));
        }
    }
    let (count, trials) = (trials.len(), Mutex::new(trials));
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                loop {
                    let next = trials.lock().expect("no panic").pop();
                    let Some((number, kind, axis, moment, expected)) = next else {
                        break;
                    };
                    let summary = unless_disturbed(|| fails(number, kind, axis, moment, expected));
                    println!("{summary}");
                }
            });
        }
    });
    println!("{count} faults: the right alarm, at rest, without power");
}
