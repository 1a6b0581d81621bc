//! From the ideal setpoint of a cycle to what the drives are sent, the same in the cycle and where it is
//! computed again.

use evolvent_compensation::Compensation;
use evolvent_machine::{Limits, Machine, SignalKind};
use evolvent_motion::{Guard, Setpoint, State, Violation, flags};
use evolvent_path::{AXES, Axes, Jet};
use evolvent_signals::InputImage;

/// How far the drives may stand from what they were sent, mm or degrees, and count as standing there: going
/// from a corrected position to the ideal one and back is exact to rounding only.
const SAME_PLACE: f64 = 1e-9;

/// Corrects every setpoint. Made where the machine file says that something is wrong with the machine.
///
/// One step a cycle. Real-time safe, but for making it.
#[derive(Clone, Debug)]
pub struct Corrections {
    compensation: Compensation,
    thermal_inputs: [Option<u32>; AXES],
    /// Of what the drives are sent. Travel is checked of ideal positions.
    limits: Limits,
    period_s: f64,
    guard: Guard,
    sent: Jet,
    /// The next setpoint does not continue the last: the axes have other coordinates, or were moved without
    /// power.
    is_new: bool,
    fault: Option<Violation>,
}

impl Corrections {
    /// At rest at the ideal `position`; none where nothing is corrected.
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

    /// What the drives are sent for this setpoint, as the analog inputs are.
    pub fn step(&mut self, setpoint: &Setpoint, inputs: Option<&InputImage>) -> Jet {
        for (axis, number) in self.thermal_inputs.iter().enumerate() {
            let value = number.and_then(|number| inputs?.value(SignalKind::Analog, number));
            if let Some(value) = value {
                self.compensation.set_thermal_offset(axis, value);
            }
        }
        // A take-up may be under way where the axes have got other coordinates: for three cycles acceleration
        // and jerk are not known.
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
        // What stops by itself after a fault has its own bounds.
        let is_stopping = matches!(setpoint.state, State::Fault | State::Stopping);
        if let Err(violation) = self.guard.check(&corrected.position, is_joint, is_stopping) {
            self.fault.get_or_insert(violation);
        }
        self.guard.publish(&corrected.position, is_joint);
        self.sent = corrected;
        corrected
    }

    /// What the guard over corrected setpoints has objected to since this was asked last.
    pub fn take_fault(&mut self) -> Option<Violation> {
        self.fault.take()
    }

    /// At rest: the same place has other coordinates, or the machine was moved without power.
    pub fn relocate(&mut self, position: &Axes) {
        self.compensation.rebase_position(position);
        self.is_new = true;
    }

    /// By how much the last setpoint was corrected.
    #[must_use]
    pub fn shift(&self, ideal: &Axes) -> Axes {
        self.sent.position - ideal
    }

    /// Where the tool is, the drives being at `positions` on the axes for which `is_known`, and elsewhere as
    /// they were sent; none where that is where they were sent.
    pub(crate) fn found(&self, positions: &[f64; AXES], is_known: impl Fn(usize) -> bool) -> Option<Axes> {
        let mut at = self.sent.position;
        let mut is_elsewhere = false;
        for (axis, value) in positions.iter().enumerate() {
            if is_known(axis) && (value - at[axis]).abs() > SAME_PLACE {
                at[axis] = *value;
                is_elsewhere = true;
            }
        }
        is_elsewhere.then(|| self.compensation.ideal_position(&at))
    }
}
