//! Reads the profile of a turning cycle: a subroutine is executed, and its moves are stored instead of
//! output.

use std::io::BufRead;

use crate::Code;
use crate::Diagnostic;
use crate::codes::modal_groups::{FeedMode, Motion};
use crate::diagnostics::diagnostic::Fault;
use crate::execution::cycles::profile::Corner;
use crate::execution::cycles::roughing::{RoughCall, profile_of};
use crate::interpreter::Interpreter;
use crate::parameters::names::NormalizedName;
use crate::state::machine_state::{ProgrammedFeed, State};
use crate::syntax::statement::Statement;

/// A cycle that waits for its profile.
#[derive(Debug)]
pub(crate) struct Capture {
    call: RoughCall,
    /// Number of frames before the subroutine.
    call_depth: usize,
    /// Index of its first command.
    first: usize,
    /// The state that it must leave unchanged.
    state: State,
    statement: Statement,
    /// The line of the cycle, for errors, and its number for commands.
    text: Vec<u8>,
    line: u32,
    number: u32,
    /// Whether the approach to the profile has been executed.
    has_approach: bool,
    /// Fillet or chamfer of the present line.
    corner: Option<Corner>,
    /// Fillets and chamfers of the commands.
    corners: Vec<(usize, Corner)>,
}

impl<R: BufRead> Interpreter<R> {
    /// Enters the subroutine of a cycle.
    pub(crate) fn begin_profile(&mut self, call: RoughCall) -> Result<(), Fault> {
        let span = self.current.statement.motion_span();
        if self.capture.is_some() {
            let message = "a cycle along a profile inside a profile";
            return Err(Fault::new(Code::ProfileRefused, span, message)
                .help("a profile must contain only G0, G1, G2 and G3"));
        }
        let call_depth = self.flow.frames.len();
        let text = NormalizedName::of_number(call.number);
        let Some(label) = self.flow.labels.intern_label(&text) else {
            return Err(Fault::new(
                Code::BadName,
                span,
                "there are too many names of O-words",
            ));
        };
        self.flow.arguments.clear();
        let number = self.program_line();
        let (line, source) = (self.current.number, self.current.text.clone());
        self.enter(&text, label, span, true, 1)
            .map_err(|fault| match fault.code {
                Code::SubroutineMissing => fault.help(
                    "Q names a subroutine that holds the profile: put it between O100 sub and O100 endsub \
                     before this line and write Q100; block numbers (N100, as P and Q of other controls) are \
                     not used",
                ),
                _ => fault,
            })?;
        self.capture = Some(Box::new(Capture {
            call,
            call_depth,
            first: self.output.pending.len(),
            state: self.state,
            statement: self.current.statement.clone(),
            text: source,
            line,
            number,
            has_approach: false,
            corner: None,
            corners: Vec::new(),
        }));
        // Speeds in the profile are meaningless, so none is required.
        self.state.modes.feed_mode = FeedMode::PerMinute;
        self.state.modes.feed = Some(ProgrammedFeed::PerMinute {
            word: 60.0,
            linear_mm_s: 1.0,
        });
        if !matches!(self.state.motion, Motion::Rapid | Motion::Linear | Motion::Arc(_)) {
            self.state.motion = Motion::Linear;
        }
        Ok(())
    }

    /// In a profile A is a fillet and C a chamfer at the end of the line.
    pub(crate) fn read_corner(&mut self) -> Result<(), Fault> {
        let unit = self.state.unit_mm();
        let Some(capture) = &mut self.capture else {
            return Ok(());
        };
        capture.corner = None;
        let mut invalid = None;
        self.current.block.words.retain(|word| {
            let kind = match word.letter {
                b'A' => Corner::Fillet(word.value * unit),
                b'C' => Corner::Chamfer(word.value * unit),
                _ => return true,
            };
            if word.value <= 0.0 || capture.corner.is_some() {
                invalid = Some(word.span);
            }
            capture.corner = Some(kind);
            false
        });
        match invalid {
            None => Ok(()),
            Some(span) => {
                let message = "one fillet A or one chamfer C, above 0";
                Err(Fault::new(Code::OutOfRange, span, message))
            }
        }
    }

    /// Called after a valid line of the profile.
    pub(crate) fn record_profile_line(&mut self) {
        let moves = self.current.statement.motion().is_some() && self.current.statement.has_axes();
        let Some(capture) = &mut self.capture else { return };
        let corner = capture.corner.take();
        if !capture.has_approach && moves {
            // The first move only leads to the profile, and may have no length.
            capture.has_approach = true;
            self.output.pending.truncate(capture.first);
        } else if let Some(corner) = corner
            && let Some(last) = self.output.pending.len().checked_sub(capture.first + 1)
        {
            capture.corners.push((last, corner));
        }
    }

    /// Called after each line: takes its commands, and executes the cycle when the subroutine has ended.
    pub(crate) fn finish_profile(&mut self) -> Result<(), Box<Diagnostic>> {
        let inside = self.flow.frames.len();
        let Some(capture) = &mut self.capture else {
            return Ok(());
        };
        if self.finished {
            let fault = Fault::new(
                Code::ProfileRefused,
                capture.statement.motion_span(),
                "the program ends inside the profile of this cycle",
            )
            .help("a profile must end with O.. endsub");
            let diagnostic = Box::new(fault.locate(capture.line, &capture.text));
            self.output.pending.truncate(capture.first);
            self.capture = None;
            return Err(diagnostic);
        }
        if inside > capture.call_depth {
            return Ok(());
        }
        let Some(capture) = self.capture.take() else {
            return Ok(());
        };
        self.end_profile(&capture)
    }

    fn end_profile(&mut self, capture: &Capture) -> Result<(), Box<Diagnostic>> {
        let commands: Vec<_> = self
            .output
            .pending
            .drain(capture.first.min(self.output.pending.len())..)
            .collect();
        let mut state = capture.state;
        self.state = state;
        let profile = profile_of(&commands, &capture.corners, &state);
        let mut executor = self.executor(&capture.statement, &mut state, capture.number);
        let result = executor.rough(&capture.call, profile.as_deref().map_err(|fault| *fault));
        match result {
            Ok(()) => {
                self.parameters.commit();
                self.state = state;
                Ok(())
            }
            Err(fault) => {
                self.output.pending.truncate(capture.first);
                self.parameters.roll_back();
                Err(Box::new(fault.locate(capture.line, &capture.text)))
            }
        }
    }
}
