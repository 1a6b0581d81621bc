//! The modal state, and how a line changes it.

use evolvent_path::{AXES, Axes, AxisLetter, Curve, Line, MAX_COORDINATE, Plane};

use crate::codes::{FeedMode, GCode, Group, LengthOffset, MCode, Motion, Once, PathControl};
use crate::diagnostic::Fault;
use crate::round;
use crate::statement::{Statement, whole};
use crate::system::System;
use crate::{Action, Code, Move, MoveKind, PathMode, Settings, SpindleDirection};

/// Millimetres of an inch.
const INCH_MM: f64 = 25.4;

/// F as it was when it was given: a later G20 or G21 does not change the speed.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ProgrammedFeed {
    /// For motion of linear axes: mm/s, or mm per revolution in G95.
    linear: f64,
    /// For motion of rotary axes only: deg/s, or degrees per revolution in G95.
    rotary: f64,
}

/// Everything that outlives a line. Small and `Copy`: a line works on a copy, which replaces the original only
/// if the whole line is right.
#[derive(Clone, Copy, Debug)]
pub(crate) struct State {
    /// Machine coordinates, mm and degrees.
    pub(crate) position: Axes,
    pub(crate) motion: Motion,
    pub(crate) plane: Plane,
    pub(crate) inches: bool,
    pub(crate) incremental: bool,
    pub(crate) arc_centre_absolute: bool,
    feed_mode: FeedMode,
    feed: Option<ProgrammedFeed>,
    path_mode: PathMode,
    work_offset: usize,
    g92: Axes,
    g92_active: bool,
    tool_offset: Axes,
    tool: u32,
    spindle: SpindleDirection,
    speed_rpm: f64,
    cached_zero: Axes,
    mist: bool,
    flood: bool,
    selected_tool: Option<u32>,
    /// M2 or M30 has been executed.
    pub(crate) ended: bool,
}

impl State {
    pub(crate) fn new(settings: &Settings) -> Self {
        Self {
            position: settings.start,
            motion: Motion::None,
            plane: Plane::Xy,
            inches: settings.inches,
            incremental: false,
            arc_centre_absolute: false,
            feed_mode: FeedMode::PerMinute,
            feed: None,
            path_mode: settings.path_mode,
            work_offset: settings.active_offset,
            g92: settings.g92_offset,
            g92_active: true,
            tool_offset: Axes::zeros(),
            tool: settings.tool,
            spindle: SpindleDirection::Stopped,
            speed_rpm: 0.0,
            cached_zero: settings.work_offsets[settings.active_offset.min(8)] + settings.g92_offset,
            mist: false,
            flood: false,
            selected_tool: None,
            ended: false,
        }
    }

    /// Executes a line in the order of RS274/NGC, table 8.
    pub(crate) fn execute(
        &mut self,
        line: &Statement,
        settings: &Settings,
        out: &mut impl FnMut(Action),
    ) -> Result<(), Fault> {
        if let Some(GCode::FeedMode(mode)) = line.g(Group::FeedMode)
            && mode != self.feed_mode
        {
            // F means something else now.
            self.feed_mode = mode;
            self.feed = None;
        }
        if let Some(feed) = line.word(b'F') {
            self.set_feed(feed);
        }
        self.tool_spindle_coolant(line, out)?;
        if let (Some(Once::Dwell), Some(seconds)) = (line.once(), line.word(b'P')) {
            out(Action::Dwell { seconds });
        }
        self.length_offset(line, settings, out)?;
        self.modes(line, settings);
        self.offset(line, settings)?;
        self.cached_zero = self.zero(settings);
        if let Some(motion) = line.motion_code() {
            self.motion = motion;
        }
        let machine = line.once() == Some(Once::MachineCoordinates);
        if machine {
            if !matches!(line.motion(), Some(Motion::Rapid | Motion::Linear)) {
                let span = line.group_span(Group::Once);
                return Err(
                    Fault::new(Code::MachineCoordinatesMotion, span, "G53 needs G0 or G1")
                        .help("write G53 G0 X.. or G53 G1 X.. on one line"),
                );
            }
            if self.incremental {
                let span = line.group_span(Group::Once);
                return Err(Fault::new(
                    Code::MachineCoordinatesIncremental,
                    span,
                    "G53 while G91 is active",
                )
                .help("machine coordinates are absolute: write G90 first"));
            }
        }
        if let Some(motion) = line.motion() {
            self.moves(motion, machine, line, settings, out)?;
        }
        match line.m(Group::Stop) {
            Some(MCode::Stop) => out(Action::ProgramStop {
                optional: false,
                pallet: false,
            }),
            Some(MCode::OptionalStop) => out(Action::ProgramStop {
                optional: true,
                pallet: false,
            }),
            Some(MCode::PalletStop) => out(Action::ProgramStop {
                optional: false,
                pallet: true,
            }),
            Some(_) => self.end(out),
            None => {}
        }
        Ok(())
    }

    /// What M2 does: spindle and coolant off, then the end.
    pub(crate) fn end(&mut self, out: &mut impl FnMut(Action)) {
        if self.spindle != SpindleDirection::Stopped {
            self.spindle = SpindleDirection::Stopped;
            out(Action::Spindle {
                direction: self.spindle,
                speed_rpm: self.speed_rpm,
            });
        }
        if self.mist || self.flood {
            (self.mist, self.flood) = (false, false);
            out(Action::Coolant {
                mist: false,
                flood: false,
            });
        }
        self.ended = true;
        out(Action::ProgramEnd);
    }

    /// Millimetres of a unit of length.
    pub(crate) fn unit_mm(&self) -> f64 {
        if self.inches { INCH_MM } else { 1.0 }
    }

    /// Program zero in machine coordinates.
    pub(crate) fn zero(&self, settings: &Settings) -> Axes {
        self.work_zero(settings) + self.active_g92() + self.tool_offset
    }

    fn work_zero(&self, settings: &Settings) -> Axes {
        settings
            .work_offsets
            .get(self.work_offset)
            .copied()
            .unwrap_or_default()
    }

    fn active_g92(&self) -> Axes {
        if self.g92_active { self.g92 } else { Axes::zeros() }
    }

    fn set_feed(&mut self, feed: f64) {
        self.feed = match self.feed_mode {
            // Only for the line that it stands on.
            FeedMode::InverseTime => None,
            FeedMode::PerMinute => Some(ProgrammedFeed {
                linear: feed * self.unit_mm() / 60.0,
                rotary: feed / 60.0,
            }),
            FeedMode::PerRevolution => Some(ProgrammedFeed {
                linear: feed * self.unit_mm(),
                rotary: feed,
            }),
        };
    }

    fn tool_spindle_coolant(&mut self, line: &Statement, out: &mut impl FnMut(Action)) -> Result<(), Fault> {
        if let Some(speed) = line.word(b'S') {
            self.speed_rpm = speed;
        }
        if let Some(tool) = line.word(b'T') {
            let tool = whole(tool, "T", line.span(b'T'))?;
            self.selected_tool = Some(tool);
            out(Action::SelectTool(tool));
        }
        if line.m(Group::ToolChange).is_some() {
            let Some(tool) = self.selected_tool else {
                let span = line.group_span(Group::ToolChange);
                return Err(
                    Fault::new(Code::ToolMissing, span, "M6, but no tool has been selected")
                        .help("write T and the tool's number before M6 or on its line"),
                );
            };
            if self.spindle != SpindleDirection::Stopped {
                self.spindle = SpindleDirection::Stopped;
                out(Action::Spindle {
                    direction: self.spindle,
                    speed_rpm: self.speed_rpm,
                });
            }
            self.tool = tool;
            out(Action::ChangeTool(tool));
        }
        let turned = line.m(Group::Spindle);
        match turned {
            Some(MCode::SpindleClockwise) => self.spindle = SpindleDirection::Clockwise,
            Some(MCode::SpindleCounterClockwise) => self.spindle = SpindleDirection::CounterClockwise,
            Some(_) => self.spindle = SpindleDirection::Stopped,
            None => {}
        }
        if turned.is_some() || line.has(b'S') {
            out(Action::Spindle {
                direction: self.spindle,
                speed_rpm: self.speed_rpm,
            });
        }
        if let Some(coolant) = line.m(Group::Coolant) {
            match coolant {
                MCode::Mist => self.mist = true,
                MCode::Flood => self.flood = true,
                _ => (self.mist, self.flood) = (false, false),
            }
            out(Action::Coolant {
                mist: self.mist,
                flood: self.flood,
            });
        }
        Ok(())
    }

    fn length_offset(
        &mut self,
        line: &Statement,
        settings: &Settings,
        out: &mut impl FnMut(Action),
    ) -> Result<(), Fault> {
        let Some(offset) = line.length_offset() else {
            return Ok(());
        };
        let unit = if line.g(Group::Units).is_some() {
            // Units come before tool offsets in the order of execution.
            if line.g(Group::Units) == Some(GCode::Inches(true)) {
                INCH_MM
            } else {
                1.0
            }
        } else {
            self.unit_mm()
        };
        let mut change = Axes::zeros();
        if offset != LengthOffset::Off && !(offset == LengthOffset::Given || line.has_axes()) {
            let number = match line.word(b'H') {
                Some(number) => whole(number, "H", line.span(b'H'))?,
                None => self.tool,
            };
            match settings.tools.as_ref().map(|tools| tools.get(number)) {
                _ if number == 0 => {}
                Some(Some(tool)) => change = tool.offset,
                Some(None) => {
                    let message = format!("tool {number} is not in the tool table");
                    let span = if line.has(b'H') {
                        line.span(b'H')
                    } else {
                        line.group_span(Group::LengthOffset)
                    };
                    return Err(Fault::new(Code::UnknownTool, span, message)
                        .help("add the tool to the table, or name another one with H"));
                }
                None => out(Action::Message(format!(
                    "warning: there is no tool table, so the length of tool {number} counts as 0"
                ))),
            }
        }
        match offset {
            LengthOffset::Off => self.tool_offset = Axes::zeros(),
            LengthOffset::Table => self.tool_offset = change,
            LengthOffset::Added if !line.has_axes() => self.tool_offset += change,
            LengthOffset::Given | LengthOffset::Added => {
                for axis in AxisLetter::ALL {
                    let index = axis.index();
                    if let Some(value) = line.axis(index) {
                        let value = value * if axis.is_rotary() { 1.0 } else { unit };
                        let base = if offset == LengthOffset::Added {
                            self.tool_offset[index]
                        } else {
                            0.0
                        };
                        self.tool_offset[index] = base + value;
                        check_coordinate(self.tool_offset[index], axis, line)?;
                    }
                }
            }
        }
        Ok(())
    }

    /// Place of an axis in program coordinates and units.
    pub(crate) fn program_position(&self, axis: usize) -> f64 {
        (self.position[axis] - self.cached_zero[axis]) / self.axis_unit(axis)
    }

    /// Place of an axis in machine coordinates, in program units.
    pub(crate) fn machine_position(&self, axis: usize) -> f64 {
        self.position[axis] / self.axis_unit(axis)
    }

    pub(crate) fn tool(&self) -> u32 {
        self.tool
    }

    pub(crate) fn selected_tool(&self) -> Option<u32> {
        self.selected_tool
    }

    /// A predefined parameter.
    pub(crate) fn system(&self, _system: System) -> f64 {
        0.0
    }

    fn modes(&mut self, line: &Statement, settings: &Settings) {
        if let Some(GCode::Plane(plane)) = line.g(Group::Plane) {
            self.plane = plane;
        }
        if let Some(GCode::Inches(inches)) = line.g(Group::Units) {
            self.inches = inches;
        }
        if let Some(GCode::WorkOffset(index)) = line.g(Group::WorkOffset)
            && index < settings.work_offsets.len()
        {
            self.work_offset = index;
        }
        if let Some(GCode::Path(control)) = line.g(Group::PathControl) {
            self.path_mode = match control {
                PathControl::ExactPath => PathMode::ExactPath,
                PathControl::ExactStop => PathMode::ExactStop,
                PathControl::Blend => PathMode::Blend {
                    tolerance_mm: line.word(b'P').map(|p| p * self.unit_mm()),
                    merge_mm: line.word(b'Q').map(|q| q * self.unit_mm()),
                },
            };
        }
        if let Some(GCode::Incremental(incremental)) = line.g(Group::Distance) {
            self.incremental = incremental;
        }
        if let Some(GCode::ArcCentreAbsolute(absolute)) = line.g(Group::ArcDistance) {
            self.arc_centre_absolute = absolute;
        }
    }

    /// G92 and its kin.
    fn offset(&mut self, line: &Statement, settings: &Settings) -> Result<(), Fault> {
        match line.once() {
            Some(Once::SetOffset) => {
                let mut offset = self.active_g92();
                let work = self.work_zero(settings);
                for axis in AxisLetter::ALL {
                    let index = axis.index();
                    if let Some(value) = line.axis(index) {
                        offset[index] = self.position[index]
                            - work[index]
                            - self.tool_offset[index]
                            - value * self.axis_unit(index);
                        check_coordinate(offset[index], axis, line)?;
                    }
                }
                (self.g92, self.g92_active) = (offset, true);
            }
            Some(Once::ClearOffset) => (self.g92, self.g92_active) = (Axes::zeros(), true),
            Some(Once::SuspendOffset) => self.g92_active = false,
            Some(Once::RestoreOffset) => self.g92_active = true,
            Some(Once::Dwell | Once::MachineCoordinates) | None => {}
        }
        Ok(())
    }

    /// Millimetres or degrees of a program unit of an axis.
    fn axis_unit(&self, index: usize) -> f64 {
        if AxisLetter::ALL[index].is_rotary() {
            1.0
        } else {
            self.unit_mm()
        }
    }

    /// Where the axis words lead to, in machine coordinates.
    fn target(&self, machine: bool, line: &Statement, settings: &Settings) -> Result<Axes, Fault> {
        let mut target = self.position;
        let zero = if machine {
            Axes::zeros()
        } else {
            self.zero(settings)
        };
        for index in 0..AXES {
            if let Some(value) = line.axis(index) {
                let value = value * self.axis_unit(index);
                let base = if self.incremental {
                    self.position[index]
                } else {
                    zero[index]
                };
                target[index] = base + value;
                check_coordinate(target[index], AxisLetter::ALL[index], line)?;
            }
        }
        Ok(target)
    }

    fn moves(
        &mut self,
        motion: Motion,
        machine: bool,
        line: &Statement,
        settings: &Settings,
        out: &mut impl FnMut(Action),
    ) -> Result<(), Fault> {
        let target = self.target(machine, line, settings)?;
        let kind = if motion == Motion::Rapid {
            MoveKind::Rapid
        } else {
            MoveKind::Feed
        };
        // G0 or G1 alone only sets the mode.
        if kind == MoveKind::Feed && (motion.is_round() || line.has_axes()) {
            self.check_feed(motion, line)?;
        }
        let curve = match motion {
            Motion::Arc(sense) => round::arc(self, sense, target, line, settings)?,
            Motion::Involute(sense) => round::involute(self, sense, target, line, settings)?,
            _ if target == self.position => return Ok(()),
            _ => Line::new(self.position, target)
                .map(Curve::Line)
                .map_err(|error| Fault::new(Code::LineRefused, line.motion_span(), error.to_string()))?,
        };
        let feed = match kind {
            MoveKind::Rapid => f64::INFINITY,
            MoveKind::Feed => self.feed_along(&curve, target, line),
        };
        // A path that a double cannot tell from nothing would have no direction and no time.
        if !(curve.length() > 0.0 && feed > 0.0) {
            let message = format!("a move of {:e} mm at {feed:e} mm/s", curve.length());
            return Err(Fault::new(Code::LineRefused, line.motion_span(), message)
                .help("length or feed is too small to compute with"));
        }
        // The curve keeps its end bit for bit, but rounds may have moved it (a circle's end is its start).
        self.position = curve.end();
        out(Action::Move(Move {
            curve,
            kind,
            feed,
            path_mode: self.path_mode,
        }));
        Ok(())
    }

    /// A feed move needs a speed.
    fn check_feed(&self, motion: Motion, line: &Statement) -> Result<(), Fault> {
        let name = motion.name();
        let span = line.motion_span();
        let feed = match self.feed_mode {
            FeedMode::InverseTime => {
                let Some(feed) = line.word(b'F') else {
                    let message = format!("{name} in G93 without F");
                    return Err(Fault::new(Code::InverseTimeFeedMissing, span, message)
                        .help("in inverse time mode every feed move has its own F: 1 / minutes"));
                };
                feed
            }
            FeedMode::PerMinute | FeedMode::PerRevolution => {
                let Some(feed) = self.feed else {
                    let message = format!("{name}, but no feed is in force");
                    return Err(Fault::new(Code::FeedMissing, span, message)
                        .help("write F on this line or before; a change of feed mode forgets F"));
                };
                feed.linear
            }
        };
        if feed <= 0.0 {
            let message = format!("{name} with feed F0");
            return Err(Fault::new(Code::FeedZero, span, message).help("write an F above 0"));
        }
        if self.feed_mode == FeedMode::PerRevolution && self.speed_rpm <= 0.0 {
            let message = format!("{name} in G95, but the spindle speed is 0");
            return Err(Fault::new(Code::SpindleSpeedMissing, span, message)
                .help("feed per revolution needs a spindle speed: write S and M3 first"));
        }
        Ok(())
    }

    /// Speed along the feed metric in mm/s, or deg/s if only rotary axes move. [`check_feed`](Self::check_feed)
    /// has passed.
    fn feed_along(&self, curve: &Curve, target: Axes, line: &Statement) -> f64 {
        if self.feed_mode == FeedMode::InverseTime {
            return line.word(b'F').unwrap_or(0.0) / 60.0 * curve.length();
        }
        let straight = matches!(curve, Curve::Line(_));
        let rotary = straight
            && AxisLetter::ALL
                .iter()
                .all(|axis| axis.is_rotary() || target[axis.index()] == self.position[axis.index()]);
        let feed = self
            .feed
            .map_or(0.0, |feed| if rotary { feed.rotary } else { feed.linear });
        match self.feed_mode {
            FeedMode::PerRevolution => feed * self.speed_rpm / 60.0,
            _ => feed,
        }
    }
}

fn check_coordinate(value: f64, axis: AxisLetter, line: &Statement) -> Result<(), Fault> {
    if value.abs() <= MAX_COORDINATE {
        return Ok(());
    }
    let letter = axis.letter();
    let message = format!("{letter} would be {value:e} in machine coordinates");
    Err(
        Fault::new(Code::PositionTooLarge, line.span(letter as u8), message)
            .help("no machine travels that far; look at offsets and increments"),
    )
}
