//! The cycle's thread: the loop around `PathExecutor::step`.
//!
//! Once it runs it allocates nothing, locks nothing, and waits for nothing but its deadline (the virtual clock
//! also waits for the planner and for room in the queues, because its time is not real).

use std::sync::Arc;

use evolvent_motion::{Inputs, PathExecutor, PlanConsumer, Setpoint, State, flags};
use evolvent_path::AXES;
use evolvent_trace::{CycleRecord, Histogram, inputs as recorded};
use evolvent_turning::{
    AdaptiveFeed, AdaptiveStop, CutNow, LoadSample, Reason, SimulatedProcess, Transition, TurningOutput,
};
use rtrb::{Consumer, Producer};

use crate::job::Clock;
use crate::pacing::{LatenessCounter, Pacing, RealTimer};
use crate::rt::MonotonicClock;
use crate::shared::Controls;
use crate::signal_loop::SignalLoop;
use crate::standby::{NotBegun, Standby};
use crate::turning_tally::TurningTally;
use evolvent_control::Alarm;
use evolvent_drive::PowerRequest;

/// Cycles that a virtual run may spin on a full queue before it lets another thread run.
const SPINS: u32 = 64;

/// A setpoint on its way to the bus.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DueSetpoint {
    pub setpoint: Setpoint,
    pub due_time_ns: u64,
    pub drive: DriveRequest,
}

/// What is asked of the drives beside the setpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DriveRequest {
    pub power: PowerRequest,
    pub fault_reset: u32,
    pub datum: u64,
}

impl DriveRequest {
    /// Follow.
    pub(crate) const ON: Self = Self {
        power: PowerRequest::On,
        fault_reset: 0,
        datum: 0,
    };
}

/// A cycle on its way to the trace.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CycleSample {
    pub record: CycleRecord,
    pub block: u32,
    pub actions: u32,
    /// The change of state of a turning cycle.
    pub turning: Option<Transition>,
}

impl CycleSample {
    /// Blocks begun up to here; 0 where nothing moves.
    pub(crate) fn blocks_begun(&self) -> u32 {
        let still = [State::Idle, State::Dwell, State::ProgramStop].map(|state| state as u8);
        if still.contains(&self.record.state) {
            0
        } else {
            self.block + 1
        }
    }
}

/// Everything the loop needs; built before it starts.
pub(crate) struct CycleLoop {
    pub queue: PlanConsumer,
    pub controls: Arc<Controls>,
    pub clock: Clock,
    pub period_ns: u64,
    pub lead_cycles: u32,
    /// Stop after so many late setpoints in a row; 0 for never.
    pub max_late_cycles: u32,
    /// Wait at program stops until told to go on; otherwise stand there for one cycle.
    pub stop_at_program_stops: bool,
    /// The actions before stops at which a command of the machine's own is carried out, in order; none where nothing is.
    pub commands: Option<Consumer<u32>>,
    /// Outputs and inputs, where the machine has any.
    pub signals: Option<SignalLoop>,
    pub bus: Option<Producer<DueSetpoint>>,
    pub trace: Option<Producer<CycleSample>>,
    /// Unix time of the first setpoint.
    pub start_unix_ns: u64,
    /// A load is measured, and recorded.
    pub records_load: bool,
    /// The workpiece that the setpoints cut: with the virtual clock, whose load no sensor measures.
    pub process: Option<SimulatedProcess>,
    /// Holds a program that needs a load until there is one.
    pub standby: Standby,
    /// Counts what turning cycles do.
    pub turning: TurningTally,
}

/// One cycle, for who looks on.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// The setpoint.
    pub setpoint: &'a Setpoint,
    /// What a turning cycle gave out, where one moves the axes.
    pub turning: Option<&'a TurningOutput>,
    /// What the simulated workpiece lost, where there is one.
    pub cut: Option<CutNow>,
}

/// What the loop counted.
pub(crate) struct CycleReport {
    pub motion: PathExecutor,
    pub last: Option<Setpoint>,
    pub cycles: u64,
    pub late_cycles: u64,
    pub dropped_records: u64,
    pub dropped_setpoints: u64,
    pub starved_cycles: u64,
    pub stopped_for_lateness: bool,
    pub planner_died: bool,
    /// Why adaptive feed has stopped the run.
    pub adaptive_stop: Option<AdaptiveStop>,
    /// The emergency-stop chain was opened, or not closed.
    pub estopped: bool,
    /// Why the program was not begun.
    pub not_begun: Option<NotBegun>,
    /// What turning cycles came to.
    pub turning: TurningTally,
    /// The plan ended before the program did.
    pub program_failed: bool,
    /// The simulated workpiece as it is left.
    pub process: Option<SimulatedProcess>,
    /// Program stops at which nobody was waited for.
    pub program_stops_passed: u64,
    pub lateness: Histogram,
    pub work: Histogram,
}

impl CycleLoop {
    /// Runs to the end of the plan, a stop or a fault. `observe` sees every setpoint (offline planning).
    pub(crate) fn run(mut self, motion: PathExecutor, mut observe: impl FnMut(&Seen<'_>)) -> CycleReport {
        let mut report = CycleReport {
            motion,
            last: None,
            cycles: 0,
            late_cycles: 0,
            dropped_records: 0,
            dropped_setpoints: 0,
            starved_cycles: 0,
            stopped_for_lateness: false,
            planner_died: false,
            adaptive_stop: None,
            estopped: false,
            not_begun: None,
            turning: self.turning,
            process: None,
            program_failed: false,
            program_stops_passed: 0,
            lateness: Histogram::default(),
            work: Histogram::default(),
        };
        let realtime = self.clock == Clock::Realtime;
        let mut pacing = Pacing::new(MonotonicClock::now_ns(), self.period_ns, self.lead_cycles);
        let mut late = LatenessCounter::new(self.max_late_cycles);
        let mut resumed = false;
        let (mut simulated, mut load_before) = (None, None);
        let mut adaptive = self
            .controls
            .adaptive()
            .and_then(|settings| AdaptiveFeed::new(settings).ok());
        loop {
            let path_time = report.cycles * self.period_ns;
            let paced = realtime.then(|| pacing.wait(&mut RealTimer));
            pacing.advance(0);
            let lateness = paced.map_or(0, |cycle| cycle.lateness_ns);
            if paced.is_none() {
                let (motion, queue, controls) = (&report.motion, &mut self.queue, &self.controls);
                wait_until(|| motion.is_ready(queue) || (controls.is_stopping() && motion.is_at_rest()));
            }
            let mut inputs = self.controls.inputs();
            if self.process.is_some() {
                inputs.load = simulated;
            }
            match self.standby.step(&self.controls) {
                Ok(held) => inputs.hold |= held,
                Err(why) => {
                    report.not_begun.get_or_insert(why);
                    inputs.stop = true;
                    self.controls.raise(Alarm::LoadSensor);
                }
            }
            inputs.stop |= report.stopped_for_lateness;
            let command = at_command(&mut self.commands, &report);
            let mut at_wait = false;
            if let Some(signals) = &mut self.signals {
                signals.see_inputs(report.cycles, self.period_ns, report.last.as_ref());
                if signals.is_estopped() && !report.estopped {
                    report.estopped = true;
                    self.controls.raise(Alarm::EmergencyStopChain);
                }
                inputs.stop |= report.estopped;
                at_wait = signals.is_waiting();
                if signals.is_over() {
                    let (motion, queue) = (&report.motion, &mut self.queue);
                    if !realtime && motion.state() == State::ProgramStop && !inputs.stop {
                        // The planner reads on with the result: what follows must not depend on how fast it is.
                        wait_until(|| motion.can_leave_wait(queue) || queue.is_abandoned());
                    }
                    inputs.resume = motion.can_leave_wait(queue);
                }
            }
            if at_wait {
                // Only the wait's end goes on from here.
            } else if let Some(action) = command {
                inputs.resume = !resumed && self.controls.is_command_done(action);
            } else if !self.stop_at_program_stops {
                // In the cycle itself, so that a run with the virtual clock takes the same cycles each time.
                inputs.resume = !resumed && report.motion.state() == State::ProgramStop;
                report.program_stops_passed += u64::from(inputs.resume);
            }
            resumed = inputs.resume;
            if let Some(adaptive) = &mut adaptive {
                let driven = report.motion.feed_factor();
                let stop = adapt(adaptive, driven, report.last.as_ref(), &mut inputs);
                report.adaptive_stop = report.adaptive_stop.or(stop);
                inputs.stop |= report.adaptive_stop.is_some();
            }
            let before = report.motion.plan_step();
            let mut setpoint = report.motion.step(&inputs, &mut self.queue);
            let has_left = at_wait && inputs.resume && report.motion.plan_step() != before;
            if setpoint.state == State::Done && self.controls.has_program_failed() {
                setpoint.state = State::Stopped;
                report.program_failed = true;
                self.controls.raise(Alarm::Program);
            }
            if report.motion.fault().is_some() {
                self.controls.raise(Alarm::Guard);
            }
            if let Some(reason) = report.motion.turning_fault() {
                self.controls.raise(turning_alarm(&reason));
            }
            if report.motion.is_stuck(&mut self.queue) {
                setpoint.state = State::Fault;
                setpoint.flags |= flags::LAST;
                report.planner_died = true;
                self.controls.raise(Alarm::Planner);
            }
            let mut work = 0;
            if let Some(cycle) = paced {
                let now = MonotonicClock::now_ns();
                work = now.saturating_sub(cycle.begun_ns);
                report.lateness.record(lateness as i64);
                if late.count(&cycle, now) {
                    setpoint.flags |= flags::LATE;
                }
                if late.is_too_late() {
                    report.stopped_for_lateness = true;
                    self.controls.raise(Alarm::Lateness);
                }
            }
            if setpoint.flags & flags::STARVED != 0 {
                report.starved_cycles += 1;
            }
            if let Some(signals) = &mut self.signals {
                if has_left {
                    signals.go_on();
                }
                signals.step(&setpoint);
            }
            if let Some(bus) = &mut self.bus {
                let due_time_ns = paced.map_or(path_time, |cycle| cycle.due_ns);
                let due = DueSetpoint {
                    setpoint,
                    due_time_ns,
                    drive: DriveRequest::ON,
                };
                if !hand_over(bus, due, realtime) {
                    report.dropped_setpoints += 1;
                }
            }
            if let Some(trace) = &mut self.trace {
                let due_unix_ns = self.start_unix_ns + path_time;
                let mut sample = sample(
                    &setpoint,
                    due_unix_ns,
                    lateness,
                    work,
                    input_bits(&inputs, &report.motion),
                );
                if self.records_load || adaptive.is_some() {
                    let turning = report.motion.turning().and_then(|output| output.transition);
                    note_turning(&mut sample, turning, inputs.load, &mut load_before);
                }
                if !hand_over(trace, sample, realtime) {
                    report.dropped_records += 1;
                }
            }
            let cut = self.process.as_mut().map(|process| {
                let (cut, sample) = process.step(setpoint.position[0], setpoint.position[2]);
                simulated = sample;
                cut
            });
            report.turning.see(report.motion.turning(), cut.as_ref());
            observe(&Seen {
                setpoint: &setpoint,
                turning: report.motion.turning(),
                cut,
            });
            let stands = setpoint.state == State::ProgramStop;
            let next = self.commands.as_ref().and_then(|commands| commands.peek().ok());
            let at_command = stands && next.is_some_and(|action| action + 1 == setpoint.actions);
            let at_wait = self.signals.as_ref().is_some_and(SignalLoop::is_waiting);
            self.controls.set_at_command(at_command || at_wait);
            self.controls.publish(&setpoint);
            if let Some(cycle) = paced {
                // With the handing over, which the cycle's own record cannot know yet.
                let whole = MonotonicClock::now_ns().saturating_sub(cycle.begun_ns);
                report.work.record(whole as i64);
            }
            report.cycles += 1;
            report.last = Some(setpoint);
            if report.motion.is_over() || report.planner_died {
                break;
            }
        }
        report.late_cycles = late.total();
        report.dropped_records += self.signals.as_ref().map_or(0, |signals| signals.lost);
        self.controls.abandon();
        report.process = self.process;
        report
    }
}

/// The action before the command at which the machine stands, if it stands at one. Commands that lie behind are forgotten.
fn at_command(commands: &mut Option<Consumer<u32>>, report: &CycleReport) -> Option<u32> {
    let (commands, last) = (commands.as_mut()?, report.last.as_ref()?);
    while commands.peek().is_ok_and(|action| action + 1 < last.actions) {
        let _behind = commands.pop();
    }
    let next = *commands.peek().ok()?;
    (last.state == State::ProgramStop && next + 1 == last.actions).then_some(next)
}

/// Lets the cutting load scale the feed. Rapids are left alone; the operator's override counts below 100 % only, so that
/// the set load holds.
fn adapt(
    adaptive: &mut AdaptiveFeed,
    driven: Option<f64>,
    last: Option<&Setpoint>,
    inputs: &mut Inputs,
) -> Option<AdaptiveStop> {
    let feeds = last.is_some_and(|last| last.state == State::Running && last.flags & flags::RAPID == 0);
    let driven = driven.or(last.map(|last| last.feed_override)).unwrap_or_default();
    let output = adaptive.step(inputs.load, driven, feeds);
    inputs.feed_override = inputs.feed_override.min(1.0) * output.factor;
    output.stop
}

/// The alarm of a turning cycle that has given up.
pub(crate) fn turning_alarm(reason: &Reason) -> Alarm {
    match reason {
        Reason::Sensor(_) => Alarm::LoadSensor,
        _ => Alarm::CuttingLoad,
    }
}

/// In real time what finds no room is dropped; in virtual time there is time to wait.
fn hand_over<T: Copy>(queue: &mut Producer<T>, item: T, realtime: bool) -> bool {
    if !realtime {
        wait_until(|| !queue.is_full() || queue.is_abandoned());
    }
    queue.push(item).is_ok()
}

pub(crate) fn wait_until(mut ready: impl FnMut() -> bool) {
    let mut spins = 0;
    while !ready() {
        spins += 1;
        if spins < SPINS {
            std::hint::spin_loop();
        } else {
            std::thread::yield_now();
        }
    }
}

/// What the step depended on beside plan and override, as bits of the trace.
pub(crate) fn input_bits(inputs: &Inputs, motion: &PathExecutor) -> u32 {
    let bits = [
        (inputs.hold, recorded::HOLD),
        (inputs.stop, recorded::STOP),
        (inputs.resume, recorded::RESUME),
        (motion.has_waited(), recorded::WAITED),
        (motion.was_refused(), recorded::REFUSED),
    ];
    bits.into_iter()
        .filter(|(set, _)| *set)
        .fold(0, |sum, (_, bit)| sum | bit)
}

pub(crate) fn sample(
    setpoint: &Setpoint,
    due_unix_ns: u64,
    lateness: u64,
    work: u64,
    inputs: u32,
) -> CycleSample {
    CycleSample {
        record: CycleRecord {
            sequence: setpoint.sequence,
            due_time_ns: due_unix_ns,
            wake_lateness_ns: lateness as i64,
            work_ns: work.min(u64::from(u32::MAX)) as u32,
            path_mm: setpoint.path_mm,
            feed_mm_s: setpoint.feed_mm_s,
            position: setpoint.position.into(),
            velocity: setpoint.velocity.into(),
            acceleration: setpoint.acceleration.into(),
            jerk: setpoint.jerk.into(),
            line: setpoint.line,
            state: setpoint.state as u8,
            flags: setpoint.flags,
            override_: setpoint.feed_override,
            load: f64::NAN,
            inputs,
            following_error: [f64::NAN; AXES],
        },
        block: setpoint.block,
        actions: setpoint.actions,
        turning: None,
    }
}

/// Adds what a turning cycle went by and did to a sample. `before` is the reading of the cycle before.
pub(crate) fn note_turning(
    sample: &mut CycleSample,
    turning: Option<Transition>,
    load: Option<LoadSample>,
    before: &mut Option<LoadSample>,
) {
    sample.turning = turning;
    let was = std::mem::replace(before, load);
    let Some(load) = load else { return };
    sample.record.load = load.value;
    if was.is_none_or(|was| was.sequence != load.sequence) {
        sample.record.inputs |= recorded::LOAD;
    }
    if load.value >= load.range_max {
        sample.record.inputs |= recorded::LOAD_AT_END;
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::mpsc;
    use std::time::Duration;

    use evolvent_machine::Machine;
    use evolvent_motion::plan_queue;
    use evolvent_path::{Axes, Curve, Line};
    use evolvent_planner::{PlanSink, Run, ScalarLimits, Segment, SegmentMarks, Step};

    use super::*;

    #[test]
    fn a_planner_that_dies_before_its_steps_are_final_ends_the_run_with_a_fault() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let limits = Machine::load(&file).unwrap().limits();
        let (mut producer, queue) = plan_queue(|| true);
        let mut to = Axes::zeros();
        to[0] = 10.0;
        let segment = Segment {
            curve: Curve::Line(Line::new(Axes::zeros(), to).unwrap()),
            from: 0.0,
            length: 10.0,
            line: 1,
            block: 0,
            marks: SegmentMarks::default(),
        };
        let run = Run {
            length: 10.0,
            segments: 1,
            limits: ScalarLimits {
                velocity: 10.0,
                acceleration: 100.0,
                jerk: 1000.0,
            },
            feed: 10.0,
        };
        producer.segment(&segment).unwrap();
        producer.step(&Step::Run(run)).unwrap();
        drop(producer);

        let controls = Arc::new(Controls::new(1.0));
        let cycle = CycleLoop {
            queue,
            controls: Arc::clone(&controls),
            clock: Clock::Virtual,
            period_ns: 1_000_000,
            lead_cycles: 2,
            max_late_cycles: 0,
            stop_at_program_stops: false,
            commands: None,
            signals: None,
            bus: None,
            trace: None,
            start_unix_ns: 0,
            records_load: false,
            process: None,
            standby: Standby::new(false, 1_000_000),
            turning: TurningTally::new(0.0, 1_000_000),
        };
        let (sender, receiver) = mpsc::channel();
        std::thread::spawn(move || {
            let report = cycle.run(PathExecutor::new(limits, 1_000_000, Axes::zeros()), |_| {});
            sender.send((report.planner_died, report.last.unwrap())).unwrap();
        });
        let (planner_died, last) = receiver.recv_timeout(Duration::from_secs(60)).unwrap();
        assert!(planner_died);
        assert_eq!(last.state, State::Fault);
        assert_eq!(last.position, Axes::zeros());
        assert_eq!(controls.alarm(), Alarm::Planner.number());
    }
}
