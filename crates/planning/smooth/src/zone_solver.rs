//! Finds the control points of a zone, window by window.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes};

use crate::chain::Chain;
use crate::joint_optimizer::{JointOptimizer, Window};
use crate::newton::{Problem, Workspace, minimise};
use crate::tube::Sample;
use crate::weights::{Scales, Weights};
use crate::zone::BlendZone;

/// Control points that are found together, how many of them become final if more follow, and how many more may be
/// left so that they are found with them.
pub(crate) const WINDOW: usize = 96;
const COMMIT: usize = 64;
const REST: usize = 48;
/// Rounds of weights, barrier at the first, its factor and its least, Newton steps of a round and of the last.
const ROUNDS: usize = 6;
const BARRIER: (f64, f64, f64) = (0.3, 0.35, 0.01);
const STEPS: (usize, usize) = (2, 6);
/// Control points before and intervals behind the free ones that the law sees.
const MARGIN: usize = 4;
/// Attempts to cover the intervals with more samples.
const ATTEMPTS: usize = 5;

/// Memory that is kept between windows.
#[derive(Debug, Default)]
pub(crate) struct ZoneSolver {
    weights: Weights,
    work: Workspace,
    together: JointOptimizer,
    feeds: Vec<f64>,
    better: Vec<Axes>,
    samples: Vec<Sample>,
    safe: Vec<Axes>,
}

/// What the path is found by.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scene<'a> {
    pub(crate) chain: &'a Chain,
    pub(crate) scales: &'a Scales,
    /// Where the path rests before and behind.
    pub(crate) rests: (f64, f64),
    /// The axes that samples speak of.
    pub(crate) measured: &'a [bool; AXES],
    pub(crate) limits: &'a Limits,
}

/// The window: free control points, the intervals that they touch, and those that the law sees.
struct Range {
    free: (usize, usize),
    from: usize,
    to: usize,
    wide: (usize, usize),
}

impl ZoneSolver {
    /// Finds the next control points of the zone and makes the first of them final. Whatever happens, they are such
    /// that the spline is covered by its samples: if nothing better is found they stay what they were.
    pub(crate) fn find(&mut self, zone: &mut BlendZone, scene: &Scene<'_>) {
        let low = zone.fixed;
        let last = if zone.complete {
            zone.points.len() - zone.clamped
        } else {
            zone.intervals()
        };
        let all = zone.complete && last <= low + WINDOW + REST;
        let high = if all { last } else { (low + WINDOW).min(last) };
        if high > low {
            let (from, to) = (low.saturating_sub(3), high.min(zone.intervals()));
            let range = Range {
                free: (low, high),
                from,
                to,
                wide: (from.saturating_sub(MARGIN), (high + MARGIN).min(zone.intervals())),
            };
            self.window(zone, scene, &range);
        }
        zone.fixed = if zone.complete && high == last {
            zone.points.len()
        } else {
            low + COMMIT
        };
    }

    fn window(&mut self, zone: &mut BlendZone, scene: &Scene<'_>, range: &Range) {
        let Scene {
            chain,
            scales,
            rests,
            measured,
            limits,
        } = *scene;
        let mut active = [false; AXES];
        let here = zone.points[range.from];
        for point in &zone.points[range.from..(range.to + 3).min(zone.points.len())] {
            for i in 0..AXES {
                active[i] |= point[i] != here[i];
            }
        }
        self.safe.clear();
        self.safe.extend_from_slice(&zone.points);
        self.feeds.clear();
        let mut number = chain.find(zone.knot(range.wide.0));
        for i in range.wide.0..range.wide.1 {
            let middle = 0.5 * (zone.knot(i) + zone.knot(i + 1));
            number = chain.find_near(middle, number);
            self.feeds
                .push(chain.get(number).map_or(f64::INFINITY, |link| link.feed));
        }
        self.by_weights(zone, chain, scales, &active, range);
        for _ in 0..ATTEMPTS {
            self.with_law(zone, chain, scales, rests, &active, range);
            self.confine(zone, limits, range);
            if zone.cover(chain, range.from, range.to, measured) {
                return;
            }
            if !zone.retreat(&self.safe, range.free, range.from, range.to) {
                break;
            }
            self.by_weights(zone, chain, scales, &active, range);
        }
        // Where nothing else helps, back to what is safe, but only there.
        for attempt in 1..=ATTEMPTS {
            if zone.cover(chain, range.from, range.to, measured) {
                return;
            }
            let share = if attempt < ATTEMPTS { 0.5 } else { 0.0 };
            zone.relax_toward(&self.safe, range.free, share);
        }
        if zone.cover(chain, range.from, range.to, measured) {
            return;
        }
        zone.points[range.free.0..range.free.1].copy_from_slice(&self.safe[range.free.0..range.free.1]);
    }

    /// By the cost that needs no law.
    fn by_weights(
        &mut self,
        zone: &mut BlendZone,
        chain: &Chain,
        scales: &Scales,
        active: &[bool; AXES],
        range: &Range,
    ) {
        let Range { from, to, wide, .. } = *range;
        let samples = zone.samples_of(from, to);
        let (start, factor, least) = BARRIER;
        let mut mu = start;
        for round in 0..ROUNDS {
            self.weights.update(zone, wide.0, wide.1, scales, active);
            // The samples of an interval share its weight.
            let times = &mut self.weights.times;
            let mut at = samples.start;
            for i in from..to {
                let count = zone.samples[at..samples.end].partition_point(|sample| sample.interval <= i);
                times[i - wide.0] /= count.max(1) as f64;
                at += count;
            }
            let problem = Problem {
                terms: &self.weights.terms[2 * (from - wide.0)..2 * (to - wide.0)],
                samples: &zone.samples[samples.clone()],
                barrier: times,
                first: wide.0,
                mu,
                free: range.free,
                active: *active,
            };
            let steps = if round + 1 == ROUNDS { STEPS.1 } else { STEPS.0 };
            minimise(&problem, &mut zone.points, steps, &mut self.work);
            zone.follow(chain, from, to);
            mu = (mu * factor).max(least);
        }
    }

    /// Brings control points back into the travel: the path is in their hull.
    fn confine(&self, zone: &mut BlendZone, limits: &Limits, range: &Range) {
        for j in range.free.0..range.free.1 {
            let safe = &self.safe[j];
            for i in (0..AXES).filter(|&i| limits.present[i]) {
                let (low, high) = (
                    limits.travel_min[i].min(safe[i]),
                    limits.travel_max[i].max(safe[i]),
                );
                zone.points[j][i] = zone.points[j][i].max(low).min(high);
            }
        }
    }

    /// Together with a time law.
    fn with_law(
        &mut self,
        zone: &mut BlendZone,
        chain: &Chain,
        scales: &Scales,
        rests: (f64, f64),
        active: &[bool; AXES],
        range: &Range,
    ) {
        let window = Window {
            zone,
            from: range.wide.0,
            to: range.wide.1,
            free: range.free,
            scales,
            active,
            feeds: &self.feeds,
            rests,
        };
        self.better.clear();
        self.better.extend_from_slice(&zone.points);
        let samples = zone.samples_of(range.from, range.to);
        self.samples.clear();
        self.samples.extend_from_slice(&zone.samples[samples.clone()]);
        if self
            .together
            .improve(&window, chain, &mut self.samples, &mut self.better)
        {
            zone.points.copy_from_slice(&self.better);
            zone.samples[samples].copy_from_slice(&self.samples);
        }
    }
}
