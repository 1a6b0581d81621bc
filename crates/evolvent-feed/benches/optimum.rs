//! How much slower than the optimum the plans are: `cargo bench -p evolvent-feed --bench optimum`.
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

use common::{Path, axes, circle, helix, involute, loose, point, square, turned};
use evolvent_feed::{Entry, Exit, Grid, MOST_INTERVALS, Optimizer, Piece, Place};

/// Least stations of the other method on each stretch.
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
        ];
        for (name, path) in paths {
            if !name.contains(&filter) {
                continue;
            }
            for (v, a, j) in sets {
                let limits = axes(3, v, a, j);
                let ours = whole(&path, &limits);
                let pieces = ours.as_ref().map(|x| x.3.as_slice());
                let best = oracle::optimum(&path, &limits, EACH, pieces);
                // From another start, where that converges.
                let other = oracle::optimum(&path, &limits, EACH, None).map_or(f64::NAN, |x| x.0);
                let receding = receding(&path, &limits);
                let (Some((best, n)), Some((ours, stations, steps, _))) = (best, ours.clone()) else {
                    println!(
                        "{name:12} {degrees:3} {v} {a} {j:e}: no {} {}",
                        best.is_none(),
                        ours.is_none()
                    );
                    continue;
                };
                let receding = receding.unwrap_or(f64::NAN);
                println!(
                    "{name:12} {degrees:3} {v} {a} {j:e}: optimum {best:.5} ({n}, {other:.5})  whole {:.4} ({stations} stations, {steps} steps)  receding {:.4}",
                    ours / best,
                    receding / best
                );
                all.push((ours / best, receding / best));
            }
        }
    }
    for (name, pick) in [("whole", 0), ("receding", 1)] {
        let mut ratios: Vec<f64> = all.iter().map(|x| if pick == 0 { x.0 } else { x.1 }).collect();
        ratios.sort_by(f64::total_cmp);
        if let (Some(middle), Some(worst)) = (ratios.get(ratios.len() / 2), ratios.last()) {
            println!("{name}: median {middle:.4}, worst {worst:.4} of {}", ratios.len());
        }
    }
}

/// Duration of one plan over the whole path, its stations and steps.
fn whole(path: &Path, limits: &evolvent_machine::Limits) -> Option<(f64, usize, u32, Vec<Piece>)> {
    let limits = loose(*limits);
    let mut grid = Grid::new(&limits);
    path.push_to(&mut grid);
    let (mut optimizer, mut out) = (Optimizer::new(&limits), Vec::new());
    let start = Place { interval: 0, x: 0.0 };
    let report = optimizer
        .plan(&grid, start, Entry::Rest, grid.end(), Exit::Rest, 1.0, &mut out)
        .ok()?;
    Some((report.duration, report.stations, report.iterations, out))
}

/// Duration in a receding horizon of [`MOST_INTERVALS`] that commits half of it.
fn receding(path: &Path, limits: &evolvent_machine::Limits) -> Option<f64> {
    let limits = loose(*limits);
    let mut grid = Grid::new(&limits);
    path.push_to(&mut grid);
    let (mut optimizer, mut out) = (Optimizer::new(&limits), Vec::<Piece>::new());
    let (mut place, mut entry, mut done) = (Place { interval: 0, x: 0.0 }, Entry::Rest, 0.0);
    let window = (grid.end() / 3).clamp(60, MOST_INTERVALS as u64);
    loop {
        let until = grid.end().min(place.interval + window);
        let exit = if until == grid.end() {
            Exit::Rest
        } else {
            Exit::Open
        };
        optimizer
            .plan(&grid, place, entry, until, exit, 1.0, &mut out)
            .ok()?;
        if exit == Exit::Rest {
            return Some(done + out.iter().map(|piece| piece.duration).sum::<f64>());
        }
        let goal = place.interval + window / 2;
        let commit = out.iter().position(|piece| piece.interval >= goal)?;
        done += out[..commit].iter().map(|piece| piece.duration).sum::<f64>();
        let next = out.get(commit)?;
        let state = next.law.at(0.0).0;
        let (_, begin) = grid.stretch_of(next.interval)?;
        place = Place {
            interval: next.interval,
            x: next.from - begin,
        };
        entry = Entry::Moving {
            v: state.v,
            a: state.a,
        };
    }
}
