//! The cycle of a served machine; it runs until the process ends.

mod away;
mod drives;
mod jobs;
mod notes;
mod orders;
mod power;
mod signals;

use std::sync::Arc;

use evolvent_bus::Feedback;
use evolvent_drive::{FeedbackWatch, PhaseLock, PowerRequest, Presence};
use evolvent_machine::Limits;
use evolvent_motion::{DrivenPath, Excursion, Inputs, Setpoint, SetpointGenerator, TransferExecutor, flags};
use evolvent_path::AxisMask;
use evolvent_signals::ProbeInput;
use evolvent_trace::{PhaseRecord, inputs as recorded};
use rtrb::{Consumer, Producer};

use notes::CycleNotes;
use power::PowerOrders;

use super::orders::{ActiveJob, CycleEvent, CycleView, Order};
use super::urgent::{UrgentOrders, UrgentTaken};
use crate::core_loop::{Computed, CycleBegin, CycleEnd, Next, SetpointSource};
use crate::corrections::Corrections;
use crate::cycle_sample::CycleSample;
use crate::due_setpoint::DriveRequest;
use crate::rt::MonotonicClock;
use crate::shared::Controls;
use crate::signal_loop::SignalLoop;

/// The cycle of a served machine, with everything that its orders control.
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
            stops: ProgramStops::default(),
            notes: CycleNotes::default(),
            relocated: false,
            drive: DriveRequest::OFF,
            faulted: false,
            power_off_at_rest: false,
            stops_for_drives: false,
            power_orders: PowerOrders::default(),
            urgent: UrgentTaken::default(),
            keep_until_ns: 0,
            switches_expected: [AxisMask::NONE; 2],
            presence: Presence::Absent,
            ending: false,
            is_estop: true,
            program: ProgramOfSetpoint::default(),
            is_last: false,
            excursion: None,
            plan_setpoint: None,
        };
        Self { parts, now }
    }

    /// For tests: enters the emergency stop without an order.
    #[cfg(test)]
    pub(in crate::serve) fn fall_into_estop(&mut self) {
        self.now.is_estop = true;
        self.parts.emergency(&mut self.now);
    }

    /// For tests: the guard stops the axes; the drives stay on.
    #[cfg(test)]
    pub(in crate::serve) fn quick_stops(&mut self) {
        self.parts.generator.emergency();
    }
}

/// The cycle's state of the machine and its queues to the other threads, built before it starts.
pub(crate) struct ServedParts {
    pub generator: SetpointGenerator,
    pub limits: Limits,
    pub period_ns: u64,
    pub orders: Consumer<Order>,
    /// Orders that bypass the queue.
    pub urgent: Arc<UrgentOrders>,
    pub events: Producer<CycleEvent>,
    pub views: Producer<CycleView>,
    pub feedback: Consumer<Feedback>,
    pub watch: FeedbackWatch,
    /// Outputs and inputs, if the machine has any.
    pub signals: Option<SignalLoop>,
    /// Corrections of the machine's errors, if there are any.
    pub corrections: Option<Corrections>,
    /// The probe's input for the next setpoint.
    pub probe: ProbeInput,
    /// `None` if the drives' clock is not followed.
    pub phase: Option<PhaseLock>,
    /// Number of the analog input that counts the handwheel's turns, if any.
    pub wheel_counts: Option<u32>,
    /// The newest cutting load.
    pub controls: Arc<Controls>,
    /// The newest part of the path that the program has driven.
    pub driven: DrivenPath,
}

struct Turn {
    after: u64,
    /// Until when the axes may move in this motion. It replaces the deadline of the previous motion only when
    /// the change is applied: a change that is too late must not extend a jog beyond its dead-man switch.
    until_ns: u64,
    id: u64,
    steering: Box<TransferExecutor>,
}

impl Turn {
    fn returned(self) -> CycleEvent {
        CycleEvent::TurnReturned {
            id: self.id,
            work: ActiveJob::Steer(self.steering),
        }
    }
}

/// State that changes from cycle to cycle.
struct CycleState {
    work: ActiveJob,
    /// A change of the steered motion: the setpoint after which it applies, and the number of its order.
    turn: Option<Turn>,
    inputs: Inputs,
    /// Set by the operator.
    spindle_override: f64,
    /// The previous setpoint.
    last: Option<Setpoint>,
    stops: ProgramStops,
    notes: CycleNotes,
    /// The axes were given other coordinates since the last step.
    relocated: bool,
    drive: DriveRequest,
    /// A stop in progress ends in a fault.
    faulted: bool,
    /// The drives lose power when the axes are at rest.
    power_off_at_rest: bool,
    /// An alarm of the drives was reported since power was requested.
    stops_for_drives: bool,
    /// An ON that waits for the drives, and the power requested before.
    power_orders: PowerOrders,
    /// The urgent orders taken so far.
    urgent: UrgentTaken,
    keep_until_ns: u64,
    switches_expected: [AxisMask; 2],
    presence: Presence,
    ending: bool,
    /// In emergency stop: outputs are in their safe state.
    is_estop: bool,
    program: ProgramOfSetpoint,
    /// This is the last cycle.
    is_last: bool,
    /// The axes are away from the held program, or about to leave it.
    excursion: Option<Excursion>,
    /// The program's own setpoint of this cycle while the axes are away.
    plan_setpoint: Option<Setpoint>,
}

/// Program stops, each by the number of actions before it.
#[derive(Clone, Copy, Debug, Default)]
struct ProgramStops {
    /// The stop at which the machine may continue.
    go_on: Option<u32>,
    /// The stop at which it waits.
    at_stop: Option<u32>,
    /// The program continued after a wait with this setpoint.
    has_left_wait: bool,
}

/// The program to which a setpoint belongs.
#[derive(Clone, Copy, Debug, Default)]
struct ProgramOfSetpoint {
    /// Its job, or that of the last program if it belongs to none.
    job: u64,
    /// The setpoint is the last of the program.
    is_end: bool,
}

impl CycleState {
    /// Whether nothing moves the axes.
    fn is_idle(&self) -> bool {
        matches!(self.work, ActiveJob::None)
    }

    /// Whether motion is permitted. An order may have been on its way when the chain opened. Drives without
    /// power follow no setpoint, and those that are about to lose it will soon follow none.
    fn is_ready(&self) -> bool {
        !self.faulted && !self.is_estop && self.drive.power == PowerRequest::On && !self.power_off_at_rest
    }

    fn can_begin(&self) -> bool {
        self.is_idle() && self.is_ready()
    }

    /// Stops whatever moves the axes, within the limits.
    fn stop_work(&mut self) {
        match &mut self.work {
            ActiveJob::None => {}
            ActiveJob::Follow(_) => self.inputs.stop = true,
            ActiveJob::Steer(steering) => steering.stop(),
        }
    }
}

impl SetpointSource for ServedCycle {
    /// The clock of a served machine is always real.
    fn await_plan(&mut self) {}

    fn step(&mut self, begin: &CycleBegin) -> Computed {
        let Self { parts, now } = self;
        let feedback = parts.newest_feedback();
        // Read after the feedback, so the feedback is never later than this time.
        let taken_ns = MonotonicClock::now_ns();
        (now.stops.has_left_wait, now.program.is_end) = (false, false);
        parts.apply_inputs();
        parts.take_orders(now);
        // After the orders: none of them moves anything while the chain is open.
        parts.check_chain(now);
        now.inputs.load = parts.controls.load();
        if let Some(feedback) = &feedback {
            parts.rebase_to_drives(now, feedback, taken_ns);
        }
        parts.carry_out_on(now, taken_ns);
        let mut setpoint = parts.step(now, begin.deadline_ns);
        let of_program = now.plan_setpoint.unwrap_or(setpoint);
        now.last = Some(of_program);
        let corrected = parts.correct(now, &setpoint);
        parts.check_drives(now, &setpoint, corrected.as_ref(), taken_ns, feedback.as_ref());
        now.notes.note_following_error(now.presence, feedback.as_ref());
        let is_switched = parts.set_outputs(now, &of_program);
        if let (ActiveJob::Follow(job), None) = (&now.work, &now.excursion) {
            job.motion.note_driven(&mut parts.driven, &setpoint, is_switched);
        }
        now.is_last = now.ending && now.is_idle() && parts.generator.is_at_rest();
        if now.is_last {
            setpoint.flags |= flags::LAST;
            now.drive.power = PowerRequest::Off;
        }
        now.power_orders
            .record_request(now.drive.power, setpoint.sequence);
        now.notes.phase = feedback
            .filter(|_| now.presence == Presence::Operational)
            .zip(parts.phase.as_ref())
            .map(|(feedback, lock)| PhaseRecord {
                error_ns: feedback.phase_error_ns,
                drift_ppm: 1e6 * lock.drift_ratio(),
                correction_ppm: 1e6 * lock.correction_ratio(),
                is_settled: lock.is_settled(),
            });
        Computed {
            setpoint,
            corrected,
            drive: now.drive,
            job: now.program.job,
            is_of_program: now.notes.input_bits & recorded::FOLLOWS != 0,
            spindle_overrides: parts.counted_overrides(now),
            override_off_mask: parts.override_off_mask(),
            input_bits: now.notes.input_bits,
        }
    }

    fn stop_for_lateness(&mut self, sequence: u64) {
        self.parts.stop_for_lateness(&mut self.now, sequence);
    }

    fn describe(&mut self, sample: &mut CycleSample) {
        let notes = &mut self.now.notes;
        sample.record.following_error = notes.following_error;
        notes.note_load(&mut sample.record, self.now.inputs.load, self.parts.period_ns);
        sample.turning = notes.turned;
        sample.phase = notes.phase;
    }

    fn finish(&mut self, end: &CycleEnd<'_>) -> Next {
        let Self { parts, now } = self;
        // A view that does not fit is superseded by the next one.
        let _full = parts.views.push(CycleView {
            setpoint: *end.setpoint,
            shift: (parts.corrections.as_ref()).map(|corrections| corrections.shift(&end.setpoint.position)),
            lateness_ns: end.lateness_ns,
            work_ns: end.work_ns,
            presence: now.presence,
            power: now.drive.power,
            power_order: now.power_orders.settled(),
            datum: now.drive.datum,
            late_cycles: end.counts.late_cycles,
            dropped_records: end.counts.dropped_records,
            dropped_setpoints: end.counts.dropped_setpoints,
            at_rest: parts.generator.is_at_rest() && now.is_idle(),
            at_wait: parts.signals.as_ref().is_some_and(SignalLoop::is_waiting),
            is_chain_open: parts.signals.as_ref().is_some_and(SignalLoop::is_estop_open),
            probe: parts.signals.as_ref().map(SignalLoop::probe).unwrap_or_default(),
            spindle_overrides: parts.counted_overrides(now),
            handwheel: parts.handwheel(),
            leaving: parts.leaving(now),
            phase: now.notes.phase,
        });
        if now.is_last {
            return Next::End;
        }
        let phase_error_ns = now.notes.phase.map(|phase| phase.error_ns);
        let correction_ns = parts.phase.as_mut().map_or(0, |phase| phase.step(phase_error_ns));
        Next::Cycle { correction_ns }
    }
}

impl ServedParts {
    fn report(&mut self, event: CycleEvent) {
        // The queue is as long as all orders and jobs together, so it is never full while the control thread
        // lives. An event that does not fit must not be dropped here, since that would free memory.
        if let Err(rtrb::PushError::Full(event)) = self.events.push(event) {
            std::mem::forget(event);
        }
    }
}

#[cfg(test)]
mod tests;
