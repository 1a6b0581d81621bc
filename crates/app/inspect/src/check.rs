//! Checks positions against the machine's limits, independent of plans.

use evolvent_machine::{Limits, Machine};
use evolvent_path::{Axes, AxisLetter};
use evolvent_trace::{CycleRecord, inputs};

/// Permitted ratios of velocity, acceleration and jerk to their limits. Jerk may exceed its limit by more,
/// because third differences amplify rounding.
const ALLOWED: [f64; 3] = [1.001, 1.001, 1.02];
/// Number of cycles after a joint of exact-path mode in which its step affects second and third differences.
const JOINT_CYCLES: u32 = 3;
/// The flag of such a joint.
const FLAG_JOINT: u32 = 16;
/// After a fault the axes brake from their present positions; the guard's own rules apply there.
const STATE_FAULT: u8 = 8;
/// Rounding tolerance of the travel check, mm or degrees.
const TRAVEL_SLACK: f64 = 1e-6;

/// The largest value of one kind, and its position.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Worst {
    /// Its fraction of the limit; for travel, mm or degrees beyond it.
    pub ratio: f64,
    /// The value, in mm or degrees and seconds.
    pub value: f64,
    /// The cycle.
    pub sequence: u64,
    /// The program's line.
    pub line: u32,
}

/// Differentiates recorded positions and keeps the maximum of every axis.
#[derive(Clone, Debug)]
pub struct LimitCheck {
    limits: Limits,
    rate_hz: f64,
    /// The last positions, newest first, and the number of consecutive ones up to the present.
    past: [[f64; 9]; 3],
    known: u32,
    last_sequence: Option<u64>,
    since_joint: u32,
    /// Velocity, acceleration and jerk by axis.
    worst: [[Worst; 3]; 9],
    travel: [Worst; 9],
    broken: u64,
    first_broken: Option<(u64, u32, String)>,
    /// For the corrected setpoints, if they differ.
    drives: Option<Box<LimitCheck>>,
    /// Name of the positions, for messages.
    whose: &'static str,
}

impl LimitCheck {
    /// Starts with a machine at rest at `start`.
    #[must_use]
    pub fn new(machine: &Machine, period_ns: u64, start: &[f64; 9]) -> Self {
        Self {
            limits: machine.limits(),
            rate_hz: 1e9 / period_ns as f64,
            past: [*start; 3],
            known: 3,
            last_sequence: None,
            since_joint: JOINT_CYCLES,
            worst: [[Worst::default(); 3]; 9],
            travel: [Worst::default(); 9],
            broken: 0,
            first_broken: None,
            drives: (!machine.corrections.is_none()).then(|| Box::new(Self::of_drives(machine, period_ns))),
            whose: "",
        }
    }

    /// For corrected positions: the first ones are arbitrary, the travel is that of ideal positions.
    fn of_drives(machine: &Machine, period_ns: u64) -> Self {
        let mut limits = machine.drive_limits();
        (limits.travel_min, limits.travel_max) =
            (Axes::repeat(f64::NEG_INFINITY), Axes::repeat(f64::INFINITY));
        Self {
            limits,
            rate_hz: 1e9 / period_ns as f64,
            past: [[0.0; 9]; 3],
            known: 0,
            last_sequence: None,
            since_joint: JOINT_CYCLES,
            worst: [[Worst::default(); 3]; 9],
            travel: [Worst::default(); 9],
            broken: 0,
            first_broken: None,
            drives: None,
            whose: " as sent to its drive",
        }
    }

    /// Sets the travel from here on.
    pub fn set_travel(&mut self, low: &Axes, high: &Axes) {
        (self.limits.travel_min, self.limits.travel_max) = (*low, *high);
    }

    /// Evaluates the next cycle. After a gap the differences start again. Returns the differences by axis:
    /// velocity, acceleration, jerk; `None` right after a gap.
    pub fn cycle(&mut self, record: &CycleRecord) -> Option<[[f64; 3]; 9]> {
        if let Some(drives) = &mut self.drives
            && !record.drive_position.iter().all(|position| position.is_nan())
        {
            let mut sent = *record;
            for (axis, position) in record.drive_position.iter().enumerate() {
                // An axis that the trace does not have is at rest.
                sent.position[axis] = if position.is_nan() { 0.0 } else { *position };
            }
            drives.cycle(&sent);
        }
        let follows = match self.last_sequence {
            None => record.sequence == 0,
            Some(last) => last.checked_add(1) == Some(record.sequence),
        };
        if !follows {
            self.known = 0;
        }
        self.last_sequence = Some(record.sequence);
        self.since_joint = if record.flags & FLAG_JOINT != 0 {
            0
        } else {
            self.since_joint.saturating_add(1)
        };
        let p = &record.position;
        if record.inputs & inputs::RELOCATED != 0 {
            // At rest, with other coordinates.
            self.past = [*p; 3];
            for axis in 0..9 {
                self.limits.travel_min[axis] = self.limits.travel_min[axis].min(p[axis]);
                self.limits.travel_max[axis] = self.limits.travel_max[axis].max(p[axis]);
            }
        }
        let mut found = [[0.0; 3]; 9];
        let f = self.rate_hz;
        let [p1, p2, p3] = &self.past;
        for axis in 0..9 {
            if !self.limits.present[axis] {
                continue;
            }
            let (d1, d2, d3) = (p[axis] - p1[axis], p1[axis] - p2[axis], p2[axis] - p3[axis]);
            found[axis] = [d1 * f, (d1 - d2) * (f * f), ((d1 - d2) - (d2 - d3)) * (f * f * f)];
        }
        let is_known = self.known >= 3;
        for axis in 0..9 {
            if self.limits.present[axis] {
                self.judge(axis, &found[axis], record, is_known);
            }
        }
        self.past = [*p, self.past[0], self.past[1]];
        self.known = self.known.saturating_add(1);
        is_known.then_some(found)
    }

    fn judge(&mut self, axis: usize, found: &[f64; 3], record: &CycleRecord, is_known: bool) {
        let position = record.position[axis];
        let (low, high) = (self.limits.travel_min[axis], self.limits.travel_max[axis]);
        let beyond = (low - position).max(position - high);
        let at = |ratio: f64, value: f64| Worst {
            ratio,
            value,
            sequence: record.sequence,
            line: record.line,
        };
        let letter = AxisLetter::ALL[axis].letter();
        if beyond > self.travel[axis].ratio {
            self.travel[axis] = at(beyond, position);
        }
        // Written so that NaN violates it.
        if !matches!(beyond.partial_cmp(&TRAVEL_SLACK), Some(std::cmp::Ordering::Less)) {
            self.break_limit(record, || format!("axis {letter} left its travel: {position:.6}"));
        }
        if !is_known {
            return;
        }
        let limits = [
            self.limits.velocity[axis],
            self.limits.acceleration[axis],
            self.limits.jerk[axis],
        ];
        let near_joint = self.since_joint < JOINT_CYCLES;
        for order in 0..3 {
            if near_joint && order > 0 {
                continue;
            }
            let ratio = found[order].abs() / limits[order];
            if ratio > self.worst[axis][order].ratio {
                self.worst[axis][order] = at(ratio, found[order].abs());
            }
            let noise = 16.0 * f64::EPSILON * position.abs().max(1.0) * self.rate_hz.powi(order as i32 + 1);
            let is_braking = record.state == STATE_FAULT && order == 0;
            if ratio > ALLOWED[order] + noise / limits[order] && !is_braking {
                let quantity = ["velocity", "acceleration", "jerk"][order];
                let (value, whose) = (found[order].abs(), self.whose);
                self.break_limit(record, || {
                    format!(
                        "{quantity} of axis {letter}{whose} was {value:.6e}, its limit is {:.6e}",
                        limits[order]
                    )
                });
            }
        }
    }

    fn break_limit(&mut self, record: &CycleRecord, text: impl FnOnce() -> String) {
        self.broken += 1;
        if self.first_broken.is_none() {
            self.first_broken = Some((record.sequence, record.line, text()));
        }
    }

    /// The maxima of an axis, by its index in XYZABCUVW: velocity, acceleration, jerk as fractions of the
    /// limit.
    #[must_use]
    pub fn worst(&self, axis: usize) -> &[Worst; 3] {
        &self.worst[axis]
    }

    /// Number of samples that exceeded a limit.
    #[must_use]
    pub fn broken(&self) -> u64 {
        self.broken + self.drives.as_ref().map_or(0, |drives| drives.broken)
    }

    /// The first of them: cycle, line, and a description.
    #[must_use]
    pub fn first_broken(&self) -> Option<&(u64, u32, String)> {
        let sent = self
            .drives
            .as_ref()
            .and_then(|drives| drives.first_broken.as_ref());
        self.first_broken.as_ref().or(sent)
    }
}
