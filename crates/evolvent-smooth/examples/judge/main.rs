//! Judges the smoother: smooths programs and plans the feed along the result.
//!
//! `cargo run --release -p evolvent-smooth --example judge -- FILE...`; files of G-code, or `.canon` files with the
//! canonical calls that `rs274 -g` prints. Limits: V 200 mm/s, A 2000 mm/s2, J 50 000 mm/s3, G64 P0.02.

#![expect(
    clippy::print_stdout,
    clippy::neg_cmp_op_on_partial_ord,
    reason = "a tool that prints"
)]

mod plan;
mod program;

use std::path::Path;

use evolvent_machine::Limits;
use evolvent_path::Axes;
use evolvent_smooth::{Output, Settings, Smoother, Tolerance};
use plan::{Section, plan, sample};
use program::{Item, read};

fn number(name: &str, default: f64) -> f64 {
    std::env::var(name)
        .ok()
        .and_then(|x| x.parse().ok())
        .unwrap_or(default)
}

/// Processor time of this program, which other programs do not lengthen (Linux).
fn cpu_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/self/schedstat").unwrap_or_default();
    text.split(' ')
        .next()
        .and_then(|ns| ns.parse::<f64>().ok())
        .unwrap_or(0.0)
        * 1e-9
}

/// Seconds that LinuxCNC 2.9 takes.
const PEER: [(&str, f64); 14] = [
    ("wheels", 8.53),
    ("short_segments_0.001", 3.11),
    ("circle_small_segments_ncd", 15.15),
    ("spiral-circular-segments", 15.05),
    ("3D_Chips", 39.75),
    ("random_lines_0.001in", 4.65),
    ("arc_parabolic", 0.37),
    ("axis_letter", 6.25),
    ("bezel_ex_37tick", 13.55),
    ("tort-sam-mach3", 1.46),
    ("test_12mmflat", 30.57),
    ("Pasta", 174.32),
    ("tight-corner-tolerance", 48.15),
    ("g0_corners", 3.70),
];

fn main() {
    let (v, a, j) = (number("V", 200.0), number("A", 2000.0), number("J", 50_000.0));
    let p = number("P", 0.02);
    let limits = Limits {
        present: [true, true, true, false, false, false, false, false, false],
        velocity: Axes::repeat(v),
        acceleration: Axes::repeat(a),
        jerk: Axes::repeat(j),
        travel_min: Axes::repeat(-1e4),
        travel_max: Axes::repeat(1e4),
        home: Axes::zeros(),
    };
    let judged = plan::Limits {
        v: [v; 3],
        a: [0.998 * a; 3],
        j: [0.985 * j; 3],
    };
    let settings = Settings {
        joint_time_s: 1e-3,
        limits,
    };
    let tolerance = Tolerance::Within { mm: p, merge_mm: 0.0 };
    let (mut logs, mut counted) = (0.0, 0);
    for file in std::env::args().skip(1) {
        let path = Path::new(&file);
        let name = path
            .file_stem()
            .and_then(|s| s.to_str())
            .unwrap_or("?")
            .to_owned();
        let items = match read(path, tolerance) {
            Ok(items) => items,
            Err(error) => {
                println!("{name}: {error}");
                continue;
            }
        };
        let begun = cpu_seconds();
        let mut smoother = Smoother::new(settings);
        let mut out = Vec::new();
        let (mut blocks, mut dwell) = (0, 0.0);
        for item in &items {
            match item {
                Item::Block(block) => {
                    blocks += 1;
                    smoother.push(block, &mut out);
                }
                Item::Rest { seconds } => {
                    smoother.rest(&mut out);
                    dwell += seconds;
                }
            }
        }
        smoother.rest(&mut out);
        let smoothing = cpu_seconds() - begun;
        let begun = cpu_seconds();
        let (mut total, mut stations, mut iterations, mut failed) = (dwell, 0, 0, 0);
        let mut worst = [0.0f64; 3];
        let mut pieces = 0;
        let mut section = Section::new();
        for output in out {
            match output {
                Output::Stretch(stretch) => {
                    pieces += 1;
                    section.push(stretch);
                }
                Output::Cap { speed } if speed > 0.0 => section.caps.push((section.stretches.len(), speed)),
                Output::Cap { .. } => {
                    let whole = std::mem::replace(&mut section, Section::new());
                    if whole.length <= 0.0 {
                        continue;
                    }
                    let plan = plan(&whole, &judged, 4);
                    total += plan.total;
                    stations += plan.u.len();
                    iterations += plan.iterations;
                    failed += usize::from(plan.failed);
                    let samples = sample(&whole, &plan, 1e-3);
                    check(&samples, &whole, [v, a, j], &mut worst);
                }
                Output::Mark(_) => {}
            }
        }
        let planning = cpu_seconds() - begun;
        let peer = PEER
            .iter()
            .find(|(n, _)| *n == name)
            .map_or(f64::NAN, |(_, t)| *t);
        if peer.is_finite() {
            logs += (total / peer).ln();
            counted += 1;
        }
        println!(
            "{name:28} T {total:8.3} ratio {:5.3} | blocks {blocks} pieces {pieces} stations {stations} | v {:.3} a {:.3} j {:.3} dev {:.4} fail {} {failed} | smooth {:.1} us/block {:.0} ms, plan {:.0} ms ({iterations})",
            total / peer,
            worst[0],
            worst[1],
            worst[2],
            smoother.deviation_mm(),
            smoother.failures(),
            smoothing * 1e6 / f64::from(blocks),
            smoothing * 1e3,
            planning * 1e3,
        );
    }
    println!(
        "geometric mean {:.4} of {counted}",
        (logs / f64::from(counted.max(1))).exp()
    );
}

fn check(samples: &[(f64, plan::V3)], section: &Section, limits: [f64; 3], worst: &mut [f64; 3]) {
    let (first, last) = (section.jet(0.0).position, section.jet(section.length).position);
    let at = |i: isize, d: usize| {
        if i < 0 {
            first[d]
        } else {
            samples.get(i as usize).map_or(last[d], |s| s.1[d])
        }
    };
    let dt = 1e-3;
    for i in -3..samples.len() as isize + 3 {
        for d in 0..3 {
            let (x0, x1, x2, x3) = (at(i - 3, d), at(i - 2, d), at(i - 1, d), at(i, d));
            worst[0] = worst[0].max((x3 - x2).abs() / dt / limits[0]);
            worst[1] = worst[1].max((x3 - 2.0 * x2 + x1).abs() / (dt * dt) / limits[1]);
            worst[2] = worst[2].max((x3 - 3.0 * x2 + 3.0 * x1 - x0).abs() / (dt * dt * dt) / limits[2]);
        }
    }
}
