//! Optimises the control points of a zone, window by window.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes};

use crate::chain::Chain;
use crate::joint_optimizer::{JointOptimizer, Window};
use crate::newton::{Problem, Workspace, minimise};
use crate::tube::Sample;
use crate::weights::{Scales, Weights};
use crate::zone::BlendZone;

/// Number of control points that are optimised together, how many of them become final if more follow, and
/// how many more may remain to be included.
pub(crate) const WINDOW: usize = 96;
const COMMIT: usize = 64;
const MAX_REMAINING: usize = 48;
/// Rounds of reweighting; initial barrier, its factor and its minimum; Newton steps of a round and of the
/// last.
const ROUNDS: usize = 6;
const BARRIER: (f64, f64, f64) = (0.3, 0.35, 0.01);
const STEPS: (usize, usize) = (2, 6);
/// Number of control points before and intervals after the free ones that the time law includes.
const MARGIN: usize = 4;
/// Maximum number of attempts to cover the intervals with more samples.
const MAX_ATTEMPTS: usize = 5;

/// Working memory, kept between windows.
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

/// The data of the optimisation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Context<'a> {
    pub(crate) chain: &'a Chain,
    pub(crate) scales: &'a Scales,
    /// Positions before and after where the path stops.
    pub(crate) rests: (f64, f64),
    /// The axes that samples measure.
    pub(crate) measured: &'a [bool; AXES],
    pub(crate) limits: &'a Limits,
}

/// The window: free control points, the intervals they affect, and those that the time law includes.
struct WindowRange {
    free: (usize, usize),
    from: usize,
    to: usize,
    wide: (usize, usize),
}

impl ZoneSolver {
    /// Optimises the next control points of the zone and makes the first of them final. In any case the
    /// spline is covered by its samples: if nothing better is found the points stay unchanged.
    pub(crate) fn optimize(&mut self, zone: &mut BlendZone, context: &Context<'_>) {
        let low = zone.fixed;
        let last = if zone.complete {
            zone.points.len() - zone.clamped
        } else {
            zone.intervals()
        };
        let all = zone.complete && last <= low + WINDOW + MAX_REMAINING;
        let high = if all { last } else { (low + WINDOW).min(last) };
        if high > low {
            let (from, to) = (low.saturating_sub(3), high.min(zone.intervals()));
            let range = WindowRange {
                free: (low, high),
                from,
                to,
                wide: (from.saturating_sub(MARGIN), (high + MARGIN).min(zone.intervals())),
            };
            self.window(zone, context, &range);
        }
        zone.fixed = if zone.complete && high == last {
            zone.points.len()
        } else {
            low + COMMIT
        };
    }

    fn window(&mut self, zone: &mut BlendZone, context: &Context<'_>, range: &WindowRange) {
        let Context {
            chain,
            scales,
            rests,
            measured,
            limits,
        } = *context;
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
            self.feeds.push(
                chain
                    .get(number)
                    .map_or(f64::INFINITY, |segment| segment.feed_mm_s),
            );
        }
        self.by_weights(zone, chain, scales, &active, range);
        for _ in 0..MAX_ATTEMPTS {
            self.with_law(zone, chain, scales, rests, &active, range);
            self.clamp_to_travel(zone, limits, range);
            if zone.ensure_coverage(chain, range.from, range.to, measured) {
                return;
            }
            if !zone.backtrack(&self.safe, range.free, range.from, range.to) {
                break;
            }
            self.by_weights(zone, chain, scales, &active, range);
        }
        // If nothing else helps, back towards the safe solution, but only there.
        for attempt in 1..=MAX_ATTEMPTS {
            if zone.ensure_coverage(chain, range.from, range.to, measured) {
                return;
            }
            let fraction = if attempt < MAX_ATTEMPTS { 0.5 } else { 0.0 };
            zone.relax_toward(&self.safe, range.free, fraction);
        }
        if zone.ensure_coverage(chain, range.from, range.to, measured) {
            return;
        }
        zone.points[range.free.0..range.free.1].copy_from_slice(&self.safe[range.free.0..range.free.1]);
    }

    /// Optimises by the cost function that needs no time law.
    fn by_weights(
        &mut self,
        zone: &mut BlendZone,
        chain: &Chain,
        scales: &Scales,
        active: &[bool; AXES],
        range: &WindowRange,
    ) {
        let WindowRange { from, to, wide, .. } = *range;
        let samples = zone.samples_of(from, to);
        let (start, factor, min) = BARRIER;
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
            mu = (mu * factor).max(min);
        }
    }

    /// Moves control points back into the travel: the path is in their convex hull.
    fn clamp_to_travel(&self, zone: &mut BlendZone, limits: &Limits, range: &WindowRange) {
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

    /// Optimises together with a time law.
    fn with_law(
        &mut self,
        zone: &mut BlendZone,
        chain: &Chain,
        scales: &Scales,
        rests: (f64, f64),
        active: &[bool; AXES],
        range: &WindowRange,
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
