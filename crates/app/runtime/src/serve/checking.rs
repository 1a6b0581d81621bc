//! Long programs are checked on a separate thread, while the machine is stopped or jogged. No program starts
//! before its check is complete.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::thread;

use evolvent_control::{Alarm, Rejection};
use evolvent_path::AxisMask;

use super::files::FileVersion;
use super::programs::sentence;
use crate::check::check_while;
use crate::check_bounds::{CheckBounds, Unchecked};
use crate::job::Setup;
use crate::memory::ProgramMemory;
use crate::rt::take_turns;

/// How much of a program without a known error was checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Coverage {
    /// All of it.
    Whole,
    /// A part, and the reason why the check ended there.
    Part(Unchecked),
}

impl Coverage {
    /// A caution about the unchecked part, if any.
    pub(super) fn caution(&self) -> Option<String> {
        match self {
            Self::Whole => None,
            Self::Part(unchecked) => Some(format!("{unchecked}; an error after it stops the program there")),
        }
    }
}

/// Result of a check.
pub(super) type CheckVerdict = Result<Coverage, Rejection>;

/// A check in progress, or its result.
#[derive(Debug)]
pub(super) struct Checking {
    version: FileVersion,
    /// Offsets and tools when the check began.
    memory: ProgramMemory,
    /// Axes that were not homed when the check began; their positions were not checked.
    unhomed: AxisMask,
    verdict: Option<CheckVerdict>,
    /// Whether [`Checking::finding`] has returned the verdict.
    is_reported: bool,
    result: Receiver<CheckVerdict>,
    superseded: Arc<AtomicBool>,
}

impl Checking {
    /// Starts to check a program on a separate thread.
    pub(super) fn begin(version: FileVersion, setup: &Setup) -> Result<Self, Rejection> {
        let (sender, result) = mpsc::channel();
        let superseded = Arc::new(AtomicBool::new(false));
        let (is_superseded, file, of_thread) = (Arc::clone(&superseded), version.file.clone(), setup.clone());
        let spawned = thread::Builder::new().name("checker".into()).spawn(move || {
            take_turns();
            let verdict = judge(&file, &of_thread, 0, CheckBounds::whole(1), || {
                !is_superseded.load(Ordering::Relaxed)
            });
            let _gone = sender.send(verdict);
        });
        spawned
            .map_err(|error| Rejection::new(Alarm::Planner, format!("no thread to check with: {error}")))?;
        Ok(Self {
            version,
            memory: setup.memory.clone(),
            unhomed: setup.unhomed,
            verdict: None,
            is_reported: false,
            result,
            superseded,
        })
    }

    /// Whether the check is about the current file, offsets, tools and homed axes.
    pub(super) fn is_about(&self, version: &FileVersion, setup: &Setup) -> bool {
        *version == self.version && self.memory == setup.memory && self.unhomed == setup.unhomed
    }

    /// What is wrong with the program, or which part could not be checked. Returned once;
    /// [`Checking::verdict`] is independent of it.
    pub(super) fn finding(&mut self) -> Option<Finding> {
        if self.is_reported {
            return None;
        }
        let finding = match self.verdict()? {
            Ok(coverage) => coverage.caution().map(Finding::Caution),
            Err(refusal) => Some(Finding::Objection(refusal.text.clone())),
        };
        self.is_reported = true;
        finding
    }

    /// The caution for the client that starts the program.
    pub(super) fn caution(&self) -> Option<String> {
        self.verdict.as_ref()?.as_ref().ok()?.caution()
    }

    /// The verdict; `None` while the check is in progress.
    pub(super) fn verdict(&mut self) -> Option<&CheckVerdict> {
        if self.verdict.is_none() {
            self.verdict = match self.result.try_recv() {
                Ok(verdict) => Some(verdict),
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Disconnected) => {
                    let text = "the check of the program ended unexpectedly; load it again, and report this";
                    Some(Err(Rejection::new(Alarm::BadProgram, text)))
                }
            };
        }
        self.verdict.as_ref()
    }
}

/// What a check reports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Finding {
    /// The program does not start.
    Objection(String),
    /// The program starts, but part of it was not checked.
    Caution(String),
}

impl Drop for Checking {
    fn drop(&mut self) {
        self.superseded.store(true, Ordering::Relaxed);
    }
}

/// Checks a program against the language and the machine. Line numbers in errors count from an offset.
pub(super) fn judge(
    file: &Path,
    setup: &Setup,
    lines_before: u32,
    bounds: CheckBounds,
    go_on: impl FnMut() -> bool,
) -> CheckVerdict {
    let found = check_while(file, setup, bounds, go_on)
        .map_err(|error| Rejection::new(Alarm::File, format!("{}: {error}", file.display())))?;
    match found.errors.first() {
        None => Ok(found.unchecked.map_or(Coverage::Whole, Coverage::Part)),
        Some(first) => {
            let alarm = if first.code == evolvent_gcode::Code::BeyondTravel {
                Alarm::SoftLimit
            } else {
                Alarm::BadProgram
            };
            Err(Rejection::new(alarm, sentence(first, lines_before)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A check without a file, whose verdict is what the sender sends.
    fn checking() -> (mpsc::Sender<CheckVerdict>, Checking) {
        let (sender, result) = mpsc::channel();
        let version = FileVersion {
            file: "long.ngc".into(),
            bytes: 1_000_000,
            changed: None,
        };
        let checking = Checking {
            version,
            memory: ProgramMemory::default(),
            unhomed: AxisMask::NONE,
            verdict: None,
            is_reported: false,
            result,
            superseded: Arc::default(),
        };
        (sender, checking)
    }

    #[test]
    fn an_objection_is_reported_once_even_after_a_start() {
        for start_comes_first in [false, true] {
            let (sender, mut checking) = checking();
            assert_eq!(checking.finding(), None, "under way");
            let refusal = Rejection::new(Alarm::BadProgram, "line 7: no such word");
            sender.send(Err(refusal.clone())).unwrap();
            if start_comes_first {
                assert_eq!(checking.verdict(), Some(&Err(refusal.clone())));
            }
            let finding = Finding::Objection(refusal.text.clone());
            assert_eq!(checking.finding(), Some(finding));
            assert_eq!(checking.finding(), None, "once");
            assert_eq!(checking.verdict(), Some(&Err(refusal)), "each start hears it");
        }
    }

    #[test]
    fn a_good_check_is_silent_and_a_dead_one_objects() {
        let (sender, mut good) = checking();
        sender.send(Ok(Coverage::Whole)).unwrap();
        assert_eq!(
            (good.finding(), good.verdict()),
            (None, Some(&Ok(Coverage::Whole)))
        );
        assert_eq!(good.caution(), None);
        let (sender, mut died) = checking();
        drop(sender);
        let finding = died.finding();
        assert!(matches!(finding, Some(Finding::Objection(text)) if text.contains("ended unexpectedly")));
    }
}
