//! Parts of contours that are narrower than the tool, without being neighbours.

#![expect(clippy::panic, reason = "a test may fail")]

use evolvent_gcode::{Action, Interpreter, Move, Settings, ToolTable};
use evolvent_random::Random;

use crate::cutters::{TOOLS, run};

/// Lines of warnings about contours that are too close to themselves, and the lines that they name.
fn reported_pairs(program: &str) -> Vec<(u32, u32)> {
    let settings = Settings {
        tools: Some(ToolTable::parse(TOOLS).unwrap_or_else(|error| panic!("{error}"))),
        ..Settings::default()
    };
    let commands: Result<Vec<_>, _> = Interpreter::new(program.as_bytes(), settings).collect();
    let commands = commands.unwrap_or_else(|error| panic!("{}\n{program}", error.render("x")));
    assert_eq!(
        commands.last().map(|command| &command.action),
        Some(&Action::ProgramEnd)
    );
    let found = commands.into_iter().filter_map(|command| match command.action {
        Action::Warning(text) => {
            let (_, rest) = text.split_once("contour of line ")?;
            Some((command.line, rest.split(',').next()?.parse().ok()?))
        }
        _ => None,
    });
    found.collect()
}

/// A pocket of two chambers, joined by a throat, from inside; lines 10 and 16 pass the throat.
fn throat(width: f64, tool: f64, side: &str, before: &str, after: &str) -> String {
    let x = 0.5 * width;
    let mut corners = vec![
        (-30.0, -20.0),
        (-30.0, 20.0),
        (-x, 20.0),
        (-x, 40.0),
        (-30.0, 40.0),
        (-30.0, 70.0),
        (30.0, 70.0),
        (30.0, 40.0),
        (x, 40.0),
        (x, 20.0),
        (30.0, 20.0),
        (30.0, -20.0),
        (0.0, -20.0),
    ];
    if side == "G41.1" {
        corners.pop();
        corners.reverse();
        corners.push((0.0, -20.0));
    }
    let mut text = format!("G21 G90 F300\n{before}\n{side} D{tool}\nG1 X-1 Y-8\nG1 X0 Y-20\n");
    for (x, y) in corners {
        text.push_str(&format!("X{x} Y{y}\n"));
    }
    text.push_str(&format!("{after}\nM2\n"));
    text
}

#[test]
fn a_narrow_throat_is_reported_with_both_lines() {
    for side in ["G42.1", "G41.1"] {
        let (before, after) = ("G0 X0 Y0", "G40 X0 Y0");
        for (width, tool) in [(8.0, 10.0), (9.9, 10.0), (0.1, 10.0)] {
            let found = reported_pairs(&throat(width, tool, side, before, after));
            assert_eq!(found.len(), 1, "{side} {width}: {found:?}");
            let (path, edge) = found[0];
            // The walls of the throat, one line beside the other's.
            let mut lines = [path, edge];
            lines.sort_unstable();
            assert!(
                lines[0].abs_diff(9) <= 1 && lines[1].abs_diff(15) <= 1,
                "{side} {width}: {found:?}"
            );
        }
        for (width, tool) in [(10.0, 10.0), (10.5, 10.0), (8.0, 7.9)] {
            assert_eq!(
                reported_pairs(&throat(width, tool, side, before, after)),
                [],
                "{side} {width}"
            );
        }
        // The same at another height; the approach to the contour may be crossed.
        let found = reported_pairs(&throat(8.0, 10.0, side, "G0 X0 Y0\nG0 Z-3", "X0 Y0\nG40 X5"));
        assert_eq!(found.len(), 1, "{side}");
        assert_eq!(
            reported_pairs(&throat(12.0, 10.0, side, before, "X0 Y-10\nX-5 Y0\nG40 X5")),
            [],
            "{side}"
        );
    }
}

/// The pocket of [`throat`] in chords, as CAM systems write contours.
fn in_chords(program: &str, chord: f64) -> String {
    let mut at: Option<[f64; 2]> = None;
    let mut text = String::new();
    for line in program.lines() {
        let corner = line.strip_prefix('X').and_then(|rest| rest.split_once(" Y"));
        let corner: Option<[f64; 2]> = corner.and_then(|(x, y)| Some([x.parse().ok()?, y.parse().ok()?]));
        if let (Some(from), Some(to)) = (at, corner) {
            // An inner corner needs a move of the tool's radius on both sides.
            let length = (to[0] - from[0]).hypot(to[1] - from[1]);
            let (first, last) = (6.0_f64.min(length), (length - 6.0).max(0.0));
            let chords = ((last - first) / chord).ceil().max(0.0) as u32;
            let inner = (0..chords).map(|k| first + (last - first) * f64::from(k) / f64::from(chords));
            for at in inner.chain([last, length]).filter(|at| *at > 0.0) {
                let [x, y] = [0, 1].map(|axis| from[axis] + at / length * (to[axis] - from[axis]));
                text.push_str(&format!("X{x:.4} Y{y:.4}\n"));
            }
        } else {
            text.push_str(line);
            text.push('\n');
        }
        at = corner.or(at.filter(|_| corner.is_some()));
    }
    text
}

#[test]
fn a_narrow_throat_is_found_in_thousands_of_chords() {
    for side in ["G42.1", "G41.1"] {
        let program =
            |width: f64, chord: f64| in_chords(&throat(width, 10.0, side, "G0 X0 Y0", "G40 X0 Y0"), chord);
        for (chord, min_lines) in [(0.1, 2000), (0.02, 10_000)] {
            let narrow = program(8.0, chord);
            assert!(narrow.lines().count() > min_lines);
            assert_eq!(reported_pairs(&narrow).len(), 1, "{side} {chord}");
            assert_eq!(reported_pairs(&program(10.5, chord)), [], "{side} {chord}");
        }
        // Longer ones are not searched, which is said once.
        let settings = Settings {
            tools: Some(ToolTable::parse(TOOLS).unwrap_or_else(|error| panic!("{error}"))),
            ..Settings::default()
        };
        let long = program(8.0, 0.01);
        let commands = Interpreter::new(long.as_bytes(), settings).filter_map(Result::ok);
        let warnings = commands.filter(|command| {
            matches!(&command.action, Action::Warning(text) if text.contains("more than 20000 moves"))
        });
        assert_eq!(warnings.count(), 1, "{side}");
    }
}

/// A disc in many moves takes about as long in arcs as in chords: only nearby moves are compared.
#[test]
fn thousands_of_arcs_cost_about_as_much_as_chords() {
    let seconds = |is_arc: bool| {
        let radius = 80.0;
        let mut text = "G21 G90 F300\nG0 X110 Y-30\nG42.1 D10\nG1 X80 Y-10\nG1 X80 Y0\n".to_owned();
        let moves = 8000;
        let point = |k: u32| {
            let angle = std::f64::consts::TAU * f64::from(k) / f64::from(moves);
            [radius * angle.cos(), radius * angle.sin()]
        };
        for k in 1..=moves {
            let ([from_x, from_y], [x, y]) = (point(k - 1), point(k));
            let word = if is_arc {
                format!("G3 X{x:.6} Y{y:.6} I{:.6} J{:.6}\n", -from_x, -from_y)
            } else {
                format!("G1 X{x:.6} Y{y:.6}\n")
            };
            text.push_str(&word);
        }
        text.push_str("G1 X80 Y10\nG40 G1 X110 Y30\nM2\n");
        let begin = std::time::Instant::now();
        assert_eq!(reported_pairs(&text), [], "arcs: {is_arc}");
        begin.elapsed().as_secs_f64()
    };
    let (chords, arcs) = (seconds(false), seconds(true));
    // Measured 2 to 3; with the boxes of whole circles every arc is compared with every other.
    assert!(arcs < 20.0 * chords, "{arcs} s in arcs, {chords} s in chords");
}

#[test]
fn an_island_too_close_to_the_wall_is_reported() {
    let program = |gap: f64, depth: f64, inner: f64| {
        let (edge, top) = (40.0 - gap, 40.0 + inner);
        format!(
            "G21 G90 F300\nG0 X-10 Y60 Z-1\nG42.1 D10\nG1 X-3 Y72\nG1 X5 Y80\nX40\nY-40\nX-40\nY80\nX5\n\
             G40 Y60\nG0 Z{depth}\nG0 X10 Y65\nG41.1 D10\nG1 X-3 Y55\nG1 X0 Y{edge}\nG2 J-{edge}\n\
             G40 G1 Y65\nG0 X-10 Y60 Z-1\nG42.1 D10\nG1 X-3 Y72\nG1 X5 Y{top}\nX{inner}\nY-{inner}\n\
             X-{inner}\nY{top}\nX5\nG40 Y60\nM2\n"
        )
    };
    // The pocket's path into the island and the island's into the pocket, twice.
    assert_eq!(
        reported_pairs(&program(9.0, -1.0, 39.5)),
        [(17, 7), (7, 17), (24, 17), (17, 24)]
    );
    assert_eq!(reported_pairs(&program(10.2, -1.0, 40.0)), []);
    // The same pocket again, 0.5 inside: not an edge of the part, whatever it crosses.
    assert_eq!(reported_pairs(&program(12.0, -1.0, 39.5)), []);
    assert_eq!(reported_pairs(&program(9.0, -5.0, 39.5)), []);
}

/// A closed contour about the origin, its program, and its points at most 0.15 apart.
fn random_contour(random: &mut Random) -> (String, f64, Vec<[f64; 2]>) {
    let corners = 5 + (9.0 * random.unit()) as usize;
    let radius = random.between(1.0, 6.0);
    let clockwise = random.unit() < 0.5;
    let mut points: Vec<[f64; 2]> = (0..corners)
        .map(|k| {
            let angle = std::f64::consts::TAU * (k as f64 + random.between(-0.3, 0.3)) / corners as f64;
            let distance = random.between(8.0, 45.0);
            [distance * angle.cos(), distance * angle.sin()]
        })
        .collect();
    if clockwise {
        points.reverse();
    }
    // The contour starts in the middle of a line, so that the approach meets no corner.
    let [first, second] = [points[0], points[1]];
    let middle = [0.5 * (first[0] + second[0]), 0.5 * (first[1] + second[1])];
    points.push(first);
    points.push(middle);
    let tangent = [second[0] - first[0], second[1] - first[1]];
    let size = tangent[0].hypot(tangent[1]);
    let tangent = tangent.map(|value| value / size);
    let is_left = random.unit() < 0.5;
    let side = if is_left { 1.0 } else { -1.0 };
    let normal = [-side * tangent[1], side * tangent[0]];
    let reported_pairs = |a: f64, b: f64| {
        [
            middle[0] + a * normal[0] - b * tangent[0],
            middle[1] + a * normal[1] - b * tangent[1],
        ]
    };
    let (start, lead) = (
        reported_pairs(6.0 * radius, 2.0 * radius),
        reported_pairs(3.0 * radius, 3.0 * radius),
    );
    let word = if is_left { "G41.1" } else { "G42.1" };
    let mut text = format!(
        "G21 F600\nG0 X{} Y{}\n{word} D{}\nG1 X{} Y{}\nG1 X{} Y{}\n",
        start[0],
        start[1],
        2.0 * radius,
        lead[0],
        lead[1],
        middle[0],
        middle[1]
    );
    let mut outline = vec![middle];
    let mut at = middle;
    for (index, to) in points.iter().enumerate().skip(1) {
        let delta = [to[0] - at[0], to[1] - at[1]];
        let chord = delta[0].hypot(delta[1]);
        let is_arc = index > 1 && index + 1 < points.len() && random.unit() < 0.4;
        if is_arc {
            // The centre is beside the middle of the chord.
            let offset = random.between(0.3, 2.0) * chord * if random.unit() < 0.5 { 1.0 } else { -1.0 };
            let centre = [
                at[0] + 0.5 * delta[0] - offset * delta[1] / chord,
                at[1] + 0.5 * delta[1] + offset * delta[0] / chord,
            ];
            // The shorter arc: counter-clockwise with the centre on the left.
            let word = if offset > 0.0 { "G3" } else { "G2" };
            text.push_str(&format!(
                "{word} X{} Y{} I{} J{}\n",
                to[0],
                to[1],
                centre[0] - at[0],
                centre[1] - at[1]
            ));
            let angle = |point: &[f64; 2]| (point[1] - centre[1]).atan2(point[0] - centre[0]);
            let (from, size) = (angle(&at), (at[0] - centre[0]).hypot(at[1] - centre[1]));
            let sweep =
                (offset.signum() * (angle(to) - from)).rem_euclid(std::f64::consts::TAU) * offset.signum();
            let steps = (sweep.abs() * size / 0.15).ceil();
            for step in 1..=steps as u32 {
                let angle = from + sweep * f64::from(step) / steps;
                outline.push([centre[0] + size * angle.cos(), centre[1] + size * angle.sin()]);
            }
        } else {
            text.push_str(&format!("G1 X{} Y{}\n", to[0], to[1]));
            outline.push(*to);
        }
        at = *to;
    }
    let out = reported_pairs(6.0 * radius, 0.0);
    text.push_str(&format!("G40 G1 X{} Y{}\nM2\n", out[0], out[1]));
    (text, radius, outline)
}

/// Distance of a point from a polyline.
fn distance_to(outline: &[[f64; 2]], point: [f64; 2]) -> f64 {
    let squares = outline.windows(2).map(|ends| {
        let chord = [ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]];
        let to = [point[0] - ends[0][0], point[1] - ends[0][1]];
        let square = chord[0] * chord[0] + chord[1] * chord[1];
        let at = if square > 0.0 {
            ((to[0] * chord[0] + to[1] * chord[1]) / square).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (to[0] - at * chord[0]).powi(2) + (to[1] - at * chord[1]).powi(2)
    });
    squares.fold(f64::INFINITY, f64::min).sqrt()
}

/// An open contour, its program with straight moves to it and away, and points at most 0.15 apart.
fn random_open_contour(random: &mut Random) -> (String, f64, Vec<Vec<[f64; 2]>>) {
    let radius = random.between(1.0, 5.0);
    let word = if random.unit() < 0.5 { "G41.1" } else { "G42.1" };
    let mut heading = random.between(-3.0, 3.0);
    let step =
        |at: [f64; 2], heading: f64, size: f64| [at[0] + size * heading.cos(), at[1] + size * heading.sin()];
    let start = step([0.0; 2], heading, -3.0 * radius);
    let mut text = format!(
        "G21 F600\nG0 X{} Y{}\n{word} D{}\nG1 X0 Y0\n",
        start[0],
        start[1],
        2.0 * radius
    );
    let (mut at, mut pieces) = ([0.0; 2], vec![vec![start, [0.0; 2]]]);
    for piece in 0..5 + (6.0 * random.unit()) as usize {
        if piece > 0 {
            heading += random.between(-2.2, 2.2);
        }
        // First and last are lines, because arcs next to the approach count as part of it.
        if random.unit() < 0.35 && (1..5).contains(&piece) {
            let (size, sweep) = (random.between(0.3, 5.0) * radius, random.between(-3.0, 3.0));
            let centre = step(at, heading + 0.5 * std::f64::consts::PI * sweep.signum(), size);
            let from = (at[1] - centre[1]).atan2(at[0] - centre[0]);
            let steps = (sweep.abs() * size / 0.15).ceil();
            let points: Vec<_> = (0..=steps as u32)
                .map(|k| step(centre, from + sweep * f64::from(k) / steps, size))
                .collect();
            let (code, to) = (if sweep > 0.0 { "G3" } else { "G2" }, points[points.len() - 1]);
            text.push_str(&format!(
                "{code} X{} Y{} I{} J{}\n",
                to[0],
                to[1],
                centre[0] - at[0],
                centre[1] - at[1]
            ));
            (at, heading) = (to, heading + sweep);
            pieces.push(points);
        } else {
            let to = step(at, heading, random.between(1.0, 9.0) * radius);
            text.push_str(&format!("G1 X{} Y{}\n", to[0], to[1]));
            pieces.push(vec![at, to]);
            at = to;
        }
    }
    let out = step(at, heading, 3.0 * radius);
    text.push_str(&format!("G40 G1 X{} Y{}\nM2\n", out[0], out[1]));
    (text, radius, pieces)
}

/// The moves without the rapid, the approach, and the last one, which is not compensated.
fn moves_beside(actions: &[Action]) -> Vec<Move> {
    let steps = actions.iter().filter_map(|action| match action {
        Action::Move(step) => Some(*step),
        _ => None,
    });
    let mut steps: Vec<Move> = steps.skip(2).collect();
    steps.pop();
    steps
}

/// The minimum over points 0.1 mm apart on these moves.
fn min_distance(steps: &[Move], distance: impl Fn([f64; 2]) -> f64) -> f64 {
    let points = steps.iter().flat_map(|step| {
        let length = step.curve.length();
        let count = (length / 0.1).ceil().max(1.0) as u32;
        (0..=count).map(move |k| step.curve.jet(length * f64::from(k) / f64::from(count)).position)
    });
    points
        .map(|point| distance([point[0], point[1]]))
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn a_second_lap_is_not_compared_with_the_first() {
    // A rectangle, then a second lap that cuts one of its corners: intended, with any tool.
    let lap = "Y50\nX80\nY0\nX0\n";
    let program = |second: &str| {
        format!("G21 G90 G17\nT3 M6\nG0 X-20 Y-20\nF1000\nG41 D3 G1 X0\n{lap}{second}X-20\nG40 X-40\nM2\n")
    };
    assert_eq!(reported_pairs(&program("Y50\nX70\nX80 Y40\nY0\n")), []);
    assert_eq!(reported_pairs(&program("Y50\nX80\nY0\n")), []);
    // The move away still counts: it crosses the part.
    assert_ne!(reported_pairs(&program("Y50\nX40\nX40 Y20\n")), []);
}

#[test]
fn random_open_contours_report_sampled_cuts() {
    let mut random = Random::mixed(20_261_124);
    let (mut cut, mut clean, mut rejected) = (0, 0, 0);
    for _ in 0..2000 {
        let (program, radius, pieces) = random_open_contour(&mut random);
        let Ok(actions) = run(&program) else {
            rejected += 1;
            continue;
        };
        let steps = moves_beside(&actions);
        let is_warned = actions.iter().any(|action| matches!(action, Action::Warning(_)));
        let depth = |pieces: &[Vec<[f64; 2]>]| {
            let distance = min_distance(&steps, |point| {
                let distances = pieces.iter().map(|piece| distance_to(piece, point));
                distances.fold(f64::INFINITY, f64::min)
            });
            radius - distance
        };
        // The last edge and the arcs before it may lead away as far as the program shows.
        let lead_out = pieces
            .iter()
            .rev()
            .skip(1)
            .take_while(|piece| piece.len() > 2)
            .count();
        let lead_in = pieces.iter().skip(1).take_while(|piece| piece.len() > 2).count();
        let certain_edges = &pieces[1 + lead_in..pieces.len() - 1 - lead_out];
        if depth(certain_edges) > 0.02 + 0.002 * radius {
            assert!(
                is_warned,
                "{} deep without a warning\n{program}",
                depth(certain_edges)
            );
            cut += 1;
        } else if depth(&pieces[1..]) < 0.005 {
            assert!(!is_warned, "nothing is cut\n{program}");
            clean += 1;
        }
    }
    assert!(
        cut > 100 && clean > 100,
        "{cut} cut, {clean} clean, {rejected} refused"
    );
}

#[test]
fn random_closed_contours_report_sampled_cuts() {
    let mut random = Random::mixed(20_261_123);
    let (mut cut, mut clean, mut rejected) = (0, 0, 0);
    for _ in 0..1000 {
        let (program, radius, outline) = random_contour(&mut random);
        let Ok(actions) = run(&program) else {
            rejected += 1;
            continue;
        };
        let steps = moves_beside(&actions);
        let is_warned = actions.iter().any(|action| matches!(action, Action::Warning(_)));
        let depth = radius - min_distance(&steps, |point| distance_to(&outline, point));
        if depth > 0.02 + 0.002 * radius {
            assert!(is_warned, "{depth} deep without a warning\n{program}");
            cut += 1;
        } else if depth < 0.005 {
            assert!(!is_warned, "nothing is cut\n{program}");
            clean += 1;
        }
    }
    assert!(
        cut > 100 && clean > 100,
        "{cut} cut, {clean} clean, {rejected} refused"
    );
}
