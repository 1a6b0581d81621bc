//! From the planner's thread to the cycle: what changes when.

use evolvent_machine::MAX_ANALOG;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::feed_law::FeedLaw;
use crate::override_switches::OverrideSwitches;
use crate::virtual_spindle::SpindleTarget;
use crate::wait::{InputWait, WaitResult};

/// Changes and waits on the way: one for each block mark and step that a plan queue holds at most, 131 072
/// and 36 800, and for the blocks that wait in the planner's windows.
const AHEAD: usize = 1 << 18;
/// Results of waits on the way: a program waits for each before it goes on.
const RESULTS: usize = 8;

/// From when on a change counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// At rest, with the action of this number.
    Rest(u32),
    /// With the first setpoint of the block of this number, or of a later one.
    Block(u32),
}

/// What changes at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// From when on.
    pub moment: Moment,
    /// Digital outputs that are switched on.
    pub on: u64,
    /// Digital outputs that are switched off.
    pub off: u64,
    /// Bit i set: analog output i is set.
    pub analog_mask: u32,
    /// Values of the analog outputs that are set.
    pub analog: [f64; MAX_ANALOG as usize],
    /// Which overrides count from then on; none where that stays as it is.
    pub overrides: Option<OverrideSwitches>,
    /// What the feed goes by from then on; none where that stays as it is.
    pub feed_law: Option<FeedLaw>,
    /// The spindle whose angle motion follows from then on; none where that stays as it is.
    pub follows: Option<u32>,
    /// How a spindle turns from then on, where time is not real; none where that stays as it is.
    pub spindle: Option<SpindleTarget>,
}

impl Change {
    /// Nothing changes, from this moment on.
    #[must_use]
    pub fn at(moment: Moment) -> Self {
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

    /// Switches a digital output; of two changes of one output the later counts. Numbers that there are not
    /// are left alone.
    pub fn set_digital(&mut self, number: u32, on: bool) {
        if let Some(bit) = 1_u64.checked_shl(number) {
            (self.on, self.off) = if on {
                (self.on | bit, self.off & !bit)
            } else {
                (self.on & !bit, self.off | bit)
            };
        }
    }

    /// Sets an analog output, likewise.
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

/// Something that is scheduled.
#[derive(Clone, Copy, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "nearly all are changes, and each is boxed"
)]
pub(crate) enum Scheduled {
    Change(Change),
    Wait(InputWait),
}

/// The planner's end. Everything is scheduled in the order of the program, before the block or action goes
/// into the plan.
#[derive(Debug)]
pub struct Scheduler {
    scheduled: Producer<Box<Scheduled>>,
    spent: Consumer<Box<Scheduled>>,
    results: Consumer<WaitResult>,
}

impl Scheduler {
    /// Schedules a change. `false` where there is no room, which a plan queue of its sizes never brings
    /// about, or where the cycle has gone.
    #[must_use]
    pub fn change(&mut self, change: Change) -> bool {
        self.push(Scheduled::Change(change))
    }

    /// Schedules a wait, likewise.
    #[must_use]
    pub fn wait(&mut self, wait: InputWait) -> bool {
        self.push(Scheduled::Wait(wait))
    }

    /// What came of a wait, once.
    pub fn result(&mut self) -> Option<WaitResult> {
        self.results.pop().ok()
    }

    /// Whether the cycle has gone.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        self.scheduled.is_abandoned()
    }

    fn push(&mut self, scheduled: Scheduled) -> bool {
        // What the cycle is done with is dropped here, where time does not matter.
        while self.spent.pop().is_ok() {}
        !self.scheduled.is_abandoned() && self.scheduled.push(Box::new(scheduled)).is_ok()
    }
}

/// The cycle's end: what one program has scheduled, and the way back. [`Signals`](crate::Signals) carries it
/// out.
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
    let (told, results) = RingBuffer::new(RESULTS);
    let scheduler = Scheduler {
        scheduled,
        spent,
        results,
    };
    let consumer = ScheduleConsumer {
        ahead,
        spent: done,
        results: told,
    };
    (scheduler, consumer)
}
