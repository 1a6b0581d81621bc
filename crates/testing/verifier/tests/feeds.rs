//! Programs in which feeds and tolerances change from block to block, judged from their positions.

#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::f64::consts::TAU;

use evolvent_machine::Limits;
use evolvent_random::Random;
use evolvent_verifier::Allowances;

use crate::rates::trial::{root, setup, trial};

/// Runs a program on a shipped machine and asserts that there is no violation. Returns the duration, s.
fn keeps_everything(machine: &str, text: &str) -> f64 {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("feeds.ngc");
    std::fs::write(&path, text).expect("a file in the temporary folder");
    let machine = root().join("config/machines").join(machine);
    let setup = setup(&machine, None, None).expect("machine");
    let trial = trial(&path, &setup).expect("a run");
    assert_eq!(trial.error, None, "{text}");
    let violations = trial.verdict.violations(&Allowances::default());
    assert!(violations.is_empty(), "{violations:?}\n{text}");
    trial.verdict.duration_s
}

/// Distance and duration of a time-optimal change of speed along one axis, mm and s.
fn change(limits: &Limits, axis: usize, from: f64, to: f64) -> (f64, f64) {
    let (acceleration, jerk) = (limits.acceleration[axis], limits.jerk[axis]);
    let change = (to - from).abs();
    let seconds = if change * jerk <= acceleration * acceleration {
        2.0 * (change / jerk).sqrt()
    } else {
        change / acceleration + acceleration / jerk
    };
    (0.5 * (from + to) * seconds, seconds)
}

/// Along a line the speed changes within the faster block, and as fast as the limits permit.
#[test]
fn a_slow_block_on_a_line_does_not_slow_the_next() {
    let mut random = Random::seeded(0x57EF_0001);
    let name = "mill-3axis.toml";
    let limits = setup(&root().join("config/machines").join(name), None, None)
        .expect("machine")
        .machine
        .limits();
    for _ in 0..evolvent_random::cases(12) {
        let axis = random.below(2);
        let letter = ["X", "Y"][axis];
        let mode = random.one_of(&["G61", "G64 P0.01", "G64 P0.5"]);
        let mut text = format!("G21 G90 {mode}\n");
        let (mut at, mut before, mut shortest, mut slack) = (0.0, 0.0, 0.0, 0.0);
        let mut blocks = 0;
        while blocks < 6 {
            let (length, feed) = (random.log(12.0, 40.0), random.log(30.0, 6000.0));
            if at + length > 150.0 {
                break;
            }
            let speed = (feed / 60.0 * 1e4).round() / 1e4;
            (at, blocks) = (at + length, blocks + 1);
            text.push_str(&format!("G1 {letter}{at:.6} F{:.6}\n", 60.0 * speed));
            let (distance, seconds) = change(&limits, axis, before, speed);
            shortest += length / speed + seconds - distance / speed.max(before);
            (before, slack) = (speed, slack + 0.01 + 0.5 * seconds);
        }
        let (distance, last) = change(&limits, axis, before, 0.0);
        shortest += last - distance / before;
        let seconds = keeps_everything(name, &(text.clone() + "M2\n"));
        // Cost of the intervals: half of the duration, and 10 ms for a short change.
        let max_s = shortest + slack + 0.01 + 0.5 * last;
        assert!(seconds <= max_s, "{seconds} s, shortest {shortest} s\n{text}");
        assert!(
            seconds >= 0.999 * shortest,
            "{seconds} s, shortest {shortest} s\n{text}"
        );
    }
}

/// Moves along lines that continue, turn or reverse, with rapids among feeds of every size.
fn program(random: &mut Random) -> String {
    let tolerance = random.one_of(&[0.01, 0.05, 0.2, 1.0, 5.0]);
    let mut text = format!("G21 G90 G17 G54 G64 P{tolerance}\nF200\n");
    let mut point = [0.0_f64; 3];
    let mut direction = [1.0, 0.0, 0.0];
    for _ in 0..5 + random.below(25) {
        let length = random.log(0.03, 40.0);
        match random.below(10) {
            0..4 => {}
            4 => direction = direction.map(|x| -x),
            _ => {
                let (turn, lift) = (random.between(0.0, TAU), random.between(-1.0, 1.0));
                let flat = (1.0 - lift * lift).sqrt();
                direction = [flat * turn.cos(), flat * turn.sin(), lift];
            }
        }
        let next: [f64; 3] = std::array::from_fn(|i| point[i] + length * direction[i]);
        if next.iter().any(|x| x.abs() > 45.0) {
            direction = direction.map(|x| -x);
            continue;
        }
        point = next;
        let [x, y, z] = point;
        if random.unit() < 0.45 {
            text.push_str(&format!("G0 X{x:.4} Y{y:.4} Z{z:.4}\n"));
        } else {
            let feed = random.one_of(&[60, 200, 600, 2000, 6000]);
            text.push_str(&format!("G1 X{x:.4} Y{y:.4} Z{z:.4} F{feed}\n"));
        }
    }
    text + "M2\n"
}

#[test]
fn feeds_hold_beside_short_rapids() {
    let mut random = Random::seeded(0xF33D_0001);
    for _ in 0..evolvent_random::cases(24) {
        keeps_everything("mill-3axis.toml", &program(&mut random));
    }
}

#[test]
fn rotary_axis_feed_holds_beside_linear_moves() {
    for text in [
        "G64 P0.05\nG1 X40 F5000\nG1 A-20 F300\nG1 X80 F5000\nG1 A-10 F300\nM2\n",
        "G64 P0.01\nG0 X100\nG1 A-20 F300\nG0 Y50\nM2\n",
        "G64 P0.05\nG1 X40 F2000\nG93\nG1 A-20 F2\nM2\n",
    ] {
        keeps_everything("five-axis.toml", text);
    }
}

/// Correct motions whose tolerance changes at a corner, or whose rest is between two setpoints.
#[test]
fn a_change_of_tolerance_is_not_called_a_deviation() {
    for text in [
        "G0 X20\nG64 P0.5\nG1 X19 Y-3 F500\nG1 X20 Y5\nM2\n",
        "G64 P1\nG1 X20 F1000\nG61\nG1 X20.1 Y0.1\nG1 X20.3 Y0.15\nG1 X20.5 Y0.4\nG1 X21 Y0.5\nG1 X30\nM2\n",
        "G61.1\nG0 X10\nG1 X20 F1000\nM2\n",
    ] {
        keeps_everything("mill-3axis.toml", text);
    }
}

/// Arcs with a radius below the tolerance: the path may cross to the returning part of the arc, which is
/// near.
#[test]
fn a_small_arc_may_be_cut_short() {
    for text in [
        "G64 P1\nG0 X25.084 Y20.2497\nG1 Z-1.5778 F600\nG1 X27.2544 Y21.9656 Z0.2193\nG1 X27.1604 Y21.9043\n\
         G2 X28.01119 Y21.1318 I0.77614 J0 F6000\nM2\n",
        "G64 P1\nG0 X1.6552 Y-0.4553 Z-16.1679\nG0 X1.7208 Y-0.5301\nG0 Z-15.3689\n\
         G2 X2.09434 Y0.06635 I0.66298 J0 F600\nG0 Z-14.6353\nG2 X4.01009 Y-0.3932 I1.01299 J0 F60\n\
         G1 X24.1477 Y-30.3457 Z-21.904\nM2\n",
    ] {
        keeps_everything("mill-3axis.toml", text);
    }
}
