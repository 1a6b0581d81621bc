//! The cycle's end: the outputs of every setpoint, and the wait in force.

use evolvent_machine::{EstopSettings, MAX_SPINDLES, OutputRule, OutputSettings, SignalKind, SignalSettings};

use crate::feed_law::FeedLaw;
use crate::image::{InputImage, OutputImage};
use crate::override_switches::OverrideSwitches;
use crate::probe_image::{ProbeInput, ProbeState};
use crate::schedule::{OutputChange, ScheduleConsumer, Scheduled, SignalMoment};
use crate::spindle_input::{SpindleInput, SpindleKnowledge};
use crate::spindle_state::SpindleState;
use crate::spindle_tracker::{SpindleMotion, SpindleTracker};
use crate::virtual_spindle::VirtualSpindle;
use crate::wait::ActiveWait;

/// Relative difference from which on the feed follows the measured speed of the spindle.
const FEED_HYSTERESIS: f64 = 0.01;

/// The state of the machine that determines safe outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// A program runs, or none does.
    Runs,
    /// A feed hold has stopped the axes.
    Held,
    /// The program was stopped.
    Stopped,
    /// The program has ended.
    Ended,
    /// Fault or emergency stop.
    Fault,
}

/// The progress of a program at one setpoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Number of actions that have taken effect.
    pub actions: u32,
    /// Number of blocks that have begun: the number of the present one + 1.
    pub blocks: u32,
    /// The state of the machine.
    pub phase: Phase,
    /// X of the tool in machine coordinates, mm.
    pub x_mm: f64,
}

/// The outputs that one rule sets to their safe values.
#[derive(Clone, Copy, Debug, Default)]
struct Mask {
    digital: u64,
    analog: u32,
}

impl Mask {
    fn of(settings: &SignalSettings, rule: impl Fn(&OutputSettings) -> bool) -> Self {
        let mut mask = Self::default();
        for output in settings.outputs.iter().filter(|output| rule(output)) {
            match output.kind {
                SignalKind::Digital => mask.digital |= 1 << output.number,
                SignalKind::Analog => mask.analog |= 1 << output.number,
            }
        }
        mask
    }

    fn apply(&self, image: &mut OutputImage, safe: &OutputImage) {
        image.digital = image.digital & !self.digital | safe.digital & self.digital;
        for (index, value) in image.analog.iter_mut().enumerate() {
            if self.analog >> index & 1 == 1 {
                *value = safe.analog[index];
            }
        }
    }
}

/// Outputs, inputs and waits in the cycle. Nothing here allocates or frees.
#[derive(Debug)]
pub struct Signals {
    /// The schedule of the program that runs.
    schedule: Option<ScheduleConsumer>,
    lead_cycles: u32,
    safe: OutputImage,
    on_hold: Mask,
    on_stop: Mask,
    on_end: Mask,
    all: Mask,
    estop: Option<EstopSettings>,
    /// The outputs as the program has set them.
    programmed: OutputImage,
    overrides: OverrideSwitches,
    feed_law: FeedLaw,
    /// The last factor on the feed of the plan.
    feed_ratio: f64,
    /// Maximum speed of each spindle, rpm; infinite if unknown.
    max_rpm: [f64; MAX_SPINDLES as usize],
    /// The spindle whose angle motion follows.
    follows: u32,
    inputs: InputImage,
    probe: ProbeInput,
    tracker: SpindleTracker,
    /// The spindles with the virtual clock.
    virtual_spindles: [VirtualSpindle; MAX_SPINDLES as usize],
    period_s: f64,
    /// Number of setpoints after which a sample of the angle is too old. The limit is the same as for every
    /// input, and applies also when the publisher is silent.
    stale_cycles: f64,
    wait: Option<ActiveWait>,
    /// The wait is over and the program may continue.
    go_on: bool,
}

impl Signals {
    /// Every output at its safe value, no input known, no program. `lead_cycles` is the time from the
    /// computation of a setpoint until it is due; `period_ns` is the period.
    #[must_use]
    pub fn new(settings: &SignalSettings, lead_cycles: u32, period_ns: u64) -> Self {
        let period_s = period_ns as f64 * 1e-9;
        let mut safe = OutputImage::default();
        for output in &settings.outputs {
            match output.kind {
                SignalKind::Digital => safe.digital |= u64::from(output.safe != 0.0) << output.number,
                SignalKind::Analog => safe.analog[output.number as usize] = output.safe,
            }
        }
        Self {
            schedule: None,
            lead_cycles,
            safe,
            on_hold: Mask::of(settings, |output| output.on_hold == OutputRule::Safe),
            on_stop: Mask::of(settings, |output| output.on_stop == OutputRule::Safe),
            on_end: Mask::of(settings, |output| output.on_end == OutputRule::Safe),
            all: Mask::of(settings, |_| true),
            estop: settings.estop,
            programmed: safe,
            overrides: OverrideSwitches::default(),
            feed_law: FeedLaw::default(),
            feed_ratio: 1.0,
            max_rpm: settings.max_rpm(),
            follows: 0,
            inputs: InputImage::default(),
            probe: ProbeInput::default(),
            tracker: SpindleTracker::new(period_s),
            virtual_spindles: std::array::from_fn(|number| {
                VirtualSpindle::new(settings.spindle(number as u32))
            }),
            period_s,
            stale_cycles: f64::from(lead_cycles) + settings.input_timeout_s / period_s,
            wait: None,
            go_on: false,
        }
    }

    /// Starts a program: from now on its schedule is executed. Outputs stay as they are. Returns the schedule
    /// of a program that has not been ended.
    pub fn begin_program(&mut self, schedule: ScheduleConsumer) -> Option<ScheduleConsumer> {
        let before = self.end_program();
        self.schedule = Some(schedule);
        before
    }

    /// Ends the program and any wait of it; every override is enabled again. Returns its schedule, to be
    /// dropped outside the cycle.
    pub fn end_program(&mut self) -> Option<ScheduleConsumer> {
        (self.wait, self.go_on) = (None, false);
        (self.overrides, self.feed_law) = (OverrideSwitches::default(), FeedLaw::default());
        self.follows = 0;
        self.schedule.take()
    }

    /// Continues with these outputs, which were set before.
    pub fn go_on_with(&mut self, outputs: &OutputImage) {
        self.programmed = *outputs;
    }

    /// The safe value of every output.
    #[must_use]
    pub fn safe(&self) -> &OutputImage {
        &self.safe
    }

    /// The inputs in force.
    #[must_use]
    pub fn inputs(&self) -> &InputImage {
        &self.inputs
    }

    /// Takes newer inputs: each sample in order, before the step of the setpoint that uses them.
    pub fn observe(&mut self, inputs: &InputImage) {
        let is_of_other = self.inputs.angle_spindle != inputs.angle_spindle;
        if is_of_other {
            // The model of one spindle does not apply to another.
            self.tracker.forget();
        }
        let before = self.inputs.angle.filter(|_| !is_of_other);
        let is_indexed = |image: &InputImage| {
            let state = image.spindle(inputs.angle_spindle);
            state.is_some_and(|state| state.indexed)
        };
        let has_moved = is_indexed(&self.inputs) != is_indexed(inputs);
        self.inputs = *inputs;
        self.probe.observe(&inputs.probe);
        match (&inputs.angle, before) {
            (None, Some(_)) => self.tracker.forget(),
            // A sample is processed when its time changes: a trace records the two numbers one after the
            // other.
            (Some(now), before) if before.is_none_or(|before| before.cycle != now.cycle) => {
                self.tracker.observe(now);
            }
            _ => {}
        }
        if has_moved {
            // The index pulse moves the zero: earlier samples refer to another zero. A trace records this
            // after the sample.
            self.tracker.forget();
            if let Some(now) = &inputs.angle {
                self.tracker.observe(now);
            }
        }
        if let Some(wait) = &mut self.wait {
            wait.observe(inputs);
        }
    }

    /// The state of the probe in the newest sample. Real-time safe.
    #[must_use]
    pub fn probe_state(&self) -> ProbeState {
        self.inputs.probe.state
    }

    /// The probe for the next setpoint. Call it once per setpoint, after its samples.
    pub fn take_probe(&mut self) -> ProbeInput {
        self.probe.take()
    }

    /// The motion of the spindle that motion follows when the setpoint with this number is due.
    #[must_use]
    pub fn spindle_at(&self, sequence: u64) -> SpindleInput {
        let cycle = sequence as f64;
        let state = self.inputs.spindle(self.follows);
        // Samples of the previous spindle may still arrive.
        let is_of_other = self.inputs.angle.is_some() && self.inputs.angle_spindle != self.follows;
        let knowledge = match (state.filter(|_| !is_of_other), self.tracker.newest_cycle()) {
            (Some(SpindleState::OBEDIENT), None) => SpindleKnowledge::Imagined,
            (Some(state), Some(newest)) if cycle - newest <= self.stale_cycles => {
                if state.indexed && self.tracker.is_settled() {
                    SpindleKnowledge::Tracked
                } else {
                    SpindleKnowledge::Seeking
                }
            }
            _ => SpindleKnowledge::Unknown,
        };
        let motion = match knowledge {
            SpindleKnowledge::Tracked => self.tracker.at(cycle).unwrap_or_default(),
            SpindleKnowledge::Imagined => SpindleMotion {
                mean: self
                    .virtual_spindles
                    .get(self.follows as usize)
                    .map_or([0.0; 3], VirtualSpindle::motion),
                ..SpindleMotion::default()
            },
            SpindleKnowledge::Unknown | SpindleKnowledge::Seeking => SpindleMotion::default(),
        };
        let age_s = match (knowledge, self.tracker.newest_cycle()) {
            (SpindleKnowledge::Tracked, Some(newest)) => {
                (cycle - newest - f64::from(self.lead_cycles)) * self.period_s
            }
            _ => 0.0,
        };
        SpindleInput {
            knowledge,
            age_s,
            mean: motion.mean,
            ripple: motion.ripple,
        }
    }

    /// Whether the emergency-stop chain is open: its input is open or unknown.
    #[must_use]
    pub fn is_estop_open(&self) -> bool {
        self.estop.is_some_and(|estop| {
            let closed = f64::from(u8::from(estop.closed));
            self.inputs.value(SignalKind::Digital, estop.input) != Some(closed)
        })
    }

    /// A spindle whose drive is in fault, or whose rotation is not reported.
    #[must_use]
    pub fn spindle_in_trouble(&self) -> Option<u32> {
        let in_trouble =
            |state: &Option<SpindleState>| state.is_some_and(|state| state.fault || state.silent);
        let found = self.inputs.spindles.iter().position(in_trouble);
        found.map(|number| number as u32)
    }

    /// Whether the machine is at rest for a wait, over or not. Only the end of the wait continues from there.
    #[must_use]
    pub fn is_waiting(&self) -> bool {
        self.wait.is_some() || self.go_on
    }

    /// Whether the wait in force is over.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.go_on
    }

    /// The machine leaves its wait with the next setpoint. Returns whether the wait was over.
    pub fn take_resume(&mut self) -> bool {
        std::mem::take(&mut self.go_on)
    }

    /// The overrides that are enabled for the next setpoint, as the program has switched them up to the last
    /// one.
    #[must_use]
    pub fn overrides(&self) -> &OverrideSwitches {
        &self.overrides
    }

    /// The factor on the feed of the plan for the next setpoint, with the tool at X in machine coordinates,
    /// mm. It is kept while it changes by at most 1 %, so that not every setpoint requests a new plan.
    pub fn feed_ratio(&mut self, x_mm: f64, spindle_overrides: &[f64; MAX_SPINDLES as usize]) -> f64 {
        let spindle = self.feed_law.spindle().unwrap_or(0) as usize;
        let of_spindle = |values: &[f64]| values.get(spindle).copied().unwrap_or(f64::INFINITY);
        let measured_rpm = self.inputs.speeds_rpm.get(spindle).copied().flatten();
        let (spindle_override, max_rpm) = (of_spindle(spindle_overrides), of_spindle(&self.max_rpm));
        let ratio = self.feed_law.ratio(x_mm, measured_rpm, spindle_override, max_rpm);
        let is_exact = ratio == 0.0 || measured_rpm.is_none() || self.feed_law == FeedLaw::Time;
        if is_exact || (ratio - self.feed_ratio).abs() > FEED_HYSTERESIS * self.feed_ratio {
            self.feed_ratio = ratio;
        }
        self.feed_ratio
    }

    /// Sets outputs by hand, from the next setpoint on. The moment of `change` is ignored.
    pub fn set_by_hand(&mut self, change: &OutputChange) {
        self.programmed.apply(change);
    }

    /// The outputs of a setpoint with this progress of the program. Call it once per setpoint.
    pub fn step(&mut self, progress: &Progress) -> OutputImage {
        self.carry_out(progress);
        self.turn_virtual_spindles(progress.x_mm);
        match progress.phase {
            Phase::Runs | Phase::Held => {}
            Phase::Stopped => self.on_stop.apply(&mut self.programmed, &self.safe),
            Phase::Ended => self.on_end.apply(&mut self.programmed, &self.safe),
            Phase::Fault => self.all.apply(&mut self.programmed, &self.safe),
        }
        let mut image = self.programmed;
        if progress.phase == Phase::Held {
            self.on_hold.apply(&mut image, &self.safe);
        }
        image
    }

    /// Advances the virtual spindles by one period, to the time at which the next setpoint is due.
    fn turn_virtual_spindles(&mut self, x_mm: f64) {
        for (spindle, state) in self.virtual_spindles.iter_mut().zip(&self.inputs.spindles) {
            if *state == Some(SpindleState::OBEDIENT) {
                spindle.advance(x_mm, self.period_s);
            }
        }
    }

    /// Executes the schedule up to this progress.
    fn carry_out(&mut self, progress: &Progress) {
        let Some(schedule) = &mut self.schedule else {
            return;
        };
        if let Some(wait) = &mut self.wait
            && let Some(result) = wait.step(&self.inputs)
        {
            self.wait = None;
            self.go_on = true;
            // The program waits for each result before the next wait, so there is capacity.
            let _room = schedule.results.push(result);
        }
        loop {
            // A wait at the head of the queue holds back the entries after it. It begins only when no other
            // wait is in force.
            let is_waiting = self.wait.is_some() || self.go_on;
            let has_come = match schedule.ahead.peek().map(Box::as_ref) {
                Ok(Scheduled::Change(change)) => match change.moment {
                    SignalMoment::Rest(action) => action < progress.actions,
                    SignalMoment::Block(block) => block < progress.blocks,
                },
                Ok(Scheduled::Wait(wait)) => wait.action < progress.actions && !is_waiting,
                Err(_) => false,
            };
            if !has_come {
                break;
            }
            let Ok(scheduled) = schedule.ahead.pop() else {
                break;
            };
            match *scheduled {
                Scheduled::Change(change) => {
                    self.programmed.apply(&change);
                    self.overrides = change.overrides.unwrap_or(self.overrides);
                    self.feed_law = change.feed_law.unwrap_or(self.feed_law);
                    self.follows = change.follows.unwrap_or(self.follows);
                    if let Some(target) = change.spindle
                        && let Some(spindle) = self.virtual_spindles.get_mut(target.spindle as usize)
                    {
                        spindle.command(&target);
                    }
                }
                Scheduled::Wait(wait) => {
                    let mut wait = ActiveWait::new(wait, self.lead_cycles);
                    wait.observe(&self.inputs);
                    self.wait = Some(wait);
                }
            }
            if let Err(rtrb::PushError::Full(scheduled)) = schedule.spent.push(scheduled) {
                // This queue is as long as the one before it, so it has capacity. Freeing here would be work
                // for the cycle.
                std::mem::forget(scheduled);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use evolvent_path::SpindleSpeed;

    use super::*;
    use crate::schedule::schedule;

    #[test]
    fn feed_per_revolution_lasts_to_the_end_of_program() {
        let mut signals = Signals::new(&SignalSettings::default(), 2, 1_000_000);
        let (mut scheduler, consumer) = schedule();
        signals.begin_program(consumer);
        let change = OutputChange {
            feed_law: Some(FeedLaw::Revolution {
                spindle: 0,
                speed: SpindleSpeed::Constant { rpm: 1000.0 },
            }),
            ..OutputChange::at(SignalMoment::Block(3))
        };
        assert!(!change.is_empty() && !change.sets_outputs());
        assert!(scheduler.change(change));
        let at = |blocks| Progress {
            actions: 0,
            blocks,
            phase: Phase::Runs,
            x_mm: 0.0,
        };
        let measured = |signals: &mut Signals, rpm: Option<f64>| {
            signals.observe(&InputImage {
                speeds_rpm: [rpm, Some(7.0), None, None],
                ..InputImage::default()
            });
            signals.feed_ratio(0.0, &[1.0; 4])
        };
        signals.step(&at(3));
        assert_eq!(
            measured(&mut signals, Some(500.0)),
            1.0,
            "block 3 is not there yet"
        );
        signals.step(&at(4));
        assert_eq!(measured(&mut signals, Some(500.0)), 0.5);
        assert_eq!(measured(&mut signals, Some(504.0)), 0.5, "within 1 %");
        assert_eq!(measured(&mut signals, Some(506.0)), 0.506);
        assert_eq!(measured(&mut signals, Some(0.0)), 0.0, "it stands");
        assert_eq!(measured(&mut signals, Some(1.0)), 0.001, "it turns again");
        // The speed is not measured: the commanded speed counts, whatever was driven before.
        assert_eq!(measured(&mut signals, None), 1.0);
        assert_eq!(signals.feed_ratio(0.0, &[0.9, 3.0, 3.0, 3.0]), 0.9);
        assert_eq!(measured(&mut signals, Some(995.0)), 0.995);
        drop(signals.end_program());
        assert_eq!(signals.feed_ratio(0.0, &[0.5; 4]), 1.0, "the program is over");
    }
}
