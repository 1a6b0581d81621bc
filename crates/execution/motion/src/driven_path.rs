//! The path that a program has driven, so that it can be retraced.

use evolvent_path::{Axes, Jet};

use crate::setpoint::Setpoint;
use crate::state::MotionState;

/// Number of samples kept: with one per millisecond, 32 s of motion.
const SAMPLES: usize = 1 << 15;
/// Number of block starts kept.
const BLOCKS: usize = 1 << 10;
/// Maximum time between two samples, ns, or one period if that is longer. The error of the quintics is at
/// most `J h^3 / 161` ([`between`]): 0.0013 um for the 200 m/s3 of the machine files in `config/machines`,
/// 0.012 um for 2000 m/s3.
const SPACING_NS: u64 = 1_000_000;

/// One instant of the path.
#[derive(Clone, Copy, Debug)]
struct Sample {
    /// Cycles of motion since the start.
    time: u64,
    position: Axes,
    /// Velocity per cycle.
    first: Axes,
    /// Acceleration per cycle squared.
    second: Axes,
    line: u32,
    /// Whether it is at an exact-path joint.
    joint: bool,
}

/// A position on the driven path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DrivenPoint {
    /// Position and derivatives by path time in cycles.
    pub(crate) jet: Jet,
    pub(crate) line: u32,
    pub(crate) joint: bool,
}

/// The newest part of the path that a program has driven, over its time in motion. A stop counts as one
/// sample.
///
/// The cycle adds each setpoint of the program. Only [`DrivenPath::new`] allocates (about 8 MB). The path is
/// cleared by everything that retracing can neither repeat nor undo: an action, a changed output, a probing
/// move, a thread, a process cycle. So none of these has happened between any two positions of the path.
#[derive(Clone, Debug)]
pub struct DrivenPath {
    samples: Box<[Sample]>,
    /// Numbers of the oldest and of the next sample.
    begin: u64,
    end: u64,
    /// Path times at which blocks began.
    blocks: Box<[u64]>,
    blocks_begin: u64,
    blocks_end: u64,
    spacing: u64,
    /// Path time so far, in cycles.
    time: u64,
    block: u32,
    actions: u32,
    was_held: bool,
    /// The sample at or before the last position that was looked up.
    found: u64,
}

impl DrivenPath {
    /// An empty path for a control period in ns. Allocates.
    #[must_use]
    pub fn new(period_ns: u64) -> Self {
        let nowhere = Sample {
            time: 0,
            position: Axes::zeros(),
            first: Axes::zeros(),
            second: Axes::zeros(),
            line: 0,
            joint: false,
        };
        Self {
            samples: vec![nowhere; SAMPLES].into_boxed_slice(),
            begin: 0,
            end: 0,
            blocks: vec![0; BLOCKS].into_boxed_slice(),
            blocks_begin: 0,
            blocks_end: 0,
            spacing: (SPACING_NS / period_ns.max(1)).max(1),
            time: 0,
            block: 0,
            actions: 0,
            was_held: false,
            found: 0,
        }
    }

    /// Clears the path. Real-time safe.
    pub fn forget(&mut self) {
        (self.begin, self.blocks_begin) = (self.end, self.blocks_end);
    }

    /// Adds a setpoint of the program. `by_time`: its position and derivatives by time in s; `is_switched`:
    /// an output has changed with it; `is_barred`: it belongs to a motion that cannot be retraced. Real-time
    /// safe.
    pub(crate) fn note(
        &mut self,
        setpoint: &Setpoint,
        by_time: &Jet,
        period: f64,
        is_switched: bool,
        is_barred: bool,
    ) {
        // Outputs with a safe state in holds change at the hold and after it. They do not depend on the path.
        let is_held = setpoint.state == MotionState::Held;
        let by_hold = is_held || (self.was_held && setpoint.block == self.block);
        self.was_held = is_held;
        if is_barred || (is_switched && !by_hold) || setpoint.actions != self.actions {
            self.forget();
            self.actions = setpoint.actions;
        }
        let begins = setpoint.block != self.block || self.begin == self.end;
        self.block = setpoint.block;
        let rests = by_time.first == Axes::zeros() && by_time.second == Axes::zeros();
        let last = self.newest();
        let is_there = last.is_some_and(|last| {
            rests
                && last.first == Axes::zeros()
                && last.second == Axes::zeros()
                && last.position == by_time.position
        });
        if !is_there {
            self.time += 1;
            let is_due = last.is_none_or(|last| self.time - last.time >= self.spacing);
            let joint = setpoint.flags & crate::flags::JOINT != 0;
            if begins || rests || is_due || joint {
                let by_cycle = by_time.compose(period, 0.0, 0.0);
                self.samples[self.end as usize % SAMPLES] = Sample {
                    time: self.time,
                    position: by_time.position,
                    first: by_cycle.first,
                    second: by_cycle.second,
                    line: setpoint.line,
                    joint,
                };
                self.end += 1;
                self.begin = self.begin.max(self.end.saturating_sub(SAMPLES as u64));
            }
        }
        if begins
            && self
                .blocks
                .get((self.blocks_end.wrapping_sub(1)) as usize % BLOCKS)
                != Some(&self.time)
        {
            self.blocks[self.blocks_end as usize % BLOCKS] = self.time;
            self.blocks_end += 1;
            self.blocks_begin = self
                .blocks_begin
                .max(self.blocks_end.saturating_sub(BLOCKS as u64));
        }
        // Block starts whose samples were overwritten are dropped.
        let oldest = self.samples[self.begin as usize % SAMPLES].time;
        while self.blocks_begin < self.blocks_end && self.blocks[self.blocks_begin as usize % BLOCKS] < oldest
        {
            self.blocks_begin += 1;
        }
        self.found = self.end.saturating_sub(1);
    }

    fn newest(&self) -> Option<Sample> {
        (self.begin < self.end).then(|| self.samples[(self.end - 1) as usize % SAMPLES])
    }

    /// Path time of the newest sample, in cycles. Real-time safe.
    pub(crate) fn end_time(&self) -> Option<f64> {
        Some(self.newest()?.time as f64)
    }

    /// Path time of the `back`-th block start before `time`; none if it is not kept. Real-time safe.
    pub(crate) fn block_start(&self, time: f64, back: u32) -> Option<f64> {
        let number = (self.blocks_end - self.blocks_from(time)).checked_sub(u64::from(back))?;
        (number >= self.blocks_begin).then(|| self.blocks[number as usize % BLOCKS] as f64)
    }

    /// Number of block starts at `time` or later.
    fn blocks_from(&self, time: f64) -> u64 {
        (self.blocks_begin..self.blocks_end)
            .rev()
            .take_while(|number| self.blocks[*number as usize % BLOCKS] as f64 >= time)
            .count() as u64
    }

    /// Number of block starts before `time`. Real-time safe.
    pub(crate) fn blocks_before(&self, time: f64) -> u32 {
        (self.blocks_end - self.blocks_begin - self.blocks_from(time)) as u32
    }

    /// Number of block starts before the newest sample. Real-time safe.
    #[must_use]
    pub fn blocks_driven(&self) -> u32 {
        self.end_time().map_or(0, |time| self.blocks_before(time))
    }

    /// The position at a path time. The search begins at the last position that was looked up, so that the
    /// cost is bounded by the number of samples between both. Real-time safe.
    pub(crate) fn at(&mut self, time: f64) -> Option<DrivenPoint> {
        if self.begin == self.end {
            return None;
        }
        let at = |number: u64| self.samples[number as usize % SAMPLES];
        let mut found = self.found.clamp(self.begin, self.end - 1);
        while found > self.begin && at(found).time as f64 > time {
            found -= 1;
        }
        while found + 1 < self.end && at(found + 1).time as f64 <= time {
            found += 1;
        }
        self.found = found;
        let left = at(found);
        if found + 1 == self.end || left.time as f64 >= time {
            let jet = Jet {
                position: left.position,
                first: left.first,
                second: left.second,
                third: Axes::zeros(),
            };
            return Some(DrivenPoint {
                jet,
                line: left.line,
                joint: left.joint,
            });
        }
        let right = at(found + 1);
        Some(DrivenPoint {
            jet: between(&left, &right, time),
            line: left.line,
            joint: left.joint || right.joint,
        })
    }
}

/// The quintic that has position and two derivatives of both samples.
///
/// It is linear in the third derivative `j(t)` of the path, so its error is an integral of `j` times a
/// kernel. If `|j|` is at most `J`, steps included, then over the distance `h` of the samples the error is at
/// most `J h^3 / 161.7` and the third derivative at most `2.18 J`: the maxima of the integrals of the
/// kernels' absolute values, evaluated numerically. For one step from `-J` to `J` they are `J h^3 / 384` and
/// `1.75 J`.
fn between(left: &Sample, right: &Sample, time: f64) -> Jet {
    let h = (right.time - left.time) as f64;
    let s = (time - left.time as f64) / h;
    let (v0, v1) = (left.first * h, right.first * h);
    let (a0, a1) = (left.second * (0.5 * h * h), right.second * (0.5 * h * h));
    // Differences at the right sample to the parabola through the left one.
    let d = right.position - left.position - v0 - a0;
    let e = v1 - v0 - a0 * 2.0;
    let f = (a1 - a0) * 2.0;
    let c3 = d * 10.0 - e * 4.0 + f * 0.5;
    let c4 = d * -15.0 + e * 7.0 - f;
    let c5 = d * 6.0 - e * 3.0 + f * 0.5;
    let position = left.position + (v0 + (a0 + (c3 + (c4 + c5 * s) * s) * s) * s) * s;
    let first = v0 + (a0 * 2.0 + (c3 * 3.0 + (c4 * 4.0 + c5 * (5.0 * s)) * s) * s) * s;
    let second = a0 * 2.0 + (c3 * 6.0 + (c4 * 12.0 + c5 * (20.0 * s)) * s) * s;
    let third = c3 * 6.0 + (c4 * 24.0 + c5 * (60.0 * s)) * s;
    Jet {
        position,
        first: first / h,
        second: second / (h * h),
        third: third / (h * h * h),
    }
}

#[cfg(test)]
mod tests {
    use evolvent_random::Random;

    use super::*;

    /// A path of piecewise constant third derivative, at most 1: its position and derivatives at `time`.
    fn bang_bang(jerks: &[(f64, f64)], time: f64) -> [f64; 3] {
        let [mut x, mut v, mut a] = [0.3, -0.2, 0.1];
        let mut left = time;
        for (length, jerk) in jerks {
            let t = left.min(*length);
            x += t * (v + t * (a / 2.0 + t * jerk / 6.0));
            v += t * (a + t * jerk / 2.0);
            a += t * jerk;
            left -= t;
            if left <= 0.0 {
                break;
            }
        }
        [x, v, a]
    }

    fn sample(time: u64, [x, v, a]: [f64; 3]) -> Sample {
        Sample {
            time,
            position: Axes::repeat(x),
            first: Axes::repeat(v),
            second: Axes::repeat(a),
            line: 0,
            joint: false,
        }
    }

    #[test]
    fn quintics_keep_the_derived_bounds_for_jerk_steps() {
        let mut random = Random::seeded(1603);
        let (mut error, mut third) = (0.0_f64, 0.0_f64);
        for case in 0..4000 {
            let h = 1 + random.pick(35) as u64;
            let mut jerks = vec![];
            for n in 0..2 + case % 3 {
                let jerk = if (n + case) % 2 == 0 { 1.0 } else { -1.0 };
                jerks.push((random.unit() * h as f64, jerk));
            }
            jerks.push((h as f64, random.between(-1.0, 1.0)));
            let (left, right) = (
                sample(7, bang_bang(&jerks, 0.0)),
                sample(7 + h, bang_bang(&jerks, h as f64)),
            );
            for k in 0..=40 {
                let time = h as f64 * f64::from(k) / 40.0;
                let found = between(&left, &right, 7.0 + time);
                let expected = bang_bang(&jerks, time);
                error = error.max((found.position[0] - expected[0]).abs() / (h as f64).powi(3));
                third = third.max(found.third[0].abs());
                if k == 0 || k == 40 {
                    let ends = [found.position[0], found.first[0], found.second[0]];
                    for (found, expected) in ends.iter().zip(expected) {
                        assert!(
                            (found - expected).abs() < 1e-9 * (h as f64).powi(3),
                            "case {case}"
                        );
                    }
                }
            }
        }
        println!("error 1/{:.0} J h^3, third derivative {third:.3} J", 1.0 / error);
        assert!(error < 1.0 / 161.0 && third < 2.18, "{error} {third}");
        assert!(
            error > 1.0 / 400.0 && third > 1.7,
            "{error} {third} prove nothing"
        );
    }
}
