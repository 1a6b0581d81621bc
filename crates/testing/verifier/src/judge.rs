//! The judge: positions in, verdict out.

use evolvent_machine::Machine;
use evolvent_path::{AXES, Axes};

use crate::differences::Differences;
use crate::follower::Follower;
use crate::{Route, Verdict};

/// Number of setpoints after a joint for which the third difference contains its step.
const JOINT_SETPOINTS: u64 = 4;

/// Judges one motion, setpoint by setpoint.
///
/// Time and memory per setpoint do not depend on the length of the program.
#[derive(Clone, Debug)]
pub struct Judge<'a> {
    route: &'a Route,
    follower: Follower<'a>,
    differences: Differences,
    jerk: Axes,
    period_s: f64,
    /// Maximum distance of the nearest setpoint from a rest between two setpoints.
    rest_mm: f64,
    chord_mm: f64,
    /// The block nearest to the last setpoint.
    block: usize,
    last: Axes,
    /// The last setpoint after a joint.
    joint: Option<u64>,
    verdict: Verdict,
}

impl<'a> Judge<'a> {
    /// Starts with a machine at rest at the route's start; the first setpoint is one period later.
    #[must_use]
    pub fn new(machine: &Machine, period_ns: u64, route: &'a Route) -> Self {
        let period_s = period_ns as f64 * 1e-9;
        let limits = machine.limits();
        let chord_mm = machine.path.chord_error_increments / machine.increments_per_mm;
        Self {
            route,
            follower: Follower::new(route, chord_mm),
            differences: Differences::new(machine, period_s, route.start()),
            jerk: limits.jerk,
            period_s,
            rest_mm: (0..AXES)
                .filter(|&axis| limits.present[axis])
                .map(|axis| limits.jerk[axis] * (0.5 * period_s).powi(3) / 6.0)
                .fold(0.0, f64::hypot),
            chord_mm,
            block: 0,
            last: route.start(),
            joint: None,
            verdict: Verdict {
                blocks: route.blocks.len(),
                path_mm: route.length_mm(),
                ..Verdict::default()
            },
        }
    }

    /// Judges the next setpoint: the positions of the axes, mm and degrees.
    pub fn sample(&mut self, position: &Axes) {
        let setpoint = self.verdict.setpoints;
        self.verdict.setpoints += 1;
        self.verdict.duration_s = self.verdict.setpoints as f64 * self.period_s;
        if !position.iter().all(|value| value.is_finite()) {
            self.verdict.unreadable += 1;
            return;
        }
        if setpoint == 0 {
            self.verdict.start = self.start_off(position);
        }
        if *position != self.last && !self.route.blocks.is_empty() {
            self.follow(position, setpoint);
        }
        self.differences(position, setpoint);
        self.last = *position;
    }

    /// Ends the motion; the axes keep their positions.
    #[must_use]
    pub fn finish(mut self) -> Verdict {
        let last = self.last;
        let setpoint = self.verdict.setpoints;
        // A motion that ends abruptly counts as a stop in zero time.
        for _ in 0..3 {
            self.differences(&last, setpoint);
        }
        let verdict = &mut self.verdict;
        verdict.end = (last - self.route.end()).amax();
        let coverage = self.follower.finish();
        let line = |block: usize| self.route.blocks.get(block).map_or(0, |block| block.line);
        verdict.missed = coverage.missed;
        verdict.first_missed = coverage.first_missed.map(line);
        verdict
            .reverse
            .record(coverage.farthest.0, 0, line(coverage.farthest.1), 0);
        let rest = (coverage.rest.0 - self.rest_mm).max(0.0);
        verdict.rest.record(rest, 0, line(coverage.rest.1), 0);
        self.verdict
    }

    /// Distance of the first setpoint from the start, minus the distance that the jerk limit permits in one
    /// period.
    fn start_off(&self, position: &Axes) -> f64 {
        let far = self.jerk * (self.period_s * self.period_s * self.period_s);
        (position - self.route.start())
            .abs()
            .zip_map(&far, |off, far| (off - far).max(0.0))
            .amax()
    }

    fn follow(&mut self, position: &Axes, setpoint: u64) {
        let found = self.follower.follow(position);
        let blocks = &self.route.blocks;
        let line = blocks[found.block].line;
        let verdict = &mut self.verdict;
        verdict.deviation_mm.record(found.linear, setpoint, line, 0);
        verdict.deviation_deg.record(found.rotary, setpoint, line, 0);
        verdict.deviation.record(found.ratio, setpoint, line, 0);
        verdict.between_mm.record(found.between, setpoint, line, 0);
        verdict.between.record(found.between_ratio, setpoint, line, 0);
        if found.lost {
            verdict.lost += 1;
            verdict.first_lost.get_or_insert((setpoint, line));
        }
        let about = &blocks[found.first..=found.last.max(found.block)];
        let metric = blocks[found.block].metric;
        if about.iter().all(|block| block.metric == metric) {
            let step = (position - self.last).fixed_rows::<3>(metric.first_axis()).norm();
            let max = about.iter().fold(0.0_f64, |max, block| max.max(block.feed));
            // Error of a speed from the rounding of positions.
            let noise = 8.0 * f64::EPSILON * position.amax();
            let ratio = (step - noise).max(0.0) / (self.period_s * max);
            verdict.feed.record(ratio, setpoint, line, 0);
        }
        let (low, high) = (self.block.min(found.block), self.block.max(found.block));
        if blocks[low..high].iter().any(|block| block.joint) {
            self.joint = Some(setpoint);
        }
        self.block = found.block;
    }

    fn differences(&mut self, position: &Axes, setpoint: u64) {
        let ratios = self.differences.push(position);
        let line = self.route.blocks.get(self.block).map_or(0, |block| block.line);
        let verdict = &mut self.verdict;
        let [velocity, acceleration, jerk] = ratios.orders;
        verdict.velocity.record(velocity.0, setpoint, line, velocity.1);
        verdict
            .acceleration
            .record(acceleration.0, setpoint, line, acceleration.1);
        let at_joint = self.joint.is_some_and(|joint| setpoint < joint + JOINT_SETPOINTS);
        if at_joint {
            verdict
                .joint
                .record(ratios.joint.0, setpoint, line, ratios.joint.1);
        } else {
            verdict.jerk.record(jerk.0, setpoint, line, jerk.1);
        }
        verdict
            .chord
            .record(ratios.chord_mm / self.chord_mm, setpoint, line, 0);
        verdict
            .travel
            .record(ratios.beyond.0, setpoint, line, ratios.beyond.1);
    }
}
