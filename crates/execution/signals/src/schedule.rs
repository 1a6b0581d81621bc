//! From the planner's thread to the cycle: which change takes effect when.

use evolvent_machine::MAX_ANALOG;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::feed_law::FeedLaw;
use crate::override_switches::OverrideSwitches;
use crate::virtual_spindle::SpindleTarget;
use crate::wait::{InputWait, WaitResult};

/// Capacity for scheduled changes and waits: one for each block mark and step that a plan queue holds at most
/// (131 072 and 36 800), and for the blocks that wait in the planner's windows.
const AHEAD: usize = 1 << 18;
/// Capacity for results of waits: a program waits for each result before it continues.
const RESULTS: usize = 8;

/// The moment from which a change takes effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SignalMoment {
    /// At rest, with the action of this number.
    Rest(u32),
    /// With the first setpoint of the block of this number, or of a later one.
    Block(u32),
}

/// A change at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputChange {
    /// The moment from which it takes effect.
    pub moment: SignalMoment,
    /// Digital outputs to switch on.
    pub on: u64,
    /// Digital outputs to switch off.
    pub off: u64,
    /// Bit i set: sets analog output i.
    pub analog_mask: u32,
    /// Values of the analog outputs to set.
    pub analog: [f64; MAX_ANALOG as usize],
    /// The overrides that are enabled from then on; `None` if they do not change.
    pub overrides: Option<OverrideSwitches>,
    /// What the feed refers to from then on; `None` if that does not change.
    pub feed_law: Option<FeedLaw>,
    /// The spindle whose angle motion follows from then on; `None` if that does not change.
    pub follows: Option<u32>,
    /// The target of a spindle from then on, with the virtual clock; `None` if that does not change.
    pub spindle: Option<SpindleTarget>,
}

impl OutputChange {
    /// An empty change at this moment.
    #[must_use]
    pub fn at(moment: SignalMoment) -> Self {
        Self {
            moment,
            on: 0,
            off: 0,
            analog_mask: 0,
            analog: [0.0; MAX_ANALOG as usize],
            overrides: None,
            feed_law: None,
            follows: None,
            spindle: None,
        }
    }

    /// Switches a digital output. Of two changes of one output the later one takes effect. Numbers that do
    /// not exist are ignored.
    pub fn set_digital(&mut self, number: u32, on: bool) {
        if let Some(bit) = 1_u64.checked_shl(number) {
            (self.on, self.off) = if on {
                (self.on | bit, self.off & !bit)
            } else {
                (self.on & !bit, self.off | bit)
            };
        }
    }

    /// Sets an analog output, with the same rules.
    pub fn set_analog(&mut self, number: u32, value: f64) {
        if let Some(slot) = self.analog.get_mut(number as usize) {
            *slot = value;
            self.analog_mask |= 1 << number;
        }
    }

    /// Whether nothing changes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        !self.sets_outputs()
            && self.overrides.is_none()
            && self.feed_law.is_none()
            && self.follows.is_none()
            && self.spindle.is_none()
    }

    /// Whether an output changes.
    #[must_use]
    pub fn sets_outputs(&self) -> bool {
        self.on != 0 || self.off != 0 || self.analog_mask != 0
    }
}

/// An entry of the schedule.
#[derive(Clone, Copy, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "nearly all are changes, and each is boxed"
)]
pub(crate) enum Scheduled {
    Change(OutputChange),
    Wait(InputWait),
}

/// The planner's end of the schedule. Entries are scheduled in the order of the program, each before its
/// block or action enters the plan.
#[derive(Debug)]
pub struct Scheduler {
    scheduled: Producer<Box<Scheduled>>,
    spent: Consumer<Box<Scheduled>>,
    results: Consumer<WaitResult>,
}

impl Scheduler {
    /// Schedules a change. Returns `false` if the schedule is full, which cannot happen with the sizes of a
    /// plan queue, or if the cycle's end has been dropped.
    #[must_use]
    pub fn change(&mut self, change: OutputChange) -> bool {
        self.push(Scheduled::Change(change))
    }

    /// Schedules a wait, with the same result.
    #[must_use]
    pub fn wait(&mut self, wait: InputWait) -> bool {
        self.push(Scheduled::Wait(wait))
    }

    /// The result of a wait; each result is returned once.
    pub fn result(&mut self) -> Option<WaitResult> {
        self.results.pop().ok()
    }

    /// Whether the cycle's end has been dropped.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        self.scheduled.is_abandoned()
    }

    fn push(&mut self, scheduled: Scheduled) -> bool {
        // Entries that the cycle has executed are dropped here, outside the cycle.
        while self.spent.pop().is_ok() {}
        !self.scheduled.is_abandoned() && self.scheduled.push(Box::new(scheduled)).is_ok()
    }
}

/// The cycle's end of the schedule of one program, and the queues back. [`Signals`](crate::Signals) executes
/// it.
#[derive(Debug)]
pub struct ScheduleConsumer {
    pub(crate) ahead: Consumer<Box<Scheduled>>,
    pub(crate) spent: Producer<Box<Scheduled>>,
    pub(crate) results: Producer<WaitResult>,
}

/// Both ends of the schedule of one program. Allocates.
#[must_use]
pub fn schedule() -> (Scheduler, ScheduleConsumer) {
    let (scheduled, ahead) = RingBuffer::new(AHEAD);
    let (done, spent) = RingBuffer::new(AHEAD);
    let (sender, results) = RingBuffer::new(RESULTS);
    let scheduler = Scheduler {
        scheduled,
        spent,
        results,
    };
    let consumer = ScheduleConsumer {
        ahead,
        spent: done,
        results: sender,
    };
    (scheduler, consumer)
}
