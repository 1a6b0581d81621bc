//! The signals of a served machine in recomputation: recorded inputs for the waits of its programs, and a
//! comparison of the outputs.

use std::collections::VecDeque;

use evolvent_machine::{MAX_ANALOG, MAX_DIGITAL, SignalKind, SignalSettings};
use evolvent_motion::{MotionState, PathExecutor, PlanConsumer, Setpoint};
use evolvent_signals::{InputImage, OutputImage, Phase, ProbeInput, ScheduleConsumer, Signals, SpindleInput};

use crate::recompute::wait_for_planner;
use crate::signal_loop::{ProgramProgress, SignalChange, SignalName, phase_of};

/// An output that a program has set differently from the recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputDifference {
    /// The first setpoint with the difference.
    pub sequence: u64,
    /// Digital or analog.
    pub kind: SignalKind,
    /// Number of the output.
    pub number: u32,
    /// The recorded value.
    pub recorded: f64,
    /// The recomputed value.
    pub recomputed: f64,
}

/// Inputs, waits and outputs of a served machine, cycle by cycle.
#[derive(Debug)]
pub(crate) struct SignalReplay {
    signals: Signals,
    inputs: VecDeque<SignalChange>,
    outputs: VecDeque<SignalChange>,
    image: InputImage,
    /// The recorded outputs of the last setpoint.
    recorded: OutputImage,
    progress: ProgramProgress,
    differences: u64,
    first: Option<OutputDifference>,
}

impl SignalReplay {
    /// With the recorded changes, in order.
    pub(crate) fn new(
        settings: &SignalSettings,
        lead_cycles: u32,
        period_ns: u64,
        inputs: VecDeque<SignalChange>,
        outputs: VecDeque<SignalChange>,
    ) -> Self {
        let signals = Signals::new(settings, lead_cycles, period_ns);
        Self {
            recorded: *signals.safe(),
            signals,
            inputs,
            outputs,
            image: InputImage::default(),
            progress: ProgramProgress::default(),
            differences: 0,
            first: None,
        }
    }

    /// Begins a program with the present outputs.
    pub(crate) fn begin_program(&mut self, schedule: ScheduleConsumer, first_block: u32) {
        self.progress = ProgramProgress::new(first_block);
        self.signals.go_on_with(&self.recorded);
        let _before = self.signals.begin_program(schedule);
    }

    /// Ends the program.
    pub(crate) fn end_program(&mut self) {
        let _spent = self.signals.end_program();
    }

    /// Applies the inputs for a setpoint.
    pub(crate) fn apply_inputs(&mut self, sequence: u64) {
        while let Some(change) = pop_due(&mut self.inputs, sequence) {
            change.enter(&mut self.image);
            self.signals.observe(&self.image);
        }
    }

    /// Whether the program continues with this cycle; `recorded` is the recorded answer. Outside of waits
    /// only the recording knows it.
    pub(crate) fn resumes(&self, recorded: bool, motion: &PathExecutor, queue: &mut PlanConsumer) -> bool {
        if !self.signals.is_waiting() || !recorded {
            return recorded;
        }
        // A trace that contradicts this differs; nothing waits for it.
        if self.signals.is_over() {
            wait_for_planner(|| motion.can_leave_wait(queue) || queue.is_abandoned());
        }
        self.signals.is_over()
    }

    /// The probe's input for the next setpoint.
    pub(crate) fn take_probe(&mut self) -> ProbeInput {
        self.signals.take_probe()
    }

    /// The rotation of the spindle that the motion follows, at the due time of this setpoint.
    pub(crate) fn spindle_at(&self, sequence: u64) -> SpindleInput {
        self.signals.spindle_at(sequence)
    }

    /// Whether the machine rests for a wait.
    pub(crate) fn inputs(&self) -> &InputImage {
        self.signals.inputs()
    }

    pub(crate) fn is_waiting(&self) -> bool {
        self.signals.is_waiting()
    }

    /// Continues after a wait.
    pub(crate) fn go_on(&mut self) {
        let _was_over = self.signals.take_resume();
    }

    /// After a setpoint. `are_programmed`: the outputs are those of a program, and are compared; those that a
    /// fault made safe are not. Returns whether an output had changed when it was recorded.
    pub(crate) fn step(&mut self, setpoint: &Setpoint, are_programmed: bool) -> bool {
        let sequence = setpoint.sequence;
        let mut has_changed = false;
        while let Some(change) = pop_due(&mut self.outputs, sequence) {
            has_changed = true;
            if let SignalName::Signal(kind, number) = change.name {
                self.recorded.set(kind, number, change.value.unwrap_or(0.0));
            }
        }
        // In traces of version 0.2 only the state tells of a fault, one cycle later.
        if !are_programmed || setpoint.state == MotionState::Fault {
            return has_changed;
        }
        let phase: Phase = phase_of(setpoint.state);
        let image = self.signals.step(&self.progress.with(setpoint, phase));
        if image == self.recorded {
            return has_changed;
        }
        let digital = (0..MAX_DIGITAL).map(|number| (SignalKind::Digital, number));
        let analog = (0..MAX_ANALOG).map(|number| (SignalKind::Analog, number));
        for (kind, number) in digital.chain(analog) {
            let (recorded, recomputed) = (self.recorded.value(kind, number), image.value(kind, number));
            if recorded != recomputed {
                self.differences += 1;
                self.first.get_or_insert(OutputDifference {
                    sequence,
                    kind,
                    number,
                    recorded,
                    recomputed,
                });
            }
        }
        // Each difference counts once.
        self.signals.go_on_with(&self.recorded);
        has_changed
    }

    /// Number of values that differed, and the first of them.
    pub(crate) fn differences(&self) -> (u64, Option<OutputDifference>) {
        (self.differences, self.first)
    }
}

/// The next change that is due by this setpoint.
fn pop_due(changes: &mut VecDeque<SignalChange>, sequence: u64) -> Option<SignalChange> {
    if changes.front()?.sequence > sequence {
        return None;
    }
    changes.pop_front()
}
