//! A run computed again from what was recorded of it.

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use evolvent_motion::{Extremes, Inputs, PathExecutor, Setpoint, State, plan_queue};
use evolvent_path::Jet;
use evolvent_signals::{InputImage, Phase, Signals, schedule};

use crate::corrections::Corrections;
use crate::feeder::Feeder;
use crate::job::Setup;
use crate::refusal::ProgramError;
use crate::signal_loop::{ProgramProgress, SignalChange, for_each_change, phase_of};
use crate::stages::Stages;

/// Looks at the plan before the one who waits sleeps, and for how long: spinning would take the core from the planner.
const LOOKS: u32 = 64;
const PATIENCE: Duration = Duration::from_micros(50);
/// How long the planner sleeps when the queue is full.
const PLANNER_NAP: Duration = Duration::from_micros(100);

/// The kind of computer that this is, as traces name it.
#[must_use]
pub fn platform() -> String {
    format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS)
}

/// What came in at one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordedInputs {
    /// The cycle's inputs.
    pub inputs: Inputs,
    /// Whether the cycle waited for the planner, or drove on as planned before, for want of an answer.
    pub waited: bool,
    /// Whether an answer of the planner came to nothing.
    pub refused: bool,
}

/// What computing a run again came to.
#[derive(Debug)]
pub struct Recomputed {
    /// Setpoints computed.
    pub cycles: u64,
    /// The state of the last.
    pub state: State,
    /// What was wrong with the program: it was planned up to there.
    pub program: Result<(), ProgramError>,
    /// Largest distance of blends from the programmed path, mm.
    pub deviation_mm: f64,
    /// Largest magnitudes that the guard measured.
    pub extremes: Extremes,
    /// Outputs that have changed, in order.
    pub outputs: Vec<SignalChange>,
}

/// Waits for the planner, which may need every core there is.
pub(crate) fn wait_for_planner(mut ready: impl FnMut() -> bool) {
    let mut looks = 0;
    while !ready() {
        looks += 1;
        if looks < LOOKS {
            std::hint::spin_loop();
        } else {
            thread::sleep(PATIENCE);
        }
    }
}

/// Computes a run again, cycle by cycle, as the virtual clock does. `inputs` gives what came in at each cycle, `None`
/// to end; `changes` are the recorded changes of digital and analog inputs, in order; `observe` sees every setpoint, with what the drives are sent
/// where that is something else, and says whether to go on.
///
/// The setpoints are those of the recorded run, bit for bit, if this program is the same version for the same kind of
/// processor, unless the recorded run was starved: how much of a plan a real-time planner had ready is not recorded.
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
    let (mut producer, mut queue) = plan_queue(move || {
        thread::sleep(PLANNER_NAP);
        !waiting.load(Ordering::Acquire)
    });
    let (turnings, probings) = (producer.take_turnings(), producer.take_probings());
    let threadings = producer.take_threadings();
    let mut motion = PathExecutor::new(limits, setup.period_ns, limits.home).planned_for(feed_override);
    let mut corrections = Corrections::new(&setup.machine, setup.period_ns, limits.home);
    let planner = Stages::two(setup, feed_override, producer)?;
    let settings = &setup.machine.signals;
    let (scheduler, consumer) = schedule();
    let mut signals = Signals::new(
        settings,
        setup.machine.lead_cycles(setup.period_ns),
        setup.period_ns,
    );
    let _none = signals.begin_program(consumer);
    let mut changes = changes.iter().peekable();
    let (mut image, mut sent) = (InputImage::default(), *signals.safe());
    let (mut of_program, mut estopped) = (ProgramProgress::default(), false);
    let mut outputs = Vec::new();
    thread::scope(|scope| {
        let failing = &failed;
        let feeder = thread::Builder::new()
            .name("planner".into())
            .spawn_scoped(scope, move || {
                // With blocks, as every recorded run: the line of the end is the last block's.
                Feeder::new(program, setup, planner, Vec::new(), true, optional_stop)
                    .turning_by(turnings)
                    .probing_by(probings)
                    .threading_by(threadings)
                    .signalling_by(Some(scheduler))
                    .feed(program, || failing.store(true, Ordering::Release))
            })?;
        let mut cycles = 0;
        let mut state = State::Idle;
        while let Some(RecordedInputs {
            mut inputs,
            waited,
            refused,
        }) = inputs(cycles)
        {
            wait_for_planner(|| motion.is_ready(&mut queue) || (inputs.stop && motion.is_at_rest()));
            while let Some(change) = changes.next_if(|change| change.sequence <= cycles) {
                change.enter(&mut image);
                signals.see(&image);
            }
            inputs.probe = signals.take_probe();
            inputs.spindle = signals.spindle_at(cycles);
            // As in the run: before the first inputs the chain is none that is open.
            estopped |= signals.is_estop_open();
            let at_wait = signals.is_waiting();
            if at_wait && inputs.resume {
                // A trace that says otherwise differs; nobody hangs for it.
                inputs.resume = signals.is_over();
                if inputs.resume {
                    wait_for_planner(|| motion.can_leave_wait(&mut queue) || queue.is_abandoned());
                }
            }
            motion.replay_starved(waited);
            motion.refuse_plan(refused);
            let before = motion.plan_step();
            let mut setpoint = motion.step(&inputs, &mut queue);
            if at_wait && inputs.resume && motion.plan_step() != before {
                let _was_over = signals.take_resume();
            }
            if setpoint.state == State::Done && failed.load(Ordering::Acquire) {
                setpoint.state = State::Stopped;
            }
            let is_stuck = motion.is_stuck(&mut queue);
            if is_stuck {
                setpoint.state = State::Fault;
            }
            let phase = if estopped {
                Phase::Fault
            } else {
                phase_of(setpoint.state)
            };
            let image = signals.step(&of_program.with(&setpoint, phase));
            for_each_change(setpoint.sequence, &sent, &image, |change| outputs.push(change));
            sent = image;
            cycles += 1;
            state = setpoint.state;
            let corrected =
                (corrections.as_mut()).map(|corrections| corrections.step(&setpoint, Some(signals.inputs())));
            if !observe(&setpoint, corrected.as_ref()) || motion.is_over() || is_stuck {
                break;
            }
        }
        abandoned.store(true, Ordering::Release);
        // The planner sees that nobody takes its plan any more.
        drop(queue);
        drop(signals);
        // A panic of a thread is a bug; it is passed on.
        let (feed, program) = feeder
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        Ok(Recomputed {
            cycles,
            state,
            program: program.map(|_left| ()),
            deviation_mm: feed.deviation_mm,
            extremes: *motion.extremes(),
            outputs,
        })
    })
}
