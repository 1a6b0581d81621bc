//! Long programs are checked beside, while the machine stands or is jogged; no program starts before it is checked.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::thread;

use evolvent_control::{Alarm, Rejection};

use super::files::Look;
use super::programs::sentence;
use crate::check::{CheckBounds, check_while};
use crate::job::Setup;
use crate::memory::ProgramMemory;
use crate::rt::take_turns;

/// A check under way, or what it came to.
#[derive(Debug)]
pub(super) struct Checking {
    look: Look,
    /// What offsets and tools were then.
    memory: ProgramMemory,
    verdict: Option<Result<(), Rejection>>,
    /// Whether [`Checking::objection`] has told the verdict.
    is_told: bool,
    result: Receiver<Result<(), Rejection>>,
    superseded: Arc<AtomicBool>,
}

impl Checking {
    /// Begins to check a program on a thread of its own.
    pub(super) fn begin(look: Look, setup: &Setup) -> Result<Self, Rejection> {
        let (sender, result) = mpsc::channel();
        let superseded = Arc::new(AtomicBool::new(false));
        let (told, file, of_thread) = (Arc::clone(&superseded), look.file.clone(), setup.clone());
        let spawned = thread::Builder::new().name("checker".into()).spawn(move || {
            take_turns();
            let verdict = judge(&file, &of_thread, 0, CheckBounds::whole(1), || {
                !told.load(Ordering::Relaxed)
            });
            let _gone = sender.send(verdict);
        });
        spawned
            .map_err(|error| Rejection::new(Alarm::Planner, format!("no thread to check with: {error}")))?;
        Ok(Self {
            look,
            memory: setup.memory.clone(),
            verdict: None,
            is_told: false,
            result,
            superseded,
        })
    }

    /// Whether it is about this program as it is now, with the offsets and tools of now.
    pub(super) fn is_about(&self, look: &Look, setup: &Setup) -> bool {
        *look == self.look && self.memory == setup.memory
    }

    /// What is wrong with the program, once, whoever has asked for the verdict before.
    pub(super) fn objection(&mut self) -> Option<String> {
        if self.is_told {
            return None;
        }
        let verdict = self.verdict()?;
        let objection = verdict.as_ref().err().map(|refusal| refusal.text.clone());
        self.is_told = true;
        objection
    }

    /// What it came to; none while it is under way.
    pub(super) fn verdict(&mut self) -> Option<&Result<(), Rejection>> {
        if self.verdict.is_none() {
            self.verdict = match self.result.try_recv() {
                Ok(verdict) => Some(verdict),
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Disconnected) => {
                    let text = "the check of the program has died; load it again, and report this";
                    Some(Err(Rejection::new(Alarm::BadProgram, text)))
                }
            };
        }
        self.verdict.as_ref()
    }
}

impl Drop for Checking {
    fn drop(&mut self) {
        self.superseded.store(true, Ordering::Relaxed);
    }
}

/// The errors that program text and machine raise against a program; its lines count from an offset.
pub(super) fn judge(
    file: &Path,
    setup: &Setup,
    lines_before: u32,
    bounds: CheckBounds,
    go_on: impl FnMut() -> bool,
) -> Result<(), Rejection> {
    let found = check_while(file, setup, bounds, go_on)
        .map_err(|error| Rejection::new(Alarm::File, format!("{}: {error}", file.display())))?;
    match found.errors.first() {
        None => Ok(()),
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

    /// A check of no file, which comes to what is sent.
    fn checking() -> (mpsc::Sender<Result<(), Rejection>>, Checking) {
        let (sender, result) = mpsc::channel();
        let look = Look {
            file: "long.ngc".into(),
            bytes: 1_000_000,
            changed: None,
        };
        let checking = Checking {
            look,
            memory: ProgramMemory::default(),
            verdict: None,
            is_told: false,
            result,
            superseded: Arc::default(),
        };
        (sender, checking)
    }

    #[test]
    fn an_objection_is_told_once_although_a_start_has_heard_it_first() {
        for start_comes_first in [false, true] {
            let (sender, mut checking) = checking();
            assert_eq!(checking.objection(), None, "under way");
            let refusal = Rejection::new(Alarm::BadProgram, "line 7: no such word");
            sender.send(Err(refusal.clone())).unwrap();
            if start_comes_first {
                assert_eq!(checking.verdict(), Some(&Err(refusal.clone())));
            }
            assert_eq!(checking.objection(), Some(refusal.text.clone()));
            assert_eq!(checking.objection(), None, "once");
            assert_eq!(checking.verdict(), Some(&Err(refusal)), "each start hears it");
        }
    }

    #[test]
    fn there_is_nothing_to_tell_of_a_good_program_and_a_word_of_a_check_that_died() {
        let (sender, mut good) = checking();
        sender.send(Ok(())).unwrap();
        assert_eq!((good.objection(), good.verdict()), (None, Some(&Ok(()))));
        let (sender, mut died) = checking();
        drop(sender);
        assert!(died.objection().is_some_and(|text| text.contains("has died")));
    }
}
