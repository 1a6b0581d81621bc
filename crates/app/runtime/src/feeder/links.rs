//! The feeder's ways to the cycle, beside the plan.

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

/// How long the planner sleeps while those handed over before are driven.
const HANDOVER_NAP: Duration = Duration::from_millis(1);

/// Reports user-defined M codes in a run: to the thread that carries them out, and to the cycle, which waits
/// there.
pub(crate) struct ToCarrier {
    pub calls: Sender<(u32, UserCall)>,
    pub stops: Producer<u32>,
    pub controls: Arc<Controls>,
}

/// Where nothing is driven there are none.
#[derive(Default)]
pub(super) struct CycleLinks {
    pub(super) processes: Option<ProcessSender>,
    pub(super) probings: Option<ProbingSender>,
    pub(super) threadings: Option<ThreadingSender>,
    /// Of outputs and waits.
    pub(super) signals: Option<Scheduler>,
    pub(super) carrier: Option<ToCarrier>,
}

/// Hands something that takes over to the cycle as soon as there is room; `false` where nothing is driven.
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
        // Holds and overrides are answered meanwhile.
        planner.poll()?;
        std::thread::sleep(HANDOVER_NAP);
    }
}
