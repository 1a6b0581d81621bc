//! Reports on a run to its caller.

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

/// Note if drives send feedback.
const DRIVES_UNWATCHED: &str = "drives reply on the bus, but `run` does not monitor them: it does not stop \
                                if one fails or does not follow. Monitoring needs power, homing and latched \
                                alarms: use `evolvent serve`";
/// The same for a run that depends on the cutting load.
const DRIVES_HALF_WATCHED: &str = "drives reply on the bus: the run ends if they stop by themselves; a \
                                   following error or lost feedback does not stop it. Monitoring these needs \
                                   power, homing and latched alarms: use `evolvent serve`";
/// Interval of progress reports.
const PROGRESS_EVERY: Duration = Duration::from_millis(50);
/// The same with the virtual clock, whose runs may end at once.
const PROGRESS_EVERY_VIRTUAL: Duration = Duration::from_millis(2);

/// Receives reports on a run.
pub trait RunObserver {
    /// Called about twenty times per second.
    fn progress(&mut self, controls: &Controls);

    /// A notice between moves has taken effect.
    fn notice(&mut self, notice: &Notice);

    /// A note that the user should see at once.
    fn note(&mut self, text: &str);
}

/// Follows a run and reports to its observer.
pub(crate) struct LookingOn<'a> {
    controls: &'a Controls,
    notices: &'a Receiver<FeederEvent>,
    failures: &'a Receiver<RecordError>,
    every: Duration,
    /// Drives must be monitored if there are any.
    minds_drives: bool,
    /// The note about drives that send feedback, and whether it was sent.
    of_drives: &'static str,
    reported_note: Option<&'static str>,
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
            reported_note: None,
        }
    }

    /// The note about drives that send feedback, if it was sent.
    pub(crate) fn drives_note(&self) -> Option<&'static str> {
        self.reported_note
    }

    /// Passes events on until `finished`.
    pub(crate) fn until(&mut self, observer: &mut dyn RunObserver, finished: impl Fn() -> bool) {
        // The planner is far ahead: a notice is passed on once the cycle has reached it.
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
            if self.minds_drives && self.reported_note.is_none() && self.controls.drives().is_some() {
                observer.note(self.of_drives);
                self.reported_note = Some(self.of_drives);
            }
            observer.progress(self.controls);
            if over {
                break;
            }
        }
    }
}
