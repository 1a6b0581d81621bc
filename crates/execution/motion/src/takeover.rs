//! Motions that take over from the plan at rest: a process cycle, a probing move or a pass of threading.
//!
//! Each is built outside the cycle, passed to the cycle in a box and returned in it: the cycle neither
//! allocates nor frees.

use evolvent_path::Jet;
use evolvent_wire::flags;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::path_executor::PathExecutor;
use crate::probing::{ProbeResult, Probing};
use crate::process_cycle::ProcessCycle;
use crate::queue::PlanConsumer;
use crate::setpoint::Setpoint;
use crate::state::MotionState;
use crate::threading::{ThreadResult, Threading};

/// Capacity for waiting motions and for completed ones: as many as can be on the way, and one that is active.
const WAITING: usize = 8;
const OVER: usize = 2 * WAITING;

/// The motion that takes over with the next setpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Takeover {
    Process,
    Probing,
    Threading,
}

/// Passes process cycles to the cycle, each before its [`Step::Turning`](evolvent_planner::Step::Turning).
pub type ProcessSender = TakeoverSender<dyn ProcessCycle>;

/// Passes probing moves to the cycle, each before its [`Step::Probe`](evolvent_planner::Step::Probe).
pub type ProbingSender = TakeoverSender<Probing>;

/// Passes threading passes to the cycle, each before its [`Step::Thread`](evolvent_planner::Step::Thread).
pub type ThreadingSender = TakeoverSender<Threading>;

/// The planner's end: sends motions to the cycle and receives them when they are over.
#[derive(Debug)]
pub struct TakeoverSender<T: ?Sized> {
    waiting: Producer<Box<T>>,
    over: Consumer<Box<T>>,
}

impl<T: ?Sized> TakeoverSender<T> {
    /// Sends a motion to the cycle. Drops those that are over.
    ///
    /// # Errors
    /// The motion, if the queue is full; to be sent again.
    pub fn send(&mut self, next: Box<T>) -> Result<(), Box<T>> {
        while self.over.pop().is_ok() {}
        self.waiting
            .push(next)
            .map_err(|rtrb::PushError::Full(next)| next)
    }

    /// Whether the cycle's end has been dropped.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        self.waiting.is_abandoned()
    }
}

impl TakeoverSender<Probing> {
    /// The result of the oldest completed move; each is returned once.
    pub fn result(&mut self) -> Option<ProbeResult> {
        self.over.pop().ok().and_then(|probing| probing.result())
    }
}

impl TakeoverSender<Threading> {
    /// The result of the oldest completed pass; each is returned once.
    pub fn result(&mut self) -> Option<ThreadResult> {
        self.over.pop().ok().and_then(|threading| threading.result())
    }
}

/// The cycle's end. Real-time safe.
#[derive(Debug)]
pub(crate) struct TakeoverReceiver<T: ?Sized> {
    waiting: Consumer<Box<T>>,
    over: Producer<Box<T>>,
}

impl<T: ?Sized> TakeoverReceiver<T> {
    /// The motion that belongs to the plan step that has been reached.
    pub(crate) fn take(&mut self) -> Option<Box<T>> {
        self.waiting.pop().ok()
    }

    /// Returns a completed motion: it is dropped outside the cycle.
    pub(crate) fn give_back(&mut self, over: Box<T>) {
        if let Err(rtrb::PushError::Full(over)) = self.over.push(over) {
            // The queue has capacity for all that can be on the way. The cycle must not free memory.
            std::mem::forget(over);
        }
    }
}

/// Both ends.
pub(crate) fn takeover_queue<T: ?Sized>() -> (TakeoverSender<T>, TakeoverReceiver<T>) {
    let (waiting, to_cycle) = RingBuffer::new(WAITING);
    let (from_cycle, over) = RingBuffer::new(OVER);
    let sender = TakeoverSender { waiting, over };
    let receiver = TakeoverReceiver {
        waiting: to_cycle,
        over: from_cycle,
    };
    (sender, receiver)
}

impl PathExecutor {
    /// Starts the motion that the plan has reached.
    pub(crate) fn begin(&mut self, takeover: Takeover, queue: &mut PlanConsumer) {
        self.is_rapid = false;
        match takeover {
            Takeover::Process => self.process.begin(queue.processes.take()),
            Takeover::Probing => self.probing = queue.probings.take(),
            Takeover::Threading => self.threading = queue.threadings.take(),
        }
    }

    /// Publishes a setpoint of the motion, unless the guard rejects it: then every axis stops on its own.
    pub(crate) fn accept(&mut self, jet: &Jet) -> bool {
        if let Err(violation) = self.guard.check(&jet.position, false, false) {
            self.fault.get_or_insert(violation);
            self.start_quick_stop();
            return false;
        }
        self.guard.publish(&jet.position, false);
        self.last = *jet;
        self.cursor.rest.takeover = None;
        true
    }

    /// The state of the cycle during such a motion.
    pub(crate) fn takeover_state(&self, is_held: bool, is_at_rest: bool) -> MotionState {
        match (self.stop, is_held) {
            (true, _) if is_at_rest => MotionState::Stopped,
            (true, _) => MotionState::Stopping,
            (_, true) if is_at_rest => MotionState::Held,
            (_, true) => MotionState::Holding,
            _ => MotionState::Running,
        }
    }

    /// The motion is over: the path ends at another position, from which the next plan starts when the result
    /// is known.
    pub(crate) fn resume_plan_at(&mut self, jet: &Jet) {
        self.cursor.rest.position = Some(jet.position);
        self.cursor.pass_rest();
    }

    /// The setpoint of an accepted jet.
    pub(crate) fn takeover_setpoint(&mut self, jet: Jet, is_held: bool) -> Setpoint {
        let mut bits = 0;
        for (set, bit) in [
            (is_held, flags::HOLD),
            (self.fault.is_some(), flags::GUARD),
            (self.is_over(), flags::LAST),
        ] {
            if set {
                bits |= bit;
            }
        }
        self.setpoint(jet, self.cursor.path(), bits)
    }
}
