//! Reports on a program while it is planned.

use std::collections::{BTreeSet, VecDeque};
use std::sync::mpsc::Sender;

use evolvent_gcode::{Modal, Move, MoveKind};
use evolvent_path::Curve;
use evolvent_trace::BlockKind;

use crate::news::{BlockPlan, FeederEvent, Moment, Notice, QueuedBlock, StopKind};
use crate::periphery::Periphery;
use crate::source::Commands;
use crate::switches::Switched;

/// A block that was passed to the planner and is not reported yet.
struct OpenBlock {
    block: u32,
    line: u32,
    kind: BlockKind,
    length_mm: f64,
}

/// Sends events to the listeners of a run and to an observer that follows block by block.
pub(super) struct Reporter {
    listeners: Vec<Sender<FeederEvent>>,
    observer: Option<Sender<FeederEvent>>,
    /// Receives spindle, coolant and tool with the number of the action.
    periphery_listener: Option<Sender<(u32, Periphery)>>,
    /// Whether blocks are reported.
    pub(super) with_blocks: bool,
    open: VecDeque<OpenBlock>,
    /// The job that changes of switches are reported for.
    job: u32,
    modal: Option<Modal>,
    /// Prefix of the names of attached subroutines.
    subroutines: String,
    /// Number of subroutine files that have been attached.
    files_attached: usize,
    /// Lines and texts of notices without a stop that are not released yet.
    passing: Vec<(u32, bool, String)>,
    /// Lines with a warning.
    pub(super) warned: BTreeSet<u32>,
}

impl Reporter {
    pub(super) fn new(listeners: Vec<Sender<FeederEvent>>, with_blocks: bool) -> Self {
        Self {
            listeners,
            observer: None,
            periphery_listener: None,
            with_blocks,
            open: VecDeque::new(),
            job: 0,
            modal: None,
            subroutines: "subroutines/".to_owned(),
            files_attached: 0,
            passing: Vec::new(),
            warned: BTreeSet::new(),
        }
    }

    pub(super) fn report_periphery_to(&mut self, listener: Option<Sender<(u32, Periphery)>>) {
        self.periphery_listener = listener;
    }

    pub(super) fn attach_to(&mut self, folder: String) {
        self.subroutines = folder;
    }

    pub(super) fn report_to(&mut self, observer: Sender<FeederEvent>) {
        self.observer = Some(observer);
    }

    pub(super) fn report_switches_of(&mut self, job: u32) {
        self.job = job;
    }

    // A receiver that is gone needs no events.
    fn to_observer(&self, event: FeederEvent) {
        if let Some(observer) = &self.observer {
            let _gone = observer.send(event);
        }
    }

    pub(super) fn stop(&mut self, action: u32, kind: StopKind) {
        self.release(Moment::Rest(action));
        self.to_observer(FeederEvent::Stop(action, kind));
    }

    pub(super) fn switched(&self, switched: Switched) {
        for listener in &self.listeners {
            let _gone = listener.send(FeederEvent::Switched(self.job, switched));
        }
    }

    /// Reports the periphery from the action of this number on.
    pub(super) fn periphery(&self, action: u32, periphery: Periphery) {
        if let Some(listener) = &self.periphery_listener {
            let _gone = listener.send((action, periphery));
        }
        self.to_observer(FeederEvent::Periphery(action, periphery));
    }

    /// Attaches the files that the program has called.
    pub(super) fn attach_files(&mut self, commands: &Commands) {
        if commands.file_count() == self.files_attached {
            return;
        }
        for (name, text) in commands.files().skip(self.files_attached) {
            for listener in &self.listeners {
                let name = format!("{}{name}", self.subroutines);
                let _gone = listener.send(FeederEvent::Attach(name, text.clone()));
            }
        }
        self.files_attached = commands.file_count();
    }

    /// Reports the modes from the next block on, if they have changed.
    pub(super) fn modal(&mut self, commands: &Commands, next_block: u32) {
        if self.observer.is_none() {
            return;
        }
        let modal = commands.modal();
        if self.modal != Some(modal) {
            self.modal = Some(modal);
            self.to_observer(FeederEvent::Modal(next_block, modal));
        }
    }

    /// Reports a notice at rest, with the action of this number.
    pub(super) fn announce(&mut self, action: u32, line: u32, is_message: bool, text: &str) {
        self.release(Moment::Rest(action));
        self.send(Moment::Rest(action), line, is_message, text);
    }

    /// Reports a notice without a stop: it appears when the program reaches it, with the next block or at
    /// rest before it.
    pub(super) fn announce_in_passing(&mut self, line: u32, is_message: bool, text: &str) {
        self.passing.push((line, is_message, text.to_owned()));
    }

    /// Whether there are notices without a stop whose moment is still open.
    pub(super) fn has_passing(&self) -> bool {
        !self.passing.is_empty()
    }

    /// Releases the notices without a stop: they appear at this moment.
    pub(super) fn release(&mut self, moment: Moment) {
        for (line, is_message, text) in std::mem::take(&mut self.passing) {
            self.send(moment, line, is_message, &text);
        }
    }

    fn send(&self, moment: Moment, line: u32, is_message: bool, text: &str) {
        for listener in self.listeners.iter().chain(&self.observer) {
            let notice = Notice {
                moment,
                line,
                is_message,
                text: text.to_owned(),
            };
            let _gone = listener.send(FeederEvent::Notice(notice));
        }
    }

    /// Reports a move that was passed to the planner.
    pub(super) fn queued(&mut self, motion: &Move, line: u32, block: u32, path_mm: f64) {
        self.to_observer(FeederEvent::Queued(QueuedBlock {
            block,
            end: motion.curve.end(),
            feed_mm_s: motion.feed_mm_s,
            path_mm,
        }));
        if self.with_blocks {
            let kind = match (motion.kind, &motion.curve) {
                (MoveKind::Rapid, _) => BlockKind::Rapid,
                (_, Curve::Line(_)) => BlockKind::Line,
                (_, Curve::Arc(_)) => BlockKind::Arc,
                (_, Curve::Involute(_)) => BlockKind::Involute,
                (_, Curve::Blend(_) | Curve::Spline(_)) => BlockKind::Other,
            };
            let length_mm = motion.curve.length();
            match self.open.back_mut() {
                Some(open) if open.block == block => open.length_mm += length_mm,
                _ => self.open.push_back(OpenBlock {
                    block,
                    line,
                    kind,
                    length_mm,
                }),
            }
        }
    }

    /// Reports blocks whose plan is final, as numbers and durations in seconds; all except the last one
    /// unless `all`.
    pub(super) fn blocks(&mut self, finished: &mut VecDeque<(u32, f64)>, all: bool) {
        let keep = usize::from(!all);
        while finished.len() > keep {
            let Some((block, planned_s)) = finished.pop_front() else {
                break;
            };
            while let Some(open) = self.open.front() {
                if open.block > block {
                    break;
                }
                let plan = BlockPlan {
                    block: open.block,
                    line: open.line,
                    kind: open.kind,
                    length_mm: open.length_mm,
                    planned_s: if open.block == block { planned_s } else { 0.0 },
                };
                self.open.pop_front();
                for listener in &self.listeners {
                    let _gone = listener.send(FeederEvent::Block(plan));
                }
            }
        }
    }
}
