//! The machine's progress in its job: the planner's reports compared with the cycle.

use std::collections::VecDeque;
use std::sync::mpsc::Receiver;

use evolvent_bus::Status;
use evolvent_gcode::Modal;
use evolvent_motion::{MotionState, Setpoint};

use crate::news::{FeederEvent, Notice, QueuedBlock, StopKind, notices_due};
use crate::periphery::{Periphery, UnplannedMove};

/// What is known of the blocks ahead.
#[derive(Debug, Default)]
pub(crate) struct BlockTrack {
    blocks: VecDeque<QueuedBlock>,
    modals: VecDeque<(u32, Modal)>,
    stops: VecDeque<(u32, StopKind)>,
    peripheries: VecDeque<(u32, Periphery)>,
    notices: VecDeque<Notice>,
    planned_mm: f64,
}

impl BlockTrack {
    /// Takes in the planner's reports.
    pub(crate) fn receive(&mut self, news: &Receiver<FeederEvent>) {
        for news in news.try_iter() {
            match news {
                FeederEvent::Queued(block) => {
                    self.planned_mm = block.path_mm;
                    self.blocks.push_back(block);
                }
                FeederEvent::Modal(block, modal) => self.modals.push_back((block, modal)),
                FeederEvent::Stop(action, kind) => self.stops.push_back((action, kind)),
                FeederEvent::Periphery(action, periphery) => self.peripheries.push_back((action, periphery)),
                FeederEvent::Notice(notice) => self.notices.push_back(notice),
                FeederEvent::Block(_)
                | FeederEvent::File(..)
                | FeederEvent::Attach(..)
                | FeederEvent::AttachFile(..)
                | FeederEvent::Switched(..)
                | FeederEvent::NextFile(_)
                | FeederEvent::ExternalEvent(_) => {}
            }
        }
    }

    /// Notes that the cycle has reached this setpoint. Returns the last modes that took effect, and passes on
    /// the messages that did.
    pub(crate) fn reach(&mut self, setpoint: &Setpoint, mut message: impl FnMut(&Notice)) -> Option<Modal> {
        let still = [MotionState::Idle, MotionState::Dwell, MotionState::ProgramStop];
        let begun = if still.contains(&setpoint.state) {
            0
        } else {
            setpoint.block + 1
        };
        let ended = setpoint.state == MotionState::Done;
        loop {
            let due = notices_due(&self.notices, setpoint.actions, begun, ended);
            if due == 0 {
                break;
            }
            self.notices.drain(..due).for_each(|notice| message(&notice));
        }
        while let (Some(first), Some(second)) = (self.blocks.front(), self.blocks.get(1))
            && (first.block < setpoint.block
                || (first.block == second.block && first.path_mm < setpoint.path_mm))
        {
            self.blocks.pop_front();
        }
        let mut modal = None;
        while self
            .modals
            .front()
            .is_some_and(|(block, _)| *block < begun || ended)
        {
            modal = self.modals.pop_front().map(|(_, modal)| modal);
        }
        modal
    }

    /// Spindle, coolant and tool with this setpoint, if an action changed them since the last call. Actions
    /// take effect at rest, between the preceding motion and what follows, including a dwell or a stop.
    pub(crate) fn take_periphery(&mut self, setpoint: &Setpoint) -> Option<Periphery> {
        let mut newest = None;
        while (self.peripheries.front()).is_some_and(|(action, _)| *action < setpoint.actions) {
            newest = self.peripheries.pop_front().map(|(_, periphery)| periphery);
        }
        newest
    }

    /// The block in progress, with the feed of the present part of it.
    fn block(&self, setpoint: &Setpoint) -> Option<QueuedBlock> {
        let first = self
            .blocks
            .front()
            .filter(|block| block.block >= setpoint.block)?;
        let parts = self.blocks.iter().take_while(|part| part.block == first.block);
        let end = parts.last()?.end;
        Some(QueuedBlock { end, ..*first })
    }

    /// Writes the distances to the end of the block and of what is planned, and the programmed feed.
    /// `unplanned` is the move that the cycle drives now without a plan.
    pub(crate) fn show(&self, status: &mut Status, unplanned: Option<UnplannedMove>, setpoint: &Setpoint) {
        let present = match unplanned {
            Some(motion) => Some((motion.end, motion.feed_mm_s)),
            None => self.block(setpoint).map(|block| (block.end, block.feed_mm_s)),
        };
        let (end, feed_mm_s) = present.unwrap_or((setpoint.position, 0.0));
        status.distance_to_go = (end - setpoint.position).into();
        // A rapid has no programmed feed.
        status.feed_programmed_mm_s = if feed_mm_s.is_finite() { feed_mm_s } else { 0.0 };
        status.path_to_go_mm = present.map_or(0.0, |_| (self.planned_mm - setpoint.path_mm).max(0.0));
    }

    /// The program stop at which the machine is with this setpoint, as the number of the action before it,
    /// and its kind; returned once for each stop.
    pub(crate) fn take_stop(&mut self, setpoint: &Setpoint) -> Option<(u32, StopKind)> {
        while (self.stops.front()).is_some_and(|(action, _)| action + 1 < setpoint.actions) {
            self.stops.pop_front();
        }
        let stands = setpoint.state == MotionState::ProgramStop;
        let is_there = (self.stops.front()).is_some_and(|(action, _)| action + 1 == setpoint.actions);
        if stands && is_there {
            self.stops.pop_front()
        } else {
            None
        }
    }

    /// The modes at the end of the plan, and all remaining messages.
    pub(crate) fn finish(&mut self) -> Option<Modal> {
        let modal = self.modals.pop_back().map(|(_, modal)| modal);
        *self = Self::default();
        modal
    }
}
