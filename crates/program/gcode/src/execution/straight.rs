//! Straight moves: G0, G1, G28, G30, G33, G38.

use evolvent_path::{Axes, AxisLetter, Curve, Line, ParamCurve as _, Plane, turn_shorter};

use crate::codes::modal_groups::{FeedMode, Group, Motion, NonModal};
use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;
use crate::execution::execute::MAX_HELD_COMMANDS;
use crate::execution::offsets::check_coordinate;
use crate::{Action, CanonicalCommand, Code, Move, MoveKind, PathMode};

impl Executor<'_> {
    /// The target of the axis words, in machine coordinates.
    pub(crate) fn target(&self) -> Result<Axes, Fault> {
        let (state, line) = (&*self.state, self.line);
        let from = state.programmed();
        let mut target = from;
        if line.non_modal() == Some(NonModal::MachineCoordinates) {
            for index in 0..AxisLetter::ALL.len() {
                if let Some(value) = line.axis(index) {
                    target[index] = value * state.word_unit(index);
                }
            }
        } else if state.rotation[0] == 0.0 && !line.has_polar() {
            let zero = state.program_to_machine(Axes::zeros());
            for index in 0..AxisLetter::ALL.len() {
                if let Some(value) = line.axis(index) {
                    let base = if state.modes.incremental {
                        from[index]
                    } else {
                        zero[index]
                    };
                    target[index] = base + value * state.word_unit(index);
                }
            }
        } else {
            let mut program = state.machine_to_program(from);
            let incremental = state.modes.incremental;
            for index in 0..AxisLetter::ALL.len() {
                if let Some(value) = line.axis(index) {
                    let base = if incremental { program[index] } else { 0.0 };
                    program[index] = base + value * state.word_unit(index);
                }
            }
            if line.has_polar() {
                self.polar(&mut program)?;
            }
            target = state.program_to_machine(program);
            let names_xy = line.has(b'X') || line.has(b'Y') || line.has_polar();
            for index in 0..AxisLetter::ALL.len() {
                if line.axis(index).is_none() && !(index < 2 && names_xy) {
                    target[index] = from[index];
                }
            }
        }
        if !state.modes.incremental && state.unlimited.contains(&true) {
            self.unwrap_angles(&from, &mut target)?;
        }
        if self.pending_cancel().is_some() {
            for index in state.plane_axes() {
                target[index] = state.position[index];
            }
        }
        for axis in AxisLetter::ALL {
            check_coordinate(target[axis.index()], axis, line)?;
        }
        Ok(target)
    }

    /// The programmed position to which the next move in the plane leads after G40, if this line names no
    /// axis of the plane. Such a line moves the other axes alone: a tool that is raised after G40 stays
    /// beside the contour.
    fn pending_cancel(&self) -> Option<Axes> {
        let (state, line) = (&*self.state, self.line);
        let programmed = state.cutter.programmed.filter(|_| !state.cutter.is_on())?;
        let names_plane_axis =
            line.has_polar() || state.plane_axes().iter().any(|index| line.axis(*index).is_some());
        (!names_plane_axis).then_some(programmed)
    }

    /// Executes moves, and keeps the position in the plane that is pending after G40.
    fn keep_pending_cancel(
        &mut self,
        moves: impl FnOnce(&mut Self) -> Result<(), Fault>,
    ) -> Result<(), Fault> {
        let Some(mut pending) = self.pending_cancel() else {
            return moves(self);
        };
        let plane = self.state.plane_axes();
        self.state.cutter.programmed = Some(self.state.position);
        moves(self)?;
        for axis in AxisLetter::ALL {
            let index = axis.index();
            if !plane.contains(&index) {
                pending[index] = self.state.position[index];
            }
        }
        (self.state.cutter.programmed, self.state.cutter.return_pending) = (Some(pending), true);
        Ok(())
    }

    /// `@` is the distance from the program zero, `^` the angle from X in degrees.
    pub(crate) fn polar(&self, program: &mut Axes) -> Result<(), Fault> {
        let line = self.line;
        let fault = |letter: u8, message: &str| {
            let letter = if line.has(letter) {
                letter
            } else {
                letter ^ b'@' ^ b'^'
            };
            Err(Fault::new(
                Code::PolarCoordinates,
                line.span(letter),
                message.to_owned(),
            ))
        };
        if self.state.plane() != Some(Plane::Xy) {
            let letter = if line.has(b'@') { b'@' } else { b'^' };
            let message = "@ and ^ are coordinates of the XY plane, and another plane is active";
            return Err(Fault::new(Code::WrongPlane, line.span(letter), message)
                .help("write G17 before them, or give the end by its axes"));
        }
        if line.has(b'X') || line.has(b'Y') {
            return fault(b'@', "X and Y cannot be combined with @ and ^");
        }
        let (radius, angle) = (
            libm::hypot(program[0], program[1]),
            libm::atan2(program[1], program[0]),
        );
        let is_at_zero = program[0] == 0.0 && program[1] == 0.0;
        let unit = self.state.unit_mm();
        let incremental = self.state.modes.incremental;
        if incremental && is_at_zero {
            return fault(b'@', "@ and ^ in G91 have no meaning at the program's zero");
        }
        let radius = match line.word(b'@') {
            Some(value) if incremental => radius + value * unit,
            Some(value) => value * unit,
            None => radius,
        };
        let angle = match line.word(b'^') {
            Some(value) if incremental => angle + value.to_radians(),
            Some(value) => value.to_radians(),
            None if is_at_zero => return fault(b'@', "@ without ^ has no meaning at the program's zero"),
            None => angle,
        };
        program[0] = radius * libm::cos(angle);
        program[1] = radius * libm::sin(angle);
        Ok(())
    }

    /// G0, G1.
    pub(crate) fn straight(&mut self, motion: Motion) -> Result<(), Fault> {
        let line = self.line;
        if line.non_modal() == Some(NonModal::MachineCoordinates) && self.state.modes.incremental {
            let span = line.group_span(Group::NonModal);
            return Err(Fault::new(
                Code::MachineCoordinatesIncremental,
                span,
                "G53 while G91 is active",
            )
            .help("machine coordinates are absolute: write G90 first"));
        }
        // G0 or G1 alone only sets the mode.
        if !line.has_axes() {
            return Ok(());
        }
        let kind = if motion == Motion::Rapid {
            MoveKind::Rapid
        } else {
            self.check_feed(motion.name())?;
            MoveKind::Feed
        };
        let target = self.target()?;
        if self.state.cutter.is_on() {
            return self.compensated_line(target, kind);
        }
        self.keep_pending_cancel(|this| this.emit_line(target, kind))
    }

    /// A straight move from the present position.
    #[inline]
    pub(crate) fn emit_line(&mut self, target: Axes, kind: MoveKind) -> Result<(), Fault> {
        let path_mode = self.state.modes.path_mode;
        self.emit_line_in_mode(target, kind, path_mode)
    }

    #[inline]
    pub(crate) fn emit_line_in_mode(
        &mut self,
        target: Axes,
        kind: MoveKind,
        path_mode: PathMode,
    ) -> Result<(), Fault> {
        if target == self.state.position {
            if !self.state.cutter.is_on() {
                self.state.cutter.programmed = None;
            }
            return Ok(());
        }
        let line = Line::new(self.state.position, target)
            .map_err(|error| Fault::new(Code::LineRefused, self.line.motion_span(), error.to_string()))?;
        let length = line.length();
        let rotary = self.moves_only_rotary(&target);
        let feed = match kind {
            MoveKind::Rapid => f64::INFINITY,
            MoveKind::Feed => {
                // After G40 the programmed path determines the time, in inverse time mode.
                let programmed = match self.state.cutter.programmed {
                    Some(from) => libm::sqrt((target - from).fixed_rows::<3>(0).norm_squared()),
                    None => length,
                };
                let programmed = if programmed > 0.0 { programmed } else { length };
                self.speed(programmed, rotary)
            }
        };
        self.check_move(length, feed)?;
        // Without constructing a curve first: long programs consist of lines, and a curve is large.
        self.state.position = target;
        if !self.state.cutter.is_on() {
            self.state.cutter.programmed = None;
        }
        self.commands.push_back(CanonicalCommand {
            line: self.number,
            action: Action::Move(Move {
                curve: Curve::Line(line),
                kind,
                feed_mm_s: feed,
                path_mode,
            }),
            origin: self.origin.clone(),
            calls: self.calls.clone(),
            feed_mm_rev: self.feed_per_revolution(kind, rotary),
            feed_spindle: self.state.modes.feed_spindle as u32,
            continues: false,
        });
        Ok(())
    }

    #[inline]
    pub(crate) fn line_to(&self, target: Axes) -> Result<Curve, Fault> {
        Line::new(self.state.position, target)
            .map(Curve::Line)
            .map_err(|error| Fault::new(Code::LineRefused, self.line.motion_span(), error.to_string()))
    }

    fn moves_only_rotary(&self, target: &Axes) -> bool {
        let is_unmoved = |axis: &AxisLetter| target[axis.index()] == self.state.position[axis.index()];
        AxisLetter::ALL
            .iter()
            .all(|axis| axis.is_rotary() || is_unmoved(axis))
    }

    /// Outputs a move.
    #[inline]
    pub(crate) fn emit_curve(
        &mut self,
        curve: Curve,
        kind: MoveKind,
        feed: f64,
        path_mode: PathMode,
    ) -> Result<(), Fault> {
        self.check_move(curve.length(), feed)?;
        // The curve keeps its end bit for bit, but rounding may have moved it (a circle ends at its start).
        self.state.position = curve.end();
        if !self.state.cutter.is_on() {
            // After G40 the tool has returned to the programmed path.
            self.state.cutter.programmed = None;
        }
        self.commands.push_back(CanonicalCommand {
            line: self.number,
            action: Action::Move(Move {
                curve,
                kind,
                feed_mm_s: feed,
                path_mode,
            }),
            origin: self.origin.clone(),
            calls: self.calls.clone(),
            feed_mm_rev: self.feed_per_revolution(kind, false),
            feed_spindle: self.state.modes.feed_spindle as u32,
            continues: false,
        });
        Ok(())
    }

    /// Rejects a path too short for a direction and duration in double precision, and more commands than fit
    /// into memory.
    #[inline]
    fn check_move(&self, length: f64, feed: f64) -> Result<(), Fault> {
        if length > 0.0 && feed > 0.0 && self.commands.len() < MAX_HELD_COMMANDS {
            return Ok(());
        }
        if self.commands.len() >= MAX_HELD_COMMANDS {
            let message = format!(
                "more than {MAX_HELD_COMMANDS} commands from one line, or waiting for cutter compensation"
            );
            return Err(Fault::new(Code::BodyTooLong, self.line.motion_span(), message));
        }
        let message = format!("a move of {length:e} mm at {feed:e} mm/s");
        Err(Fault::new(Code::LineRefused, self.line.motion_span(), message)
            .help("length or feed is too small to compute with"))
    }

    /// Feed per spindle revolution of a move in G95.
    #[inline]
    fn feed_per_revolution(&self, kind: MoveKind, rotary: bool) -> Option<f64> {
        if kind == MoveKind::Rapid {
            return None;
        }
        self.state.modes.feed?.per_revolution(rotary)
    }

    /// Checks that cutter compensation is off.
    pub(crate) fn check_uncompensated(&self, name: &str) -> Result<(), Fault> {
        if !self.state.cutter.is_on() {
            return Ok(());
        }
        let message = format!("{name} while cutter compensation is on");
        Err(Fault::new(Code::CompensationActive, self.line.motion_span(), message).help("write G40 first"))
    }

    /// Checks that the feed mode is one for cycles, which have several moves.
    pub(crate) fn check_feed_of_cycle(&self, name: &str) -> Result<(), Fault> {
        if self.state.modes.feed_mode != FeedMode::InverseTime {
            return Ok(());
        }
        let message = format!("{name} in G93");
        Err(Fault::new(Code::WrongMode, self.line.motion_span(), message)
            .help("cycles need a feed per minute or per revolution: G94 or G95"))
    }

    /// Checks that a feed move has a feed.
    pub(crate) fn check_feed(&self, name: &str) -> Result<(), Fault> {
        let modes = &self.state.modes;
        let span = self.line.motion_span();
        let is_zero = match modes.feed_mode {
            FeedMode::InverseTime => {
                let Some(feed) = self.line.word(b'F') else {
                    let message = format!("{name} in G93 without F");
                    return Err(Fault::new(Code::InverseTimeFeedMissing, span, message)
                        .help("in inverse time mode every feed move needs its own F: 1 / minutes"));
                };
                feed <= 0.0
            }
            FeedMode::PerMinute | FeedMode::PerRevolution => {
                let Some(feed) = modes.feed else {
                    let message = format!("{name}, but no feed is active");
                    return Err(Fault::new(Code::FeedMissing, span, message)
                        .help("write F on this line or before; a change of feed mode clears F"));
                };
                feed.is_zero()
            }
        };
        if is_zero {
            let message = format!("{name} with feed F0");
            return Err(Fault::new(Code::FeedZero, span, message).help("write an F above 0"));
        }
        if modes.feed_mode == FeedMode::PerRevolution
            && modes.spindles[modes.feed_spindle].speed.word() <= 0.0
        {
            let message = format!("{name} in G95, but the spindle speed is 0");
            return Err(Fault::new(Code::SpindleSpeedMissing, span, message)
                .help("feed per revolution needs a spindle speed: write S and M3 first"));
        }
        Ok(())
    }

    /// Speed in mm/s for a path of this length, or deg/s if only rotary axes move.
    /// [`check_feed`](Self::check_feed) has passed.
    pub(crate) fn speed(&self, length: f64, rotary: bool) -> f64 {
        let modes = &self.state.modes;
        if modes.feed_mode == FeedMode::InverseTime {
            return self.line.word(b'F').unwrap_or(0.0) / 60.0 * length;
        }
        // Updated along the move if the spindle speed follows the radius.
        modes
            .feed
            .map_or(0.0, |feed| feed.per_second(rotary, || self.state.feed_rpm()))
    }

    /// G28, G30: via the point of the axis words to the stored position. Without axis words all axes move
    /// there, else only those named.
    pub(crate) fn home(&mut self, first: usize) -> Result<(), Fault> {
        if !self.line.has_axes() {
            return self.move_to_reference(first);
        }
        self.keep_pending_cancel(|this| this.move_to_reference(first))
    }

    fn move_to_reference(&mut self, first: usize) -> Result<(), Fault> {
        let line = self.line;
        let stored = self.parameters.axes(first);
        let mut end = stored;
        if line.has_axes() {
            let intermediate = self.target()?;
            self.emit_line(intermediate, MoveKind::Rapid)?;
            for index in 0..AxisLetter::ALL.len() {
                if line.axis(index).is_none() {
                    end[index] = self.state.position[index];
                }
            }
        }
        for axis in AxisLetter::ALL {
            if !self.settings.axes[axis.index()] {
                end[axis.index()] = self.state.position[axis.index()];
            }
            if self.state.unlimited[axis.index()] {
                end[axis.index()] = turn_shorter(self.state.position[axis.index()], end[axis.index()]);
            }
            check_coordinate(end[axis.index()], axis, line)?;
        }
        self.emit_line(end, MoveKind::Rapid)
    }

    /// Checks that the spindle rotates, and returns the pitch K in mm.
    pub(crate) fn pitch(&self, name: &str, letter: u8) -> Result<f64, Fault> {
        let line = self.line;
        let Some(pitch) = line.word(letter) else {
            let message = format!("{name} needs {}, the pitch", char::from(letter));
            return Err(Fault::new(Code::WordMissing, line.motion_span(), message));
        };
        if pitch <= 0.0 {
            let message = format!("{}{pitch}: a pitch must be above 0", char::from(letter));
            return Err(Fault::new(Code::OutOfRange, line.span(letter), message));
        }
        let spindles = &self.state.modes.spindles;
        let number = self.state.modes.active_spindle;
        if !spindles[number].is_rotating() {
            let message = if self
                .settings
                .features
                .spindles
                .iter()
                .filter(|exists| **exists)
                .count()
                > 1
            {
                format!("{name}, but spindle {number}, which it follows, does not turn")
            } else {
                format!("{name}, but the spindle does not turn")
            };
            let help = match spindles.iter().position(|spindle| spindle.is_rotating()) {
                Some(other) => format!("spindle {other} turns: write ${other} to follow it"),
                None => "write S and M3 or M4 first".to_owned(),
            };
            return Err(Fault::new(Code::SpindleSpeedMissing, line.motion_span(), message).help(help));
        }
        Ok(pitch * self.state.unit_mm())
    }

    /// G33.
    pub(crate) fn thread(&mut self) -> Result<(), Fault> {
        if !self.line.has_axes() {
            let message = "G33 needs an axis word: the end of the thread";
            return Err(Fault::new(Code::WordMissing, self.line.motion_span(), message));
        }
        let pitch_mm = self.pitch("G33", b'K')?;
        let start_degrees = self.line.word(b'Q').unwrap_or(0.0);
        if !(0.0..360.0).contains(&start_degrees) {
            let message = format!("G33: Q{start_degrees} is the start angle of the thread, 0 to 360 degrees");
            return Err(Fault::new(Code::OutOfRange, self.line.span(b'Q'), message));
        }
        let target = self.target()?;
        self.emit_thread(target, pitch_mm, start_degrees, None)
    }

    pub(crate) fn emit_thread(
        &mut self,
        target: Axes,
        pitch_mm: f64,
        start_degrees: f64,
        clear_x: Option<f64>,
    ) -> Result<(), Fault> {
        if target == self.state.position {
            return Ok(());
        }
        let curve = self.line_to(target)?;
        let path_mode = self.state.modes.path_mode;
        self.state.position = target;
        self.emit(Action::Thread {
            spindle: self.state.modes.active_spindle as u32,
            curve,
            pitch_mm,
            path_mode,
            start_degrees,
            clear_x,
        });
        Ok(())
    }

    /// G33.1.
    pub(crate) fn rigid_tap(&mut self) -> Result<(), Fault> {
        if !self.line.has_axes() {
            let message = "G33.1 needs an axis word: the end of the thread";
            return Err(Fault::new(Code::WordMissing, self.line.motion_span(), message));
        }
        let pitch_mm = self.pitch("G33.1", b'K')?;
        let return_factor = self.line.word(b'I').unwrap_or(1.0);
        if return_factor <= 0.0 {
            let message =
                format!("I{return_factor}: the factor for the speed of the way out must be above 0");
            return Err(Fault::new(Code::OutOfRange, self.line.span(b'I'), message));
        }
        let target = self.target()?;
        if target == self.state.position {
            return Ok(());
        }
        let curve = self.line_to(target)?;
        self.emit(Action::RigidTap {
            spindle: self.state.modes.active_spindle as u32,
            curve,
            pitch_mm,
            return_factor,
        });
        Ok(())
    }

    /// G38.2 to G38.5.
    pub(crate) fn probe(&mut self, toward: bool, must: bool) -> Result<(), Fault> {
        let line = self.line;
        if !line.has_axes() {
            let message = "G38 needs an axis word: the maximum travel of the probe";
            return Err(Fault::new(Code::WordMissing, line.motion_span(), message));
        }
        self.check_uncompensated("G38")?;
        if self.pending_cancel().is_some() {
            let message = "G38 right after G40, which the next move in the plane completes";
            return Err(Fault::new(Code::CompensationActive, line.motion_span(), message)
                .help("write a straight move in the plane between them"));
        }
        self.check_feed("G38")?;
        let target = self.target()?;
        if target == self.state.position {
            if self.state.is_probed {
                // The stop position of the previous probe is unknown: without contact it is here, and there
                // is no path.
                return Ok(());
            }
            let message = "G38 ends where it starts";
            return Err(Fault::new(Code::OutOfRange, line.motion_span(), message));
        }
        let curve = self.line_to(target)?;
        let feed = self.speed(curve.length(), self.moves_only_rotary(&target));
        self.state.position = target;
        self.state.is_probed = true;
        self.emit(Action::Probe {
            curve,
            feed_mm_s: feed,
            toward,
            must,
        });
        Ok(())
    }
}
