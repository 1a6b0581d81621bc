//! A machine with backlash, screw errors and axes that are not square: the setpoints of its drives keep the
//! limits, bring the tool to its programmed position, and are recomputed bit for bit.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use evolvent_bus::ControlRequest;
use evolvent_replay::verify;
use evolvent_tests::job_result::DONE;
use evolvent_tests::{
    Cycle, Domain, Drives, HOMING, Launch, Operator, Served, Workshop, command, cycles, unless_disturbed,
};

/// Lost motion of X, Y and Z, mm.
const PLAY: [f64; 3] = [0.02, 0.03, 0.012];
/// Drift of X per mm of Y.
const XY: f64 = 150e-6;
/// Limits of the test mill: velocity, acceleration, jerk of X, Y and Z.
const LIMITS: [[f64; 3]; 3] = [
    [500.0, 5000.0, 200_000.0],
    [500.0, 5000.0, 200_000.0],
    [20_000.0 / 60.0, 3000.0, 100_000.0],
];

/// Deviation of a slide from the nominal position of its screw, mm.
fn screw_error(axis: usize, position: f64) -> f64 {
    match axis {
        0 => 0.0,
        1 => 0.006 * (position / 40.0).sin() + 0.000_03 * position,
        _ => 0.004 * (position / 30.0).cos() - 0.000_05 * position,
    }
}

/// A nut with play on each screw, and an X axis that is not square to Y.
struct Plant {
    slides: [f64; 3],
}

impl Plant {
    fn drive(&mut self, motors: &[f64]) -> [f64; 3] {
        let mut tool = [0.0; 3];
        for axis in 0..3 {
            let (low, high) = (motors[axis] - 0.5 * PLAY[axis], motors[axis] + 0.5 * PLAY[axis]);
            self.slides[axis] = self.slides[axis].clamp(low, high);
            tool[axis] = self.slides[axis] + screw_error(axis, self.slides[axis]);
        }
        tool[0] += XY * tool[1];
        tool
    }
}

/// Gauge readings at `position`: the error in either direction, um.
fn measured(axis: usize, position: f64) -> [f64; 2] {
    [-0.5, 0.5].map(|side| {
        let slide = position + side * PLAY[axis];
        1000.0 * (slide + screw_error(axis, slide) - position)
    })
}

/// The test mill with these errors: backlash on X, a CSV table of both directions on Y, a LinuxCNC table on
/// Z.
fn machine(workshop: &Workshop, name: &str, more: &str) -> PathBuf {
    let shipped = workshop.mill(name, &[]);
    let mut text = std::fs::read_to_string(shipped).expect("a machine file");
    let mut csv = String::from("# laser, 21 degrees\nposition_mm, forward_error_um, reverse_error_um\n");
    let mut comp = String::new();
    for step in -26..=26 {
        let position = 10.0 * f64::from(step);
        let [forward, reverse] = measured(1, position);
        let _ = writeln!(csv, "{position}, {forward:.6}, {reverse:.6}");
        let [forward, reverse] = measured(2, position).map(|error| position + 1e-3 * error);
        let _ = writeln!(comp, "{position} {forward:.9} {reverse:.9}");
    }
    let _file = workshop.write("y.csv", csv);
    let _file = workshop.write("z.comp", comp);
    for (letter, keys) in [
        ("X", "backlash_mm = 0.02"),
        ("Y", "screw_table = \"y.csv\""),
        (
            "Z",
            "screw_table = \"z.comp\"\nscrew_table_format = \"linuxcnc-0\"",
        ),
    ] {
        let head = format!("letter = \"{letter}\"");
        assert!(text.contains(&head), "the mill has changed");
        text = text.replacen(&head, &format!("{keys}\n{head}"), 1);
    }
    text = text.replace("feedback_timeout_ms = 20", "feedback_timeout_ms = 1000");
    let _ = write!(text, "\n[squareness]\nxy_um_m = 150\n{more}");
    workshop.write(&format!("{name}.toml"), text)
}

const PROGRAM: &str = "\
G17 G21 G90 G94 G64 P0.02 F4000
G0 X5 Y5 Z5
G0 X30 Y0 Z-20
G2 X30 Y0 I-30 J0
G3 X30 Y0 I-30 J0 F9000
G0 X-90 Y80 Z-60
G18 G2 X-90 Z-60 I20 K0 F3000
G17 G1 X0 Y-80 F20000
X1 Y-79.9
X0 Y-80
X1 Y-79.9 Z-60.05
X0 Y-80 Z-60
X80 Y80 Z10
M2
";

/// Maximum fractions of velocity, acceleration and jerk limits in the third differences of these positions,
/// by axis.
fn limit_fractions(positions: &[[f64; 3]], period_s: f64) -> [[f64; 3]; 3] {
    let mut max = [[0.0_f64; 3]; 3];
    for four in positions.windows(4) {
        for axis in 0..3 {
            let p = [3, 2, 1, 0].map(|index: usize| four[index][axis]);
            let found = [
                (p[0] - p[1]) / period_s,
                (p[0] - 2.0 * p[1] + p[2]) / period_s.powi(2),
                (p[0] - 3.0 * p[1] + 3.0 * p[2] - p[3]) / period_s.powi(3),
            ];
            for order in 0..3 {
                max[axis][order] = max[axis][order].max(found[order].abs() / LIMITS[axis][order]);
            }
        }
    }
    max
}

fn first_three(position: &[f64]) -> [f64; 3] {
    [position[0], position[1], position[2]]
}

/// When an axis has certainly taken up its play: it has moved this far in one direction, for this many
/// cycles.
struct Settled {
    turned_at: f64,
    last: f64,
    sign: f64,
    cycles: u32,
}

impl Settled {
    fn update(&mut self, position: f64, needed: u32) -> bool {
        let step = position - self.last;
        self.last = position;
        if step * self.sign < 0.0 || self.sign == 0.0 {
            (self.turned_at, self.sign, self.cycles) = (position, step.signum(), 0);
        }
        if step == 0.0 && self.cycles == 0 {
            self.sign = 0.0;
        }
        self.cycles += 1;
        self.cycles > needed && (position - self.turned_at).abs() > 0.2
    }
}

/// Drives the plant. Returns the maximum distance of the tool from the ideal position where the play is
/// certainly taken up, and anywhere.
fn follow(cycles: &[Cycle], period_s: f64, is_corrected: bool) -> [f64; 2] {
    let mut plant = Plant { slides: [0.0; 3] };
    let mut settled = [0, 1, 2].map(|_| Settled {
        turned_at: 0.0,
        last: 0.0,
        sign: 0.0,
        cycles: 0,
    });
    let needed = (0.12 / period_s) as u32;
    let (mut max, mut count) = ([0.0_f64; 2], 0);
    for cycle in cycles {
        let sent = if is_corrected {
            &cycle.drive_position
        } else {
            &cycle.position
        };
        let tool = plant.drive(&first_three(sent));
        for axis in 0..3 {
            let off = (tool[axis] - cycle.position[axis]).abs();
            if settled[axis].update(cycle.position[axis], needed) {
                max[0] = max[0].max(off);
                count += 1;
            }
            max[1] = max[1].max(off);
        }
    }
    assert!(count > 1000, "only {count} positions far from reversals");
    max
}

fn period_s(cycles: &[Cycle]) -> f64 {
    (cycles[1].due_time_ns - cycles[0].due_time_ns) as f64 * 1e-9
}

fn run(workshop: &Workshop, machine: &Path, planner: &str) -> PathBuf {
    let program = workshop.write("circles.ngc", PROGRAM);
    let trace = workshop.path(&format!("{planner}.mcap"));
    Launch::in_virtual_time(&program, machine)
        .with(&["--planner", planner])
        .trace(&trace)
        .finish()
        .expect_code(&[0]);
    trace
}

#[test]
fn corrected_setpoints_keep_limits_and_tool_position() {
    let workshop = Workshop::new();
    let machine = machine(&workshop, "corrected", "");
    for planner in ["optimal", "classic"] {
        let trace = run(&workshop, &machine, planner);
        let cycles = cycles(&trace);
        let period_s = period_s(&cycles);
        let sent: Vec<_> = cycles
            .iter()
            .map(|cycle| first_three(&cycle.drive_position))
            .collect();
        let ideal: Vec<_> = cycles.iter().map(|cycle| first_three(&cycle.position)).collect();
        let (of_sent, of_ideal) = (
            limit_fractions(&sent, period_s),
            limit_fractions(&ideal, period_s),
        );
        println!("{planner}: sent {of_sent:?}, ideal {of_ideal:?}");
        for axis in 0..3 {
            for (order, allowed) in [1.001, 1.001, 1.02].into_iter().enumerate() {
                let fraction = of_sent[axis][order];
                assert!(
                    fraction <= allowed,
                    "{planner}, axis {axis}, order {order}: {fraction}"
                );
                // The reserve is used.
                assert!(
                    of_ideal[axis][order] < 1.0,
                    "{planner}, axis {axis}, order {order}"
                );
            }
        }
        if planner == "optimal" {
            assert!(of_sent[0][1] > 0.9, "hardly any limit is reached: {of_sent:?}");
        }
        let [away, anywhere] = follow(&cycles, period_s, true);
        let [uncorrected, _] = follow(&cycles, period_s, false);
        println!(
            "{planner}: off by {away} mm, while play is taken up {anywhere} mm, uncorrected {uncorrected} mm"
        );
        assert!(away < 2e-4, "{planner}: {away} mm");
        // While the motor moves through the play, the slide is at rest.
        assert!(anywhere < 0.032, "{planner}: {anywhere} mm");
        assert!(uncorrected > 0.018, "{planner}: {uncorrected} mm");
        let verified = verify(&trace).expect("a readable trace");
        assert!(
            verified.holds() && !verified.lacks_data(),
            "{planner}: {verified:?}"
        );
    }
}

#[test]
fn a_machine_without_errors_is_sent_what_is_planned() {
    let workshop = Workshop::new();
    let trace = run(&workshop, &workshop.mill("plain", &[]), "optimal");
    for cycle in cycles(&trace) {
        assert!(cycle.drive_position.iter().all(|position| position.is_nan()));
    }
}

/// An input script that warms the machine up, checked against limits and bits.
#[test]
fn thermal_growth_is_followed_and_recomputed() {
    let workshop = Workshop::new();
    let more = "[[input]]\nname = \"growth\"\nnumber = 2\nkind = \"analog\"\n";
    let machine = machine(&workshop, "warm", more);
    let text = std::fs::read_to_string(&machine).expect("the machine file");
    let text = text.replacen(
        "backlash_mm = 0.02",
        "thermal_input = \"growth\"\nthermal_rate_um_s = 20\nthermal_max_mm = 0.05",
        1,
    );
    let machine = workshop.write("warm.toml", text);
    let program = workshop.write("wait.ngc", "G21 G90 F3000\nG1 X10\nG4 P2\nG1 X20\nG4 P2\nM2\n");
    let script = workshop.write(
        "inputs.toml",
        "[[change]]\ninput = \"growth\"\nvalue = 0.03\nat_s = 0.5\n",
    );
    let trace = workshop.path("warm.mcap");
    Launch::in_virtual_time(&program, &machine)
        .with(&["--inputs", script.to_str().expect("UTF-8")])
        .trace(&trace)
        .finish()
        .expect_code(&[0]);
    let cycles = cycles(&trace);
    let period_s = period_s(&cycles);
    let shift: Vec<f64> = cycles
        .iter()
        .map(|cycle| cycle.drive_position[0] - cycle.position[0] + XY * cycle.position[1])
        .collect();
    let last = shift[shift.len() - 1];
    assert!((last - 0.03).abs() < 1e-6, "{last}");
    let fastest = shift
        .windows(2)
        .map(|two| (two[1] - two[0]).abs() / period_s)
        .fold(0.0, f64::max);
    assert!(fastest < 0.02 * 1.001 && fastest > 0.019, "{fastest} mm/s");
    let verified = verify(&trace).expect("a readable trace");
    assert!(verified.holds() && !verified.lacks_data(), "{verified:?}");
}

#[test]
fn a_served_corrected_machine_is_recomputed() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = machine(&workshop, "sv-corr", HOMING);
        let trace = workshop.path("served.mcap");
        let options = ["--trace", trace.to_str().expect("UTF-8")];
        let served = Served::start(&machine, "sv-corr", &domain, &workshop.path("state"), &options);
        let drives = Drives::start(&machine, &domain, &["--reference-offset", "3.5"]);
        let mut operator = Operator::join("sv-corr", &domain);
        operator.waits("drives", |status| status.feedback_age_ns < 1_000_000_000);
        operator.brings_up();
        let status = operator.homes();
        assert_eq!(
            (status.job_result, status.homed_mask),
            (DONE, 0b111),
            "{}",
            status.alarm_sentence()
        );
        let mut jog = ControlRequest {
            axes_mask: 2,
            index: 1,
            amount: 40.0,
            ..command("JOG")
        };
        for distance in [20.0, -12.0] {
            jog.values[1] = distance;
            let job = operator.does(&jog).job;
            assert_eq!(operator.sees_end(job).job_result, DONE);
        }
        operator.says_number("MODE", 2);
        for text in ["G0 X20 Y60 Z-30", "G2 X20 Y60 I-15 F5000", "G0 X-5 Y-50 Z-10"] {
            let job = operator.says_text("MDI", text).job;
            assert_eq!(operator.sees_end(job).job_result, DONE, "{text}");
        }
        // The table of Y corrects by about 5 um there, the backlash of X by 10 um: the displayed position is
        // that of the tool.
        let status = operator.waits("drives at rest", |status| {
            (0..3).all(|axis| (status.position_actual[axis] - status.position_machine[axis]).abs() < 0.0021)
        });
        assert_eq!(first_three(&status.position_machine), [-5.0, -50.0, -10.0]);
        assert_eq!(status.alarm_count, 0);
        operator.says("OFF");
        operator.waits("no power", |status| status.power == 0 && status.enabled_mask == 0);
        operator.says("ON");
        let status = operator.waits("power", |status| status.machine_state == 2);
        assert!(
            (status.position_machine[1] + 50.0).abs() < 0.0021,
            "{:?}",
            status.position_machine
        );
        let job = operator.says_text("MDI", "G0 X0 Y0 Z0").job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        drop(operator);
        drop(drives);
        served.end().expect_code(&[0, 3]);
        let cycles = cycles(&trace);
        let corrected = |axis: usize| {
            (cycles.iter())
                .map(|cycle| (cycle.drive_position[axis] - cycle.position[axis]).abs())
                .fold(0.0, f64::max)
        };
        assert!(
            corrected(0) > 0.009 && corrected(1) > 0.014,
            "{} {}",
            corrected(0),
            corrected(1)
        );
        let verified = verify(&trace).expect("a readable trace");
        println!("{verified:?}");
        assert!(verified.holds(), "{verified:?}");
        assert_eq!(verified.uncompared, 0, "{verified:?}");
        assert!(verified.notes.is_empty(), "{verified:?}");
    });
}
