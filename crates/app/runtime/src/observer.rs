//! How a run goes, told to whoever started it.

use std::collections::VecDeque;
use std::sync::mpsc::Receiver;
use std::thread;
use std::time::Duration;

use evolvent_machine::FeedbackMode;
use evolvent_trace::RecordError;

use crate::job::{Clock, Job};
use crate::news::{ExternalEventKind, FeederEvent, Moment, Notice, notices_due};
use crate::shared::Controls;
use crate::standby::needs_load;

/// What is noted where drives answer.
const DRIVES_UNWATCHED: &str = "drives answer on the bus, but `run` does not watch them: nothing stops it \
     where one fails or does not follow. That takes power, homing and alarms that stay, which `evolvent \
     serve` has";
/// The same for a run that goes by what they cut.
const DRIVES_HALF_WATCHED: &str = "drives answer on the bus: the run ends if they stop by themselves; a \
     following error or lost feedback does not stop it, because that takes power, homing and alarms that \
     stay, which `evolvent serve` has";
/// How often the caller hears of progress.
const PROGRESS_EVERY: Duration = Duration::from_millis(50);
/// The same where time is not real: runs may be over at once.
const PROGRESS_EVERY_VIRTUAL: Duration = Duration::from_millis(2);

/// Tells the caller how the run goes.
pub trait RunObserver {
    /// Called about twenty times a second.
    fn progress(&mut self, controls: &Controls);

    /// Something between moves has taken effect.
    fn notice(&mut self, notice: &Notice);

    /// Something that the user should know at once.
    fn note(&mut self, text: &str);
}

/// Looks on at a run for its observer.
pub(crate) struct LookingOn<'a> {
    controls: &'a Controls,
    notices: &'a Receiver<FeederEvent>,
    failures: &'a Receiver<RecordError>,
    every: Duration,
    /// Drives are to be watched where there are any.
    minds_drives: bool,
    /// What is noted where drives answer, and whether it was.
    of_drives: &'static str,
    told: Option<&'static str>,
}

impl<'a> LookingOn<'a> {
    pub(crate) fn new(
        job: &Job,
        controls: &'a Controls,
        notices: &'a Receiver<FeederEvent>,
        failures: &'a Receiver<RecordError>,
    ) -> Self {
        Self {
            controls,
            notices,
            failures,
            every: match job.clock {
                Clock::Realtime => PROGRESS_EVERY,
                Clock::Virtual => PROGRESS_EVERY_VIRTUAL,
            },
            minds_drives: job.setup.machine.drives.feedback != FeedbackMode::Ignore,
            of_drives: if needs_load(job, controls) {
                DRIVES_HALF_WATCHED
            } else {
                DRIVES_UNWATCHED
            },
            told: None,
        }
    }

    /// What was noted of drives that answer.
    pub(crate) fn told_of_drives(&self) -> Option<&'static str> {
        self.told
    }

    /// Passes on news until `finished`.
    pub(crate) fn until(&mut self, observer: &mut dyn RunObserver, finished: impl Fn() -> bool) {
        // The planner is far ahead: a notice is passed on once the cycle has got there.
        let mut ahead: VecDeque<Notice> = VecDeque::new();
        loop {
            let over = finished();
            if !over {
                thread::sleep(self.every);
            }
            for news in self.notices.try_iter() {
                match news {
                    FeederEvent::Notice(notice) => ahead.push_back(notice),
                    FeederEvent::ExternalEvent(outside) => observer.notice(&Notice {
                        moment: Moment::Rest(0),
                        line: outside.code,
                        is_message: outside.kind == ExternalEventKind::Output,
                        text: outside.text,
                    }),
                    _ => {}
                }
            }
            let progress = self.controls.progress();
            loop {
                let due = notices_due(&ahead, progress.actions, progress.blocks, progress.has_ended);
                if due == 0 {
                    break;
                }
                ahead.drain(..due).for_each(|notice| observer.notice(&notice));
            }
            for error in self.failures.try_iter() {
                observer.note(&error.to_string());
            }
            if self.minds_drives && self.told.is_none() && self.controls.drives().is_some() {
                observer.note(self.of_drives);
                self.told = Some(self.of_drives);
            }
            observer.progress(self.controls);
            if over {
                break;
            }
        }
    }
}
