//! The cycle's end: outputs with every setpoint, and the wait in force.

use evolvent_machine::{EstopSettings, OutputRule, OutputSettings, SignalKind, SignalSettings};
use rtrb::{Consumer, Producer};

use crate::image::{InputImage, OutputImage};
use crate::schedule::{Change, Moment, Scheduled};
use crate::wait::{ActiveWait, WaitResult};

/// What the machine is doing, as far as outputs have a rule for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// A program runs, or nothing does.
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

/// How far a program is with one setpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Actions that have taken effect.
    pub actions: u32,
    /// Blocks that have begun: the number of the present one + 1.
    pub blocks: u32,
    /// What the machine is doing.
    pub phase: Phase,
}

/// The outputs that one rule makes safe.
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
    ahead: Consumer<Box<Scheduled>>,
    spent: Producer<Box<Scheduled>>,
    results: Producer<WaitResult>,
    lead_cycles: u32,
    safe: OutputImage,
    on_hold: Mask,
    on_stop: Mask,
    on_end: Mask,
    all: Mask,
    estop: Option<EstopSettings>,
    /// As the program has set them.
    programmed: OutputImage,
    inputs: InputImage,
    wait: Option<ActiveWait>,
    /// The wait is over, and the program may go on.
    go_on: bool,
}

impl Signals {
    pub(crate) fn new(
        settings: &SignalSettings,
        lead_cycles: u32,
        ahead: Consumer<Box<Scheduled>>,
        spent: Producer<Box<Scheduled>>,
        results: Producer<WaitResult>,
    ) -> Self {
        let mut safe = OutputImage::default();
        for output in &settings.outputs {
            match output.kind {
                SignalKind::Digital => safe.digital |= u64::from(output.safe != 0.0) << output.number,
                SignalKind::Analog => safe.analog[output.number as usize] = output.safe,
            }
        }
        Self {
            ahead,
            spent,
            results,
            lead_cycles,
            safe,
            on_hold: Mask::of(settings, |output| output.on_hold == OutputRule::Safe),
            on_stop: Mask::of(settings, |output| output.on_stop == OutputRule::Safe),
            on_end: Mask::of(settings, |output| output.on_end == OutputRule::Safe),
            all: Mask::of(settings, |_| true),
            estop: settings.estop,
            programmed: safe,
            inputs: InputImage::default(),
            wait: None,
            go_on: false,
        }
    }

    /// Begins with these outputs instead of the safe ones: those that the job before has left.
    pub fn begin_with(&mut self, outputs: OutputImage) {
        self.programmed = outputs;
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

    /// Takes newer inputs: each sample in order, before the step of the setpoint that goes by them.
    pub fn see(&mut self, inputs: &InputImage) {
        self.inputs = *inputs;
        if let Some(wait) = &mut self.wait {
            wait.see(inputs);
        }
    }

    /// Whether the emergency-stop chain is open: its input is, or is not known.
    #[must_use]
    pub fn is_estop_open(&self) -> bool {
        self.estop.is_some_and(|estop| {
            let closed = f64::from(u8::from(estop.closed));
            self.inputs.value(SignalKind::Digital, estop.input) != Some(closed)
        })
    }

    /// Whether the machine rests for a wait, over or not: only this goes on from there.
    #[must_use]
    pub fn is_waiting(&self) -> bool {
        self.wait.is_some() || self.go_on
    }

    /// Whether the wait for which the machine rests is over.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.go_on
    }

    /// The machine leaves its wait with the next setpoint: whether that was over.
    pub fn take_resume(&mut self) -> bool {
        std::mem::take(&mut self.go_on)
    }

    /// Sets outputs by hand, from the next setpoint on. Its moment counts for nothing.
    pub fn set_by_hand(&mut self, change: &Change) {
        self.apply(change);
    }

    /// The outputs with a setpoint, the program having come so far. Once for each setpoint.
    pub fn step(&mut self, progress: &Progress) -> OutputImage {
        if let Some(wait) = &mut self.wait
            && let Some(result) = wait.step(&self.inputs)
        {
            self.wait = None;
            self.go_on = true;
            // The program waits for each before the next, so there is room.
            let _room = self.results.push(result);
        }
        loop {
            // A wait holds back what is scheduled behind it; none begins while one is in force.
            let has_come = match self.ahead.peek().map(Box::as_ref) {
                Ok(Scheduled::Change(change)) => match change.moment {
                    Moment::Rest(action) => action < progress.actions,
                    Moment::Block(block) => block < progress.blocks,
                },
                Ok(Scheduled::Wait(wait)) => wait.action < progress.actions && !self.is_waiting(),
                Err(_) => false,
            };
            if !has_come {
                break;
            }
            let Ok(scheduled) = self.ahead.pop() else { break };
            match *scheduled {
                Scheduled::Change(change) => self.apply(&change),
                Scheduled::Wait(wait) => {
                    let mut wait = ActiveWait::new(wait, self.lead_cycles);
                    wait.see(&self.inputs);
                    self.wait = Some(wait);
                }
            }
            if let Err(rtrb::PushError::Full(scheduled)) = self.spent.push(scheduled) {
                // As long as the queue before it, so there is room; freeing here would be work for the cycle.
                std::mem::forget(scheduled);
            }
        }
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

    fn apply(&mut self, change: &Change) {
        self.programmed.digital = self.programmed.digital & !change.off | change.on;
        for (index, value) in self.programmed.analog.iter_mut().enumerate() {
            if change.analog_mask >> index & 1 == 1 {
                *value = change.analog[index];
            }
        }
    }
}
