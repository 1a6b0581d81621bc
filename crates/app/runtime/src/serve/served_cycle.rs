//! The cycle of a machine that is served: it never ends before the process does.

use std::sync::Arc;

use evolvent_bus::Feedback;
use evolvent_control::JobResult;
use evolvent_drive::{Command, DriveAlarm, FeedbackWatch, PhaseLock, PowerRequest, Presence};
use evolvent_machine::Limits;
use evolvent_motion::{Inputs, MachineState, Setpoint, State, TransferExecutor, flags};
use evolvent_path::{AXES, Axes, AxisMask, Jet};
use evolvent_signals::{Phase, ProbeInput};
use evolvent_trace::{CycleRecord, inputs as recorded};
use evolvent_turning::Transition;
use rtrb::{Consumer, Producer};

use super::orders::{ActiveJob, CycleCommand, CycleEvent, CycleView, Following, Order};
use crate::core_loop::{Computed, CycleBegin, CycleEnd, Next, SetpointSource};
use crate::corrections::Corrections;
use crate::cycle_sample::{CycleSample, input_bits};
use crate::due_setpoint::DriveRequest;
use crate::handwheel_view::HandwheelView;
use crate::rt::MonotonicClock;
use crate::shared::Controls;
use crate::signal_loop::{SignalLoop, phase_of};
use crate::turning_motion::{turning_fault, turning_output};

/// Orders that one cycle takes at the most; there are never so many.
const MAX_ORDERS: usize = 32;
/// A cutting load that is older than this is none any more.
const LOAD_AGE_NS: u64 = 1_000_000_000;
/// Feedback that one cycle looks through for the newest.
const MAX_FEEDBACK: usize = 256;

/// The cycles of a served machine: whatever its operator asks for.
pub(crate) struct ServedCycle {
    parts: ServedParts,
    now: CycleState,
}

impl ServedCycle {
    /// At rest, the drives without power.
    pub(crate) fn new(parts: ServedParts) -> Self {
        let now = CycleState {
            work: ActiveJob::None,
            turn: None,
            inputs: Inputs::default(),
            spindle_override: 1.0,
            last: None,
            go_on: None,
            at_stop: None,
            input_bits: 0,
            relocated: false,
            drive: DriveRequest::OFF,
            faulted: false,
            power_off_at_rest: false,
            keep_until_ns: 0,
            switches_expected: AxisMask::NONE,
            presence: Presence::Absent,
            ending: false,
            is_estop: true,
            job: 0,
            has_left_wait: false,
            ends_program: false,
            is_last: false,
            phase_error_ns: None,
            following_error: [f64::NAN; AXES],
            load_seen: (0, 0),
            turned: None,
        };
        Self { parts, now }
    }
}

/// What it owns of the machine, and its ways to the other threads; built before it starts.
pub(crate) struct ServedParts {
    pub station: MachineState,
    pub limits: Limits,
    pub period_ns: u64,
    pub orders: Consumer<Order>,
    pub events: Producer<CycleEvent>,
    pub views: Producer<CycleView>,
    pub feedback: Consumer<Feedback>,
    pub watch: FeedbackWatch,
    /// Outputs and inputs, where the machine has any.
    pub signals: Option<SignalLoop>,
    /// Where the machine is not as it should be.
    pub corrections: Option<Corrections>,
    /// What the next setpoint goes by of the probe.
    pub probe: ProbeInput,
    /// None where the drives' clock is not followed.
    pub phase: Option<PhaseLock>,
    /// Number of the analog input that counts the handwheel's turns, where there is one.
    pub wheel_counts: Option<u32>,
    /// The newest cutting load.
    pub controls: Arc<Controls>,
}

struct Turn {
    after: u64,
    id: u64,
    steering: Box<TransferExecutor>,
}

/// What changes from cycle to cycle.
struct CycleState {
    work: ActiveJob,
    /// A change of the steered motion: behind which setpoint, number of the order.
    turn: Option<Turn>,
    inputs: Inputs,
    /// Of the operator.
    spindle_override: f64,
    /// The setpoint before.
    last: Option<Setpoint>,
    /// The program stop at which the machine may go on, and the one at which it stands, by the actions before them.
    go_on: Option<u32>,
    at_stop: Option<u32>,
    /// What the step depended on, as bits of the trace.
    input_bits: u32,
    /// The axes got other coordinates since the last step.
    relocated: bool,
    drive: DriveRequest,
    /// A stop that ends in a fault.
    faulted: bool,
    /// Where it comes to rest the drives lose power.
    power_off_at_rest: bool,
    keep_until_ns: u64,
    switches_expected: AxisMask,
    presence: Presence,
    ending: bool,
    /// In emergency stop: outputs are safe.
    is_estop: bool,
    /// The job to whose program the setpoint belongs, or the last one did.
    job: u64,
    /// The program has gone on behind a wait with this setpoint.
    has_left_wait: bool,
    /// This setpoint is the last of a program.
    ends_program: bool,
    /// The cycle is the last one.
    is_last: bool,
    /// Of the drives' clock with this cycle; none where none was told.
    phase_error_ns: Option<i64>,
    /// As the drives told it last; not a number where none answers.
    following_error: [f64; AXES],
    /// Number of the newest cutting load, and the setpoint with which it was seen first.
    load_seen: (u64, u64),
    /// The change of state of a turning cycle.
    turned: Option<Transition>,
}

impl CycleState {
    /// The cutting load that this cycle went by, for the trace; not a number where a sensor has been silent for long.
    fn note_load(&mut self, record: &mut CycleRecord, period_ns: u64) {
        let Some(newest) = self.inputs.load else { return };
        if newest.sequence != self.load_seen.0 {
            self.load_seen = (newest.sequence, record.sequence);
            record.inputs |= recorded::LOAD;
        }
        if newest.value >= newest.range_max {
            record.inputs |= recorded::LOAD_AT_END;
        }
        let is_old = (record.sequence - self.load_seen.1).saturating_mul(period_ns) > LOAD_AGE_NS;
        record.load = if is_old { f64::NAN } else { newest.value };
    }

    /// What the drives measured, for the trace.
    fn note_following_error(&mut self, feedback: Option<&Feedback>) {
        if self.presence == Presence::Absent {
            self.following_error = [f64::NAN; AXES];
        }
        let Some(feedback) = feedback.filter(|feedback| feedback.is_finite()) else {
            return;
        };
        for (i, error) in self.following_error.iter_mut().enumerate() {
            let is_there = AxisMask::from_bits(feedback.axes_mask).contains(i);
            *error = if is_there {
                feedback.following_error[i]
            } else {
                f64::NAN
            };
        }
    }
}

impl SetpointSource for ServedCycle {
    /// A served machine's time is always real.
    fn await_plan(&mut self) {}

    fn step(&mut self, begin: &CycleBegin) -> Computed {
        let Self { parts, now } = self;
        let feedback = parts.newest_feedback();
        // Read behind the feedback, which so is never of the future by this thread's own doing.
        let taken_ns = MonotonicClock::now_ns();
        (now.has_left_wait, now.ends_program) = (false, false);
        parts.see_inputs();
        parts.take_orders(now);
        // Behind the orders: none of them moves anything while the chain is open.
        parts.check_chain(now);
        now.inputs.load = parts.controls.load();
        if let Some(feedback) = &feedback {
            parts.rebase_to_drives(now, feedback, taken_ns);
        }
        let mut setpoint = parts.step(now, begin.deadline_ns);
        now.last = Some(setpoint);
        let corrected = parts.correct(now, &setpoint);
        parts.check_drives(now, &setpoint, corrected.as_ref(), taken_ns, feedback.as_ref());
        now.note_following_error(feedback.as_ref());
        parts.set_outputs(now, &setpoint);
        now.is_last = now.ending && matches!(now.work, ActiveJob::None) && parts.station.is_at_rest();
        if now.is_last {
            setpoint.flags |= flags::LAST;
            now.drive.power = PowerRequest::Off;
        }
        now.phase_error_ns = feedback
            .filter(|_| now.presence == Presence::Operational)
            .map(|feedback| feedback.phase_error_ns);
        Computed {
            setpoint,
            corrected,
            drive: now.drive,
            job: now.job,
            is_of_program: now.input_bits & recorded::FOLLOWS != 0,
            spindle_override: parts.counted_override(now),
            input_bits: now.input_bits,
        }
    }

    fn stop_for_lateness(&mut self, sequence: u64) {
        self.parts.stop_for_lateness(&mut self.now, sequence);
    }

    fn describe(&mut self, sample: &mut CycleSample) {
        sample.record.following_error = self.now.following_error;
        self.now.note_load(&mut sample.record, self.parts.period_ns);
        sample.turning = self.now.turned;
    }

    fn finish(&mut self, end: &CycleEnd<'_>) -> Next {
        let Self { parts, now } = self;
        // A view that finds no room is followed by another.
        let _full = parts.views.push(CycleView {
            setpoint: *end.setpoint,
            shift: (parts.corrections.as_ref()).map(|corrections| corrections.shift(&end.setpoint.position)),
            lateness_ns: end.lateness_ns,
            work_ns: end.work_ns,
            presence: now.presence,
            power: now.drive.power,
            datum: now.drive.datum,
            late_cycles: end.counts.late_cycles,
            dropped_records: end.counts.dropped_records,
            dropped_setpoints: end.counts.dropped_setpoints,
            at_rest: parts.station.is_at_rest() && matches!(now.work, ActiveJob::None),
            at_wait: parts.signals.as_ref().is_some_and(SignalLoop::is_waiting),
            is_chain_open: parts.signals.as_ref().is_some_and(SignalLoop::is_estop_open),
            probe: parts.signals.as_ref().map(SignalLoop::probe).unwrap_or_default(),
            spindle_override: parts.counted_override(now),
            handwheel: parts.handwheel(),
        });
        if now.is_last {
            return Next::End;
        }
        let phase_error_ns = now.phase_error_ns;
        let correction_ns = parts.phase.as_mut().map_or(0, |phase| phase.step(phase_error_ns));
        Next::Cycle { correction_ns }
    }
}

impl ServedParts {
    fn newest_feedback(&mut self) -> Option<Feedback> {
        let mut newest = None;
        for _ in 0..MAX_FEEDBACK {
            match self.feedback.pop() {
                Ok(feedback) => newest = Some(feedback),
                Err(_) => break,
            }
        }
        newest
    }

    fn tell(&mut self, event: CycleEvent) {
        // The queue is as long as all orders and jobs together: it is never full while control lives. What finds no
        // room anyway must not be dropped here, since dropping frees memory.
        if let Err(rtrb::PushError::Full(event)) = self.events.push(event) {
            std::mem::forget(event);
        }
    }

    /// What the handwheel says.
    fn handwheel(&self) -> HandwheelView {
        match (&self.signals, self.wheel_counts) {
            (Some(signals), Some(counts)) => signals.handwheel(counts),
            _ => HandwheelView::default(),
        }
    }

    /// The spindle override where the program lets it count.
    fn counted_override(&self, now: &CycleState) -> f64 {
        let switches = self.signals.as_ref().map(SignalLoop::overrides);
        if switches.unwrap_or_default().spindle {
            now.spindle_override
        } else {
            1.0
        }
    }

    fn take_orders(&mut self, now: &mut CycleState) {
        for _ in 0..MAX_ORDERS {
            let Ok(order) = self.orders.pop() else { break };
            let reported = !matches!(order.what, CycleCommand::Turn { .. });
            self.take(now, order.id, order.what);
            if reported && order.id > 0 {
                let sequence = self.station.sequence();
                self.tell(CycleEvent::Applied {
                    id: order.id,
                    sequence,
                });
            }
        }
    }

    fn take(&mut self, now: &mut CycleState, id: u64, what: CycleCommand) {
        match what {
            CycleCommand::Follow(mut job) => {
                let free = matches!(now.work, ActiveJob::None) && !now.faulted;
                if free && self.station.hand_to(&mut job.motion) {
                    now.inputs = Inputs {
                        feed_override: now.inputs.feed_override,
                        ..Inputs::default()
                    };
                    (now.go_on, now.at_stop) = (None, None);
                    now.job = job.job;
                    self.begin_schedule(&mut job);
                    now.work = ActiveJob::Follow(job);
                } else {
                    let sequence = self.station.sequence();
                    let work = ActiveJob::Follow(job);
                    self.tell(CycleEvent::Misplaced { sequence, work });
                }
            }
            CycleCommand::Steer(steering) => {
                let free = matches!(now.work, ActiveJob::None) && !now.faulted;
                if free && self.station.can_steer(&steering) {
                    now.work = ActiveJob::Steer(steering);
                } else {
                    let sequence = self.station.sequence();
                    let work = ActiveJob::Steer(steering);
                    self.tell(CycleEvent::Misplaced { sequence, work });
                }
            }
            CycleCommand::Turn { after, steering } => {
                let turn = Turn { after, id, steering };
                if let Some(old) = now.turn.replace(turn) {
                    self.tell(CycleEvent::Returned(ActiveJob::Steer(old.steering)));
                }
            }
            CycleCommand::Hold => now.inputs.hold = true,
            CycleCommand::Resume(stop) => {
                now.inputs.hold = false;
                now.go_on = stop.or(now.go_on);
            }
            CycleCommand::GoOn(stop) => now.go_on = Some(stop),
            CycleCommand::Stop => match &mut now.work {
                ActiveJob::None => {}
                ActiveJob::Follow(_) => now.inputs.stop = true,
                ActiveJob::Steer(steering) => steering.stop(),
            },
            CycleCommand::Override(factor) => {
                now.inputs.feed_override = factor;
                self.station.set_override(factor);
            }
            CycleCommand::SpindleOverride(factor) => now.spindle_override = factor,
            CycleCommand::Emergency => {
                now.is_estop = true;
                self.emergency(now);
            }
            CycleCommand::LeaveEstop => {
                now.is_estop = false;
                if let Some(signals) = &mut self.signals {
                    signals.reset_estop();
                }
            }
            CycleCommand::Outputs(change) => {
                if let Some(signals) = &mut self.signals {
                    signals.set_by_hand(&change);
                }
            }
            CycleCommand::Power(request) => {
                now.drive.power = request;
                now.power_off_at_rest = false;
            }
            CycleCommand::Clear => {
                now.faulted = false;
                now.drive.fault_reset = now.drive.fault_reset.wrapping_add(1);
            }
            CycleCommand::Relocate {
                position,
                limits,
                renames,
            } => {
                if matches!(now.work, ActiveJob::None) && self.station.is_at_rest() {
                    if self.station.position() != position {
                        now.relocated = true;
                        if let Some(corrections) = &mut self.corrections {
                            corrections.relocate(&position);
                        }
                    }
                    self.limits = limits;
                    self.station.relocate(limits, position);
                    now.drive.datum += u64::from(renames);
                }
            }
            CycleCommand::Within(limits) => {
                if matches!(now.work, ActiveJob::None) && self.station.is_at_rest() {
                    self.limits = limits;
                    self.station.relocate(limits, self.station.position());
                }
            }
            CycleCommand::KeepJogging(until_ns) => now.keep_until_ns = until_ns,
            CycleCommand::ExpectSwitches(mask) => now.switches_expected = mask,
            CycleCommand::LatchIndex(request) => now.drive.index = request,
            CycleCommand::End => {
                now.ending = true;
                match &mut now.work {
                    ActiveJob::None => {}
                    ActiveJob::Follow(_) => now.inputs.stop = true,
                    ActiveJob::Steer(steering) => steering.stop(),
                }
            }
        }
    }

    /// Drives without power may be moved by hand: the core stands where they are.
    fn rebase_to_drives(&mut self, now: &mut CycleState, feedback: &Feedback, time_ns: u64) {
        let is_off = now.drive.power == PowerRequest::Off && matches!(now.work, ActiveJob::None);
        let is_believed = self.watch.believes(time_ns, feedback);
        if !is_off || !self.station.is_at_rest() || !is_believed {
            return;
        }
        // A core that was restarted does not know by which names the bridge goes on.
        now.drive.datum = now.drive.datum.max(feedback.datum);
        if feedback.datum != now.drive.datum {
            return;
        }
        let mut position = self.station.position();
        let known = AxisMask::from_bits(feedback.axes_mask);
        let found = match &self.corrections {
            Some(corrections) => corrections.found(&feedback.position, |axis| known.contains(axis)),
            None => Some(Axes::from(std::array::from_fn(|axis| {
                if known.contains(axis) {
                    feedback.position[axis]
                } else {
                    position[axis]
                }
            }))),
        };
        let Some(found) = found else { return };
        let mut moved = false;
        for i in 0..position.len() {
            if found[i] != position[i] {
                position[i] = found[i];
                // Beyond the travel it may stand, and come back.
                self.limits.travel_min[i] = self.limits.travel_min[i].min(position[i]);
                self.limits.travel_max[i] = self.limits.travel_max[i].max(position[i]);
                moved = true;
            }
        }
        if moved {
            now.relocated = true;
            if let Some(corrections) = &mut self.corrections {
                corrections.relocate(&position);
            }
            self.station.relocate(self.limits, position);
        }
    }

    /// Every axis stops by itself; whatever moved them is over.
    fn emergency(&mut self, now: &mut CycleState) {
        self.station.emergency();
        now.drive.power = PowerRequest::QuickStop;
        now.power_off_at_rest = true;
        self.drop_turn(now);
        let work = std::mem::replace(&mut now.work, ActiveJob::None);
        if !matches!(work, ActiveJob::None) {
            now.ends_program = true;
            let sequence = self.station.sequence();
            self.tell(CycleEvent::Ended {
                sequence,
                result: JobResult::Fault,
                work,
            });
        }
    }

    /// What the machine tells counts for the next setpoint.
    fn see_inputs(&mut self) {
        if let Some(signals) = &mut self.signals {
            signals.see_inputs(self.station.sequence(), self.period_ns, None);
            self.probe = signals.take_probe();
        }
    }

    /// An open chain stops everything, and the drives.
    fn check_chain(&mut self, now: &mut CycleState) {
        let is_open = self.signals.as_ref().is_some_and(SignalLoop::is_estopped);
        if is_open && !now.is_estop {
            now.is_estop = true;
            let sequence = self.station.sequence();
            self.tell(CycleEvent::EstopChain { sequence });
            self.emergency(now);
        }
    }

    /// What a program has scheduled is carried out from its first setpoint on.
    fn begin_schedule(&mut self, job: &mut Following) {
        let Some(signals) = &mut self.signals else { return };
        if let Some(schedule) = job.schedule.take() {
            let before = signals.begin_program(schedule, job.first_block);
            if let Some(before) = before {
                self.tell(CycleEvent::Spent(before));
            }
        }
    }

    /// The outputs that count with a setpoint.
    fn set_outputs(&mut self, now: &CycleState, setpoint: &Setpoint) {
        let Some(signals) = &mut self.signals else { return };
        let is_of_program = now.input_bits & recorded::FOLLOWS != 0;
        let phase = if now.is_estop || now.faulted || now.drive.power == PowerRequest::QuickStop {
            Phase::Fault
        } else if is_of_program {
            phase_of(setpoint.state)
        } else {
            Phase::Runs
        };
        if now.has_left_wait {
            signals.go_on();
        }
        signals.step(setpoint, phase);
        if now.ends_program
            && let Some(schedule) = signals.end_program()
        {
            self.tell(CycleEvent::Spent(schedule));
        }
    }

    fn drop_turn(&mut self, now: &mut CycleState) {
        if let Some(turn) = now.turn.take() {
            self.tell(CycleEvent::Returned(ActiveJob::Steer(turn.steering)));
        }
    }

    /// One setpoint of whatever moves the axes.
    fn step(&mut self, now: &mut CycleState, deadline: u64) -> Setpoint {
        now.turned = None;
        now.input_bits = if std::mem::take(&mut now.relocated) {
            recorded::RELOCATED
        } else {
            0
        };
        let mut work = std::mem::replace(&mut now.work, ActiveJob::None);
        let (mut setpoint, result) = match &mut work {
            ActiveJob::None => {
                let state = if now.faulted { State::Fault } else { State::Idle };
                (self.station.rest(state), None)
            }
            ActiveJob::Follow(job) => self.follow(now, job),
            ActiveJob::Steer(steering) => self.steer(now, steering, deadline),
        };
        now.work = work;
        if let Some(violation) = self.station.take_fault()
            && !now.faulted
        {
            now.faulted = true;
            let sequence = setpoint.sequence;
            self.tell(CycleEvent::Guard { sequence, violation });
        }
        if let Some(result) = result {
            let sequence = setpoint.sequence;
            now.ends_program = true;
            self.drop_turn(now);
            let work = std::mem::replace(&mut now.work, ActiveJob::None);
            if !self.station.is_quick_stopping() {
                self.station.end();
            }
            now.inputs.hold = false;
            now.inputs.stop = false;
            self.tell(CycleEvent::Ended {
                sequence,
                result,
                work,
            });
        }
        if now.faulted && matches!(setpoint.state, State::Stopped | State::Stopping) {
            setpoint.state = State::Fault;
        }
        if now.power_off_at_rest && matches!(now.work, ActiveJob::None) && self.station.is_at_rest() {
            now.power_off_at_rest = false;
            now.drive.power = PowerRequest::Off;
        }
        setpoint
    }

    fn follow(&mut self, now: &mut CycleState, job: &mut Following) -> (Setpoint, Option<JobResult>) {
        // It counts for the stop that was meant, and for none behind it.
        let is_meant = now.go_on.is_some() && now.go_on == now.at_stop;
        now.inputs.resume = is_meant && !now.inputs.resume;
        let waiting = self.signals.as_ref().filter(|signals| signals.is_waiting());
        let at_wait = waiting.is_some();
        if let Some(signals) = waiting {
            // Only the wait's end goes on from here.
            now.inputs.resume = signals.is_over() && job.motion.can_leave_wait(&mut job.queue);
        }
        let trouble = self.signals.as_ref().and_then(SignalLoop::spindle_in_trouble);
        now.inputs.stop |= trouble.is_some();
        let before = job.motion.plan_step();
        now.inputs.probe = self.probe;
        if let Some(signals) = &self.signals {
            now.inputs.spindle = signals.spindle_at(job.motion.next_sequence());
        }
        let switches = self.signals.as_ref().map(SignalLoop::overrides);
        let mut inputs = now.inputs.switched_by(&switches.unwrap_or_default());
        let spindle_override = self.counted_override(now);
        if let Some(signals) = &mut self.signals {
            inputs.feed_override *= signals.feed_ratio(now.last.as_ref(), spindle_override);
        }
        let mut setpoint = job.motion.step(&inputs, &mut job.queue);
        now.has_left_wait = at_wait && now.inputs.resume && job.motion.plan_step() != before;
        if let (Some(spindle), false) = (trouble, now.faulted) {
            let sequence = setpoint.sequence;
            self.tell_once(now, CycleEvent::Spindle { sequence, spindle });
        }
        if let (Some(reason), false) = (turning_fault(&job.motion), now.faulted) {
            let sequence = setpoint.sequence;
            self.tell_once(now, CycleEvent::Turning { sequence, reason });
        }
        now.turned = turning_output(&job.motion).and_then(|output| output.transition);
        now.input_bits |= recorded::FOLLOWS | input_bits(&inputs, &job.motion);
        now.at_stop = (setpoint.state == State::ProgramStop).then_some(setpoint.actions);
        self.station.follow(&job.motion, &setpoint);
        if setpoint.state == State::Done && job.flags.has_failed() {
            setpoint.state = State::Stopped;
        }
        if job.motion.is_stuck(&mut job.queue) {
            let sequence = setpoint.sequence;
            self.tell_once(now, CycleEvent::PlannerGone { sequence });
            return (setpoint, Some(JobResult::Fault));
        }
        let result = job.motion.is_over().then(|| match setpoint.state {
            State::Fault => JobResult::Fault,
            _ if now.faulted => JobResult::Fault,
            State::Done => JobResult::Done,
            _ if job.flags.has_failed() => JobResult::Failed,
            _ => JobResult::Stopped,
        });
        (setpoint, result)
    }

    fn steer(
        &mut self,
        now: &mut CycleState,
        steering: &mut TransferExecutor,
        deadline: u64,
    ) -> (Setpoint, Option<JobResult>) {
        if deadline > now.keep_until_ns {
            steering.stop();
        }
        let sequence = self.station.sequence();
        if let Some(turn) = now.turn.take_if(|turn| turn.after < sequence) {
            // Too late for it, the old motion goes on to its own end.
            if turn.after + 1 == sequence && self.station.turn(steering, &turn.steering) {
                self.tell(CycleEvent::Applied {
                    id: turn.id,
                    sequence,
                });
            }
            self.tell(CycleEvent::Returned(ActiveJob::Steer(turn.steering)));
        }
        now.input_bits |= recorded::STEERS;
        if steering.is_stopping() {
            now.input_bits |= recorded::STOP;
        }
        let setpoint = self.station.steer(steering);
        let result = match setpoint.state {
            State::Done => Some(JobResult::Done),
            State::Stopped if now.faulted => Some(JobResult::Fault),
            State::Stopped => Some(JobResult::Stopped),
            _ if self.station.is_quick_stopping() => Some(JobResult::Fault),
            _ => None,
        };
        (setpoint, result)
    }

    fn tell_once(&mut self, now: &mut CycleState, event: CycleEvent) {
        if !now.faulted {
            now.faulted = true;
            self.tell(event);
        }
    }

    /// What the drives are sent for a setpoint.
    fn correct(&mut self, now: &mut CycleState, setpoint: &Setpoint) -> Option<Jet> {
        let corrections = self.corrections.as_mut()?;
        let inputs = self.signals.as_ref().map(SignalLoop::inputs);
        let corrected = corrections.step(setpoint, inputs);
        if let Some(violation) = corrections.take_fault()
            && !now.faulted
        {
            let sequence = setpoint.sequence;
            self.tell_once(now, CycleEvent::Guard { sequence, violation });
            match &mut now.work {
                ActiveJob::None => {}
                ActiveJob::Follow(_) => now.inputs.stop = true,
                ActiveJob::Steer(steering) => steering.stop(),
            }
        }
        Some(corrected)
    }

    fn check_drives(
        &mut self,
        now: &mut CycleState,
        setpoint: &Setpoint,
        corrected: Option<&Jet>,
        time_ns: u64,
        feedback: Option<&Feedback>,
    ) {
        let (position, velocity) = corrected.map_or((setpoint.position, setpoint.velocity), |jet| {
            (jet.position, jet.first)
        });
        let command = Command {
            sequence: setpoint.sequence,
            position: Axes::into(position),
            velocity: Axes::into(velocity),
            datum: now.drive.datum,
            power: now.drive.power,
            fault_reset: now.drive.fault_reset,
            switches_expected: now.switches_expected,
        };
        match self.watch.step(time_ns, &command, feedback) {
            Ok(presence) => now.presence = presence,
            Err(alarm) => self.stop_for_drives(now, setpoint.sequence, alarm),
        }
        let axes = self.watch.take_reference_lost();
        if !axes.is_empty() {
            let sequence = setpoint.sequence;
            self.tell(CycleEvent::ReferenceLost { sequence, axes });
        }
    }

    fn stop_for_drives(&mut self, now: &mut CycleState, sequence: u64, alarm: DriveAlarm) {
        if now.drive.power != PowerRequest::On {
            return;
        }
        let known = now.faulted;
        self.tell_once(now, CycleEvent::Drive { sequence, alarm });
        if !alarm.drives_follow() {
            self.emergency(now);
        } else if !known {
            now.power_off_at_rest = true;
            match &mut now.work {
                ActiveJob::None => {}
                ActiveJob::Follow(_) => now.inputs.stop = true,
                ActiveJob::Steer(steering) => steering.stop(),
            }
        }
    }

    fn stop_for_lateness(&mut self, now: &mut CycleState, sequence: u64) {
        if matches!(now.work, ActiveJob::None) {
            return;
        }
        self.tell_once(now, CycleEvent::Late { sequence });
        match &mut now.work {
            ActiveJob::None => {}
            ActiveJob::Follow(_) => now.inputs.stop = true,
            ActiveJob::Steer(steering) => steering.stop(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use evolvent_counting::{CountingAllocator, calls};
    use evolvent_drive::WatchSettings;
    use evolvent_machine::{Machine, SignalKind, SignalSettings};
    use evolvent_signals::{Change, InputImage, Moment, Signals};
    use evolvent_transfer::{AxesState, Sync, Transfer};
    use rtrb::RingBuffer;

    use super::*;
    use crate::core_loop::CoreLoop;
    use crate::job::Clock;
    use crate::signal_loop::InputSource;

    #[global_allocator]
    static ALLOCATOR: CountingAllocator = CountingAllocator;

    /// Calls of the allocator by a cycle that drives so many jogs, each with a turn that comes too late, renamings, an
    /// override and feedback of every cycle.
    fn calls_during(jogs: u64) -> (u64, u64) {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let text = std::fs::read_to_string(file).unwrap();
        let text = text.replacen("letter = \"X\"", "letter = \"X\"\nbacklash_mm = 0.02", 1);
        let machine = Machine::parse(&text, "backlash.toml").unwrap();
        let limits = machine.limits();
        let period_ns = 250_000;
        let (mut orders, cycle_orders) = RingBuffer::new(64);
        let (cycle_events, mut events) = RingBuffer::new(4096);
        let (cycle_views, mut views) = RingBuffer::new(4096);
        let (mut to_cycle, feedback) = RingBuffer::new(256);
        let (bus, _setpoints) = RingBuffer::new(64);
        let (trace, _records) = RingBuffer::new(64);
        let core = CoreLoop {
            clock: Clock::Realtime,
            period_ns,
            lead_cycles: 2,
            max_late_cycles: 0,
            start_unix_ns: 0,
            bus: Some(bus),
            trace: Some(trace),
        };
        let parts = ServedParts {
            station: MachineState::new(limits, period_ns, limits.home),
            limits,
            period_ns,
            orders: cycle_orders,
            events: cycle_events,
            views: cycle_views,
            feedback,
            watch: FeedbackWatch::new(WatchSettings::new(period_ns, AxisMask::NONE)),
            signals: None,
            corrections: Corrections::new(&machine, period_ns, limits.home),
            probe: ProbeInput::default(),
            wheel_counts: None,
            phase: None,
            controls: Arc::new(Controls::new(1.0)),
        };
        let cycle = std::thread::spawn(move || {
            let before = calls();
            let counts = core.run(&mut ServedCycle::new(parts));
            (calls() - before, counts.cycles)
        });
        let mut give = |what| assert!(orders.push(Order { id: 1, what }).is_ok(), "no room");
        give(CycleCommand::KeepJogging(u64::MAX));
        let mut at = limits.home;
        let (mut ended, mut begun) = (0, 0);
        while ended < jogs {
            while let Ok(view) = views.pop() {
                at = view.setpoint.position;
                // Feedback that nobody needs is read all the same.
                let _full = to_cycle.push(Feedback::default());
            }
            while let Ok(event) = events.pop() {
                match event {
                    CycleEvent::Ended { .. } => ended += 1,
                    // The view was older than the event: once more.
                    CycleEvent::Misplaced { .. } => begun = ended,
                    _ => {}
                }
            }
            if begun == ended && begun < jogs && views.is_empty() {
                begun += 1;
                let mut to = at;
                to[0] = if begun % 2 == 1 { 2.0 } else { 0.0 };
                let from = AxesState::at_rest(at);
                let solved = Transfer::solve(&limits, &from, &AxesState::at_rest(to), Sync::Time).unwrap();
                let steering = TransferExecutor::new(solved);
                give(CycleCommand::Override(0.5));
                give(CycleCommand::Relocate {
                    position: at,
                    limits,
                    renames: false,
                });
                give(CycleCommand::Steer(Box::new(steering)));
                give(CycleCommand::Turn {
                    after: 0,
                    steering: Box::new(steering),
                });
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        give(CycleCommand::End);
        cycle.join().unwrap()
    }

    #[test]
    fn the_cycle_allocates_and_frees_nothing_however_long_it_runs_and_whatever_it_drives() {
        let (few, _) = calls_during(1);
        let (many, cycles) = calls_during(12);
        assert!(cycles > 500, "{cycles} cycles prove nothing");
        assert_eq!(few, many, "calls of the allocator");
    }

    /// A machine with a chain on input 0 and a clamp, safe when it is on, on output 0.
    fn settings() -> SignalSettings {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let text = std::fs::read_to_string(file).unwrap();
        let signals = "[[input]]\nname = \"chain\"\nnumber = 0\n[[output]]\nname = \"clamp\"\nnumber = 0\nsafe_on = true\n\
                       [estop]\ninput = \"chain\"\n";
        let machine = Machine::parse(&format!("{text}{signals}"), "signals.toml").unwrap();
        machine.signals
    }

    /// The control thread sleeps: nobody takes events or views, and no order comes.
    #[test]
    fn an_open_chain_stops_axes_drives_and_outputs_with_the_next_setpoint_whoever_sleeps() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let limits = Machine::load(&file).unwrap().limits();
        let period_ns = 1_000_000;
        let settings = settings();
        let (mut orders, cycle_orders) = RingBuffer::new(64);
        let (cycle_events, mut events) = RingBuffer::new(64);
        let (cycle_views, _views) = RingBuffer::new(1);
        let (_to_cycle, feedback) = RingBuffer::new(1);
        let (mut inputs, samples) = RingBuffer::new(16);
        let (changes, mut outputs) = RingBuffer::new(64);
        let source = InputSource::Bus(samples);
        let signals = SignalLoop::new(
            Signals::new(&settings, 2, 1_000_000),
            source,
            Some(changes),
            None,
            true,
        );
        let mut cycle = ServedCycle::new(ServedParts {
            station: MachineState::new(limits, period_ns, limits.home),
            limits,
            period_ns,
            orders: cycle_orders,
            events: cycle_events,
            views: cycle_views,
            feedback,
            watch: FeedbackWatch::new(WatchSettings::new(period_ns, AxisMask::NONE)),
            signals: Some(signals),
            corrections: None,
            probe: ProbeInput::default(),
            wheel_counts: None,
            phase: None,
            controls: Arc::new(Controls::new(1.0)),
        });
        let mut image = InputImage::default();
        image.set(SignalKind::Digital, 0, Some(1.0));
        inputs.push(image).unwrap();
        let mut to = limits.home;
        to[0] += 100.0;
        let from = AxesState::at_rest(limits.home);
        let way = Transfer::solve(&limits, &from, &AxesState::at_rest(to), Sync::Time).unwrap();
        let mut clamp = Change::at(Moment::Rest(0));
        clamp.set_digital(0, false);
        for what in [
            CycleCommand::LeaveEstop,
            CycleCommand::Power(PowerRequest::On),
            CycleCommand::Outputs(clamp),
            CycleCommand::KeepJogging(u64::MAX),
            CycleCommand::Steer(Box::new(TransferExecutor::new(way))),
        ] {
            assert!(orders.push(Order { id: 0, what }).is_ok(), "no room");
        }
        let mut step = |number: u64| {
            cycle.step(&CycleBegin {
                number,
                deadline_ns: number * period_ns,
            })
        };
        let before = (0..200).map(&mut step).last().unwrap();
        assert!(before.setpoint.velocity[0] > 10.0, "{:?}", before.setpoint);
        assert_eq!(before.drive.power, PowerRequest::On);
        let open: Vec<_> = std::iter::from_fn(|| outputs.pop().ok()).collect();
        assert_eq!(open.last().map(|due| due.outputs.digital), Some(0));
        image.set(SignalKind::Digital, 0, Some(0.0));
        inputs.push(image).unwrap();
        let first = step(200);
        assert_eq!(first.drive.power, PowerRequest::QuickStop);
        let safe = outputs.pop().unwrap();
        assert_eq!(
            (safe.sequence, safe.outputs.digital),
            (first.setpoint.sequence, 1)
        );
        let stopping: Vec<_> = (201..1200).map(step).collect();
        let speeds = || stopping.iter().map(|computed| computed.setpoint.velocity[0]);
        assert!(speeds().all(|speed| speed <= first.setpoint.velocity[0] + 1e-9));
        let last = stopping.last().unwrap();
        assert_eq!(
            (last.setpoint.velocity[0], last.drive.power),
            (0.0, PowerRequest::Off)
        );
        let told: Vec<_> = std::iter::from_fn(|| events.pop().ok()).collect();
        let chain = told
            .iter()
            .filter(|event| matches!(event, CycleEvent::EstopChain { .. }));
        assert_eq!(chain.count(), 1);
    }
}
