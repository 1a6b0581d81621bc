//! The control thread's loop: commands, jobs, status, and signs of life.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use evolvent_bus::{ControlServer, Feedback};
use rtrb::Consumer;

use super::calls::Calls;
use super::config::ServeNews;
use super::notify::SystemdNotifier;
use super::operator::Operator;
use super::orders::{CycleEvent, CycleView};
use super::session_trace::SessionTrace;
use super::snapshot::Pulse;
use super::status_writer::StatusWriter;
use crate::job::Setup;
use crate::news::ExternalEventKind;
use crate::pacing::wake_interval_ns;
use crate::publish_report::PublishReport;
use crate::rt::MonotonicClock;

/// Poll interval of the control thread, at most and at least; in between it is a quarter of the period. It
/// bounds the latency of commands on an idle host: a hold takes effect within the lead and two cycles.
pub(super) const CONTROL_EVERY: Duration = Duration::from_micros(500);
const CONTROL_EVERY_AT_LEAST: Duration = Duration::from_micros(100);
/// Poll interval while nothing moves and no job waits: no stop depends on it, and every wake-up of an idle
/// machine takes time of a processor.
const CONTROL_EVERY_IDLE: Duration = Duration::from_millis(1);
/// Maximum number of requests answered in one pass, in addition to those that stop the machine.
const MAX_REQUESTS: usize = 32;
/// Maximum number of unanswered requests: more than all clients together may send.
const MAX_ARRIVED: usize = 1024;
/// The process ends after this time even if the axes have not stopped.
const END_TIMEOUT: Duration = Duration::from_secs(30);

/// Queues from cycle and publisher to the control thread.
pub(super) struct ControlQueues {
    pub views: Consumer<CycleView>,
    pub events: Consumer<CycleEvent>,
    pub answers: Consumer<Feedback>,
    pub counts: Consumer<(PublishReport, usize)>,
}

/// Everything that the control thread owns.
pub(super) struct ControlLoop {
    pub operator: Operator,
    pub server: ControlServer,
    pub queues: ControlQueues,
    pub status: StatusWriter,
    pub trace: Option<SessionTrace>,
    pub manager: SystemdNotifier,
    /// The publisher's counts so far, and the number of its readers.
    pub published: (PublishReport, usize),
    calls: Calls,
    pub pulse: Pulse,
    /// Whether the user was notified of discarded messages about inputs, and about spindles.
    refusal_reported: [bool; 2],
    /// Whether the user was notified of the damaged connection of a client.
    damage_reported: bool,
    next_sign: Instant,
    /// The setpoint at the last watchdog message.
    last_sequence: u64,
}

impl ControlLoop {
    pub(super) fn new(
        operator: Operator,
        server: ControlServer,
        queues: ControlQueues,
        status: StatusWriter,
        trace: Option<SessionTrace>,
        manager: SystemdNotifier,
    ) -> Self {
        Self {
            operator,
            server,
            queues,
            status,
            trace,
            manager,
            published: (PublishReport::default(), 0),
            calls: Calls::default(),
            pulse: Pulse::default(),
            refusal_reported: [false; 2],
            damage_reported: false,
            next_sign: Instant::now(),
            last_sequence: 0,
        }
    }

    /// Runs until the cycle has ended, which `stop` requests, or until it has failed to end in time.
    pub(super) fn run(
        &mut self,
        setup: &Setup,
        stop: &AtomicBool,
        is_cycle_over: impl Fn() -> bool,
        tell: &mut impl FnMut(ServeNews<'_>),
    ) {
        let lead_cycles = setup.machine.lead_cycles(setup.period_ns);
        let every = Duration::from_nanos(wake_interval_ns(setup.period_ns, lead_cycles) / 4)
            .clamp(CONTROL_EVERY_AT_LEAST, CONTROL_EVERY);
        let mut ending: Option<Instant> = None;
        loop {
            let now_ns = MonotonicClock::now_ns();
            self.answer(now_ns, tell);
            while let Ok(count) = self.queues.counts.pop() {
                self.published = count;
            }
            self.tell_refused(tell);
            for caution in self.operator.take_cautions() {
                tell(ServeNews::Note(&caution));
            }
            if let Some(trace) = &mut self.trace {
                trace.poll(&mut self.operator);
            }
            if stop.load(Ordering::Relaxed) && ending.is_none() {
                ending = Some(Instant::now());
                self.manager.tell("STOPPING=1");
                self.operator.end();
            }
            let is_over = is_cycle_over();
            if is_over {
                // Events that the last cycles reported after the previous pass.
                self.poll(now_ns);
            }
            self.status
                .write(&mut self.operator, &self.pulse, &self.published, now_ns, is_over);
            self.give_sign();
            if is_over || ending.is_some_and(|since| since.elapsed() > END_TIMEOUT) {
                return;
            }
            thread::sleep(if self.operator.is_idle() {
                CONTROL_EVERY_IDLE
            } else {
                every
            });
        }
    }

    /// Takes in the reports of the cycle.
    fn poll(&mut self, now_ns: u64) {
        let queues = &mut self.queues;
        let (pulse, period_ns) = (&mut self.pulse, self.operator.setup.period_ns);
        self.operator.tick(
            now_ns,
            &mut queues.views,
            &mut queues.events,
            &mut queues.answers,
            |view| pulse.count(view, period_ns),
        );
    }

    /// Answers requests. Commands are checked against the state after the newest cycle.
    fn answer(&mut self, now_ns: u64, tell: &mut impl FnMut(ServeNews<'_>)) {
        self.poll(now_ns);
        // Receives all waiting requests before it answers any: otherwise clients that send the next request
        // upon each answer would keep others waiting.
        while self.calls.arrived() < MAX_ARRIVED {
            match self.server.receive() {
                Ok(Some(call)) => self.calls.arrive(call),
                Ok(None) => break,
                Err(error) => {
                    // Notified once: repeated notes that nobody reads would fill their pipe and block this
                    // thread.
                    if !std::mem::replace(&mut self.damage_reported, true) {
                        tell(ServeNews::Note(&error.to_string()));
                    }
                    break;
                }
            }
        }
        (self.calls).answer_arrived(&mut self.operator, now_ns, MAX_REQUESTS);
        self.calls.go_on(&mut self.operator, now_ns);
    }

    /// Notifies the user once that messages of bridges are discarded. Nothing else would say why their
    /// signals are unknown.
    fn tell_refused(&mut self, tell: &mut impl FnMut(ServeNews<'_>)) {
        let (inputs, spindles) = (self.published.0.refused_inputs, self.published.0.refused_spindles);
        let faults = [
            inputs.map(|(_, fault)| ("inputs", fault.to_string())),
            spindles.map(|(_, fault)| ("spindles", fault.to_string())),
        ];
        for (is_reported, fault) in self.refusal_reported.iter_mut().zip(faults) {
            let Some((what, fault)) = fault.filter(|_| !*is_reported) else {
                continue;
            };
            *is_reported = true;
            let text = format!(
                "messages of {what} are discarded, because {fault}: their content is unknown; check the \
                 bridge that sends them"
            );
            tell(ServeNews::Note(&text));
            self.operator.record(ExternalEventKind::Warning, 0, text, None);
        }
    }

    /// The watchdog message depends on progress of the cycle, not of this thread alone.
    fn give_sign(&mut self) {
        let sequence = self.operator.view.setpoint.sequence;
        if let Some(every) = self.manager.watchdog
            && Instant::now() >= self.next_sign
            && sequence != self.last_sequence
        {
            self.last_sequence = sequence;
            self.next_sign = Instant::now() + every;
            self.manager.tell("WATCHDOG=1");
        }
    }
}
