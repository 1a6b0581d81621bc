//! One run: starts the threads, joins them, and sums up.

use std::sync::Arc;
use std::sync::mpsc;
use std::thread;
use std::time::{SystemTime, UNIX_EPOCH};

use evolvent_control::Alarm;
use evolvent_machine::{FeedbackMode, ToolChange};
use evolvent_motion::{Setpoint, plan_queue};
use evolvent_trace::RecordError;
use evolvent_turning::SimulatedProcess;

use crate::feeder::FeedReport;
use crate::job::{Clock, Job};
use crate::memory::ProgramMemory;
use crate::observer::{LookingOn, RunObserver};
use crate::program_cycle::ObservedCycle;
use crate::publish_report::PublishReport;
use crate::queues::{optional_ring, queue_length};
use crate::recording::{Closing, RecordReport, RecorderLines};
use crate::refusal::ProgramError;
use crate::run_report::RunReport;
use crate::run_threads::{CycleEnds, Fed, PLANNER_NAP, PlannerEnds, RunThreads};
use crate::shared::Controls;
use crate::signal_ends::SignalEnds;
use crate::start_error::StartError;
use crate::summary::{Outcome, Summary, late_for_nobody};

/// Result of a run.
#[derive(Debug)]
pub struct RunOutcome {
    /// The summary.
    pub summary: Summary,
    /// The error of the program, if any; it was run up to there.
    pub program: Result<(), ProgramError>,
    /// The error of the trace, if any.
    pub trace_error: Option<RecordError>,
    /// The fault that stopped the run, if any.
    pub fault: Option<String>,
    /// The simulated workpiece after the run, if there is one.
    pub process: Option<SimulatedProcess>,
    /// Tools and parameters after the program, if it was read to its end.
    pub left: Option<ProgramMemory>,
}

impl RunOutcome {
    fn take_record(&mut self, record: RecordReport) {
        let summary = &mut self.summary;
        summary.dropped_records += record.lost;
        match record.result {
            Ok(path) => summary.trace = Some(path.display().to_string()),
            Err(error) => {
                summary.notes.push(error.to_string());
                self.trace_error = Some(error);
            }
        }
    }
}

/// Runs a job to its end. `observe` sees every setpoint, on the cycle's thread: for offline use only.
///
/// # Errors
/// The run could not be started; nothing has moved.
pub fn run(
    job: &Job,
    controls: &Arc<Controls>,
    observer: &mut dyn RunObserver,
    mut observe: impl FnMut(&Setpoint) + Send,
) -> Result<RunOutcome, StartError> {
    run_observed(job, controls, observer, |cycle| observe(cycle.setpoint))
}

/// Like [`run`]; `observe` also receives turning cycles and the simulated workpiece.
///
/// # Errors
/// The run could not be started; nothing has moved.
pub fn run_observed(
    job: &Job,
    controls: &Arc<Controls>,
    observer: &mut dyn RunObserver,
    observe: impl FnMut(&ObservedCycle<'_>) + Send,
) -> Result<RunOutcome, StartError> {
    refuse_what_cannot_run(job)?;
    let setup = &job.setup;
    let mut notes = Vec::new();
    thread::scope(|scope| {
        let length = queue_length(setup.rate_hz());
        let (to_trace, recorded_cycles) = optional_ring(job.trace.is_some(), length);
        let (to_bus, setpoints) = optional_ring(job.bus, length);
        let signals = SignalEnds::of_run(job, length);
        let (periphery, planned_periphery) = mpsc::channel();
        let (onlooker, planned_blocks) = mpsc::channel();
        let mut threads = RunThreads {
            scope,
            job,
            controls,
            observer,
            notes: &mut notes,
            start_unix_ns: unix_ns(),
        };

        // The bus is opened first: what fails should fail before anything is planned.
        let publisher = setpoints
            .map(|setpoints| {
                threads.start_publisher(setpoints, signals.port, planned_periphery, planned_blocks)
            })
            .transpose()?;
        let (news, notices) = mpsc::channel();
        let mut listeners = vec![news];
        let (recorder_lines, recorded) = RecorderLines::new();
        let recorder = match (&job.trace, recorded_cycles) {
            (Some(path), Some(cycles)) => {
                listeners.push(recorded.news);
                Some(threads.start_recorder(path, cycles, signals.recorder, recorder_lines)?)
            }
            _ => None,
        };
        let waiting = Arc::clone(controls);
        let (plan_producer, plan_consumer) = plan_queue(move || {
            thread::sleep(PLANNER_NAP);
            !waiting.is_abandoned()
        });
        let (carrier, to_carrier, commands) = match threads.start_carrier(listeners.clone())? {
            None => (None, None, None),
            Some(carrier) => (
                Some(carrier.thread),
                Some(carrier.planner),
                Some(carrier.commands),
            ),
        };
        let planner = threads.start_planner(PlannerEnds {
            plan: plan_producer,
            scheduler: signals.scheduler,
            periphery: job.bus.then_some(periphery),
            onlooker: job.bus.then_some(onlooker),
            listeners,
            with_blocks: recorder.is_some(),
            carrier: to_carrier,
        })?;
        let cycle = threads.start_cycle(
            CycleEnds {
                plan: plan_consumer,
                signals: signals.cycle,
                commands,
                bus: to_bus,
                trace: to_trace,
            },
            observe,
        )?;
        let mut looking_on = LookingOn::new(job, controls, &notices, &recorded.failures);
        looking_on.until(observer, || cycle.is_finished());

        let ended = Ended {
            report: join(cycle),
            fed: join(planner),
            not_carried_out: carrier.and_then(join),
            published: publisher.map(join).unwrap_or_default(),
        };
        // Events that the other threads sent at their end.
        looking_on.until(observer, || true);
        notes.extend(looking_on.drives_note().map(str::to_owned));
        let (mut outcome, alarm) = ended.sum_up(job, observer, notes);
        if let Some(recorder) = recorder {
            let _gone = recorded.closing.send(Closing {
                summary: outcome.summary.to_metadata(),
                alarm,
            });
            outcome.take_record(join(recorder));
        }
        Ok(outcome)
    })
}

/// Results of all threads except the recorder, which waits for the summary.
struct Ended {
    report: RunReport,
    fed: Fed,
    /// The reason why a user-defined M code was not carried out.
    not_carried_out: Option<String>,
    published: PublishReport,
}

impl Ended {
    /// The outcome without the trace, and the alarm that ended the run early.
    fn sum_up(
        self,
        job: &Job,
        observer: &mut dyn RunObserver,
        mut notes: Vec<String>,
    ) -> (RunOutcome, Option<(Alarm, String)>) {
        let (feed, program) = self.fed;
        let (report, published) = (self.report, self.published);
        for text in published.refusal_notes().chain(notes_of(job, &report, &feed)) {
            observer.note(&text);
            notes.push(text);
        }
        let fault = report
            .fault()
            .or_else(|| self.not_carried_out.map(|text| (Alarm::UserCommand, text)));
        let alarm = match (&fault, &program) {
            (Some((alarm, text)), _) => Some((*alarm, text.clone())),
            (None, Err(error)) if report.now.program_failed => Some((Alarm::Program, error.to_string())),
            _ => None,
        };
        // Without the bus only the cycle itself counts late setpoints.
        let late = published.late.max(report.counts.late_cycles);
        let mut summary = report.summarise(job, &feed, late, notes);
        summary.dropped_setpoints += published.failed;
        summary.listeners = published.listeners as u64;
        if summary.late_cycles > 0 && summary.listeners == 0 {
            let text = late_for_nobody(summary.late_cycles);
            observer.note(&text);
            summary.notes.push(text);
        }
        if matches!(alarm, Some((Alarm::UserCommand, _))) {
            summary.outcome = Outcome::Failed;
        }
        summary.alarm = alarm.as_ref().map(|(alarm, _)| alarm.number());
        summary.error = alarm.as_ref().map(|(_, text)| text.clone());
        let (program, left) = match program {
            Ok(left) => (Ok(()), left),
            Err(error) => (Err(error), None),
        };
        let outcome = RunOutcome {
            summary,
            program,
            trace_error: None,
            fault: fault.map(|(_, text)| text),
            process: report.process,
            left,
        };
        (outcome, alarm)
    }
}

/// Rejects jobs that need an operator, whom `run` does not have.
fn refuse_what_cannot_run(job: &Job) -> Result<(), StartError> {
    let machine = &job.setup.machine;
    if job.bus && job.is_realtime() && machine.drives.feedback == FeedbackMode::Required {
        return Err(StartError::DrivesRequired);
    }
    if !job.bus && job.is_realtime() && machine.signals.estop.is_some() {
        return Err(StartError::ChainUnread);
    }
    Ok(())
}

/// Notes about what the run passed over.
fn notes_of(job: &Job, report: &RunReport, feed: &FeedReport) -> impl Iterator<Item = String> {
    let passed = report.now.program_stops_passed;
    let (skipped, executed) = feed.block_delete_lines;
    let not_carried_out = feed.user_commands;
    [
        (job.is_realtime() && passed > 0).then(|| {
            format!(
                "{passed} program stops (M0, M1, M60) were passed without waiting, because no operator could \
                 confirm them: run in a terminal to confirm them"
            )
        }),
        (job.clock == Clock::Virtual && not_carried_out > 0).then(|| {
            format!(
                "{not_carried_out} user-defined M codes (M100 to M199) were not carried out: time was virtual"
            )
        }),
        (skipped > 0).then(|| format!("{skipped} lines that begin with / were skipped (--block-delete)")),
        (executed > 0)
            .then(|| format!("{executed} lines that begin with / were executed; --block-delete skips them")),
        tool_change_note(job, feed.tool_changes),
    ]
    .into_iter()
    .flatten()
}

/// Note about tool changes that were not carried out.
fn tool_change_note(job: &Job, changes: u64) -> Option<String> {
    let changer = job.setup.machine.program.tool_change;
    let (many, verb) = match changes {
        0 => return None,
        1 => ("1 tool change (M6)".to_owned(), "was"),
        changes => (format!("{changes} tool changes (M6)"), "were"),
    };
    match (job.clock, changer) {
        // Its moves, outputs and inputs are part of the run.
        (_, ToolChange::Subroutine) => None,
        (_, ToolChange::None) => Some(format!(
            "{many} {verb} counted as done and nothing was changed: program.tool_change is \"none\" in the \
             machine file"
        )),
        (Clock::Virtual, _) => Some(format!("{many} {verb} not carried out: time was virtual")),
        (Clock::Realtime, _) => None,
    }
}

/// A panic of a thread is a bug; it is passed on instead of producing a wrong summary.
fn join<T>(handle: thread::ScopedJoinHandle<'_, T>) -> T {
    handle
        .join()
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

fn unix_ns() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| since.as_nanos() as u64)
}
