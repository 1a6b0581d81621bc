//! All axes of a session with one follower: takes setpoints, returns rates and feedback.

use evolvent_bridge::follower_settings;
use evolvent_bus::{AXES, Feedback, Setpoint};
use evolvent_drive::{
    DriveState, Follower, GantryEvent, GantryPair, IndexLatch, IndexRequest, PowerRequest, SettingsError,
    Target, worse_status,
};
use evolvent_machine::Machine;
use evolvent_path::AxisMask;

use crate::axis::{AxisLimits, MesaAxis};
use crate::board_settings::{Actuator, BoardAxis, BoardSettings, Pin};
use crate::encoder_index::{EncoderIndex, IndexReading};
use crate::field_pins::{InputLocation, OutputLocation};
use crate::plan::{Inputs, Outputs, Plan};
use crate::session::SessionError;
use crate::smart_serial::{bit_of, set_bit};

/// Axes of one session. Only the constructor allocates.
#[derive(Debug)]
pub(crate) struct AxisSet {
    follower: Follower,
    axes: Vec<MesaAxis>,
    gantries: Vec<GantryPair>,
    is_aligned: bool,
    period_s: f64,
    instance: u64,
    axes_mask: u32,
    was_enabled: bool,
    /// One axis has left operation; the others stay stopped until power is requested again.
    group_stop: bool,
    /// The session ends: all axes stop.
    ending: bool,
    /// The newest request for an index pulse, which the board may not have accepted yet.
    index_request: IndexRequest,
    index: IndexLatch,
    encoder_index: EncoderIndex,
    target: Option<Target>,
    measured_ns: u64,
}

impl AxisSet {
    pub(crate) fn new(
        machine: &Machine,
        board: &BoardSettings,
        period_ns: u64,
        instance: u64,
    ) -> Result<Self, SettingsError> {
        let settings = follower_settings(machine, board.axes_mask(), period_ns);
        let axes = board.axes.iter().map(|axis| {
            let limits = AxisLimits {
                max_velocity: settings.max_velocity[axis.axis],
                max_acceleration: settings.max_acceleration[axis.axis],
                max_jerk: settings.max_jerk[axis.axis],
            };
            MesaAxis::new(*axis, limits)
        });
        Ok(Self {
            axes: axes.collect(),
            gantries: pairs(board),
            is_aligned: false,
            follower: Follower::new(settings)?,
            period_s: period_ns as f64 * 1e-9,
            instance,
            axes_mask: settings.axes.bits(),
            was_enabled: false,
            group_stop: false,
            ending: false,
            index_request: IndexRequest::NONE,
            index: IndexLatch::default(),
            encoder_index: EncoderIndex::default(),
            target: None,
            measured_ns: 0,
        })
    }

    pub(crate) fn offer(&mut self, now_ns: u64, setpoint: &Setpoint) {
        let _noted = self.follower.offer(now_ns, setpoint);
    }

    pub(crate) fn refuse_version(&mut self) {
        self.follower.refuse_version();
    }

    pub(crate) fn axes(&self) -> &[MesaAxis] {
        &self.axes
    }

    /// Marks the axes as lost: the board no longer replies, or its data are implausible.
    pub(crate) fn set_lost(&mut self) {
        for axis in &mut self.axes {
            axis.set_lost();
        }
    }

    /// Stops all axes from now on, whatever the core requests.
    pub(crate) const fn end(&mut self) {
        self.ending = true;
    }

    pub(crate) fn has_torque(&self) -> bool {
        self.axes.iter().any(MesaAxis::has_torque)
    }

    /// Evaluates a reading.
    ///
    /// # Errors
    /// The reading is so late that a counter may have wrapped unnoticed: the session must end, because the
    /// coordinates of the axis are no longer valid. The axes can still brake with the reading.
    pub(crate) fn take(
        &mut self,
        plan: &Plan,
        inputs: &Inputs,
        measured_ns: u64,
    ) -> Result<(), SessionError> {
        self.measured_ns = measured_ns;
        let mut unread = Ok(());
        for axis in &mut self.axes {
            let settings = *axis.settings();
            let (gap_s, most_s) = (axis.gap_s(measured_ns), axis.longest_gap_s());
            if gap_s > most_s && unread.is_ok() {
                let (what, unit) = settings.actuator.counter();
                unread = Err(SessionError::Unread {
                    what,
                    unit,
                    gap_ms: gap_s * 1e3,
                    most_ms: most_s * 1e3,
                });
            }
            let is_on = |pin: Option<Pin>| pin.is_some_and(|pin| level(plan, inputs, pin));
            let raw = match settings.actuator {
                Actuator::Steps { unit, .. } => inputs.accumulators[unit],
                Actuator::Servo { encoder, .. } => inputs.counts[encoder],
            };
            axis.take(
                raw,
                measured_ns,
                is_on(settings.fault),
                settings.switches.map(is_on),
            );
        }
        if !core::mem::replace(&mut self.is_aligned, true) {
            // The positions of the motors are unknown: the beam is assumed square until both have passed
            // their switches.
            for pair in &self.gantries {
                pair.align(&mut self.axes);
            }
        }
        self.take_index(inputs);
        unread
    }

    /// Maximum time without a reading before coordinates are unknown, s.
    pub(crate) fn longest_gap_s(&self) -> f64 {
        let gaps = self.axes.iter().map(MesaAxis::longest_gap_s);
        gaps.fold(f64::INFINITY, f64::min)
    }

    /// Updates the request for an index pulse. It counts as accepted once the board is ready to latch the
    /// pulse.
    fn take_index(&mut self, inputs: &Inputs) {
        let reading = self
            .encoder_index
            .take(inputs.index_numbers[0], inputs.index_controls[0]);
        if reading == IndexReading::Nothing {
            return;
        }
        let _axis = self.index.take(self.index_request);
        let request = self.index_request;
        if let (IndexReading::At(count), Some(axis)) = (
            reading,
            self.axes.iter().find(|axis| axis.index() == request.axis),
        ) {
            self.index.latch(axis.position_of(count));
        }
    }

    /// Arms the encoder of the axis whose index pulse is requested. A request for an axis without one is
    /// never accepted.
    fn request_index(&mut self, request: IndexRequest) {
        if request == self.index_request {
            return;
        }
        self.index_request = request;
        if request.number == 0 {
            let _none = self.index.take(request);
        }
        let axis = self.axes.iter().find(|axis| axis.index() == request.axis);
        match axis
            .and_then(MesaAxis::index_source)
            .filter(|_| request.number != 0)
        {
            Some((unit, rising)) => self.encoder_index.arm(unit, rising),
            None => self.encoder_index.disarm(),
        }
    }

    /// The encoder whose index pulse is awaited.
    pub(crate) const fn awaited_encoder(&self) -> Option<usize> {
        self.encoder_index.watched()
    }

    /// Runs one period at a time of the bus's clock.
    pub(crate) fn step(&mut self, now_ns: u64, plan: &Plan, outputs: &mut Outputs) {
        let enabled = self
            .axes
            .iter()
            .all(|axis| axis.state() == DriveState::OperationEnabled);
        let mut actual = [0.0; AXES];
        for axis in self.axes.iter().filter(|axis| axis.settings().gantry.is_none()) {
            actual[axis.index()] = axis.held_position();
        }
        for pair in &self.gantries {
            pair.hold(&self.axes, &mut actual);
        }
        let target = self.follower.step(now_ns, enabled, &actual);
        if let Some(shift) = target.datum_shift {
            self.rename(&shift);
            self.index.rename(&shift);
        }
        self.request_index(target.index);
        outputs.index[0] = self.encoder_index.command();
        for pair in &mut self.gantries {
            pair.step(&mut self.axes, (enabled, &target), None, self.period_s);
        }
        // Axes that cannot follow together do not follow at all.
        if target.power == PowerRequest::Off && !target.is_silent {
            self.group_stop = false;
        } else if self.was_enabled && !enabled {
            self.group_stop = true;
        }
        self.was_enabled = enabled;
        let power = if self.ending || self.group_stop {
            PowerRequest::QuickStop
        } else {
            target.power
        };
        for axis in &mut self.axes {
            let order = axis.step(&target, power, now_ns, self.period_s);
            let settings = axis.settings();
            match settings.actuator {
                Actuator::Steps { unit, .. } => outputs.rates[unit] = order.value,
                Actuator::Servo { pwm, .. } => {
                    outputs.duties[pwm] = order.value;
                    outputs.pwm_enable &= !(1 << pwm);
                    outputs.pwm_enable |= u32::from(order.is_enabled) << pwm;
                }
            }
            if let Some(pin) = settings.enable {
                set(plan, outputs, pin, order.is_enabled);
            }
        }
        self.target = Some(target);
    }

    /// Handles a change of datum.
    fn rename(&mut self, shift: &[f64; AXES]) {
        for axis in &mut self.axes {
            axis.rename(shift[axis.index()]);
        }
        for pair in &mut self.gantries {
            pair.rename(&mut self.axes, shift);
        }
    }

    /// Returns the events of each gantry.
    pub(crate) fn take_gantry_events(&mut self) -> impl Iterator<Item = GantryEvent> + '_ {
        let axes = &self.axes;
        self.gantries.iter_mut().map(|pair| pair.take_event(axes))
    }

    /// The limit switches of a motor as reported to the core.
    fn limits(&self, entry: usize, pressed: [bool; 2]) -> [bool; 2] {
        let mut pairs = self.gantries.iter();
        pairs
            .find_map(|pair| pair.limits(entry, pressed))
            .unwrap_or(pressed)
    }

    /// The last feedback of the axes.
    pub(crate) fn feedback(&self) -> Option<Feedback> {
        let target = self.target.as_ref()?;
        let mut feedback = Feedback {
            sequence: target.sequence,
            time_ns: self.measured_ns,
            phase_error_ns: target.phase_error_ns,
            axes_mask: self.axes_mask,
            bridge_state: target.state.number(),
            note: self.follower.note().number(),
            fault_reset_done: u32::MAX,
            missed_setpoints: self.follower.missed(),
            datum: target.datum,
            instance: target.instance(self.instance),
            ..Feedback::default()
        };
        for (entry, axis) in self.axes.iter().enumerate() {
            let index = axis.index();
            if axis.settings().gantry.is_none() {
                feedback.position[index] = axis.position();
                feedback.velocity[index] = axis.velocity();
                feedback.following_error[index] = target.position[index] - axis.position();
                feedback.status_word[index] = u32::from(axis.status_word());
            }
            let [home, negative, positive] = axis.switches();
            let [negative, positive] = self.limits(entry, [negative, positive]);
            feedback.home_switch_mask |=
                AxisMask::one_if(index, home && axis.settings().gantry.is_none()).bits();
            feedback.negative_limit_mask |= AxisMask::one_if(index, negative).bits();
            feedback.positive_limit_mask |= AxisMask::one_if(index, positive).bits();
            if feedback.error_code == 0 {
                feedback.error_code = u32::from(axis.error_code());
            }
            feedback.fault_reset_done = feedback.fault_reset_done.min(axis.resets_done());
        }
        for pair in &self.gantries {
            let [first, second] = pair.indices().map(|motor| &self.axes[motor]);
            feedback.status_word[first.index()] =
                u32::from(worse_status(first.status_word(), second.status_word()));
            pair.describe(&self.axes, target, &mut feedback);
        }
        self.index.describe(&mut feedback);
        Some(feedback)
    }

    /// The feedback without a new reading: it reports that the axes have stopped replying.
    pub(crate) fn lost_feedback(&self, now_ns: u64) -> Option<Feedback> {
        let feedback = self.feedback()?;
        Some(Feedback {
            time_ns: now_ns,
            ..feedback
        })
    }
}

/// The gantries of a board file.
fn pairs(board: &BoardSettings) -> Vec<GantryPair> {
    let seconds = board.axes.iter().enumerate();
    let pair = |(second, axis): (usize, &BoardAxis)| {
        let is_first = |other: &BoardAxis| other.axis == axis.axis && other.gantry.is_none();
        let first = board.axes.iter().position(is_first)?;
        let has_switches = [first, second]
            .iter()
            .all(|motor| board.axes[*motor].switches[0].is_some());
        Some(GantryPair::new(first, second, axis.gantry?, has_switches))
    };
    seconds.filter_map(pair).collect()
}

/// Whether a pin is on.
pub(crate) fn level(plan: &Plan, inputs: &Inputs, pin: Pin) -> bool {
    let (register, bit) = match plan.input_location(pin) {
        InputLocation::Remote { remote, bit } => {
            return bit_of(&inputs.serial.words[remote], bit) != pin.inverted;
        }
        InputLocation::Port { port, bit } => (inputs.ports[port], bit),
        InputLocation::Filter { unit, bit } => (inputs.filtered[unit], bit),
    };
    (register >> bit & 1 == 1) != pin.inverted
}

/// Switches a pin on or off.
pub(crate) fn set(plan: &Plan, outputs: &mut Outputs, pin: Pin, on: bool) {
    let (register, bit) = match plan.output_location(pin) {
        OutputLocation::Remote { remote, bit } => {
            return set_bit(&mut outputs.serial.words[remote], bit, on != pin.inverted);
        }
        OutputLocation::Port { port, bit } => (&mut outputs.ports[port], bit),
        OutputLocation::Relay { unit, bit } => (&mut outputs.field.relays[unit], bit),
        OutputLocation::Simple { unit, bit } => (&mut outputs.field.simple[unit], bit),
    };
    *register &= !(1 << bit);
    if on != pin.inverted {
        *register |= 1 << bit;
    }
}
