//! One drive and its axis: increments of the drive, coordinates of the machine.

use evolvent_drive::{Cia402, DriveState, PowerRequest, Target, bits, control};

use crate::network::NetworkAxis;
use crate::pdo::{DriveInputs, DriveOutputs};

/// For how many periods the bit of a fault reset is held: a drive may miss a single one between two frames.
const RESET_PERIODS: u32 = 5;

/// A drive as the bridge sees it. May be called by the cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DriveAxis {
    settings: NetworkAxis,
    controller: Option<Cia402>,
    inputs: DriveInputs,
    /// The drive's position without wrapping around.
    increments: i64,
    has_position: bool,
    /// Added to the position of the increments for the machine's coordinate.
    offset: f64,
    velocity: f64,
    is_lost: bool,
    /// Periods for which a fault reset is still held.
    reset_periods: u32,
}

impl DriveAxis {
    pub(crate) const fn new(settings: NetworkAxis) -> Self {
        Self {
            settings,
            controller: None,
            inputs: DriveInputs {
                status_word: 0,
                mode: 0,
                position: 0,
                error_code: 0,
                digital_inputs: 0,
                torque: 0,
            },
            increments: 0,
            has_position: false,
            offset: settings.zero,
            velocity: 0.0,
            is_lost: false,
            reset_periods: 0,
        }
    }

    pub(crate) const fn index(&self) -> usize {
        self.settings.axis
    }

    pub(crate) const fn is_absolute(&self) -> bool {
        self.settings.absolute
    }

    pub(crate) fn state(&self) -> Option<DriveState> {
        if self.is_lost {
            None
        } else {
            DriveState::decode(self.inputs.status_word)
        }
    }

    /// Its device does not answer, or is not in OP.
    pub(crate) const fn set_lost(&mut self) {
        self.is_lost = true;
    }

    fn sign(&self) -> f64 {
        if self.settings.inverted { -1.0 } else { 1.0 }
    }

    /// The machine coordinate.
    pub(crate) fn position(&self) -> f64 {
        self.sign() * self.settings.scale.position(self.increments) + self.offset
    }

    pub(crate) const fn velocity(&self) -> f64 {
        self.velocity
    }

    /// Names positions anew.
    pub(crate) fn rename(&mut self, shift: f64) {
        self.offset += shift;
    }

    /// Takes inputs in, `period_s` after the last.
    pub(crate) fn take(&mut self, inputs: DriveInputs, period_s: f64) {
        if self.has_position {
            // Counters of 32 bits wrap around.
            let step = inputs.position.wrapping_sub(self.inputs.position);
            self.increments += i64::from(step);
            self.velocity = self.sign() * self.settings.scale.position(i64::from(step)) / period_s;
        } else {
            self.increments = i64::from(inputs.position);
            self.has_position = true;
        }
        self.inputs = inputs;
    }

    /// What the drive gets. Without an order of the core (`target` none) it has no torque.
    pub(crate) fn outputs(&mut self, target: Option<&Target>, power: PowerRequest) -> DriveOutputs {
        let axis = self.settings.axis;
        let fault_reset = target.map_or(0, |target| target.fault_reset);
        let setpoint = target.map_or(f64::NAN, |target| target.position[axis]);
        // Resets that were asked for before this drive was there are over.
        let controller = self.controller.get_or_insert(Cia402::new(fault_reset));
        let order = controller.step(self.inputs.status_word, power, fault_reset, setpoint, 0.0);
        if order.control_word == control::FAULT_RESET {
            self.reset_periods = RESET_PERIODS;
        }
        let holds_reset = self.reset_periods > 0 && self.state() == Some(DriveState::Fault);
        self.reset_periods = self.reset_periods.saturating_sub(1);
        let mut outputs = DriveOutputs {
            control_word: if holds_reset {
                control::FAULT_RESET
            } else {
                order.control_word
            },
            mode: order.mode_of_operation,
            target: self.inputs.position,
            ..DriveOutputs::default()
        };
        if let (true, Some(target)) = (order.follows, target) {
            let sign = self.sign();
            let scale = self.settings.scale;
            outputs.target = scale.increments(sign * (setpoint - self.offset)) as i32;
            if self.settings.velocity_offset {
                outputs.velocity_offset = scale.increments(sign * target.velocity[axis]) as i32;
            }
            outputs.torque_offset =
                (sign * target.acceleration[axis] * self.settings.torque_per_acceleration) as i16;
        }
        outputs
    }

    /// The status word of the feedback. A drive that does not answer is in fault for the core.
    pub(crate) const fn status_word(&self) -> u16 {
        if self.is_lost {
            DriveState::Fault.code()
        } else {
            self.inputs.status_word
        }
    }

    /// Object 603Fh while the drive is in fault; 7500h, communication, where it does not answer.
    pub(crate) const fn error_code(&self) -> u16 {
        if self.is_lost {
            0x7500
        } else if self.inputs.status_word & bits::FAULT != 0 {
            self.inputs.error_code
        } else {
            0
        }
    }

    pub(crate) fn torque_ratio(&self) -> f64 {
        self.sign() * f64::from(self.inputs.torque) / 1000.0
    }

    pub(crate) fn resets_done(&self) -> u32 {
        self.controller.map_or(0, |controller| controller.resets_done())
    }

    /// Home switch, limit switch at the negative end, and at the positive end.
    pub(crate) fn switches(&self) -> [bool; 3] {
        let bit = |bit: u8| self.inputs.digital_inputs >> bit & 1 == 1;
        let limits = [bit(0), bit(1)].map(|pressed| pressed && self.settings.limit_switches);
        let [negative, positive] = if self.settings.inverted {
            [limits[1], limits[0]]
        } else {
            limits
        };
        [self.settings.home_switch_bit.is_some_and(bit), negative, positive]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scale::Scale;

    fn axis(inverted: bool) -> DriveAxis {
        DriveAxis::new(NetworkAxis {
            axis: 0,
            scale: Scale::new(1000, [1, 1], 5.0).expect("a scale"),
            inverted,
            absolute: false,
            zero: 10.0,
            map: true,
            velocity_offset: true,
            torque_per_acceleration: 0.0,
            home_switch_bit: Some(2),
            limit_switches: true,
        })
    }

    #[test]
    fn a_counter_that_wraps_around_goes_on() {
        for inverted in [false, true] {
            let mut axis = axis(inverted);
            let sign = if inverted { -1.0 } else { 1.0 };
            axis.take(
                DriveInputs {
                    position: i32::MAX - 100,
                    ..DriveInputs::default()
                },
                1e-3,
            );
            let before = axis.position();
            axis.take(
                DriveInputs {
                    position: i32::MIN + 99,
                    ..DriveInputs::default()
                },
                1e-3,
            );
            assert!(
                (axis.position() - before - sign).abs() < 1e-6,
                "200 increments are 1 mm"
            );
            assert!((axis.velocity() - sign * 1000.0).abs() < 1e-6);
        }
    }

    #[test]
    fn the_target_is_the_actual_position_until_operation_is_enabled() {
        let mut axis = axis(true);
        let status = |state: DriveState| DriveInputs {
            status_word: state.code(),
            position: 4321,
            ..DriveInputs::default()
        };
        for state in [
            DriveState::SwitchOnDisabled,
            DriveState::ReadyToSwitchOn,
            DriveState::SwitchedOn,
        ] {
            axis.take(status(state), 1e-3);
            assert_eq!(axis.outputs(None, PowerRequest::On).target, 4321);
        }
    }

    #[test]
    fn switches_of_an_inverted_axis_change_sides() {
        let mut axis = axis(true);
        axis.take(
            DriveInputs {
                digital_inputs: 0b101,
                ..DriveInputs::default()
            },
            1e-3,
        );
        assert_eq!(axis.switches(), [true, false, true]);
    }
}
