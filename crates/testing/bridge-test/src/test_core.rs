//! A core that a case controls, to do right or wrong.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use core::time::Duration;
use std::sync::Arc;

use evolvent_bridge_sim::monotonic_ns;
use evolvent_bus::{
    AXES, BusConfig, BusError, CoreBus, Feedback, MachineInputs, MachineOutputs, Setpoint, SpindleFeedback,
};
use evolvent_drive::{BridgeState, DriveState, PowerRequest};

use crate::case::CaseError;

/// The suite's period: slow enough for a busy machine.
pub(crate) const PERIOD_NS: u64 = 2_000_000;
/// Periods between sending a setpoint and its due time.
pub(crate) const LEAD: u64 = 100;
/// Time limit for actions of a bridge without a time limit of their own, s: a busy host may need that.
pub(crate) const LATEST_S: f64 = 20.0;
/// Cycles between messages of unchanged outputs.
const OUTPUTS_EVERY: u64 = 25;
/// Axes of the suite's machine.
pub(crate) const LETTERS: &str = "XYZ";
const AXES_MASK: u32 = 0b111;

/// Silence after which a bridge counts as suspended or ended.
const SILENT_NS: u64 = 100_000_000;
/// Time to wait for a silent bridge to send again before it is judged, s.
const PATIENCE_S: f64 = 5.0;

/// Number of times that the host kept a test core from running until the bridge ran out of setpoints, or kept
/// the bridge from running. Neither is a fault of the bridge.
pub(crate) static DISTURBED: AtomicU32 = AtomicU32::new(0);

/// Feedback that one cycle has received.
#[derive(Clone, Copy, Debug)]
pub struct FeedbackSample {
    /// Time of the cycle, ns of CLOCK_MONOTONIC.
    pub now_ns: u64,
    /// The newest feedback.
    pub feedback: Feedback,
}

/// Treatment of a setpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fate {
    Sent,
    Lost,
}

/// A core of the suite's machine, driven cycle by cycle by a case.
#[derive(Debug)]
pub struct TestCore {
    bus: CoreBus,
    sequence: u64,
    next_ns: u64,
    /// Commanded positions of the axes.
    position: [f64; AXES],
    velocity: f64,
    acceleration: f64,
    power: PowerRequest,
    fault_reset: u32,
    datum: u64,
    feedback: Option<Feedback>,
    /// Time of arrival of the newest feedback.
    received_ns: u64,
    /// All feedback, in order.
    log: Vec<FeedbackSample>,
    /// Outputs in force, repeated every [`OUTPUTS_EVERY`] cycles.
    outputs: Option<MachineOutputs>,
    /// Time at which outputs were last sent.
    outputs_left_ns: u64,
    /// Every message of inputs with its time of arrival.
    inputs: Vec<(u64, MachineInputs)>,
    /// Every message of spindle 0 with its time of arrival.
    spindle: Vec<(u64, SpindleFeedback)>,
    /// Ends every wait and motion.
    stop: Arc<AtomicBool>,
}

impl TestCore {
    /// Opens the bus as a core.
    ///
    /// # Errors
    /// Another core is running, or the bus cannot be used.
    pub fn open(machine_name: &str, prefix: &str) -> Result<Self, BusError> {
        let mut config = BusConfig::new(machine_name, LETTERS, PERIOD_NS);
        config.prefix = Some(prefix.to_owned());
        Ok(Self {
            bus: CoreBus::open(&config)?,
            sequence: 0,
            next_ns: monotonic_ns(),
            position: [0.0; AXES],
            velocity: 0.0,
            acceleration: 0.0,
            power: PowerRequest::Off,
            fault_reset: 0,
            datum: 0,
            feedback: None,
            received_ns: 0,
            log: Vec::new(),
            outputs: None,
            outputs_left_ns: 0,
            inputs: Vec::new(),
            spindle: Vec::new(),
            stop: Arc::default(),
        })
    }

    /// Makes cycles return at once after `stop` is set, so that a case ends soon.
    pub(crate) fn with_stop(mut self, stop: &Arc<AtomicBool>) -> Self {
        self.stop = Arc::clone(stop);
        self
    }

    /// Sets the initial value of the counter of resets.
    pub(crate) const fn with_fault_resets(mut self, count: u32) -> Self {
        self.fault_reset = count;
        self
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Returns every message of inputs since the last call, with its time of arrival, ns.
    pub(crate) fn take_inputs(&mut self) -> Vec<(u64, MachineInputs)> {
        std::mem::take(&mut self.inputs)
    }

    /// Sets digital output 0, whose safe value is off, from the setpoint of the next cycle on. Returns the
    /// message, which has the due time.
    pub(crate) fn set_output(&mut self, on: bool) -> MachineOutputs {
        self.send_outputs(MachineOutputs {
            digital_mask: 1,
            digital: u64::from(on),
            ..MachineOutputs::default()
        })
    }

    /// Turns spindle 0 at a speed, counter-clockwise if negative, from the setpoint of the next cycle on.
    /// Returns the message, which has the due time.
    pub(crate) fn set_spindle(&mut self, rpm: f64) -> MachineOutputs {
        let mut outputs = MachineOutputs {
            spindle_mask: 1,
            ..MachineOutputs::default()
        };
        outputs.spindle_direction[0] = match rpm {
            rpm if rpm > 0.0 => 1,
            rpm if rpm < 0.0 => 2,
            _ => 0,
        };
        outputs.spindle_rpm[0] = rpm.abs();
        self.send_outputs(outputs)
    }

    fn send_outputs(&mut self, wanted: MachineOutputs) -> MachineOutputs {
        let before = self.outputs.map_or(0, |outputs| outputs.sequence);
        let outputs = MachineOutputs {
            sequence: before + 1,
            cycle: self.sequence,
            due_time_ns: self.next_ns + LEAD * PERIOD_NS,
            ..wanted
        };
        // A message that is not sent is followed by the next.
        let _reached = self.bus.publish_outputs(&outputs);
        self.outputs = Some(outputs);
        self.outputs_left_ns = monotonic_ns();
        outputs
    }

    /// Sends nothing for a time, and receives.
    pub(crate) fn be_silent(&mut self, seconds: f64) {
        let end_ns = monotonic_ns() + (seconds * 1e9) as u64;
        while monotonic_ns() < end_ns && !self.is_stopped() {
            std::thread::sleep(Duration::from_nanos(PERIOD_NS));
            let now_ns = monotonic_ns();
            self.receive_inputs(now_ns);
            self.receive_feedback(now_ns);
        }
        self.next_ns = monotonic_ns();
    }

    /// Time at which the last message of outputs was sent, ns of CLOCK_MONOTONIC; 0 for none.
    pub(crate) const fn outputs_left_ns(&self) -> u64 {
        self.outputs_left_ns
    }

    fn receive_inputs(&mut self, now_ns: u64) {
        while let Ok(Some(message)) = self.bus.unchecked_inputs() {
            self.inputs.push((now_ns, message));
        }
        while let Ok(Some(message)) = self.bus.unchecked_spindle() {
            if message.spindle == 0 {
                self.spindle.push((now_ns, message));
            }
        }
    }

    /// Returns every message of spindle 0 since the last call, with its time of arrival, ns.
    pub(crate) fn take_spindle(&mut self) -> Vec<(u64, SpindleFeedback)> {
        std::mem::take(&mut self.spindle)
    }

    /// The newest feedback.
    #[must_use]
    pub const fn feedback(&self) -> Option<&Feedback> {
        self.feedback.as_ref()
    }

    /// Returns all feedback since the last call.
    pub fn take_log(&mut self) -> Vec<FeedbackSample> {
        std::mem::take(&mut self.log)
    }

    pub(crate) fn request(&mut self, power: PowerRequest) {
        self.power = power;
    }

    /// Requests a reset of the drives' faults. Returns its number.
    pub(crate) fn reset_faults(&mut self) -> u32 {
        self.fault_reset += 1;
        self.fault_reset
    }

    pub(crate) fn commanded(&self) -> [f64; AXES] {
        self.position
    }

    pub(crate) fn set_position(&mut self, position: [f64; AXES]) {
        self.position = position;
    }

    pub(crate) fn rename(&mut self, shift: f64) {
        self.datum += 1;
        self.position[0] += shift;
    }

    /// Runs one cycle: publishes a setpoint, sleeps until the next cycle, receives feedback.
    pub(crate) fn cycle(&mut self, tamper: &mut dyn FnMut(&mut Setpoint) -> Fate) {
        if self.is_stopped() {
            return;
        }
        let mut setpoint = Setpoint {
            sequence: self.sequence,
            due_time_ns: self.next_ns + LEAD * PERIOD_NS,
            period_ns: PERIOD_NS,
            position: self.position,
            axes_mask: AXES_MASK,
            state: 1,
            override_ratio: 1.0,
            power_request: self.power.number(),
            fault_reset: self.fault_reset,
            datum: self.datum,
            ..Setpoint::default()
        };
        setpoint.velocity[0] = self.velocity;
        setpoint.acceleration[0] = self.acceleration;
        self.sequence += 1;
        if tamper(&mut setpoint) == Fate::Sent {
            // A setpoint that is not sent counts as lost; the case sees the effect.
            let _reached = self.bus.publish_setpoint(&setpoint);
        }
        self.next_ns += PERIOD_NS;
        let now_ns = monotonic_ns();
        if now_ns > self.next_ns + LEAD * PERIOD_NS * 3 / 4 {
            // This process was kept from running: continue from now, as a restarted core would.
            self.next_ns = now_ns;
            DISTURBED.fetch_add(1, Ordering::Relaxed);
        }
        std::thread::sleep(Duration::from_nanos(self.next_ns.saturating_sub(now_ns)));
        let now_ns = monotonic_ns();
        self.bus.admit_readers();
        self.receive_inputs(now_ns);
        if let Some(outputs) = &mut self.outputs
            && self.sequence.is_multiple_of(OUTPUTS_EVERY)
        {
            outputs.sequence += 1;
            let _reached = self.bus.publish_outputs(outputs);
            self.outputs_left_ns = monotonic_ns();
        }
        self.receive_feedback(now_ns);
    }

    fn receive_feedback(&mut self, now_ns: u64) {
        while let Ok(Some(feedback)) = self.bus.unchecked_feedback() {
            let silent_ns = now_ns.saturating_sub(self.received_ns);
            if self
                .feedback
                .is_some_and(|last| was_paused(&last, silent_ns, &feedback))
            {
                DISTURBED.fetch_add(1, Ordering::Relaxed);
            }
            self.received_ns = now_ns;
            self.feedback = Some(feedback);
            self.log.push(FeedbackSample { now_ns, feedback });
        }
    }

    /// Whether the bridge has sent feedback and is silent now.
    fn is_silent(&self) -> bool {
        self.feedback.is_some() && monotonic_ns().saturating_sub(self.received_ns) > SILENT_NS
    }

    /// Runs cycles at rest, and more if the bridge is silent, so that it is judged by new feedback and not by
    /// old.
    pub(crate) fn rest(&mut self, seconds: f64) {
        self.rest_with(seconds, &mut |_| Fate::Sent);
    }

    pub(crate) fn rest_with(&mut self, seconds: f64, tamper: &mut dyn FnMut(&mut Setpoint) -> Fate) {
        (self.velocity, self.acceleration) = (0.0, 0.0);
        for _ in 0..cycles(seconds) {
            self.cycle(tamper);
        }
        for _ in 0..cycles(PATIENCE_S) {
            if !self.is_silent() {
                break;
            }
            self.cycle(tamper);
        }
    }

    /// Runs cycles at rest until the feedback meets a condition.
    ///
    /// # Errors
    /// The condition is not met in time.
    pub(crate) fn until(
        &mut self,
        what: &'static str,
        seconds: f64,
        mut condition: impl FnMut(&Feedback) -> bool,
    ) -> Result<Feedback, CaseError> {
        (self.velocity, self.acceleration) = (0.0, 0.0);
        let begin_ns = monotonic_ns();
        loop {
            self.cycle(&mut |_| Fate::Sent);
            if self.is_stopped() {
                return Err(CaseError::new("stopped"));
            }
            let fresh = self
                .feedback
                .filter(|feedback| feedback.time_ns.saturating_add(200_000_000) > monotonic_ns());
            if let Some(feedback) = fresh.filter(|feedback| condition(feedback)) {
                return Ok(feedback);
            }
            if monotonic_ns() - begin_ns > (seconds * 1e9) as u64 {
                return Err(CaseError::new(format!(
                    "{what}: not within {seconds} s; {}",
                    self.describe()
                )));
            }
        }
    }

    /// Waits for the bridge, sets the commanded position to that of the axes, resets faults of the drives, as
    /// a core does after the operator's RESET, and switches the drives on. Drives that lost their fieldbus
    /// under power, when the previous bridge ended, are in fault.
    ///
    /// # Errors
    /// There is no feedback in time, or the drives are not operational in time.
    pub(crate) fn bring_up(&mut self) -> Result<(), CaseError> {
        self.request(PowerRequest::Off);
        self.feedback = None;
        self.until("feedback of a bridge", 15.0, |_| true)?;
        // If power was on, the axes may still be stopping.
        let at_rest =
            |feedback: &Feedback| feedback.velocity[..3].iter().all(|velocity| velocity.abs() < 0.1);
        let off =
            |feedback: &Feedback| states(feedback).all(|state| state != Some(DriveState::OperationEnabled));
        let from = self.sequence;
        let here = self.until("axes at rest with the drives off", LATEST_S, |feedback| {
            at_rest(feedback) && off(feedback) && feedback.sequence >= from
        })?;
        self.position = here.position;
        self.rest(0.1);
        if states(&here).any(|state| state.is_some_and(DriveState::is_fault)) {
            let number = self.reset_faults();
            self.until(
                "the reset of faults that the drives had at the start",
                LATEST_S,
                |feedback| {
                    feedback.fault_reset_done == number
                        && !states(feedback).any(|state| state.is_some_and(DriveState::is_fault))
                },
            )?;
        }
        self.request(PowerRequest::On);
        self.until("drives in operation, following", LATEST_S, is_following)?;
        Ok(())
    }

    /// Moves the first axis smoothly by `by`, and back.
    pub(crate) fn swing(&mut self, by: f64, seconds: f64, tamper: &mut dyn FnMut(&mut Setpoint) -> Fate) {
        self.move_by(by, seconds / 2.0, tamper);
        self.move_by(-by, seconds / 2.0, tamper);
    }

    /// Moves the first axis by `by` with a quintic from rest to rest.
    pub(crate) fn move_by(&mut self, by: f64, seconds: f64, tamper: &mut dyn FnMut(&mut Setpoint) -> Fate) {
        let from = self.position[0];
        let count = cycles(seconds).max(1);
        let whole_s = count as f64 * PERIOD_NS as f64 * 1e-9;
        for i in 1..=count {
            let u = i as f64 / count as f64;
            let fraction = u * u * u * (10.0 + u * (6.0 * u - 15.0));
            let speed = 30.0 * u * u * (1.0 + u * (u - 2.0));
            let bend = 60.0 * u * (1.0 + u * (2.0 * u - 3.0));
            self.position[0] = from + by * fraction;
            self.velocity = by * speed / whole_s;
            self.acceleration = by * bend / (whole_s * whole_s);
            self.cycle(tamper);
        }
        (self.velocity, self.acceleration) = (0.0, 0.0);
    }

    /// Moves the first axis at a speed while `goes_on`, called after every cycle, returns true. Reaching the
    /// speed and stopping take a tenth of a second each.
    pub(crate) fn creep(&mut self, speed: f64, goes_on: &mut dyn FnMut(&mut Self) -> bool) {
        let ramp = cycles(0.1);
        let period_s = PERIOD_NS as f64 * 1e-9;
        let (mut step, mut ends) = (0, false);
        while !(self.is_stopped() || ends && step == 0) {
            if ends {
                step -= 1;
            } else {
                step = (step + 1).min(ramp);
            }
            self.velocity = speed * step as f64 / ramp as f64;
            self.position[0] += self.velocity * period_s;
            self.cycle(&mut |_| Fate::Sent);
            ends |= !goes_on(self);
        }
        (self.velocity, self.acceleration) = (0.0, 0.0);
    }

    /// Describes the newest feedback, for errors.
    pub(crate) fn describe(&self) -> String {
        self.feedback.map_or("no feedback".to_owned(), |feedback| {
            let drives: Vec<String> = states(&feedback)
                .map(|state| state.map_or("unknown".to_owned(), |state| format!("{state:?}")))
                .collect();
            format!(
                "bridge state {}, note {}, drives {}, missed {}, replied to setpoint {} of {}",
                feedback.bridge_state,
                feedback.note,
                drives.join(" "),
                feedback.missed_setpoints,
                feedback.sequence,
                self.sequence
            )
        })
    }
}

/// Whether a bridge was kept from running between two feedback messages. A bridge that was restarted in
/// between was not.
fn was_paused(last: &Feedback, silent_ns: u64, next: &Feedback) -> bool {
    silent_ns > SILENT_NS && last.instance == next.instance
}

fn cycles(seconds: f64) -> u64 {
    (seconds * 1e9 / PERIOD_NS as f64) as u64
}

pub(crate) fn states(feedback: &Feedback) -> impl Iterator<Item = Option<DriveState>> + '_ {
    feedback.status_word[..LETTERS.len()]
        .iter()
        .map(|word| DriveState::decode((word & 0xFFFF) as u16))
}

pub(crate) fn is_following(feedback: &Feedback) -> bool {
    states(feedback).all(|state| state == Some(DriveState::OperationEnabled))
        && BridgeState::from_number(feedback.bridge_state) == Some(BridgeState::Following)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paused_and_dead_bridges_are_distinguished() {
        let of = |instance| Feedback {
            instance,
            ..Feedback::default()
        };
        assert!(was_paused(&of(1), SILENT_NS + 1, &of(1)));
        assert!(!was_paused(&of(1), SILENT_NS, &of(1)));
        assert!(!was_paused(&of(1), SILENT_NS + 1, &of(2)));
    }
}
