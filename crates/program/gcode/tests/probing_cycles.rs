//! The shipped probing cycles on simulated surfaces: a ball on a stylus that stops shortly after each
//! contact.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::Path;

use evolvent_gcode::{Action, Diagnostic, Interpreter, Settings, Tool, ToolChanger, ToolTable};
use evolvent_path::Axes;
use evolvent_random::Random;

use crate::interpreted::errors;

/// Distance that the ball moves after contact, mm.
const OVERTRAVEL: f64 = 0.08;

/// The distance from a point to a surface, negative inside of it.
type Surface = Box<dyn Fn(&[f64; 3]) -> f64>;

/// The result of a program.
struct Probed {
    error: Option<Diagnostic>,
    contacts: usize,
    /// Maximum depth of the ball in the part during a move that does not probe, mm.
    deepest: f64,
    end: Axes,
    values: Vec<f64>,
    table: ToolTable,
}

fn xyz(at: &Axes) -> [f64; 3] {
    [at[0], at[1], at[2]]
}

/// A machine with tool 4 in the spindle, and the shipped cycles.
fn mill(start: [f64; 3]) -> Settings {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/probing");
    let mut tool = Tool::new(4);
    tool.offset[2] = 99.0;
    Settings {
        subroutine_folders: vec![folder],
        start: Axes::from_fn(|i, _| if i < 3 { start[i] } else { 0.0 }),
        tool: 4,
        tools: Some(ToolTable::new(vec![tool])),
        ..Settings::default()
    }
}

fn probe(program: &str, start: [f64; 3], radius: f64, surface: &Surface) -> Probed {
    probe_on(mill(start), program, radius, surface)
}

/// Runs a program whose probe is a ball; machine coordinates are those of its centre.
fn probe_on(settings: Settings, program: &str, radius: f64, surface: &Surface) -> Probed {
    let touches = |at: &Axes| surface(&xyz(at)) <= radius;
    let mut interpreter = Interpreter::new(program.as_bytes(), settings);
    let mut probed = Probed {
        error: None,
        contacts: 0,
        deepest: 0.0,
        end: Axes::zeros(),
        values: Vec::new(),
        table: ToolTable::default(),
    };
    while let Some(command) = interpreter.next() {
        let command = match command {
            Ok(command) => command,
            Err(error) => {
                probed.error = Some(error);
                break;
            }
        };
        match command.action {
            Action::Move(step) => {
                let length = step.curve.length();
                for k in 0..=200 {
                    let at = step.curve.position(length * f64::from(k) / 200.0);
                    probed.deepest = probed.deepest.max(radius - surface(&xyz(&at)));
                }
                // After a contact the ball is still in the part by the overtravel.
                probed.end = step.curve.end();
            }
            Action::Probe { curve, .. } => {
                let length = curve.length();
                assert!(!touches(&curve.start()), "tripped before line {}", command.line);
                let steps = 4000;
                let first =
                    (1..=steps).find(|k| touches(&curve.position(length * f64::from(*k) / f64::from(steps))));
                let Some(first) = first else {
                    assert!(interpreter.set_probe_result(&curve.end(), &curve.end(), false));
                    continue;
                };
                let (mut low, mut high) = (f64::from(first - 1), f64::from(first));
                for _ in 0..60 {
                    let middle = (low + high) / 2.0;
                    if touches(&curve.position(length * middle / f64::from(steps))) {
                        high = middle;
                    } else {
                        low = middle;
                    }
                }
                let at = length * high / f64::from(steps);
                let stop_position = curve.position((at + OVERTRAVEL).min(length));
                probed.contacts += 1;
                assert!(interpreter.set_probe_result(&curve.position(at), &stop_position, true));
            }
            Action::Print(text) => {
                let words = text.split_whitespace();
                probed
                    .values
                    .extend(words.map(|word| word.parse::<f64>().expect("a number")));
            }
            _ => {}
        }
    }
    probed.table = interpreter.tools().expect("a table").clone();
    probed
}

#[track_caller]
fn assert_near(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len(), "{found:?}");
    for (found, expected) in found.iter().zip(expected) {
        // Values are printed with six decimals.
        assert!((found - expected).abs() <= 2e-6, "{found:?} is not {expected:?}");
    }
}

/// One of two.
fn either<T>(random: &mut Random, one: T, other: T) -> T {
    if random.unit() < 0.5 { one } else { other }
}

#[test]
fn probing_cycles_work_in_all_units_and_modes() {
    let mut random = Random::new();
    for _ in 0..40 {
        let corner = [random.between(-3.0, 3.0), random.between(-3.0, 3.0)];
        let signs = [0, 1].map(|_| either(&mut random, 1.0, -1.0));
        let tip_diameter = random.between(0.5, 4.0);
        // The part is where both coordinates are beyond the corner.
        let surface: Surface = Box::new(move |at| {
            let beyond = [0, 1].map(|axis| signs[axis] * (corner[axis] - at[axis]));
            match (beyond[0] > 0.0, beyond[1] > 0.0) {
                (true, true) => beyond[0].hypot(beyond[1]),
                _ => beyond[0].max(beyond[1]),
            }
        });
        let start = [corner[0] - signs[0] * 10.0, corner[1] - signs[1] * 10.0, 0.0];
        let (code, unit) = either(&mut random, ("G21", 1.0), ("G20", 25.4));
        let distance_mode = either(&mut random, "G90", "G91");
        // Paths and results are radii, also in G7.
        let radius = either(&mut random, "G7", "G8");
        let zero = [0, 1].map(|_| random.between(-20.0, 20.0));
        let words = [signs[0] * 20.0, signs[1] * 20.0, tip_diameter, 200.0, 30.0, 1.0]
            .map(|word| format!("[{}]", word / unit));
        let program = format!(
            "G21 G10 L2 P2 X{} Y{}\nG55\n{code} {distance_mode} {radius} F7\no<probe_corner> call {}\n\
             (PRINT,%.6f#<_probe_x> %.6f#<_probe_y>)\nM2\n",
            zero[0],
            zero[1],
            words.join(" ")
        );
        let probed = probe(&program, start, tip_diameter / 2.0, &surface);
        assert!(probed.error.is_none(), "{:?}\n{program}", probed.error);
        let found: Vec<f64> = probed.values.iter().map(|value| value * unit).collect();
        for axis in 0..2 {
            let error = found[axis] - (corner[axis] - zero[axis]);
            assert!(error.abs() <= 3e-5, "{error} of {found:?}\n{program}");
        }
        assert_eq!(probed.contacts, 4);
        assert!(probed.deepest <= OVERTRAVEL + 1e-9, "{}", probed.deepest);
        assert!((probed.end - Axes::from_fn(|i, _| if i < 3 { start[i] } else { 0.0 })).norm() < 1e-9);
    }
}

#[test]
fn bores_and_bosses_are_found_from_off_centre() {
    let mut random = Random::new();
    for _ in 0..40 {
        let centre = [random.between(-2.0, 2.0), random.between(-2.0, 2.0)];
        let diameter = random.between(20.0, 40.0);
        let tip_diameter = random.between(0.5, 4.0);
        let expected = [centre[0], centre[1], diameter];
        let bore: Surface = Box::new(move |at| diameter / 2.0 - (at[0] - centre[0]).hypot(at[1] - centre[1]));
        let program = format!(
            "G21 F10\no<probe_bore> call [{diameter}] [{tip_diameter}] [300] [50] [1]\n\
             (PRINT,%.6f#<_probe_x> %.6f#<_probe_y> %.6f#<_probe_diameter>)\nM2\n"
        );
        let probed = probe(&program, [0.0; 3], tip_diameter / 2.0, &bore);
        assert!(probed.error.is_none(), "{:?}", probed.error);
        assert_near(&probed.values, &expected);
        assert!((probed.end[0] - centre[0]).abs() < 1e-6 && (probed.end[1] - centre[1]).abs() < 1e-6);
        assert_eq!(probed.contacts, 12);
        // A boss with a flat top at Z0, and the ball 5 mm above it.
        let boss: Surface = Box::new(move |at| {
            let out = (at[0] - centre[0]).hypot(at[1] - centre[1]) - diameter / 2.0;
            if out > 0.0 && at[2] > 0.0 {
                out.hypot(at[2])
            } else {
                out.max(at[2])
            }
        });
        let program = format!(
            "G21 F10\no<probe_boss> call [{diameter}] [6] [9] [{tip_diameter}] [300] [50] [1]\n\
             (PRINT,%.6f#<_probe_x> %.6f#<_probe_y> %.6f#<_probe_diameter>)\nM2\n"
        );
        let probed = probe(&program, [0.0, 0.0, 5.0], tip_diameter / 2.0, &boss);
        assert!(probed.error.is_none(), "{:?}", probed.error);
        assert_near(&probed.values, &expected);
        assert_eq!(probed.end[2], 5.0);
        assert!(probed.deepest <= OVERTRAVEL + 1e-9, "{}", probed.deepest);
    }
}

#[test]
fn a_tool_length_is_measured() {
    // The tip of a tool of 73.25 mm touches a sensor whose height the spindle itself would reach at Z-200.
    let surface: Surface = Box::new(|at| at[2] - (-200.0 + 73.25));
    for (offset, code) in [("", "G21"), ("G10 L2 P1 Z-31\n", "G20"), ("G92 Z4\n", "G21")] {
        let program = format!(
            "G21\n{offset}G43 H4\n{code}\no<probe_tool> call [-200] [150] [300] [20] [2]\n\
             (PRINT,%.6f#<_probe_length>)\nM2\n"
        );
        for parameters_in_inches in [false, true] {
            let mut settings = mill([0.0, 0.0, -20.0]);
            settings.parameters_in_inches = parameters_in_inches;
            let probed = probe_on(settings, &program, 0.0, &surface);
            assert!(probed.error.is_none(), "{:?}", probed.error);
            assert_near(&probed.values, &[73.25]);
            let length = probed.table.get(4).expect("the tool").offset[2];
            assert!((length - 73.25).abs() < 1e-9, "{length}");
            assert_eq!(probed.contacts, 2);
        }
    }
}

/// During the change #5400 is still the previous tool.
#[test]
fn a_tool_being_fetched_is_measured_for_its_line() {
    let surface: Surface = Box::new(|at| at[2] - (-200.0 + 73.25));
    let run = |argument: &str| {
        let change = format!("G21 G90\no<probe_tool> call [-200] [150] [300] [20] [2]{argument}\n");
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("toolchange.ngc"), change).expect("a file");
        let mut settings = mill([0.0, 0.0, -20.0]);
        settings.subroutine_folders.push(folder.path().to_owned());
        settings.tools = ToolTable::parse("T4 P4 Z99\nT5 P5 Z50\n").ok();
        settings.features.tool_change = Some(ToolChanger {
            subroutine: "toolchange".to_owned(),
            is_random: false,
        });
        // As after every other change of a program.
        probe_on(
            settings,
            "G21 G10 L2 P1 Z-31\nG43 H4\nT5 M6\n(PRINT,%.0f#<_remap_level>)\nM2\n",
            0.0,
            &surface,
        )
    };
    let probed = run(" [#1]");
    assert!(probed.error.is_none(), "{:?}", probed.error);
    let lengths = [4, 5].map(|tool| probed.table.get(tool).expect("a tool").offset[2]);
    assert_eq!(lengths[0], 99.0);
    assert!((lengths[1] - 73.25).abs() < 1e-9, "{lengths:?}");
    assert_eq!(probed.values, [0.0]);
    let error = run("").error.expect("an error");
    assert!(error.message.contains("the number of the new tool"), "{error:?}");
}

#[test]
fn cycles_report_missing_contacts_and_invalid_arguments() {
    let nothing: Surface = Box::new(|_| 1e3);
    let everything: Surface = Box::new(|at| at[2] - 3.0);
    for (call, surface, word) in [
        (
            "o<probe_edge> call [3] [5] [1] [100] [10] [1]",
            &nothing,
            "probe_edge: axis 3",
        ),
        (
            "o<probe_edge> call [0] [0] [1] [100] [10] [1]",
            &nothing,
            "probe_touch: way",
        ),
        (
            "o<probe_bore> call [0] [1] [100] [10] [1]",
            &nothing,
            "probe_bore",
        ),
        (
            "o<probe_boss> call [20] [0] [5] [1] [100] [10] [1]",
            &nothing,
            "probe_boss",
        ),
        (
            "o<probe_boss> call [20] [4] [8] [1] [100] [10] [1]",
            &everything,
            "on the way down",
        ),
        ("o<probe_tool> call [-1] [0] [100] [10] [1]", &nothing, "way down"),
    ] {
        let probed = probe(&format!("G21\n{call}\nM2\n"), [0.0, 0.0, 5.0], 0.5, surface);
        let error = probed.error.expect("an error");
        assert!(error.message.contains(word), "{call}: {error:?}");
        assert!(error.file.is_some_and(|file| file.contains("probe_")));
    }
}

#[test]
fn a_probe_end_without_result_may_be_probed_again() {
    let found = errors("F100 G90\nG38.3 Z-5\nG38.5 Z-5\nG38.3 X2\nG38.5 X2\n");
    assert!(found.is_empty(), "{found:?}");
    // Without a probing move before, it is an error.
    assert_eq!(errors("F100 G90\nG0 Z-5\nG38.5 Z-5\n").len(), 1);
}
