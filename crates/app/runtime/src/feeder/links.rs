//! The feeder's channels to the cycle, besides the plan.

use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::time::Duration;

use evolvent_motion::{ProbingSender, ProcessSender, QueueClosed, TakeoverSender, ThreadingSender};
use evolvent_planner::PlanSink;
use evolvent_signals::Scheduler;
use rtrb::Producer;

use crate::news::UserCall;
use crate::shared::Controls;
use crate::stages::Stages;

/// Poll interval of the planner while earlier processes are still running.
const HANDOVER_NAP: Duration = Duration::from_millis(1);

/// Reports user-defined M codes of a run: to the thread that carries them out, and to the cycle, which waits
/// for them.
pub(crate) struct ToCarrier {
    pub calls: Sender<(u32, UserCall)>,
    pub stops: Producer<u32>,
    pub controls: Arc<Controls>,
}

/// Senders to the cycle; all `None` if nothing is driven.
#[derive(Default)]
pub(super) struct CycleLinks {
    pub(super) processes: Option<ProcessSender>,
    pub(super) probings: Option<ProbingSender>,
    pub(super) threadings: Option<ThreadingSender>,
    /// The scheduler of outputs and waits.
    pub(super) signals: Option<Scheduler>,
    pub(super) carrier: Option<ToCarrier>,
}

/// Passes a process on to the cycle as soon as the queue has capacity. Returns `false` if nothing is driven.
pub(super) fn hand_over<T: ?Sized, S: PlanSink<Error = QueueClosed>>(
    sender: &mut Option<TakeoverSender<T>>,
    planner: &mut Stages<S>,
    mut next: Box<T>,
) -> Result<bool, QueueClosed> {
    let Some(sender) = sender else {
        return Ok(false);
    };
    loop {
        match sender.send(next) {
            Ok(()) => return Ok(true),
            Err(_) if sender.is_abandoned() => return Err(QueueClosed),
            Err(back) => next = back,
        }
        // Replies to holds and overrides in the meantime.
        planner.poll()?;
        std::thread::sleep(HANDOVER_NAP);
    }
}
