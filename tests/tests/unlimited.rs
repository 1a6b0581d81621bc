//! An unlimited rotary axis: programs, MDI, jogs and homing in closed loop with simulated drives, and a trace
//! that is recomputed.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use evolvent_bus::{ControlRequest, Status};
use evolvent_replay::verify;
use evolvent_tests::{
    Cycle, Domain, Drives, Operator, Random, Served, Workshop, command, cycles, run, unless_disturbed,
};

const C: usize = 5;

/// More than the table turns in a cycle of 1 ms, degrees: the end of a move without a stop is between two
/// setpoints.
const STEP_DEG: f64 = 0.75;

/// A mill with an unlimited rotary table that reaches 720 degrees/s, or a multiple of that: long turns make
/// long traces.
fn table(workshop: &Workshop, name: &str, kind: &str, faster: u32, homing: &str) -> PathBuf {
    let shipped = workshop.mill(name, &[]);
    let text = std::fs::read_to_string(shipped).expect("a machine file");
    let text = text
        .replace("feedback_timeout_ms = 20", "feedback_timeout_ms = 1000")
        .replacen(
            "increments_per_mm",
            "increments_per_degree = 1000\nincrements_per_mm",
            1,
        );
    let axis = format!(
        "[[axis]]\nletter = \"C\"\nunlimited = \"{kind}\"\nmax_velocity_deg_s = {}\n\
         max_acceleration_deg_s2 = {}\nmax_jerk_deg_s3 = {}\nfollowing_error_deg = 2\n",
        720 * faster,
        7200 * faster,
        200_000 * faster
    );
    workshop.write(&format!("{name}.toml"), format!("{text}\n{axis}\n{homing}"))
}

fn path(file: &Path) -> &str {
    file.to_str().expect("UTF-8")
}

/// The cycles of a virtual run, which is recomputed from its trace.
fn virtual_cycles(workshop: &Workshop, machine: &Path, program: &str) -> Vec<Cycle> {
    let file = workshop.write("table.ngc", program);
    let trace = workshop.path("table.mcap");
    run([
        "run",
        path(&file),
        "--machine",
        path(machine),
        "--clock",
        "virtual",
        "--no-bus",
        "--trace",
        path(&trace),
    ])
    .expect_code(&[0]);
    let again = verify(&trace).expect("a readable trace");
    assert!(again.holds(), "{again:?}");
    cycles(&trace)
}

/// Angles of C at the end of each line, in a virtual run.
fn ends(kind: &str, program: &str) -> Vec<f64> {
    let workshop = Workshop::new();
    let machine = table(&workshop, "table", kind, 1, "");
    let mut ends: Vec<f64> = Vec::new();
    let mut line = 0;
    for cycle in virtual_cycles(&workshop, &machine, program) {
        let angle = cycle.position[C];
        if cycle.line == line && !ends.is_empty() {
            *ends.last_mut().expect("one") = angle;
        } else {
            ends.push(angle);
        }
        line = cycle.line;
    }
    ends
}

#[test]
fn g90_takes_the_shorter_way_and_g91_the_full_way() {
    let program = "G61 F36000\nG0 C350\nG1 C10\nG0 C190\nG0 C0\nG91 G1 C725\nG90 G0 C0\nG53 G0 C-90\n\
                   G10 L2 P1 C30\nG0 C0\nM2\n";
    let ends = ends("shorter", program);
    let expected = [-10.0, 10.0, 190.0, 360.0, 1085.0, 1080.0, 990.0, 1110.0];
    assert!(ends.len() >= expected.len(), "{ends:?}");
    for (end, expected) in ends.iter().zip(expected) {
        assert!((end - expected).abs() < STEP_DEG, "{ends:?}");
    }
}

#[test]
fn the_sign_gives_the_direction_and_full_turns_fail() {
    let program = "G61\nG0 C350\nG0 C10\nG0 C-350\nG0 C-0\nG0 C0\nG0 C-90\nG0 C90\nM2\n";
    let ends = ends("sign", program);
    let different: Vec<f64> = ends.iter().copied().fold(Vec::new(), |mut kept, end| {
        if kept.last().is_none_or(|last: &f64| (last - end).abs() > 1e-6) {
            kept.push(end);
        }
        kept
    });
    let different: Vec<f64> = different.into_iter().skip_while(|end| *end == 0.0).collect();
    let expected = [350.0, 370.0, 350.0, 0.0, -270.0];
    assert!(different.len() >= expected.len(), "{different:?}");
    for (end, expected) in different.iter().zip(expected) {
        assert!((end - expected).abs() < STEP_DEG, "{different:?}");
    }
    let workshop = Workshop::new();
    let machine = table(&workshop, "table", "sign", 1, "");
    let file = workshop.write("wrong.ngc", "G0 C10\nG0 C-360\nM2\n");
    let finished = run(["check", path(&file), "--machine", path(&machine), "--json"]);
    let errors = finished.expect_code(&[1]).json();
    assert_eq!(errors["errors"][0]["code"], "G0412", "{errors}");
    assert_eq!(errors["errors"][0]["line"], 2);
}

/// 2775 turns in one program, with limits kept in every sample and the right angle at the end.
#[test]
fn a_long_turn_keeps_its_resolution() {
    let workshop = Workshop::new();
    let machine = table(&workshop, "far", "shorter", 100, "");
    let cycles = virtual_cycles(&workshop, &machine, "G91 G0 C999000\nG90 G0 C123.456\nM2\n");
    let last = cycles.last().expect("cycles").position[C];
    let wrong = (last - 123.456).rem_euclid(360.0);
    assert!(wrong.min(360.0 - wrong) < 1e-6, "{last}");
    let beyond = workshop.write("beyond.ngc", "G91 G0 C1000001\nM2\n");
    run(["check", path(&beyond), "--machine", path(&machine)]).expect_code(&[1]);
}

const HOMING: &str = "
[[homing]]
axis = \"C\"
method = \"switch-index\"
towards = \"positive\"
search_deg_s = 90
latch_deg_s = 20
index_deg = 12.5
index_within_deg = 30
";

fn jog(distance: f64, speed: f64) -> ControlRequest {
    let mut request = ControlRequest {
        axes_mask: 1 << C,
        index: 1,
        amount: speed,
        ..command("JOG")
    };
    request.values[C] = distance;
    request
}

fn near(status: &Status, angle: f64) -> bool {
    (status.position_machine[C] - angle).abs() < 1e-6
}

/// It homes within a turn, turns in one direction by MDI and jogs endlessly, and displays angles. At rest
/// whole turns are removed without motion, and the next block takes the shorter direction.
#[test]
fn a_served_table_turns_without_an_end() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let name = "table-served";
        let machine = table(&workshop, name, "shorter", 5, HOMING);
        let trace = workshop.path("turns.mcap");
        let options = ["--trace", path(&trace)];
        let served = Served::start(&machine, name, &domain, &workshop.path("state"), &options);
        let drives = Drives::start(&machine, &domain, &["--reference-offset", "3.5"]);
        let mut operator = Operator::join(name, &domain);
        operator.waits("drives", |status| status.feedback_age_ns < 1_000_000_000);
        operator.brings_up();
        operator.says_number("MODE", 1);
        let home = ControlRequest {
            axes_mask: 1 << C,
            ..command("HOME")
        };
        let job = operator.does(&home).job;
        let status = operator.sees_end(job);
        assert_eq!(status.job_result, 1, "{}", status.alarm_sentence());
        // The drives give the offsets of the other axes; the pulse has corrected that of C, except for whole
        // turns.
        let wrong = (status.home_offset[C] - 3.5).rem_euclid(360.0);
        assert!(wrong.min(360.0 - wrong) < 1e-2, "{wrong}");
        let mut random = Random::new();
        let mut angle = 0.0_f64;
        for round in 0..4 {
            operator.says_number("MODE", 2);
            let distance = random.between(5000.0, 9000.0).round();
            let job = operator.says_text("MDI", &format!("G91 G0 C{distance}")).job;
            let status = operator.sees_end(job);
            assert_eq!(status.job_result, 1, "{}", status.alarm_sentence());
            angle = (angle + distance).rem_euclid(360.0);
            let status = operator.now();
            assert!(
                near(&status, angle),
                "round {round}: {} {angle}",
                status.position_machine[C]
            );
            operator.says_number("MODE", 1);
            let job = operator.does(&jog(7000.0, 3500.0)).job;
            let status = operator.sees_end(job);
            angle = (angle + 7000.0).rem_euclid(360.0);
            assert!(near(&status, angle), "{} {angle}", status.position_machine[C]);
            operator.says_number("MODE", 2);
            let to = random.between(0.0, 360.0).round();
            let job = operator.says_text("MDI", &format!("G90 G0 C{to}")).job;
            let status = operator.sees_end(job);
            angle = to.rem_euclid(360.0);
            assert!(near(&status, angle), "{}", status.position_machine[C]);
            assert_eq!(status.alarm_count, 0, "{}", status.alarm_sentence());
        }
        // The counts of the drives are higher by the turns that were removed.
        let removed = operator.now().home_offset[C] - status.home_offset[C];
        assert!(removed >= 36_000.0 && removed % 360.0 == 0.0, "{removed}");
        drop(operator);
        drop(drives);
        served.end().expect_code(&[0, 3]);
        let turned = cycles(&trace);
        let farthest = turned
            .iter()
            .map(|cycle| cycle.position[C].abs())
            .fold(0.0, f64::max);
        // Whole turns are removed at each rest beyond 36 000 degrees, and a move turns by 9000 at most.
        assert!(farthest > 36_000.0 && farthest < 45_001.0, "{farthest}");
        let again = verify(&trace).expect("a readable trace");
        assert!(again.holds() && again.uncompared == 0, "{again:?}");
    });
}

/// The next jog comes when whole turns are removed: it begins in the new coordinates.
#[test]
fn a_jog_after_many_turns_starts_at_the_axis_position() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let name = "table-next";
        let machine = table(&workshop, name, "shorter", 20, "");
        // The lowest rate: several commands can arrive before the cycle that removes the turns.
        let text = std::fs::read_to_string(&machine).expect("a machine file");
        let machine = workshop.write(
            &format!("{name}.toml"),
            text.replace("rate = \"rational\"", "rate = 250"),
        );
        let served = Served::start(&machine, name, &domain, &workshop.path("state"), &[]);
        let drives = Drives::start(&machine, &domain, &[]);
        let mut operator = Operator::join(name, &domain);
        operator.waits("drives", |status| status.feedback_age_ns < 1_000_000_000);
        operator.brings_up();
        operator.says_number("MODE", 1);
        for _ in 0..6 {
            operator.does(&jog(60_000.0, 14_400.0));
            // By then it has turned by more than 36 000 degrees.
            std::thread::sleep(Duration::from_secs(3));
            operator.says("JOG_STOP");
            let begin = Instant::now();
            // Rejected while the axis is stopping.
            let job = loop {
                let answer = operator.request(&jog(90.0, 14_400.0));
                if answer.verdict == 0 {
                    break answer.job;
                }
                assert!(begin.elapsed() < Duration::from_secs(20), "{}", answer.text());
            };
            let status = operator.sees_end(job);
            assert_eq!(status.job_result, 1, "{}", status.alarm_sentence());
            assert_eq!(status.alarm_count, 0, "{}", status.alarm_sentence());
        }
        assert!(operator.now().home_offset[C] >= 6.0 * 36_000.0);
        drop(operator);
        drop(drives);
        served.end().expect_code(&[0, 3]);
    });
}
