//! The optimum along a path by another method: sequential second-order cone programmes of the crate `copp`.
//!
//! Shares only the curves with the planner: its own stations, aligned with joints and graded towards both
//! ends, the limits at those stations alone, and no margins. It is not a lower bound: on a line of 50 mm it
//! is 0.2 % above the closed form, and where curvature changes rapidly it stagnates up to 2.5 % above motions
//! that keep every limit.

use copp::robot::Robot;
use copp::solver::topp2_ra::{ReachSet2OptionsBuilder, Topp2ProblemBuilder, topp2_ra};
use copp::solver::topp3_socp::{ClarabelOptionsBuilder, Topp3ProblemBuilder, s_to_t_topp3, topp3_socp};
use evolvent_machine::Limits;
use evolvent_path::{AXES, Curve, Jet};
use evolvent_timing::TimeLawPiece;
use nalgebra::DMatrix;

use crate::common::Path;

/// Maximum number of linearisations until the duration converges.
const ROUNDS: usize = 30;
/// Relative change of the duration that counts as converged.
const STILL: f64 = 1e-5;

/// A station: parameter along the whole path, derivatives there, maximum speed by the feed.
struct Station {
    u: f64,
    jet: Jet,
    feed: f64,
}

/// Offsets on a curve: dense where the tangent rotates rapidly, and at both ends.
fn parameters(curve: &Curve, from: f64, length: f64, each: usize) -> Vec<f64> {
    const FINE: usize = 2000;
    let density = |k: usize| {
        let x = (k as f64 + 0.5) / FINE as f64;
        let jet = curve.jet(from + x * length);
        let ends = 0.4 / (x * (1.0 - x) + 3e-4).sqrt();
        let turn = length * jet.second.norm() / jet.first.norm().max(1e-9);
        ends + turn.min(300.0)
    };
    let total: f64 = (0..FINE).map(density).sum();
    let (mut out, mut sum) = (vec![0.0], 0.0);
    for k in 0..FINE {
        sum += density(k);
        if sum >= total * out.len() as f64 / each as f64 && k + 1 < FINE {
            out.push((k as f64 + 1.0) / FINE as f64 * length);
        }
    }
    out
}

fn stations(path: &Path, each: usize) -> Vec<Station> {
    let total = path.length();
    let mut marks: Vec<(f64, usize, f64)> = Vec::new();
    let mut begin = 0.0;
    for (part, (curve, from, length, _)) in path.parts.iter().enumerate() {
        for x in parameters(curve, *from, *length, each) {
            marks.push((begin + x, part, from + x));
        }
        begin += length;
    }
    let (last, (_, from, length, _)) = (path.parts.len() - 1, path.parts[path.parts.len() - 1]);
    marks.push((total, last, from + length));
    // Graded by a tenth from both ends until that is coarser than the existing stations.
    let grade = |limit: f64| {
        let mut x: f64 = limit * 1e-3;
        let mut out = Vec::new();
        while x < limit {
            out.push(x);
            x *= 1.04;
        }
        out
    };
    let first_length = path.parts[0].2;
    for x in grade(0.5 * first_length) {
        marks.push((x, 0, path.parts[0].1 + x));
    }
    for x in grade(0.5 * length) {
        marks.push((total - x, last, from + length - x));
    }
    marks.sort_by(|a, b| a.0.total_cmp(&b.0));
    marks.dedup_by(|b, a| (b.0 - a.0) < 1e-6 * total / (path.parts.len() as f64));
    // The coarse stations within the graded ends are close to others, which is harmless.
    marks
        .into_iter()
        .map(|(u, part, at)| {
            let (curve, from, _, feed) = &path.parts[part];
            let mut jet = curve.jet(at);
            // At a joint the smaller of the two third derivatives: the optimum is rather too fast.
            if at <= *from && part > 0 {
                let before = &path.parts[part - 1];
                let left = before.0.jet(before.1 + before.2);
                if left.third.norm() < jet.third.norm() {
                    jet = left;
                }
            }
            let feed = feed / jet.first.norm();
            Station { u, jet, feed }
        })
        .collect()
}

/// `u'^2` of a plan at the stations.
fn squares(pieces: &[TimeLawPiece], stations: &[Station]) -> Vec<f64> {
    let (mut index, mut begin) = (0, 0.0);
    stations
        .iter()
        .map(|station| {
            while index + 1 < pieces.len() && station.u > begin + pieces[index].length {
                begin += pieces[index].length;
                index += 1;
            }
            let piece = &pieces[index];
            let t = piece.law.time_to(station.u - begin, piece.duration_s);
            piece.law.at(t).0.v.powi(2)
        })
        .collect()
}

/// The optimum of the path from rest to rest, s; and the number of its stations.
pub(crate) fn optimum(
    path: &Path,
    limits: &Limits,
    each: usize,
    start: Option<&[TimeLawPiece]>,
) -> Option<(f64, usize)> {
    let axes: Vec<usize> = (0..AXES)
        .filter(|&i| {
            limits.present[i]
                && path
                    .parts
                    .iter()
                    .any(|(c, f, l, _)| c.derivative_bounds(*f, f + l).0[i] > 0.0)
        })
        .collect();
    let stations = stations(path, each);
    let (n, dim) = (stations.len(), axes.len());
    // Units in which the jerk limit and the path's length are about one.
    let length = path.length();
    let time = (length / limits.jerk[axes[0]]).cbrt();
    let s: Vec<f64> = stations.iter().map(|x| x.u / length).collect();
    let matrix = |f: &dyn Fn(&Jet, usize) -> f64| {
        DMatrix::from_fn(dim, n, |row, column| f(&stations[column].jet, axes[row]))
    };
    let q = matrix(&|jet, i| jet.position[i] / length);
    let d1 = matrix(&|jet, i| jet.first[i]);
    let d2 = matrix(&|jet, i| jet.second[i] * length);
    let d3 = matrix(&|jet, i| jet.third[i] * length * length);
    let bound = |of: &dyn Fn(usize) -> f64| axes.iter().map(|&i| of(i)).collect::<Vec<f64>>();
    let v = bound(&|i| limits.velocity[i] * time / length);
    let a = bound(&|i| limits.acceleration[i] * time * time / length);
    let j = bound(&|i| limits.jerk[i] * time * time * time / length);
    let minus = |x: &[f64]| x.iter().map(|x| -x).collect::<Vec<f64>>();
    let mut robot = Robot::with_capacity(dim, n);
    robot.with_s(s.as_slice()).ok()?;
    let (q, d1, d2, d3) = (
        q.view((0, 0), (dim, n)),
        d1.view((0, 0), (dim, n)),
        d2.view((0, 0), (dim, n)),
        d3.view((0, 0), (dim, n)),
    );
    robot
        .with_q(&q.as_view(), &d1.as_view(), &d2.as_view(), Some(&d3.as_view()), 0)
        .ok()?
        .with_axial_velocity((v.as_slice(), n), (minus(&v).as_slice(), n), 0)
        .ok()?
        .with_axial_acceleration((a.as_slice(), n), (minus(&a).as_slice(), n), 0)
        .ok()?
        .with_axial_jerk((j.as_slice(), n), (minus(&j).as_slice(), n), 0)
        .ok()?;
    if stations.iter().any(|x| x.feed.is_finite()) {
        let cap: Vec<f64> = stations
            .iter()
            .map(|x| (x.feed * time / length).powi(2).min(1e12))
            .collect();
        robot.constraints.with_constraint_1order(&cap, 0).ok()?;
    }
    let interval = (0, n - 1);
    let mut a_ref = {
        let problem = Topp2ProblemBuilder::new(&robot, interval, (0.0, 0.0))
            .build()
            .ok()?;
        topp2_ra(&problem, &ReachSet2OptionsBuilder::new().build().ok()?).ok()?
    };
    if let Some(pieces) = start {
        let squares = squares(pieces, &stations);
        for (to, from) in a_ref.iter_mut().zip(squares) {
            *to = (from * time * time / (length * length)).max(1e-10);
        }
    }
    let options = ClarabelOptionsBuilder::new()
        .allow_almost_solved(true)
        .allow_insufficient_progress(true)
        .build()
        .ok()?;
    let mut best = f64::INFINITY;
    for _ in 0..ROUNDS {
        let problem = Topp3ProblemBuilder::new(&mut robot, 0, &a_ref, (0.0, 0.0), (0.0, 0.0))
            .build_with_linearization()
            .ok()?;
        let profile = match topp3_socp(&problem, &options) {
            Ok(profile) => profile,
            Err(_) => break,
        };
        let (t, _) = s_to_t_topp3(&s, profile.as_parts(), 0.0).ok()?;
        let t = t * time;
        if std::env::var("OLOG").is_ok() {
            eprintln!("    {t}");
        }
        let still = (best - t).abs() < STILL * t;
        best = best.min(t);
        a_ref = profile.a;
        if still {
            break;
        }
    }
    best.is_finite().then_some((best, n))
}
