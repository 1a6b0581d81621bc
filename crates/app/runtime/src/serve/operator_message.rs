//! The text for the operator in the status, and how long it is valid.

use std::collections::VecDeque;

use evolvent_motion::{MotionState, Setpoint};

use crate::joined_messages::{is_same_stop, joined};

/// Maximum number of texts that were replaced before a status had them; beyond it the oldest are dropped.
const MAX_REPLACED: usize = 64;

/// The last message.
#[derive(Debug, Default)]
pub(super) struct OperatorMessage {
    text: String,
    validity: Validity,
    /// Bytes of `text` that are messages of the program at one stop, and the setpoint of the last of them.
    of_program: usize,
    stop: Option<Setpoint>,
    /// Whether a status has had `text`.
    is_sent: bool,
    /// Texts that were replaced before, the oldest first.
    replaced: VecDeque<String>,
}

/// How long a message is shown unless another replaces it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Validity {
    /// Until the next job begins.
    #[default]
    NextJob,
    /// Until the next job begins or another program is loaded.
    ThisProgram,
    /// Until the job that it is about ends.
    ThisJob,
    /// Until the program continues from its present or next stop.
    Stop { is_there: bool },
}

impl OperatorMessage {
    pub(super) fn text(&self) -> &str {
        &self.text
    }

    pub(super) fn clear(&mut self) {
        self.put(String::new(), Validity::NextJob);
    }

    /// Reports an event.
    pub(super) fn tell(&mut self, text: impl Into<String>) {
        self.put(text.into(), Validity::NextJob);
    }

    /// Reports something about the loaded program.
    pub(super) fn tell_of_program(&mut self, text: impl Into<String>) {
        self.put(text.into(), Validity::ThisProgram);
    }

    /// Reports something that is valid during the job only.
    pub(super) fn tell_of_job(&mut self, text: impl Into<String>) {
        self.put(text.into(), Validity::ThisJob);
    }

    /// Reports something about the present or next stop of the program, such as a request to the operator.
    pub(super) fn tell_of_stop(&mut self, text: impl Into<String>) {
        self.put(text.into(), Validity::Stop { is_there: false });
    }

    /// Passes on a message of the program, which takes effect with this setpoint. It is added to those before
    /// it at the same stop.
    pub(super) fn pass_on(&mut self, text: &str, setpoint: &Setpoint, is_at_rest: bool) {
        let validity = if is_at_rest && setpoint.state == MotionState::ProgramStop {
            Validity::Stop { is_there: false }
        } else {
            Validity::NextJob
        };
        let is_same = (self.stop.as_ref()).is_some_and(|before| is_same_stop(before, setpoint));
        let whole = is_same
            .then(|| joined(&self.text[..self.of_program], text))
            .flatten();
        let text = whole.unwrap_or_else(|| text.to_owned());
        let of_program = text.len();
        self.put(text, validity);
        (self.of_program, self.stop) = (of_program, Some(*setpoint));
    }

    /// Reports what the program waits for at its present stop, after the messages of the program there.
    pub(super) fn tell_of_wait(&mut self, text: &str) {
        let (of_program, stop) = (self.of_program, self.stop.take());
        match joined(&self.text[..of_program], text) {
            Some(whole) => {
                self.put(whole, Validity::Stop { is_there: false });
                (self.of_program, self.stop) = (of_program, stop);
            }
            None => self.tell_of_stop(text),
        }
    }

    /// Removes what the program waited for: its messages at this stop remain.
    pub(super) fn end_wait(&mut self) {
        let (of_program, stop, validity) = (self.of_program, self.stop.take(), self.validity);
        self.put(self.text[..of_program].to_owned(), validity);
        (self.of_program, self.stop) = (of_program, stop);
    }

    fn put(&mut self, text: String, validity: Validity) {
        let before = std::mem::replace(&mut self.text, text);
        if !self.is_sent && !before.is_empty() && !self.text.starts_with(&before) {
            if self.replaced.len() >= MAX_REPLACED {
                self.replaced.pop_front();
            }
            self.replaced.push_back(before.clone());
        }
        self.is_sent &= self.text == before;
        (self.validity, self.of_program, self.stop) = (validity, 0, None);
    }

    /// Whether a status is due, because it would have another text than the last.
    pub(super) fn is_unsent(&self) -> bool {
        !self.is_sent || !self.replaced.is_empty()
    }

    /// The next text that needs a status of its own before the present one.
    pub(super) fn take_replaced(&mut self) -> Option<String> {
        self.replaced.pop_front()
    }

    /// Notes that a status has the present text.
    pub(super) fn is_in_status(&mut self) {
        self.is_sent = true;
    }

    /// Notes the state of the program.
    pub(super) fn follow(&mut self, state: MotionState) {
        if let Validity::Stop { is_there } = &mut self.validity {
            let is_at_rest = matches!(state, MotionState::ProgramStop | MotionState::Held);
            if *is_there
                && matches!(
                    state,
                    MotionState::Running | MotionState::Dwell | MotionState::Done
                )
            {
                self.clear();
            } else {
                *is_there |= is_at_rest;
            }
        }
    }

    pub(super) fn job_ends(&mut self) {
        if matches!(self.validity, Validity::ThisJob | Validity::Stop { .. }) {
            self.clear();
        }
    }

    /// Another program is about to be loaded.
    pub(super) fn program_changes(&mut self) {
        if self.validity == Validity::ThisProgram {
            self.clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use evolvent_path::Axes;

    use super::*;

    #[test]
    fn a_request_is_shown_until_the_program_goes_on() {
        let mut message = OperatorMessage::default();
        message.tell_of_stop("put tool 2 into the spindle");
        for state in [
            MotionState::Running,
            MotionState::ProgramStop,
            MotionState::Held,
            MotionState::ProgramStop,
        ] {
            message.follow(state);
            assert_eq!(message.text(), "put tool 2 into the spindle", "{state:?}");
        }
        message.follow(MotionState::Running);
        assert_eq!(message.text(), "");
    }

    #[test]
    fn what_is_so_during_a_job_only_ends_with_it() {
        let mut message = OperatorMessage::default();
        message.tell_of_job("away from the program");
        message.follow(MotionState::Running);
        assert_eq!(message.text(), "away from the program");
        message.job_ends();
        assert_eq!(message.text(), "");
        message.tell("part 7 is done");
        message.job_ends();
        message.program_changes();
        assert_eq!(message.text(), "part 7 is done");
        message.tell_of_program("checked up to line 4");
        message.job_ends();
        assert_eq!(message.text(), "checked up to line 4");
        message.program_changes();
        assert_eq!(message.text(), "");
    }

    fn at(x_mm: f64, state: MotionState) -> Setpoint {
        let mut position = Axes::zeros();
        position[0] = x_mm;
        Setpoint {
            sequence: 0,
            actions: 0,
            state,
            position,
            velocity: Axes::zeros(),
            acceleration: Axes::zeros(),
            jerk: Axes::zeros(),
            path_mm: x_mm,
            feed_mm_s: 0.0,
            feed_override: 1.0,
            line: 0,
            block: 0,
            flags: 0,
        }
    }

    #[test]
    fn messages_at_one_stop_are_one_text() {
        let mut message = OperatorMessage::default();
        message.pass_on("clamp A closed?", &at(5.0, MotionState::Dwell), true);
        message.pass_on("clamp B closed?", &at(5.0, MotionState::ProgramStop), true);
        assert_eq!(message.text(), "clamp A closed?; clamp B closed?");
        message.tell_of_wait("M101 is being carried out");
        assert_eq!(
            message.text(),
            "clamp A closed?; clamp B closed?; M101 is being carried out"
        );
        message.end_wait();
        assert_eq!(message.text(), "clamp A closed?; clamp B closed?");
        message.follow(MotionState::ProgramStop);
        message.follow(MotionState::Running);
        assert_eq!(message.text(), "");
        // After a move, another stop.
        message.pass_on("one", &at(5.0, MotionState::Running), true);
        message.pass_on("two", &at(6.0, MotionState::Running), true);
        assert_eq!(message.text(), "two");
    }

    #[test]
    fn what_no_status_had_is_not_lost() {
        let mut message = OperatorMessage::default();
        message.pass_on("one", &at(5.0, MotionState::Running), true);
        message.pass_on("two", &at(6.0, MotionState::Running), true);
        let long = "x".repeat(255);
        message.pass_on(&long, &at(6.0, MotionState::Running), true);
        message.clear();
        let replaced: Vec<_> = std::iter::from_fn(|| message.take_replaced()).collect();
        assert_eq!(replaced, ["one", "two", &long]);
        assert!(message.is_unsent(), "that there is none is new, too");
        message.is_in_status();
        assert!(!message.is_unsent());
        message.tell("three");
        message.is_in_status();
        message.tell("four");
        message.is_in_status();
        assert_eq!(message.take_replaced(), None, "a status had it");
    }
}
