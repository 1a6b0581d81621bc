//! One drive and its axis: conversion between increments of the drive and machine coordinates.

use evolvent_drive::{
    Braking, Cia402, DriveState, GantryMotor, GantrySettings, PowerRequest, Target, bits, control,
};

use crate::homing::{HOMING_MODE, HomingProgress};
use crate::network::NetworkAxis;
use crate::pdo::{DriveInputs, DriveOutputs};
use crate::touch_probe::TouchProbe;
use crate::zero_impulse::{Latched, ZeroImpulse};

/// Number of periods for which the fault reset bit is held: a drive may miss a single one between two frames.
const RESET_PERIODS: u32 = 5;

/// Velocity below which a motor may lose its torque, mm/s or degrees/s: 300 kg at 1 mm/s have 0.15 mJ, which
/// a friction of 50 N absorbs in 3 um.
const STANDING: f64 = 1.0;

/// Progress of the zero impulse in one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum IndexProgress {
    /// Nothing new.
    Nothing,
    /// From now on the drive latches the impulse.
    Armed,
    /// The impulse occurred at this machine coordinate.
    Latched(f64),
}

/// The bridge's state of one drive. May be called by the cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DriveAxis {
    settings: NetworkAxis,
    controller: Cia402,
    inputs: DriveInputs,
    /// The drive's position without wrap-around.
    increments: i64,
    has_position: bool,
    /// The axis begins at `zero`, independent of its counter: its coordinates are valid only after homing,
    /// and a counter that is not absolute may be any number of turns away.
    begins_at_zero: bool,
    /// The offset of an earlier session, which is used instead if it gives a position within the reach.
    kept_offset: Option<f64>,
    reach: f64,
    /// Machine coordinate minus position of the increments.
    offset: f64,
    /// The drive has homed, and its counter counts from there: later sessions need this offset.
    is_renamed_by_drive: bool,
    velocity: f64,
    is_lost: bool,
    /// Remaining periods of a fault reset.
    reset_periods: u32,
    homing: HomingProgress,
    /// The position at which a drive in operation waits for the others: where it has come into operation, or
    /// has found its zero.
    hold: i32,
    holds: bool,
    probe: TouchProbe,
    has_edge: bool,
    zero_impulse: ZeroImpulse,
    /// Distance since power came on, for the drive of a gantry.
    moved: f64,
    /// Offset from the setpoint, and its velocity, for a drive of a gantry.
    apart: (f64, f64),
    /// The drive is too far from the other drive of its gantry.
    is_apart: bool,
}

impl DriveAxis {
    pub(crate) const fn new(settings: NetworkAxis) -> Self {
        Self {
            settings,
            controller: Cia402::new(),
            inputs: DriveInputs {
                status_word: 0,
                mode: 0,
                position: 0,
                error_code: 0,
                digital_inputs: 0,
                torque: 0,
                following_error: None,
                probe_status: 0,
                probe_position: 0,
                index_position: 0,
            },
            increments: 0,
            has_position: false,
            begins_at_zero: false,
            kept_offset: None,
            reach: f64::INFINITY,
            offset: settings.zero,
            is_renamed_by_drive: false,
            velocity: 0.0,
            is_lost: false,
            reset_periods: 0,
            homing: if settings.homing.is_some() {
                HomingProgress::Needed
            } else {
                HomingProgress::Done
            },
            hold: 0,
            holds: false,
            probe: TouchProbe {
                is_armed: false,
                latched: 0,
            },
            has_edge: false,
            zero_impulse: ZeroImpulse::new(),
            moved: 0.0,
            apart: (0.0, 0.0),
            is_apart: false,
        }
    }

    /// Call before the first inputs: the axis begins at `zero`, or, in a later session of the process, with
    /// the last chosen offset, so that an axis that was not moved keeps its coordinate. A counter that was
    /// reset meanwhile may give a coordinate beyond `reach`, which the core rejects: such an axis begins at
    /// `zero` again.
    pub(crate) const fn begin_at_zero(&mut self, kept_offset: Option<f64>, reach: f64) {
        self.begins_at_zero = true;
        self.kept_offset = kept_offset;
        self.reach = reach;
    }

    /// Returns the offset if it has just been chosen by the first inputs or by homing of the drive. Homing
    /// restarts the counter, so with an older offset the next session would be wrong by the previous count.
    pub(crate) const fn take_chosen_offset(&mut self) -> Option<f64> {
        if core::mem::replace(&mut self.is_renamed_by_drive, false) {
            return Some(self.offset);
        }
        if self.has_position && self.begins_at_zero && self.inputs.status_word != 0 {
            self.begins_at_zero = false;
            return Some(self.offset);
        }
        None
    }

    /// Whether its encoder knows machine zero.
    pub(crate) const fn has_absolute_encoder(&self) -> bool {
        self.settings.absolute
    }

    pub(crate) const fn gantry(&self) -> Option<GantrySettings> {
        self.settings.gantry
    }

    pub(crate) const fn moved(&self) -> f64 {
        self.moved
    }

    pub(crate) const fn forget_way(&mut self) {
        self.moved = 0.0;
    }

    pub(crate) const fn homing(&self) -> HomingProgress {
        self.homing
    }

    /// Its position in the homing sequence.
    pub(crate) fn homing_order(&self) -> u32 {
        self.settings.homing.map_or(0, |homing| homing.order)
    }

    /// Returns the machine coordinate of a touch probe edge, once.
    pub(crate) fn take_latched(&mut self) -> Option<f64> {
        core::mem::replace(&mut self.has_edge, false).then(|| self.position_of(self.probe.latched))
    }

    /// The machine coordinate of a position of the drive close to the present one.
    fn position_of(&self, increments: i32) -> f64 {
        let away = i64::from(increments.wrapping_sub(self.inputs.position));
        let position = self.settings.scale.position(self.increments + away);
        self.sign() * position + self.offset
    }

    /// Whether it latches the zero impulse of its encoder.
    pub(crate) const fn latches_index(&self) -> bool {
        self.settings.index_probe.is_some()
    }

    /// Sets whether the next zero impulse is to be latched.
    pub(crate) const fn set_index_awaited(&mut self, is_awaited: bool) {
        if is_awaited {
            self.zero_impulse.arm();
        } else {
            self.zero_impulse.disarm();
        }
    }

    /// Whether the probe input is on, if one is configured.
    pub(crate) fn probe_input(&self) -> Option<bool> {
        let bit = self.settings.probe_input_bit?;
        Some(self.inputs.digital_inputs >> bit & 1 == 1)
    }

    /// The drive's own following error, if it reports one.
    pub(crate) fn following_error(&self) -> Option<f64> {
        let error = self.inputs.following_error?;
        Some(self.sign() * self.settings.scale.position(i64::from(error)))
    }

    pub(crate) const fn index(&self) -> usize {
        self.settings.axis
    }

    /// Whether its positions refer to machine zero: by its encoder, or because it has homed.
    pub(crate) fn is_absolute(&self) -> bool {
        self.settings.absolute || self.settings.homing.is_some() && self.homing == HomingProgress::Done
    }

    pub(crate) fn state(&self) -> Option<DriveState> {
        if self.is_lost {
            None
        } else {
            DriveState::decode(self.inputs.status_word)
        }
    }

    /// Marks its device as lost: it does not reply, or is not in OP.
    pub(crate) const fn set_lost(&mut self) {
        self.is_lost = true;
    }

    /// The bits of 60B8h that latch the zero impulse.
    const fn index_function(&self) -> u16 {
        match self.settings.index_probe {
            Some(probe) => self.zero_impulse.function(probe),
            None => 0,
        }
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

    /// Whether the motor is slow enough to lose its torque; an encoder at rest may toggle by one increment.
    fn is_standing(&self, period_s: f64) -> bool {
        let increment = self.settings.scale.position(1).abs();
        self.velocity.abs() <= STANDING.max(1.5 * increment / period_s)
    }

    /// Shifts the coordinates.
    pub(crate) fn rename(&mut self, shift: f64) {
        self.offset += shift;
    }

    /// Reads the inputs, `elapsed_s` after the last ones. The axis cannot move faster than `max_velocity`.
    /// Returns the progress of the zero impulse.
    pub(crate) fn take(&mut self, inputs: DriveInputs, elapsed_s: f64, max_velocity: f64) -> IndexProgress {
        // A drive without a reported state reports no position either.
        if self.has_position && !self.begins_at_zero {
            // 32-bit counters wrap around.
            let step = inputs.position.wrapping_sub(self.inputs.position);
            self.increments += i64::from(step);
            let way = self.sign() * self.settings.scale.position(i64::from(step));
            let homes = matches!(self.homing, HomingProgress::Running(_));
            let fastest = if homes {
                self.homing_velocity().min(max_velocity)
            } else {
                max_velocity
            };
            let is_possible = way.abs() <= fastest * elapsed_s;
            if !is_possible && homes {
                // The drive has found its zero and counts from there: this step is not a motion. It may occur
                // before the drive reports that it has homed; until then the coordinates continue unchanged.
                self.offset -= way;
            } else {
                self.velocity = way / elapsed_s;
            }
            if is_possible {
                self.moved += way;
            }
        } else {
            self.increments = i64::from(inputs.position);
            self.has_position = true;
            if self.begins_at_zero {
                let counted = self.sign() * self.settings.scale.position(self.increments);
                let is_within = |offset: &f64| (counted + offset).abs() <= self.reach;
                self.offset = self
                    .kept_offset
                    .filter(is_within)
                    .unwrap_or(self.settings.zero - counted);
            }
        }
        self.inputs = inputs;
        if self.settings.touch_probe {
            self.has_edge = self.probe.step(inputs.probe_status, inputs.probe_position);
        }
        match self.settings.index_probe.map(|probe| {
            self.zero_impulse
                .step(probe, inputs.probe_status, inputs.index_position)
        }) {
            None | Some(Latched::Nothing) => IndexProgress::Nothing,
            Some(Latched::Armed) => IndexProgress::Armed,
            Some(Latched::At(increments)) => IndexProgress::Latched(self.position_of(increments)),
        }
    }

    /// Maximum velocity of the axis while its drive homes: twice the speed of the search. With the maximum
    /// velocity of the axis, a step to the drive's zero during lost frames could count as a motion of some
    /// millimetres.
    fn homing_velocity(&self) -> f64 {
        let fastest = self
            .settings
            .homing
            .map_or(0, |homing| homing.search.max(homing.latch));
        2.0 * self.settings.scale.position(i64::from(fastest)).abs()
    }

    /// Handles that the drive has found its zero and counts from there.
    fn rename_by_drive(&mut self) {
        if let Some(homing) = self.settings.homing {
            self.increments = i64::from(self.inputs.position);
            self.offset = homing.position;
            self.is_renamed_by_drive = true;
            self.velocity = 0.0;
            (self.holds, self.hold) = (true, self.inputs.position);
        }
    }

    /// Runs one period of homing. Returns whether the drive is in mode 6. `power`: the core requests it;
    /// `turn`: no axis has to home before this one.
    fn home(&mut self, power: bool, turn: bool, period_s: f64) -> bool {
        let Some(homing) = self.settings.homing else {
            return false;
        };
        if !power {
            if self.homing != HomingProgress::Done {
                self.homing = HomingProgress::Needed;
            }
            return false;
        }
        if self.state() != Some(DriveState::OperationEnabled) || !turn {
            if matches!(self.homing, HomingProgress::Running(_)) {
                self.homing = HomingProgress::Failed;
            }
            return false;
        }
        if matches!(self.homing, HomingProgress::Done | HomingProgress::Failed) {
            return false;
        }
        let max_periods = (homing.timeout_s / period_s) as u32;
        let shows_mode = self.inputs.mode == HOMING_MODE;
        self.homing = self.homing.step(self.inputs.status_word, shows_mode, max_periods);
        if self.homing == HomingProgress::Done {
            self.rename_by_drive();
        }
        matches!(self.homing, HomingProgress::Needed | HomingProgress::Running(_))
    }

    /// Computes the outputs of the drive. Without a target of the core (`target` is `None`) it has no torque.
    /// While drives home (`turn` is the order of the axes that home now), those that have homed hold, and
    /// later ones wait without torque.
    pub(crate) fn outputs(
        &mut self,
        target: Option<&Target>,
        power: PowerRequest,
        turn: Option<u32>,
        period_s: f64,
    ) -> DriveOutputs {
        // A failed homing must not keep torque on.
        let power = if self.homing == HomingProgress::Failed && power == PowerRequest::On {
            PowerRequest::QuickStop
        } else {
            power
        };
        let is_its_turn = turn.is_none_or(|turn| self.homing_order() <= turn);
        let homes = self.home(power != PowerRequest::Off, is_its_turn, period_s);
        let axis = self.settings.axis;
        let fault_reset = target.and_then(|target| target.fault_reset);
        let setpoint = target.map_or(f64::NAN, |target| target.position[axis] + self.apart.0);
        let is_standing = self.is_standing(period_s);
        let braking = Braking {
            period_s,
            is_standing: self.has_position.then_some(is_standing),
        };
        let status_word = self.inputs.status_word;
        let order = (self.controller).step(status_word, power, fault_reset, setpoint, 0.0, braking);
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
            probe_function: self.probe.function() | self.index_function(),
            ..DriveOutputs::default()
        };
        let enables = order.control_word == control::ENABLE_OPERATION;
        // A vertical axis would sag if its target followed its position.
        let is_in_operation = self.state() == Some(DriveState::OperationEnabled);
        let others_follow = target.is_some_and(|target| target.state.has_targets());
        let waits = is_in_operation && !homes && (turn.is_some() || !others_follow);
        if waits && !self.holds {
            self.hold = self.inputs.position;
        }
        self.holds = waits;
        if homes && enables {
            outputs.mode = HOMING_MODE;
            outputs.control_word |= self.homing.control_bits();
        } else if turn.is_some() && enables && self.homing != HomingProgress::Done && !is_its_turn {
            outputs.control_word = control::SWITCH_ON;
        } else if waits {
            outputs.target = self.hold;
        } else if let (true, Some(target)) = (order.follows, target) {
            let sign = self.sign();
            let scale = self.settings.scale;
            outputs.target = scale.increments(sign * (setpoint - self.offset)) as i32;
            if self.settings.velocity_offset {
                let velocity = target.velocity[axis] + self.apart.1;
                outputs.velocity_offset = scale.increments(sign * velocity) as i32;
            }
            outputs.torque_offset =
                (sign * target.acceleration[axis] * self.settings.torque_per_acceleration) as i16;
        }
        outputs
    }

    /// The machine coordinate at which it waits for the others, or its present one.
    pub(crate) fn held_position(&self) -> f64 {
        if self.holds {
            self.position_of(self.hold)
        } else {
            self.position()
        }
    }

    /// The status word of the feedback. A drive that does not reply is in fault for the core.
    pub(crate) const fn status_word(&self) -> u16 {
        if self.is_lost || self.is_apart {
            DriveState::Fault.code()
        } else {
            self.inputs.status_word
        }
    }

    /// Object 603Fh while the drive is in fault; 7500h, communication, if it does not reply.
    pub(crate) const fn error_code(&self) -> u16 {
        if self.is_lost {
            0x7500
        } else if self.is_apart {
            0x8611
        } else if self.inputs.status_word & bits::FAULT != 0 {
            self.inputs.error_code
        } else {
            0
        }
    }

    pub(crate) fn torque_ratio(&self) -> f64 {
        self.sign() * f64::from(self.inputs.torque) / 1000.0
    }

    pub(crate) const fn resets_done(&self) -> u32 {
        self.controller.resets_done()
    }

    /// Whether its beam can be squared by home switches: it has one, and no other reference.
    pub(crate) const fn is_squared_by_switch(&self) -> bool {
        self.settings.home_switch_bit.is_some() && !self.settings.absolute && self.settings.homing.is_none()
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

impl GantryMotor for DriveAxis {
    fn axis(&self) -> usize {
        self.index()
    }

    fn position(&self) -> f64 {
        self.position()
    }

    fn velocity(&self) -> f64 {
        self.velocity()
    }

    fn held_position(&self) -> f64 {
        self.held_position()
    }

    fn home_switch(&self) -> bool {
        self.switches()[0]
    }

    fn has_following_error(&self) -> bool {
        self.following_error().is_some()
    }

    fn rename(&mut self, shift: f64) {
        self.rename(shift);
    }

    fn set_apart(&mut self, distance: f64, velocity: f64) {
        self.apart = (distance, velocity);
    }

    fn set_too_far_apart(&mut self, is_apart: bool) {
        self.is_apart = is_apart;
    }
}

#[cfg(test)]
mod tests;
