//! Cutter compensation: G40 to G42.1.

use evolvent_path::{Axes, Curve};

use crate::codes::Compensation;
use crate::diagnostic::Fault;
use crate::execute::Executor;
use crate::{Code, MoveKind};

/// What compensation keeps between lines.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CutterState {
    pub(crate) code: Compensation,
    /// Where the program is, while the tool's centre is elsewhere.
    pub(crate) programmed: Option<Axes>,
}

impl Default for CutterState {
    fn default() -> Self {
        Self {
            code: Compensation::Off,
            programmed: None,
        }
    }
}

impl CutterState {
    pub(crate) fn is_on(&self) -> bool {
        self.code != Compensation::Off
    }
}

impl Executor<'_> {
    pub(crate) fn compensation(&mut self, code: Compensation) -> Result<(), Fault> {
        if code == Compensation::Off {
            return Ok(());
        }
        let span = self.line.group_span(crate::codes::Group::CutterCompensation);
        Err(Fault::new(
            Code::UnsupportedG,
            span,
            "G41 and G42 are not available yet",
        ))
    }

    pub(crate) fn leave_compensation(&mut self) -> Result<(), Fault> {
        Ok(())
    }

    pub(crate) fn compensated_line(&mut self, target: Axes, kind: MoveKind) -> Result<(), Fault> {
        self.put_line(target, kind)
    }

    pub(crate) fn compensated_arc(&mut self, _curve: Curve) -> Result<(), Fault> {
        Ok(())
    }
}
