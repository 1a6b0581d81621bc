//! The tool for compensation, the position of its tip, and contours that it does not fit.

#![expect(clippy::panic, reason = "a test may fail")]

use evolvent_gcode::{Action, Code, Diagnostic, Interpreter, Move, Settings, ToolTable};
use evolvent_path::Curve;

/// Tool 3 is a mill; tool 1 has a nose of 0.8 mm whose tip points towards -X and -Z.
pub(crate) const TOOLS: &str = "T1 P1 D1.6 I95 J155 Q2\nT3 P3 Z50 D12\nT4 P4 Z20 D4";

pub(crate) fn run(program: &str) -> Result<Vec<Action>, Diagnostic> {
    let settings = Settings {
        tools: Some(ToolTable::parse(TOOLS).unwrap_or_else(|error| panic!("{error}"))),
        ..Settings::default()
    };
    Interpreter::new(program.as_bytes(), settings)
        .map(|item| item.map(|command| command.action))
        .collect()
}

fn moves(program: &str) -> Vec<Move> {
    let actions = run(program).unwrap_or_else(|error| panic!("{}\n{program}", error.render("x")));
    let moves = actions.into_iter().filter_map(|action| match action {
        Action::Move(step) => Some(step),
        _ => None,
    });
    moves.collect()
}

fn fault(program: &str) -> (Code, u32) {
    let error = run(program).err();
    let error = error.unwrap_or_else(|| panic!("nothing is wrong with\n{program}"));
    assert!(error.help.is_some(), "{}", error.render("x"));
    (error.code, error.line)
}

fn messages(program: &str) -> Vec<String> {
    let actions = run(program).unwrap_or_else(|error| panic!("{}\n{program}", error.render("x")));
    let texts = actions.into_iter().filter_map(|action| match action {
        Action::Message(text) => Some(text),
        _ => None,
    });
    texts.collect()
}

#[test]
fn a_slot_narrower_than_the_tool_is_rejected() {
    let slot = |width: f64| {
        format!("G21 G90 F300\nG0 X-20 Y0\nG41.1 D10\nG1 X0 Y0\nX30\nY{width}\nX0\nG40 X-20\nM2\n")
    };
    for (width, line) in [(0.5, 6), (8.0, 7), (9.99, 7), (9.9999, 7)] {
        assert_eq!(fault(&slot(width)), (Code::CompensationGouge, line), "{width}");
    }
    // A slot as wide as the tool is wide enough: the tool moves in and out on one line.
    let fitting = moves(&slot(10.0));
    let ends: Vec<_> = fitting
        .iter()
        .map(|step| (step.curve.end()[0], step.curve.end()[1]))
        .collect();
    assert_eq!(
        ends,
        [(-20.0, 0.0), (0.0, 5.0), (25.0, 5.0), (0.0, 5.0), (-20.0, 10.0)]
    );
    assert_eq!(moves(&slot(10.01)).len(), 6);
}

#[test]
fn an_arc_too_short_for_both_corners_is_rejected() {
    let program = "G21 G90 F300\nG0 X-60 Y0\nG41.1 D10\nG1 X-40 Y0\nG1 X0 Y0\nG2 X2.232 Y2.660 I8.660 J-5\n\
                   G1 X-3 Y32.2\nG40 X-30 Y32.2\nM2\n";
    assert_eq!(fault(program), (Code::CompensationGouge, 7));
}

#[test]
fn a_move_consumed_by_its_first_corner_is_rejected() {
    let program = "G21 G90 F300\nG0 X-20 Y60\nG41.1 D10\nG1 X-20 Y40\nG1 X-20 Y20\nG3 X0 Y0 I20\n\
                   G1 X1.7 Y4.7\nG1 X-10 Y14.5\nG40 X-10 Y40\nM2\n";
    assert_eq!(fault(program), (Code::CompensationGouge, 8));
}

#[test]
fn a_fine_hollow_narrower_than_the_tool_is_rejected() {
    // Half a circle of radius 4 in steps of two degrees: no sharp corner, but a reversed tool path.
    let hollow = |radius: f64| {
        let mut text = format!("G21 F600\nG0 X{radius} Y-30\nG41.1 D10\nG1 Y-12\nY0\n");
        for step in 1..=90 {
            let angle = f64::from(2 * step).to_radians();
            let (x, y) = (radius * angle.cos(), radius * angle.sin());
            text.push_str(&format!("X{x:.6} Y{y:.6}\n"));
        }
        text.push_str("Y-12\nG40 Y-30\nM2\n");
        text
    };
    assert_eq!(fault(&hollow(4.0)).0, Code::CompensationGouge);
    assert!(moves(&hollow(5.2)).len() > 90);
}

#[test]
fn arcs_with_rounded_ends_are_followed() {
    // Along a line to a half circle whose radii at start and end differ by 0.01 mm, on either side.
    for (side, y) in [("G41.1", 1.0), ("G42.1", -1.0)] {
        let found = moves(&format!(
            "F600\nG0 X0 Y-30\n{side} D2\nG1 X10 Y-20\nY0\nG3 X-9.99 Y0 I-10 J0\nG1 Y-20\nG40 Y-30"
        ));
        let arc = found.iter().find_map(|step| match step.curve {
            Curve::Arc(arc) if arc.sweep_rad() > 3.0 => Some(arc),
            _ => None,
        });
        let radius = arc.map(|arc| arc.radius_mm());
        assert!(
            radius.is_some_and(|radius| (radius - 10.0 + y).abs() < 0.011),
            "{radius:?}"
        );
    }
    // A line that folds back to an arc as nearly as a program can express it.
    let fold = "F100\nG0 X-29.5409 Y-111.2971\nG42.1 D0.5\nG1 X-42.0209 Y-102.9771\nX-54.5009 Y-94.6571\n\
                G2 I-1.576 J-2.5527 X-57.8722 Y-99.6133\nG40\nG1 X-62.9 Y-114.6";
    assert!(moves(fold).len() == 6);
}

#[test]
fn a_full_circle_next_to_a_corner_remains_full() {
    // The tool arrives 0.03 rad off the circle's tangent, from outside or inside.
    for angle in [-0.03_f64, 0.03] {
        let (x, y) = (-40.0 * angle.cos(), -40.0 * angle.sin());
        let found = moves(&format!(
            "F600\nG0 X{:.6} Y{:.6}\nG42.1 D10\nG1 X{x:.6} Y{y:.6}\nX0 Y0\nG3 J20\nG1 X30\nG40 Y-30",
            2.0 * x,
            2.0 * y
        ));
        let sweeps = found.iter().filter_map(|step| match step.curve {
            Curve::Arc(arc) => Some(arc.sweep_rad()),
            _ => None,
        });
        let largest = sweeps.fold(0.0, f64::max);
        assert!((largest - std::f64::consts::TAU).abs() < 0.04, "{largest}");
    }
}

#[test]
fn a_tool_nose_cuts_the_programmed_diameter() {
    let program =
        "G21 G18 G94 F100\nT1 M6 G43\nG0 X40 Z50\nG42\nG1 X20 Z45\nX20 Z20\nX30 Z10\nG40 G0 X60\nM2\n";
    let found = moves(program);
    let at = |index: usize| (found[index].curve.end()[0], found[index].curve.end()[2]);
    // Along Z the tip moves at the programmed radius; the nose touches it, its centre 0.8 above.
    assert_eq!((at(1).0, at(2).0), (20.0, 20.0));
    // On the cone of 45 degrees the nose's centre is 0.8 off the line, the tip 0.8 lower in both.
    let (x, z) = (at(3).0 + 0.8, at(3).1 + 0.8);
    let deviation = ((x - 20.0) + (z - 20.0)) / std::f64::consts::SQRT_2;
    assert!((deviation.abs() - 0.8).abs() < 1e-12, "{deviation}");
    // G40 returns the tip to the programmed position.
    assert_eq!(at(4), (60.0, 10.0));
}

#[test]
fn tool_orientation_locates_the_tip() {
    // Along Z, up a shoulder, and on along Z: the centre's path is that of a mill.
    for (tip, z, x) in [
        (0, 0.0, 0.0),
        (1, 1.0, -1.0),
        (2, -1.0, -1.0),
        (3, -1.0, 1.0),
        (4, 1.0, 1.0),
        (5, 1.0, 0.0),
        (6, 0.0, -1.0),
        (7, -1.0, 0.0),
        (8, 0.0, 1.0),
        (9, 0.0, 0.0),
    ] {
        let found = moves(&format!(
            "G18 F100\nG0 X10 Z30\nG42.1 D2 L{tip}\nG1 X10 Z20\nZ0\nX30\nZ-20\nG40 Z-29"
        ));
        let end = |index: usize| (found[index].curve.end()[2], found[index].curve.end()[0]);
        assert_eq!(end(1), (20.0 + z, 11.0 + x), "tip {tip}");
        assert_eq!(end(2), (1.0 + z, 11.0 + x), "tip {tip}");
        assert_eq!(end(3), (1.0 + z, 30.0 + x), "tip {tip}");
        let Curve::Arc(corner) = found[4].curve else {
            panic!("tip {tip}: {:?}", found[4]);
        };
        assert_eq!(corner.centre_mm(), [z, 30.0 + x], "tip {tip}");
        assert_eq!(end(5), (-20.0 + z, 31.0 + x), "tip {tip}");
        assert_eq!(end(6), (-29.0, 30.0), "tip {tip}");
    }
}

#[test]
fn orientation_needs_g18_and_is_at_most_9() {
    for (program, code) in [
        ("G17\nG41.1 D2 L2", Code::WrongPlane),
        ("T1 M6\nG41", Code::WrongPlane),
        ("G17\nG42 D1", Code::WrongPlane),
        ("G18\nG42.1 D2 L10", Code::OutOfRange),
    ] {
        assert_eq!(fault(program), (code, 2), "{program}");
    }
}

#[test]
fn tool_0_of_h_and_d_is_the_tool_in_the_spindle() {
    let length = |word: &str| moves(&format!("T3 M6\n{word}\nG0 Z10"))[0].curve.end()[2];
    assert_eq!(length("G43 H0"), 60.0);
    assert_eq!(length("G43.2 H0"), 60.0);
    assert_eq!(length("G43.2 H0\nG43.2 H4"), 80.0);
    assert_eq!(length("G43 H4"), 30.0);
    for word in ["G41 D0", "G41", "G41 D3"] {
        let found = moves(&format!("T3 M6 F100\nG0 X-20\n{word}\nG1 X0\nX20\nG40 X40"));
        assert_eq!(found[1].curve.end()[1], 6.0, "{word}");
        let found = moves("T3 M6 F100\nG0 X-20\nG42 D0\nG1 X0\nX20\nG40 X40");
        assert_eq!(found[1].curve.end()[1], -6.0);
    }
    // Without a tool there is no offset.
    assert_eq!(moves("G43 H0\nG0 Z10")[0].curve.end()[2], 10.0);
}

#[test]
fn g10_of_the_loaded_tool_counts_at_once() {
    let shown = "(DEBUG, #5400 #5403 #5410 #5411 #5412 #5413)\n";
    let text = messages(&format!(
        "T3 M6\n{shown}G10 L1 P3 Z7 R2 I11 J22 Q6\n{shown}G10 L1 P4 Z8 I33\n{shown}G10 L10 P3 Z0\n{shown}"
    ));
    let first = "3.000000 50.000000 12.000000 0.000000 0.000000 0.000000";
    let second = "3.000000 7.000000 4.000000 11.000000 22.000000 6.000000";
    let third = "3.000000 0.000000 4.000000 11.000000 22.000000 6.000000";
    let trimmed: Vec<_> = text.iter().map(|text| text.trim()).collect();
    assert_eq!(trimmed, [first, second, second, third]);
    assert_eq!(fault("T3 M6\nG10 L1 P0 Z1"), (Code::OutOfRange, 2));
}

#[test]
fn outputs_keep_their_position_in_a_contour() {
    let program = |line: &str| {
        format!("G21 G90 F300 G64\nG0 X-20 Y0\nG41.1 D4\nG1 X0 Y5\nX20\n{line}\nY20\nX0\nG40 X-20\nM2\n")
    };
    let expected = moves(&program("(nothing)"));
    // Each takes effect after the move that ends at X20, as without compensation: the fourth, after the
    // rapid, the entry and the arc of its corner.
    let moves_before = 4;
    for line in ["M62 P0", "M63 P0", "M64 P0", "M65 P0", "M67 E0 Q1", "M68 E0 Q1"] {
        let actions = run(&program(line)).unwrap_or_else(|error| panic!("{}", error.render("x")));
        let is_output =
            |action: &Action| matches!(action, Action::Output { .. } | Action::AnalogOutput { .. });
        let index = actions.iter().position(is_output);
        let preceding = actions[..index.unwrap_or_else(|| panic!("{line}"))].iter();
        let count = preceding
            .filter(|action| matches!(action, Action::Move(_)))
            .count();
        assert_eq!(count, moves_before, "{line}");
        assert_eq!(moves(&program(line)), expected, "{line}");
    }
    let exact = moves(&program("G61"));
    assert_eq!(exact.len(), expected.len());
    for (index, (left, right)) in exact.iter().zip(&expected).enumerate() {
        assert_eq!(left.curve, right.curve);
        assert_eq!(
            left.path_mode == right.path_mode,
            index < moves_before,
            "move {index}"
        );
    }
}

#[test]
fn the_tool_leaves_a_contour_straight_up_after_g40() {
    let contour = "G21 G90 F100\nG0 X-20 Y0 Z5\nG0 Z-5\nG41.1 D10\nG1 X0 Y0\nG1 Y50\nG40\n";
    for up in [
        "G0 Z50",
        "G53 G0 Z50",
        "G91 G0 Z55\nG90",
        "G1 Z0\nG0 Z50",
        "G28 Z50",
    ] {
        let steps = moves(&format!("{contour}{up}\nG0 Y60\nG0 X1\nM2\n"));
        let ends: Vec<_> = steps.iter().map(|step| step.curve.end()).collect();
        let at = |index: usize| [ends[index][0], ends[index][1]];
        assert_eq!(at(3), [-5.0, 50.0]);
        for up in 4..ends.len() - 2 {
            assert_eq!(at(up), [-5.0, 50.0], "{ends:?}");
        }
        // The next move in the plane returns to the programmed path in both axes.
        assert_eq!(at(ends.len() - 2), [0.0, 60.0]);
        assert_eq!(at(ends.len() - 1), [1.0, 60.0]);
    }
    // A tool change, a cycle and a zero in between use the programmed position.
    for between in ["T3 M6", "G92 X0 Y50", "G10 L20 P1 X0 Y50"] {
        let steps = moves(&format!("{contour}G0 Z50\n{between}\nG0 Y60\nM2\n"));
        let end = steps.last().map(|step| step.curve.end()).unwrap_or_default();
        assert_eq!([end[0], end[1]], [0.0, 60.0], "{between}");
    }
    let steps = moves(&format!("{contour}G0 Z5\nG81 Y60 Z-1 R2\nG80\nM2\n"));
    let end = steps.last().map(|step| step.curve.end()).unwrap_or_default();
    assert_eq!([end[0], end[1]], [0.0, 60.0]);
    assert_eq!(
        fault(&format!("{contour}G38.2 Z-9\nM2\n")),
        (Code::CompensationActive, 8)
    );
    assert!(run(&format!("{contour}G0 Z50\nG0 X0\nG38.2 Z-9\nM2\n")).is_ok());
    // In the time for the programmed path: 5 mm up in a tenth of a minute.
    let steps = moves(&format!("{contour}G93 G1 Z0 F10\nM2\n"));
    let last = steps.last().map_or(f64::NAN, |step| step.feed_mm_s);
    assert!((last - 50.0 / 60.0).abs() < 1e-9, "{last}");
}

/// The warnings of a program.
fn warnings(program: &str) -> Vec<String> {
    let actions = run(program).unwrap_or_else(|error| panic!("{}\n{program}", error.render("x")));
    let texts = actions.into_iter().filter_map(|action| match action {
        Action::Warning(text) => Some(text),
        _ => None,
    });
    texts.collect()
}

#[test]
fn compensation_without_a_tool_is_a_warning() {
    let contour = "G1 X10 F100\nX20\nG40\nM2\n";
    for code in ["G41", "G42"] {
        let found = warnings(&format!("{code}\n{contour}"));
        assert!(
            matches!(&found[..], [text] if text.contains("no tool is in the spindle")),
            "{found:?}"
        );
    }
    // A tool in the spindle, one named by D, and a given diameter.
    for code in ["T3 M6\nG41", "M61 Q3\nG42", "G41 D4", "G41.1 D0"] {
        assert_eq!(warnings(&format!("{code}\n{contour}")), [""; 0], "{code}");
    }
}
