//! Excess of the duration of plans over the optimum: `cargo bench -p evolvent-timing --bench optimum`.
#![allow(
    missing_docs,
    clippy::print_stdout,
    clippy::print_stderr,
    clippy::expect_used,
    reason = "a benchmark prints"
)]

#[path = "../tests/common/mod.rs"]
mod common;
mod oracle;

use common::{Path, axes, circle, helix, involute, point, relaxation, square, turned};
use evolvent_path::{Arc, Axes, Blend, Curve, Line, Plane, Sense};
use evolvent_timing::{Entry, Exit, Grid, MAX_INTERVALS, Optimizer, PathPosition, TimeLawPiece};
use evolvent_verifier::butterfly_point;

/// Minimum number of stations of the other method per curve.
const EACH: usize = 160;

fn main() {
    let filter = std::env::args()
        .skip(1)
        .find(|x| !x.starts_with('-'))
        .unwrap_or_default();
    let sets = [(200.0, 2000.0, 5e4), (500.0, 5000.0, 1e6), (100.0, 5000.0, 5e4)];
    let mut all = Vec::new();
    for degrees in [0.0, 30.0, 45.0] {
        let corner = |x: f64, y: f64| turned(point(x, y, 0.0), degrees);
        let paths: Vec<(&str, Path)> = vec![
            (
                "line 1",
                Path::polyline(&[corner(0.0, 0.0), corner(1.0, 0.0)], 0.02, f64::INFINITY),
            ),
            (
                "line 50",
                Path::polyline(&[corner(0.0, 0.0), corner(50.0, 0.0)], 0.02, f64::INFINITY),
            ),
            (
                "corner 90",
                Path::polyline(
                    &[corner(0.0, 0.0), corner(10.0, 0.0), corner(10.0, 10.0)],
                    0.02,
                    f64::INFINITY,
                ),
            ),
            (
                "corner 150",
                Path::polyline(
                    &[corner(0.0, 0.0), corner(10.0, 0.0), corner(1.34, 5.0)],
                    0.02,
                    f64::INFINITY,
                ),
            ),
            ("square 0.1", square(0.1, 0.02, degrees)),
            ("square 1", square(1.0, 0.02, degrees)),
            ("square 10", square(10.0, 0.02, degrees)),
            ("circle 0.25", circle(0.25, degrees)),
            ("circle 10", circle(10.0, degrees)),
            ("circle 100", circle(100.0, degrees)),
            ("helix", helix(5.0, 2.0, 2, degrees)),
            ("involute", involute(1.0, 1.5, degrees)),
            ("involute 20", involute(0.5, 20.0, degrees)),
            ("line-arc-line", line_arc_line(degrees)),
            ("butterfly 200", butterfly(200, degrees)),
        ];
        for (name, path) in paths {
            if !format!("{name} {degrees}").contains(&filter) {
                continue;
            }
            let each = match name {
                "involute 20" => 1600,
                "butterfly 200" => 12,
                _ => EACH,
            };
            for (v, a, j) in sets {
                let limits = axes(3, v, a, j);
                let ours = whole(&path, &limits);
                let receding = receding(&path, &limits);
                let pieces = ours.as_ref().map(|x| x.3.as_slice());
                let near = oracle::optimum(
                    &path,
                    &limits,
                    each,
                    pieces.or(receding.as_ref().map(|x| x.1.as_slice())),
                );
                // From another start, if that converges.
                let other = oracle::optimum(&path, &limits, each, None);
                let exact = name.starts_with("line ").then(|| {
                    // On a rotated line the limits are those of the axis with the largest component.
                    let (sin, cos) = f64::to_radians(degrees).sin_cos();
                    let fraction = sin.max(cos);
                    (line(path.length(), v / fraction, a / fraction, j / fraction), 0)
                });
                let best = (near.iter().chain(&other).chain(&exact)).min_by(|a, b| a.0.total_cmp(&b.0));
                let (Some((best, n)), Some((receding, _))) = (best, &receding) else {
                    println!(
                        "{name:12} {degrees:3} {v} {a} {j:e}: no {} {}",
                        best.is_none(),
                        receding.is_none()
                    );
                    continue;
                };
                let (ours, stations, steps) = ours.map_or((f64::NAN, 0, 0), |x| (x.0, x.1, x.2));
                println!(
                    "{name:12} {degrees:3} {v} {a} {j:e}: optimum {best:.5} ({n}, {:.5})  whole {:.4} \
                     ({stations} stations, {steps} steps)  receding {:.4}",
                    other.map_or(f64::NAN, |x| x.0),
                    ours / best,
                    receding / best
                );
                all.push((ours / best, receding / best));
            }
        }
    }
    for (name, pick) in [("whole", 0), ("receding", 1)] {
        let mut ratios: Vec<f64> = (all.iter().map(|x| if pick == 0 { x.0 } else { x.1 }))
            .filter(|ratio| ratio.is_finite())
            .collect();
        ratios.sort_by(f64::total_cmp);
        if let (Some(middle), Some(worst)) = (ratios.get(ratios.len() / 2), ratios.last()) {
            println!("{name}: median {middle:.4}, worst {worst:.4} of {}", ratios.len());
        }
    }
}

/// The minimum time of a straight line from rest to rest, in closed form: the profile is symmetric, each half
/// a change of speed at the jerk limit, at the acceleration limit if that is reached, with the maximum speed
/// in between.
fn line(length: f64, v: f64, a: f64, j: f64) -> f64 {
    // The change to v takes 2 sqrt(v / j), or v / a + a / j if a is reached, at an average of v / 2.
    let change = |v: f64| {
        if v * j <= a * a {
            2.0 * (v / j).sqrt()
        } else {
            v / a + a / j
        }
    };
    if v * change(v) <= length {
        return 2.0 * change(v) + (length - v * change(v)) / v;
    }
    let (mut low, mut high) = (0.0, v);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if middle * change(middle) <= length {
            low = middle;
        } else {
            high = middle;
        }
    }
    2.0 * change(low)
}

/// Two lines with a quarter circle between them, whose tangent joints are smoothed over a millimetre.
fn line_arc_line(degrees: f64) -> Path {
    let at = |x: f64, y: f64| turned(point(x, y, 0.0), degrees);
    let centre = at(20.0, 5.0);
    let arc = Arc::new(
        Plane::Xy,
        at(20.0, 0.0),
        at(25.0, 5.0),
        [centre[0], centre[1]],
        Sense::CounterClockwise,
        0,
    );
    let curves: [Curve; 3] = [
        Line::new(at(0.0, 0.0), at(20.0, 0.0)).expect("line").into(),
        arc.expect("arc").into(),
        Line::new(at(25.0, 5.0), at(25.0, 25.0)).expect("line").into(),
    ];
    let mut parts = Vec::new();
    let mut from = 0.0;
    for (k, left) in curves.iter().enumerate() {
        let Some(right) = curves.get(k + 1) else {
            parts.push((*left, from, left.domain() - from, f64::INFINITY));
            break;
        };
        let cut = left.domain() - 0.5;
        parts.push((*left, from, cut - from, f64::INFINITY));
        let ease = Blend::hermite(&left.jet(cut), &right.jet(0.5), 1.0).expect("blend");
        parts.push((Curve::Blend(ease), 0.0, 1.0, f64::INFINITY));
        from = 0.5;
    }
    Path { parts }
}

/// The butterfly in chords with blended corners.
fn butterfly(chords: u32, degrees: f64) -> Path {
    let points: Vec<Axes> = (0..=chords)
        .map(|k| {
            let [x, y] = butterfly_point(f64::from(k) / f64::from(chords));
            turned(point(x, y, 0.0), degrees)
        })
        .collect();
    Path::polyline(&points, 0.02, 200.0)
}

/// Duration of one plan over the whole path, its stations and steps. `None` also if it needs more than one
/// window.
fn whole(path: &Path, limits: &evolvent_machine::Limits) -> Option<(f64, usize, u32, Vec<TimeLawPiece>)> {
    let limits = relaxation(*limits);
    let mut grid = Grid::new(&limits);
    path.push_to(&mut grid);
    let (mut optimizer, mut out) = (Optimizer::new(&limits), Vec::new());
    let start = PathPosition { interval: 0, x: 0.0 };
    let report = optimizer
        .plan(&grid, start, Entry::Rest, grid.end(), Exit::Rest, 1.0, &mut out)
        .ok()?;
    Some((report.duration_s, report.stations, report.iterations, out))
}

/// Duration in a receding horizon of [`MAX_INTERVALS`] that commits half of it, as the planner of programs
/// does.
fn receding(path: &Path, limits: &evolvent_machine::Limits) -> Option<(f64, Vec<TimeLawPiece>)> {
    let limits = relaxation(*limits);
    let mut grid = Grid::new(&limits);
    path.push_to(&mut grid);
    let (mut optimizer, mut out) = (Optimizer::new(&limits), Vec::<TimeLawPiece>::new());
    let (mut position, mut entry, mut done) = (PathPosition { interval: 0, x: 0.0 }, Entry::Rest, Vec::new());
    let window = MAX_INTERVALS as u64;
    loop {
        let until = grid.end().min(position.interval + window);
        let exit = if until == grid.end() {
            Exit::Rest
        } else {
            Exit::Open
        };
        optimizer
            .plan(&grid, position, entry, until, exit, 1.0, &mut out)
            .ok()?;
        if exit == Exit::Rest {
            done.append(&mut out);
            return Some((done.iter().map(|piece| piece.duration_s).sum(), done));
        }
        let goal = position.interval + window / 2;
        let commit = out.iter().position(|piece| piece.interval >= goal)?;
        done.extend(out.drain(..commit));
        let next = out.first()?;
        let state = next.law.at(0.0).0;
        let (_, begin) = grid.segment_of(next.interval)?;
        position = PathPosition {
            interval: next.interval,
            x: next.from - begin,
        };
        entry = Entry::Moving {
            v: state.v,
            a: state.a,
        };
    }
}
