//! Outputs and inputs in the loop of the cycle: receives samples, and sends changes to bus and trace.

use evolvent_machine::{MAX_ANALOG, MAX_DIGITAL, MAX_SPINDLES, SignalKind, SignalSettings};
use evolvent_motion::{MotionState, Setpoint};
use evolvent_path::AxisLetter;
use evolvent_signals::{
    InputImage, OutputChange, OutputImage, OverrideSwitches, Phase, ProbeInput, ProbeState, Progress,
    ScheduleConsumer, Signals, SpindleAngle, SpindleInput, SpindleState, probe_numbers,
};
use rtrb::{Consumer, Producer};

use crate::due_setpoint::SpindleOverrides;
use crate::handwheel_view::HandwheelView;
use crate::input_script::InputScript;

/// Outputs to be published, from one setpoint on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DueOutputs {
    pub sequence: u64,
    pub outputs: OutputImage,
}

/// While the spindle is stopped, rapids continue as with this feed override.
const RAPID_RATIO: f64 = 0.01;

/// Number in the trace of the angle of the spindle that the motion follows.
const ANGLE: u32 = 96;
/// Number in the trace of the time of that angle.
const ANGLE_CYCLE: u32 = ANGLE + 1;
/// Number in the trace of the speed of spindle 0; the other spindles follow.
const SPEED: u32 = ANGLE + 2;
/// Number in the trace of the spindle that the angle belongs to.
const ANGLE_SPINDLE: u32 = SPEED + MAX_SPINDLES;

/// A recorded change of an input or output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalChange {
    /// The setpoint with which it changed.
    pub sequence: u64,
    /// Whether it is an output.
    pub is_output: bool,
    /// The signal.
    pub name: SignalName,
    /// The new value; `None` for an input that is unknown. For a spindle, the number of a [`SpindleState`].
    pub value: Option<f64>,
}

/// A signal of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SignalName {
    /// An input or output with its number.
    Signal(SignalKind, u32),
    /// The state of a spindle: an input.
    Spindle(u32),
    /// A value of the probe, numbered as in [`probe_numbers`]: an input.
    Probe(u32),
    /// A value of the newest angle sample of the spindle that the motion follows: an input.
    Angle(AngleValue),
    /// The speed of a spindle, rpm: an input.
    Speed(u32),
    /// The spindle that the angle belongs to: an input.
    AngleSpindle,
}

/// One of the two numbers of an angle sample. In the trace the turns come first; the time completes the
/// sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AngleValue {
    /// Turns since the index pulse.
    Turns,
    /// The time of the angle, as the number of the setpoint that is due then.
    Cycle,
}

impl SignalName {
    /// Sets an input of an image; `None` makes it unknown. Real-time safe.
    pub(crate) fn enter(self, image: &mut InputImage, value: Option<f64>) {
        match self {
            Self::Signal(kind, number) => image.set(kind, number, value),
            Self::Spindle(number) => {
                image.set_spindle(number, value.and_then(SpindleState::from_number));
            }
            Self::Probe(number) => image.probe.set(number, value),
            Self::Speed(number) => {
                if let Some(speed) = image.speeds_rpm.get_mut(number as usize) {
                    *speed = value;
                }
            }
            Self::AngleSpindle => image.angle_spindle = value.unwrap_or(0.0) as u32,
            Self::Angle(number) => {
                // A sample is incomplete without its time.
                let mut angle = image.angle.unwrap_or(SpindleAngle {
                    cycle: f64::NAN,
                    turns: f64::NAN,
                });
                match (number, value) {
                    (_, None) => image.angle = None,
                    (AngleValue::Turns, Some(turns)) => angle.turns = turns,
                    (AngleValue::Cycle, Some(cycle)) => angle.cycle = cycle,
                }
                if value.is_some() {
                    image.angle = Some(angle);
                }
            }
        }
    }
}

impl SignalChange {
    /// The number in the trace. Analog signals have an offset of 64, spindles of 80, values of the probe of
    /// 84. 96 and 97 are the angle of a spindle and its time, 98 to 101 the speeds of the spindles, 102 the
    /// spindle of the angle.
    #[must_use]
    pub const fn code(&self) -> u32 {
        match self.name {
            SignalName::Signal(SignalKind::Digital, number) => number,
            SignalName::Signal(SignalKind::Analog, number) => MAX_DIGITAL + number,
            SignalName::Spindle(number) => MAX_DIGITAL + MAX_ANALOG + number,
            SignalName::Probe(number) => MAX_DIGITAL + MAX_ANALOG + MAX_SPINDLES + number,
            SignalName::Angle(AngleValue::Turns) => ANGLE,
            SignalName::Angle(AngleValue::Cycle) => ANGLE_CYCLE,
            SignalName::Speed(number) => SPEED + number,
            SignalName::AngleSpindle => ANGLE_SPINDLE,
        }
    }

    /// The signal with a number in the trace.
    #[must_use]
    pub const fn of_code(code: u32) -> SignalName {
        const SPINDLES: u32 = MAX_DIGITAL + MAX_ANALOG;
        const PROBE: u32 = SPINDLES + MAX_SPINDLES;
        match code {
            0..MAX_DIGITAL => SignalName::Signal(SignalKind::Digital, code),
            MAX_DIGITAL..SPINDLES => SignalName::Signal(SignalKind::Analog, code - MAX_DIGITAL),
            SPINDLES..PROBE => SignalName::Spindle(code - SPINDLES),
            PROBE..ANGLE => SignalName::Probe(code - PROBE),
            ANGLE => SignalName::Angle(AngleValue::Turns),
            ANGLE_CYCLE => SignalName::Angle(AngleValue::Cycle),
            SPEED..ANGLE_SPINDLE => SignalName::Speed(code - SPEED),
            _ => SignalName::AngleSpindle,
        }
    }

    /// Applies the change to an image of the inputs.
    pub(crate) fn enter(&self, image: &mut InputImage) {
        self.name.enter(image, self.value);
    }

    /// The change as text, with the machine's name of the signal: `output clamp on`.
    pub(crate) fn text(&self, settings: &SignalSettings) -> String {
        let (kind, number) = match self.name {
            SignalName::Signal(kind, number) => (kind, number),
            SignalName::Spindle(number) => {
                return format!("spindle {number} {}", spindle_text(self.value));
            }
            SignalName::Probe(number) => return probe_text(number, self.value),
            SignalName::Angle(value) => return angle_text(value, self.value),
            SignalName::Speed(number) => {
                return match self.value {
                    Some(rpm) => format!("spindle {number}: {rpm:.1} rpm"),
                    None => format!("spindle {number}: speed unknown"),
                };
            }
            SignalName::AngleSpindle => {
                return format!("angle of spindle {}", self.value.unwrap_or(0.0));
            }
        };
        let name = if self.is_output {
            settings.output(kind, number).map(|output| &output.name)
        } else {
            settings.input(kind, number).map(|input| &input.name)
        };
        let direction = if self.is_output { "output" } else { "input" };
        let name = name.map_or_else(|| number.to_string(), Clone::clone);
        match (kind, self.value) {
            (_, None) => format!("{direction} {name} unknown"),
            (SignalKind::Digital, Some(value)) => {
                format!("{direction} {name} {}", if value == 0.0 { "off" } else { "on" })
            }
            (_, Some(value)) => format!("{direction} {name} {value}"),
        }
    }
}

/// A number of an angle sample as text.
fn angle_text(name: AngleValue, value: Option<f64>) -> String {
    match (name, value) {
        (_, None) => "spindle: angle unknown".to_owned(),
        (AngleValue::Turns, Some(turns)) => format!("spindle: turned by {turns}"),
        (AngleValue::Cycle, Some(cycle)) => format!("spindle: at setpoint {cycle}"),
    }
}

/// A value of the probe as text.
fn probe_text(number: u32, value: Option<f64>) -> String {
    let value_or_nan = value.unwrap_or(f64::NAN);
    match (number, value) {
        (probe_numbers::STATE, None) => "probe unknown".to_owned(),
        (probe_numbers::STATE, Some(0.0)) => "probe open".to_owned(),
        (probe_numbers::STATE, Some(1.0)) => "probe tripped".to_owned(),
        (probe_numbers::STATE, Some(_)) => "probe: time is virtual, no contact is known".to_owned(),
        (probe_numbers::CHANGES, _) => format!("probe: position of change {value_or_nan}"),
        _ => {
            let axis = AxisLetter::ALL.get((number - probe_numbers::POSITION) as usize);
            let letter = axis.map_or('?', |axis| axis.letter());
            format!("probe: changed at {letter}{value_or_nan}")
        }
    }
}

fn spindle_text(value: Option<f64>) -> &'static str {
    match value.and_then(SpindleState::from_number) {
        None => "unknown",
        Some(state) if state.fault => "in fault",
        Some(state) if state.silent => "silent",
        Some(state) if state.oriented => "oriented",
        Some(state) if state.at_speed => "at speed",
        Some(_) => "not at speed",
    }
}

/// Source of the inputs.
#[derive(Debug)]
pub(crate) enum InputSource {
    /// Bridges on the bus.
    Bus(Consumer<InputImage>),
    /// A file with the times of their changes.
    Script(Box<InputScript>),
}

/// Outputs, inputs and waits of one loop. Real-time safe except construction.
#[derive(Debug)]
pub(crate) struct SignalLoop {
    signals: Signals,
    source: InputSource,
    bus: Option<Producer<DueOutputs>>,
    trace: Option<Producer<SignalChange>>,
    recorded_inputs: InputImage,
    recorded_outputs: OutputImage,
    sent: Option<OutputImage>,
    /// Number of changes that did not fit into the queue.
    pub lost: u64,
    is_realtime: bool,
    progress: ProgramProgress,
    /// The chain was open since the last reset.
    estopped: bool,
}

impl SignalLoop {
    pub(crate) fn new(
        signals: Signals,
        source: InputSource,
        bus: Option<Producer<DueOutputs>>,
        trace: Option<Producer<SignalChange>>,
        is_realtime: bool,
    ) -> Self {
        Self {
            recorded_outputs: *signals.safe(),
            signals,
            source,
            bus,
            trace,
            recorded_inputs: InputImage::default(),
            sent: None,
            lost: 0,
            is_realtime,
            progress: ProgramProgress::default(),
            estopped: false,
        }
    }

    /// Begins a program whose first block has this number. Returns the schedule of a program that was not
    /// ended.
    pub(crate) fn begin_program(
        &mut self,
        schedule: ScheduleConsumer,
        first_block: u32,
    ) -> Option<ScheduleConsumer> {
        self.progress = ProgramProgress::new(first_block);
        self.signals.begin_program(schedule)
    }

    /// Ends the program. Returns its schedule, to be dropped by a thread without deadlines.
    pub(crate) fn end_program(&mut self) -> Option<ScheduleConsumer> {
        self.signals.end_program()
    }

    /// Sets outputs by hand, from the next setpoint on.
    pub(crate) fn set_by_hand(&mut self, change: &OutputChange) {
        self.signals.set_by_hand(change);
    }

    /// Forgets that the chain was open, unless it still is.
    pub(crate) fn reset_estop(&mut self) {
        self.estopped = self.signals.is_estop_open();
    }

    /// Before a setpoint: applies the inputs for it. `last` is the preceding setpoint.
    pub(crate) fn apply_inputs(&mut self, sequence: u64, period_ns: u64, last: Option<&Setpoint>) {
        loop {
            let sample = match &mut self.source {
                InputSource::Bus(samples) => samples.pop().ok(),
                InputSource::Script(script) => script.next(sequence, period_ns, last),
            };
            let Some(sample) = sample else { break };
            self.record_inputs(sequence, &sample);
            self.signals.observe(&sample);
        }
        self.estopped |= self.signals.is_estop_open();
    }

    /// The state of the handwheel whose counts are this analog input.
    pub(crate) fn handwheel(&self, counts: u32) -> HandwheelView {
        let inputs = self.signals.inputs();
        HandwheelView {
            counts: inputs.value(SignalKind::Analog, counts),
            digital: inputs.digital & inputs.digital_known,
        }
    }

    /// The probe's input for the next setpoint. Call it once per setpoint, after its inputs.
    pub(crate) fn take_probe(&mut self) -> ProbeInput {
        self.signals.take_probe()
    }

    /// The rotation of the spindle that the motion follows, at the due time of this setpoint.
    pub(crate) fn spindle_at(&self, sequence: u64) -> SpindleInput {
        self.signals.spindle_at(sequence)
    }

    /// The inputs for the setpoint of this cycle.
    pub(crate) fn inputs(&self) -> &InputImage {
        self.signals.inputs()
    }

    /// The overrides in force for the next setpoint.
    pub(crate) fn overrides(&self) -> OverrideSwitches {
        *self.signals.overrides()
    }

    /// Factor on the feed of the plan for the next setpoint. `last` is the preceding setpoint; `is_rapid`: it
    /// belongs to a rapid, or a rapid comes next.
    pub(crate) fn feed_ratio(
        &mut self,
        last: Option<&Setpoint>,
        is_rapid: bool,
        spindle_overrides: &SpindleOverrides,
    ) -> f64 {
        let Some(last) = last else { return 1.0 };
        let ratio = self.signals.feed_ratio(last.position[0], spindle_overrides);
        if !is_rapid {
            return ratio;
        }
        // A rapid does not depend on the spindle, but a factor of zero would stop it.
        ratio.max(RAPID_RATIO)
    }

    /// Whether the emergency-stop chain was open at this or an earlier setpoint.
    pub(crate) fn is_estopped(&self) -> bool {
        self.estopped
    }

    /// A spindle that is in fault, or whose rotation is not reported.
    pub(crate) fn spindle_in_trouble(&self) -> Option<u32> {
        self.signals.spindle_in_trouble()
    }

    /// Whether the chain is open or unknown now.
    pub(crate) fn is_estop_open(&self) -> bool {
        self.signals.is_estop_open()
    }

    /// The present state of the probe.
    pub(crate) fn probe(&self) -> ProbeState {
        self.signals.probe_state()
    }

    /// Whether the machine is at rest in a wait.
    pub(crate) fn is_waiting(&self) -> bool {
        self.signals.is_waiting()
    }

    /// Whether a wait is over and the program may continue.
    pub(crate) fn is_over(&self) -> bool {
        self.signals.is_over()
    }

    /// Continues the program after a wait that is over.
    pub(crate) fn go_on(&mut self) {
        let _was_over = self.signals.take_resume();
    }

    /// After a setpoint: sends the outputs that change with it to bus and trace, before the setpoint itself.
    /// `phase` is the state of the machine without the chain. Returns whether an output has changed.
    pub(crate) fn step(&mut self, setpoint: &Setpoint, phase: Phase) -> bool {
        let phase = if self.estopped { Phase::Fault } else { phase };
        let outputs = self.signals.step(&self.progress.with(setpoint, phase));
        let has_changed = self.record_outputs(setpoint.sequence, &outputs);
        if let Some(bus) = &mut self.bus
            && self.sent != Some(outputs)
        {
            let due = DueOutputs {
                sequence: setpoint.sequence,
                outputs,
            };
            if !self.is_realtime {
                crate::core_loop::wait_until(|| !bus.is_full() || bus.is_abandoned());
            }
            // An image that does not fit is sent with a later setpoint: each message is complete.
            match bus.push(due) {
                Ok(()) => self.sent = Some(outputs),
                Err(_) => self.lost += 1,
            }
        }
        has_changed
    }

    fn record_inputs(&mut self, sequence: u64, sample: &InputImage) {
        let before = std::mem::replace(&mut self.recorded_inputs, *sample);
        if before == *sample {
            return;
        }
        for kind in [SignalKind::Digital, SignalKind::Analog] {
            for number in 0..kind.max() {
                let value = sample.value(kind, number);
                if value != before.value(kind, number) {
                    self.record(SignalChange {
                        sequence,
                        is_output: false,
                        name: SignalName::Signal(kind, number),
                        value,
                    });
                }
            }
        }
        for number in 0..probe_numbers::COUNT {
            let value = sample.probe.value(number);
            if value != before.probe.value(number) {
                self.record(SignalChange {
                    sequence,
                    is_output: false,
                    name: SignalName::Probe(number),
                    value,
                });
            }
        }
        if sample.angle_spindle != before.angle_spindle {
            self.record(SignalChange {
                sequence,
                is_output: false,
                name: SignalName::AngleSpindle,
                value: Some(f64::from(sample.angle_spindle)),
            });
        }
        // Turns come first: the time completes a sample.
        for (name, value, value_before) in [
            (
                AngleValue::Turns,
                sample.angle.map(turns_of),
                before.angle.map(turns_of),
            ),
            (
                AngleValue::Cycle,
                sample.angle.map(cycle_of),
                before.angle.map(cycle_of),
            ),
        ] {
            if value != value_before {
                self.record(SignalChange {
                    sequence,
                    is_output: false,
                    name: SignalName::Angle(name),
                    value,
                });
            }
        }
        for number in 0..MAX_SPINDLES {
            let speed_rpm = sample.speeds_rpm[number as usize];
            if speed_rpm != before.speeds_rpm[number as usize] {
                self.record(SignalChange {
                    sequence,
                    is_output: false,
                    name: SignalName::Speed(number),
                    value: speed_rpm,
                });
            }
        }
        for number in 0..MAX_SPINDLES {
            let state = sample.spindle(number);
            if state != before.spindle(number) {
                self.record(SignalChange {
                    sequence,
                    is_output: false,
                    name: SignalName::Spindle(number),
                    value: state.map(SpindleState::to_number),
                });
            }
        }
    }

    fn record_outputs(&mut self, sequence: u64, outputs: &OutputImage) -> bool {
        let before = std::mem::replace(&mut self.recorded_outputs, *outputs);
        if before == *outputs {
            return false;
        }
        for_each_change(sequence, &before, outputs, |change| self.record(change));
        true
    }

    fn record(&mut self, change: SignalChange) {
        let Some(trace) = &mut self.trace else { return };
        if !self.is_realtime {
            crate::core_loop::wait_until(|| !trace.is_full() || trace.is_abandoned());
        }
        if trace.push(change).is_err() {
            self.lost += 1;
        }
    }
}

const fn turns_of(angle: SpindleAngle) -> f64 {
    angle.turns
}

const fn cycle_of(angle: SpindleAngle) -> f64 {
    angle.cycle
}

/// Calls `tell` for every output that differs.
pub(crate) fn for_each_change(
    sequence: u64,
    before: &OutputImage,
    after: &OutputImage,
    mut tell: impl FnMut(SignalChange),
) {
    let change = |kind, number, value| SignalChange {
        sequence,
        is_output: true,
        name: SignalName::Signal(kind, number),
        value: Some(value),
    };
    for number in 0..MAX_DIGITAL {
        if (before.digital ^ after.digital) >> number & 1 == 1 {
            let on = (after.digital >> number & 1) as f64;
            tell(change(SignalKind::Digital, number, on));
        }
    }
    for number in 0..MAX_ANALOG {
        let value = after.analog[number as usize];
        if before.analog[number as usize] != value {
            tell(change(SignalKind::Analog, number, value));
        }
    }
}

/// Progress of a program in its setpoints.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ProgramProgress {
    first_block: u32,
    /// One of its blocks has begun.
    has_moved: bool,
}

impl ProgramProgress {
    /// For a program whose first block has this number.
    pub(crate) fn new(first_block: u32) -> Self {
        Self {
            first_block,
            has_moved: false,
        }
    }

    /// The progress with this setpoint.
    pub(crate) fn with(&mut self, setpoint: &Setpoint, phase: Phase) -> Progress {
        // Before the first block, the setpoint already has its number.
        self.has_moved |= setpoint.block > self.first_block || setpoint.path_mm > 0.0;
        Progress {
            actions: setpoint.actions,
            blocks: if self.has_moved { setpoint.block + 1 } else { 0 },
            phase,
            x_mm: setpoint.position[0],
        }
    }
}

/// The phase of outputs while a program is in this state.
pub(crate) fn phase_of(state: MotionState) -> Phase {
    match state {
        MotionState::Held => Phase::Held,
        MotionState::Stopped => Phase::Stopped,
        MotionState::Done => Phase::Ended,
        MotionState::Fault => Phase::Fault,
        _ => Phase::Runs,
    }
}
