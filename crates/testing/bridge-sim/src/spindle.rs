//! A simulated spindle: inertia, an encoder with an index pulse, and a speed ripple.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use evolvent_bus::{MachineOutputs, SpindleFeedback, spindle_flags};

use crate::fault::FaultKind;

/// Deviation within which the commanded speed counts as reached, as a ratio of it.
const AT_SPEED_RATIO: f64 = 0.02;
/// Speed below which the spindle is at standstill, rpm.
const STANDING_RPM: f64 = 1e-6;
/// Speed of orientation, rpm.
const ORIENT_RPM: f64 = 60.0;
/// Tolerance of orientation, turns.
const ORIENTED_TURNS: f64 = 1e-4;
/// Ratio of the speed at the fault `spindle-slow`.
const SLOW_RATIO: f64 = 0.5;
/// Deceleration of a stalled spindle, as a multiple of its drive's.
const STALL_FACTOR: f64 = 20.0;
const NUMBERS: [u32; 3] = [0, 1, 2];

/// Settings of a simulated spindle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpindleSimulation {
    /// Number of the spindle in programs and on the bus.
    pub number: u32,
    /// Acceleration, rpm per second: the torque of its drive divided by its inertia.
    pub acceleration_rpm_s: f64,
    /// Amplitude of the speed ripple, three cycles per turn, as a ratio of the speed.
    pub ripple: f64,
    /// Encoder counts per turn.
    pub counts: u32,
    /// Age of the feedback when it is sent, ns. Its time stamp is correct.
    pub delay_ns: u64,
}

impl SpindleSimulation {
    /// A spindle that reaches 1000 rpm in half a second, with an encoder of 4096 counts, no ripple and no
    /// delay.
    #[must_use]
    pub const fn usual(number: u32) -> Self {
        Self {
            number,
            acceleration_rpm_s: 2000.0,
            ripple: 0.0,
            counts: 4096,
            delay_ns: 0,
        }
    }
}

/// One spindle as a pure model: outputs in, feedback out, time as an argument.
#[derive(Clone, Debug)]
pub struct SimSpindle {
    simulation: SpindleSimulation,
    instance: u64,
    time_ns: Option<u64>,
    /// True angle since the start, turns.
    turns: f64,
    /// Speed without ripple, rpm, negative counter-clockwise.
    speed_rpm: f64,
    /// Angle of its index pulse, turns.
    index: f64,
    /// Extreme angles since the start, turns.
    swept: [f64; 2],
    sequence: u64,
    delayed: VecDeque<SpindleFeedback>,
}

impl SimSpindle {
    /// Creates a spindle at rest that has not passed its index pulse.
    #[must_use]
    pub fn new(simulation: SpindleSimulation, instance: u64) -> Self {
        Self {
            simulation,
            instance,
            time_ns: None,
            turns: 0.0,
            speed_rpm: 0.0,
            index: 0.3,
            swept: [0.0; 2],
            sequence: 0,
            delayed: VecDeque::new(),
        }
    }

    /// The true angle since the index pulse, turns.
    #[must_use]
    pub fn angle(&self) -> f64 {
        self.turns - self.index
    }

    /// The true speed, rpm.
    #[must_use]
    pub fn speed_rpm(&self) -> f64 {
        self.speed_rpm * (1.0 + self.simulation.ripple * (3.0 * TAU * self.turns).sin())
    }

    /// Advances to `now_ns` with the outputs in force. Returns the message that its bridge sends, if any.
    pub fn step(
        &mut self,
        now_ns: u64,
        outputs: &MachineOutputs,
        faults: &[FaultKind],
    ) -> Option<SpindleFeedback> {
        let before_ns = self.time_ns.replace(now_ns).unwrap_or(now_ns);
        let seconds = now_ns.saturating_sub(before_ns) as f64 * 1e-9;
        let has = |kind: FaultKind| faults.contains(&kind);
        let slot = self.simulation.number as usize;
        let direction = outputs.spindle_direction.get(slot).copied().unwrap_or(0);
        let rpm = outputs.spindle_rpm.get(slot).copied().unwrap_or(0.0);
        let is_orienting = direction == 3;
        let [stopped, clockwise, counter] = NUMBERS;
        let mut wanted = match direction {
            d if d == clockwise => rpm,
            d if d == counter => -rpm,
            _ => 0.0,
        };
        if has(FaultKind::SpindleSlow) {
            wanted *= SLOW_RATIO;
        }
        let mut max_change = self.simulation.acceleration_rpm_s * seconds;
        if has(FaultKind::SpindleFault) || has(FaultKind::SpindleStall) {
            wanted = 0.0;
            max_change *= if has(FaultKind::SpindleStall) {
                STALL_FACTOR
            } else {
                1.0
            };
        }
        self.speed_rpm += (wanted - self.speed_rpm).clamp(-max_change, max_change);
        self.turns += self.speed_rpm() / 60.0 * seconds;
        let mut is_oriented = false;
        if is_orienting && self.speed_rpm.abs() < STANDING_RPM && !has(FaultKind::SpindleFault) {
            is_oriented = self.turn_to(outputs, slot, ORIENT_RPM / 60.0 * seconds);
        }
        self.swept = [self.swept[0].min(self.turns), self.swept[1].max(self.turns)];
        let is_turning = direction == clockwise || direction == counter;
        let commanded = if direction == counter { -rpm } else { rpm };
        let is_at_speed = if is_turning {
            (self.speed_rpm - commanded).abs() <= AT_SPEED_RATIO * rpm
        } else {
            direction == stopped && self.speed_rpm.abs() < STANDING_RPM
        };
        let flags = [
            (is_at_speed, spindle_flags::AT_SPEED),
            (has(FaultKind::SpindleFault), spindle_flags::FAULT),
            (self.is_indexed(), spindle_flags::INDEXED),
            (is_oriented, spindle_flags::ORIENTED),
        ];
        let flags = flags.into_iter().filter(|(is_set, _)| *is_set);
        let counts = f64::from(self.simulation.counts.max(1));
        // Bridges report the middle of a count.
        let shown = ((self.angle() * counts).floor() + 0.5) / counts;
        let message = SpindleFeedback {
            time_ns: now_ns,
            instance: self.instance,
            turns: shown.floor() as i64,
            fraction: shown - shown.floor(),
            speed_rpm: self.speed_rpm(),
            spindle: self.simulation.number,
            flags: flags.fold(0, |sum, (_, bit)| sum | bit),
            outputs_sequence: outputs.sequence,
            ..SpindleFeedback::default()
        };
        self.delayed.push_back(message);
        let delay_ns = self.simulation.delay_ns;
        let is_due = |message: &SpindleFeedback| message.time_ns.saturating_add(delay_ns) <= now_ns;
        let mut sent = None;
        while self.delayed.front().is_some_and(is_due) {
            sent = self.delayed.pop_front();
        }
        let mut sent = sent.filter(|_| !has(FaultKind::SpindleSilent))?;
        self.sequence += 1;
        sent.sequence = self.sequence;
        Some(sent)
    }

    /// Whether it has passed its index pulse.
    fn is_indexed(&self) -> bool {
        let [lowest, highest] = self.swept;
        (highest - self.index).floor() >= (lowest - self.index).ceil()
    }

    /// Turns towards the commanded angle by at most `max_turns`. Returns whether the spindle is oriented.
    fn turn_to(&mut self, outputs: &MachineOutputs, slot: usize, max_turns: f64) -> bool {
        let target = outputs.spindle_angle.get(slot).copied().unwrap_or(0.0) / 360.0;
        let ahead = (target - self.angle()).rem_euclid(1.0);
        let is_there = ahead.min(1.0 - ahead) <= ORIENTED_TURNS;
        let turns = match outputs.spindle_way.get(slot) {
            _ if is_there && ahead > 0.5 => ahead - 1.0,
            _ if is_there => ahead,
            Some(1) => ahead,
            Some(2) => ahead - 1.0,
            _ if ahead > 0.5 => ahead - 1.0,
            _ => ahead,
        };
        self.turns += turns.clamp(-max_turns, max_turns);
        is_there && self.is_indexed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn outputs(direction: u32, rpm: f64) -> MachineOutputs {
        let mut outputs = MachineOutputs {
            sequence: 7,
            ..MachineOutputs::default()
        };
        (outputs.spindle_direction[0], outputs.spindle_rpm[0]) = (direction, rpm);
        outputs
    }

    /// Milliseconds until a message meets the condition, and that message.
    fn until(
        spindle: &mut SimSpindle,
        from_ms: u64,
        outputs: &MachineOutputs,
        flag: u32,
    ) -> Option<(u64, SpindleFeedback)> {
        (from_ms + 1..from_ms + 10_000).find_map(|ms| {
            let message = spindle.step(ms * MS, outputs, &[])?;
            (message.flags & flag != 0).then_some((ms - from_ms, message))
        })
    }

    #[test]
    fn a_spindle_accelerates_and_reports_at_speed() {
        let mut spindle = SimSpindle::new(SpindleSimulation::usual(0), 1);
        spindle.step(0, &outputs(0, 0.0), &[]);
        let (after_ms, message) =
            until(&mut spindle, 0, &outputs(1, 1000.0), spindle_flags::AT_SPEED).unwrap();
        // 980 of 1000 rpm at 2000 rpm/s.
        assert_eq!(after_ms, 490);
        assert_eq!((message.outputs_sequence, message.sequence), (7, 491));
        let (after_ms, _) = until(&mut spindle, 490, &outputs(2, 1000.0), spindle_flags::AT_SPEED).unwrap();
        assert_eq!(after_ms, 980);
    }

    #[test]
    fn the_angle_is_the_integral_of_the_speed() {
        let simulation = SpindleSimulation {
            ripple: 0.02,
            counts: 1000,
            ..SpindleSimulation::usual(0)
        };
        let mut spindle = SimSpindle::new(simulation, 1);
        let (mut last, mut count) = (None::<SpindleFeedback>, 0);
        for ms in 0..5000 {
            let message = spindle.step(ms * MS, &outputs(1, 600.0), &[]).unwrap();
            let angle = message.turns as f64 + message.fraction;
            assert!((spindle.angle() - angle).abs() <= 0.5001e-3, "{ms} ms");
            if let Some(last) = last {
                let before = last.turns as f64 + last.fraction;
                let step = message.speed_rpm / 60e3;
                assert!((angle - before - step).abs() < 2.1e-3, "{ms} ms");
                count += 1;
            }
            last = Some(message);
        }
        assert_eq!(count, 4999);
        // 600 rpm: 10 turns a second, less the loss during acceleration.
        assert!((45.0..50.0).contains(&spindle.angle()), "{}", spindle.angle());
    }

    #[test]
    fn it_turns_to_an_angle_by_the_way_that_is_asked_for() {
        for (direction, min, max) in [(0, 0.0, 0.5), (1, 0.0, 1.0), (2, -1.0, 0.0)] {
            let mut spindle = SimSpindle::new(SpindleSimulation::usual(0), 1);
            spindle.step(0, &outputs(1, 60.0), &[]);
            until(&mut spindle, 0, &outputs(1, 60.0), spindle_flags::INDEXED).unwrap();
            until(&mut spindle, 3000, &outputs(0, 60.0), spindle_flags::AT_SPEED).unwrap();
            let before = spindle.angle();
            let mut wanted = outputs(3, 60.0);
            (wanted.spindle_angle[0], wanted.spindle_way[0]) = (90.0, direction);
            let (_, message) = until(&mut spindle, 20_000, &wanted, spindle_flags::ORIENTED).unwrap();
            assert!((message.fraction - 0.25).abs() < 4e-4, "{}", message.fraction);
            let turned = spindle.angle() - before;
            assert!(
                (min - 1e-3..=max + 1e-3).contains(&turned),
                "way {direction}: {turned}"
            );
        }
    }

    #[test]
    fn faults_are_seen_in_its_feedback() {
        let mut spindle = SimSpindle::new(SpindleSimulation::usual(0), 1);
        spindle.step(0, &outputs(1, 1000.0), &[]);
        until(&mut spindle, 0, &outputs(1, 1000.0), spindle_flags::AT_SPEED).unwrap();
        let silent = spindle.step(500 * MS, &outputs(1, 1000.0), &[FaultKind::SpindleSilent]);
        assert_eq!(silent, None);
        let fault = spindle.step(501 * MS, &outputs(1, 1000.0), &[FaultKind::SpindleFault]);
        assert_eq!(fault.unwrap().flags & spindle_flags::FAULT, spindle_flags::FAULT);
        let stalled = (502..600).find_map(|ms| {
            let message = spindle.step(ms * MS, &outputs(1, 1000.0), &[FaultKind::SpindleStall])?;
            (message.speed_rpm == 0.0).then_some(ms)
        });
        assert!(stalled.is_some_and(|ms| ms < 540), "{stalled:?}");
        let slow = (600..2000)
            .filter_map(|ms| spindle.step(ms * MS, &outputs(1, 1000.0), &[FaultKind::SpindleSlow]))
            .last()
            .unwrap();
        assert!((slow.speed_rpm - 500.0).abs() < 1.0 && slow.flags & spindle_flags::AT_SPEED == 0);
    }

    #[test]
    fn what_is_delayed_has_the_time_of_its_sample() {
        let simulation = SpindleSimulation {
            delay_ns: 5 * MS,
            ..SpindleSimulation::usual(0)
        };
        let mut spindle = SimSpindle::new(simulation, 1);
        for ms in 0..20 {
            let sent = spindle.step(ms * MS, &outputs(1, 100.0), &[]);
            assert_eq!(
                sent.map(|message| message.time_ns),
                (ms >= 5).then(|| (ms - 5) * MS)
            );
        }
    }
}
