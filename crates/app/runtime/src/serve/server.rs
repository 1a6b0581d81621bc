//! A machine that is served: threads started, the control thread's loop, everything brought to rest at the end.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use evolvent_bus::ControlServer;
use evolvent_drive::{FeedbackWatch, PhaseLock};
use evolvent_motion::MachineState;
use evolvent_signals::Signals;
use evolvent_trace::{RecordError, Recorder};
use rtrb::{Consumer, Producer, RingBuffer};

use super::calls::Calls;
use super::files::READING_TIMEOUT;
use super::notify::SystemdNotifier;
use super::operator::{Operator, OperatorConfig};
use super::orders::CycleView;
use super::series::{FileProgress, TraceSeries};
use super::served_cycle::{ServedCycle, ServedParts};
use super::served_status::{ServedStatus, Snapshot};
use super::snapshot::{Mark, Pulse, snapshot};
use super::state_store::StateStore;
use crate::core_loop::CoreLoop;
use crate::drives::{phase_settings, watch_settings};
use crate::job::{Clock, Setup};
use crate::pacing::wake_interval_ns;
use crate::periphery_track::PeripheryTrack;
use crate::publish_report::PublishReport;
use crate::publisher::Publisher;
use crate::publishing::Publishing;
use crate::recording::{Closing, Further, RecordReport, RecorderLines, Recording};
use crate::rt::{MonotonicClock, apply_to_this_thread, raise_priority, separate_large_blocks};
use crate::run::{CYCLE_TIMEOUT, RunSource, StartError, optional_ring, rescue_leftovers, run_info};
use crate::shared::Controls;
use crate::signal_loop::{InputSource, SignalLoop};
use crate::signal_port::{CHANGES, SAMPLES, SignalPort};
use crate::signal_recorder::SignalRecorder;
use crate::stop_watch::StopWatch;

/// Time between two looks of the control thread, at the most and at the least: so long a command waits at the most on a host
/// that is not busy. In between it is a quarter of the period, so that a hold takes no more than lead and two cycles.
const CONTROL_EVERY: Duration = Duration::from_micros(500);
const CONTROL_EVERY_AT_LEAST: Duration = Duration::from_micros(100);
/// Time between two snapshots where nothing changes.
const STATUS_EVERY_NS: u64 = 50_000_000;
/// Requests that are answered in one look at the most.
const MAX_REQUESTS: usize = 32;
/// How long coming to rest may take before the process ends anyway.
const END_TIMEOUT: Duration = Duration::from_secs(30);
/// Seconds of setpoints and records that the queues hold, and bounds of their length.
const QUEUE_SECONDS: f64 = 2.0;
const QUEUE_LENGTH: (usize, usize) = (4096, 65_536);

/// How a machine is served.
#[derive(Clone, Debug)]
pub struct ServeConfig {
    /// The machine at its rate.
    pub setup: Setup,
    /// iceoryx2's prefix; none for iceoryx2's own.
    pub bus_prefix: Option<String>,
    /// Where the trace goes.
    pub trace: TraceTo,
    /// Where offsets, tools and parameters are kept: see [`crate::state_folder`].
    pub state_folder: PathBuf,
}

/// Where the trace of a served machine goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TraceTo {
    /// Nothing is recorded.
    Nowhere,
    /// The whole session in one file, without a bound.
    File(PathBuf),
    /// `NAME-TIME.mcap` in this folder: a new file every hour, where nothing moves. The oldest files of this machine are
    /// removed before all of them together take more than the bound.
    Folder {
        /// The folder; it is made.
        folder: PathBuf,
        /// The bound, bytes.
        limit_bytes: u64,
    },
}

/// Messages while a machine is served.
#[derive(Clone, Copy, Debug)]
pub enum ServeNews<'a> {
    /// It takes commands from now on; the first trace file, if there is one.
    Ready(Option<&'a Path>),
    /// What the user should know.
    Note(&'a str),
}

/// What serving came to.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ServeSummary {
    /// The machine's name.
    pub machine: String,
    /// Setpoints.
    pub cycles: u64,
    /// The control rate.
    pub rate_hz: f64,
    /// Jobs begun.
    pub jobs: u64,
    /// Commands accepted.
    pub commands_accepted: u64,
    /// Commands rejected.
    pub commands_rejected: u64,
    /// Setpoints that left after they were due.
    pub late_cycles: u64,
    /// Readers of setpoints and bridges that were connected at the same time, at most. Late setpoints count for the exit code only
    /// where there was one.
    pub listeners: u64,
    /// Trace records lost.
    pub dropped_records: u64,
    /// Setpoints lost on the way to the bus.
    pub dropped_setpoints: u64,
    /// Alarms in force at the end.
    pub alarms: Vec<u32>,
    /// The trace file, if one was written.
    pub trace: Option<String>,
    /// What the user should know.
    pub notes: Vec<String>,
}

/// Serves a machine until `stop` is set; comes to rest within the limits then. `tell` hears what people should know at
/// once.
///
/// # Errors
/// It could not be started; nothing has moved.
pub fn serve(
    config: &ServeConfig,
    stop: &AtomicBool,
    mut tell: impl FnMut(ServeNews<'_>),
) -> Result<ServeSummary, StartError> {
    let setup = &config.setup;
    separate_large_blocks();
    let machine = &setup.machine;
    let limits = machine.limits();
    let length = ((setup.rate_hz() * QUEUE_SECONDS) as usize).clamp(QUEUE_LENGTH.0, QUEUE_LENGTH.1);
    let start_unix_ns = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| since.as_nanos() as u64);
    let manager = SystemdNotifier::of_environment();
    let mut notes = Vec::new();

    let controls = Arc::new(Controls::new(1.0));
    let prefix = config.bus_prefix.as_deref();
    let publishing = Publishing::new(setup, Clock::Realtime, prefix, Arc::clone(&controls));
    let bus_config = publishing.config.clone();
    let (bus, setpoints) = RingBuffer::new(length);
    let (mut snapshots, to_publish) = RingBuffer::new(64);
    let (to_cycle, feedback) = RingBuffer::new(256);
    let (to_control, mut answers) = RingBuffer::new(4096);
    let (to_count, mut counts) = RingBuffer::new(8);
    let signal_settings = &machine.signals;
    let has_signals = !signal_settings.is_empty();
    let (signal_trace, signal_record) =
        optional_ring(has_signals && config.trace != TraceTo::Nowhere, length);
    let (output_changes, changes) = RingBuffer::new(CHANGES);
    let (input_samples, samples) = RingBuffer::new(SAMPLES);
    let (periphery, periphery_orders) = mpsc::channel();
    let tool = setup.tool;
    let publisher = Publisher {
        publishing,
        setpoints,
        periphery: PeripheryTrack::new(tool, periphery_orders),
        signals: has_signals.then(|| SignalPort::new(signal_settings, tool, input_samples, changes)),
        stops: StopWatch::start(setup, Clock::Realtime)?,
        status: ServedStatus {
            snapshots: to_publish,
            feedback: to_cycle,
            answers: to_control,
            counts: to_count,
        },
    };
    let (publish, opening) = publisher.prepare(Some(setup.realtime_request(1)));
    let publisher = thread::Builder::new().name("publisher".into()).spawn(publish)?;
    let _nobody_asked_for = opening.wait()?;
    let mut server = ControlServer::open(&bus_config)?;

    let series = match &config.trace {
        TraceTo::Folder { folder, limit_bytes } => {
            Some(TraceSeries::new(folder.clone(), &machine.name, *limit_bytes))
        }
        TraceTo::Nowhere | TraceTo::File(_) => None,
    };
    let progress = Arc::new(FileProgress::default());
    let first_file = match &config.trace {
        TraceTo::Nowhere => None,
        TraceTo::File(path) => Some(path.clone()),
        TraceTo::Folder { .. } => series.as_ref().map(TraceSeries::file_of_now),
    };
    let recording = match &first_file {
        None => None,
        Some(path) => {
            let further = series.clone().map(|series| (series, Arc::clone(&progress)));
            let signals = signal_record.map(|changes| SignalRecorder::new(changes, signal_settings.clone()));
            let started = start_recording(
                config,
                path,
                further,
                (length, signals),
                start_unix_ns,
                &mut |text: &str| {
                    tell(ServeNews::Note(text));
                },
            );
            Some(started?)
        }
    };
    let (trace, recorder, recording) = match recording {
        None => (None, None, None),
        Some((queue, news, rest)) => (Some(queue), Some(news), Some(rest)),
    };

    let (orders, cycle_orders) = RingBuffer::new(1024);
    let (cycle_events, mut events) = RingBuffer::new(4096);
    let (cycle_views, mut views) = RingBuffer::new(length);
    let core = CoreLoop {
        clock: Clock::Realtime,
        period_ns: setup.period_ns,
        lead_cycles: machine.lead_cycles(setup.period_ns),
        max_late_cycles: machine.max_late_cycles(setup.period_ns),
        start_unix_ns,
        bus: Some(bus),
        trace,
    };
    let parts = ServedParts {
        station: MachineState::new(limits, setup.period_ns, limits.home),
        limits,
        period_ns: setup.period_ns,
        orders: cycle_orders,
        events: cycle_events,
        views: cycle_views,
        feedback,
        watch: FeedbackWatch::new(watch_settings(machine, setup.period_ns)),
        signals: has_signals.then(|| {
            let signals = Signals::new(signal_settings, machine.lead_cycles(setup.period_ns));
            let source = InputSource::Bus(samples);
            SignalLoop::new(signals, source, Some(output_changes), signal_trace, true)
        }),
        phase: phase_settings(machine, setup.period_ns).map(PhaseLock::new),
        controls,
    };
    let (granted_sender, granted) = mpsc::channel();
    let request = setup.realtime_request(0);
    let cycle = thread::Builder::new().name("cycle".into()).spawn(move || {
        let _gone = granted_sender.send(apply_to_this_thread(&request).notes);
        core.run(&mut ServedCycle::new(parts))
    })?;
    for text in granted.recv().unwrap_or_default() {
        tell(ServeNews::Note(&text));
        notes.push(text);
    }

    let Ok(first) = wait_for_view(&mut views) else {
        return Err(StartError::CycleTimeout);
    };
    let keep = StateStore::open(setup.memory.clone(), &config.state_folder);
    for complaint in &keep.complaints {
        tell(ServeNews::Note(complaint));
    }
    let mut operator = Operator::new(OperatorConfig {
        setup: setup.clone(),
        keep,
        folder: config.state_folder.clone(),
        orders,
        recorder,
        periphery,
        view: first,
    })
    .map_err(StartError::Modes)?;
    manager.tell("READY=1");
    tell(ServeNews::Ready(first_file.as_deref()));
    // A hold is not to wait until a busy host has time. What it starts itself is of the normal scheduler.
    raise_priority();

    let every =
        Duration::from_nanos(wake_interval_ns(setup.period_ns, machine.lead_cycles(setup.period_ns)) / 4)
            .clamp(CONTROL_EVERY_AT_LEAST, CONTROL_EVERY);
    let mut file_begun = Instant::now();
    let mut files_ordered = 0;
    let mut calls = Calls::default();
    let mut pulse = Pulse::default();
    let mut published = (PublishReport::default(), 0);
    let mut sequence = 0;
    let mut mark: Option<Mark> = None;
    let mut next_status = 0;
    let mut next_sign = Instant::now();
    let mut seen = 0;
    let mut ending: Option<Instant> = None;
    loop {
        let now_ns = MonotonicClock::now_ns();
        // Commands are judged by what the newest cycle has left.
        operator.tick(now_ns, &mut views, &mut events, &mut answers, |view| {
            pulse.count(view);
        });
        for _ in 0..MAX_REQUESTS {
            match server.receive() {
                Ok(Some(call)) => calls.take(call, &mut operator, now_ns),
                Ok(None) => break,
                Err(error) => {
                    tell(ServeNews::Note(&error.to_string()));
                    break;
                }
            }
        }
        calls.go_on(&mut operator, now_ns);
        while let Ok(count) = counts.pop() {
            published = count;
        }
        if let Some(recording) = &recording {
            for error in recording.failures.try_iter() {
                operator.trace_failed(&error.to_string());
            }
        }
        if let Some(series) = &series
            // One after the other.
            && progress.files.load(Ordering::Acquire) == files_ordered
            && series.is_due(file_begun, progress.bytes.load(Ordering::Relaxed), operator.is_idle())
        {
            file_begun = Instant::now();
            files_ordered += 1;
            operator.begin_trace_file();
        }
        if stop.load(Ordering::Relaxed) && ending.is_none() {
            ending = Some(Instant::now());
            manager.tell("STOPPING=1");
            operator.end();
        }
        let is_over = cycle.is_finished();
        let now_mark = Mark::of(&operator);
        let changed = mark != Some(now_mark);
        if changed || now_ns >= next_status || is_over {
            next_status = now_ns + STATUS_EVERY_NS;
            sequence += 1;
            let status = snapshot(&operator, &pulse, &published, sequence, now_ns);
            let event = mark.filter(|_| changed).map(|before| now_mark.event(before));
            // A publisher that hangs gets the next one.
            let _full = snapshots.push(Snapshot { status, event });
            mark = Some(now_mark);
        }
        if let Some(every) = manager.watchdog
            && Instant::now() >= next_sign
            && operator.view.setpoint.sequence != seen
        {
            // A sign of life of the cycle, not of this thread alone.
            seen = operator.view.setpoint.sequence;
            next_sign = Instant::now() + every;
            manager.tell("WATCHDOG=1");
        }
        let hangs = ending.is_some_and(|since| since.elapsed() > END_TIMEOUT);
        if is_over || hangs {
            break;
        }
        thread::sleep(every);
    }
    let view = operator.view;
    let (accepted, rejected) = operator.desk.counts();
    let mut summary = ServeSummary {
        machine: machine.name.clone(),
        cycles: view.setpoint.sequence + 1,
        rate_hz: setup.rate_hz(),
        jobs: operator.desk.job(),
        commands_accepted: accepted,
        commands_rejected: rejected + operator.malformed(),
        late_cycles: view.late_cycles.max(published.0.late),
        listeners: published.0.listeners as u64,
        dropped_records: view.dropped_records,
        dropped_setpoints: view.dropped_setpoints + published.0.failed,
        alarms: operator.desk.alarms().map(|(alarm, _)| alarm.number()).collect(),
        trace: None,
        notes,
    };
    operator.keep.close(READING_TIMEOUT);
    // The recorder ends when nobody can send it news any more, the publisher when nobody sends setpoints.
    drop(operator);
    drop(snapshots);
    if cycle.is_finished() {
        let counts = cycle
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        summary.cycles = counts.cycles;
        let published = publisher
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        summary.notes.extend(published.refusal_note());
        if let Some(recording) = recording {
            let record = recording.finish(&summary);
            summary.dropped_records += record.lost;
            match record.result {
                Ok(path) => summary.trace = Some(path.display().to_string()),
                Err(error) => summary.notes.push(error.to_string()),
            }
        }
    } else {
        summary
            .notes
            .push("the cycle did not come to rest in time".to_owned());
    }
    Ok(summary)
}

fn wait_for_view(views: &mut Consumer<CycleView>) -> Result<CycleView, ()> {
    let deadline = Instant::now() + CYCLE_TIMEOUT;
    loop {
        // Looked at last: this thread may have been kept from running as well.
        let is_over = Instant::now() > deadline;
        if let Ok(view) = views.pop() {
            return Ok(view);
        }
        if is_over {
            return Err(());
        }
        thread::sleep(CONTROL_EVERY);
    }
}

/// A recorder at work.
struct AtWork {
    thread: thread::JoinHandle<RecordReport>,
    closing: mpsc::Sender<Closing>,
    failures: mpsc::Receiver<RecordError>,
}

impl AtWork {
    fn finish(self, summary: &ServeSummary) -> RecordReport {
        let pairs = [
            ("outcome", "served".to_owned()),
            ("jobs", summary.jobs.to_string()),
            ("commands_accepted", summary.commands_accepted.to_string()),
            ("commands_rejected", summary.commands_rejected.to_string()),
            ("late_cycles", summary.late_cycles.to_string()),
            ("dropped_records", summary.dropped_records.to_string()),
        ];
        let summary: BTreeMap<String, String> = pairs
            .into_iter()
            .map(|(key, value)| (key.to_owned(), value))
            .collect();
        let closing = Closing { summary, alarm: None };
        let _gone = self.closing.send(closing);
        self.thread
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

type Started = (
    Producer<crate::cycle_sample::CycleSample>,
    mpsc::Sender<crate::news::FeederEvent>,
    AtWork,
);

fn start_recording(
    config: &ServeConfig,
    path: &Path,
    further: Option<(TraceSeries, Arc<FileProgress>)>,
    (length, signals): (usize, Option<SignalRecorder>),
    start_unix_ns: u64,
    note: &mut impl FnMut(&str),
) -> Result<Started, StartError> {
    for text in rescue_leftovers(path) {
        note(&text);
    }
    let info = run_info(&config.setup, &RunSource::Served, start_unix_ns);
    let recorder = Recorder::create(path, &info)?;
    if let Some((series, _)) = &further {
        // A folder that cannot be read would have failed before.
        let _left = series.trim(path);
    }
    let (producer, queue) = RingBuffer::new(length);
    let (lines, recorded) = RecorderLines::new();
    let recording = Recording {
        recorder,
        queue,
        signals,
        lines,
        on_full: config.setup.machine.trace.on_full,
        controls: Arc::new(Controls::new(1.0)),
        program: PathBuf::new(),
        further: further.map(|(series, progress)| Further {
            series,
            info,
            progress,
            finishing: Vec::new(),
        }),
    };
    let period_ns = config.setup.period_ns;
    let thread = thread::Builder::new()
        .name("recorder".into())
        .spawn(move || recording.run(period_ns))?;
    let at_work = AtWork {
        thread,
        closing: recorded.closing,
        failures: recorded.failures,
    };
    Ok((producer, recorded.news, at_work))
}
