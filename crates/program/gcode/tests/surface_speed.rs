//! G96 with and without G95: the commands to the spindle, and the feed of moves while its speed follows the
//! radius.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::f64::consts::TAU;

use evolvent_gcode::{
    Action, CanonicalCommand, Interpreter, MachineFeatures, MoveKind, Outputs, PathMode, Settings,
    SpindleDirection, SpindleOutput,
};
use evolvent_path::SurfaceSpeed;

fn run(program: &str) -> Vec<CanonicalCommand> {
    let settings = Settings {
        features: MachineFeatures {
            lathe: true,
            spindle_max_rpm: [4000.0; 4],
            ..MachineFeatures::default()
        },
        ..Settings::default()
    };
    Interpreter::new(program.as_bytes(), settings)
        .map(|command| command.expect("a program without errors"))
        .collect()
}

fn spindles(commands: &[CanonicalCommand]) -> Vec<Action> {
    let commands_to_spindle = commands.iter().map(|command| command.action.clone());
    commands_to_spindle
        .filter(|action| matches!(action, Action::Spindle { .. } | Action::SurfaceSpeed { .. }))
        .collect()
}

/// A machine with this state of spindle 0.
fn of_first(spindle: SpindleOutput) -> Outputs {
    let mut outputs = Outputs::default();
    outputs.spindles[0] = spindle;
    outputs
}

fn surface(speed_m_min: f64, max_rpm: f64, centre_mm: f64) -> Action {
    Action::SurfaceSpeed {
        spindle: 0,
        direction: SpindleDirection::Clockwise,
        surface: SurfaceSpeed {
            speed_m_min,
            max_rpm,
            centre_mm,
        },
    }
}

/// The speed by definition: the circumference per minute.
fn rpm(speed_m_min: f64, max_rpm: f64, radius_mm: f64) -> f64 {
    (speed_m_min * 1000.0 / (TAU * radius_mm)).min(max_rpm)
}

/// Checks the pieces of a program's feed moves against the definition at many positions of each. Returns
/// their number, and the length of those along which the speed is limited, mm.
fn check_pieces(program: &str, speed_at: impl Fn(f64) -> f64, feed_mm: f64) -> (usize, f64) {
    let commands = run(program);
    let pieces: Vec<_> = commands
        .iter()
        .filter_map(|command| match &command.action {
            Action::Move(motion) if motion.kind == MoveKind::Feed => Some((motion, command)),
            _ => None,
        })
        .collect();
    for pair in pieces.windows(2) {
        assert_eq!(pair[0].0.curve.end(), pair[1].0.curve.start());
        // These programs have one feed move per line.
        assert_eq!(pair[1].1.continues, pair[0].1.line == pair[1].1.line);
        let [before, after] = [
            pair[0].0.curve.at(pair[0].0.curve.length()).tangent(),
            pair[1].0.curve.at(0.0).tangent(),
        ];
        assert!((before - after).norm() < 1e-9, "{before} {after}");
    }
    let mut limited_mm = 0.0;
    for (motion, command) in &pieces {
        assert_eq!(command.feed_mm_rev, Some(feed_mm));
        let before = [motion.curve.start()[0], motion.curve.end()[0]];
        let is_limited = before
            .iter()
            .all(|x| speed_at(*x) >= (1.0 - 1e-9) * speed_at(0.0));
        limited_mm += if is_limited { motion.curve.length() } else { 0.0 };
        for k in 0..=20 {
            let point = motion
                .curve
                .at(motion.curve.length() * f64::from(k) / 20.0)
                .position;
            let expected = feed_mm * speed_at(point[0]) / 60.0;
            let deviation = motion.feed_mm_s / expected - 1.0;
            // Half of the change along a piece; none where the speed is limited; or the end of what is not
            // divided further.
            let bound = if is_limited { 2e-9 } else { 0.0051 };
            assert!(
                deviation.abs() < bound || motion.curve.length() < 0.02,
                "{deviation} at {point}"
            );
        }
    }
    (pieces.len(), limited_mm)
}

#[test]
fn facing_keeps_the_chip_thickness() {
    let speed_at = |x: f64| rpm(200.0, 3000.0, x.abs());
    let (count, limited_mm) = check_pieces(
        "G21 G18 G8 G95 G96 S200 D3000 M3\nG0 X60 Z0\nG1 X-2 F0.2\nM2\n",
        speed_at,
        0.2,
    );
    // ln(60 / 10.6) / ln(1.01) = 174 at least, and 5 % more; where the speed is limited there is one piece.
    assert!((175..186).contains(&count), "{count}");
    // 200 m/min at 3000 rpm: from 10.61 mm to 2 mm beyond the centre.
    assert!(
        (limited_mm - 2.0 - 200_000.0 / (TAU * 3000.0)).abs() < 1e-6,
        "{limited_mm}"
    );
    // Limited by the spindle, 4000 rpm, not by D.
    let speed_at = |x: f64| rpm(200.0, 4000.0, x.abs());
    check_pieces(
        "G21 G18 G8 G95 G96 S200 M3\nG0 X60 Z0\nG1 X0 F0.2\nM2\n",
        speed_at,
        0.2,
    );
    // Outwards, across the centre, and too short for a piece of each.
    for (from, to) in [(-20.0, 60.0), (0.0, 30.0), (10.6, 10.62), (5.0, 7.9577)] {
        let program = format!("G21 G18 G8 G95 G96 S200 D4000 M3\nG0 X{from} Z0\nG1 X{to} F0.2\nM2\n");
        check_pieces(&program, speed_at, 0.2);
    }
}

#[test]
fn the_cross_feed_of_a_facing_cycle_is_per_revolution() {
    // K is more than the depth: one pass, in along X by E and out along Z by F.
    for (speed, speed_at) in [("G97 S600", None), ("G96 S150 D2500", Some(150.0))] {
        let program = format!("G21 G18 G8 G95 {speed} M3\nG0 X30 Z0\nG75 X20 Z-1 K2 E0.05 F0.2\nM2\n");
        let mut found = [0, 0];
        for command in run(&program) {
            let Action::Move(motion) = &command.action else {
                continue;
            };
            if motion.kind == MoveKind::Rapid {
                continue;
            }
            let along_x = motion.curve.start()[2] == motion.curve.end()[2];
            found[usize::from(along_x)] += 1;
            let feed_mm = if along_x { 0.05 } else { 0.2 };
            assert_eq!(command.feed_mm_rev, Some(feed_mm), "{program}");
            let radius_mm = motion.curve.at(0.5 * motion.curve.length()).position[0];
            let turning = speed_at.map_or(600.0, |speed_m_min| rpm(speed_m_min, 2500.0, radius_mm));
            let ratio = motion.feed_mm_s / (feed_mm * turning / 60.0);
            assert!((ratio - 1.0).abs() < 0.0102, "{program} {ratio}");
        }
        assert!(found[0] > 0 && found[1] > 0, "{program} {found:?}");
    }
}

#[test]
fn arcs_are_divided_but_cylinders_are_not() {
    let speed_at = |x: f64| rpm(150.0, 2500.0, x);
    let ball = "G21 G18 G8 G61.1 G95 G96 S150 D2500 M3\nG0 X1 Z20\nG3 X20 Z1 I0 K-19 F0.1\nM2\n";
    let (count, _) = check_pieces(ball, speed_at, 0.1);
    assert!(count > 20, "{count}");
    let moves: Vec<_> = run(ball)
        .into_iter()
        .filter_map(|command| match command.action {
            Action::Move(motion) if motion.kind == MoveKind::Feed => Some(motion),
            _ => None,
        })
        .collect();
    // The stop is at the end of all pieces only.
    let stops = moves
        .iter()
        .filter(|motion| motion.path_mode == PathMode::ExactStop);
    assert_eq!(stops.count(), 1);
    assert_eq!(moves[moves.len() - 1].path_mode, PathMode::ExactStop);
    for motion in &moves {
        for k in 0..=10 {
            let point = motion
                .curve
                .at(motion.curve.length() * f64::from(k) / 10.0)
                .position;
            let radius = (point[0] - 1.0).hypot(point[2] - 1.0);
            assert!((radius - 19.0).abs() < 1e-9, "{radius}");
        }
    }
    let length: f64 = moves.iter().map(|motion| motion.curve.length()).sum();
    assert!((length - 19.0 * TAU / 4.0).abs() < 1e-9, "{length}");
    let cylinder = "G21 G18 G8 G95 G96 S150 D2500 M3\nG0 X20 Z1\nG1 Z-50 F0.3\nM2\n";
    assert_eq!(check_pieces(cylinder, speed_at, 0.3).0, 1);
}

#[test]
fn the_centre_follows_offsets() {
    let program =
        "G21 G18 G8 G96 S100 D2000 M3\nG92 X5\nG10 L2 P2 X-30\nG55\nG43.1 X0.5\nG97 S600\nG54\nM5\nM2\n";
    let commands_to_spindle = spindles(&run(program));
    let expected = [
        surface(100.0, 2000.0, 0.0),
        surface(100.0, 2000.0, -5.0),
        surface(100.0, 2000.0, -35.0),
        surface(100.0, 2000.0, -34.5),
    ];
    assert_eq!(&commands_to_spindle[..4], &expected);
    assert!(
        matches!(commands_to_spindle[4], Action::Spindle { speed_rpm: 600.0, .. }),
        "{:?}",
        commands_to_spindle[4]
    );
    // Constant again: offsets have no effect.
    assert!(
        matches!(
            commands_to_spindle[5],
            Action::Spindle {
                direction: SpindleDirection::Stopped,
                ..
            }
        ),
        "{:?}",
        commands_to_spindle[5]
    );
}

#[test]
fn g97_alone_keeps_the_present_speed() {
    let commands_to_spindle = spindles(&run("G21 G18 G8\nG0 X25\nG96 S100 M4\nG97\nM2\n"));
    let Action::Spindle {
        direction, speed_rpm, ..
    } = commands_to_spindle[1]
    else {
        panic!("{commands_to_spindle:?}")
    };
    assert_eq!(direction, SpindleDirection::CounterClockwise);
    assert!((speed_rpm - rpm(100.0, 4000.0, 25.0)).abs() < 1e-9, "{speed_rpm}");
}

#[test]
fn surface_speed_respects_feet_and_diameters() {
    // 300 ft/min at 1 inch of diameter: 300 * 12 / pi rpm.
    let commands_to_spindle = spindles(&run("G20 G18 G7\nG0 X1\nG96 S300 M3\nG97\nM2\n"));
    let Action::Spindle { speed_rpm, .. } = commands_to_spindle[1] else {
        panic!("{commands_to_spindle:?}")
    };
    assert!((speed_rpm - 3600.0 / (TAU / 2.0)).abs() < 1e-6, "{speed_rpm}");
}

#[test]
fn a_restart_has_the_active_speed_and_feed() {
    let program = "G21 G18 G8 G95 G96 S200 D3000 M3\nG0 X60 Z0\nG1 X40 F0.2\nX20\nM2\n";
    let settings = Settings {
        features: MachineFeatures {
            lathe: true,
            ..MachineFeatures::default()
        },
        ..Settings::default()
    };
    let mut interpreter = Interpreter::new(program.as_bytes(), settings);
    let restart = interpreter.start_at(4).unwrap();
    assert!(
        restart.actions.contains(&surface(200.0, 3000.0, 0.0)),
        "{:?}",
        restart.actions
    );
    assert!(restart.modes.contains("S200 G96 D3000 M3"), "{}", restart.modes);
    let rest: Vec<_> = interpreter.map(Result::unwrap).collect();
    let feeds: Vec<f64> = rest
        .iter()
        .filter_map(|command| match &command.action {
            Action::Move(motion) => Some(motion.feed_mm_s),
            _ => None,
        })
        .collect();
    assert!(feeds.len() > 20, "{feeds:?}");
    assert!(feeds.windows(2).all(|pair| pair[1] > pair[0]), "{feeds:?}");
}

/// Metres per minute taken for revolutions would be another speed.
#[test]
fn a_program_starts_in_g97_and_an_mdi_block_continues() {
    let after = |is_mdi: bool, text: &str| {
        let settings = Settings {
            is_mdi,
            outputs: of_first(SpindleOutput {
                surface: Some(SurfaceSpeed {
                    speed_m_min: 180.0,
                    max_rpm: 900.0,
                    centre_mm: 0.0,
                }),
                speed_rpm: 700.0,
                direction: SpindleDirection::Stopped,
            }),
            ..Settings::default()
        };
        let commands = Interpreter::new(text.as_bytes(), settings);
        spindles(
            &commands
                .map(|command| command.expect("no error"))
                .collect::<Vec<_>>(),
        )
    };
    assert_eq!(after(true, "M3\n"), [surface(180.0, 900.0, 0.0)]);
    let constant = |speed_rpm| Action::Spindle {
        spindle: 0,
        direction: SpindleDirection::Clockwise,
        speed_rpm,
    };
    assert_eq!(after(false, "M3\n")[0], constant(0.0));
    // After M2 too.
    let ended = after(true, "M3\nM2\n");
    assert!(
        matches!(ended[1], Action::Spindle { direction: SpindleDirection::Stopped, speed_rpm, .. } if speed_rpm == 0.0),
        "{ended:?}"
    );
}

#[test]
fn indivisible_moves_use_the_slowest_feed() {
    let feeds = |program: &str| -> Vec<f64> {
        run(program)
            .iter()
            .filter_map(|command| match &command.action {
                Action::Move(motion) if motion.kind == MoveKind::Feed => Some(motion.feed_mm_s),
                _ => None,
            })
            .collect()
    };
    // A spline from X10 to X30 in a few pieces of its own: none is faster than at its outer end.
    let program = "G21 G17 G95 G96 S100 M3\nG0 X10 Y0\nG5 I5 J0 P-5 Q0 X30 Y10 F0.2\nM2\n";
    let commands = run(program);
    let pieces = commands.iter().filter_map(|command| match &command.action {
        Action::Move(motion) if motion.kind == MoveKind::Feed => Some(motion),
        _ => None,
    });
    let mut count = 0;
    for motion in pieces {
        let xs = (0..=50).map(|k| motion.curve.position(motion.curve.domain() * f64::from(k) / 50.0)[0]);
        let widest = xs.fold(0.0, f64::max);
        let slowest = 0.2 * rpm(100.0, 4000.0, widest) / 60.0;
        assert!(
            (motion.feed_mm_s / slowest - 1.0).abs() < 0.0102,
            "{} for {slowest}",
            motion.feed_mm_s
        );
        count += 1;
    }
    assert!(count > 0);
    let feed_after_drilling = feeds("G21 G18 G8 G95 G96 S200 M3\nG0 X60 Z0\nG97 S600\nG1 X20 F0.2\nM2\n");
    assert_eq!(feed_after_drilling, [2.0]);
}

#[test]
fn an_mdi_block_divides_its_moves() {
    let settings = Settings {
        is_mdi: true,
        outputs: of_first(SpindleOutput {
            direction: SpindleDirection::Clockwise,
            surface: Some(SurfaceSpeed {
                speed_m_min: 100.0,
                max_rpm: 3000.0,
                centre_mm: 0.0,
            }),
            speed_rpm: 0.0,
        }),
        ..Settings::default()
    };
    let block = Interpreter::new("G95\nG0 X50\nG1 X10 F0.1\n".as_bytes(), settings);
    let moves = block.filter(|command| {
        let command = command.as_ref().expect("no error");
        matches!(&command.action, Action::Move(motion) if motion.kind == MoveKind::Feed)
    });
    assert!(moves.count() > 50);
    let commands_to_spindle = spindles(&run("G21 G96 S100 M3\nM5\nG92 X5\nG0 X1\nM2\n"));
    // On, off, and the end of the surface speed: a stopped spindle receives no new centre.
    assert_eq!(commands_to_spindle.len(), 3, "{commands_to_spindle:?}");
}

#[test]
fn rotary_moves_are_fed_in_degrees_per_revolution() {
    let commands = run("G20 G95 S120 M3\nG1 A90 F3\nG1 X1 F0.01\nM2\n");
    let fed: Vec<f64> = commands
        .iter()
        .filter_map(|command| command.feed_mm_rev)
        .collect();
    // 3 degrees, and 0.01 inches.
    assert_eq!(fed[0], 3.0);
    assert!((fed[1] - 0.254).abs() < 1e-12, "{fed:?}");
}

#[test]
fn outputs_have_direction_and_speed_at_a_position() {
    let mut outputs = Outputs::default();
    let surface = SurfaceSpeed {
        speed_m_min: 100.0,
        max_rpm: 3000.0,
        centre_mm: -5.0,
    };
    let direction = SpindleDirection::CounterClockwise;
    assert!(outputs.apply(&Action::SurfaceSpeed {
        spindle: 2,
        direction,
        surface
    }));
    assert_eq!(outputs.spindle(2).direction, direction);
    assert_eq!(outputs.spindle(0), SpindleOutput::default(), "another spindle");
    assert!(
        (outputs.spindle(2).signed_rpm_at(20.0, 1.0, f64::INFINITY) + rpm(100.0, 3000.0, 25.0)).abs() < 1e-9
    );
    assert_eq!(outputs.spindle(2).constant_rpm(), 0.0);
    let speed_rpm = 700.0;
    assert!(outputs.apply(&Action::Spindle {
        spindle: 2,
        direction,
        speed_rpm
    }));
    assert_eq!(
        (
            outputs.spindle(2).signed_rpm_at(20.0, 1.0, f64::INFINITY),
            outputs.spindle(2).constant_rpm()
        ),
        (-700.0, -700.0)
    );
}
