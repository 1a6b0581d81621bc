//! Setpoints for the scope, each with the answers of drives and sensors.

use std::collections::VecDeque;

use evolvent_bus::{Feedback, Load, Setpoint};
use evolvent_machine::SignalSettings;
use evolvent_wire::AXES;

use crate::messages::{SAMPLE_BYTES, SampleAnswer, put_sample};
use crate::sampled_signals::SampledSignals;

/// Maximum time that a setpoint waits for its answer, ns.
const PATIENCE_NS: u64 = 60_000_000;
/// An answer or a load is not used for setpoints later than this, ns.
pub(crate) const STALE_NS: u64 = 100_000_000;
/// Maximum number of waiting setpoints, answers and loads; beyond it the oldest are dropped.
const MAX_WAITING: usize = 4096;

/// Combines setpoints, feedback and loads.
#[derive(Debug)]
pub(crate) struct Sampler {
    setpoints: VecDeque<Setpoint>,
    answers: VecDeque<Feedback>,
    loads: VecDeque<(u64, f64)>,
    /// The last figures of the drives, and the due time of the setpoint that they belong to.
    errors: [(u64, f64); AXES],
    velocities: [(u64, f64); AXES],
    positions: [(u64, f64); AXES],
    torques: [(u64, f64); AXES],
    phase_error_us: (u64, f64),
    load: (u64, f64),
    /// Spindles, inputs and outputs.
    pub(crate) signals: SampledSignals,
}

impl Sampler {
    /// For a machine with these signals.
    pub(crate) fn new(signals: &SignalSettings) -> Self {
        Self {
            signals: SampledSignals::new(signals),
            setpoints: VecDeque::new(),
            answers: VecDeque::new(),
            loads: VecDeque::new(),
            errors: [(0, f64::NAN); AXES],
            velocities: [(0, f64::NAN); AXES],
            positions: [(0, f64::NAN); AXES],
            torques: [(0, f64::NAN); AXES],
            phase_error_us: (0, f64::NAN),
            load: (0, f64::NAN),
        }
    }

    /// Size of a sample, bytes.
    pub(crate) fn sample_bytes(&self) -> usize {
        SAMPLE_BYTES + 4 * self.signals.len()
    }
}

pub(crate) fn push<T>(list: &mut VecDeque<T>, item: T) {
    if list.len() >= MAX_WAITING {
        list.pop_front();
    }
    list.push_back(item);
}

impl Sampler {
    pub(crate) fn setpoint(&mut self, setpoint: Setpoint) {
        push(&mut self.setpoints, setpoint);
    }

    pub(crate) fn feedback(&mut self, feedback: Feedback) {
        // An answer to a setpoint that was never sent would block all others forever.
        let newest = self.setpoints.back().map_or(u64::MAX, |newest| newest.sequence);
        if feedback.sequence <= newest {
            push(&mut self.answers, feedback);
        }
    }

    pub(crate) fn load(&mut self, load: &Load) {
        if load.is_valid() {
            push(&mut self.loads, (load.time_ns, load.value));
        }
    }

    /// The complete samples, in binary.
    pub(crate) fn take(&mut self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(self.setpoints.len() * self.sample_bytes());
        let newest_ns = self.setpoints.back().map_or(0, |newest| newest.due_time_ns);
        let answered = self.answers.back().map_or(0, |newest| newest.sequence);
        while let Some(setpoint) = self.setpoints.front() {
            let is_complete =
                setpoint.sequence <= answered || setpoint.due_time_ns.saturating_add(PATIENCE_NS) < newest_ns;
            if !is_complete {
                break;
            }
            let Some(setpoint) = self.setpoints.pop_front() else {
                break;
            };
            self.answer(&setpoint);
            let fresh = |(at, value): (u64, f64)| {
                if setpoint.due_time_ns.saturating_sub(at) <= STALE_NS {
                    value
                } else {
                    f64::NAN
                }
            };
            let answer = SampleAnswer {
                following_error: &self.errors.map(fresh),
                velocity: &self.velocities.map(fresh),
                position: &self.positions.map(fresh),
                torque: &self.torques.map(fresh),
                phase_error_us: fresh(self.phase_error_us),
                load: fresh(self.load),
                signals: self.signals.at(setpoint.sequence, setpoint.due_time_ns),
            };
            put_sample(&mut bytes, &setpoint, &answer);
        }
        bytes
    }

    /// Takes in the answers up to a setpoint.
    fn answer(&mut self, setpoint: &Setpoint) {
        while self
            .answers
            .front()
            .is_some_and(|answer| answer.sequence <= setpoint.sequence)
        {
            let Some(answer) = self.answers.pop_front() else {
                break;
            };
            for axis in (0..AXES).filter(|axis| answer.axes_mask >> axis & 1 == 1) {
                self.errors[axis] = (setpoint.due_time_ns, answer.following_error[axis]);
                self.velocities[axis] = (setpoint.due_time_ns, answer.velocity[axis]);
                self.positions[axis] = (setpoint.due_time_ns, answer.position[axis]);
                self.torques[axis] = (setpoint.due_time_ns, answer.torque_ratio[axis]);
            }
            self.phase_error_us = (setpoint.due_time_ns, answer.phase_error_ns as f64 * 1e-3);
        }
        while self
            .loads
            .front()
            .is_some_and(|(at, _)| *at <= setpoint.due_time_ns)
        {
            self.load = self.loads.pop_front().unwrap_or(self.load);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setpoint(sequence: u64) -> Setpoint {
        Setpoint {
            sequence,
            due_time_ns: sequence * 1_000_000,
            ..Setpoint::default()
        }
    }

    fn feedback(sequence: u64, error: f64) -> Feedback {
        let mut answer = Feedback {
            sequence,
            axes_mask: 1,
            ..Feedback::default()
        };
        (answer.following_error[0], answer.velocity[0]) = (error, -error);
        (answer.position[0], answer.torque_ratio[0]) = (2.0 * error, 0.5 * error);
        answer.phase_error_ns = 1000 * error as i64;
        answer
    }

    /// Of a machine without signals.
    fn sampler() -> Sampler {
        let file = include_str!("../../../../config/machines/mill-3axis.toml");
        let mut signals = evolvent_machine::Machine::parse(file, "mill.toml")
            .unwrap()
            .signals;
        signals.spindles.clear();
        signals.inputs.clear();
        signals.outputs.clear();
        Sampler::new(&signals)
    }

    /// Time, following errors of the first two axes, load. The measured velocity is the negative following
    /// error.
    fn read(bytes: &[u8]) -> Vec<(f64, f32, f32, f32)> {
        let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let one = |at: usize| {
            let time = f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
            let (error, velocity) = (float(at + 24 + 108), float(at + 24 + 148));
            assert!(velocity == -error || velocity.is_nan() && error.is_nan());
            let (position, torque, phase) =
                (float(at + 24 + 184), float(at + 24 + 220), float(at + 24 + 256));
            assert!(position == 2.0 * error || position.is_nan() && error.is_nan());
            assert!(torque == 0.5 * error || torque.is_nan() && error.is_nan());
            assert!(phase == error.trunc() || phase.is_nan() && error.is_nan());
            (
                time,
                float(at + 24 + 108),
                float(at + 24 + 112),
                float(at + 24 + 144),
            )
        };
        (0..bytes.len()).step_by(SAMPLE_BYTES).map(one).collect()
    }

    #[test]
    fn each_setpoint_has_the_answer_to_it() {
        let mut sampler = sampler();
        (100..110).for_each(|sequence| sampler.setpoint(setpoint(sequence)));
        (100..106).for_each(|sequence| sampler.feedback(feedback(sequence, sequence as f64)));
        sampler.feedback(feedback(u64::MAX, 7.0));
        for (time_ns, value) in [(102_500_000, 5.0), (104_500_000, 6.0), (104_600_000, f64::NAN)] {
            sampler.load(&Load {
                time_ns,
                value,
                kind: 1,
                range_max: 10.0,
                ..Load::default()
            });
        }
        let samples = read(&sampler.take());
        assert_eq!(samples.len(), 6, "later ones wait for their answers");
        for (i, (time, x, y, load)) in samples.iter().enumerate() {
            assert!((time - (0.1 + 0.001 * i as f64)).abs() < 1e-9);
            assert_eq!((*x, y.is_nan()), (100.0 + i as f32, true));
            let expected = [None, None, None, Some(5.0), Some(5.0), Some(6.0)][i];
            assert_eq!((!load.is_nan()).then_some(*load), expected);
        }
        assert!(sampler.take().is_empty());
    }

    #[test]
    fn setpoints_are_shown_without_feedback() {
        let mut sampler = sampler();
        sampler.setpoint(setpoint(1));
        sampler.feedback(feedback(1, 0.5));
        assert_eq!(read(&sampler.take())[0].1, 0.5);
        (2..1000).for_each(|sequence| sampler.setpoint(setpoint(sequence)));
        let samples = read(&sampler.take());
        assert_eq!(samples.len(), 998 - 61);
        assert_eq!(samples[50].1, 0.5, "as it was told last");
        assert!(samples[200].1.is_nan(), "not for ever");
        (1000..20_000).for_each(|sequence| sampler.setpoint(setpoint(sequence)));
        assert!(sampler.take().len() <= MAX_WAITING * SAMPLE_BYTES);
    }
}
