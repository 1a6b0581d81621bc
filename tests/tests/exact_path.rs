//! Setpoints are on the programmed curves, and the chords between them keep the chord error: measured in the
//! trace, with formulas independent of the crates under test.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "helpers of tests fail and talk as tests do"
)]

use std::fs;
use std::path::Path;

use evolvent_tests::{Cycle, Hole, Launch, Piece, Workshop, cycles, repository, run};
use evolvent_trace::TraceFile;

/// Runs a program with the virtual clock and returns its curves and cycles. The lengths of the blocks in the
/// trace are those of the curves.
fn run_exact(workshop: &Workshop, program: &Path, machine: &Path) -> (Hole, Vec<Cycle>) {
    let trace = workshop.path("run.mcap");
    Launch::in_virtual_time(program, machine)
        .trace(&trace)
        .finish()
        .expect_code(&[0]);
    let hole = Hole::read(&fs::read_to_string(program).expect("the program"));
    let mut file = TraceFile::open(&trace).expect("the trace");
    for block in file.blocks().map(|block| block.expect("a block")) {
        let length = hole.pieces[&block.line].length();
        let miss = (block.length_mm - length).abs();
        assert!(
            miss <= 1e-12 * length.max(100.0),
            "line {}: {} mm for {length} mm",
            block.line,
            block.length_mm
        );
    }
    (hole, cycles(&trace))
}

const fn xy(cycle: &Cycle) -> [f64; 2] {
    [cycle.position[0], cycle.position[1]]
}

/// The maximum distance of a setpoint from its curve, and the maximum chord error, each with its line; only
/// for circles and involutes.
fn worst(hole: &Hole, cycles: &[Cycle]) -> ((f64, u32), (f64, u32)) {
    let (mut off, mut chord) = ((0.0, 0), (0.0, 0));
    let mut count = 0;
    for pair in cycles.windows(2) {
        let Some(piece) = hole.pieces.get(&pair[1].line).filter(|piece| piece.is_curved()) else {
            continue;
        };
        count += 1;
        let distance = piece.distance(xy(&pair[1]));
        if distance > off.0 {
            off = (distance, pair[1].line);
        }
        // The setpoint before the first of a curve is on the previous curve.
        let error = if pair[0].line == pair[1].line {
            piece.chord_error(xy(&pair[0]), xy(&pair[1]))
        } else {
            0.0
        };
        if error > chord.0 {
            chord = (error, pair[1].line);
        }
    }
    assert!(count > 100, "only {count} setpoints on curves");
    (off, chord)
}

#[track_caller]
fn assert_exact(hole: &Hole, cycles: &[Cycle], permitted_mm: f64) {
    let (off, chord) = worst(hole, cycles);
    println!(
        "off the curve {:e} mm (line {}), chord error {:e} mm (line {})",
        off.0, off.1, chord.0, chord.1
    );
    assert!(
        off.0 <= 1e-9,
        "a setpoint of line {} is {:e} mm off its curve",
        off.1,
        off.0
    );
    assert!(
        chord.0 <= permitted_mm,
        "a chord of line {} is {:e} mm off its curve",
        chord.1,
        chord.0
    );
    let last = cycles.last().expect("setpoints");
    for axis in 0..3 {
        let miss = (last.position[axis] - hole.end[axis]).abs();
        assert!(miss <= 1e-9, "axis {axis} ends {miss:e} mm off");
    }
    // The distance along the path is counted in the planner's regular parameter. It is arc length except
    // where an involute leaves its base circle: there it exceeds arc length, by a sixth of the radius of the
    // circle in total.
    let ahead_mm: f64 = hole.pieces.values().map(Piece::base_radius_touched).sum::<f64>() / 5.0;
    let (reported_mm, length) = (last.path_mm, hole.length());
    assert!(
        (-1e-6..=ahead_mm + 1e-6).contains(&(reported_mm - length)),
        "{reported_mm} mm of path for {length} mm"
    );
}

/// The hole of the examples in the paper: 200 mm, tool 40 mm, 20 turns of 3.95 mm.
#[test]
fn setpoints_of_the_papers_hole_are_within_1_nm() {
    let workshop = Workshop::new();
    let machine = workshop.mill("exact", &[]);
    let (hole, cycles) = run_exact(
        &workshop,
        &repository().join("tests/programs/bore-200.ngc"),
        &machine,
    );
    // Table 2 of the paper: lengths of the roughing involute and of the circle that ends it.
    let lengths: Vec<f64> = hole
        .pieces
        .values()
        .filter(|piece| piece.is_curved())
        .map(Piece::length)
        .collect();
    assert!((lengths[0] - 4_963.716_39).abs() < 5e-6, "{}", lengths[0]);
    assert!((lengths[1] - 496.371_639).abs() < 5e-7, "{}", lengths[1]);
    assert_exact(&hole, &cycles, 0.001);
}

/// Holes of other sizes, milled in both directions, at other positions, on finer and coarser grids: at the
/// rational rate no chord is farther from its curve than one increment.
#[test]
fn rational_rate_chords_stay_within_one_increment() {
    let holes: [(&str, &[&str]); 4] = [
        (
            "1000",
            &[
                "--hole",
                "60",
                "--tool",
                "20",
                "--pitch",
                "1.5",
                "--allowance",
                "0.3",
                "--finish",
            ],
        ),
        (
            "200",
            &[
                "--hole",
                "90",
                "--tool",
                "16",
                "--pitch",
                "5",
                "--conventional",
                "--center",
                "30,-20",
            ],
        ),
        (
            "10000",
            &[
                "--hole",
                "30",
                "--tool",
                "8",
                "--pitch",
                "0.7",
                "--finish",
                "--allowance",
                "0.1",
            ],
        ),
        (
            "1000",
            &["--hole", "300", "--tool", "12", "--pitch", "9", "--feed", "30000"],
        ),
    ];
    for (increments, options) in holes {
        let workshop = Workshop::new();
        let grid = format!("increments_per_mm = {increments}   ");
        let machine = workshop.mill("chords", &[("increments_per_mm = 1000", &grid)]);
        let written = run(["bore"].iter().chain(options)).expect_code(&[0]);
        let program = workshop.write("hole.ngc", written.out);
        let (hole, cycles) = run_exact(&workshop, &program, &machine);
        println!("{options:?} at {increments} increments a mm");
        let increment_mm = 1.0 / increments.parse::<f64>().expect("a number");
        assert_exact(&hole, &cycles, increment_mm);
    }
}

/// Circles at a feed that no axis can keep: the slow ones are limited by the chord error, the fast ones by
/// acceleration, and those near the rational radius by both.
#[test]
fn circles_at_the_greatest_feed_keep_the_chord_error() {
    let workshop = Workshop::new();
    let machine = workshop.mill("circles", &[]);
    let radii = [0.01, 0.05, 0.2, 1.0, 3.0, 10.0, 30.0, 100.0];
    let circles = radii
        .map(|radius| format!("G1 X{radius} Y0\nG3 X{radius} Y0 I-{radius} J0\n"))
        .concat();
    let program = workshop.write(
        "circles.ngc",
        format!("G17 G21 G90 G94\nG61\nF30000\n{circles}M30\n"),
    );
    let (hole, cycles) = run_exact(&workshop, &program, &machine);
    assert_exact(&hole, &cycles, 0.001);
}

/// Tests the measurement itself: with half the control rate and a larger chord error allowed in the file, the
/// test above must fail.
#[test]
fn a_chord_error_that_is_too_great_is_seen() {
    let workshop = Workshop::new();
    let wide = "[path]\nchord_error_increments = 40\n";
    let machine = workshop.mill(
        "wide",
        &[("rate = \"rational\"", "rate = 250"), ("[path]\n", wide)],
    );
    let program = workshop.write(
        "circle.ngc",
        "G17 G21 G90 G94\nG61\nF30000\nG1 X30 Y0\nG3 X30 Y0 I-30 J0\nM30\n",
    );
    let (hole, cycles) = run_exact(&workshop, &program, &machine);
    let (off, chord) = worst(&hole, &cycles);
    assert!(off.0 <= 1e-9, "{off:?}");
    // The sagitta is a/8f^2 for the acceleration a across the path: 10 um for the limit of one axis, up to
    // sqrt(2) times that if two axes contribute.
    assert!((0.005..0.01415).contains(&chord.0), "{chord:?}");
}
