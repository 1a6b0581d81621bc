//! Outputs and inputs on the bus: the work of the publisher's thread.

use crate::input_check::input_entry;
use evolvent_bus::{CoreBus, Feedback, MachineOutputs, spindle_flags};
use evolvent_drive::{InputEntry, InputFault, KnownInputs, KnownProbe, SpindleEntry, SpindleFault};
use evolvent_gcode::{SPINDLES, SpindleDirection};
use evolvent_machine::{SignalKind, SignalSettings};
use evolvent_signals::{InputImage, OutputImage, ProbeImage, ProbeState, SpindleAngle, SpindleState};
use rtrb::{Consumer, Producer};

use crate::due_setpoint::DueSetpoint;
use crate::periphery::Periphery;
use crate::probe_locator::ProbeLocator;
use crate::signal_loop::DueOutputs;
use crate::spindle_command::SpindleCommand;
use crate::spindle_speedometer::Speedometer;
use crate::spindle_stall::StallWatch;

/// Capacity of the queue of input samples to the cycle.
pub(crate) const SAMPLES: usize = 1024;
/// Capacity of the queue of output changes to the bus.
pub(crate) const CHANGES: usize = 4096;

/// Maximum time from the command to the first report of a spindle, ns: 1 s in which a bridge notices that the
/// core before this one has ended, 1 s in which systemd restarts it, and 1 s in which it joins.
const FIRST_REPORT_NS: u64 = 3_000_000_000;

/// The last command of programs to a spindle.
#[derive(Clone, Copy, Debug, Default)]
struct Commanded {
    /// Number of the command.
    number: u64,
    /// The message of outputs that carried it to the bridge.
    sequence: u64,
    /// Due time of that message, if the spindle is to turn.
    turns_since_ns: Option<u64>,
    /// A ramp has not reached the commanded speed.
    is_passing: bool,
    /// The speed with the last setpoint, rpm.
    rpm: f64,
}

/// Sends the cycle's outputs, and receives the bridges' inputs.
#[derive(Debug)]
pub(crate) struct SignalPort {
    entry: InputEntry,
    spindles: SpindleEntry,
    commanded: [Commanded; SPINDLES],
    speedometers: [Speedometer; SPINDLES],
    stalls: [StallWatch; SPINDLES],
    period_ns: u64,
    /// The last state switched by programs.
    periphery: Periphery,
    /// The last setpoint: its number and due time.
    last_due: (u64, u64),
    /// The spindle whose angle the program follows.
    follows_angle: Option<u32>,
    settings: SignalSettings,
    samples: Producer<InputImage>,
    changes: Consumer<DueOutputs>,
    /// The last sample sent to the cycle.
    sent: Option<InputImage>,
    message: MachineOutputs,
    /// The last known state of the probe.
    probe: Option<KnownProbe>,
    probe_image: ProbeImage,
    locator: ProbeLocator,
}

impl SignalPort {
    /// Every output at its safe value, with this tool in the spindle. `period_ns` is the time between
    /// setpoints.
    pub(crate) fn new(
        settings: &SignalSettings,
        period_ns: u64,
        tool: u32,
        samples: Producer<InputImage>,
        changes: Consumer<DueOutputs>,
    ) -> Self {
        let entry = input_entry(settings);
        let mut message = MachineOutputs {
            tool,
            ..MachineOutputs::default()
        };
        for output in &settings.outputs {
            let bit = 1_u64 << output.number;
            match output.kind {
                SignalKind::Digital => {
                    message.digital_mask |= bit;
                    message.safe_digital |= if output.safe == 0.0 { 0 } else { bit };
                }
                SignalKind::Analog => {
                    message.analog_mask |= bit as u32;
                    message.safe_analog[output.number as usize] = output.safe;
                }
            }
        }
        (message.digital, message.analog) = (message.safe_digital, message.safe_analog);
        let timeout_ns = (settings.input_timeout_s * 1e9) as u64;
        let mut spindles = SpindleEntry::new(timeout_ns);
        for spindle in &settings.spindles {
            message.spindle_mask |= 1 << spindle.number;
            if spindle.has_feedback() {
                spindles = spindles.with_spindle(spindle.number, spindle.max_rpm);
            }
        }
        Self {
            entry,
            spindles,
            commanded: [Commanded::default(); SPINDLES],
            speedometers: [Speedometer::default(); SPINDLES],
            stalls: [StallWatch::default(); SPINDLES],
            period_ns,
            periphery: Periphery::default(),
            last_due: (0, 0),
            follows_angle: None,
            settings: settings.clone(),
            samples,
            changes,
            sent: None,
            message,
            probe: None,
            probe_image: ProbeImage::default(),
            locator: ProbeLocator::new(),
        }
    }

    /// Receives the bridges' messages, and passes the inputs to the cycle if they have changed.
    pub(crate) fn take_inputs(&mut self, bus: &mut CoreBus, now_ns: u64) {
        // Each message separately, since an edge and its end may arrive together.
        while let Ok(Some(message)) = bus.unchecked_inputs() {
            // Faulty messages are counted; one report for each would not help.
            if self.entry.take(&message, now_ns).is_ok() {
                self.hand_on(now_ns);
            }
        }
        while let Ok(Some(message)) = bus.unchecked_spindle() {
            if self.spindles.take(&message, now_ns).is_ok() {
                self.hand_on(now_ns);
            }
        }
        self.hand_on(now_ns);
    }

    /// The state of a spindle relative to its last command.
    fn spindle_state(&self, number: u32, now_ns: u64) -> Option<SpindleState> {
        let command = self.commanded.get(number as usize).copied().unwrap_or_default();
        let spindle = self.settings.spindle(number)?;
        if !spindle.has_feedback() {
            // The spindle follows the ramp of its command.
            return Some(SpindleState {
                command: command.number,
                at_speed: command.sequence > 0 && !command.is_passing,
                ..SpindleState::default()
            });
        }
        let timeout_ns = (self.settings.input_timeout_s * 1e9) as u64;
        let Some(known) = self.spindles.known(now_ns, number) else {
            let since_ns = command.turns_since_ns?;
            let permitted_ns = if self.spindles.has_reported(number) {
                timeout_ns
            } else {
                // The missing report, not the speed that was not reached, is to end the program.
                let half_wait_ns = (spindle.at_speed_timeout_s * 0.5e9) as u64;
                timeout_ns.max(FIRST_REPORT_NS.min(half_wait_ns))
            };
            return (now_ns > since_ns.saturating_add(permitted_ns)).then_some(SpindleState {
                command: command.number,
                silent: true,
                ..SpindleState::default()
            });
        };
        let has = |flag: u32| known.flags & flag != 0;
        let obeys = command.sequence > 0 && !command.is_passing && known.outputs_sequence >= command.sequence;
        Some(SpindleState {
            command: command.number,
            at_speed: obeys && has(spindle_flags::AT_SPEED),
            oriented: obeys && has(spindle_flags::ORIENTED),
            fault: has(spindle_flags::FAULT),
            silent: false,
            indexed: has(spindle_flags::INDEXED),
        })
    }

    /// The newest angle sample of the spindle that the motion follows, if a program follows one.
    fn spindle_angle(&self, now_ns: u64) -> Option<SpindleAngle> {
        let (sequence, due_ns) = self.last_due;
        let spindle = self.follows_angle.filter(|_| due_ns != 0)?;
        let known = self.spindles.known(now_ns, spindle)?;
        let since_due_ns = known.time_ns as i64 - due_ns as i64;
        Some(SpindleAngle {
            cycle: sequence as f64 + since_due_ns as f64 / self.period_ns as f64,
            turns: known.turns as f64 + known.fraction,
        })
    }

    /// The speed of a spindle that a bridge reports, rpm, negative counter-clockwise; `None` if it is too
    /// old.
    pub(crate) fn measured_rpm(&self, number: u32, now_ns: u64) -> Option<f64> {
        Some(self.spindles.known(now_ns, number)?.speed_rpm)
    }

    /// Number of rejected messages of spindles, and the fault of the last one; `None` if there were none.
    pub(crate) fn refused_spindles(&self) -> Option<(u64, SpindleFault)> {
        let (count, fault) = self.spindles.refused();
        fault.map(|fault| (count, fault))
    }

    /// Adds feedback of the drives, from which the position of a contact is interpolated.
    pub(crate) fn observe_feedback(&mut self, feedback: &Feedback) {
        if self.settings.probe.is_some() {
            self.locator.observe_feedback(feedback);
        }
    }

    fn hand_on(&mut self, now_ns: u64) {
        let known = self.entry.known(now_ns);
        let probe = known.probe.filter(|_| self.settings.probe.is_some());
        let (mut image, bounces) = (image_of(&known), self.follow_probe(probe, now_ns));
        let is_stalled = self.watch_stalls(now_ns);
        let known_spindles = self
            .settings
            .spindles
            .iter()
            .filter(|spindle| spindle.has_feedback() || spindle.ramp_rpm_s.is_some());
        for spindle in known_spindles {
            let mut state = self.spindle_state(spindle.number, now_ns);
            if let Some(state) = &mut state {
                state.fault |= is_stalled[spindle.number as usize];
            }
            image.set_spindle(spindle.number, state);
        }
        image.angle = self.spindle_angle(now_ns);
        image.angle_spindle = self.follows_angle.unwrap_or(0);
        for (number, meter) in self.speedometers.iter_mut().enumerate() {
            image.speeds_rpm[number] = match self.settings.spindle(number as u32) {
                Some(spindle) if !spindle.has_feedback() && spindle.ramp_rpm_s.is_some() => {
                    let commanded = &self.commanded[number];
                    Some(meter.commanded_rpm(commanded.rpm, commanded.is_passing))
                }
                _ => meter.rpm(self.spindles.known(now_ns, number as u32).as_ref()),
            };
        }
        if bounces {
            // The probe is open again already; the contact counts nevertheless.
            image.probe = ProbeImage {
                state: ProbeState::Tripped,
                ..self.probe_image
            };
            self.send_sample(&image);
        }
        self.probe_image.state = match probe {
            None => ProbeState::Unknown,
            Some(probe) if probe.is_tripped => ProbeState::Tripped,
            Some(_) => ProbeState::Open,
        };
        image.probe = self.probe_image;
        self.send_sample(&image);
        // Positions follow the changes that they belong to.
        while let Some(position) = self.locator.next(now_ns) {
            self.probe_image.locate_change(position);
            image.probe = self.probe_image;
            self.send_sample(&image);
        }
    }

    /// The spindles that have stalled after reaching their speed, except one that a pass follows.
    fn watch_stalls(&mut self, now_ns: u64) -> [bool; SPINDLES] {
        std::array::from_fn(|number| {
            let is_followed = (self.periphery.in_pass).is_some_and(|pass| pass.spindle == number as u32);
            let known = self
                .spindles
                .known(now_ns, number as u32)
                .filter(|_| !is_followed);
            let Some(known) = known else {
                self.stalls[number] = StallWatch::default();
                return false;
            };
            let commanded_rpm = match self.message.spindle_direction[number] {
                1 => self.message.spindle_rpm[number],
                2 => -self.message.spindle_rpm[number],
                _ => 0.0,
            };
            self.stalls[number].is_stalled(commanded_rpm, known.speed_rpm, now_ns)
        })
    }

    fn send_sample(&mut self, image: &InputImage) {
        if self.sent != Some(*image) && self.samples.push(*image).is_ok() {
            self.sent = Some(*image);
        }
    }

    /// Whether the probe has tripped and opened again since the last call.
    fn follow_probe(&mut self, probe: Option<KnownProbe>, now_ns: u64) -> bool {
        let (Some(now), Some(before)) = (probe, std::mem::replace(&mut self.probe, probe)) else {
            return false;
        };
        if now.instance != before.instance {
            return false;
        }
        let has_tripped = now.trips > before.trips;
        if has_tripped || now.is_tripped != before.is_tripped {
            self.locator.observe_change(&now, now_ns);
        }
        has_tripped && !now.is_tripped
    }

    /// Whether the emergency-stop chain is closed; `true` without a chain.
    pub(crate) fn is_chain_closed(&self) -> bool {
        self.settings.estop.is_none_or(|estop| {
            let closed = f64::from(u8::from(estop.closed));
            self.sent
                .is_some_and(|image| image.value(SignalKind::Digital, estop.input) == Some(closed))
        })
    }

    /// Number of rejected messages of inputs, and the fault of the last one; `None` if there were none.
    pub(crate) fn refused(&self) -> Option<(u64, InputFault)> {
        let (count, fault) = self.entry.refused();
        fault.map(|fault| (count, fault))
    }

    /// Sends what changes with a setpoint, before the setpoint itself. `periphery`: its state, if it has
    /// changed; `commands`: the commands to the spindles.
    pub(crate) fn follow(
        &mut self,
        bus: &mut CoreBus,
        due: &DueSetpoint,
        periphery: Option<&Periphery>,
        commands: &[SpindleCommand; SPINDLES],
    ) {
        if self.settings.probe.is_some() {
            self.locator.observe_setpoint(due);
        }
        self.last_due = (due.setpoint.sequence, due.due_time_ns);
        let mut outputs: Option<OutputImage> = None;
        while let Ok(change) = self.changes.peek()
            && change.sequence <= due.setpoint.sequence
        {
            outputs = Some(change.outputs);
            let _taken = self.changes.pop();
        }
        if let Some(outputs) = outputs {
            (self.message.digital, self.message.analog) = (outputs.digital, outputs.analog);
        }
        if let Some(periphery) = periphery {
            self.periphery = *periphery;
            self.follows_angle = periphery.follows_angle;
            self.message.coolant = periphery.coolant_bits();
            self.message.tool = periphery.tool;
            (self.message.tool_change, self.message.tool_wanted) = periphery.change_numbers();
        }
        let mut is_commanded = false;
        for (number, command) in commands.iter().enumerate() {
            is_commanded |= self.command_spindle(number, command);
            if periphery.is_some() {
                self.note_command(number, due.due_time_ns);
            }
        }
        if outputs.is_some() || periphery.is_some() || is_commanded {
            self.message.cycle = due.setpoint.sequence;
            self.message.due_time_ns = due.due_time_ns;
            self.send(bus);
        }
    }

    /// Writes the command to a spindle into the next message. Returns whether it differs from the last.
    fn command_spindle(&mut self, number: usize, command: &SpindleCommand) -> bool {
        let message = &mut self.message;
        let before = (
            message.spindle_direction[number],
            message.spindle_rpm[number],
            message.spindle_angle[number],
            message.spindle_way[number],
        );
        // The spindle turns to an angle after its ramp has ended.
        let orientation = self.periphery.orientations[number].filter(|_| command.passing.is_none());
        let programmed = self.periphery.outputs.spindles[number].direction;
        let now = (
            match orientation {
                Some(_) => ORIENT,
                None => direction_number(command.passing.unwrap_or(programmed)),
            },
            command.rpm,
            // 360 degrees are equivalent to 0.
            orientation.map_or(0.0, |orient| orient.degrees % 360.0),
            orientation
                .and_then(|orient| orient.direction)
                .map_or(0, direction_number),
        );
        (
            message.spindle_direction[number],
            message.spindle_rpm[number],
            message.spindle_angle[number],
            message.spindle_way[number],
        ) = now;
        let commanded = &mut self.commanded[number];
        commanded.is_passing = command.passing.is_some();
        commanded.rpm = if now.0 == ORIENT || now.0 == 0 {
            0.0
        } else {
            command.rpm
        };
        if now != before {
            // The number of the next message.
            commanded.sequence = self.message.sequence + 1;
        }
        now != before
    }

    /// Notes a command of the program to a spindle.
    fn note_command(&mut self, number: usize, due_time_ns: u64) {
        let commanded = &mut self.commanded[number];
        let is_new = commanded.number != self.periphery.spindle_commands[number];
        commanded.number = self.periphery.spindle_commands[number];
        let since_ns = commanded
            .turns_since_ns
            .filter(|_| !is_new)
            .unwrap_or(due_time_ns);
        commanded.turns_since_ns = self.periphery.drives_spindle(number).then_some(since_ns);
        if commanded.sequence == 0 {
            commanded.sequence = self.message.sequence + 1;
        }
    }

    /// Sends the outputs in force. A message that cannot be sent is superseded by the next.
    pub(crate) fn send(&mut self, bus: &mut CoreBus) {
        self.message.sequence += 1;
        let _lost = bus.publish_outputs(&self.message);
    }
}

/// `spindle_direction` of a spindle that turns to an angle.
const ORIENT: u32 = 3;

fn direction_number(direction: SpindleDirection) -> u32 {
    match direction {
        SpindleDirection::Stopped => 0,
        SpindleDirection::Clockwise => 1,
        SpindleDirection::CounterClockwise => 2,
    }
}

fn image_of(known: &KnownInputs) -> InputImage {
    InputImage {
        digital_known: known.digital_known,
        digital: known.digital,
        analog_known: known.analog_known,
        analog: known.analog,
        ..InputImage::default()
    }
}
