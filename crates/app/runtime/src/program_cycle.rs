//! The cycles of a run: one program along its plan, from the first setpoint to the last.

use std::sync::Arc;

use evolvent_control::Alarm;
use evolvent_drive::DriveAlarm;
use evolvent_gcode::SPINDLES;
use evolvent_motion::{Inputs, MotionState, PathExecutor, PlanConsumer, Setpoint, flags};
use evolvent_path::Jet;
use evolvent_trace::inputs as recorded;
use evolvent_turning::{
    AdaptiveFeed, AdaptiveStop, CutPhase, CutState, LoadSample, Reason, SimulatedProcess, TurningOutput,
};
use rtrb::Consumer;

use crate::core_loop::{Computed, CycleBegin, CycleEnd, Next, SetpointSource, wait_until};
use crate::corrections::Corrections;
use crate::cycle_sample::{CycleSample, input_bits};
use crate::due_setpoint::DriveRequest;
use crate::shared::Controls;
use crate::signal_loop::{SignalLoop, phase_of};
use crate::spindle_rundown::{SpindleRundown, rest_after};
use crate::standby::{NotBegun, Standby};
use crate::turning_motion::{turning_fault, turning_output};
use crate::turning_tally::TurningTally;

/// One cycle, for observers.
#[derive(Clone, Copy, Debug)]
pub struct ObservedCycle<'a> {
    /// The setpoint.
    pub setpoint: &'a Setpoint,
    /// Output of a turning cycle, if one moves the axes.
    pub turning: Option<&'a TurningOutput>,
    /// The material that the simulated workpiece lost, if there is one.
    pub cut: Option<CutState>,
}

/// The program and inputs of a run; built before it starts.
pub(crate) struct ProgramCycle<F> {
    pub motion: PathExecutor,
    pub queue: PlanConsumer,
    pub controls: Arc<Controls>,
    pub period_ns: u64,
    pub is_realtime: bool,
    /// Wait at program stops until resumed; otherwise stop there for one cycle.
    pub stops_at_program_stops: bool,
    /// The actions before stops at which user-defined M codes are carried out, in order; `None` if none are.
    pub commands: Option<Consumer<u32>>,
    /// Outputs and inputs, if the machine has any.
    pub signals: Option<SignalLoop>,
    /// Corrections of the machine's errors, if there are any.
    pub corrections: Option<Corrections>,
    /// Whether a cutting load is measured and recorded.
    pub records_load: bool,
    /// The workpiece cut by the setpoints, with the virtual clock; no sensor measures its load.
    pub process: Option<SimulatedProcess>,
    /// Holds a program that needs a load until there is one.
    pub standby: Standby,
    pub adaptive: Option<AdaptiveFeed>,
    /// Continues after the program until the spindles have stopped.
    pub rundown: SpindleRundown,
    /// Observes every setpoint (offline planning).
    pub observe: F,
    pub now: ProgramState,
}

/// State that changes from cycle to cycle, and results for the report.
#[derive(Debug)]
pub(crate) struct ProgramState {
    pub last: Option<Setpoint>,
    pub starved_cycles: u64,
    pub stopped_for_lateness: bool,
    /// A corrected setpoint violated a limit.
    pub miscorrected: bool,
    pub planner_died: bool,
    /// The reason why adaptive feed stopped the run.
    pub adaptive_stop: Option<AdaptiveStop>,
    /// The emergency-stop chain was opened, or not closed.
    pub estopped: bool,
    /// A spindle that is in fault, or whose feedback stopped.
    pub spindle_trouble: Option<u32>,
    /// The reason why the program did not begin.
    pub not_begun: Option<NotBegun>,
    /// The reason why the drives stopped during the cut.
    pub drive_stop: Option<DriveAlarm>,
    /// The plan ended before the program did.
    pub program_failed: bool,
    /// Program stops passed without waiting.
    pub program_stops_passed: u64,
    /// Results of turning cycles.
    pub turning: TurningTally,
    /// Inputs of this cycle.
    inputs: Inputs,
    /// The previous cycle resumed the machine.
    resumed: bool,
    /// The last load of the simulated workpiece.
    simulated: Option<LoadSample>,
    /// The load in the previous record.
    recorded_load: Option<LoadSample>,
}

impl ProgramState {
    /// The state before the first cycle.
    pub(crate) fn new(turning: TurningTally) -> Self {
        Self {
            last: None,
            starved_cycles: 0,
            stopped_for_lateness: false,
            miscorrected: false,
            planner_died: false,
            adaptive_stop: None,
            estopped: false,
            spindle_trouble: None,
            not_begun: None,
            drive_stop: None,
            program_failed: false,
            program_stops_passed: 0,
            turning,
            inputs: Inputs::default(),
            resumed: false,
            simulated: None,
            recorded_load: None,
        }
    }
}

impl<F: FnMut(&ObservedCycle<'_>)> SetpointSource for ProgramCycle<F> {
    fn await_plan(&mut self) {
        let (motion, queue, controls) = (&self.motion, &mut self.queue, &self.controls);
        wait_until(|| motion.is_ready(queue) || (controls.is_stopping() && motion.is_at_rest()));
    }

    fn step(&mut self, begin: &CycleBegin) -> Computed {
        if self.rundown.is_running()
            && let Some(last) = self.now.last
        {
            return self.rest(begin, &last);
        }
        let switches = self.signals.as_ref().map(SignalLoop::overrides);
        let switches = switches.unwrap_or_default();
        let mut inputs = self.controls.inputs().switched_by(&switches);
        if self.process.is_some() {
            inputs.load = self.now.simulated;
        }
        self.hold_before_load(&mut inputs);
        inputs.stop |= self.now.stopped_for_lateness || self.now.miscorrected;
        let command = self.at_command();
        let at_wait = self.take_signals(begin.number, &mut inputs);
        self.pass_stops(command, at_wait, &mut inputs);
        self.adapt(&mut inputs, switches.adaptive.unwrap_or(true));
        let last = self.now.last.as_ref();
        let signals = self.signals.as_mut();
        let is_rapid = self.motion.is_rapid();
        let ratio = |signals: &mut SignalLoop| signals.feed_ratio(last, is_rapid, &[1.0; SPINDLES]);
        inputs.feed_override *= signals.map_or(1.0, ratio);
        let before = self.motion.plan_step();
        let mut setpoint = self.motion.step(&inputs, &mut self.queue);
        let has_left = at_wait && inputs.resume && self.motion.plan_step() != before;
        self.note_faults(&mut setpoint);
        self.now.starved_cycles += u64::from(setpoint.flags & flags::STARVED != 0);
        if let Some(signals) = &mut self.signals {
            if has_left {
                signals.go_on();
            }
            let _has_changed = signals.step(&setpoint, phase_of(setpoint.state));
        }
        let bits = input_bits(&inputs, &self.motion);
        self.leave(setpoint, inputs, bits)
    }

    fn stop_for_lateness(&mut self, _sequence: u64) {
        self.now.stopped_for_lateness = true;
        self.controls.raise(Alarm::Lateness);
    }

    fn describe(&mut self, sample: &mut CycleSample) {
        if !self.records_load && self.adaptive.is_none() {
            return;
        }
        sample.turning = turning_output(&self.motion).and_then(|output| output.transition);
        let was = std::mem::replace(&mut self.now.recorded_load, self.now.inputs.load);
        let Some(load) = self.now.inputs.load else { return };
        sample.record.load = load.value;
        if was.is_none_or(|was| was.sequence != load.sequence) {
            sample.record.inputs |= recorded::LOAD;
        }
        if load.value >= load.range_max {
            sample.record.inputs |= recorded::LOAD_AT_END;
        }
    }

    fn finish(&mut self, end: &CycleEnd<'_>) -> Next {
        let setpoint = end.setpoint;
        let cut = self.process.as_mut().map(|process| {
            let (cut, sample) = process.step(setpoint.position[0], setpoint.position[2]);
            self.now.simulated = sample;
            cut
        });
        let turning = turning_output(&self.motion);
        self.now.turning.observe(turning, cut.as_ref());
        (self.observe)(&ObservedCycle {
            setpoint,
            turning,
            cut,
        });
        let is_at_stop = setpoint.state == MotionState::ProgramStop;
        let next = self.commands.as_ref().and_then(|commands| commands.peek().ok());
        let at_command = is_at_stop && next.is_some_and(|action| action + 1 == setpoint.actions);
        let at_wait = self.signals.as_ref().is_some_and(SignalLoop::is_waiting);
        self.controls.set_at_command(at_command || at_wait);
        self.controls.publish(setpoint);
        self.now.last = Some(*setpoint);
        if (self.motion.is_over() && !self.rundown.is_running()) || self.now.planner_died {
            return Next::End;
        }
        Next::Cycle { correction_ns: 0 }
    }
}

impl<F> ProgramCycle<F> {
    /// A setpoint at rest after the end of the program, while a spindle slows down.
    fn rest(&mut self, begin: &CycleBegin, last: &Setpoint) -> Computed {
        let mut inputs = self.controls.inputs();
        let _at_wait = self.take_signals(begin.number, &mut inputs);
        let setpoint = rest_after(last);
        if let Some(signals) = &mut self.signals {
            let _has_changed = signals.step(&setpoint, phase_of(setpoint.state));
        }
        self.leave(setpoint, inputs, 0)
    }

    /// Completes a setpoint with its accompanying data, whether or not it is the last.
    fn leave(&mut self, mut setpoint: Setpoint, inputs: Inputs, mut input_bits: u32) -> Computed {
        self.now.inputs = inputs;
        let corrected = self.correct(&setpoint);
        if self
            .rundown
            .follow(&mut setpoint, &self.controls, self.now.estopped)
        {
            input_bits |= recorded::RUNS_ON;
        }
        Computed {
            setpoint,
            corrected,
            drive: DriveRequest::ON,
            job: 0,
            is_of_program: true,
            // `run` has no spindle override.
            spindle_overrides: [1.0; SPINDLES],
            override_off_mask: 0,
            input_bits,
        }
    }

    /// Holds a program that needs a load until there is one, and ends it if the drives stop during the cut.
    fn hold_before_load(&mut self, inputs: &mut Inputs) {
        match self.standby.step(&self.controls) {
            Ok(is_held) => inputs.hold |= is_held,
            Err(why) => {
                self.now.not_begun.get_or_insert(why);
                inputs.stop = true;
                self.controls.raise(Alarm::LoadSensor);
            }
        }
        // An earlier stop of the program explains why drives no longer follow.
        let has_ended =
            self.now.adaptive_stop.is_some() || turning_fault(&self.motion).is_some() || self.now.estopped;
        if self.now.drive_stop.is_none()
            && !has_ended
            && let Some(alarm) = self.standby.drive_stop(&self.controls)
        {
            self.now.drive_stop = Some(alarm);
            self.controls.raise(drive_alarm(&alarm));
        }
        inputs.stop |= self.now.drive_stop.is_some();
    }

    /// The action before the user-defined M code at which the machine waits, if any. Drops codes that were
    /// passed.
    fn at_command(&mut self) -> Option<u32> {
        let (commands, last) = (self.commands.as_mut()?, self.now.last.as_ref()?);
        while commands.peek().is_ok_and(|action| action + 1 < last.actions) {
            let _behind = commands.pop();
        }
        let next = *commands.peek().ok()?;
        (last.state == MotionState::ProgramStop && next + 1 == last.actions).then_some(next)
    }

    /// Applies inputs of the machine: its emergency-stop chain, and waits that are over. Returns whether the
    /// machine is at rest in a wait.
    fn take_signals(&mut self, number: u64, inputs: &mut Inputs) -> bool {
        let Some(signals) = &mut self.signals else {
            return false;
        };
        signals.apply_inputs(number, self.period_ns, self.now.last.as_ref());
        inputs.probe = signals.take_probe();
        inputs.spindle = signals.spindle_at(number);
        if signals.is_estopped() && !self.now.estopped {
            self.now.estopped = true;
            self.controls.raise(Alarm::EmergencyStopChain);
        }
        if self.now.spindle_trouble.is_none()
            && let Some(spindle) = signals.spindle_in_trouble()
        {
            self.now.spindle_trouble = Some(spindle);
            self.controls.raise(Alarm::Spindle);
        }
        inputs.stop |= self.now.estopped || self.now.spindle_trouble.is_some();
        if signals.is_over() {
            let (motion, queue) = (&self.motion, &mut self.queue);
            if !self.is_realtime && motion.state() == MotionState::ProgramStop && !inputs.stop {
                // The planner continues with the result: the motion must not depend on the planner's speed.
                wait_until(|| motion.can_leave_wait(queue) || queue.is_abandoned());
            }
            inputs.resume = motion.can_leave_wait(queue);
        }
        signals.is_waiting()
    }

    /// Decides at a program stop whether the machine continues.
    fn pass_stops(&mut self, command: Option<u32>, at_wait: bool, inputs: &mut Inputs) {
        let resumed = self.now.resumed;
        if at_wait {
            // Only the end of the wait continues the program here.
        } else if let Some(action) = command {
            inputs.resume = !resumed && self.controls.is_command_done(action);
        } else if !self.stops_at_program_stops {
            // Decided in the cycle, so that a run with the virtual clock always takes the same cycles.
            inputs.resume = !resumed && self.motion.state() == MotionState::ProgramStop;
            self.now.program_stops_passed += u64::from(inputs.resume);
        }
        self.now.resumed = inputs.resume;
    }

    /// Scales the feed by the cutting load. Rapids are unchanged. The operator's override applies only below
    /// 100 %, so that the set load is kept. Where the program has switched adaptive feed off (M52 P0), this
    /// tracks the load and scales nothing.
    fn adapt(&mut self, inputs: &mut Inputs, counts: bool) {
        let Some(adaptive) = &mut self.adaptive else {
            return;
        };
        let last = self.now.last.as_ref();
        let runs = last.is_some_and(|last| last.state == MotionState::Running);
        let phase = match (runs, self.motion.is_rapid()) {
            (true, true) => CutPhase::Rapid,
            (true, false) if counts => CutPhase::Feed,
            _ => CutPhase::Rest,
        };
        let driven = self.motion.feed_factor();
        let driven = driven.or(last.map(|last| last.feed_override)).unwrap_or_default();
        let output = adaptive.step(inputs.load, driven, phase);
        if !counts {
            return;
        }
        inputs.feed_override = inputs.feed_override.min(1.0) * output.factor;
        self.now.adaptive_stop = self.now.adaptive_stop.or(output.stop);
        inputs.stop |= self.now.adaptive_stop.is_some();
    }

    /// Computes what the drives are sent for a setpoint.
    fn correct(&mut self, setpoint: &Setpoint) -> Option<Jet> {
        let corrections = self.corrections.as_mut()?;
        let inputs = self.signals.as_ref().map(SignalLoop::inputs);
        let corrected = corrections.step(setpoint, inputs);
        if corrections.take_fault().is_some() {
            self.now.miscorrected = true;
            self.controls.raise(Alarm::Guard);
        }
        Some(corrected)
    }

    /// Notes faults that occurred with this setpoint.
    fn note_faults(&mut self, setpoint: &mut Setpoint) {
        if setpoint.state == MotionState::Done && self.controls.has_program_failed() {
            setpoint.state = MotionState::Stopped;
            self.now.program_failed = true;
            self.controls.raise(Alarm::Program);
        }
        if self.motion.fault().is_some() {
            self.controls.raise(Alarm::Guard);
        }
        if let Some(reason) = turning_fault(&self.motion) {
            self.controls.raise(turning_alarm(&reason));
        }
        if self.motion.is_stuck(&mut self.queue) {
            setpoint.state = MotionState::Fault;
            setpoint.flags |= flags::LAST;
            self.now.planner_died = true;
            self.controls.raise(Alarm::Planner);
        }
    }
}

/// The alarm for drives that have stopped.
pub(crate) fn drive_alarm(alarm: &DriveAlarm) -> Alarm {
    Alarm::from_number(alarm.number()).unwrap_or(Alarm::BridgeStopped)
}

/// The alarm of a turning cycle that has failed.
pub(crate) fn turning_alarm(reason: &Reason) -> Alarm {
    match reason {
        Reason::Sensor(_) => Alarm::LoadSensor,
        _ => Alarm::CuttingLoad,
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
    use crate::core_loop::CoreLoop;
    use crate::job::Clock;

    #[test]
    fn a_planner_that_dies_ends_the_run_with_a_fault() {
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
            feed_u_s: 10.0,
        };
        producer.segment(&segment).unwrap();
        producer.step(&Step::Run(run)).unwrap();
        drop(producer);

        let controls = Arc::new(Controls::new(1.0));
        let core = CoreLoop {
            clock: Clock::Virtual,
            period_ns: 1_000_000,
            lead_cycles: 2,
            max_late_cycles: 0,
            start_unix_ns: 0,
            bus: None,
            trace: None,
        };
        let mut source = ProgramCycle {
            motion: PathExecutor::new(limits, 1_000_000, Axes::zeros()),
            queue,
            controls: Arc::clone(&controls),
            period_ns: 1_000_000,
            is_realtime: false,
            stops_at_program_stops: false,
            commands: None,
            signals: None,
            corrections: None,
            records_load: false,
            process: None,
            standby: Standby::new(false, 1_000_000),
            adaptive: None,
            rundown: SpindleRundown::NONE,
            observe: |_: &ObservedCycle<'_>| {},
            now: ProgramState::new(TurningTally::new(0.0, 1_000_000)),
        };
        let (sender, receiver) = mpsc::channel();
        std::thread::spawn(move || {
            let _counts = core.run(&mut source);
            let now = source.now;
            sender.send((now.planner_died, now.last.unwrap())).unwrap();
        });
        let (planner_died, last) = receiver.recv_timeout(Duration::from_secs(60)).unwrap();
        assert!(planner_died);
        assert_eq!(last.state, MotionState::Fault);
        assert_eq!(last.position, Axes::zeros());
        assert_eq!(controls.alarm(), Alarm::Planner.number());
    }
}
