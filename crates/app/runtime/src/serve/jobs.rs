//! Jobs along a plan: planned on their own thread, passed to the cycle when ready.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use evolvent_motion::{PathExecutor, plan_queue};
use evolvent_signals::schedule;

use super::orders::{Following, JobFlags};
use crate::feeder::{FeedReport, Feeder};
use crate::job::Setup;
use crate::memory::ProgramMemory;
use crate::news::FeederEvent;
use crate::periphery::Periphery;
use crate::refusal::ProgramError;
use crate::rt::take_turns;
use crate::stages::Stages;
use crate::switches::{SwitchState, Switching};
use crate::user_code::UserCodes;

/// How long the planner sleeps when the queue is full.
const PLANNER_NAP: Duration = Duration::from_micros(500);

type Planned = (FeedReport, Result<Option<ProgramMemory>, ProgramError>);

/// How to run a program.
pub(crate) struct ProgramJob {
    pub file: PathBuf,
    pub setup: Setup,
    pub feed_override: f64,
    /// The job's number in the trace and for the operator.
    pub job: u32,
    pub number: u64,
    /// The switches for its first line, and their source.
    pub switches: SwitchState,
    pub switching: Switching,
    /// Numbers of the first block and the first action; they continue from job to job.
    pub numbered_from: (u32, u32),
    /// Receives the state of the periphery from each action on.
    pub periphery: Option<Sender<(u32, Periphery)>>,
    /// The trace's recorder, if there is one.
    pub recorder: Option<Sender<FeederEvent>>,
    /// Prefix of the names under which subroutines are attached.
    pub subroutines: String,
    /// Whether user-defined M codes are carried out; otherwise nothing checks whether their files exist.
    pub carries_out: bool,
    /// Whether the planner may use two threads, which give the same plan in less time.
    pub in_two_threads: bool,
}

/// A job's planner.
pub(crate) struct Planning {
    /// The job, until its first pieces are ready.
    waiting: Option<Box<Following>>,
    pub flags: Arc<JobFlags>,
    pub news: Receiver<FeederEvent>,
    thread: Option<JoinHandle<Planned>>,
}

impl Planning {
    /// Starts the planner.
    pub(crate) fn start(job: ProgramJob) -> io::Result<Self> {
        let flags = Arc::new(JobFlags::default());
        let waiting = Arc::clone(&flags);
        let (mut producer, queue) = plan_queue(move || {
            thread::sleep(PLANNER_NAP);
            !waiting.abandoned.load(Ordering::Acquire)
        });
        let setup = &job.setup;
        let motion = PathExecutor::new(setup.machine.limits(), setup.period_ns, setup.start())
            .planned_for(job.feed_override);
        let (turnings, probings) = (producer.take_processes(), producer.take_probings());
        let threadings = producer.take_threadings();
        let (onlooker, news) = mpsc::channel();
        let of_thread = Arc::clone(&flags);
        let (scheduler, schedule) = Some(schedule()).unzip();
        let (number, first_block) = (job.number, job.numbered_from.0);
        let planner = if job.in_two_threads {
            Stages::two(setup, job.feed_override, producer)?
        } else {
            Stages::one(setup, job.feed_override, producer)
        };
        let thread = thread::Builder::new().name("planner".into()).spawn(move || {
            take_turns();
            let with_blocks = job.recorder.is_some();
            let recorders: Vec<_> = job.recorder.into_iter().collect();
            let feeder = Feeder::new(
                &job.file,
                &job.setup,
                planner,
                recorders,
                with_blocks,
                job.switches.optional_stop,
            )
            .turning_by(turnings)
            .probing_by(probings)
            .threading_by(threadings)
            .signalling_by(scheduler)
            .periphery_to(job.periphery)
            .numbered_from(job.numbered_from.0, job.numbered_from.1)
            .attaching_to(job.subroutines)
            .watched_by(onlooker)
            .switched_by(job.switches, job.switching, job.job);
            let feeder = if job.carries_out {
                feeder.executing(UserCodes::of(&job.setup))
            } else {
                feeder
            };
            feeder.feed(&job.file, || of_thread.failed.store(true, Ordering::Release))
        })?;
        Ok(Self {
            waiting: Some(Box::new(Following {
                motion,
                queue,
                flags: Arc::clone(&flags),
                job: number,
                first_block,
                schedule,
            })),
            flags,
            news,
            thread: Some(thread),
        })
    }

    /// Returns the job once, as soon as enough of it is planned to begin.
    pub(crate) fn take_if_ready(&mut self) -> Option<Box<Following>> {
        let job = self.waiting.as_mut()?;
        if job.motion.is_ready(&mut job.queue) {
            return self.waiting.take();
        }
        None
    }

    /// Whether the cycle does not have the job yet.
    pub(crate) fn is_waiting(&self) -> bool {
        self.waiting.is_some()
    }

    /// Tells the planner that the rest of the plan is not needed.
    pub(crate) fn abandon(&mut self) {
        self.flags.abandoned.store(true, Ordering::Release);
        self.waiting = None;
    }

    /// The result of planning, once its thread has ended.
    pub(crate) fn take_result(&mut self) -> Option<Planned> {
        if !self.thread.as_ref()?.is_finished() {
            return None;
        }
        // A panic of the planner is a bug; it is passed on.
        let joined = self.thread.take()?.join();
        Some(joined.unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    }
}

impl Drop for Planning {
    fn drop(&mut self) {
        self.abandon();
    }
}
