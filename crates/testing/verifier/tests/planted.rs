//! Violations of every kind, planted into correct motions, are found, and nothing else.

use evolvent_path::AxisLetter;
use evolvent_random::{Random, seed};
use evolvent_verifier::{Kind, Verdict};

use crate::common::{Motion, PEAKS, axes, judge, kinds, machine, xyz};

const XYZ: &str = "XYZ";

fn found(program: &str, motion: &Motion) -> (Vec<Kind>, Verdict) {
    let verdict = judge(program, motion, &machine(XYZ));
    (kinds(&verdict), verdict)
}

/// A square of 10 mm.
const SQUARE: &str = "G21 G61 G90 F12000\nG1 X10\nG1 Y10\nG1 X0\nG1 Y0\nM2\n";

fn square(rate_hz: f64) -> Motion {
    Motion::new(rate_hz)
        .to(xyz(10.0, 0.0, 0.0), 0.3)
        .to(xyz(10.0, 10.0, 0.0), 0.3)
        .to(xyz(0.0, 10.0, 0.0), 0.3)
        .to(xyz(0.0, 0.0, 0.0), 0.3)
}

/// Lines, arcs and helices in three planes, involutes outwards and inwards.
const CURVES: &str = "G21 G61 G90 F12000
G1 X20
G17 G3 X20 Y20 I0 J10
G2 X20 Y20 Z6 I-5 P3
G18 G3 X20 Z26 I0 K10
G19 G2 Y20 Z36 J0 K5
G17 G0 X0 Y0 Z0
G3.2 X0 Y-9.42477796076938 I-0.5 J0 R0.5
M2
";

fn curves(rate_hz: f64) -> Motion {
    // Polar form of the involute: at roll angle phi, r sqrt(1 + phi^2) from the centre in the direction phi -
    // atan phi.
    let (r, turns) = (0.5, 3.0);
    let last = std::f64::consts::TAU * turns;
    let involute = |x: f64| {
        let phi = last * x.sqrt();
        let (radius, polar) = (r * (1.0 + phi * phi).sqrt(), phi - phi.atan());
        xyz(-r + radius * polar.cos(), radius * polar.sin(), 0.0)
    };
    Motion::new(rate_hz)
        .to(xyz(20.0, 0.0, 0.0), 0.5)
        .turn([0, 1], [20.0, 10.0], 180.0, 0.0, 1.0)
        .turn([0, 1], [15.0, 20.0], -3.0 * 360.0, 6.0, 3.0)
        .turn([2, 0], [16.0, 20.0], 180.0, 0.0, 1.0)
        .turn([1, 2], [20.0, 31.0], -180.0, 0.0, 1.0)
        .to(xyz(0.0, 0.0, 0.0), 0.7)
        .along(4.0, involute)
}

#[test]
fn a_sudden_tight_tolerance_on_a_line_is_no_deviation() {
    // The program position lags by the tolerance, which is many times the tolerance of the exact block after
    // it.
    let program = "G21 G90 G64 P0.02 F12000\nG1 X1\nG61\nG1 X2\nG1 X30\nM2\n";
    let motion = Motion::new(1000.0).to(xyz(30.0, 0.0, 0.0), 1.5);
    let (found, verdict) = found(program, &motion);
    assert!(found.is_empty(), "{found:?} {verdict:?}");
    // A deviation beyond exact mode's tolerance is still found after it.
    let mut off = motion;
    off.setpoints
        .iter_mut()
        .filter(|position| position[0] > 10.0)
        .for_each(|position| position[1] = 1e-3);
    let (found, _) = self::found(program, &off);
    assert!(found.contains(&Kind::Deviation), "{found:?}");
}

#[test]
fn valid_motion_on_every_curve_has_no_fault() {
    for rate_hz in [250.0, 1000.0, 10_000.0, 35_000.0] {
        let (mut kinds, verdict) = found(CURVES, &curves(rate_hz));
        if rate_hz < 300.0 {
            // Chords of 4 ms are 1.9 um off the circle of 5 mm at this speed.
            assert!((verdict.chord.value - 1.89).abs() < 0.01, "{:?}", verdict.chord);
            kinds.retain(|kind| !matches!(kind, Kind::Chord | Kind::Between));
        }
        assert_eq!(kinds, [], "{rate_hz} Hz: {verdict:#?}");
        assert!(verdict.deviation_mm.value < 1e-11, "{:?}", verdict.deviation_mm);
        assert!(verdict.reverse.value < 1e-11, "{:?}", verdict.reverse);
        assert_eq!(verdict.blocks, 7);
        let (kinds, _) = found(SQUARE, &square(rate_hz));
        assert_eq!(kinds, [], "{rate_hz} Hz");
    }
}

#[test]
fn differences_of_a_polynomial_are_its_derivatives() {
    // 25 mm in 0.35 s, compared with the peaks of the polynomial.
    let motion = Motion::new(35_000.0).to(xyz(25.0, 0.0, 0.0), 0.35);
    let seconds = motion.setpoints.len() as f64 * motion.period_ns as f64 * 1e-9;
    let (_, verdict) = found("G21 G61 G0 X25\nM2\n", &motion);
    let expected = [
        25.0 / seconds * PEAKS[0] / 200.0,
        25.0 / (seconds * seconds) * PEAKS[1] / 2000.0,
        25.0 / (seconds * seconds * seconds) * PEAKS[2] / 50_000.0,
    ];
    for (worst, expected) in [verdict.velocity, verdict.acceleration, verdict.jerk]
        .iter()
        .zip(expected)
    {
        assert!(
            (worst.value / expected - 1.0).abs() < 1e-4,
            "{worst:?} for {expected}"
        );
        assert_eq!(worst.axis, 0);
    }
}

#[test]
fn a_velocity_two_thousandths_too_high_is_found() {
    for (excess, expected) in [(1.002, vec![Kind::Velocity]), (0.9995, vec![])] {
        let seconds = PEAKS[0] * 1000.0 / (200.0 * excess);
        let motion = Motion::new(1000.0).to(xyz(0.0, 1000.0, 0.0), seconds);
        let (kinds, verdict) = found("G21 G61 G0 Y1000\nM2\n", &motion);
        assert_eq!(kinds, expected, "{:?}", verdict.velocity);
        assert_eq!(verdict.velocity.axis, 1);
    }
}

#[test]
fn an_acceleration_two_thousandths_too_high_is_found() {
    for (excess, expected) in [(1.003, vec![Kind::Acceleration]), (0.9995, vec![])] {
        let length = 2000.0 * excess * 0.31 * 0.31 / PEAKS[1];
        let motion = Motion::new(10_000.0).to(xyz(0.0, 0.0, length), 0.31);
        let (kinds, verdict) = found(&format!("G21 G61 G0 Z{length:?}\nM2\n"), &motion);
        assert_eq!(kinds, expected, "{:?}", verdict.acceleration);
    }
}

#[test]
fn a_jerk_three_per_cent_too_high_is_found() {
    for (excess, expected) in [(1.03, vec![Kind::Jerk]), (1.01, vec![])] {
        let length = 50_000.0 * excess * 0.001 / PEAKS[2];
        let motion = Motion::new(10_000.0).to(xyz(length, 0.0, 0.0), 0.1);
        let (kinds, verdict) = found(&format!("G21 G61 G0 X{length:?}\nM2\n"), &motion);
        assert_eq!(kinds, expected, "{:?}", verdict.jerk);
    }
}

#[test]
fn a_shift_of_1_um_is_found_at_any_rate() {
    for rate_hz in [250.0, 1000.0, 10_000.0, 35_000.0] {
        let mut motion = square(rate_hz);
        let middle = motion.setpoints.len() / 8;
        motion.setpoints[middle][1] += 0.001;
        let (kinds, verdict) = found(SQUARE, &motion);
        assert!(kinds.contains(&Kind::Deviation), "{rate_hz} Hz: {kinds:?}");
        assert!((verdict.deviation_mm.value - 0.001).abs() < 1e-9);
        assert_eq!(verdict.deviation_mm.setpoint, middle as u64);
        assert_eq!(verdict.deviation_mm.line, 2);
        // Three thousandths of a millimetre over the period's cube: 1.0 of the limit at 250 Hz already.
        assert_eq!(
            kinds.contains(&Kind::Jerk),
            rate_hz > 300.0,
            "{rate_hz} Hz: {kinds:?}"
        );
    }
}

#[test]
fn a_tolerance_exceeded_by_one_per_cent_is_found() {
    let program = "G21 G64 P0.02 G90 F12000\nG1 X50\nG1 X100\nM2\n";
    for (excess, expected) in [(1.01, true), (0.999, false)] {
        let bump = |x: f64| {
            let aside = (4.0 * x * (1.0 - x)).powi(4) * 0.02 * excess;
            xyz(100.0 * x, 0.6 * aside, -0.8 * aside)
        };
        let (kinds, verdict) = found(program, &Motion::new(1000.0).along(2.0, bump));
        assert_eq!(kinds.contains(&Kind::Deviation), expected, "{kinds:?}");
        assert!(
            (verdict.deviation.value - excess).abs() < 1e-4,
            "{:?}",
            verdict.deviation
        );
    }
}

#[test]
fn a_corner_cut_is_judged_by_the_tolerance() {
    // The chord of a right angle runs within P of either side while it cuts off 1.41 P.
    let program = "G21 G64 P0.02 G90 F12000\nG1 X10\nG1 Y10\nM2\n";
    for (cut, allowed) in [(0.019, true), (0.029, true), (0.06, false)] {
        // A circle tangent to both sides stays within (1 - 1/sqrt 2) of its radius of the nearer one.
        let radius = cut;
        let motion = Motion::new(1000.0)
            .to(xyz(10.0 - radius, 0.0, 0.0), 0.3)
            .turn([0, 1], [10.0 - radius, radius], 90.0, 0.0, 0.15)
            .to(xyz(10.0, 10.0, 0.0), 0.3);
        let (kinds, verdict) = found(program, &motion);
        let expected = radius * (1.0 - std::f64::consts::FRAC_1_SQRT_2);
        assert!(
            (verdict.deviation_mm.value - expected).abs() < 1e-5,
            "{:?}",
            verdict.deviation_mm
        );
        let apex = radius * (std::f64::consts::SQRT_2 - 1.0);
        assert!(
            (verdict.reverse.value - apex).abs() < 1e-4,
            "{:?} {apex}",
            verdict.reverse
        );
        assert_eq!(kinds, [], "{allowed}");
    }
    // Straight across: the middle of the chord from (10 - d, 0) to (10, d) is d / 2 from both sides.
    for (d, allowed) in [(0.039, true), (0.044, false)] {
        let motion = Motion::new(1000.0)
            .to(xyz(10.0 - d, 0.0, 0.0), 0.3)
            .to(xyz(10.0, d, 0.0), 0.3)
            .to(xyz(10.0, 10.0, 0.0), 0.3);
        let (kinds, verdict) = found(program, &motion);
        assert!(
            (verdict.deviation_mm.value - 0.5 * d).abs() < 1e-5,
            "{:?}",
            verdict.deviation_mm
        );
        assert_eq!(kinds.is_empty(), allowed, "{kinds:?}");
    }
}

#[test]
fn a_block_left_out_is_found() {
    // The third side of the square is cut: straight home from the second corner.
    let motion = Motion::new(1000.0)
        .to(xyz(10.0, 0.0, 0.0), 0.3)
        .to(xyz(10.0, 10.0, 0.0), 0.3)
        .to(xyz(0.0, 0.0, 0.0), 0.4);
    let (kinds, verdict) = found(SQUARE, &motion);
    assert!(
        kinds.contains(&Kind::Order) && kinds.contains(&Kind::Missed),
        "{kinds:?}"
    );
    assert_eq!(verdict.first_missed, Some(4));
}

#[test]
fn a_skipped_spike_is_found() {
    let program = "G21 G64 P0.02 G90 F12000\nG1 X10\nG1 Y1\nG1 Y0\nG1 X20\nM2\n";
    let motion = Motion::new(1000.0).to(xyz(20.0, 0.0, 0.0), 0.5);
    let (kinds, verdict) = found(program, &motion);
    assert!(verdict.deviation_mm.value < 1e-9);
    assert!(kinds.contains(&Kind::Missed), "{kinds:?}");
    // The same along the path: out and back on one line.
    let program = "G21 G64 P0.02 G90 F12000\nG1 X10\nG1 X9\nG1 X20\nM2\n";
    let (kinds, _) = found(program, &motion);
    assert!(kinds.contains(&Kind::Order), "{kinds:?}");
}

#[test]
fn reversal_may_turn_within_tolerance_of_tip() {
    let program = "G21 G64 P0.02 G90 F12000\nG1 X10\nG1 X0\nM2\n";
    let motion = |tip: f64| {
        Motion::new(1000.0)
            .to(xyz(tip, 0.0, 0.0), 0.3)
            .to(xyz(0.0, 0.0, 0.0), 0.3)
    };
    let (kinds, verdict) = found(program, &motion(9.981));
    assert_eq!(kinds, []);
    assert!(
        (verdict.reverse.value - 0.019).abs() < 1e-9,
        "{:?}",
        verdict.reverse
    );
    let (kinds, _) = found(program, &motion(9.8));
    assert!(kinds.contains(&Kind::Missed), "{kinds:?}");
    let (kinds, _) = found(program, &motion(10.024));
    assert_eq!(kinds, [Kind::Deviation, Kind::Between]);
}

#[test]
fn unprogrammed_reversals_are_distinguished() {
    let program = |low: f64, high: f64| {
        let there_and_back = format!("G1 X{low}\nG1 X{high}\n").repeat(8);
        format!("G21 G64 P0.02 G90 F12000\nG1 X{high}\n{there_and_back}G1 X0\nM2\n")
    };
    let motion = (0..8)
        .fold(Motion::new(1000.0).to(xyz(9.96, 0.0, 0.0), 0.4), |motion, _| {
            motion.to(xyz(9.94, 0.0, 0.0), 0.05).to(xyz(9.96, 0.0, 0.0), 0.05)
        })
        .to(xyz(0.0, 0.0, 0.0), 0.4);
    // Every tip is missed by two tolerances.
    assert_eq!(found(&program(9.9, 10.0), &motion).0, []);
    // At twelve.
    let (kinds, _) = found(&program(9.7, 10.2), &motion);
    assert!(
        kinds.contains(&Kind::Order) && kinds.contains(&Kind::Missed),
        "{kinds:?}"
    );
}

#[test]
fn a_changed_order_is_found() {
    // A figure of eight: first the loop on the right.
    let eight = "G21 G64 P0.02 G90 F12000\nG2 X0 Y0 I5 J0\nG2 X0 Y0 I-5 J0\nM2\n";
    let loops = |centres: [f64; 2], degrees: f64| {
        Motion::new(1000.0)
            .turn([0, 1], [centres[0], 0.0], degrees, 0.0, 1.5)
            .turn([0, 1], [centres[1], 0.0], degrees, 0.0, 1.5)
    };
    assert_eq!(found(eight, &loops([5.0, -5.0], -360.0)).0, []);
    for (what, motion) in [
        ("the other loop first", loops([-5.0, 5.0], -360.0)),
        ("the other way round", loops([5.0, -5.0], 360.0)),
    ] {
        let (kinds, _) = found(eight, &motion);
        assert!(kinds.contains(&Kind::Order), "{what}: {kinds:?}");
    }
    // Sides of a triangle with its start twice: driven backwards.
    let triangle = "G21 G61 G90 F12000\nG1 X10\nG1 X5 Y8\nG1 X0 Y0\nM2\n";
    let backwards = Motion::new(1000.0)
        .to(xyz(5.0, 8.0, 0.0), 0.3)
        .to(xyz(10.0, 0.0, 0.0), 0.3)
        .to(xyz(0.0, 0.0, 0.0), 0.3);
    assert!(found(triangle, &backwards).0.contains(&Kind::Order));
}

#[test]
fn skipped_turns_of_a_circle_are_found() {
    let twice = "G21 G61 G90 F12000\nG3 X0 Y0 I5 J0 P2\nM2\n";
    let turns = |count: f64| Motion::new(1000.0).turn([0, 1], [5.0, 0.0], 360.0 * count, 0.0, 1.5 * count);
    assert_eq!(found(twice, &turns(2.0)).0, []);
    assert_eq!(found(twice, &turns(1.0)).0, [Kind::Missed]);
    assert_eq!(found(twice, &Motion::new(1000.0).wait(0.1)).0, [Kind::Missed]);
    assert!(found(twice, &turns(3.0)).0.contains(&Kind::Order));
}

#[test]
fn a_feed_two_thousandths_too_high_is_found() {
    for (excess, expected) in [(1.002, vec![Kind::Feed]), (0.9995, vec![])] {
        // 6000 mm/min.
        let seconds = PEAKS[0] * 400.0 / (100.0 * excess);
        let motion = Motion::new(1000.0).to(xyz(240.0, 320.0, 0.0), seconds);
        let (kinds, verdict) = found("G21 G61 F6000\nG1 X240 Y320\nM2\n", &motion);
        assert_eq!(kinds, expected, "{:?}", verdict.feed);
    }
}

#[test]
fn a_chord_error_beyond_what_is_permitted_is_found() {
    // Chords of v T on radius R are v^2 T^2 / 8 R off: 1 um at 44.7 mm/s, 4 ms, 4 mm.
    let program = "G21 G61 G90 F12000\nG3 X0 Y0 I4 J0 P20\nM2\n";
    for (excess, expected) in [(1.03_f64, true), (0.98, false)] {
        let speed = (8.0 * 4.0 * 0.001 * excess).sqrt() / 0.004;
        let seconds = PEAKS[0] * 20.0 * std::f64::consts::TAU * 4.0 / speed;
        let motion = Motion::new(250.0).turn([0, 1], [4.0, 0.0], 20.0 * 360.0, 0.0, seconds);
        let (kinds, verdict) = found(program, &motion);
        assert!(
            (verdict.chord.value / excess - 1.0).abs() < 2e-3,
            "{:?}",
            verdict.chord
        );
        assert!(
            (verdict.between_mm.value / (0.001 * excess) - 1.0).abs() < 5e-3,
            "{:?}",
            verdict.between_mm
        );
        let both = [Kind::Between, Kind::Chord];
        assert_eq!(kinds, if expected { &both[..] } else { &[] });
    }
}

#[test]
fn a_start_or_an_end_elsewhere_is_found() {
    let mut motion = square(1000.0);
    let last = motion.setpoints.len() - 1;
    motion.setpoints[last][0] += 2e-6;
    assert!(found(SQUARE, &motion).0.contains(&Kind::End));
    let mut motion = square(1000.0);
    motion.setpoints[0][2] += 0.5;
    assert!(found(SQUARE, &motion).0.contains(&Kind::Start));
}

#[test]
fn a_motion_that_breaks_off_is_found() {
    let mut motion = square(1000.0);
    motion.setpoints.truncate(motion.setpoints.len() - 150);
    let (kinds, _) = found(SQUARE, &motion);
    for kind in [Kind::Acceleration, Kind::Jerk, Kind::Missed, Kind::End] {
        assert!(kinds.contains(&kind), "{kind:?}: {kinds:?}");
    }
}

#[test]
fn a_dwell_without_a_stop_is_found() {
    let program = "G21 G64 P0.02 G90 F12000\nG1 X10\nG4 P0.1\nG1 Y10\nM2\n";
    let legs = |radius: f64, wait: f64| {
        Motion::new(1000.0)
            .to(xyz(10.0 - radius, 0.0, 0.0), 0.3)
            .turn(
                [0, 1],
                [10.0 - radius, radius],
                90.0,
                0.0,
                if radius > 0.0 { 0.15 } else { 0.0 },
            )
            .wait(wait)
            .to(xyz(10.0, 10.0, 0.0), 0.3)
    };
    assert_eq!(found(program, &legs(0.0, 0.1)).0, []);
    assert_eq!(found(program, &legs(0.03, 0.1)).0, [Kind::Rest]);
    // Passes the point of rest, but without a setpoint on it.
    let straight = "G21 G64 P0.02 G90 F12000\nG1 X10\nG4 P0.1\nG1 X23\nM2\n";
    let motion = Motion::new(1000.0).to(xyz(23.0, 0.0, 0.0), 0.4);
    assert_eq!(found(straight, &motion).0, [Kind::Rest]);
}

#[test]
fn nan_and_positions_beyond_the_travel_are_found() {
    let mut motion = square(1000.0);
    motion.setpoints[100][0] = f64::NAN;
    assert!(found(SQUARE, &motion).0.contains(&Kind::Unreadable));
    let mut motion = square(1000.0);
    motion.setpoints[100][2] = -10_000.1;
    let (kinds, verdict) = found(SQUARE, &motion);
    assert!(kinds.contains(&Kind::Travel));
    assert!((verdict.travel.value - 0.1).abs() < 1e-9);
}

#[test]
fn nine_axes_are_followed_together() {
    let machine = machine("XYZABCUVW");
    let program = "G21 G64 P0.02 G90 F3000\nG1 X10 A40 U3\nG1 Y10 B-30 C20 W2\nG1 A400 B0\nG1 V5 F300\nM2\n";
    use AxisLetter::{A, B, C, U, V, W, X, Y};
    let stops = [
        axes(&[(X, 10.0), (A, 40.0), (U, 3.0)]),
        axes(&[
            (X, 10.0),
            (A, 40.0),
            (U, 3.0),
            (Y, 10.0),
            (B, -30.0),
            (C, 20.0),
            (W, 2.0),
        ]),
        axes(&[(X, 10.0), (A, 400.0), (U, 3.0), (Y, 10.0), (C, 20.0), (W, 2.0)]),
        axes(&[
            (X, 10.0),
            (A, 400.0),
            (U, 3.0),
            (Y, 10.0),
            (C, 20.0),
            (W, 2.0),
            (V, 5.0),
        ]),
    ];
    let seconds = [1.0, 1.0, 20.0, 3.0];
    let motion = stops
        .iter()
        .zip(seconds)
        .fold(Motion::new(1000.0), |motion, (stop, seconds)| {
            motion.to(*stop, seconds)
        });
    let verdict = judge(program, &motion, &machine);
    assert_eq!(kinds(&verdict), [], "{verdict:#?}");
    assert!(verdict.deviation_mm.value < 1e-12 && verdict.deviation_deg.value < 1e-12);

    // In the middle of the first move C, which rests, is off by 0.03 degrees; then A, which moves.
    let mut off = motion.clone();
    off.setpoints[500][5] += 0.03;
    let verdict = judge(program, &off, &machine);
    assert!(kinds(&verdict).contains(&Kind::Deviation));
    assert!((verdict.deviation_deg.value - 0.03).abs() < 1e-9 && verdict.deviation_mm.value < 1e-9);
    let mut off = motion;
    off.setpoints[500][3] += 0.03;
    let verdict = judge(program, &off, &machine);
    let deviation_deg = verdict.deviation_deg.value;
    // Moving on by du changes X by 10 du and A by 40 du: the greater of 0.03 - 40 du and 10 du is least at
    // 0.006.
    assert!((deviation_deg - 0.006).abs() < 1e-6, "{deviation_deg}");

    // The turn of A alone: faster than 3000 degrees a minute.
    let quick = stops
        .iter()
        .zip([1.0, 1.0, 14.0, 3.0])
        .fold(Motion::new(1000.0), |motion, (stop, seconds)| {
            motion.to(*stop, seconds)
        });
    let verdict = judge(program, &quick, &machine);
    assert_eq!(kinds(&verdict), [Kind::Feed]);
    assert_eq!(verdict.feed.line, 4);
}

#[test]
fn blocks_of_10_um_are_followed_at_full_speed() {
    // A circle in chords of 10 um, driven round it at 170 mm/s: twenty blocks a setpoint.
    let radius = 20.0;
    let count = (std::f64::consts::TAU * radius / 0.01) as usize;
    let mut program = String::from("G21 G64 P0.02 G90 F12000\n");
    for i in 1..=count {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / count as f64).sin_cos();
        program.push_str(&format!(
            "G1 X{:.12} Y{:.12}\n",
            radius * cos - radius,
            radius * sin
        ));
    }
    for rate_hz in [250.0, 1000.0] {
        let motion = Motion::new(rate_hz).turn([0, 1], [-radius, 0.0], 360.0, 0.0, 1.6);
        let verdict = judge(&program, &motion, &machine(XYZ));
        let kinds: Vec<Kind> = kinds(&verdict)
            .into_iter()
            .filter(|kind| *kind != Kind::Chord)
            .collect();
        assert_eq!(kinds, [], "{rate_hz} Hz: {verdict:#?}");
        assert!(verdict.deviation_mm.value < 1e-6, "{:?}", verdict.deviation_mm);
        // In the opposite direction it is not the program.
        let back = Motion::new(rate_hz).turn([0, 1], [-radius, 0.0], -360.0, 0.0, 1.6);
        assert!(crate::common::kinds(&judge(&program, &back, &machine(XYZ))).contains(&Kind::Order));
    }
}

#[test]
fn curvature_steps_are_judged_by_the_joint_time() {
    // Line into arc at a constant 10 mm/s on radius 2 mm: 50 mm/s2 at once, which is J times 1 ms; jerk knows
    // no bound.
    let program = "G21 G61 G90 F12000\nG1 X20\nG3 X20 Y4 I0 J2\nG1 X0\nM2\n";
    // At 35 kHz three periods are 0.086 ms: 54.3 mm/s2 are allowed from one to the other.
    for (speed, allowed) in [(10.0_f64, true), (10.8, false)] {
        let mut motion = Motion::new(35_000.0);
        let arc = std::f64::consts::PI * 2.0;
        let whole = 40.0 + arc;
        let point = |s: f64| {
            if s <= 20.0 {
                xyz(s, 0.0, 0.0)
            } else if s < 20.0 + arc {
                let (sin, cos) = ((s - 20.0) / 2.0).sin_cos();
                xyz(20.0 + 2.0 * sin, 2.0 - 2.0 * cos, 0.0)
            } else {
                xyz(20.0 - (s - 20.0 - arc), 4.0, 0.0)
            }
        };
        // Up to speed in half a second, constant, and down again; the distance is the integral of the
        // rising speed.
        let up = 0.5;
        let cruise = (whole - speed * up) / speed;
        let rise = |x: f64| x.powi(5) * (7.0 + x * (-14.0 + x * (10.0 - 2.5 * x)));
        let distance = |t: f64| speed * (up * rise((t / up).clamp(0.0, 1.0)) + (t - up).max(0.0));
        let period_s = motion.period_ns as f64 * 1e-9;
        let count = ((up + cruise + up) / period_s) as usize;
        for i in 1..=count {
            let t = i as f64 * period_s;
            motion
                .setpoints
                .push(point(distance(t) - distance((t - up - cruise).max(0.0))));
        }
        motion.setpoints.push(point(whole));
        let (kinds, verdict) = found(program, &motion);
        let step = speed * speed / 2.0 / (50_000.0 * (0.001 + 3.0 * period_s));
        assert!(
            (verdict.joint.value / step - 1.0).abs() < 1e-3,
            "{:?} {step}",
            verdict.joint
        );
        let expected: &[Kind] = if allowed { &[] } else { &[Kind::Joint] };
        assert_eq!(kinds, expected, "{verdict:#?}");
    }
}

#[test]
fn the_deviation_matches_an_exhaustive_search() {
    let mut random = Random::from_state(seed(0x5eed_0007) | 1);
    let mut unit = || random.unit();
    for case in 0..20 {
        // Always to the right, so that the nearest point is ahead on the path.
        let mut corners = vec![[0.0, 0.0]];
        let (mut x, mut y) = (0.0, 0.0);
        for _ in 0..60 {
            x += 0.02 + unit() * unit();
            y += unit() - 0.5;
            corners.push([x, y]);
        }
        let lines: String = corners[1..]
            .iter()
            .map(|[x, y]| format!("G1 X{x:.12} Y{y:.12}\n"))
            .collect();
        let program = format!("G21 G64 P0.1 G90 F12000\n{lines}M2\n");
        // Along the corners with waves of up to 60 um across, at even steps of X.
        let height = |at: f64| {
            let i = corners.partition_point(|corner| corner[0] < at).clamp(1, 60);
            let ([x0, y0], [x1, y1]) = (corners[i - 1], corners[i]);
            y0 + (y1 - y0) * ((at - x0) / (x1 - x0)).clamp(0.0, 1.0)
        };
        let wave = 0.06 * unit();
        let motion = Motion::new(1000.0).along(10.0, |fraction| {
            let at = x * fraction;
            xyz(
                at,
                height(at) + wave * (40.0 * fraction).sin() * fraction * (1.0 - fraction),
                0.0,
            )
        });
        let nearest = |point: &evolvent_path::Axes| {
            corners.windows(2).fold(f64::INFINITY, |min, pair| {
                let along = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
                let to = [point[0] - pair[0][0], point[1] - pair[0][1]];
                let square = along[0] * along[0] + along[1] * along[1];
                let fraction = ((to[0] * along[0] + to[1] * along[1]) / square).clamp(0.0, 1.0);
                min.min((to[0] - fraction * along[0]).hypot(to[1] - fraction * along[1]))
            })
        };
        let expected = motion.setpoints.iter().map(nearest).fold(0.0, f64::max);
        let verdict = judge(&program, &motion, &machine(XYZ));
        let judged = verdict.deviation_mm.value;
        assert!(
            (judged - expected).abs() < 1e-9,
            "case {case}: {judged} {expected}"
        );
        assert_eq!(verdict.lost, 0, "case {case}");
        assert_eq!(verdict.missed, 0, "case {case}");
    }
}
