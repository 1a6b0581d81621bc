//! The threads of a run, each started with its ends of the queues.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::{self, Scope, ScopedJoinHandle};
use std::time::{Duration, Instant};

use evolvent_motion::{PathExecutor, PlanConsumer, PlanProducer};
use evolvent_signals::Scheduler;
use evolvent_trace::Recorder;
use evolvent_turning::{AdaptiveFeed, SimulatedProcess};
use rtrb::{Consumer, Producer, RingBuffer};

use crate::core_loop::CoreLoop;
use crate::corrections::Corrections;
use crate::cycle_sample::CycleSample;
use crate::due_setpoint::DueSetpoint;
use crate::feeder::{FeedReport, Feeder, ToCarrier};
use crate::job::{Clock, Job};
use crate::leftovers::rescue_leftovers;
use crate::memory::ProgramMemory;
use crate::news::FeederEvent;
use crate::observer::RunObserver;
use crate::periphery::Periphery;
use crate::periphery_track::{PeripheryOrder, PeripheryTrack};
use crate::program_cycle::{ObservedCycle, ProgramCycle, ProgramState};
use crate::publish_report::PublishReport;
use crate::publisher::Publisher;
use crate::publishing::Publishing;
use crate::recording::{RecordReport, RecorderLines, Recording};
use crate::refusal::ProgramError;
use crate::rt::apply_to_this_thread;
use crate::run_info::{RunSource, run_info};
use crate::run_report::RunReport;
use crate::run_status::RunStatus;
use crate::shared::Controls;
use crate::signal_loop::SignalLoop;
use crate::signal_port::SignalPort;
use crate::signal_recorder::SignalRecorder;
use crate::spindle_command::SpindleCommands;
use crate::spindle_rundown::SpindleRundown;
use crate::stages::Stages;
use crate::standby::{Standby, needs_load};
use crate::start_error::{CHAIN_TIMEOUT, StartError};
use crate::stop_watch::StopWatch;
use crate::turning_tally::TurningTally;
use crate::user_code::UserCodes;
use crate::user_code_runner::UserCodeRunner;

/// Poll interval of planner and cycle while they wait for each other.
pub(crate) const PLANNER_NAP: Duration = Duration::from_micros(500);
/// Maximum number of user-defined M codes ahead in the plan.
const COMMANDS_AHEAD: usize = 4096;
/// Poll interval of the emergency-stop chain while the run waits for it.
const CHAIN_POLL: Duration = Duration::from_millis(5);
/// Note if a program is held until there is a load.
const AWAITS_LOAD: &str =
    "the program begins when a cutting load is received on the bus and any drives on it follow";

/// Result of planning: its figures, and tools and parameters after a program that was read to its end.
pub(crate) type Fed = (FeedReport, Result<Option<ProgramMemory>, ProgramError>);

/// Starts the threads of one run, and reports notes to the user at once.
pub(crate) struct RunThreads<'a, 'scope, 'env> {
    pub scope: &'scope Scope<'scope, 'env>,
    pub job: &'env Job,
    pub controls: &'a Arc<Controls>,
    pub observer: &'a mut dyn RunObserver,
    /// The notes reported so far.
    pub notes: &'a mut Vec<String>,
    pub start_unix_ns: u64,
}

/// The planner's ends of the queues.
pub(crate) struct PlannerEnds<W> {
    pub plan: PlanProducer<W>,
    pub scheduler: Option<Scheduler>,
    pub periphery: Option<Sender<(u32, Periphery)>>,
    /// Receives every block, modes and program stops, for the status.
    pub onlooker: Option<Sender<FeederEvent>>,
    pub listeners: Vec<Sender<FeederEvent>>,
    /// Whether a recorder receives blocks.
    pub with_blocks: bool,
    pub carrier: Option<(UserCodes, ToCarrier)>,
}

/// The cycle's ends of the queues.
pub(crate) struct CycleEnds {
    pub plan: PlanConsumer,
    pub signals: Option<SignalLoop>,
    /// The actions after which the machine waits until a user-defined M code was carried out.
    pub commands: Option<Consumer<u32>>,
    pub bus: Option<Producer<DueSetpoint>>,
    pub trace: Option<Producer<CycleSample>>,
}

/// The thread that carries out user-defined M codes, and the ends of its queues for planner and cycle.
pub(crate) struct Carrier<'scope> {
    pub thread: ScopedJoinHandle<'scope, Option<String>>,
    pub planner: (UserCodes, ToCarrier),
    pub commands: Consumer<u32>,
}

impl<'scope, 'env> RunThreads<'_, 'scope, 'env> {
    fn note(&mut self, text: &str) {
        self.observer.note(text);
        self.notes.push(text.to_owned());
    }

    /// Opens the bus, and waits for subscribers and the emergency-stop chain if required.
    ///
    /// # Errors
    /// The bus does not open, or the chain is open.
    pub(crate) fn start_publisher(
        &mut self,
        setpoints: Consumer<DueSetpoint>,
        signals: Option<SignalPort>,
        planned: Receiver<(u32, Periphery)>,
        news: Receiver<FeederEvent>,
    ) -> Result<ScopedJoinHandle<'scope, PublishReport>, StartError> {
        let (job, setup) = (self.job, &self.job.setup);
        let (orders, periphery_orders) = mpsc::channel();
        // The only program: the publisher receives no other.
        let _held = orders.send(PeripheryOrder::Program { job: 0, planned });
        let mut publishing = Publishing::new(
            setup,
            job.clock,
            job.bus_prefix.as_deref(),
            Arc::clone(self.controls),
        );
        publishing.wait_for_subscribers = job.wait_for_subscribers;
        publishing.own_subscribers = job.own_subscribers;
        let status = RunStatus::new(job, &publishing, news);
        let publisher = Publisher {
            publishing,
            setpoints,
            periphery: PeripheryTrack::new(setup.tool, periphery_orders),
            spindles: SpindleCommands::new(&setup.machine.signals, setup.period_ns),
            override_off_mask: 0,
            signals,
            stops: StopWatch::start(setup, job.clock)?,
            status,
        };
        let request = job.is_realtime().then(|| setup.realtime_request(1));
        let (publish, opening) = publisher.prepare(request);
        let thread = thread::Builder::new()
            .name("publisher".into())
            .spawn_scoped(self.scope, publish)?;
        let subscribers = opening.wait()?;
        if subscribers < job.wait_for_subscribers {
            self.note(&format!(
                "{subscribers} of {} subscribers connected; the run starts without the others",
                job.wait_for_subscribers
            ));
        }
        if job.is_realtime() && setup.machine.signals.estop.is_some() {
            await_chain(self.controls)?;
        }
        Ok(thread)
    }

    /// Creates the trace and starts the recorder.
    ///
    /// # Errors
    /// The trace cannot be created.
    pub(crate) fn start_recorder(
        &mut self,
        path: &Path,
        queue: Consumer<CycleSample>,
        signals: Option<SignalRecorder>,
        lines: RecorderLines,
    ) -> Result<ScopedJoinHandle<'scope, RecordReport>, StartError> {
        let setup = &self.job.setup;
        for text in rescue_leftovers(path) {
            self.observer.note(&text);
        }
        let info = run_info(setup, &RunSource::Job(self.job), self.start_unix_ns);
        let recording = Recording {
            recorder: Recorder::create(path, &info)?,
            queue,
            signals,
            lines,
            on_full: setup.machine.trace.on_full,
            controls: Arc::clone(self.controls),
            program: self.job.program.clone(),
            further: None,
        };
        let period_ns = setup.period_ns;
        let builder = thread::Builder::new().name("recorder".into());
        Ok(builder.spawn_scoped(self.scope, move || recording.run(period_ns))?)
    }

    /// Starts the thread that carries out user-defined M codes. `None` with the virtual clock, since no
    /// machine is connected.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub(crate) fn start_carrier(
        &self,
        listeners: Vec<Sender<FeederEvent>>,
    ) -> Result<Option<Carrier<'scope>>, StartError> {
        if !self.job.is_realtime() {
            return Ok(None);
        }
        let codes = UserCodes::of(&self.job.setup);
        let (stops, commands) = RingBuffer::new(COMMANDS_AHEAD);
        let (calls, called) = mpsc::channel();
        let runner = UserCodeRunner {
            codes: codes.clone(),
            controls: Arc::clone(self.controls),
            calls: called,
            listeners,
        };
        let builder = thread::Builder::new().name("carrier".into());
        let to_carrier = ToCarrier {
            calls,
            stops,
            controls: Arc::clone(self.controls),
        };
        Ok(Some(Carrier {
            thread: builder.spawn_scoped(self.scope, move || runner.run())?,
            planner: (codes, to_carrier),
            commands,
        }))
    }

    /// Starts the thread that reads and plans the program.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub(crate) fn start_planner<W: FnMut() -> bool + Send + 'scope>(
        &self,
        mut ends: PlannerEnds<W>,
    ) -> Result<ScopedJoinHandle<'scope, Fed>, StartError> {
        let job = self.job;
        let controls = Arc::clone(self.controls);
        let builder = thread::Builder::new().name("planner".into());
        let planner = builder.spawn_scoped(self.scope, move || {
            let (turnings, probings) = (ends.plan.take_processes(), ends.plan.take_probings());
            let threadings = ends.plan.take_threadings();
            let stages = Stages::one(&job.setup, job.feed_override, ends.plan);
            let mut feeder = Feeder::new(
                &job.program,
                &job.setup,
                stages,
                ends.listeners,
                ends.with_blocks,
                job.optional_stop,
            )
            .turning_by(turnings)
            .probing_by(probings)
            .threading_by(threadings)
            .signalling_by(ends.scheduler)
            .periphery_to(ends.periphery)
            .unattended(job.is_realtime() && !job.stop_at_program_stops);
            if let Some(onlooker) = ends.onlooker {
                feeder = feeder.watched_by(onlooker);
            }
            if let Some((codes, carrier)) = ends.carrier {
                feeder = feeder.executing(codes).carried_out_by(carrier);
            }
            feeder.feed(&job.program, || controls.fail_program())
        })?;
        Ok(planner)
    }

    /// Starts the cycle's thread, which waits for the first plan.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub(crate) fn start_cycle<F: FnMut(&ObservedCycle<'_>) + Send + 'scope>(
        &mut self,
        ends: CycleEnds,
        observe: F,
    ) -> Result<ScopedJoinHandle<'scope, RunReport>, StartError> {
        let (job, setup) = (self.job, &self.job.setup);
        let limits = setup.machine.limits();
        let needs_load = needs_load(job, self.controls);
        let core = CoreLoop {
            clock: job.clock,
            period_ns: setup.period_ns,
            lead_cycles: setup.machine.lead_cycles(setup.period_ns),
            max_late_cycles: setup.machine.max_late_cycles(setup.period_ns),
            start_unix_ns: self.start_unix_ns,
            bus: ends.bus,
            trace: ends.trace,
        };
        let set_load = setup
            .process
            .as_ref()
            .map_or(0.0, |process| process.settings.regime.set_load);
        let mut source = ProgramCycle {
            motion: PathExecutor::new(limits, setup.period_ns, limits.home).planned_for(job.feed_override),
            queue: ends.plan,
            controls: Arc::clone(self.controls),
            period_ns: setup.period_ns,
            is_realtime: job.is_realtime(),
            stops_at_program_stops: job.stop_at_program_stops,
            commands: ends.commands,
            signals: ends.signals,
            corrections: Corrections::new(&setup.machine, setup.period_ns, limits.home),
            records_load: setup.process.is_some(),
            process: (job.clock == Clock::Virtual)
                .then(|| SimulatedProcess::new(setup.process.as_ref()?, setup.period_ns as f64 * 1e-9))
                .flatten(),
            standby: Standby::new(needs_load, setup.period_ns).with_drives(setup.machine.drives.feedback),
            adaptive: self
                .controls
                .adaptive()
                .and_then(|settings| AdaptiveFeed::new(settings).ok()),
            rundown: if job.bus && job.is_realtime() {
                SpindleRundown::new(&setup.machine.signals, setup.period_ns)
            } else {
                // With the virtual clock or without the bus, spindles reach their speed at once.
                SpindleRundown::NONE
            },
            observe,
            now: ProgramState::new(TurningTally::new(set_load, setup.period_ns)),
        };
        if needs_load {
            self.observer.note(AWAITS_LOAD);
        }
        let request = job.is_realtime().then(|| setup.realtime_request(0));
        let (granted_sender, granted) = mpsc::channel();
        let builder = thread::Builder::new().name("cycle".into());
        let cycle = builder.spawn_scoped(self.scope, move || {
            // The first cycles must not depend on how fast the plan arrives.
            while !source.motion.is_ready(&mut source.queue) && !source.controls.is_stopping() {
                thread::sleep(PLANNER_NAP);
            }
            if let Some(request) = request {
                let _gone = granted_sender.send(apply_to_this_thread(&request).notes);
            }
            drop(granted_sender);
            let counts = core.run(&mut source);
            // The rest of the plan is not needed.
            source.controls.abandon();
            RunReport::of(counts, source)
        })?;
        for text in granted.iter().flatten() {
            self.note(&text);
        }
        Ok(cycle)
    }
}

/// Waits until the emergency-stop chain is closed, or until a stop.
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
