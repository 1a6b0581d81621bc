//! Meaning of programs: one test per rule of RS274/NGC (NISTIR 6556, chapter 3), with values computed by
//! hand.

use evolvent_gcode::{
    Action, CanonicalCommand, Interpreter, Move, MoveKind, PathMode, Settings, SpindleDirection as Turn,
    StartOffsets,
};
use evolvent_path::{Axes, Curve};

fn commands_with(program: &str, settings: Settings) -> Vec<CanonicalCommand> {
    let (commands, errors): (Vec<_>, Vec<_>) =
        Interpreter::new(program.as_bytes(), settings).partition(Result::is_ok);
    let shown: Vec<_> = errors
        .into_iter()
        .filter_map(Result::err)
        .map(|error| error.render("test"))
        .collect();
    assert!(shown.is_empty(), "{}", shown.join("\n"));
    commands.into_iter().filter_map(Result::ok).collect()
}

fn actions(program: &str) -> Vec<Action> {
    commands_with(program, Settings::default())
        .into_iter()
        .map(|command| command.action)
        .collect()
}

fn moves_with(program: &str, settings: Settings) -> Vec<Move> {
    let moves = commands_with(program, settings)
        .into_iter()
        .filter_map(|command| match command.action {
            Action::Move(step) => Some(step),
            _ => None,
        });
    moves.collect()
}

fn moves(program: &str) -> Vec<Move> {
    moves_with(program, Settings::default())
}

/// XYZ of the ends of all moves.
fn ends(program: &str) -> Vec<[f64; 3]> {
    moves(program).iter().map(|step| xyz(&step.curve.end())).collect()
}

fn xyz(axes: &Axes) -> [f64; 3] {
    [axes[0], axes[1], axes[2]]
}

fn is_near(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * (1.0 + b.abs())
}

#[track_caller]
fn assert_near(found: f64, expected: f64) {
    assert!(is_near(found, expected), "{found} instead of {expected}");
}

/// Distances of points of a curve from a centre in the XY plane.
fn radii(curve: &Curve, centre: [f64; 2]) -> Vec<f64> {
    (0..=16)
        .map(|step| curve.position(curve.domain() * f64::from(step) / 16.0))
        .map(|point| (point[0] - centre[0]).hypot(point[1] - centre[1]))
        .collect()
}

#[test]
fn moves_chain_and_keep_axes_that_are_not_named() {
    assert_eq!(
        ends("G0 X1 Y2 Z3\nX5\nG1 F60 Z-1\nY0"),
        [
            [1.0, 2.0, 3.0],
            [5.0, 2.0, 3.0],
            [5.0, 2.0, -1.0],
            [5.0, 0.0, -1.0]
        ]
    );
    let chain = moves("G0 X1 Y2 Z3\nX5\nG1 F60 Z-1\nY0");
    for pair in chain.windows(2) {
        assert_eq!(pair[0].curve.end(), pair[1].curve.start());
    }
}

#[test]
fn zero_length_moves_are_omitted_but_modes_persist() {
    assert_eq!(ends("G0 X0 Y0 Z0\nG1 F60\nG91 X0\nX1"), [[1.0, 0.0, 0.0]]);
}

#[test]
fn rapids_are_unlimited_and_feeds_are_per_second() {
    let found = moves("G0 X1\nG1 F600 X2");
    assert_eq!(
        (found[0].kind, found[0].feed_mm_s),
        (MoveKind::Rapid, f64::INFINITY)
    );
    assert_eq!((found[1].kind, found[1].feed_mm_s), (MoveKind::Feed, 10.0));
}

#[test]
fn inches_scale_lengths_and_feed_but_no_angles() {
    let found = moves("G20\nF60 G1 X1 A10\nA20");
    assert_near(found[0].curve.end()[0], 25.4);
    assert_eq!(found[0].curve.end()[3], 10.0);
    assert_near(found[0].feed_mm_s, 25.4);
    // Only a rotary axis moves: F is in degrees a minute.
    assert_near(found[1].feed_mm_s, 1.0);
    assert_near(found[1].curve.length(), 10.0);
}

#[test]
fn a_unit_change_keeps_the_feed() {
    assert_near(moves("G21 F600\nG20\nG1 X1")[0].feed_mm_s, 10.0);
    // Table 8: F comes before G20 and G21, so it is in the units of the line before.
    assert_near(moves("G20 F600 G1 X1")[0].feed_mm_s, 10.0);
}

#[test]
fn uvw_determine_the_feed_only_if_xyz_do_not_move() {
    let found = moves("F60 G1 U3 V4 A90\nX1 U0");
    assert_near(found[0].curve.length(), 5.0);
    assert_near(found[0].feed_mm_s, 1.0);
    assert_near(found[1].curve.length(), 1.0);
}

#[test]
fn inverse_time_is_resolved_by_the_length_of_the_path() {
    let found = moves("G93 G1 F2 X10\nG2 F0.5 X20 I5\nG0 X0");
    // F2: half a minute for 10 mm.
    assert_near(found[0].feed_mm_s, 10.0 / 30.0);
    assert_near(found[1].feed_mm_s, std::f64::consts::PI * 5.0 / 120.0);
    assert_eq!(found[2].feed_mm_s, f64::INFINITY);
}

#[test]
fn feed_per_revolution_follows_the_spindle_speed() {
    let found = moves("G95 S300 F0.2\nG1 X1\nS600\nX2\nG20 F0.1\nX3\nF0.1 X4");
    assert_near(found[0].feed_mm_s, 1.0);
    assert_near(found[1].feed_mm_s, 2.0);
    assert_near(found[2].feed_mm_s, 1.0);
    assert_near(found[3].feed_mm_s, 25.4);
}

#[test]
fn increments_and_absolute_positions() {
    assert_eq!(
        ends("G0 X5\nG91 X1\nX1 Y2\nG90 X0"),
        [[5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [7.0, 2.0, 0.0], [0.0, 2.0, 0.0]]
    );
}

#[test]
fn distance_mode_acts_before_the_motion_of_its_line() {
    assert_eq!(ends("G0 X5\nG91 X1 G0"), [[5.0, 0.0, 0.0], [6.0, 0.0, 0.0]]);
}

fn offsets() -> Settings {
    let mut settings = Settings {
        start: Axes::repeat(1.0),
        ..Settings::default()
    };
    settings.offsets.work[0] = Axes::repeat(10.0);
    settings.offsets.work[1] = Axes::repeat(20.0);
    settings.offsets.work[8] = Axes::repeat(90.0);
    settings
}

fn first_axis(program: &str) -> Vec<f64> {
    moves_with(program, offsets())
        .iter()
        .map(|step| step.curve.end()[0])
        .collect()
}

#[test]
fn work_offsets_locate_the_program_zero() {
    assert_eq!(
        first_axis("G0 X0\nG55 X0\nG59.3 X1\nG54 X2"),
        [10.0, 20.0, 91.0, 12.0]
    );
}

#[test]
fn g53_ignores_offsets_for_one_line() {
    assert_eq!(first_axis("G92 X100\nG53 G0 X5\nX100"), [5.0, 1.0]);
    // In inches too, and with the motion mode in force.
    assert_eq!(first_axis("G0 X0\nG20\nG53 X2"), [10.0, 50.8]);
}

#[test]
fn g92_assigns_the_present_position() {
    // Machine 1 is X5 now, so X0 is machine -4.
    assert_eq!(first_axis("G92 X5\nG0 X0"), [-4.0]);
    // Related codes: clear, suspend, restore.
    assert_eq!(first_axis("G92 X5\nG92.1\nG0 X0"), [10.0]);
    assert_eq!(
        first_axis("G92 X5\nG92.2\nG0 X0\nG92.3 X0\nG92.2\nG92.3\nX1"),
        [10.0, -4.0, -3.0]
    );
    // Added to a work offset, and kept when that changes: offset -14 applies with G55 too.
    assert_eq!(first_axis("G92 X5\nG55 G0 X0"), [6.0]);
    // In inches.
    assert_eq!(first_axis("G20\nG92 X1\nG21\nG0 X25.4\nX26.4"), [2.0]);
    // Axes that are not named keep their offset: Y0 is machine -4.
    let moved = moves_with("G92 X5 Y5\nG92 X6\nG0 Y0", offsets());
    assert_eq!(moved[0].curve.end()[1], -4.0);
    // A second G92 is relative to the first.
    assert_eq!(first_axis("G92 X5\nG92 X6\nG0 X6 Y-20\nX7"), [1.0, 2.0]);
}

#[test]
fn an_earlier_g92_offset_is_active_from_the_start() {
    let settings = Settings {
        offsets: StartOffsets {
            g92: Axes::repeat(3.0),
            ..StartOffsets::default()
        },
        ..Settings::default()
    };
    assert_eq!(moves_with("G0 X0", settings)[0].curve.end()[0], 3.0);
}

#[test]
fn centre_format_arcs_are_on_their_circle() {
    // Quarter circles of radius 5, counter-clockwise, seen from the normal axis: from the first axis'
    // direction towards the second's.
    for (plane, first, second, words) in [
        ("G17", 0, 1, "X5 Y5 I0 J5"),
        ("G18", 2, 0, "Z5 X5 K0 I5"),
        ("G19", 1, 2, "Y5 Z5 J0 K5"),
    ] {
        let found = moves(&format!("F60 {plane} G3 {words}"));
        let curve = &found[0].curve;
        assert_near(curve.length(), 2.5 * std::f64::consts::PI);
        let half = curve.position(curve.domain() / 2.0);
        assert_near(half[first], 5.0 * 0.5_f64.sqrt());
        assert_near(half[second], 5.0 - 5.0 * 0.5_f64.sqrt());
    }
}

#[test]
fn g2_and_g3_are_the_two_directions() {
    let quarter = &moves("F60 G3 X5 Y5 J5")[0].curve;
    let rest = &moves("F60 G2 X5 Y5 J5")[0].curve;
    assert_near(quarter.length() * 3.0, rest.length());
    assert!(rest.position(rest.domain() / 2.0)[0] < 0.0);
}

#[test]
fn full_circles_and_turns() {
    use std::f64::consts::TAU;
    let length = |program: &str| moves(program)[0].curve.length();
    assert_near(length("F60 G2 I5"), 5.0 * TAU);
    assert_near(length("F60 G3 X0 Y0 I5 J0"), 5.0 * TAU);
    assert_near(length("F60 G2 I5 P1"), 5.0 * TAU);
    assert_near(length("F60 G2 I5 P3"), 15.0 * TAU);
    assert_near(length("F60 G3 X5 Y5 J5 P2"), 5.0 * 1.25 * TAU);
    // A helix of four turns, pitch 2.
    assert_near(length("F60 G3 I5 Z-8 P4"), (20.0 * TAU).hypot(8.0));
}

#[test]
fn inexact_increments_still_make_a_full_circle() {
    // 253.2 + 2.9 - 256.1 is not 0 in doubles, so in one of the two senses the path is 1e-14 mm.
    for sense in ["G2", "G3"] {
        let found = moves(&format!("G91 G0 Y253.2\nY2.9\nY-256.1\nG90 F60 {sense} Y0 I5"));
        assert_ne!(found[2].curve.end()[1], 0.0);
        assert_near(found[3].curve.length(), 5.0 * std::f64::consts::TAU);
    }
}

#[test]
fn arcs_are_modal_but_their_centre_is_not() {
    let found = moves("F60 G3 X10 I5\nX0 I-5\nI5");
    assert_eq!(found.len(), 3);
    assert_near(found[2].curve.length(), 10.0 * std::f64::consts::PI);
}

#[test]
fn absolute_centres_follow_offsets_and_units() {
    let settings = Settings {
        offsets: StartOffsets {
            work: [Axes::repeat(7.0); 9],
            ..StartOffsets::default()
        },
        ..Settings::default()
    };
    let program = "G0 X0 Y0 Z0\nG20\nF10 G90.1 G3 X1 Y1 I0 J1";
    let curve = moves_with(program, settings)[1].curve;
    for radius in radii(&curve, [7.0, 7.0 + 25.4]) {
        assert_near(radius, 25.4);
    }
}

#[test]
fn the_sign_of_r_selects_the_minor_or_major_arc() {
    // Chord 6, radius 5: the centre is 4 beside the chord.
    for (program, centre, long) in [
        ("F60 G2 X6 R5", [3.0, -4.0], false),
        ("F60 G3 X6 R5", [3.0, 4.0], false),
        ("F60 G2 X6 R-5", [3.0, 4.0], true),
        ("F60 G3 X6 R-5", [3.0, -4.0], true),
    ] {
        let curve = moves(program)[0].curve;
        for radius in radii(&curve, centre) {
            assert_near(radius, 5.0);
        }
        assert_eq!(curve.length() > 5.0 * std::f64::consts::PI, long, "{program}");
    }
}

#[test]
fn near_the_semicircle_radius_format_is_robust() {
    // R a little above, exactly at and (rounded by a post-processor) below half the chord.
    for r in ["5.0000000000001", "5", "4.9999999999", "4.999"] {
        let curve = moves(&format!("F60 G2 X6 Y8 R{r}"))[0].curve;
        assert!(
            (curve.length() - 5.0 * std::f64::consts::PI).abs() < 2e-5,
            "R{r}: {}",
            curve.length()
        );
        assert_eq!(xyz(&curve.end()), [6.0, 8.0, 0.0]);
    }
}

#[test]
fn arcs_rounded_to_0_01_mm_are_accepted() {
    // Radius 10 at 30 degrees, rounded to 0.01: 8.66, 5.00.
    let curve = moves("G0 X10\nF60 G3 X8.66 Y5 I-10")[1].curve;
    assert_eq!(xyz(&curve.end()), [8.66, 5.0, 0.0]);
    // LinuxCNC's tolerance is 2 * 0.01 * sqrt(2) = 0.0283 in mm: 0.028 passes, 0.029 not.
    assert_eq!(moves("F60 G2 X20.028 I10").len(), 1);
    let rejected = Interpreter::new(&b"F60 G2 X20.029 I10"[..], Settings::default()).next();
    assert!(matches!(rejected, Some(Err(_))));
    // Large arcs pass by their relative tolerance of 0.1 %, up to a hundred times the absolute.
    assert_eq!(moves("F60 G2 X2000.9 I1000").len(), 1);
}

/// A point of the involute of a circle about the origin, by definition: the end of a taut string.
fn involute(r: f64, phi: f64, turned: f64) -> [f64; 2] {
    let (sin, cos) = (phi + turned).sin_cos();
    [r * (cos + phi * sin), r * (sin - phi * cos)]
}

#[test]
fn involutes_match_their_definition_in_every_plane() {
    let (r, from, to) = (2.0, 1.0, 9.0);
    let (start, end) = (involute(r, from, 0.3), involute(r, to, 0.3));
    for (plane, axes, letters, centre) in [
        ("G17", [0, 1], ["X", "Y"], ["I", "J"]),
        ("G18", [2, 0], ["Z", "X"], ["K", "I"]),
        ("G19", [1, 2], ["Y", "Z"], ["J", "K"]),
    ] {
        let program = format!(
            "{plane} F60\nG0 {a}{} {b}{}\nG3.2 {a}{} {b}{} {i}{} {j}{} R{r}",
            start[0],
            start[1],
            end[0],
            end[1],
            -start[0],
            -start[1],
            a = letters[0],
            b = letters[1],
            i = centre[0],
            j = centre[1],
        );
        let curve = moves(&program)[1].curve;
        // Arc length r (phi1^2 - phi0^2) / 2.
        assert_near(curve.length(), r * (to * to - from * from) / 2.0);
        let middle = ((from * from + to * to) / 2.0_f64).sqrt();
        let expected = involute(r, middle, 0.3);
        let found = curve.position(curve.parameter(curve.length() / 2.0));
        assert!((found[axes[0]] - expected[0]).hypot(found[axes[1]] - expected[1]) < 1e-9);
    }
}

#[test]
fn involutes_work_in_all_modes() {
    // Mirrored at the X axis and traversed outwards, it is clockwise.
    let (start, end) = (involute(2.0, 1.0, 0.0), involute(2.0, 7.0, 0.0));
    let program = format!(
        "F60\nG0 X{} Y{}\nG91.1 G2.2 X{} Y{} Z5 I{} J{} R2",
        start[0], -start[1], end[0], -end[1], -start[0], start[1]
    );
    let out = moves(&program)[1].curve;
    assert_near(out.end()[2], 5.0);
    assert_near(out.length(), 48.0_f64.hypot(5.0));
    // Inwards: the string winds up, and the direction of motion rotates the other way.
    let program = format!(
        "{program}\nG90.1 G3.2 X{} Y{} Z0 I{} J{} R2",
        start[0], -start[1], -end[0], end[1]
    );
    let back = moves(&program)[2].curve;
    assert_near(back.length(), out.length());
    let middle = |curve: &Curve| curve.position(curve.parameter(curve.length() / 2.0));
    assert!((middle(&back) - middle(&out)).norm() < 1e-9);

    let inch = |value: f64| value / 25.4;
    let program = format!(
        "G20 F60\nG91 G0 X{} Y{}\nG3.2 X{} Y{} I{} J{} R{}",
        inch(start[0]),
        inch(start[1]),
        inch(end[0] - start[0]),
        inch(end[1] - start[1]),
        inch(-start[0]),
        inch(-start[1]),
        inch(2.0)
    );
    assert_near(moves(&program)[1].curve.length(), 48.0);
}

#[test]
fn every_move_has_the_path_control_mode() {
    let modes: Vec<_> = moves("G0 X1\nG61 X2\nG61.1 X3\nG64 X4\nG64 P0.05 Q0.01 X5\nG20 G64 P0.1 X6")
        .iter()
        .map(|step| step.path_mode)
        .collect();
    let blend = |tolerance_mm, merge_mm| PathMode::Blend {
        tolerance_mm,
        merge_mm,
    };
    assert_eq!(
        modes[..5],
        [
            blend(None, None),
            PathMode::ExactPath,
            PathMode::ExactStop,
            blend(None, None),
            blend(Some(0.05), Some(0.01))
        ]
    );
    let PathMode::Blend {
        tolerance_mm: Some(tolerance),
        ..
    } = modes[5]
    else {
        panic!("{:?}", modes[5])
    };
    assert_near(tolerance, 2.54);
}

#[test]
fn lines_execute_in_the_order_of_table_8() {
    let found = actions("T3\nM2 G1 X1 M8 G4 P0.5 (MSG, go) M3 M6 T7 S100 F60");
    assert_eq!(found[0], Action::SelectTool(3));
    assert_eq!(found[1], Action::Message("go".into()));
    assert_eq!(found[2], Action::SelectTool(7));
    assert_eq!(found[3], Action::ChangeTool(7));
    assert_eq!(
        found[4],
        Action::Spindle {
            spindle: 0,
            direction: Turn::Clockwise,
            speed_rpm: 100.0
        }
    );
    assert_eq!(
        found[5],
        Action::Coolant {
            mist: false,
            flood: true
        }
    );
}

#[test]
fn dwell_comes_before_the_motion_of_its_line() {
    let found = actions("G0 X1\nG4 P1.5 X2");
    assert_eq!(found[1], Action::Dwell { seconds: 1.5 });
    assert!(matches!(found[2], Action::Move(_)));
}

#[test]
fn spindle_and_coolant_keep_their_state() {
    let off = Action::Coolant {
        mist: false,
        flood: false,
    };
    assert_eq!(
        actions("S500\nM4\nS600\nM5\nM7\nM8\nM9"),
        [
            Action::Spindle {
                spindle: 0,
                direction: Turn::Stopped,
                speed_rpm: 500.0
            },
            Action::Spindle {
                spindle: 0,
                direction: Turn::CounterClockwise,
                speed_rpm: 500.0
            },
            Action::Spindle {
                spindle: 0,
                direction: Turn::CounterClockwise,
                speed_rpm: 600.0
            },
            Action::Spindle {
                spindle: 0,
                direction: Turn::Stopped,
                speed_rpm: 600.0
            },
            Action::Coolant {
                mist: true,
                flood: false
            },
            Action::Coolant {
                mist: true,
                flood: true
            },
            off,
            Action::ProgramEnd,
        ]
    );
}

#[test]
fn a_tool_change_stops_the_spindle() {
    assert_eq!(
        actions("S500 M3\nT2 M6")[1..4],
        [
            Action::SelectTool(2),
            Action::Spindle {
                spindle: 0,
                direction: Turn::Stopped,
                speed_rpm: 500.0
            },
            Action::ChangeTool(2),
        ]
    );
}

#[test]
fn m2_switches_everything_off_and_ends_reading() {
    let end = [
        Action::Spindle {
            spindle: 0,
            direction: Turn::Stopped,
            speed_rpm: 9.0,
        },
        Action::Coolant {
            mist: false,
            flood: false,
        },
        Action::ProgramEnd,
    ];
    for program in [
        "S9 M3\nM8\nM2\nthis is no G-code",
        "S9 M3\nM8\nM30",
        "S9 M3\nM8",
        "%\nS9 M3\nM8\n%\nX?",
    ] {
        assert_eq!(actions(program)[2..], end, "{program:?}");
    }
    assert_eq!(actions(""), [Action::ProgramEnd]);
    assert_eq!(actions("\n \n%\n\n"), [Action::ProgramEnd]);
}

#[test]
fn stops_come_last_on_their_line() {
    let stop = |optional, pallet| Action::ProgramStop { optional, pallet };
    assert_eq!(
        actions("M0\nM1\nM60")[..3],
        [stop(false, false), stop(true, false), stop(false, true)]
    );
    assert!(matches!(actions("M1 G0 X1")[0], Action::Move(_)));
}

#[test]
fn block_delete_skips_lines_only_when_enabled() {
    let program = " / G0 X1\nG0 X2";
    assert_eq!(moves(program).len(), 1);
    let settings = Settings {
        block_delete: false,
        ..Settings::default()
    };
    assert_eq!(moves_with(program, settings).len(), 2);
    // A skipped line may contain anything.
    assert_eq!(moves("/ [?\nG0 X2").len(), 1);
}

#[test]
fn cancelling_codes_of_inactive_modes_are_accepted() {
    assert_eq!(
        actions("G17 G21 G40 G49 G54 G80 G90 G94 G97"),
        [Action::ProgramEnd]
    );
}

#[test]
fn codes_ignore_leading_zeros_and_trailing_decimals() {
    assert_eq!(
        ends("N0010 G00 X01.\nG01.0 F60 X+2"),
        [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    );
    assert_eq!(moves("F60\nG02 X1 I.5\nG61.1 M03 X2 I.5 G3").len(), 2);
}

#[test]
fn commands_carry_the_physical_line() {
    let lines: Vec<_> = commands_with("%\n\n(a)\nN900 G0 X1\r\n\r\nX2\nM2", Settings::default())
        .iter()
        .map(|command| command.line)
        .collect();
    assert_eq!(lines, [4, 6, 7]);
}

#[test]
fn the_program_is_read_lazily() {
    // An endless program: an interpreter that reads ahead would not return.
    let endless = std::io::BufReader::new(std::io::Read::chain(&b"G91 G1 F60\n"[..], Endless));
    let mut interpreter = Interpreter::new(endless, Settings::default());
    for count in 1..=1000 {
        assert!(matches!(interpreter.next(), Some(Ok(_))));
        assert_eq!(interpreter.line(), count + 1);
    }
    assert_near(interpreter.position()[0], 1000.0);
}

struct Endless;

impl std::io::Read for Endless {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = buffer.len() / 3 * 3;
        for piece in buffer[..count].chunks_exact_mut(3) {
            piece.copy_from_slice(b"X1\n");
        }
        Ok(count)
    }
}

#[test]
fn x_of_g43_1_is_a_diameter_by_the_mode_of_its_line() {
    for (program, x) in [
        ("G7 G43.1 X10\nG0 X0", 5.0),
        ("G7\nG8 G43.1 X10\nG0 X0", 10.0),
        ("G43.1 X2\nG7 G43.2 X10\nG0 X0", 7.0),
    ] {
        assert_near(ends(program)[0][0], x);
    }
}

#[test]
fn a_tool_is_measured_in_a_rotated_system() {
    let (sin, cos) = 30.0_f64.to_radians().sin_cos();
    let turned = |x: f64, y: f64| [cos * x - sin * y, sin * x + cos * y];
    // X1 Y2 of the machine in rotated coordinates.
    let (x, y) = (cos + 2.0 * sin, 2.0 * cos - sin);
    for (measured, [x, y]) in [
        ("G10 L10 P4 X1", turned(4.0, 0.0)),
        ("G10 L10 P4 X1 Y3", turned(4.0, -1.0)),
        ("G10 L10 P4 Z1", [0.0, 0.0]),
        // The missing word keeps its value in these coordinates.
        ("G10 L1 P4 X1 Y2\nG10 L10 P4 X1", turned(4.0, y)),
        ("G10 L1 P4 X1 Y2\nG10 L10 P4 Y1", turned(x, 1.0)),
        ("G10 L1 P4 X1 Y2", [1.0, 2.0]),
    ] {
        let program = format!("G10 L2 P1 R30\nG0 X5 Y2\n{measured}\nG43 H4\nG0 X0 Y0");
        let found = *ends(&program).last().unwrap();
        assert_near(found[0], x);
        assert_near(found[1], y);
    }
    // Relative to G59.3, which is rotated by 30 degrees; the work is rotated by more.
    let program = "G10 L2 P9 R30\nG10 L2 P1 R50\nG53 G0 X5 Y2\nG10 L11 P4 X1 Y2\nG43 H4\nG59.3 G0 X1 Y2 Z1";
    let found = ends(program);
    assert_near(found[1][0], 5.0);
    assert_near(found[1][1], 2.0);
}

#[test]
fn repeat_counts_round_half_to_even() {
    for (count, moves) in [("2.5", 2), ("1.5", 2), ("0.5", 0), ("3.5", 4), ("2.6", 3)] {
        let program = format!("G91\nO1 repeat [{count}]\nG0 X1\nO1 endrepeat");
        assert_eq!(ends(&program).len(), moves, "{count}");
    }
}
