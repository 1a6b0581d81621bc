//! Random programs, and measures that share no code with the smoother.

#![allow(dead_code, unreachable_pub, reason = "each test uses its part")]
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a test may fail, and prints its seed"
)]

use evolvent_machine::Limits;
use evolvent_path::{AXES, Arc, Axes, Curve, Involute, Line, Plane, Sense};
pub use evolvent_random::Random;
use evolvent_smooth::{Output, PathSegment, ProgramMove, Smoother, SmootherSettings, Tolerance};

/// Seed and number of cases, from `EVOLVENT_SEED` and `EVOLVENT_CASES` if set; printed.
pub fn campaign(seed: u64, cases: usize) -> (Random, usize) {
    (
        Random::from_state(evolvent_random::seed(seed) | 1),
        evolvent_random::cases(cases),
    )
}

pub fn equal_limits(velocity: f64, acceleration: f64, jerk: f64) -> Limits {
    Limits {
        present: [true; AXES],
        velocity: Axes::repeat(velocity),
        acceleration: Axes::repeat(acceleration),
        jerk: Axes::repeat(jerk),
        travel_min: Axes::repeat(-1e5),
        travel_max: Axes::repeat(1e5),
        home: Axes::zeros(),
    }
}

/// Limits over decades, unequal.
pub fn limits(random: &mut Random) -> Limits {
    let mut limits = equal_limits(0.0, 0.0, 0.0);
    for i in 0..AXES {
        limits.velocity[i] = random.log(10.0, 2000.0);
        limits.acceleration[i] = random.log(100.0, 50_000.0);
        limits.jerk[i] = limits.acceleration[i] * random.log(3.0, 300.0);
    }
    limits
}

pub fn settings(limits: Limits) -> SmootherSettings {
    SmootherSettings {
        joint_time_s: 1e-3,
        limits,
    }
}

pub fn within(mm: f64) -> Tolerance {
    Tolerance::Within { mm, merge_mm: 0.0 }
}

pub fn point(values: &[f64]) -> Axes {
    let mut axes = Axes::zeros();
    for (axis, value) in axes.iter_mut().zip(values) {
        *axis = *value;
    }
    axes
}

pub fn block(curve: Curve, feed: f64, tolerance: Tolerance) -> ProgramMove {
    ProgramMove {
        curve,
        feed_mm_s: feed,
        rapid: feed.is_infinite(),
        tolerance,
        line: 0,
        block: 0,
    }
}

/// Lines through points, numbered.
pub fn chain(points: &[Axes], feed: f64, tolerance: Tolerance) -> Vec<ProgramMove> {
    points
        .windows(2)
        .filter_map(|pair| Line::new(pair[0], pair[1]).ok())
        .enumerate()
        .map(|(k, line)| ProgramMove {
            line: k as u32,
            block: k as u32,
            ..block(line.into(), feed, tolerance)
        })
        .collect()
}

/// The elements of a random program.
#[derive(Clone, Copy)]
pub struct Kind {
    pub smallest: f64,
    pub largest: f64,
    pub curves: bool,
    pub other_axes: bool,
    pub mixed: bool,
    pub flat: bool,
}

pub fn program(random: &mut Random, kind: Kind, count: usize, tolerance: Tolerance) -> Vec<ProgramMove> {
    let mut at = Axes::zeros();
    let mut blocks: Vec<ProgramMove> = Vec::new();
    let (mut mode, mut feed) = (tolerance, 100.0);
    let mut tries = 0;
    while blocks.len() < count && tries < 20 * count {
        tries += 1;
        if random.unit() < 0.1 {
            feed = if random.unit() < 0.2 {
                f64::INFINITY
            } else {
                random.log(1.0, 500.0)
            };
        }
        if kind.mixed && random.unit() < 0.1 {
            mode = match random.pick(6) {
                0 => Tolerance::Exact,
                1 => Tolerance::Stop,
                2 => within(0.0),
                _ => within(random.log(1e-3, 1.0)),
            };
        }
        let step = random.log(kind.smallest, kind.largest);
        let curve = match random.pick(6) {
            0 if kind.curves => arc(random, at, step),
            1 if kind.curves => involute(random, at, step),
            // Straight back: the sharpest possible corner.
            2 if !blocks.is_empty() && random.unit() < 0.3 => Some(blocks[blocks.len() - 1].curve.reversed()),
            // Collinear.
            3 if !blocks.is_empty() => {
                let last = &blocks[blocks.len() - 1].curve;
                let ahead = last.jet(last.domain()).first;
                Line::new(at, at + ahead * step).map(Curve::Line).ok()
            }
            _ => {
                let mut end = at;
                for i in 0..if kind.flat { 2 } else { 3 } {
                    end[i] += random.between(-step, step);
                }
                if kind.other_axes {
                    match random.pick(4) {
                        0 => {
                            end = at;
                            end[3] += random.between(-step, step);
                        }
                        1 => {
                            end[4] += random.between(-step, step);
                            end[6] += random.between(-step, step);
                        }
                        2 => {
                            end = at;
                            end[7] += random.between(-step, step);
                        }
                        _ => {}
                    }
                }
                Line::new(at, end).map(Curve::Line).ok()
            }
        };
        let Some(curve) = curve else { continue };
        at = curve.end();
        let k = blocks.len() as u32;
        blocks.push(ProgramMove {
            line: k + 1,
            block: k,
            ..block(curve, feed, mode)
        });
    }
    blocks
}

fn arc(random: &mut Random, at: Axes, step: f64) -> Option<Curve> {
    let plane = [Plane::Xy, Plane::Zx, Plane::Yz][random.pick(3)];
    let (first, second, third) = plane.axes();
    let radius = step.max(0.01);
    let (start, sweep) = (random.between(0.0, std::f64::consts::TAU), random.log(0.05, 6.0));
    let sense = if random.unit() < 0.5 {
        Sense::Clockwise
    } else {
        Sense::CounterClockwise
    };
    let centre = [
        at[first] - radius * start.cos(),
        at[second] - radius * start.sin(),
    ];
    let angle = start + sense.sign() * sweep;
    let mut end = at;
    end[first] = centre[0] + radius * angle.cos();
    end[second] = centre[1] + radius * angle.sin();
    if random.unit() < 0.3 {
        end[third] += random.between(-step, step);
    }
    Arc::new(plane, at, end, centre, sense, 0).map(Curve::Arc).ok()
}

/// From `at`, outwards, some of them from the base circle itself; half of them reversed.
pub fn involute(random: &mut Random, at: Axes, step: f64) -> Option<Curve> {
    let radius = (step * random.log(0.05, 1.0)).max(1e-3);
    let handed = if random.unit() < 0.5 { 1.0 } else { -1.0 };
    let inner = if random.unit() < 0.4 {
        0.0
    } else {
        random.between(0.01, 6.0)
    };
    let outer = inner + random.log(0.05, 12.0);
    let turn = random.between(0.0, std::f64::consts::TAU);
    let position = |phi: f64| {
        let (sin, cos) = (turn + handed * phi).sin_cos();
        [
            radius * (cos + handed * phi * sin),
            radius * (sin - handed * phi * cos),
        ]
    };
    let (from, to) = (position(inner), position(outer));
    let inward = random.unit() < 0.5;
    let (from, to) = if inward { (to, from) } else { (from, to) };
    let centre = [at[0] - from[0], at[1] - from[1]];
    let mut end = at;
    (end[0], end[1]) = (centre[0] + to[0], centre[1] + to[1]);
    if random.unit() < 0.3 {
        end[2] += random.between(-step, step);
    }
    let sense = if (handed > 0.0) == inward {
        Sense::Clockwise
    } else {
        Sense::CounterClockwise
    };
    Involute::new(Plane::Xy, at, end, centre, radius, sense, 1e-6)
        .ok()
        .map(Curve::Involute)
}

/// Smooths a program that ends at rest.
pub fn smooth(settings: SmootherSettings, blocks: &[ProgramMove]) -> (Vec<Output>, Smoother) {
    let mut smoother = Smoother::new(settings);
    let mut out = Vec::new();
    for block in blocks {
        smoother.push(block, &mut out);
    }
    smoother.rest(&mut out);
    (out, smoother)
}

pub fn stretches(out: &[Output]) -> Vec<PathSegment> {
    out.iter()
        .filter_map(|output| match output {
            Output::Segment(stretch) => Some(*stretch),
            _ => None,
        })
        .collect()
}

fn norm(d: &Axes, i: usize) -> f64 {
    (d[i] * d[i] + d[i + 1] * d[i + 1] + d[i + 2] * d[i + 2]).sqrt()
}

/// The maximum of the XYZ distance, the UVW distance and each rotary angle.
pub fn distance(d: &Axes) -> f64 {
    norm(d, 0)
        .max(norm(d, 6))
        .max(d[3].abs())
        .max(d[4].abs())
        .max(d[5].abs())
}

/// The programmed path by its length.
pub struct Programmed<'a> {
    blocks: &'a [ProgramMove],
    starts: Vec<f64>,
}

impl<'a> Programmed<'a> {
    pub fn new(blocks: &'a [ProgramMove]) -> Self {
        let mut starts = vec![0.0];
        for block in blocks {
            starts.push(starts[starts.len() - 1] + block.curve.domain());
        }
        Self { blocks, starts }
    }

    pub fn length(&self) -> f64 {
        self.starts[self.starts.len() - 1]
    }

    pub fn end(&self, block: usize) -> f64 {
        self.starts[block + 1]
    }

    /// The minimum distance of a point from the path near `u`, in units of the tolerance there.
    pub fn ratio(&self, position: &Axes, u: f64, reach: f64) -> f64 {
        let first = self.starts.partition_point(|&s| s < u - reach).saturating_sub(1);
        let mut min = f64::INFINITY;
        for k in first..self.blocks.len() {
            if self.starts[k] > u + reach {
                break;
            }
            let block = &self.blocks[k];
            let tolerance = block.tolerance.mm().max(1e-6);
            let at = |x: f64| distance(&(position - block.curve.position(x))) / tolerance;
            let length = block.curve.domain();
            let (low, high) = (
                (u - reach - self.starts[k]).clamp(0.0, length),
                (u + reach - self.starts[k]).clamp(0.0, length),
            );
            let parts = if matches!(block.curve, Curve::Line(_)) {
                1
            } else {
                48
            };
            for part in 0..parts {
                let cut = |k: usize| low + (high - low) * k as f64 / parts as f64;
                let (mut a, mut b) = (cut(part), cut(part + 1));
                min = min.min(at(a)).min(at(b));
                // The distance from a line is convex; from a short part of a curve approximately so.
                for _ in 0..if parts == 1 || tolerance < 1e-4 { 60 } else { 16 } {
                    let (x, y) = (a + (b - a) * 0.382, a + (b - a) * 0.618);
                    let (fx, fy) = (at(x), at(y));
                    min = min.min(fx).min(fy);
                    if fx < fy {
                        b = y;
                    } else {
                        a = x;
                    }
                }
                if min <= 0.9 {
                    return min;
                }
            }
        }
        min
    }
}

/// Checks the properties of every path.
pub fn check(blocks: &[ProgramMove], out: &[Output], samples: usize, what: &str) {
    let programmed = Programmed::new(blocks);
    let scale = 1.0 + programmed.length();
    let max = blocks.iter().map(|b| b.tolerance.mm()).fold(0.0, f64::max);
    let (mut u, mut marks) = (0.0, 0);
    let mut last: Option<(evolvent_path::Jet, bool)> = None;
    let mut at_rest = true;
    for output in out {
        match output {
            Output::Segment(stretch) => {
                // Marks are not output after their path.
                assert!(
                    programmed.end(marks) >= u - 1e-9 * scale,
                    "{what}: mark {marks} is late at {u}"
                );
                let domain = stretch.curve.domain();
                assert!(
                    stretch.length > 0.0
                        && stretch.from >= -1e-12
                        && stretch.from + stretch.length <= domain * (1.0 + 1e-9) + 1e-9,
                    "{what}: {} + {} of {domain}",
                    stretch.from,
                    stretch.length
                );
                let (start, end) = (
                    stretch.curve.jet(stretch.from),
                    stretch.curve.jet(stretch.from + stretch.length),
                );
                if let Some((before, smooth)) = last {
                    let gap = (start.position - before.position).amax();
                    assert!(gap <= 1e-9 * scale, "{what}: gap {gap} at {u}");
                    if smooth {
                        let first = (start.first - before.first).amax();
                        assert!(
                            first <= 1e-9 * (1.0 + start.first.amax()) * scale,
                            "{what}: step of q' {first} at {u}"
                        );
                        let second = (start.second - before.second).amax();
                        let size = start.second.amax().max(before.second.amax());
                        assert!(
                            second <= 1e-6 * size + 1e-7,
                            "{what}: step of q'' {second} of {size} at {u}"
                        );
                    }
                }
                let block = blocks[programmed
                    .starts
                    .partition_point(|&s| s <= u + 1e-9)
                    .clamp(1, blocks.len())
                    - 1];
                let feed_there = (block.feed_mm_s, block.rapid);
                let middle = u + 0.5 * stretch.length;
                let by_middle = blocks[programmed
                    .starts
                    .partition_point(|&s| s <= middle)
                    .clamp(1, blocks.len())
                    - 1];
                // Near a joint the lower of the feeds of both blocks applies.
                let reach = 2.0 * max + 1e-9;
                let is_lower = |(block, starts): (&ProgramMove, &[f64])| {
                    (block.feed_mm_s, block.rapid) == (stretch.feed_mm_s, stretch.rapid)
                        && block.feed_mm_s < by_middle.feed_mm_s
                        && starts[0] <= u + stretch.length + reach
                        && starts[1] >= u - reach
                };
                assert!(
                    (stretch.feed_mm_s, stretch.rapid) == feed_there
                        || (stretch.feed_mm_s, stretch.rapid) == (by_middle.feed_mm_s, by_middle.rapid)
                        || blocks.iter().zip(programmed.starts.windows(2)).any(is_lower),
                    "{what}: feed {} at {u}",
                    stretch.feed_mm_s
                );
                for k in 0..samples {
                    let x = stretch.length * (k as f64 + 0.5) / samples as f64;
                    let position = stretch.curve.position(stretch.from + x);
                    let ratio = programmed.ratio(&position, u + x, 10.0 * max + 1e-6);
                    let near = programmed
                        .starts
                        .partition_point(|&s| s <= u + x)
                        .clamp(1, blocks.len())
                        - 1;
                    assert!(
                        ratio <= 1.0,
                        "{what}: {ratio} of the tolerance at {}, {:?} block {near} from {} to {}, before \
                         {:?} here {:?}, stretch from {u} of {} blend {}",
                        u + x,
                        &blocks[near.max(3) - 3..(near + 2).min(blocks.len())],
                        programmed.starts[near],
                        programmed.starts[near + 1],
                        blocks[near.max(1) - 1].tolerance,
                        blocks[near].tolerance,
                        stretch.length,
                        stretch.blend
                    );
                }
                u += stretch.length;
                last = Some((end, true));
                at_rest = false;
            }
            Output::Cap { speed } => {
                assert!(*speed >= 0.0, "{what}: cap {speed}");
                if let Some((_, smooth)) = &mut last {
                    *smooth = false;
                }
                at_rest |= *speed == 0.0;
            }
            Output::Mark(mark) => {
                assert_eq!(mark.block as usize, marks, "{what}: order of the marks");
                let end = programmed.end(marks);
                assert!(
                    (mark.end - end).abs() <= 1e-9 * scale,
                    "{what}: mark {} of {end}",
                    mark.end
                );
                marks += 1;
            }
        }
    }
    assert!(
        (u - programmed.length()).abs() <= 1e-9 * scale,
        "{what}: length {u} of {}",
        programmed.length()
    );
    assert_eq!(marks, blocks.len(), "{what}: marks");
    assert!(at_rest || blocks.is_empty(), "{what}: ends in motion");
    if let (Some((end, _)), Some(block)) = (last, blocks.last()) {
        let off = (end.position - block.curve.end()).amax();
        assert!(off <= 1e-14 * scale, "{what}: ends {off} off");
    }
}
