//! The text for the operator in the status, and for how long it is true.

use evolvent_motion::State;

/// The last message.
#[derive(Debug, Default)]
pub(super) struct OperatorMessage {
    text: String,
    validity: Validity,
}

/// Until when a message is shown, if no other takes its place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Validity {
    /// Until the next job begins.
    #[default]
    NextJob,
    /// The same, and until another program is loaded.
    ThisProgram,
    /// Until the job ends that it is about.
    ThisJob,
    /// Until the program goes on from where it stands, or will stand.
    Stop { is_there: bool },
}

impl OperatorMessage {
    pub(super) fn text(&self) -> &str {
        &self.text
    }

    pub(super) fn clear(&mut self) {
        self.text.clear();
    }

    /// Something that has happened.
    pub(super) fn tell(&mut self, text: impl Into<String>) {
        (self.text, self.validity) = (text.into(), Validity::NextJob);
    }

    /// Something about the program that is loaded.
    pub(super) fn tell_of_program(&mut self, text: impl Into<String>) {
        (self.text, self.validity) = (text.into(), Validity::ThisProgram);
    }

    /// Something that is so for no longer than the job.
    pub(super) fn tell_of_job(&mut self, text: impl Into<String>) {
        (self.text, self.validity) = (text.into(), Validity::ThisJob);
    }

    /// Something about the stop at which the program stands or which comes next, such as a request.
    pub(super) fn tell_of_stop(&mut self, text: impl Into<String>) {
        (self.text, self.validity) = (text.into(), Validity::Stop { is_there: false });
    }

    /// The program is in this state.
    pub(super) fn follow(&mut self, state: State) {
        if let Validity::Stop { is_there } = &mut self.validity {
            let stands = matches!(state, State::ProgramStop | State::Held);
            if *is_there && matches!(state, State::Running | State::Dwell | State::Done) {
                self.text.clear();
                self.validity = Validity::NextJob;
            } else {
                *is_there |= stands;
            }
        }
    }

    pub(super) fn job_ends(&mut self) {
        if matches!(self.validity, Validity::ThisJob | Validity::Stop { .. }) {
            self.text.clear();
        }
    }

    /// A program is to be loaded.
    pub(super) fn program_changes(&mut self) {
        if self.validity == Validity::ThisProgram {
            self.text.clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_shown_until_the_program_goes_on() {
        let mut message = OperatorMessage::default();
        message.tell_of_stop("put tool 2 into the spindle");
        for state in [
            State::Running,
            State::ProgramStop,
            State::Held,
            State::ProgramStop,
        ] {
            message.follow(state);
            assert_eq!(message.text(), "put tool 2 into the spindle", "{state:?}");
        }
        message.follow(State::Running);
        assert_eq!(message.text(), "");
    }

    #[test]
    fn what_is_so_during_a_job_only_ends_with_it() {
        let mut message = OperatorMessage::default();
        message.tell_of_job("away from the program");
        message.follow(State::Running);
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
}
