//! The text for the operator in the status, and how long it is valid.

use evolvent_motion::MotionState;

/// The last message.
#[derive(Debug, Default)]
pub(super) struct OperatorMessage {
    text: String,
    validity: Validity,
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
        self.text.clear();
    }

    /// Reports an event.
    pub(super) fn tell(&mut self, text: impl Into<String>) {
        (self.text, self.validity) = (text.into(), Validity::NextJob);
    }

    /// Reports something about the loaded program.
    pub(super) fn tell_of_program(&mut self, text: impl Into<String>) {
        (self.text, self.validity) = (text.into(), Validity::ThisProgram);
    }

    /// Reports something that is valid during the job only.
    pub(super) fn tell_of_job(&mut self, text: impl Into<String>) {
        (self.text, self.validity) = (text.into(), Validity::ThisJob);
    }

    /// Reports something about the present or next stop of the program, such as a request to the operator.
    pub(super) fn tell_of_stop(&mut self, text: impl Into<String>) {
        (self.text, self.validity) = (text.into(), Validity::Stop { is_there: false });
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
                self.text.clear();
                self.validity = Validity::NextJob;
            } else {
                *is_there |= is_at_rest;
            }
        }
    }

    pub(super) fn job_ends(&mut self) {
        if matches!(self.validity, Validity::ThisJob | Validity::Stop { .. }) {
            self.text.clear();
        }
    }

    /// Another program is about to be loaded.
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
}
