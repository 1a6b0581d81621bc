//! Recomputes the jobs of a served machine from their recording.

use std::collections::VecDeque;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

use evolvent_machine::{Limits, Machine};
use evolvent_motion::{
    DrivenPath, Excursion, ExcursionEnd, Inputs, MotionState, Setpoint, SetpointGenerator, TransferExecutor,
};
use evolvent_path::{Axes, Jet};
use evolvent_transfer::TransferError;

use crate::corrections::Corrections;
use crate::job::Setup;
use crate::job_start::{ProgramStart, SteeredStart};
use crate::recompute::{RecordedInputs, wait_for_planner};
use crate::serve::{Following, Planning, ProgramJob};
use crate::signal_loop::SignalChange;
use crate::signal_replay::{OutputDifference, SignalReplay};
use crate::switches::{Switched, Switching};

/// Poll interval for the first planned pieces of a job.
const POLL_INTERVAL: Duration = Duration::from_micros(200);

/// Why a job cannot be recomputed.
#[derive(Debug, thiserror::Error)]
pub enum ServedError {
    /// The operating system cannot start a thread.
    #[error("no thread for the planner: {0}")]
    Thread(#[from] io::Error),
    /// The steered motion no longer has a solution.
    #[error("the motion cannot be solved again: {0}")]
    Transfer(#[from] TransferError),
    /// The job does not begin where the axes are.
    #[error("the job does not begin where the axes were")]
    Position,
}

/// The source of motion in a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Moved {
    /// Nothing, or each axis was stopping on its own; with the recorded state.
    ByNothing(MotionState),
    /// A job along a plan.
    ByPlan(RecordedInputs),
    /// A job along a plan is held, and the axes are away from it.
    Away {
        /// Inputs of the plan.
        plan: RecordedInputs,
        /// Whether the motion of the axes received a stop.
        stop: bool,
    },
    /// A jog or homing.
    ByTransfer {
        /// Whether it received a stop.
        stop: bool,
    },
}

enum ActiveJob {
    None,
    Plan {
        planning: Box<Planning>,
        job: Box<Following>,
    },
    TransferExecutor(Box<TransferExecutor>),
}

/// A served machine, recomputed setpoint by setpoint.
pub struct ServedAgain {
    generator: SetpointGenerator,
    limits: Limits,
    period_ns: u64,
    work: ActiveJob,
    /// Outputs and inputs, if the machine has any.
    signals: Option<SignalReplay>,
    corrections: Option<Corrections>,
    /// The driven path of the program, and the excursion from it.
    driven: DrivenPath,
    excursion: Option<Excursion>,
    /// The last setpoint sent to the drives, if known.
    corrected: Option<Jet>,
}

impl ServedAgain {
    /// At rest at the position in the machine file.
    #[must_use]
    pub fn new(limits: Limits, period_ns: u64) -> Self {
        Self {
            generator: SetpointGenerator::new(limits, period_ns, limits.home),
            limits,
            period_ns,
            work: ActiveJob::None,
            signals: None,
            corrections: None,
            driven: DrivenPath::new(period_ns),
            excursion: None,
            corrected: None,
        }
    }

    /// Adds the corrections of this machine.
    #[must_use]
    pub fn with_corrections(mut self, machine: &Machine) -> Self {
        self.corrections = Corrections::new(machine, self.period_ns, self.limits.home);
        self
    }

    /// The last setpoint sent to the drives, if it differs and is known. It depends on the directions in
    /// which the axes moved before, so it is unknown after a gap in the trace.
    #[must_use]
    pub fn corrected(&self) -> Option<&Jet> {
        self.corrected.as_ref()
    }

    /// Adds the machine's outputs and inputs, with the recorded changes in order.
    #[must_use]
    pub fn with_signals(mut self, setup: &Setup, changes: &[SignalChange]) -> Self {
        let settings = &setup.machine.signals;
        let (outputs, inputs) = changes.iter().partition(|change| change.is_output);
        let lead_cycles = setup.machine.lead_cycles(self.period_ns);
        self.signals = Some(SignalReplay::new(
            settings,
            lead_cycles,
            self.period_ns,
            inputs,
            outputs,
        ));
        self
    }

    /// Number of outputs that programs have set differently from the recording, and the first of them.
    #[must_use]
    pub fn output_differences(&self) -> (u64, Option<OutputDifference>) {
        self.signals.as_ref().map_or((0, None), SignalReplay::differences)
    }

    /// Number of the next setpoint.
    #[must_use]
    pub fn sequence(&self) -> u64 {
        self.generator.sequence()
    }

    /// Whether a job is in progress.
    #[must_use]
    pub fn is_at_work(&self) -> bool {
        !matches!(self.work, ActiveJob::None)
    }

    /// Whether the axes are at rest.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        !self.is_at_work() && self.generator.is_at_rest()
    }

    /// Gives the axes these coordinates from here on, with this travel.
    pub fn relocate(&mut self, travel: (Axes, Axes), position: Axes) {
        let limits = self.within(travel);
        if self.generator.position() != position
            && let Some(corrections) = &mut self.corrections
        {
            corrections.relocate(&position);
        }
        self.generator.relocate(limits, position);
    }

    /// Sets the travel of the next job. No effect unless the axes are at rest.
    pub fn begin_within(&mut self, travel: (Axes, Axes)) {
        if self.is_at_rest() {
            let limits = self.within(travel);
            self.generator.relocate(limits, self.generator.position());
        }
    }

    /// Continues at rest at another position; what happened in between is unknown.
    pub fn restart_at(&mut self, travel: (Axes, Axes), sequence: u64, position: Axes, path_mm: f64) {
        self.end_work();
        (self.corrections, self.corrected) = (None, None);
        let limits = self.within(travel);
        self.generator.restart_at(limits, sequence, position, path_mm);
    }

    fn within(&self, (travel_min, travel_max): (Axes, Axes)) -> Limits {
        Limits {
            travel_min,
            travel_max,
            ..self.limits
        }
    }

    /// Starts a program, whose text is in `file`, with the next setpoint. `switched` lists the changes of
    /// switches while it was read.
    ///
    /// # Errors
    /// [`ServedError`].
    pub fn follow(
        &mut self,
        start: &ProgramStart,
        switched: VecDeque<Switched>,
        setup: Setup,
        file: PathBuf,
    ) -> Result<(), ServedError> {
        self.end_work();
        let mut planning = Box::new(Planning::start(ProgramJob {
            file,
            setup,
            feed_override: start.feed_override,
            job: 0,
            number: 0,
            periphery: None,
            switches: start.switches,
            switching: Switching::Recorded(switched),
            numbered_from: start.numbered_from,
            // Blocks are reported as in the recorded run: the line of the end is that of the last block.
            recorder: Some(std::sync::mpsc::channel().0),
            subroutines: String::new(),
            carries_out: false,
            in_two_threads: true,
        })?);
        let mut job = loop {
            if let Some(job) = planning.take_if_ready() {
                break job;
            }
            std::thread::sleep(POLL_INTERVAL);
        };
        if !self.generator.attach(&mut job.motion) {
            return Err(ServedError::Position);
        }
        if let (Some(signals), Some(schedule)) = (&mut self.signals, job.schedule.take()) {
            signals.begin_program(schedule, job.first_block);
        }
        self.work = ActiveJob::Plan { planning, job };
        self.driven.forget();
        Ok(())
    }

    /// Starts this motion, or changes to it, with the next setpoint.
    ///
    /// # Errors
    /// [`ServedError`].
    pub fn steer(&mut self, start: &SteeredStart) -> Result<(), ServedError> {
        let steering = TransferExecutor::new(start.solve(&self.limits)?);
        if matches!(self.work, ActiveJob::Plan { .. }) {
            return self.steer_away(steering, start.is_turn);
        }
        match &mut self.work {
            ActiveJob::TransferExecutor(present) if start.is_turn => {
                if !self.generator.turn(present, &steering) {
                    return Err(ServedError::Position);
                }
            }
            _ => {
                self.end_work();
                if start.is_turn || !self.generator.can_steer(&steering) {
                    return Err(ServedError::Position);
                }
                self.work = ActiveJob::TransferExecutor(Box::new(steering));
            }
        }
        Ok(())
    }

    /// The same in an excursion from a held program.
    fn steer_away(&mut self, steering: TransferExecutor, is_turn: bool) -> Result<(), ServedError> {
        let mut excursion = self.begin_excursion()?;
        let counts = if is_turn {
            excursion.turn(&self.generator, &steering)
        } else {
            excursion.steer(&self.generator, Box::new(steering)).is_ok()
        };
        self.excursion = Some(excursion);
        if counts {
            Ok(())
        } else {
            Err(ServedError::Position)
        }
    }

    /// Starts a motion along the driven path of the held program with the next setpoint: backwards by `back`
    /// block starts, or for 0 forwards to its end.
    ///
    /// # Errors
    /// [`ServedError`].
    pub fn retrace(&mut self, back: u32) -> Result<(), ServedError> {
        let mut excursion = self.begin_excursion()?;
        let counts = excursion.retrace(&self.generator, &mut self.driven, &self.limits, back);
        self.excursion = Some(excursion);
        if counts {
            Ok(())
        } else {
            Err(ServedError::Position)
        }
    }

    /// Takes the present excursion, or begins one.
    fn begin_excursion(&mut self) -> Result<Excursion, ServedError> {
        match (self.excursion.take(), &self.work) {
            (Some(excursion), _) => Ok(excursion),
            (None, ActiveJob::Plan { job, .. }) => Excursion::begin(&job.motion).ok_or(ServedError::Position),
            _ => Err(ServedError::Position),
        }
    }

    /// Computes the next setpoint; `feed_override` is the one that it shows if nothing follows a plan. `None`
    /// if the source of motion is unknown here.
    pub fn step(&mut self, moved: &Moved, feed_override: f64) -> Option<Setpoint> {
        let sequence = self.generator.sequence();
        if let Some(signals) = &mut self.signals {
            signals.apply_inputs(sequence);
            if !matches!(moved, Moved::ByPlan(_) | Moved::Away { .. }) {
                let _of_no_program = signals.take_probe();
            }
        }
        let setpoint = self.move_axes(moved, feed_override);
        if let (Some(signals), Some(setpoint)) = (&mut self.signals, &setpoint)
            && !matches!(moved, Moved::ByPlan(_) | Moved::Away { .. })
        {
            let _has_changed = signals.step(setpoint, false);
        }
        self.corrected = None;
        if let (Some(corrections), Some(setpoint)) = (&mut self.corrections, &setpoint) {
            let inputs = self.signals.as_ref().map(SignalReplay::inputs);
            self.corrected = Some(corrections.step(setpoint, inputs));
        }
        setpoint
    }

    fn move_axes(&mut self, moved: &Moved, feed_override: f64) -> Option<Setpoint> {
        match (moved, &mut self.work) {
            (Moved::ByNothing(state), work) => {
                if !matches!(work, ActiveJob::None) || !self.generator.is_at_rest() {
                    // No effect if the axes are already stopping on their own.
                    self.generator.emergency();
                    self.end_work();
                }
                self.generator.set_override(feed_override);
                Some(self.generator.rest(*state))
            }
            (Moved::ByPlan(recorded), ActiveJob::Plan { job, .. }) => {
                let setpoint = follow(job, recorded, self.signals.as_mut());
                self.generator.follow(&job.motion, &setpoint);
                let is_over = job.motion.is_over() || job.motion.is_stuck(&mut job.queue);
                let mut shown = setpoint;
                if shown.state == MotionState::Done && job.flags.has_failed() {
                    shown.state = MotionState::Stopped;
                }
                let has_changed = match &mut self.signals {
                    Some(signals) => signals.step(&shown, !recorded.outputs_safe),
                    None => false,
                };
                job.motion.note_driven(&mut self.driven, &setpoint, has_changed);
                if is_over {
                    self.finish();
                }
                Some(shown)
            }
            (Moved::Away { plan, stop }, ActiveJob::Plan { .. }) => self.move_away(plan, *stop),
            (Moved::ByTransfer { stop }, ActiveJob::TransferExecutor(steering)) => {
                if *stop {
                    steering.stop();
                }
                self.generator.set_override(feed_override);
                let setpoint = self.generator.steer(steering);
                if matches!(setpoint.state, MotionState::Done | MotionState::Stopped)
                    || self.generator.is_quick_stopping()
                {
                    self.finish();
                }
                Some(setpoint)
            }
            _ => None,
        }
    }

    /// Computes one setpoint of an excursion.
    fn move_away(&mut self, recorded: &RecordedInputs, stop: bool) -> Option<Setpoint> {
        let (ActiveJob::Plan { job, .. }, Some(mut excursion)) = (&mut self.work, self.excursion.take())
        else {
            return None;
        };
        if stop {
            excursion.stop();
        }
        let plan = follow(job, recorded, self.signals.as_mut());
        let (setpoint, ended) = excursion.step(&mut self.generator, &mut self.driven, &plan);
        if ended.is_some() {
            drop(excursion.take_spent());
        }
        if let Some(signals) = &mut self.signals {
            let _has_changed = signals.step(&plan, !recorded.outputs_safe);
        }
        if job.motion.is_over() || ended == Some(ExcursionEnd::Fault) {
            self.finish();
        } else if !excursion.give_back(&self.generator, &mut job.motion) {
            self.excursion = Some(excursion);
        }
        Some(setpoint)
    }

    fn finish(&mut self) {
        self.end_work();
        if !self.generator.is_quick_stopping() {
            self.generator.end();
        }
    }

    fn end_work(&mut self) {
        self.excursion = None;
        if let ActiveJob::Plan { mut planning, job } = std::mem::replace(&mut self.work, ActiveJob::None) {
            planning.abandon();
            drop(job);
            if let Some(signals) = &mut self.signals {
                // A planner that waits for an input sees that none is reported any more.
                signals.end_program();
            }
            while planning.take_result().is_none() {
                std::thread::sleep(POLL_INTERVAL);
            }
        }
    }

    /// The control period.
    #[must_use]
    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }
}

fn follow(
    job: &mut Following,
    recorded: &RecordedInputs,
    mut signals: Option<&mut SignalReplay>,
) -> Setpoint {
    let mut inputs: Inputs = recorded.inputs;
    let (motion, queue) = (&mut job.motion, &mut job.queue);
    wait_for_planner(|| motion.is_ready(queue) || (inputs.stop && motion.is_at_rest()));
    if let Some(signals) = &mut signals {
        inputs.probe = signals.take_probe();
        inputs.spindle = signals.spindle_at(motion.next_sequence());
    }
    let at_wait = signals.as_ref().is_some_and(|signals| signals.is_waiting());
    if let Some(signals) = &signals {
        inputs.resume = signals.resumes(inputs.resume, motion, queue);
    }
    let before = motion.plan_step();
    let setpoint = motion.replay_step(&inputs, queue, recorded.lag);
    if let Some(signals) = &mut signals
        && at_wait
        && inputs.resume
        && motion.plan_step() != before
    {
        signals.go_on();
    }
    setpoint
}
