//! A core that moves, and a bridge whose feedback is monitored.

#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use evolvent_drive::{
    BridgeState, DriveAlarm, DriveSetpoint, DriveState, FeedbackWatch, PowerRequest, Presence, WatchSettings,
    bits,
};
use evolvent_path::AxisMask;
use evolvent_wire::{AXES, Feedback};

pub(crate) const PERIOD_NS: u64 = 1_000_000;
pub(crate) const AXES_MASK: u32 = 0b111;
/// Number of cycles from a setpoint to its feedback.
pub(crate) const DELAY: u64 = 4;
/// Lag of the axes, s.
pub(crate) const LAG_S: f64 = 0.008;

pub(crate) fn settings() -> WatchSettings {
    let mut settings = WatchSettings::new(PERIOD_NS, AxisMask::from_bits(AXES_MASK));
    settings.enable_timeout_ns = 100_000_000;
    settings
}

/// A core that moves X to and fro at up to 300 mm/s, and a bridge with correct feedback.
pub(crate) struct Bench {
    pub(crate) watch: FeedbackWatch,
    pub(crate) cycle: u64,
    pub(crate) power: PowerRequest,
    pub(crate) datum: u64,
    pub(crate) instance: u64,
    pub(crate) absolute_mask: u32,
    pub(crate) status: DriveState,
    pub(crate) state: BridgeState,
    pub(crate) shift: f64,
    pub(crate) delay: u64,
    pub(crate) switches_expected: [AxisMask; 2],
}

impl Bench {
    pub(crate) fn new(settings: WatchSettings) -> Self {
        Self {
            watch: FeedbackWatch::new(settings),
            cycle: 0,
            power: PowerRequest::On,
            datum: 0,
            instance: 1,
            absolute_mask: 0,
            status: DriveState::OperationEnabled,
            state: BridgeState::Following,
            shift: 0.0,
            delay: DELAY,
            switches_expected: [AxisMask::NONE; 2],
        }
    }

    pub(crate) fn position(time_s: f64) -> [f64; 2] {
        // 30 mm and 10 rad/s, from rest.
        let angle = 10.0 * time_s.max(0.0);
        [30.0 * (1.0 - angle.cos()), 300.0 * angle.sin()]
    }

    pub(crate) fn command(&self) -> DriveSetpoint {
        let [position, velocity] = Self::position((self.cycle as f64 - 50.0) * 1e-3);
        let mut command = DriveSetpoint {
            sequence: self.cycle,
            position: [0.0; AXES],
            velocity: [0.0; AXES],
            datum: self.datum,
            power: self.power,
            fault_reset: 0,
            switches_expected: self.switches_expected,
        };
        command.position[0] = position + self.shift;
        command.velocity[0] = if self.cycle < 50 { 0.0 } else { velocity };
        command
    }

    pub(crate) fn now_ns(&self) -> u64 {
        1_000_000_000 + self.cycle * PERIOD_NS
    }

    pub(crate) fn feedback(&self) -> Feedback {
        let [position, velocity] =
            Self::position((self.cycle as f64 - self.delay as f64 - 50.0) * 1e-3 - LAG_S);
        let mut feedback = Feedback {
            sequence: self.cycle.saturating_sub(self.delay),
            time_ns: self.now_ns() - PERIOD_NS / 2,
            axes_mask: AXES_MASK,
            bridge_state: self.state.number(),
            datum: self.datum,
            instance: self.instance,
            absolute_mask: self.absolute_mask,
            status_word: [u32::from(self.status.code() | bits::REMOTE); AXES],
            ..Feedback::default()
        };
        feedback.position[0] = position + self.shift;
        feedback.velocity[0] = velocity;
        feedback
    }

    /// Runs one cycle with modified feedback, or without any if `change` returns `None`.
    pub(crate) fn cycle(
        &mut self,
        change: impl FnOnce(Feedback) -> Option<Feedback>,
    ) -> Result<Presence, DriveAlarm> {
        let feedback = change(self.feedback());
        let result = self.watch.step(self.now_ns(), &self.command(), feedback.as_ref());
        self.cycle += 1;
        result
    }

    /// Runs cycles without a fault, which must raise no alarm.
    pub(crate) fn run(&mut self, cycles: u64) -> Presence {
        let mut last = Presence::Absent;
        for _ in 0..cycles {
            last = self.cycle(Some).expect("nothing is wrong");
        }
        last
    }

    /// Returns the first alarm within a number of cycles with modified feedback, and its cycle.
    pub(crate) fn alarm(
        &mut self,
        cycles: u64,
        change: impl Fn(Feedback) -> Option<Feedback>,
    ) -> (DriveAlarm, u64) {
        for n in 0..cycles {
            if let Err(alarm) = self.cycle(&change) {
                return (alarm, n);
            }
        }
        unreachable!("no alarm in {cycles} cycles");
    }
}

pub(crate) fn running() -> Bench {
    let mut bench = Bench::new(settings());
    assert_eq!(bench.run(200), Presence::Operational);
    bench
}
