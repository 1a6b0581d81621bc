//! The end of a run whose spindles have ramps: setpoints at rest continue until the ramps have ended at 0.

use evolvent_machine::SignalSettings;
use evolvent_motion::{MotionState, Setpoint, flags};
use evolvent_path::Axes;

use crate::shared::Controls;

/// Time beyond the longest ramp for the publisher's lag, ns.
const MARGIN_NS: u64 = 500_000_000;

/// Whether a run continues for its spindles after the end of its program. Real-time safe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpindleRundown {
    /// Maximum number of setpoints after the end; 0 if no spindle has a ramp.
    max_cycles: u64,
    /// The setpoint with which the program ended.
    ended: Option<u64>,
    is_running: bool,
}

impl SpindleRundown {
    /// The run ends with its program.
    pub(crate) const NONE: Self = Self {
        max_cycles: 0,
        ended: None,
        is_running: false,
    };

    /// Continues at most as long as the slowest ramp takes from its highest speed.
    pub(crate) fn new(settings: &SignalSettings, period_ns: u64) -> Self {
        let longest_s = settings
            .spindles
            .iter()
            .filter_map(|spindle| Some(spindle.max_rpm / spindle.ramp_rpm_s?))
            .fold(0.0, f64::max);
        if longest_s == 0.0 {
            return Self::NONE;
        }
        let longest_ns = (longest_s * 1e9) as u64;
        Self {
            max_cycles: longest_ns.saturating_add(MARGIN_NS) / period_ns.max(1),
            ..Self::NONE
        }
    }

    /// Whether the run continues although its program has ended.
    pub(crate) fn is_running(&self) -> bool {
        self.is_running
    }

    /// For a setpoint that could be the last: returns whether another follows, and then clears its flag LAST.
    /// After a fault, and with an open emergency-stop chain, ramps end at once.
    pub(crate) fn follow(&mut self, setpoint: &mut Setpoint, controls: &Controls, is_estopped: bool) -> bool {
        let is_at_end = setpoint.flags & flags::LAST != 0
            && matches!(setpoint.state, MotionState::Done | MotionState::Stopped)
            && !is_estopped;
        self.is_running = false;
        if is_at_end && self.max_cycles > 0 {
            let ended = *self.ended.get_or_insert(setpoint.sequence);
            let is_bounded = setpoint.sequence - ended < self.max_cycles;
            self.is_running = is_bounded && !controls.are_ramps_at_rest_after(ended);
        }
        if self.is_running {
            setpoint.flags &= !flags::LAST;
        }
        self.is_running
    }
}

/// The setpoint after the end of a program, at rest. It is the last unless another follows.
pub(crate) fn rest_after(last: &Setpoint) -> Setpoint {
    Setpoint {
        sequence: last.sequence + 1,
        velocity: Axes::zeros(),
        acceleration: Axes::zeros(),
        jerk: Axes::zeros(),
        feed_mm_s: 0.0,
        flags: flags::LAST,
        ..*last
    }
}

#[cfg(test)]
mod tests {
    use evolvent_machine::{AtSpeed, SpindleSettings};

    use super::*;

    fn settings(ramp_rpm_s: Option<f64>) -> SignalSettings {
        SignalSettings {
            spindles: vec![SpindleSettings {
                number: 2,
                max_rpm: 3000.0,
                reverse: true,
                at_speed: AtSpeed::Unknown,
                at_speed_timeout_s: 10.0,
                acceleration_rpm_s: None,
                ramp_rpm_s,
            }],
            ..SignalSettings::default()
        }
    }

    fn last(sequence: u64, state: MotionState) -> Setpoint {
        Setpoint {
            sequence,
            position: Axes::zeros(),
            velocity: Axes::zeros(),
            acceleration: Axes::zeros(),
            jerk: Axes::zeros(),
            path_mm: 0.0,
            feed_mm_s: 0.0,
            feed_override: 1.0,
            line: 3,
            block: 2,
            state,
            flags: flags::LAST,
            actions: 0,
        }
    }

    /// Number of setpoints until one keeps its flag; the publisher reports each of them `lag` setpoints
    /// later.
    fn cycles(settings: &SignalSettings, state: MotionState, turns_until: u64, lag: u64) -> u64 {
        let controls = Controls::new(1.0);
        let mut rundown = SpindleRundown::new(settings, 1_000_000);
        let mut setpoint = last(100, state);
        while rundown.follow(&mut setpoint, &controls, false) {
            assert_eq!(setpoint.flags & flags::LAST, 0);
            let reported_sequence = setpoint.sequence.saturating_sub(lag);
            controls.report_ramps(reported_sequence, reported_sequence < turns_until);
            setpoint = rest_after(&setpoint);
        }
        assert_eq!(setpoint.flags, flags::LAST);
        setpoint.sequence - 100
    }

    #[test]
    fn a_run_waits_for_ramps_up_to_their_longest_time() {
        let ramp = settings(Some(1000.0));
        assert_eq!(cycles(&ramp, MotionState::Done, 700, 2), 603);
        assert_eq!(cycles(&ramp, MotionState::Stopped, 700, 2), 603);
        // Reports from before the end do not count.
        assert_eq!(cycles(&ramp, MotionState::Done, 0, 2), 3);
        // 3 s of ramp and half a second of margin.
        assert_eq!(cycles(&ramp, MotionState::Done, u64::MAX, 2), 3500);
        assert_eq!(cycles(&ramp, MotionState::Fault, 700, 2), 0);
        assert_eq!(cycles(&settings(None), MotionState::Done, 700, 2), 0);
        let mut rundown = SpindleRundown::new(&ramp, 1_000_000);
        assert!(!rundown.follow(&mut last(5, MotionState::Stopped), &Controls::new(1.0), true));
    }
}
