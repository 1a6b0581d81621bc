//! All drives of a session behind one follower: setpoints in, outputs out, feedback back.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use evolvent_bridge::follower_settings;
use evolvent_bus::{AXES, Feedback, Setpoint};
use evolvent_drive::{
    DriveState, FeedbackBounds, Follower, Gantry, GantryFault, GantryInputs, IndexLatch, IndexRequest,
    PowerRequest, SettingsError, Target, is_homed, worse_status,
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

/// Two drives of one axis.
#[derive(Debug)]
struct Pair {
    first: usize,
    second: usize,
    gantry: Gantry,
    /// The beam is squared by home switches.
    has_switches: bool,
}

/// Drives of one session. Only the constructor allocates.
#[derive(Debug)]
pub(crate) struct DriveSet {
    follower: Follower,
    axes: Vec<DriveAxis>,
    /// When the inputs of each drive were read last.
    taken_ns: Vec<Option<u64>>,
    period_ns: u64,
    period_s: f64,
    instance: u64,
    axes_mask: u32,
    was_enabled: bool,
    /// One drive has left operation: the others are stopped until power is requested again.
    group_stop: bool,
    /// The session ends: all drives stop.
    ending: bool,
    /// Order of the axes that home now; none where all have.
    homing: Option<u32>,
    gantries: Vec<Pair>,
    /// Twice the maximum velocity of each axis.
    max_velocity: [f64; AXES],
    aligned: bool,
    /// The newest request for an index pulse, which a drive may still have to take over.
    index_request: IndexRequest,
    index: IndexLatch,
    touches: Touches,
    target: Option<Target>,
    power: PowerRequest,
    starts: Starts,
}

/// Bits of an offset that is not known: not a number that arithmetic gives.
const UNKNOWN: u64 = u64::MAX;

/// Machine coordinate minus position of the increments, as drives have begun or found their zero, over the sessions of a process.
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

/// The largest distance from machine zero that the core believes of an axis.
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
            // Others count from their drives' zero: without homing the core takes that for true.
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
                Some(Pair {
                    first,
                    second,
                    gantry: Gantry::new(settings),
                    has_switches: [first, second]
                        .iter()
                        .all(|drive| axes[*drive].is_squared_by_switch()),
                })
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

    /// From now on all drives stop, whatever the core requests.
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
        // Drives sample once a period; frames are lost, and a bridge that the computer suspends skips cycles.
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
            // Taken over, for the core, once the drive would latch the impulse.
            IndexProgress::Armed => {
                let _axis = self.index.take(self.index_request);
            }
            IndexProgress::Latched(position) => {
                let _axis = self.index.take(self.index_request);
                self.index.latch(position);
            }
        }
    }

    /// Arms the drive whose index pulse is requested. A request for an axis whose drive latches none is never taken over.
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

    /// One period at a time of the bus's clock; afterwards outputs and feedback are those of this period.
    pub(crate) fn step(&mut self, now_ns: u64) {
        let homed = self.homing;
        let pending = self
            .axes
            .iter()
            .filter(|axis| axis.homing() != HomingProgress::Done);
        self.homing = pending.map(DriveAxis::homing_order).min();
        let enabled = self.homing.is_none()
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
            let first = &self.axes[pair.first];
            actual[first.index()] = pair.gantry.position(first.held_position());
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
        } else if self.was_enabled && !enabled
            || self.homing.is_some() && self.axes.iter().any(fails)
            || homed.is_some() && self.homing.is_none()
            || self.gantries.iter().any(|pair| pair.gantry.fault().is_some())
        {
            // After drives have found their zero, the core has to see it without power before it follows.
            self.group_stop = true;
        }
        self.was_enabled = enabled;
        // Without a core a drive that looks for its zero brakes, and no other begins.
        let is_orphaned = target.is_silent && self.homing.is_some();
        self.power = if self.ending || self.group_stop || is_orphaned {
            PowerRequest::QuickStop
        } else {
            target.power
        };
        self.target = Some(target);
    }

    /// Encoders without an absolute position: the beam is assumed square until both drives have homed, or have passed their switches.
    fn align(&mut self) {
        if core::mem::replace(&mut self.aligned, true) {
            return;
        }
        for pair in &self.gantries {
            let [first, second] = [pair.first, pair.second].map(|drive| self.axes[drive].position());
            if !self.axes[pair.second].is_absolute() {
                self.axes[pair.second].rename(pair.gantry.alignment([first, second]));
            }
        }
    }

    /// Positions refer to another datum.
    fn rename(&mut self, shift: &[f64; AXES]) {
        for axis in &mut self.axes {
            axis.rename(shift[axis.index()]);
        }
        for pair in &mut self.gantries {
            let shift_here = shift[self.axes[pair.first].index()];
            let by = pair.gantry.rename(shift_here, is_homed(shift, shift_here));
            for (drive, by) in [pair.first, pair.second].into_iter().zip(by) {
                self.axes[drive].rename(by - shift_here);
            }
        }
    }

    /// Moves drives until their beams are square, and stops both of a gantry if that is not possible.
    fn step_gantries(&mut self, is_enabled: bool, target: &Target) {
        if target.power == PowerRequest::Off && self.homing.is_some() {
            self.axes.iter_mut().for_each(DriveAxis::forget_way);
        }
        for pair in &mut self.gantries {
            let drives = [pair.first, pair.second];
            let [one, other] = drives.map(|drive| self.axes[drive]);
            let switches = [one, other].map(|drive| drive.switches()[0]);
            pair.gantry.step(&GantryInputs {
                is_enabled,
                power: target.requested_power(),
                position: [one, other].map(|drive| drive.position()),
                velocity: target.velocity[one.index()],
                switches: pair.has_switches.then_some(switches),
                // Before both drives know their positions the difference is measured from their start.
                strain: self.homing.is_some().then(|| other.moved() - one.moved()),
                period_s: self.period_s,
            });
            for (side, drive) in drives.into_iter().enumerate() {
                let axis = &mut self.axes[drive];
                axis.set_apart(pair.gantry.offset(side), pair.gantry.velocity(side));
                axis.set_too_far_apart(pair.gantry.fault().is_some());
            }
        }
    }

    /// Axis and fault of each gantry, and how far the beam was from square if it has just been homed by switches.
    pub(crate) fn take_gantry_events(
        &mut self,
    ) -> impl Iterator<Item = (usize, Option<GantryFault>, Option<f64>)> + '_ {
        let axes = &self.axes;
        self.gantries.iter_mut().map(|pair| {
            let axis = axes[pair.first].index();
            (axis, pair.gantry.fault(), pair.gantry.take_squared())
        })
    }

    pub(crate) fn outputs(&mut self, axis: usize) -> DriveOutputs {
        self.axes[axis].outputs(self.target.as_ref(), self.power, self.homing, self.period_s)
    }

    /// Results of the touch probes: the state of the probe, touches, and the positions latched at the last one.
    pub(crate) fn probe(&self) -> ProbeReading {
        let inputs = self.axes.iter().filter_map(DriveAxis::probe_input);
        ProbeReading {
            input: inputs.reduce(|one, other| one || other),
            trips: self.touches.count,
            position: self.touches.position,
            latched_mask: self.touches.axes.bits(),
        }
    }

    /// The limit switches of a drive as the core has to see them.
    fn limits(&self, entry: usize, pressed: [bool; 2]) -> [bool; 2] {
        let mut pairs = self.gantries.iter();
        pairs
            .find(|pair| pair.first == entry || pair.second == entry)
            .map_or(pressed, |pair| {
                pair.gantry.limits(usize::from(pair.second == entry), pressed)
            })
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
            // Of two drives the larger torque.
            if drive.torque_ratio().abs() >= feedback.torque_ratio[axis].abs() {
                feedback.torque_ratio[axis] = drive.torque_ratio();
            }
            let homes = self.homing.is_some() && drive.state() == Some(DriveState::OperationEnabled);
            let word = if homes {
                // The core may not move it yet.
                DriveState::SwitchedOn.code()
            } else {
                drive.status_word()
            };
            // Of two drives the one that is farther from operation.
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
            let first = &self.axes[pair.first];
            let axis = first.index();
            let position = pair.gantry.position(first.position());
            feedback.position[axis] = position;
            feedback.velocity[axis] = first.velocity() - pair.gantry.velocity(0);
            if first.following_error().is_none() {
                feedback.following_error[axis] = target.position[axis] - position;
            }
            if pair.has_switches {
                feedback.home_switch_mask &= !AxisMask::one(axis).bits();
                feedback.home_switch_mask |= AxisMask::one_if(axis, pair.gantry.home_switch()).bits();
            }
        }
        self.index.describe(&mut feedback);
        Some(feedback)
    }
}

#[cfg(test)]
mod tests {
    use evolvent_drive::{DriveEvents, DriveMachine, QuickStopOption};

    use super::*;
    use crate::homing::HOMING_MODE;

    /// At 300 mm/s, with a sample of each period, after four lost frames, and after ten periods in which the bridge was suspended.
    #[test]
    fn the_velocity_after_lost_frames_is_that_of_the_time_between_the_samples() {
        let shipped = evolvent_file_tests::shipped;
        let machine = Machine::parse(&shipped("machines/mill-3axis.toml"), "mill.toml").expect("a machine");
        let network = Network::parse(&shipped("networks/sim-mill.toml"), "mill.toml").expect("a network");
        let period_ns = 1_000_000;
        let mut drives =
            DriveSet::new(&machine, &network, period_ns, 1, &Starts::default()).expect("settings");
        let mut period = 0;
        for periods in [1, 1, 5, 1, 10, 1] {
            period += periods;
            // 2^20 increments a turn of 5 mm; frames are not exactly a period apart.
            let position = (0.3 * period as f64 * 1_048_576.0 / 5.0) as i32;
            let inputs = DriveInputs {
                position,
                ..DriveInputs::default()
            };
            let jitter_ns = 300_000 * (period % 2);
            drives.take(period * period_ns + jitter_ns, 0, inputs);
            let velocity = drives.axes()[0].velocity();
            assert!(
                period == 1 || (velocity - 300.0).abs() < 0.01,
                "{periods}: {velocity} mm/s"
            );
        }
    }

    /// A multi-turn counter without `absolute`, 500 turns from its zero.
    #[test]
    fn a_drive_that_is_homed_begins_at_zero_and_keeps_its_place_over_sessions() {
        let shipped = evolvent_file_tests::shipped;
        let text = shipped("machines/mill-3axis.toml");
        let network = shipped("networks/sim-mill.toml");
        let homing = "\n[[homing]]\naxis = \"X\"\ntowards = \"negative\"\nsearch_mm_s = 50\nlatch_mm_s = 5\nswitch_mm = -5\n";
        let network = Network::parse(&network, "mill.toml").expect("a network");
        // 2^20 increments a turn of 5 mm.
        let turns = |turns: f64| DriveInputs {
            position: (turns * 1_048_576.0) as i32,
            status_word: DriveState::SwitchOnDisabled.code(),
            ..DriveInputs::default()
        };
        for (file, begins, comes_back, after_reset) in [
            (format!("{text}{homing}"), 0.0, 10.0, 0.0),
            // Nothing would tell that it is not where its counter says.
            (text, 2500.0, 2510.0, 5.0),
        ] {
            let machine = Machine::parse(&file, "mill.toml").expect("a machine");
            let starts = Starts::default();
            let session = || DriveSet::new(&machine, &network, 1_000_000, 1, &starts).expect("settings");
            let mut first = session();
            // The drive has not filled its process data yet.
            first.take(1_000_000, 0, DriveInputs::default());
            first.take(2_000_000, 0, turns(500.0));
            assert!((first.axes()[0].position() - begins).abs() < 1e-6);
            let mut second = session();
            second.take(8_000_000, 0, DriveInputs::default());
            second.take(9_000_000, 0, turns(502.0));
            assert!((second.axes()[0].position() - comes_back).abs() < 1e-6);
            // Without voltage meanwhile: the counter has begun again. Only a homed axis may begin at zero.
            let mut third = session();
            third.take(19_000_000, 0, turns(1.0));
            let position = third.axes()[0].position();
            assert!((position - after_reset).abs() < 1e-6, "{position}");
            // That is its place from then on.
            let mut fourth = session();
            fourth.take(29_000_000, 0, turns(3.0));
            let position = fourth.axes()[0].position();
            assert!((position - after_reset - 10.0).abs() < 1e-6, "{position}");
        }
    }

    const PERIOD_NS: u64 = 1_000_000;

    /// The drives of the shipped mill, of which the first two find their zero one after the other, and their core.
    struct Bench {
        drives: DriveSet,
        machines: Vec<DriveMachine>,
        now_ns: u64,
        setpoint: Setpoint,
        fault: Option<u16>,
        /// Increments of the drives, and whether they are ready.
        position: [i32; 3],
        ready: [bool; 3],
    }

    impl Bench {
        fn new(homes: bool) -> Self {
            let shipped = evolvent_file_tests::shipped;
            let machine =
                Machine::parse(&shipped("machines/mill-3axis.toml"), "mill.toml").expect("a machine");
            let text = shipped("networks/sim-mill.toml");
            let mut network = Network::parse(&text, "mill.toml").expect("a network");
            let axes = network
                .devices
                .iter_mut()
                .filter_map(|device| device.axis.as_mut());
            for (axis, order) in axes.zip(0..2).filter(|_| homes) {
                axis.homing = Some(crate::homing::HomingOnDrive {
                    method: 18,
                    search: 10_000_000,
                    latch: 1_000_000,
                    acceleration: None,
                    position: -5.0,
                    order,
                    timeout_s: 10.0,
                });
            }
            let mut bench = Self {
                drives: DriveSet::new(&machine, &network, PERIOD_NS, 1, &Starts::default())
                    .expect("settings"),
                machines: vec![DriveMachine::new(QuickStopOption::ThenDisabled); 3],
                now_ns: 1_000_000_000,
                setpoint: Setpoint {
                    period_ns: PERIOD_NS,
                    axes_mask: 0b111,
                    ..Setpoint::default()
                },
                fault: None,
                position: [0; 3],
                ready: [true; 3],
            };
            bench.request(PowerRequest::Off);
            bench
        }

        fn request(&mut self, power: PowerRequest) {
            self.setpoint.power_request = power.number();
        }

        /// Periods with a core, or without. Returns the outputs of the last.
        fn run(&mut self, periods: u32, has_core: bool) -> Vec<DriveOutputs> {
            let mut outputs = Vec::new();
            for _ in 0..periods {
                if has_core {
                    self.setpoint.sequence += 1;
                    self.setpoint.due_time_ns = self.now_ns + PERIOD_NS;
                    self.drives.offer(self.now_ns, &self.setpoint);
                }
                self.now_ns += PERIOD_NS;
                self.drives.step(self.now_ns);
                outputs = (0..3).map(|axis| self.drives.outputs(axis)).collect();
                for (axis, machine) in self.machines.iter_mut().enumerate() {
                    let events = DriveEvents {
                        ready: self.ready[axis],
                        at_rest: true,
                        fault: self.fault,
                    };
                    machine.step(outputs[axis].control_word & 0x8F, events);
                    let inputs = DriveInputs {
                        status_word: machine.status_word(),
                        mode: outputs[axis].mode,
                        position: self.position[axis],
                        ..DriveInputs::default()
                    };
                    self.drives.take(self.now_ns, axis, inputs);
                }
            }
            outputs
        }
    }

    #[test]
    fn faults_are_reset_for_a_core_that_asks_for_it_and_for_no_other() {
        let mut bench = Bench::new(false);
        // Drives that are in fault before the session, whose core has reset three faults.
        bench.fault = Some(0x2310);
        bench.run(5, false);
        bench.fault = None;
        bench.setpoint.fault_reset = 3;
        bench.run(50, true);
        let is_in_fault = |bench: &Bench| {
            let mut machines = bench.machines.iter();
            machines.all(|machine| machine.state() == DriveState::Fault)
        };
        assert!(is_in_fault(&bench), "a new session");
        // Another core, which begins to count, once after a silence and once at once.
        for silence in [500, 0] {
            bench.run(silence, false);
            (bench.setpoint.sequence, bench.setpoint.fault_reset) = (0, 4 - bench.setpoint.fault_reset);
            bench.run(50, true);
            assert!(
                is_in_fault(&bench),
                "a core that counts from {}",
                bench.setpoint.fault_reset
            );
        }
        bench.setpoint.fault_reset += 1;
        bench.run(50, true);
        let feedback = bench.drives.feedback(bench.now_ns).expect("feedback");
        assert_eq!(feedback.fault_reset_done, bench.setpoint.fault_reset);
        assert!(!is_in_fault(&bench));
    }

    /// A vertical axis, whose position loop has to carry it: one increment further down in each period if its target goes with it.
    #[test]
    fn a_drive_that_waits_for_the_others_holds_its_place() {
        let mut bench = Bench::new(false);
        bench.ready[1] = false;
        bench.run(20, true);
        bench.position[0] = 1000;
        bench.request(PowerRequest::On);
        bench.run(10, true);
        assert_eq!(bench.machines[0].state(), DriveState::OperationEnabled);
        for _ in 0..500 {
            bench.position[0] -= 1;
            assert_eq!(bench.run(1, true)[0].target, 1000);
        }
        // The others come, and the core's setpoints are where it was: no step.
        bench.ready[1] = true;
        bench.setpoint.position = bench.drives.feedback(bench.now_ns).expect("feedback").position;
        bench.setpoint.position[0] += 500.0 * 5.0 / 1_048_576.0;
        for _ in 0..50 {
            assert_eq!(bench.run(1, true)[0].target, 1000);
        }
        assert_eq!(bench.machines[1].state(), DriveState::OperationEnabled);
        // Moved by hand without power: it holds where it comes into operation again.
        bench.request(PowerRequest::Off);
        bench.run(20, true);
        bench.position[0] = 7000;
        bench.run(20, true);
        bench.setpoint.position = bench.drives.feedback(bench.now_ns).expect("feedback").position;
        bench.request(PowerRequest::On);
        for _ in 0..10 {
            assert_eq!(bench.run(1, true)[0].target, 7000);
        }
    }

    /// A probe at two drives, whose first contact bounces: one drive is armed again in time to count it.
    #[test]
    fn a_bounce_that_one_drive_counts_leaves_the_other_in_the_next_touches() {
        let shipped = evolvent_file_tests::shipped;
        let machine = Machine::parse(&shipped("machines/mill-3axis.toml"), "mill.toml").expect("a machine");
        let text = shipped("networks/sim-mill.toml");
        let mut network = Network::parse(&text, "mill.toml").expect("a network");
        let axes = network
            .devices
            .iter_mut()
            .filter_map(|device| device.axis.as_mut());
        axes.take(2).for_each(|axis| axis.touch_probe = true);
        let mut drives =
            DriveSet::new(&machine, &network, PERIOD_NS, 1, &Starts::default()).expect("settings");
        // Edges by ms, of the first drive and of the second, which is slower by a period.
        let edges = [[10, 18, 500, 900], [11, 0, 501, 901]];
        let mut seen = Vec::new();
        for ms in 1..1000_i32 {
            for (drive, edges) in edges.iter().enumerate() {
                // Stored for two periods; then off, and armed again.
                let is_stored = edges.iter().any(|edge| (*edge..edge + 2).contains(&ms));
                let is_off = edges.iter().any(|edge| (edge + 2..edge + 4).contains(&ms));
                let inputs = DriveInputs {
                    status_word: DriveState::OperationEnabled.code(),
                    probe_status: u16::from(is_stored) << 1 | u16::from(!is_off && ms > 3),
                    probe_position: ms,
                    position: ms,
                    ..DriveInputs::default()
                };
                drives.take(ms as u64 * PERIOD_NS, drive, inputs);
            }
            let reading = drives.probe();
            if [15, 30, 510, 910].contains(&ms) {
                let increments = reading.position[0] * 1_048_576.0 / 5.0;
                seen.push((reading.trips, reading.latched_mask, increments.round() as i32));
            }
        }
        // The second drive that takes part is Y.
        assert_eq!(
            seen,
            [(1, 0b11, 10), (1, 0b11, 10), (2, 0b11, 500), (3, 0b11, 900)]
        );
    }

    #[test]
    fn drives_that_home_stop_when_the_core_has_gone_and_no_other_begins() {
        let mut bench = Bench::new(true);
        bench.run(20, true);
        bench.request(PowerRequest::On);
        let outputs = bench.run(50, true);
        let modes: Vec<i8> = outputs.iter().map(|outputs| outputs.mode).collect();
        assert_eq!(modes, [HOMING_MODE, 8, 8]);
        assert_eq!(bench.machines[0].state(), DriveState::OperationEnabled);
        // Setpoints are late for a few periods, then there are none.
        bench.run(8, false);
        assert_eq!(bench.machines[0].state(), DriveState::OperationEnabled);
        bench.run(5, false);
        for _ in 0..2000 {
            let outputs = bench.run(1, false);
            assert!(outputs.iter().all(|outputs| outputs.mode != HOMING_MODE));
            assert!(bench.machines.iter().all(|machine| !machine.has_torque()));
        }
        // The same core, that was only late: power comes back after off.
        let outputs = bench.run(50, true);
        assert!(outputs.iter().all(|outputs| outputs.mode != HOMING_MODE));
        bench.request(PowerRequest::Off);
        bench.run(20, true);
        bench.request(PowerRequest::On);
        assert_eq!(bench.run(50, true)[0].mode, HOMING_MODE);
    }

    /// A counter without `absolute` 500 turns from its zero, which the drive's own homing sets to 0.
    #[test]
    fn a_drive_that_has_homed_counts_from_there_in_the_next_session_too() {
        let shipped = evolvent_file_tests::shipped;
        let machine = Machine::parse(&shipped("machines/mill-3axis.toml"), "mill.toml").expect("a machine");
        let text = shipped("networks/sim-mill.toml");
        let mut network = Network::parse(&text, "mill.toml").expect("a network");
        let mut devices = network.devices.iter_mut();
        let axis = devices.find_map(|device| device.axis.as_mut()).expect("an axis");
        axis.homing = Some(crate::homing::HomingOnDrive {
            method: 18,
            search: 10_000_000,
            latch: 1_000_000,
            acceleration: None,
            position: -5.0,
            order: 0,
            timeout_s: 10.0,
        });
        let starts = Starts::default();
        let session = || DriveSet::new(&machine, &network, 1_000_000, 1, &starts).expect("settings");
        let mut first = session();
        let at = |position: i32, status_word: u16| DriveInputs {
            position,
            status_word,
            mode: HOMING_MODE,
            ..DriveInputs::default()
        };
        let enabled = DriveState::OperationEnabled.code();
        let attained = 1 << 10 | 1 << 12;
        for period in 0..40_u64 {
            let inputs = if period < 20 {
                at(500 << 20, enabled)
            } else {
                at(0, enabled | attained)
            };
            first.take((period + 1) * 1_000_000, 0, inputs);
            let _outputs = first.axes[0].outputs(None, PowerRequest::On, Some(0), 1e-3);
        }
        assert_eq!(first.axes()[0].homing(), HomingProgress::Done);
        assert!((first.axes()[0].position() + 5.0).abs() < 1e-9);
        let mut second = session();
        // A turn of 5 mm from where it has homed.
        second.take(90_000_000, 0, at(1 << 20, DriveState::SwitchOnDisabled.code()));
        let position = second.axes()[0].position();
        assert!(position.abs() < 1e-9, "{position}");
    }
}
