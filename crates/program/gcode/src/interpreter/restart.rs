//! Starting at a line in the middle of a program.

use std::io::BufRead;

use evolvent_path::{Axes, AxisLetter, Curve, Line, Plane};

use crate::codes::modal_groups::{Compensation, FeedMode, PlaneCode};
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::interpreter::Interpreter;
use crate::state::machine_state::ProgrammedSpeed;
use crate::state::machine_state::{INCH_MM, State};
use crate::{
    Action, CallChain, CanonicalCommand, Code, Diagnostic, Move, MoveKind, PathMode, SPINDLES,
    SpindleDirection,
};

/// The state after the lines before a restart. The user has to see it before any motion: the machine is first
/// brought to `position` and into this state.
#[derive(Clone, Debug, PartialEq)]
pub struct Restart {
    /// The line that is executed first; later than requested if that line is inside a subroutine.
    pub line: u32,
    /// The tool position assumed by the program, in machine coordinates (mm, degrees). The first move starts
    /// there.
    pub position: Axes,
    /// Required actions, in this order: tool, spindle, coolant, outputs.
    pub actions: Vec<Action>,
    /// The active modes for display: `G1 G17 G21 G90 G94 G54 G64 F1000 S500 M3 T2 M8`.
    pub modes: String,
    /// Of these, what turns, flows or says where and how fast the tool moves: `T2 S500 M3 M8 F1000 G54`.
    pub active: String,
    /// The others: `G1 G17 G21 G90 G94 G64`.
    pub geometry: String,
    /// The active feed, mm/s; `None` if there is none or it belongs to single moves (G93).
    pub feed_mm_s: Option<f64>,
    /// The active F word as written, and whether it is in inches: a later G20 or G21 does not change the
    /// speed.
    pub feed_word: Option<(f64, bool)>,
}

/// The approach to the restart position, and its actions.
#[derive(Clone, Debug, PartialEq)]
pub struct Approach {
    /// Commands: the tool, then spindle and coolant, then moves, each of which ends at rest.
    pub commands: Vec<CanonicalCommand>,
    /// The moves for display, one per line: `Z to 100.000, rapid`.
    pub descriptions: Vec<String>,
}

/// Length of the last part of an approach, which uses the feed instead of rapid.
const SLOW_APPROACH_MM: f64 = 5.0;

/// Feed of the last part if the program has none, mm/s.
const SLOW_APPROACH_FEED_MM_S: f64 = 5.0;

impl Restart {
    /// All modes for an operator, who may see the beginning only.
    #[must_use]
    pub fn summary(&self) -> String {
        format!("{} {}", self.active, self.geometry)
    }

    /// The approach from the present position: along `axis` (the tool's: Z of a mill, X of a lathe) away from
    /// the work to at least `clear`, then all other axes, then along `axis` in, the last 5 mm at the active
    /// feed. `clear` is a machine coordinate in mm that is free of obstacles, such as the home position of
    /// the axis. Work and clamps are unknown: the operator has to check the approach first.
    ///
    /// # Errors
    /// [`Code::RestartRefused`] if the position is not finite.
    pub fn approach(&self, from: &Axes, axis: AxisLetter, clear: f64) -> Result<Approach, Box<Diagnostic>> {
        let index = axis.index();
        let mut commands: Vec<CanonicalCommand> = Vec::new();
        let mut descriptions = Vec::new();
        for action in &self.actions {
            commands.push(CanonicalCommand {
                line: self.line,
                action: action.clone(),
                origin: None,
                calls: CallChain::default(),
                feed_mm_rev: None,
                feed_spindle: 0,
                continues: false,
            });
        }
        let mut out = *from;
        out[index] = from[index].max(self.position[index]).max(clear);
        let mut above = self.position;
        above[index] = out[index];
        let mut slow_start = self.position;
        slow_start[index] = out[index].min(self.position[index] + SLOW_APPROACH_MM);
        let slow = MoveKind::Feed;
        let feed = self.feed_mm_s.unwrap_or(SLOW_APPROACH_FEED_MM_S);
        let mut position = *from;
        for (end, kind) in [
            (out, MoveKind::Rapid),
            (above, MoveKind::Rapid),
            (slow_start, MoveKind::Rapid),
            (self.position, slow),
        ] {
            if end == position {
                continue;
            }
            let line = Line::new(position, end).map_err(|error| {
                let span = Span::new(0, 0);
                let message = format!("the start of line {} cannot be approached: {error}", self.line);
                Box::new(Fault::new(Code::RestartRefused, span, message).locate(self.line, b""))
            })?;
            let axes = AxisLetter::ALL
                .into_iter()
                .filter(|axis| end[axis.index()] != position[axis.index()]);
            let words: Vec<String> = axes
                .map(|axis| format!("{} to {:.3}", axis.letter(), end[axis.index()]))
                .collect();
            descriptions.push(match kind {
                MoveKind::Rapid => format!("{}, rapid", words.join(", ")),
                MoveKind::Feed => format!("{}, at {:.1} mm/min", words.join(", "), 60.0 * feed),
            });
            commands.push(CanonicalCommand {
                line: self.line,
                action: Action::Move(Move {
                    curve: Curve::Line(line),
                    kind,
                    feed_mm_s: if kind == MoveKind::Rapid {
                        f64::INFINITY
                    } else {
                        feed
                    },
                    path_mode: PathMode::ExactStop,
                }),
                origin: None,
                calls: CallChain::default(),
                feed_mm_rev: None,
                feed_spindle: 0,
                continues: false,
            });
            position = end;
        }
        Ok(Approach {
            commands,
            descriptions,
        })
    }
}

impl<R: BufRead> Interpreter<R> {
    /// Interprets all lines before `line` without output, and returns the resulting state; the next command
    /// is that of `line`. Loops and subroutines before it are executed. Call it before the first command is
    /// requested. It takes as long as interpreting the lines before, and allocates only the result.
    ///
    /// # Errors
    /// The first error of the lines before; [`Code::TooManySteps`] if they loop without end;
    /// [`Code::RestartRefused`] if the program ends before the line, the line is inside cutter compensation
    /// or a NURBS, or a probing move comes before it: offsets and positions may depend on an unknown contact.
    /// A line that continues a thread is no error here, but the first command is
    /// ([`Interpreter::starts_after_thread`]).
    pub fn start_at(&mut self, line: u32) -> Result<Restart, Box<Diagnostic>> {
        let tool = self.state().tool;
        let waits_succeed = std::mem::replace(&mut self.settings.waits_succeed, true);
        // An earlier run has changed and measured the tools, and the tool table contains their lengths and
        // pockets, so the tool-change subroutine is not executed. In an MDI block it is.
        let changer = (self.settings.features.tool_change).take_if(|_| !self.settings.is_mdi);
        let executed = self.execute_before(line);
        self.settings.waits_succeed = waits_succeed;
        if changer.is_some() {
            self.settings.features.tool_change = changer;
        }
        executed?;
        let state = *self.state();
        let is_compensating = state.cutter.is_on();
        if is_compensating && self.settings.is_mdi {
            let help =
                "put the lines from G41 or G42 to G40 into a program, or into a subroutine that MDI calls";
            return Err(Box::new(self.reject_block(
                "cutter compensation cannot be used in MDI: it needs the moves after its line",
                help,
            )));
        }
        if is_compensating {
            return Err(Box::new(
                self.reject(format!("line {line} is inside cutter compensation")),
            ));
        }
        if state.nurbs_order.is_some() && self.settings.is_mdi {
            let help = "put the lines from G5.2 to G5.3 into a program, or into a subroutine that MDI calls";
            return Err(Box::new(self.reject_block(
                "a NURBS cannot be written in MDI: it needs the lines after its first",
                help,
            )));
        }
        if state.nurbs_order.is_some() {
            return Err(Box::new(self.reject(format!("line {line} is inside a NURBS"))));
        }
        for spindle in 0..SPINDLES {
            self.output.surface_feed.set_speed(&state.spindle_action(spindle));
        }
        let mut actions = Vec::new();
        if state.tool != tool {
            actions.push(Action::ChangeTool(state.tool));
        }
        // Switches off what was on before the program and is off now.
        let before = self.settings.outputs;
        for (number, spindle) in state.modes.spindles.iter().enumerate() {
            if spindle.is_rotating() || before.spindles[number].is_rotating() {
                actions.push(state.spindle_action(number));
            }
            if let Some(angle) = spindle.orientation {
                actions.push(angle.action(number));
            }
        }
        if state.modes.mist || state.modes.flood || before.mist || before.flood {
            actions.push(Action::Coolant {
                mist: state.modes.mist,
                flood: state.modes.flood,
            });
        }
        actions.extend(std::mem::take(&mut self.changed_outputs).into_values());
        actions.extend(state.changed_overrides());
        Ok(Restart {
            line: self.next_program_line(),
            position: state.position,
            actions,
            modes: state.mode_line(),
            active: state.active_line(),
            geometry: state.geometry_line(),
            feed_mm_s: state.feed_mm_s(),
            feed_word: state.feed_word(),
        })
    }

    /// Executes all lines before `line` without output.
    fn execute_before(&mut self, line: u32) -> Result<(), Box<Diagnostic>> {
        let mut executed = 0_u64;
        let mut has_probed = false;
        while self.next_program_line() < line || self.is_inside() {
            executed += 1;
            if executed > self.settings.limits.max_lines_before_start {
                return Err(Box::new(self.endless_loop(line)));
            }
            if self.next_program_line() == line
                && let Some(inside) = self.inside_subroutine(line)
            {
                return Err(Box::new(inside));
            }
            let probing_line = match self.execute_without_output() {
                Ok(probing_line) => probing_line,
                // A probing move of this block has no result here, so the (ABORT) may follow from an earlier
                // result; the check of the block decides about it.
                Err(diagnostic)
                    if self.settings.is_mdi && has_probed && diagnostic.code == Code::ActiveComment =>
                {
                    self.finished = false;
                    None
                }
                Err(diagnostic) => return Err(diagnostic),
            };
            has_probed |= probing_line.is_some();
            if let Some(line_of_probe) = probing_line.filter(|_| !self.settings.is_mdi) {
                return Err(Box::new(self.depends_on_contact(line, line_of_probe)));
            }
            if self.is_finished() {
                return Err(Box::new(self.after_the_end(line)));
            }
        }
        Ok(())
    }

    /// The error of a line that only a call executes, with its arguments.
    fn inside_subroutine(&mut self, line: u32) -> Option<Diagnostic> {
        let definition = self.flow.definition.as_ref()?;
        let (name, begin) = (definition.text.clone(), definition.line);
        self.quote_next_line();
        let message = format!("line {line} is inside the subroutine O<{name}>, which starts in line {begin}");
        let fault = Fault::new(
            Code::RestartRefused,
            Span::new(0, self.current.text.len()),
            message,
        )
        .help(format!(
            "choose the line that calls it, O<{name}> call, or a line of the program outside of it"
        ));
        Some(fault.locate(self.current.number, &self.current.text))
    }

    /// Sets the line of the error to the start line of the restart, which has not been read yet.
    fn quote_next_line(&mut self) {
        let before = (self.current.number, self.current.text.clone());
        if !matches!(self.next_line(), Ok(true)) {
            (self.current.number, self.current.text) = before;
        }
    }

    fn depends_on_contact(&self, line: u32, probe_line: u32) -> Diagnostic {
        let message = format!(
            "line {line} comes after the probing move of line {probe_line}, whose contact is not known, and \
             the lines after it depend on it"
        );
        Fault::new(
            Code::RestartRefused,
            Span::new(0, self.current.text.len()),
            message,
        )
        .help(
            "start at the probing move or before it; or set the offsets by MDI and run a copy of the \
             program without the probing",
        )
        .locate(self.current.number, &self.current.text)
    }

    fn after_the_end(&self, line: u32) -> Diagnostic {
        let end = self.current.number;
        let message = format!("the program ends in line {end}, before line {line}");
        let help = "lines after the end can only belong to subroutines: choose the line that calls it (M98 \
                    P.. or O<name> call)";
        Fault::new(
            Code::RestartRefused,
            Span::new(0, self.current.text.len()),
            message,
        )
        .help(help)
        .locate(end, &self.current.text)
    }

    fn endless_loop(&self, line: u32) -> Diagnostic {
        let message = format!(
            "{} lines were interpreted and line {line} was not reached: an endless loop",
            self.settings.limits.max_lines_before_start
        );
        Fault::new(Code::TooManySteps, Span::new(0, self.current.text.len()), message)
            .locate(self.current.number, &self.current.text)
    }

    /// The error of a block that leaves something open for the next block to end.
    fn reject_block(&self, message: &str, help: &'static str) -> Diagnostic {
        Fault::new(
            Code::RestartRefused,
            Span::new(0, self.current.text.len()),
            message,
        )
        .help(help)
        .locate(self.current.number, &self.current.text)
    }

    /// Whether the lines before a restart end with a section of a thread. The first command is then an error
    /// ([`Code::RestartRefused`]) if it is another section of it.
    #[must_use]
    pub fn starts_after_thread(&self) -> bool {
        self.preceding_thread.is_some_and(|thread| thread.is_open())
    }

    /// A further section of a thread continues at the spindle angle at which the previous section ended;
    /// alone it would start at another angle.
    pub(crate) fn inside_thread(&self, first: u32) -> Diagnostic {
        let line = self.current.number;
        self.reject_here(format!(
            "line {line} continues the thread that begins in line {first}"
        ))
    }

    fn reject(&mut self, message: String) -> Diagnostic {
        self.quote_next_line();
        self.reject_here(message)
    }

    fn reject_here(&self, message: String) -> Diagnostic {
        let span = Span::new(0, self.current.text.len());
        Fault::new(Code::RestartRefused, span, message)
            .help("choose a line between two operations, such as a rapid move to the next one")
            .locate(self.current.number, &self.current.text)
    }
}

impl State {
    /// The overrides set by M48 to M53, if they differ from those at the start.
    fn changed_overrides(&self) -> Option<Action> {
        let modes = &self.modes;
        let (feed, spindles) = (modes.feed_override, modes.spindle_override);
        let is_as_at_start =
            feed && spindles == [true; SPINDLES] && modes.adaptive.is_none() && modes.feed_stop;
        (!is_as_at_start).then_some(Action::Overrides {
            feed,
            spindles,
            adaptive: modes.adaptive,
            feed_stop: modes.feed_stop,
            cycle: None,
        })
    }

    /// The feed of a move along XYZ.
    fn feed_mm_s(&self) -> Option<f64> {
        let feed = self.modes.feed?.per_second(false, || self.feed_rpm());
        (feed > 0.0 && feed.is_finite()).then_some(feed)
    }

    /// The F word as written, and whether in inches.
    fn feed_word(&self) -> Option<(f64, bool)> {
        let feed = self.modes.feed?;
        Some((feed.word(), !feed.is_metric()))
    }

    /// The spindles as codes: spindle 0, and others that rotate.
    fn spindle_words(&self) -> Vec<String> {
        let mut words = Vec::new();
        for (number, spindle) in self.modes.spindles.iter().enumerate() {
            if number > 0 && !spindle.is_rotating() && spindle.orientation.is_none() {
                continue;
            }
            words.push(format!("S{}", spindle.speed.word()));
            if let ProgrammedSpeed::Surface { max_rpm, .. } = spindle.speed {
                words.push("G96".to_owned());
                if max_rpm.is_finite() {
                    words.push(format!("D{max_rpm}"));
                }
            }
            words.push(match (spindle.direction, spindle.orientation) {
                (SpindleDirection::Stopped, Some(angle)) => {
                    let direction = match angle.direction {
                        Some(SpindleDirection::Clockwise) => " P1",
                        Some(SpindleDirection::CounterClockwise) => " P2",
                        _ => "",
                    };
                    format!("M19 R{}{direction}", angle.degrees)
                }
                (SpindleDirection::Stopped, None) => "M5".to_owned(),
                (SpindleDirection::Clockwise, _) => "M3".to_owned(),
                (SpindleDirection::CounterClockwise, _) => "M4".to_owned(),
            });
            if number > 0 {
                words.push(format!("${number}"));
            }
        }
        words
    }

    /// The modes as a line of codes.
    fn mode_line(&self) -> String {
        let mut words = self.unit_words();
        words.push(self.system_word());
        words.extend(self.path_words());
        words.extend(self.feed_text());
        // From S on, the state of the periphery.
        words.extend(self.spindle_words());
        words.push(format!("T{}", self.tool));
        words.extend(self.coolant_words());
        words.extend(self.override_words());
        words.join(" ")
    }

    fn active_line(&self) -> String {
        let mut words = vec![format!("T{}", self.tool)];
        words.extend(self.spindle_words());
        words.extend(self.coolant_words());
        words.extend(self.feed_text());
        words.push(self.system_word());
        words.extend(self.override_words());
        words.join(" ")
    }

    fn geometry_line(&self) -> String {
        [self.unit_words(), self.path_words()].concat().join(" ")
    }

    fn system_word(&self) -> String {
        match self.modes.work_index {
            index @ 0..=5 => format!("G{}", 54 + index),
            index => format!("G59.{}", index - 5),
        }
    }

    fn feed_text(&self) -> Option<String> {
        let (word, inches) = self.feed_word()?;
        Some(match (inches, self.modes.inches) {
            (true, false) => format!("F{}", word * INCH_MM),
            (false, true) => format!("F{}", word / INCH_MM),
            _ => format!("F{word}"),
        })
    }

    fn coolant_words(&self) -> impl Iterator<Item = String> + use<> {
        let codes = [(self.modes.mist, "M7"), (self.modes.flood, "M8")];
        codes
            .into_iter()
            .filter(|(on, _)| *on)
            .map(|(_, code)| code.to_owned())
    }

    fn override_words(&self) -> impl Iterator<Item = String> + use<> {
        let modes = &self.modes;
        let codes = [
            (modes.feed_override, "M50 P0"),
            (modes.spindle_override == [true; SPINDLES], "M51 P0"),
            (modes.adaptive != Some(true), "M52 P1"),
            (modes.adaptive != Some(false), "M52 P0"),
            (modes.feed_stop, "M53 P0"),
        ];
        codes
            .into_iter()
            .filter(|(counts, _)| !*counts)
            .map(|(_, code)| code.to_owned())
    }

    /// How words are read.
    fn unit_words(&self) -> Vec<String> {
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
        if modes.feed_spindle != 0 {
            words.push(format!("${}", modes.feed_spindle));
        }
        words
    }

    /// What changes the path besides.
    fn path_words(&self) -> Vec<String> {
        let modes = &self.modes;
        let either = |yes: bool, one: &str, other: &str| (if yes { one } else { other }).to_owned();
        let mut words = Vec::new();
        words.push(match modes.path_mode {
            PathMode::ExactPath => "G61".to_owned(),
            PathMode::ExactStop => "G61.1".to_owned(),
            PathMode::Blend {
                tolerance_mm,
                merge_mm,
            } => {
                let mut word = "G64".to_owned();
                for (letter, mm) in [('P', tolerance_mm), ('Q', merge_mm)] {
                    if let Some(mm) = mm {
                        word.push_str(&format!(" {letter}{}", mm / self.unit_mm()));
                    }
                }
                word
            }
        });
        words.push(either(modes.retract_to_initial, "G98", "G99"));
        words.push(either(modes.diameter, "G7", "G8"));
        words.push(either(self.cutter.code == Compensation::Off, "G40", "G41"));
        words.push(either(self.tool_offset == Axes::zeros(), "G49", "G43"));
        if self.g92 != Axes::zeros() {
            words.push("G92.3".to_owned());
        }
        words
    }
}
