//! Beginning at a line in the middle of a program.

use std::io::BufRead;

use evolvent_path::{Axes, Plane};

use crate::codes::{Compensation, FeedMode, PlaneCode};
use crate::diagnostic::{Fault, Span};
use crate::interpreter::Interpreter;
use crate::state::{INCH_MM, State};
use crate::{Action, Code, Diagnostic, PathMode, SpindleDirection};

/// What the lines before a restart have left behind. The user has to see it before anything moves: the machine is
/// brought to `position` and into this state first.
#[derive(Clone, Debug, PartialEq)]
pub struct Restart {
    /// The line that is executed first; later than asked for where that line is inside a subroutine.
    pub line: u32,
    /// Where the program supposes the tool to be, machine coordinates (mm, degrees). The first move begins there.
    pub position: Axes,
    /// What has to be switched on or changed, in this order: tool, spindle, coolant.
    pub actions: Vec<Action>,
    /// The modes in force, for people: `G1 G17 G21 G90 G94 G54 G64 F1000 S500 M3 T2 M8`.
    pub modes: String,
}

impl<R: BufRead> Interpreter<R> {
    /// Interprets all lines before a line without handing anything out, and says what they leave behind; the next
    /// command is that of the line. Loops and subroutines before it are run. To be called before the first
    /// command is asked for. Takes as long as the lines before take to be interpreted, without allocation but for
    /// the result.
    ///
    /// # Errors
    /// The first error of the lines before; [`Code::RestartRefused`] if the program ends before the line, or the line
    /// is in the middle of cutter compensation or of a NURBS.
    pub fn start_at(&mut self, line: u32) -> Result<Restart, Box<Diagnostic>> {
        let tool = self.state().tool;
        while self.next_of_program() < line || self.is_inside() {
            self.step_silently()?;
            if self.is_finished() {
                return Err(Box::new(
                    self.refuse(format!("the program ends before line {line}")),
                ));
            }
        }
        let state = *self.state();
        if state.cutter.is_on() || state.cutter.programmed.is_some() {
            return Err(Box::new(
                self.refuse(format!("line {line} is in the middle of cutter compensation")),
            ));
        }
        if state.nurbs_order.is_some() {
            return Err(Box::new(
                self.refuse(format!("line {line} is in the middle of a NURBS")),
            ));
        }
        let mut actions = Vec::new();
        if state.tool != tool {
            actions.push(Action::ChangeTool(state.tool));
        }
        if state.modes.spindle != SpindleDirection::Stopped {
            actions.push(match state.modes.surface {
                Some(max_rpm) => Action::SurfaceSpeed {
                    direction: state.modes.spindle,
                    metres_per_minute: state.modes.speed,
                    max_rpm,
                },
                None => Action::Spindle {
                    direction: state.modes.spindle,
                    speed_rpm: state.modes.speed,
                },
            });
        }
        if state.modes.mist || state.modes.flood {
            actions.push(Action::Coolant {
                mist: state.modes.mist,
                flood: state.modes.flood,
            });
        }
        Ok(Restart {
            line: self.next_of_program(),
            position: state.position,
            actions,
            modes: state.shown(),
        })
    }

    fn refuse(&self, message: String) -> Diagnostic {
        let place = Span::new(0, self.text.len());
        Fault::new(Code::RestartRefused, place, message)
            .help("choose a line between two operations, such as a rapid move to the next one")
            .locate(self.line, &self.text)
    }
}

impl State {
    /// The modes as a line of codes.
    fn shown(&self) -> String {
        let modes = &self.modes;
        let mut words = vec![self.motion.name().to_owned()];
        words.push(
            match modes.plane {
                PlaneCode::Main(Plane::Xy) => "G17",
                PlaneCode::Main(Plane::Zx) => "G18",
                PlaneCode::Main(Plane::Yz) => "G19",
                PlaneCode::Secondary(Plane::Xy) => "G17.1",
                PlaneCode::Secondary(Plane::Zx) => "G18.1",
                PlaneCode::Secondary(Plane::Yz) => "G19.1",
            }
            .to_owned(),
        );
        let either = |yes: bool, one: &str, other: &str| (if yes { one } else { other }).to_owned();
        words.push(either(modes.inches, "G20", "G21"));
        words.push(either(modes.incremental, "G91", "G90"));
        words.push(either(modes.arc_centre_absolute, "G90.1", "G91.1"));
        words.push(
            match modes.feed_mode {
                FeedMode::InverseTime => "G93",
                FeedMode::PerMinute => "G94",
                FeedMode::PerRevolution => "G95",
            }
            .to_owned(),
        );
        words.push(match modes.work_index {
            index @ 0..=5 => format!("G{}", 54 + index),
            index => format!("G59.{}", index - 5),
        });
        words.push(match modes.path_mode {
            PathMode::ExactPath => "G61".to_owned(),
            PathMode::ExactStop => "G61.1".to_owned(),
            PathMode::Blend { tolerance_mm, .. } => tolerance_mm.map_or_else(
                || "G64".to_owned(),
                |mm| format!("G64 P{}", if modes.inches { mm / INCH_MM } else { mm }),
            ),
        });
        words.push(either(modes.retract_to_old, "G98", "G99"));
        words.push(either(modes.diameter, "G7", "G8"));
        words.push(either(self.cutter.code == Compensation::Off, "G40", "G41"));
        if let Some(feed) = modes.feed {
            words.push(format!("F{}", feed.word));
        }
        let turning = match modes.spindle {
            SpindleDirection::Stopped => "M5",
            SpindleDirection::Clockwise => "M3",
            SpindleDirection::CounterClockwise => "M4",
        };
        words.push(format!("S{} {turning}", modes.speed));
        words.push(format!("T{}", self.tool));
        for (on, code) in [(modes.mist, "M7"), (modes.flood, "M8")] {
            if on {
                words.push(code.to_owned());
            }
        }
        words.join(" ")
    }
}
