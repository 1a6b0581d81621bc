//! One run: threads started, joined, and summed up.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use evolvent_bus::BusError;
use evolvent_machine::{CycleRecording, FeedbackWish, ToolChange};
use evolvent_motion::{PathExecutor, Setpoint, plan_queue};
use evolvent_signals::{Signals, schedule};
use evolvent_trace::{ProgramSource, RecordError, Recorder, RunInfo, configuration_hash, recover_leftovers};
use evolvent_turning::{AdaptiveFeed, AdaptiveStop, SimulatedProcess};
use rtrb::RingBuffer;

use crate::core_loop::{CoreLoop, CycleCounts};
use crate::feeder::{FeedReport, Feeder, ToCarrier};
use crate::input_script::InputScript;
use crate::job::{Clock, Job, Setup};
use crate::memory::ProgramMemory;
use crate::observer::{DRIVES_UNWATCHED, LookingOn, RunObserver};
use crate::periphery_track::{PeripheryOrder, PeripheryTrack};
use crate::program_cycle::{ProgramCycle, ProgramState, Seen, turning_alarm};
use crate::publisher::{BUS_TIMEOUT, Publisher};
use crate::publishing::Publishing;
use crate::recording::{Closing, RecorderLines, Recording};
use crate::refusal::ProgramError;
use crate::rt::apply_to_this_thread;
use crate::run_status::RunStatus;
use crate::shared::Controls;
use crate::signal_loop::{InputSource, SignalLoop};
use crate::signal_port::{CHANGES, SAMPLES, SignalPort};
use crate::signal_recorder::SignalRecorder;
use crate::stages::Stages;
use crate::standby::Standby;
use crate::stop_watch::StopWatch;
use crate::summary::{Outcome, Summary, TimingSummary, axis_summaries, late_for_nobody};
use crate::turning_tally::TurningTally;
use crate::user_code::UserCodes;
use crate::user_code_runner::UserCodeRunner;
use evolvent_control::Alarm;

/// Names of the attachments with what the program found.
const TOOLS: &str = "tools.tbl";
const PARAMETERS: &str = "parameters.var";
/// How long the planner sleeps when the queue is full.
const PLANNER_NAP: Duration = Duration::from_micros(500);
/// Seconds of setpoints and records that the queues hold.
const QUEUE_SECONDS: f64 = 2.0;
/// Bounds of their length.
const QUEUE_LENGTH: (usize, usize) = (4096, 65_536);
/// Commands of the machine's own that may lie ahead in the plan.
const COMMANDS_AHEAD: usize = 4096;
/// Told where a program is held until there is a load.
const AWAITS_LOAD: &str =
    "the program begins once a cutting load comes over the bus, and drives that answer follow";
/// How long to wait for an emergency-stop chain that is closed.
const CHAIN_TIMEOUT: Duration = Duration::from_secs(10);
/// How often it is looked at meanwhile.
const CHAIN_POLL: Duration = Duration::from_millis(5);
/// How long to wait for the first setpoint of a served machine.
pub(crate) const CYCLE_TIMEOUT: Duration = Duration::from_secs(20);

/// Why a run could not be started.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The bus.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The bus did not open in time.
    #[error("the bus did not open within {} s; see whether shared memory is usable (`evolvent doctor`)", BUS_TIMEOUT.as_secs())]
    BusTimeout,
    /// The machine file wants drives watched.
    #[error(
        "the machine file asks for drives that answer (drives.feedback = \"required\"), and `run` does not watch drives: use \
         `evolvent serve`, or \"if_present\" for a run without a machine"
    )]
    DrivesRequired,
    /// Nobody reads the emergency-stop chain without the bus.
    #[error(
        "the machine file has an emergency-stop chain ([estop]), and without the bus nobody reads it: leave out --no-bus, or use \
         --clock virtual for a run without a machine"
    )]
    ChainUnread,
    /// The emergency-stop chain is open.
    #[error(
        "the emergency-stop chain ([estop]) is open, or no bridge has sent its input within {} s; close it, and see that the \
         bridge runs", CHAIN_TIMEOUT.as_secs()
    )]
    ChainOpen,
    /// The trace.
    #[error(transparent)]
    Trace(#[from] RecordError),
    /// The cycle's thread computes nothing.
    #[error(
        "the cycle did not compute a setpoint within {} s; the host is overloaded, or real-time threads take all of its \
         processors (`evolvent doctor`)",
        CYCLE_TIMEOUT.as_secs()
    )]
    CycleTimeout,
    /// The modes that the interpreter begins with are refused.
    #[error(
        "the modes at power-up are refused: {0}; see program, tool table and parameters in the machine file"
    )]
    Modes(String),
    /// The operating system gave no thread.
    #[error("a thread could not be started: {0}; free memory or raise the limit of processes")]
    Thread(#[from] std::io::Error),
}

/// What became of a run.
#[derive(Debug)]
pub struct RunOutcome {
    /// The figures.
    pub summary: Summary,
    /// What was wrong with the program: it was run up to there.
    pub program: Result<(), ProgramError>,
    /// What was wrong with the trace.
    pub trace_error: Option<RecordError>,
    /// What the guard refused.
    pub fault: Option<String>,
    /// The simulated workpiece as the run has left it, where there is one.
    pub process: Option<SimulatedProcess>,
    /// What the program has left of tools and parameters, if it was read to its end.
    pub left: Option<ProgramMemory>,
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
    run_seen(job, controls, observer, |seen| observe(seen.setpoint))
}

/// The same; `observe` also sees what turning cycles and the simulated workpiece do.
///
/// # Errors
/// The run could not be started; nothing has moved.
pub fn run_seen(
    job: &Job,
    controls: &Arc<Controls>,
    observer: &mut dyn RunObserver,
    observe: impl FnMut(&Seen<'_>) + Send,
) -> Result<RunOutcome, StartError> {
    let setup = &job.setup;
    let limits = setup.machine.limits();
    let rate_hz = setup.rate_hz();
    let length = ((rate_hz * QUEUE_SECONDS) as usize).clamp(QUEUE_LENGTH.0, QUEUE_LENGTH.1);
    let start_unix_ns = unix_ns();

    let mut notes = Vec::new();
    if job.bus && job.clock == Clock::Realtime && setup.machine.drives.feedback == FeedbackWish::Required {
        return Err(StartError::DrivesRequired);
    }
    let signal_settings = &setup.machine.signals;
    if !job.bus && job.clock == Clock::Realtime && signal_settings.estop.is_some() {
        return Err(StartError::ChainUnread);
    }

    thread::scope(|scope| {
        let (trace_producer, trace_consumer) = optional_ring(job.trace.is_some(), length);
        let (bus_producer, bus_consumer) = optional_ring(job.bus, length);

        let has_signals = !signal_settings.is_empty();
        let (signal_trace, signal_record) = optional_ring(has_signals && job.trace.is_some(), length);
        let (change_producer, changes) = optional_ring(has_signals && job.bus, CHANGES);
        let (sample_producer, samples) = optional_ring(has_signals && job.bus, SAMPLES);
        let port = sample_producer
            .zip(changes)
            .map(|(samples, changes)| SignalPort::new(signal_settings, setup.tool, samples, changes));
        let (periphery, planned_periphery) = mpsc::channel();
        let periphery = job.bus.then_some(periphery);
        let (orders, periphery_orders) = mpsc::channel();
        // Its only program: the publisher hears of no other.
        let _held = orders.send(PeripheryOrder::Program {
            job: 0,
            planned: planned_periphery,
        });
        drop(orders);
        // The bus first: what fails should fail before anything is planned.
        let publisher = match bus_consumer {
            None => None,
            Some(queue) => {
                let mut publishing =
                    Publishing::new(setup, job.clock, job.bus_prefix.as_deref(), Arc::clone(controls));
                publishing.wait_for_subscribers = job.wait_for_subscribers;
                let status = RunStatus::new(job, &publishing);
                let publisher = Publisher {
                    publishing,
                    setpoints: queue,
                    periphery: PeripheryTrack::new(setup.tool, periphery_orders),
                    signals: port,
                    stops: StopWatch::start(setup, job.clock)?,
                    status,
                };
                let request = (job.clock == Clock::Realtime).then(|| setup.realtime_request(1));
                let (publish, opening) = publisher.prepare(request);
                let handle = thread::Builder::new()
                    .name("publisher".into())
                    .spawn_scoped(scope, publish)?;
                let subscribers = opening.wait()?;
                if subscribers < job.wait_for_subscribers {
                    let text = format!(
                        "{subscribers} of {} subscribers came; the run starts without the others",
                        job.wait_for_subscribers
                    );
                    observer.note(&text);
                    notes.push(text);
                }
                if job.clock == Clock::Realtime && signal_settings.estop.is_some() {
                    await_chain(controls)?;
                }
                Some(handle)
            }
        };

        if let Some(path) = &job.trace {
            for text in rescue_leftovers(path) {
                observer.note(&text);
            }
        }
        let recorder = match &job.trace {
            Some(path) => Some(Recorder::create(
                path,
                &run_info(setup, &RunSource::Job(job), start_unix_ns),
            )?),
            None => None,
        };
        let (news, notices) = mpsc::channel();
        let mut listeners = vec![news];
        let (recorder_lines, recorded) = RecorderLines::new();
        let recording = match (recorder, trace_consumer) {
            (Some(recorder), Some(queue)) => {
                listeners.push(recorded.news);
                let recording = Recording {
                    recorder,
                    queue,
                    signals: signal_record
                        .map(|changes| SignalRecorder::new(changes, signal_settings.clone())),
                    lines: recorder_lines,
                    on_full: setup.machine.trace.on_full,
                    controls: Arc::clone(controls),
                    program: job.program.clone(),
                    further: None,
                };
                let period_ns = setup.period_ns;
                Some(
                    thread::Builder::new()
                        .name("recorder".into())
                        .spawn_scoped(scope, move || recording.run(period_ns))?,
                )
            }
            _ => None,
        };

        let waiting = Arc::clone(controls);
        let (scheduler, signals) = if has_signals {
            let lead_cycles = setup.machine.lead_cycles(setup.period_ns);
            let (scheduler, consumer) = schedule();
            let mut signals = Signals::new(signal_settings, lead_cycles);
            let _none = signals.begin_program(consumer);
            let source = match samples {
                Some(samples) if job.clock == Clock::Realtime => InputSource::Bus(samples),
                _ => {
                    let script = job.inputs.clone();
                    let script = script.unwrap_or_else(|| InputScript::without_file(signal_settings));
                    InputSource::Script(Box::new(script))
                }
            };
            let is_realtime = job.clock == Clock::Realtime;
            let signals = SignalLoop::new(signals, source, change_producer, signal_trace, is_realtime);
            (Some(scheduler), Some(signals))
        } else {
            (None, None)
        };
        let (mut plan_producer, plan_consumer) = plan_queue(move || {
            thread::sleep(PLANNER_NAP);
            !waiting.is_abandoned()
        });
        let turnings = plan_producer.take_turnings();
        let with_blocks = recording.is_some();
        // Where time is not real, nothing of the machine is there to be commanded.
        let codes = (job.clock == Clock::Realtime).then(|| UserCodes::of(setup));
        let (stops, commands) = RingBuffer::new(COMMANDS_AHEAD);
        let (calls, called) = mpsc::channel();
        let carrier = match &codes {
            None => None,
            Some(codes) => {
                let carrier = UserCodeRunner {
                    codes: codes.clone(),
                    controls: Arc::clone(controls),
                    calls: called,
                    listeners: listeners.clone(),
                };
                let builder = thread::Builder::new().name("carrier".into());
                Some(builder.spawn_scoped(scope, move || carrier.run())?)
            }
        };
        let feeding = Arc::clone(controls);
        let is_unattended = job.clock == Clock::Realtime && !job.stop_at_program_stops;
        let feeder = thread::Builder::new()
            .name("planner".into())
            .spawn_scoped(scope, move || {
                let optional_stop = job.optional_stop;
                let feeder = Feeder::new(
                    &job.program,
                    setup,
                    Stages::one(setup, job.feed_override, plan_producer),
                    listeners,
                    with_blocks,
                    optional_stop,
                )
                .turning_by(turnings)
                .signalling_by(scheduler)
                .periphery_to(periphery)
                .unattended(is_unattended);
                let feeder = match codes {
                    None => feeder,
                    Some(codes) => feeder.executing(codes).carried_out_by(ToCarrier {
                        calls,
                        stops,
                        controls: Arc::clone(&feeding),
                    }),
                };
                feeder.feed(&job.program, || feeding.fail_program())
            })?;

        let needs_load =
            job.clock == Clock::Realtime && (setup.process.is_some() || controls.adaptive().is_some());
        let core = CoreLoop {
            clock: job.clock,
            period_ns: setup.period_ns,
            lead_cycles: setup.machine.lead_cycles(setup.period_ns),
            max_late_cycles: setup.machine.max_late_cycles(setup.period_ns),
            start_unix_ns,
            bus: bus_producer,
            trace: trace_producer,
        };
        let mut source = ProgramCycle {
            motion: PathExecutor::new(limits, setup.period_ns, limits.home).planned_for(job.feed_override),
            queue: plan_consumer,
            controls: Arc::clone(controls),
            period_ns: setup.period_ns,
            is_realtime: job.clock == Clock::Realtime,
            stops_at_program_stops: job.stop_at_program_stops,
            commands: (job.clock == Clock::Realtime).then_some(commands),
            signals,
            records_load: setup.process.is_some(),
            process: (job.clock == Clock::Virtual)
                .then(|| SimulatedProcess::new(setup.process.as_ref()?, setup.period_ns as f64 * 1e-9))
                .flatten(),
            standby: Standby::new(needs_load, setup.period_ns),
            adaptive: controls
                .adaptive()
                .and_then(|settings| AdaptiveFeed::new(settings).ok()),
            observe,
            now: ProgramState::new(TurningTally::new(
                setup
                    .process
                    .as_ref()
                    .map_or(0.0, |process| process.settings.regime.set_load),
                setup.period_ns,
            )),
        };
        if needs_load {
            observer.note(AWAITS_LOAD);
        }
        let request = (job.clock == Clock::Realtime).then(|| setup.realtime_request(0));
        let (granted_sender, granted) = mpsc::channel();
        let cycle_thread = thread::Builder::new()
            .name("cycle".into())
            .spawn_scoped(scope, move || {
                // Begin with a plan in hand, so that the first cycles do not depend on how fast it came.
                while !source.motion.is_ready(&mut source.queue) && !source.controls.is_stopping() {
                    thread::sleep(PLANNER_NAP);
                }
                if let Some(request) = request {
                    let _gone = granted_sender.send(apply_to_this_thread(&request).notes);
                }
                drop(granted_sender);
                let counts = core.run(&mut source);
                // The planner need not go on.
                source.controls.abandon();
                RunReport::of(counts, source)
            })?;
        for text in granted.iter().flatten() {
            observer.note(&text);
            notes.push(text);
        }
        let mut looking_on = LookingOn::new(job, controls, &notices, &recorded.failures);
        looking_on.until(observer, || cycle_thread.is_finished());

        let report = join(cycle_thread)?;
        let (feed, program) = join(feeder)?;
        let (program, left) = match program {
            Ok(left) => (Ok(()), left),
            Err(error) => (Err(error), None),
        };
        let not_carried_out = carrier.map(join).transpose()?.flatten();
        let published = publisher.map(join).transpose()?.unwrap_or_default();
        if let Some(text) = published.refusal_note() {
            observer.note(&text);
            notes.push(text);
        }
        // What the other threads have told at their end.
        looking_on.until(observer, || true);
        if looking_on.has_told_of_drives() {
            notes.push(DRIVES_UNWATCHED.to_owned());
        }
        let late = if job.bus {
            published.late.max(report.counts.late_cycles)
        } else {
            report.counts.late_cycles
        };
        let fault = fault_of(&report).or_else(|| not_carried_out.map(|text| (Alarm::UserCommand, text)));
        let alarm = match (&fault, &program) {
            (Some((alarm, text)), _) => Some((*alarm, text.clone())),
            (None, Err(error)) if report.now.program_failed => Some((Alarm::Program, error.to_string())),
            _ => None,
        };
        if job.clock == Clock::Realtime && report.now.program_stops_passed > 0 {
            let text = format!(
                "{} program stops (M0, M1, M60) were passed without waiting, because nobody could be asked: run in a \
                 terminal to be asked",
                report.now.program_stops_passed
            );
            observer.note(&text);
            notes.push(text);
        }
        if job.clock == Clock::Virtual && feed.user_commands > 0 {
            let text = format!(
                "{} commands of the machine's own (M100 to M199) were not carried out: time was not real",
                feed.user_commands
            );
            observer.note(&text);
            notes.push(text);
        }
        let (skipped, executed) = feed.block_delete_lines;
        for text in [
            (skipped > 0).then(|| format!("{skipped} lines that begin with / were skipped (--block-delete)")),
            (executed > 0).then(|| {
                format!("{executed} lines that begin with / were executed; --block-delete skips them")
            }),
            tool_change_note(job, feed.tool_changes),
        ]
        .into_iter()
        .flatten()
        {
            observer.note(&text);
            notes.push(text);
        }
        let mut summary = summarise(job, &report, &feed, late, notes);
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
        let mut trace_error = None;
        if let Some(recording) = recording {
            let _gone = recorded.closing.send(Closing {
                summary: trace_summary(&summary),
                alarm,
            });
            let record = join(recording)?;
            summary.dropped_records += record.lost;
            match record.result {
                Ok(path) => summary.trace = Some(path.display().to_string()),
                Err(error) => {
                    summary.notes.push(error.to_string());
                    trace_error = Some(error);
                }
            }
        }
        Ok(RunOutcome {
            summary,
            program,
            trace_error,
            fault: fault.map(|(_, text)| text),
            process: report.process,
            left,
        })
    })
}

/// Waits until the emergency-stop chain is closed, not beyond a stop.
fn await_chain(controls: &Controls) -> Result<(), StartError> {
    let deadline = Instant::now() + CHAIN_TIMEOUT;
    while !controls.is_chain_closed() {
        if controls.is_stopping() || Instant::now() >= deadline {
            return Err(StartError::ChainOpen);
        }
        thread::sleep(CHAIN_POLL);
    }
    Ok(())
}

/// What became of tool changes that nobody has carried out.
fn tool_change_note(job: &Job, changes: u64) -> Option<String> {
    let (many, verb) = match changes {
        0 => return None,
        1 => ("1 tool change (M6)".to_owned(), "was"),
        changes => (format!("{changes} tool changes (M6)"), "were"),
    };
    match (job.clock, job.setup.machine.program.tool_change) {
        (_, ToolChange::None) => Some(format!(
            "{many} {verb} counted as done and nothing was changed: program.tool_change is \"none\" in the machine file"
        )),
        (Clock::Virtual, _) => Some(format!("{many} {verb} not carried out: time was not real")),
        (Clock::Realtime, _) => None,
    }
}

/// A panic of a thread is a bug; it is passed on rather than turned into a wrong summary.
fn join<T>(handle: thread::ScopedJoinHandle<'_, T>) -> Result<T, StartError> {
    handle.join().map_err(|panic| std::panic::resume_unwind(panic))
}

pub(crate) fn optional_ring<T>(
    wanted: bool,
    length: usize,
) -> (Option<rtrb::Producer<T>>, Option<rtrb::Consumer<T>>) {
    if !wanted {
        return (None, None);
    }
    let (producer, consumer) = RingBuffer::new(length);
    (Some(producer), Some(consumer))
}

/// Makes complete traces of what killed runs have left in the folder of `trace`; says what became of each.
pub(crate) fn rescue_leftovers(trace: &Path) -> Vec<String> {
    let folder = trace
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    // A folder that cannot be read is told by the recorder, if it matters.
    let leftovers = recover_leftovers(folder).unwrap_or_default();
    leftovers
        .into_iter()
        .map(|(part, result)| match result {
            Ok(recovered) => format!(
                "{}: left by a run that was killed, recovered as {}",
                part.display(),
                recovered.path.display()
            ),
            Err(error) => format!("{}: left by a run that was killed: {error}", part.display()),
        })
        .collect()
}

fn unix_ns() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| since.as_nanos() as u64)
}

/// What is recorded: one program, or whatever a served machine does.
pub(crate) enum RunSource<'a> {
    Job(&'a Job),
    Served,
}

pub(crate) fn run_info(setup: &Setup, source: &RunSource<'_>, start_time_ns: u64) -> RunInfo {
    let settings = &setup.machine.realtime;
    let name = |path: &Path| {
        path.file_name()
            .map_or_else(String::new, |name| name.to_string_lossy().into_owned())
    };
    let (program_name, program, clock, mut extra) = match source {
        RunSource::Job(job) => (
            name(&job.program),
            ProgramSource::File(job.program.clone()),
            job.clock,
            // What the run depends on beside program and machine file, for computing it again.
            BTreeMap::from([
                ("feed_override".to_owned(), job.feed_override.to_string()),
                ("optional_stop".to_owned(), job.optional_stop.to_string()),
                ("planner".to_owned(), setup.machine.path.planner.name().to_owned()),
                ("platform".to_owned(), crate::platform()),
                ("block_delete".to_owned(), setup.block_delete.to_string()),
                ("tool".to_owned(), setup.tool.to_string()),
                ("start_line".to_owned(), setup.start_line.unwrap_or(0).to_string()),
            ]),
        ),
        RunSource::Served => (
            "serve".to_owned(),
            ProgramSource::None,
            Clock::Realtime,
            BTreeMap::from([
                ("served".to_owned(), true.to_string()),
                ("planner".to_owned(), setup.machine.path.planner.name().to_owned()),
                ("platform".to_owned(), crate::platform()),
            ]),
        ),
    };
    if let Some(process) = &setup.process {
        extra.insert("process".to_owned(), process.text().to_owned());
    }
    RunInfo {
        program_name,
        program,
        machine_name: setup.machine.name.clone(),
        machine_file_name: name(&setup.machine_file),
        machine_file: setup.machine_text.clone(),
        tool_table: setup
            .memory
            .tools
            .as_ref()
            .map(|tools| (TOOLS.to_owned(), tools.to_text().into_bytes())),
        parameters: setup
            .memory
            .kept
            .as_ref()
            .map(|kept| (PARAMETERS.to_owned(), kept.to_text().into_bytes())),
        axes: setup.machine.axes.iter().map(|axis| axis.letter).collect(),
        period_ns: setup.period_ns,
        start_time_ns,
        versions: BTreeMap::from([("evolvent".to_owned(), env!("CARGO_PKG_VERSION").to_owned())]),
        configuration_hash: configuration_hash(&[setup.machine_text.as_bytes()]),
        clock: clock.name().to_owned(),
        real_time: format!(
            "SCHED_FIFO {} asked for, core {:?}, lock memory {}",
            settings.priority, settings.core, settings.lock_memory
        ),
        columns: setup.machine.trace.cycles == CycleRecording::Columns,
        extra,
    }
}

/// What the cycle's thread leaves.
struct RunReport {
    counts: CycleCounts,
    now: ProgramState,
    motion: PathExecutor,
    /// The simulated workpiece as it is left.
    process: Option<SimulatedProcess>,
}

impl RunReport {
    /// Everything else that the cycle had ends here: its queues tell the other threads.
    fn of<F>(mut counts: CycleCounts, source: ProgramCycle<F>) -> Self {
        counts.dropped_records += source.signals.as_ref().map_or(0, |signals| signals.lost);
        Self {
            counts,
            now: source.now,
            motion: source.motion,
            process: source.process,
        }
    }
}

fn fault_of(report: &RunReport) -> Option<(Alarm, String)> {
    let motion = &report.motion;
    if let Some(violation) = motion.fault() {
        let text = format!(
            "the guard refused a setpoint: {violation}; the machine was stopped. \
             This is a fault of the planner: please report it with the trace"
        );
        return Some((Alarm::Guard, text));
    }
    if report.now.planner_died {
        let text = "the planner ended without completing its plan; the machine stopped on the path";
        return Some((Alarm::Planner, text.to_owned()));
    }
    if let Some(reason) = motion.turning_fault() {
        return Some((turning_alarm(&reason), reason.text()));
    }
    if let Some(stop) = &report.now.adaptive_stop {
        let alarm = match stop {
            AdaptiveStop::Sensor(_) => Alarm::LoadSensor,
            _ => Alarm::CuttingLoad,
        };
        return Some((alarm, stop.text()));
    }
    if report.now.estopped {
        return Some((
            Alarm::EmergencyStopChain,
            Alarm::EmergencyStopChain.sentence().to_owned(),
        ));
    }
    if let Some(why) = report.now.not_begun {
        return Some((Alarm::LoadSensor, why.text()));
    }
    report.now.stopped_for_lateness.then(|| {
        let text = "too many setpoints in a row left late; the machine was stopped on the path. Run \
                    `evolvent doctor`, lower the rate, or raise realtime.max_late_cycles";
        (Alarm::Lateness, text.to_owned())
    })
}

fn summarise(job: &Job, report: &RunReport, feed: &FeedReport, late: u64, notes: Vec<String>) -> Summary {
    let setup = &job.setup;
    let machine = &setup.machine;
    let extremes = report.motion.extremes();
    let per_axis = axis_summaries(machine, extremes);
    let position = report
        .now
        .last
        .map_or(machine.limits().home, |last| last.position);
    let list = |of: fn(&crate::summary::AxisSummary) -> f64| per_axis.iter().map(of).collect::<Vec<_>>();
    Summary {
        program: job.program.display().to_string(),
        machine: machine.name.clone(),
        clock: job.clock.name(),
        outcome: if report.now.stopped_for_lateness || report.now.planner_died {
            Outcome::Fault
        } else if report.now.program_failed {
            Outcome::Failed
        } else {
            Outcome::of(report.motion.state())
        },
        axes: machine.axes.iter().map(|axis| axis.letter.letter()).collect(),
        cycles: report.counts.cycles,
        rate_hz: setup.rate_hz(),
        period_ns: setup.period_ns,
        duration_s: report.counts.cycles as f64 * setup.period_ns as f64 * 1e-9,
        planned_duration_s: feed.planned_s,
        moves: feed.moves,
        path_length_mm: report.now.last.map_or(0.0, |last| last.path_mm),
        late_cycles: late,
        listeners: 0,
        dropped_records: report.counts.dropped_records,
        dropped_setpoints: report.counts.dropped_setpoints,
        starved_cycles: report.now.starved_cycles,
        max_chord_error_mm: extremes.chord_error_mm,
        permitted_chord_error_mm: machine.path.chord_error_increments / machine.increments_per_mm,
        max_path_error_mm: feed.deviation_mm,
        end_position: machine
            .axes
            .iter()
            .map(|axis| position[axis.letter.index()])
            .collect(),
        max_velocity_mm_s: list(|axis| axis.max_velocity_mm_s),
        max_acceleration_mm_s2: list(|axis| axis.max_acceleration_mm_s2),
        max_jerk_mm_s3: list(|axis| axis.max_jerk_mm_s3),
        velocity_ratio: list(|axis| axis.velocity_ratio),
        acceleration_ratio: list(|axis| axis.acceleration_ratio),
        jerk_ratio: list(|axis| axis.jerk_ratio),
        per_axis,
        wake_lateness: TimingSummary::of(&report.counts.lateness),
        work: TimingSummary::of(&report.counts.work),
        turning: report.now.turning.summary(),
        trace: None,
        alarm: None,
        error: None,
        notes,
    }
}

/// What of the summary goes into the trace's metadata.
fn trace_summary(summary: &Summary) -> BTreeMap<String, String> {
    let pairs = [
        ("outcome", summary.outcome.name().to_owned()),
        ("duration_s", summary.duration_s.to_string()),
        ("path_length_mm", summary.path_length_mm.to_string()),
        ("late_cycles", summary.late_cycles.to_string()),
        ("dropped_records", summary.dropped_records.to_string()),
        ("max_chord_error_mm", summary.max_chord_error_mm.to_string()),
        ("max_path_error_mm", summary.max_path_error_mm.to_string()),
    ];
    let notes = (!summary.notes.is_empty()).then(|| ("notes", summary.notes.join("\n")));
    let error = summary.error.clone().map(|text| ("error", text));
    pairs
        .into_iter()
        .chain(notes)
        .chain(error)
        .map(|(key, value)| (key.to_owned(), value))
        .collect()
}
