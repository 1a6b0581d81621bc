//! Carries out user-defined M codes during a run.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::thread;
use std::time::Duration;

use evolvent_control::Alarm;

use crate::news::{ExternalEvent, ExternalEventKind, FeederEvent, UserCall};
use crate::shared::Controls;
use crate::user_code::{UserCodes, UserNews};

/// Poll interval of the machine's position in the program.
const LOOK_EVERY: Duration = Duration::from_millis(5);

/// The thread that carries out user-defined M codes.
pub(crate) struct UserCodeRunner {
    pub codes: UserCodes,
    pub controls: Arc<Controls>,
    /// The codes ahead, with the numbers of the actions before them.
    pub calls: Receiver<(u32, UserCall)>,
    /// Receivers of their output.
    pub listeners: Vec<Sender<FeederEvent>>,
}

impl UserCodeRunner {
    /// Carries out each code when the machine has reached it, until the feeder has ended and no code is left,
    /// or the cycle has ended. Returns the reason of a failure, after which the machine was stopped.
    pub(crate) fn run(self) -> Option<String> {
        loop {
            match self.calls.recv_timeout(LOOK_EVERY) {
                Ok((action, call)) => {
                    if !self.arrives(action) {
                        return None;
                    }
                    if let Err(text) = self.carry_out(call) {
                        if self.controls.is_stopping() {
                            return None;
                        }
                        self.controls.raise(Alarm::UserCommand);
                        self.tell(ExternalEventKind::Alarm, Alarm::UserCommand.number(), &text);
                        self.controls.stop();
                        return Some(text);
                    }
                    self.controls.command_done(action);
                }
                Err(RecvTimeoutError::Disconnected) => return None,
                Err(RecvTimeoutError::Timeout) if self.controls.is_abandoned() => return None,
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// Waits until the machine is at the code; `false` if it will never be.
    fn arrives(&self, action: u32) -> bool {
        loop {
            let progress = self.controls.progress();
            if progress.at_command && progress.actions == action + 1 {
                return !self.controls.is_stopping();
            }
            if self.controls.is_abandoned() || self.controls.is_stopping() {
                return false;
            }
            thread::sleep(LOOK_EVERY);
        }
    }

    fn carry_out(&self, call: UserCall) -> Result<(), String> {
        let mut program = self.codes.start(call);
        loop {
            match program.poll() {
                Some(UserNews::Line(line)) => {
                    let text = format!("M{}: {line}", call.number);
                    self.tell(ExternalEventKind::Output, call.line, &text);
                }
                Some(UserNews::Ended(result)) => return result,
                None => {
                    if self.controls.is_stopping() {
                        program.cancel();
                    }
                    thread::sleep(LOOK_EVERY);
                }
            }
        }
    }

    fn tell(&self, kind: ExternalEventKind, code: u32, text: &str) {
        let outside = ExternalEvent {
            sequence: self.controls.progress().cycles.saturating_sub(1),
            kind,
            code,
            text: text.to_owned(),
            value: None,
        };
        for listener in &self.listeners {
            // A listener that is gone needs no events.
            let _gone = listener.send(FeederEvent::ExternalEvent(outside.clone()));
        }
    }
}
