//! A served machine: starts the threads, and brings everything to rest at the end.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use evolvent_bus::{BusConfig, ControlServer, Feedback};
use evolvent_drive::{FeedbackWatch, PhaseLock};
use evolvent_motion::{DrivenPath, SetpointGenerator};
use evolvent_signals::ProbeInput;
use rtrb::{Consumer, Producer, RingBuffer};

use super::config::{ServeConfig, ServeNews, TraceTo};
use super::control_loop::{CONTROL_EVERY, ControlLoop, ControlQueues};
use super::files::READING_TIMEOUT;
use super::notify::SystemdNotifier;
use super::operator::{Operator, OperatorConfig};
use super::orders::{CycleEvent, CycleView, Order};
use super::served_cycle::{ServedCycle, ServedParts};
use super::served_status::ServedStatus;
use super::session_trace::SessionTrace;
use super::state_lock::StateLock;
use super::state_store::StateStore;
use super::status_writer::StatusWriter;
use super::summary::ServeSummary;
use super::urgent::UrgentOrders;
use crate::core_loop::{CoreLoop, CycleCounts};
use crate::corrections::Corrections;
use crate::cycle_sample::CycleSample;
use crate::drives::{phase_settings, watch_settings};
use crate::due_setpoint::DueSetpoint;
use crate::job::{Clock, Setup};
use crate::periphery_track::{PeripheryOrder, PeripheryTrack};
use crate::publish_report::PublishReport;
use crate::publisher::Publisher;
use crate::publishing::Publishing;
use crate::queues::queue_length;
use crate::rt::{apply_to_this_thread, raise_priority, separate_large_blocks};
use crate::shared::Controls;
use crate::signal_ends::SignalEnds;
use crate::signal_loop::SignalLoop;
use crate::signal_port::SignalPort;
use crate::spindle_command::SpindleCommands;
use crate::start_error::{CYCLE_TIMEOUT, StartError};
use crate::stop_watch::StopWatch;

/// Length of the queues of snapshots to the publisher, of feedback to cycle and control thread, and of counts
/// back.
const SNAPSHOTS: usize = 64;
const FEEDBACK: usize = 256;
const ANSWERS: usize = 4096;
const COUNTS: usize = 8;
/// Length of the queues of orders to the cycle and of its events.
const ORDERS: usize = 1024;
const EVENTS: usize = 4096;

/// Serves a machine until `stop` is set; then it stops within the limits. `tell` receives messages for the
/// user.
///
/// # Errors
/// The service could not be started; nothing has moved.
pub fn serve(
    config: &ServeConfig,
    stop: &AtomicBool,
    mut tell: impl FnMut(ServeNews<'_>),
) -> Result<ServeSummary, StartError> {
    separate_large_blocks();
    let mut service = Service::start(config, &mut tell)?;
    let control = &mut service.control;
    control.manager.tell("READY=1");
    tell(ServeNews::Ready(
        control.trace.as_ref().map(|trace| trace.file.as_path()),
    ));
    // A hold must not wait until a busy host has time. Threads that this one starts use the normal scheduler.
    raise_priority();
    let cycle = &service.cycle;
    control.run(&config.setup, stop, || cycle.is_finished(), &mut tell);
    Ok(service.end(config))
}

/// A running service.
struct Service {
    control: ControlLoop,
    cycle: JoinHandle<CycleCounts>,
    publisher: JoinHandle<PublishReport>,
    /// Notes to the user during the start.
    notes: Vec<String>,
    /// Held until all files are written.
    _state_lock: StateLock,
}

impl Service {
    fn start(config: &ServeConfig, tell: &mut impl FnMut(ServeNews<'_>)) -> Result<Self, StartError> {
        let setup = &config.setup;
        let machine = &setup.machine;
        let length = queue_length(setup.rate_hz());
        let start_unix_ns = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |since| since.as_nanos() as u64);
        let manager = SystemdNotifier::of_environment();
        let controls = Arc::new(Controls::new(1.0));
        let wants_trace = config.trace != TraceTo::Nowhere;
        let signals = SignalEnds::of_service(setup, wants_trace.then_some(length));

        let (bus, setpoints) = RingBuffer::new(length);
        let (snapshots, to_publish) = RingBuffer::new(SNAPSHOTS);
        let (to_cycle, feedback) = RingBuffer::new(FEEDBACK);
        let (to_control, answers) = RingBuffer::new(ANSWERS);
        let (to_count, counts) = RingBuffer::new(COUNTS);
        let (periphery, periphery_orders) = mpsc::channel();
        let (publisher, bus_config) = start_publisher(
            config,
            &controls,
            PublisherQueues {
                setpoints,
                periphery: periphery_orders,
                signals: signals.port,
                status: ServedStatus {
                    snapshots: to_publish,
                    feedback: to_cycle,
                    answers: to_control,
                    counts: to_count,
                },
            },
        )?;
        let server = ControlServer::open(&bus_config)?;
        let state_lock = StateLock::take(&config.state_folder, &machine.name)?;

        let recorded = (length, signals.recorder);
        let trace = SessionTrace::start(config, recorded, start_unix_ns, &mut |text: &str| {
            tell(ServeNews::Note(text));
        })?;
        let (trace, recorded) = trace.unzip();
        let (cycles, news) = recorded.map(|recorded| (recorded.cycles, recorded.news)).unzip();

        let (orders, cycle_orders) = RingBuffer::new(ORDERS);
        let urgent = Arc::<UrgentOrders>::default();
        let (cycle_events, events) = RingBuffer::new(EVENTS);
        let (cycle_views, mut views) = RingBuffer::new(length);
        let parts = served_parts(
            setup,
            CycleQueues {
                orders: cycle_orders,
                urgent: Arc::clone(&urgent),
                events: cycle_events,
                views: cycle_views,
                feedback,
                signals: signals.cycle,
            },
            controls,
        );
        let (cycle, notes) = start_cycle(setup, parts, start_unix_ns, bus, cycles)?;
        for text in &notes {
            tell(ServeNews::Note(text));
        }

        let view = wait_for_view(&mut views)?;
        let store = StateStore::open(setup.memory.clone(), &config.state_folder);
        for complaint in &store.complaints {
            tell(ServeNews::Note(complaint));
        }
        let operator = Operator::new(OperatorConfig {
            setup: setup.clone(),
            store,
            folder: config.state_folder.clone(),
            orders,
            urgent,
            recorder: news,
            periphery,
            view,
        })
        .map_err(StartError::Modes)?;
        let queues = ControlQueues {
            views,
            events,
            answers,
            counts,
        };
        let status = StatusWriter::new(snapshots);
        Ok(Self {
            control: ControlLoop::new(operator, server, queues, status, trace, manager),
            cycle,
            publisher,
            notes,
            _state_lock: state_lock,
        })
    }

    /// Ends the service when everything is at rest, or has failed to stop in time.
    fn end(self, config: &ServeConfig) -> ServeSummary {
        let ControlLoop {
            mut operator,
            status,
            trace,
            published: (published, _),
            pulse,
            // The service of commands exists until the last file is written, and the manager is notified of
            // the end.
            server: _server,
            manager: _manager,
            ..
        } = self.control;
        let view = operator.view;
        let (accepted, rejected) = operator.state.counts();
        let mut summary = ServeSummary {
            machine: config.setup.machine.name.clone(),
            cycles: view.setpoint.sequence + 1,
            rate_hz: config.setup.rate_hz(),
            jobs: operator.state.job(),
            commands_accepted: accepted,
            commands_rejected: rejected + operator.malformed(),
            late_cycles: view.late_cycles.max(published.late),
            listeners: published.listeners as u64,
            dropped_records: view.dropped_records,
            dropped_setpoints: view.dropped_setpoints + published.failed,
            clock: pulse.phase.figures(),
            alarms: operator.state.alarms().map(|(alarm, _)| alarm.number()).collect(),
            trace: None,
            notes: self.notes,
        };
        operator.store.close(READING_TIMEOUT);
        // The recorder ends when all senders of events are gone, the publisher when the sender of setpoints
        // is gone.
        drop(operator);
        drop(status);
        if !self.cycle.is_finished() {
            let text = "the cycle did not stop in time";
            summary.notes.push(text.to_owned());
            return summary;
        }
        summary.cycles = join(self.cycle).cycles;
        summary.notes.extend(join(self.publisher).refusal_notes());
        if let Some(trace) = trace {
            let record = trace.finish(&summary);
            summary.dropped_records += record.lost;
            match record.result {
                Ok(path) => summary.trace = Some(path.display().to_string()),
                Err(error) => summary.notes.push(error.to_string()),
            }
        }
        summary
    }
}

/// The publisher's ends of the queues from other threads.
struct PublisherQueues {
    setpoints: Consumer<DueSetpoint>,
    periphery: mpsc::Receiver<PeripheryOrder>,
    signals: Option<SignalPort>,
    status: ServedStatus,
}

/// Starts the publisher and waits until the bus is open.
fn start_publisher(
    config: &ServeConfig,
    controls: &Arc<Controls>,
    queues: PublisherQueues,
) -> Result<(JoinHandle<PublishReport>, BusConfig), StartError> {
    let setup = &config.setup;
    let prefix = config.bus_prefix.as_deref();
    let publishing = Publishing::new(setup, Clock::Realtime, prefix, Arc::clone(controls));
    let bus_config = publishing.config.clone();
    let publisher = Publisher {
        publishing,
        setpoints: queues.setpoints,
        periphery: PeripheryTrack::new(setup.tool, queues.periphery),
        spindles: SpindleCommands::new(&setup.machine.signals, setup.period_ns),
        override_off_mask: 0,
        signals: queues.signals,
        stops: StopWatch::start(setup, Clock::Realtime)?,
        status: queues.status,
    };
    let (publish, opening) = publisher.prepare(Some(setup.realtime_request(1)));
    let publisher = thread::Builder::new().name("publisher".into()).spawn(publish)?;
    let _nobody_asked_for = opening.wait()?;
    Ok((publisher, bus_config))
}

/// The cycle's ends of the queues from and to other threads.
struct CycleQueues {
    orders: Consumer<Order>,
    urgent: Arc<UrgentOrders>,
    events: Producer<CycleEvent>,
    views: Producer<CycleView>,
    feedback: Consumer<Feedback>,
    signals: Option<SignalLoop>,
}

/// The parts of the cycle, at the home position.
fn served_parts(setup: &Setup, queues: CycleQueues, controls: Arc<Controls>) -> ServedParts {
    let machine = &setup.machine;
    let limits = machine.limits();
    ServedParts {
        corrections: Corrections::new(machine, setup.period_ns, limits.home),
        probe: ProbeInput::default(),
        generator: SetpointGenerator::new(limits, setup.period_ns, limits.home),
        limits,
        period_ns: setup.period_ns,
        orders: queues.orders,
        urgent: queues.urgent,
        events: queues.events,
        views: queues.views,
        feedback: queues.feedback,
        watch: FeedbackWatch::new(watch_settings(machine, setup.period_ns)),
        signals: queues.signals,
        wheel_counts: machine.handwheel.as_ref().map(|wheel| wheel.counts),
        phase: phase_settings(machine, setup.period_ns).map(PhaseLock::new),
        controls,
        driven: DrivenPath::new(setup.period_ns),
    }
}

/// Starts the cycle. Returns notes about privileges that it could not get.
fn start_cycle(
    setup: &Setup,
    parts: ServedParts,
    start_unix_ns: u64,
    bus: Producer<DueSetpoint>,
    trace: Option<Producer<CycleSample>>,
) -> Result<(JoinHandle<CycleCounts>, Vec<String>), StartError> {
    let core = CoreLoop {
        clock: Clock::Realtime,
        period_ns: setup.period_ns,
        lead_cycles: setup.machine.lead_cycles(setup.period_ns),
        max_late_cycles: setup.machine.max_late_cycles(setup.period_ns),
        start_unix_ns,
        bus: Some(bus),
        trace,
    };
    let (granted_sender, granted) = mpsc::channel();
    let request = setup.realtime_request(0);
    let cycle = thread::Builder::new().name("cycle".into()).spawn(move || {
        let _gone = granted_sender.send(apply_to_this_thread(&request).notes);
        core.run(&mut ServedCycle::new(parts))
    })?;
    Ok((cycle, granted.recv().unwrap_or_default()))
}

/// A panic of a thread is a bug; it is passed on instead of producing a wrong summary.
fn join<T>(thread: JoinHandle<T>) -> T {
    thread
        .join()
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

fn wait_for_view(views: &mut Consumer<CycleView>) -> Result<CycleView, StartError> {
    let deadline = Instant::now() + CYCLE_TIMEOUT;
    loop {
        // The clock is read last: this thread may have been suspended as well.
        let is_over = Instant::now() > deadline;
        if let Ok(view) = views.pop() {
            return Ok(view);
        }
        if is_over {
            return Err(StartError::CycleTimeout);
        }
        thread::sleep(CONTROL_EVERY);
    }
}
