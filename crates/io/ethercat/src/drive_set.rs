//! All drives of a session with one follower: takes setpoints, returns outputs and feedback.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use evolvent_bridge::follower_settings;
use evolvent_bus::{AXES, Feedback, Setpoint};
use evolvent_drive::{
    DriveState, FeedbackBounds, Follower, GantryEvent, GantryPair, IndexLatch, IndexRequest, PowerRequest,
    SettingsError, Target, worse_status,
};
use evolvent_machine::Machine;
use evolvent_path::AxisMask;

use crate::axis::{DriveAxis, IndexProgress};
use crate::homing::HomingProgress;
use crate::network::Network;
use crate::pdo::{DriveInputs, DriveOutputs};
use crate::touch_probe::Touches;

/// The drives' reports of the probe.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ProbeReading {
    /// Whether it is tripped, if an input is configured.
    pub(crate) input: Option<bool>,
    pub(crate) trips: u64,
    pub(crate) position: [f64; AXES],
    pub(crate) latched_mask: u32,
}

/// Drives of one session. Only the constructor allocates.
#[derive(Debug)]
pub(crate) struct DriveSet {
    follower: Follower,
    axes: Vec<DriveAxis>,
    /// Time of the last inputs of each drive.
    taken_ns: Vec<Option<u64>>,
    period_ns: u64,
    period_s: f64,
    instance: u64,
    axes_mask: u32,
    was_enabled: bool,
    /// One drive has left operation; the others stay stopped until power is requested again.
    group_stop: bool,
    /// The session ends: all drives stop.
    ending: bool,
    /// Order of the axes that home now; `None` if all have homed.
    homing: Option<u32>,
    /// Drives have found their zero: the core must read the new positions without power before it follows.
    has_new_positions: bool,
    gantries: Vec<GantryPair>,
    /// Twice the maximum velocity of each axis.
    max_velocity: [f64; AXES],
    aligned: bool,
    /// The newest request for an index pulse, which a drive may not have accepted yet.
    index_request: IndexRequest,
    index: IndexLatch,
    touches: Touches,
    target: Option<Target>,
    power: PowerRequest,
    starts: Starts,
}

/// Bits of an unknown offset: a NaN that arithmetic does not produce.
const UNKNOWN: u64 = u64::MAX;

/// Machine coordinate minus position of the increments, from the start of drives or their homing, over the
/// sessions of a process.
#[derive(Clone, Debug)]
pub(crate) struct Starts(Arc<[AtomicU64; 2 * AXES]>);

impl Default for Starts {
    fn default() -> Self {
        Self(Arc::new([const { AtomicU64::new(UNKNOWN) }; 2 * AXES]))
    }
}

impl Starts {
    fn of(&self, entry: usize) -> Option<f64> {
        let bits = self.0.get(entry)?.load(Ordering::Relaxed);
        (bits != UNKNOWN).then_some(f64::from_bits(bits))
    }

    fn keep(&self, entry: usize, offset: f64) {
        if let Some(kept) = self.0.get(entry) {
            kept.store(offset.to_bits(), Ordering::Relaxed);
        }
    }
}

/// The largest distance of an axis from machine zero that the core accepts.
fn reach(machine: &Machine, index: usize) -> f64 {
    let mut bounds = FeedbackBounds::new(AxisMask::NONE);
    for axis in machine.axes.iter().filter(|axis| axis.letter.index() == index) {
        bounds.set_axis(index, [axis.travel_min, axis.travel_max], axis.max_velocity);
    }
    bounds.reach[index]
}

impl DriveSet {
    pub(crate) fn new(
        machine: &Machine,
        network: &Network,
        period_ns: u64,
        instance: u64,
        starts: &Starts,
    ) -> Result<Self, SettingsError> {
        let settings = follower_settings(machine, network.axes_mask(), period_ns);
        let mut axes: Vec<DriveAxis> = network
            .devices
            .iter()
            .filter_map(|device| device.axis)
            .map(DriveAxis::new)
            .collect();
        for (entry, axis) in axes.iter_mut().enumerate() {
            let by_core = |axis: &DriveAxis| {
                let mut homed = machine.homing.iter().map(|homing| homing.axis.index());
                homed.any(|homed| homed == axis.index())
            };
            // Other axes count from their drives' zero, which the core accepts without homing.
            if !axis.has_absolute_encoder() && (axis.homing() == HomingProgress::Needed || by_core(axis)) {
                axis.begin_at_zero(starts.of(entry), reach(machine, axis.index()));
            }
        }
        let gantries = (0..axes.len())
            .filter_map(|second| {
                let settings = axes[second].gantry()?;
                let is_first =
                    |axis: &DriveAxis| axis.index() == axes[second].index() && axis.gantry().is_none();
                let first = axes.iter().position(is_first)?;
                let has_switches = [first, second]
                    .iter()
                    .all(|drive| axes[*drive].is_squared_by_switch());
                Some(GantryPair::new(first, second, settings, has_switches))
            })
            .collect();
        Ok(Self {
            gantries,
            max_velocity: settings.max_velocity.map(|velocity| 2.0 * velocity),
            aligned: false,
            index_request: IndexRequest::NONE,
            index: IndexLatch::default(),
            starts: starts.clone(),
            follower: Follower::new(settings)?,
            taken_ns: vec![None; axes.len()],
            axes,
            period_ns,
            period_s: period_ns as f64 * 1e-9,
            instance,
            axes_mask: network.axes_mask().bits(),
            was_enabled: false,
            group_stop: false,
            ending: false,
            homing: None,
            has_new_positions: false,
            touches: Touches::default(),
            target: None,
            power: PowerRequest::Off,
        })
    }

    pub(crate) fn offer(&mut self, now_ns: u64, setpoint: &Setpoint) {
        let _noted = self.follower.offer(now_ns, setpoint);
    }

    pub(crate) fn refuse_version(&mut self) {
        self.follower.refuse_version();
    }

    pub(crate) fn axes(&self) -> &[DriveAxis] {
        &self.axes
    }

    /// The core's counter of fault resets.
    pub(crate) fn fault_reset(&self) -> Option<u32> {
        self.target.as_ref().and_then(|target| target.fault_reset)
    }

    pub(crate) fn set_lost(&mut self, axis: usize) {
        self.axes[axis].set_lost();
    }

    /// Stops all drives from now on, whatever the core requests.
    pub(crate) const fn end(&mut self) {
        self.ending = true;
    }

    /// Whether a drive has torque, or may have: one that does not reply is ignored.
    pub(crate) fn has_torque(&self) -> bool {
        let gives = |axis: &DriveAxis| axis.state().is_some_and(DriveState::has_torque);
        self.axes.iter().any(gives)
    }

    /// The inputs of a drive, read in the cycle of `now_ns`.
    pub(crate) fn take(&mut self, now_ns: u64, axis: usize, inputs: DriveInputs) {
        // Drives sample once per period, but frames may be lost, and a suspended bridge skips cycles.
        let elapsed_ns = self.taken_ns[axis].map_or(0, |taken_ns| now_ns.saturating_sub(taken_ns));
        let periods = ((elapsed_ns + self.period_ns / 2) / self.period_ns).max(1);
        self.taken_ns[axis] = Some(now_ns);
        let drive = &mut self.axes[axis];
        let elapsed_s = periods as f64 * self.period_s;
        let progress = drive.take(inputs, elapsed_s, self.max_velocity[drive.index()]);
        if let Some(position) = drive.take_latched() {
            self.touches.take(now_ns, drive.index(), position);
        }
        if let Some(offset) = drive.take_chosen_offset() {
            self.starts.keep(axis, offset);
        }
        match progress {
            IndexProgress::Nothing => {}
            // The request counts as accepted once the drive is ready to latch the impulse.
            IndexProgress::Armed => {
                let _axis = self.index.take(self.index_request);
            }
            IndexProgress::Latched(position) => {
                let _axis = self.index.take(self.index_request);
                self.index.latch(position);
            }
        }
    }

    /// Arms the drive whose index pulse is requested. A request for an axis whose drive latches none is never
    /// accepted.
    fn request_index(&mut self, request: IndexRequest) {
        if request == self.index_request {
            return;
        }
        self.index_request = request;
        for drive in self.axes.iter_mut().filter(|drive| drive.latches_index()) {
            drive.set_index_awaited(request.number != 0 && drive.index() == request.axis);
        }
        if request.number == 0 {
            let _none = self.index.take(request);
        }
    }

    /// Runs one period at a time of the bus's clock; afterwards outputs and feedback are those of this
    /// period.
    pub(crate) fn step(&mut self, now_ns: u64) {
        let homed = self.homing;
        let pending = self
            .axes
            .iter()
            .filter(|axis| axis.homing() != HomingProgress::Done);
        self.homing = pending.map(DriveAxis::homing_order).min();
        self.has_new_positions |= homed.is_some() && self.homing.is_none();
        let enabled = self.homing.is_none()
            && !self.has_new_positions
            && self
                .axes
                .iter()
                .all(|axis| axis.state() == Some(DriveState::OperationEnabled));
        self.align();
        let mut actual = [0.0; AXES];
        for axis in self.axes.iter().filter(|axis| axis.gantry().is_none()) {
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
        self.step_gantries(enabled, &target);
        // Axes that cannot follow together do not follow at all.
        let fails = |axis: &DriveAxis| {
            axis.homing() == HomingProgress::Failed || axis.state().is_none_or(DriveState::is_fault)
        };
        if target.power == PowerRequest::Off && !target.is_silent {
            self.group_stop = false;
            self.has_new_positions = false;
        } else if self.was_enabled && !enabled
            || self.homing.is_some() && self.axes.iter().any(fails)
            || self.has_new_positions
            || self.gantries.iter().any(|pair| pair.fault().is_some())
        {
            self.group_stop = true;
        }
        self.was_enabled = enabled;
        // Without a core a homing drive brakes, and no other begins.
        let is_orphaned = target.is_silent && self.homing.is_some();
        self.power = if self.ending || self.group_stop || is_orphaned {
            PowerRequest::QuickStop
        } else {
            target.power
        };
        self.target = Some(target);
    }

    /// Aligns encoders without an absolute position: the beam is assumed square until both drives have homed,
    /// or have passed their switches.
    fn align(&mut self) {
        if core::mem::replace(&mut self.aligned, true) {
            return;
        }
        for pair in &self.gantries {
            let [_, second] = pair.indices();
            if !self.axes[second].is_absolute() {
                pair.align(&mut self.axes);
            }
        }
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

    /// Moves drives until their beams are square, and stops both of a gantry if that is not possible.
    fn step_gantries(&mut self, is_enabled: bool, target: &Target) {
        if target.power == PowerRequest::Off && self.homing.is_some() {
            self.axes.iter_mut().for_each(DriveAxis::forget_way);
        }
        for pair in &mut self.gantries {
            // Before both drives know their positions the difference is measured from their start.
            let [one, other] = pair.indices().map(|drive| self.axes[drive].moved());
            let strain = self.homing.is_some().then_some(other - one);
            pair.step(&mut self.axes, (is_enabled, target), strain, self.period_s);
        }
    }

    /// Returns the events of each gantry.
    pub(crate) fn take_gantry_events(&mut self) -> impl Iterator<Item = GantryEvent> + '_ {
        let axes = &self.axes;
        self.gantries.iter_mut().map(|pair| pair.take_event(axes))
    }

    pub(crate) fn outputs(&mut self, axis: usize) -> DriveOutputs {
        self.axes[axis].outputs(self.target.as_ref(), self.power, self.homing, self.period_s)
    }

    /// Results of the touch probes: the state of the probe, touches, and the positions latched at the last
    /// one.
    pub(crate) fn probe(&self) -> ProbeReading {
        let inputs = self.axes.iter().filter_map(DriveAxis::probe_input);
        ProbeReading {
            input: inputs.reduce(|one, other| one || other),
            trips: self.touches.count,
            position: self.touches.position,
            latched_mask: self.touches.axes.bits(),
        }
    }

    /// The limit switches of a drive as reported to the core.
    fn limits(&self, entry: usize, pressed: [bool; 2]) -> [bool; 2] {
        let mut pairs = self.gantries.iter();
        pairs
            .find_map(|pair| pair.limits(entry, pressed))
            .unwrap_or(pressed)
    }

    /// The last feedback of the drives.
    pub(crate) fn feedback(&self, now_ns: u64) -> Option<Feedback> {
        let target = self.target.as_ref()?;
        let mut feedback = Feedback {
            sequence: target.sequence,
            time_ns: now_ns,
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
        let mut has_word = [false; AXES];
        for (entry, drive) in self.axes.iter().enumerate() {
            let axis = drive.index();
            let is_first = drive.gantry().is_none();
            if is_first {
                feedback.position[axis] = drive.position();
                feedback.velocity[axis] = drive.velocity();
                feedback.following_error[axis] = drive
                    .following_error()
                    .unwrap_or(target.position[axis] - drive.position());
            }
            // The larger torque of two drives counts.
            if drive.torque_ratio().abs() >= feedback.torque_ratio[axis].abs() {
                feedback.torque_ratio[axis] = drive.torque_ratio();
            }
            let may_move = self.homing.is_none() && !self.has_new_positions;
            let word = if !may_move && drive.state() == Some(DriveState::OperationEnabled) {
                DriveState::SwitchedOn.code()
            } else {
                drive.status_word()
            };
            // The drive that is farther from operation counts.
            let worst = if has_word[axis] {
                worse_status(feedback.status_word[axis] as u16, word)
            } else {
                word
            };
            feedback.status_word[axis] = u32::from(worst);
            has_word[axis] = true;
            feedback.absolute_mask |= AxisMask::one_if(axis, drive.is_absolute()).bits();
            let [home, negative, positive] = drive.switches();
            let [negative, positive] = self.limits(entry, [negative, positive]);
            feedback.home_switch_mask |= AxisMask::one_if(axis, home && is_first).bits();
            feedback.negative_limit_mask |= AxisMask::one_if(axis, negative).bits();
            feedback.positive_limit_mask |= AxisMask::one_if(axis, positive).bits();
            if feedback.error_code == 0 {
                feedback.error_code = u32::from(drive.error_code());
            }
            feedback.fault_reset_done = feedback.fault_reset_done.min(drive.resets_done());
        }
        for pair in &self.gantries {
            pair.describe(&self.axes, target, &mut feedback);
        }
        self.index.describe(&mut feedback);
        Some(feedback)
    }
}

#[cfg(test)]
mod tests;
