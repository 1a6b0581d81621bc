//! Recomputes a run from its recording.

use std::io;
use std::iter::Peekable;
use std::path::Path;
use std::slice;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use evolvent_motion::{
    Extremes, Inputs, MotionState, PathExecutor, PlanConsumer, PlannerLag, Setpoint, flags, plan_queue,
};
use evolvent_path::Jet;
use evolvent_signals::{InputImage, OutputImage, Phase, ScheduleConsumer, Signals, schedule};

use crate::corrections::Corrections;
use crate::feeder::Feeder;
use crate::job::Setup;
use crate::refusal::ProgramError;
use crate::signal_loop::{ProgramProgress, SignalChange, for_each_change, phase_of};
use crate::spindle_rundown::rest_after;
use crate::stages::Stages;

/// Number of polls before a waiting thread sleeps, and the duration of the sleep: spinning would take the
/// core from the planner.
const LOOKS: u32 = 64;
const PATIENCE: Duration = Duration::from_micros(50);
/// How long the planner sleeps when the queue is full.
const PLANNER_NAP: Duration = Duration::from_micros(100);

/// The kind of computer, as named in traces.
#[must_use]
pub fn platform() -> String {
    format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS)
}

/// Recorded inputs of one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordedInputs {
    /// The cycle's inputs.
    pub inputs: Inputs,
    /// How late the planner was.
    pub lag: PlannerLag,
    /// Whether the run continued after the end of its program, for a spindle that slowed down.
    pub runs_on: bool,
    /// Whether a fault had set the outputs to their safe values.
    pub outputs_safe: bool,
}

/// Result of recomputing a run.
#[derive(Debug)]
pub struct Recomputed {
    /// Number of setpoints computed.
    pub cycles: u64,
    /// The state of the last setpoint.
    pub state: MotionState,
    /// The error of the program, if any; it was planned up to there.
    pub program: Result<(), ProgramError>,
    /// Largest distance of blends from the programmed path, mm.
    pub deviation_mm: f64,
    /// Largest magnitudes that the guard measured.
    pub extremes: Extremes,
    /// Changes of outputs, in order.
    pub outputs: Vec<SignalChange>,
}

/// Waits for the planner, which may need all cores.
pub(crate) fn wait_for_planner(mut ready: impl FnMut() -> bool) {
    let mut polls = 0;
    while !ready() {
        polls += 1;
        if polls < LOOKS {
            std::hint::spin_loop();
        } else {
            thread::sleep(PATIENCE);
        }
    }
}

/// Recomputes a run cycle by cycle, as with the virtual clock. `inputs` returns the recorded inputs of each
/// cycle, or `None` to end. `changes` are the recorded changes of digital and analog inputs, in order.
/// `observe` receives every setpoint, and the one sent to the drives if it differs, and returns whether to
/// continue.
///
/// The setpoints are those of the recorded run, bit for bit, if this is the same version on the same kind of
/// processor. This holds however late the planner was (ADR 71), except that a classic planner which was
/// starved cannot be reproduced, because its progress is not recorded.
///
/// # Errors
/// The operating system gives no thread.
pub fn recompute(
    program: &Path,
    setup: &Setup,
    feed_override: f64,
    optional_stop: bool,
    changes: &[SignalChange],
    mut inputs: impl FnMut(u64) -> Option<RecordedInputs>,
    mut observe: impl FnMut(&Setpoint, Option<&Jet>) -> bool,
) -> io::Result<Recomputed> {
    let limits = setup.machine.limits();
    let abandoned = Arc::new(AtomicBool::new(false));
    let failed = AtomicBool::new(false);
    let waiting = Arc::clone(&abandoned);
    let (mut producer, queue) = plan_queue(move || {
        thread::sleep(PLANNER_NAP);
        !waiting.load(Ordering::Acquire)
    });
    let (turnings, probings) = (producer.take_processes(), producer.take_probings());
    let threadings = producer.take_threadings();
    let motion = PathExecutor::new(limits, setup.period_ns, limits.home).planned_for(feed_override);
    let planner = Stages::two(setup, feed_override, producer)?;
    let (scheduler, consumer) = schedule();
    let mut again = CycleReplay::new(setup, motion, queue, consumer, changes);
    thread::scope(|scope| {
        let failing = &failed;
        let feeder = thread::Builder::new()
            .name("planner".into())
            .spawn_scoped(scope, move || {
                // With blocks, as in every recorded run: the line of the end is that of the last block.
                Feeder::new(program, setup, planner, Vec::new(), true, optional_stop)
                    .turning_by(turnings)
                    .probing_by(probings)
                    .threading_by(threadings)
                    .signalling_by(Some(scheduler))
                    .feed(program, || failing.store(true, Ordering::Release))
            })?;
        while let Some(recorded) = inputs(again.cycles) {
            let setpoint = again.step(recorded, &failed);
            let corrected = again.correct(&setpoint);
            if !observe(&setpoint, corrected.as_ref()) || again.is_over() {
                break;
            }
        }
        abandoned.store(true, Ordering::Release);
        // Tells the planner that its plan is no longer taken.
        let cycles = again.end();
        // A panic of a thread is a bug; it is passed on.
        let (feed, program) = feeder
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        Ok(Recomputed {
            cycles: cycles.count,
            state: cycles.state,
            program: program.map(|_left| ()),
            deviation_mm: feed.deviation_mm,
            extremes: cycles.extremes,
            outputs: cycles.outputs,
        })
    })
}

/// The cycles of a recorded run, recomputed: motion and signals of each.
struct CycleReplay<'a> {
    motion: PathExecutor,
    queue: PlanConsumer,
    signals: Signals,
    /// Present if the machine file describes errors of the machine.
    corrections: Option<Corrections>,
    /// Recorded changes of inputs that are still to come.
    changes: Peekable<slice::Iter<'a, SignalChange>>,
    image: InputImage,
    /// The outputs of the last cycle.
    sent: OutputImage,
    of_program: ProgramProgress,
    estopped: bool,
    /// The next plan never arrives.
    is_stuck: bool,
    /// The run continued after the last setpoint although its program had ended.
    runs_on: bool,
    last: Option<Setpoint>,
    cycles: u64,
    state: MotionState,
    outputs: Vec<SignalChange>,
}

/// Result of the recomputed cycles.
struct CyclesEnded {
    count: u64,
    state: MotionState,
    extremes: Extremes,
    outputs: Vec<SignalChange>,
}

impl<'a> CycleReplay<'a> {
    fn new(
        setup: &Setup,
        motion: PathExecutor,
        queue: PlanConsumer,
        scheduled: ScheduleConsumer,
        changes: &'a [SignalChange],
    ) -> Self {
        let mut signals = Signals::new(
            &setup.machine.signals,
            setup.machine.lead_cycles(setup.period_ns),
            setup.period_ns,
        );
        let _none = signals.begin_program(scheduled);
        Self {
            motion,
            queue,
            sent: *signals.safe(),
            signals,
            corrections: Corrections::new(&setup.machine, setup.period_ns, setup.machine.limits().home),
            changes: changes.iter().peekable(),
            image: InputImage::default(),
            of_program: ProgramProgress::default(),
            estopped: false,
            is_stuck: false,
            runs_on: false,
            last: None,
            cycles: 0,
            state: MotionState::Idle,
            outputs: Vec::new(),
        }
    }

    /// Computes the next setpoint and the outputs that change with it. `failed`: the planner has found an
    /// error.
    fn step(&mut self, recorded: RecordedInputs, failed: &AtomicBool) -> Setpoint {
        let RecordedInputs {
            mut inputs,
            lag,
            runs_on,
            ..
        } = recorded;
        if self.runs_on
            && let Some(last) = self.last
        {
            return self.rest(&last, inputs, runs_on);
        }
        let (motion, queue) = (&mut self.motion, &mut self.queue);
        wait_for_planner(|| motion.is_ready(queue) || (inputs.stop && motion.is_at_rest()));
        self.enter_signals(&mut inputs);
        let at_wait = self.signals.is_waiting();
        if at_wait && inputs.resume {
            inputs.resume = self.can_resume();
        }
        let before = self.motion.plan_step();
        let mut setpoint = self.motion.replay_step(&inputs, &mut self.queue, lag);
        if at_wait && inputs.resume && self.motion.plan_step() != before {
            let _was_over = self.signals.take_resume();
        }
        if setpoint.state == MotionState::Done && failed.load(Ordering::Acquire) {
            setpoint.state = MotionState::Stopped;
        }
        self.is_stuck = self.motion.is_stuck(&mut self.queue);
        if self.is_stuck {
            setpoint.state = MotionState::Fault;
        }
        self.step_outputs(&setpoint);
        self.leave(setpoint, runs_on)
    }

    /// A setpoint after the end of the program, while a spindle slowed down.
    fn rest(&mut self, last: &Setpoint, mut inputs: Inputs, runs_on: bool) -> Setpoint {
        self.enter_signals(&mut inputs);
        let setpoint = rest_after(last);
        self.step_outputs(&setpoint);
        self.leave(setpoint, runs_on)
    }

    fn leave(&mut self, mut setpoint: Setpoint, runs_on: bool) -> Setpoint {
        // Only a run at rest can continue after its program.
        self.runs_on = runs_on && setpoint.flags & flags::LAST != 0;
        if self.runs_on {
            setpoint.flags &= !flags::LAST;
        }
        self.cycles += 1;
        self.state = setpoint.state;
        self.last = Some(setpoint);
        setpoint
    }

    /// Applies the recorded changes up to this cycle to its inputs.
    fn enter_signals(&mut self, inputs: &mut Inputs) {
        while let Some(change) = self.changes.next_if(|change| change.sequence <= self.cycles) {
            change.enter(&mut self.image);
            self.signals.observe(&self.image);
        }
        inputs.probe = self.signals.take_probe();
        inputs.spindle = self.signals.spindle_at(self.cycles);
        // As in the run: before the first inputs the chain does not count as open.
        self.estopped |= self.signals.is_estop_open();
    }

    /// Whether the wait for an input, which the recorded run left here, is over. A trace that contradicts
    /// this differs; nothing waits for it.
    fn can_resume(&mut self) -> bool {
        let is_over = self.signals.is_over();
        if is_over {
            let (motion, queue) = (&mut self.motion, &mut self.queue);
            wait_for_planner(|| motion.can_leave_wait(queue) || queue.is_abandoned());
        }
        is_over
    }

    fn step_outputs(&mut self, setpoint: &Setpoint) {
        let phase = if self.estopped {
            Phase::Fault
        } else {
            phase_of(setpoint.state)
        };
        let image = self.signals.step(&self.of_program.with(setpoint, phase));
        let outputs = &mut self.outputs;
        for_each_change(setpoint.sequence, &self.sent, &image, |change| {
            outputs.push(change);
        });
        self.sent = image;
    }

    /// The setpoint sent to the drives, if it differs.
    fn correct(&mut self, setpoint: &Setpoint) -> Option<Jet> {
        let inputs = self.signals.inputs();
        let corrections = self.corrections.as_mut()?;
        Some(corrections.step(setpoint, Some(inputs)))
    }

    fn is_over(&self) -> bool {
        (self.motion.is_over() && !self.runs_on) || self.is_stuck
    }

    /// Drops the ends of the planner's queues.
    fn end(self) -> CyclesEnded {
        CyclesEnded {
            count: self.cycles,
            state: self.state,
            extremes: *self.motion.extremes(),
            outputs: self.outputs,
        }
    }
}
