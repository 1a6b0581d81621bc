//! Converts the ideal setpoint of a cycle to the one sent to the drives, in the cycle and in recomputation.

use evolvent_compensation::Compensation;
use evolvent_machine::{Limits, Machine, SignalKind};
use evolvent_motion::{Guard, MotionState, Setpoint, Violation, flags};
use evolvent_path::{AXES, Axes, Jet};
use evolvent_signals::InputImage;

/// Distance within which the drives count as being where they were sent, mm or degrees. The conversion from
/// corrected to ideal and back is exact only up to rounding.
const POSITION_TOLERANCE: f64 = 1e-9;

/// Corrects every setpoint; exists only if the machine file describes errors of the machine.
///
/// One step per cycle. Real-time safe except construction.
#[derive(Clone, Debug)]
pub struct Corrections {
    compensation: Compensation,
    thermal_inputs: [Option<u32>; AXES],
    /// Limits of corrected setpoints. Travel is checked on ideal positions.
    limits: Limits,
    period_s: f64,
    guard: Guard,
    sent: Jet,
    /// The next setpoint does not continue the last one: the axes were given other coordinates, or moved
    /// without power.
    is_new: bool,
    fault: Option<Violation>,
}

impl Corrections {
    /// At rest at the ideal `position`; `None` if nothing is corrected.
    #[must_use]
    pub fn new(machine: &Machine, period_ns: u64, position: Axes) -> Option<Self> {
        if machine.corrections.is_none() {
            return None;
        }
        let period_s = period_ns as f64 * 1e-9;
        let mut limits = machine.drive_limits();
        limits.travel_min = Axes::repeat(f64::NEG_INFINITY);
        limits.travel_max = Axes::repeat(f64::INFINITY);
        let compensation = machine.corrections.design.compensation(period_s, position);
        let sent = compensation.corrected_position(&position);
        Some(Self {
            compensation,
            thermal_inputs: machine.corrections.thermal_inputs,
            limits,
            period_s,
            guard: Guard::new(limits, period_s, sent),
            sent: Jet::at_rest(sent),
            is_new: false,
            fault: None,
        })
    }

    /// Computes what the drives are sent for a setpoint. `inputs` holds the analog inputs for thermal growth.
    pub fn step(&mut self, setpoint: &Setpoint, inputs: Option<&InputImage>) -> Jet {
        for (axis, number) in self.thermal_inputs.iter().enumerate() {
            let value = number.and_then(|number| inputs?.value(SignalKind::Analog, number));
            if let Some(value) = value {
                self.compensation.set_thermal_offset(axis, value);
            }
        }
        // A backlash take-up may be in progress when the axes are given other coordinates, so acceleration
        // and jerk are unknown for three cycles.
        let is_new = std::mem::take(&mut self.is_new);
        if is_new {
            let before = self.compensation.corrected_position(&setpoint.position);
            self.guard = Guard::new(self.limits, self.period_s, before);
        }
        let corrected = self.compensation.step(&Jet {
            position: setpoint.position,
            first: setpoint.velocity,
            second: setpoint.acceleration,
            third: setpoint.jerk,
        });
        let is_joint = is_new || setpoint.flags & flags::JOINT != 0;
        // A stop of each axis on its own after a fault has its own limits.
        let is_stopping = matches!(setpoint.state, MotionState::Fault | MotionState::Stopping);
        if let Err(violation) = self.guard.check(&corrected.position, is_joint, is_stopping) {
            self.fault.get_or_insert(violation);
        }
        self.guard.publish(&corrected.position, is_joint);
        self.sent = corrected;
        corrected
    }

    /// The violation that the guard found in corrected setpoints since the last call, if any.
    pub fn take_fault(&mut self) -> Option<Violation> {
        self.fault.take()
    }

    /// Restarts at rest: the same position has other coordinates, or the machine was moved without power.
    pub fn relocate(&mut self, position: &Axes) {
        self.compensation.rebase_position(position);
        self.is_new = true;
    }

    /// The correction of the last setpoint, whose ideal position is `ideal`.
    #[must_use]
    pub fn shift(&self, ideal: &Axes) -> Axes {
        self.sent.position - ideal
    }

    /// The ideal position of the tool while the drives are at `positions` on the axes for which `is_known`
    /// holds, and as sent on the others. `None` if the drives are where they were sent.
    pub(crate) fn found(&self, positions: &[f64; AXES], is_known: impl Fn(usize) -> bool) -> Option<Axes> {
        let mut at = self.sent.position;
        let mut is_elsewhere = false;
        for (axis, value) in positions.iter().enumerate() {
            if is_known(axis) && (value - at[axis]).abs() > POSITION_TOLERANCE {
                at[axis] = *value;
                is_elsewhere = true;
            }
        }
        is_elsewhere.then(|| self.compensation.ideal_position(&at))
    }
}
