//! Offsets, and the data that G10 writes.

use evolvent_path::{AXES, Axes, AxisLetter, MAX_COORDINATE};

use crate::Action;
use crate::Code;
use crate::codes::modal_groups::{Group, LengthOffset, NonModal};
use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;
use crate::parameters::values::{G92, G92_ACTIVE, WORK_OFFSET_1};
use crate::syntax::statement::Statement;
use crate::tables::tools::MAX_ORIENTATION;
use crate::{Tool, WORK_OFFSETS};

impl Executor<'_> {
    /// G43, G43.1, G43.2, G49.
    pub(crate) fn length_offset(&mut self) -> Result<(), Fault> {
        let line = self.line;
        let Some(code) = line.length_offset() else {
            return Ok(());
        };
        if self.state.cutter.is_on() {
            let span = line.group_span(Group::LengthOffset);
            return Err(Fault::new(
                Code::CompensationActive,
                span,
                "a tool length while cutter compensation is on",
            )
            .help("write G43 or G49 before G41 and G42"));
        }
        let by_axes = code == LengthOffset::Dynamic
            || code == LengthOffset::Additional && line.has_axes() && !line.has(b'H');
        let mut table_offset = Axes::zeros();
        if code != LengthOffset::Off && !by_axes {
            let number = self.tool_number(b'H')?;
            table_offset = self.tool(number, b'H', Group::LengthOffset)?.offset;
            if code == LengthOffset::Table {
                self.warn_of_other_length(number, &table_offset);
            }
        }
        match code {
            LengthOffset::Off => self.state.tool_offset = Axes::zeros(),
            LengthOffset::Table => self.state.tool_offset = table_offset,
            LengthOffset::Additional if !by_axes => self.state.tool_offset += table_offset,
            LengthOffset::Dynamic | LengthOffset::Additional => {
                for axis in AxisLetter::ALL {
                    let index = axis.index();
                    if let Some(value) = line.axis(index) {
                        let base = if code == LengthOffset::Additional {
                            self.state.tool_offset[index]
                        } else {
                            0.0
                        };
                        self.state.tool_offset[index] = base + value * self.state.word_unit(index);
                        check_coordinate(self.state.tool_offset[index], axis, line)?;
                    }
                }
            }
        }
        Ok(())
    }

    /// Warns of the length of another tool than the one in the spindle. Without a tool change the tool in the
    /// spindle is unknown.
    fn warn_of_other_length(&mut self, number: u32, offset: &Axes) {
        let present = self.state.tool;
        let present_tool = self.tools.as_ref().and_then(|tools| tools.get(present));
        if present == 0 || number == present || present_tool.is_none_or(|tool| tool.offset == *offset) {
            return;
        }
        self.emit(Action::Warning(format!(
            "G43 H{number} takes the length of tool {number}, but tool {present} is in the spindle: write \
             H{present}, or G43 alone for the tool in the spindle"
        )));
    }

    /// The tool of H or D; without the word, or with 0, the tool in the spindle.
    pub(crate) fn tool_number(&self, letter: u8) -> Result<u32, Fault> {
        let number = self.line.integer(letter)?.filter(|number| *number != 0);
        Ok(number.unwrap_or(self.state.tool))
    }

    /// A tool of the table, for the word or group that needs it.
    pub(crate) fn tool(&mut self, number: u32, letter: u8, group: Group) -> Result<Tool, Fault> {
        let tools = self.tools.as_ref();
        match tools.map(|tools| tools.get(number).copied()) {
            Some(Some(tool)) => Ok(tool),
            _ if number == 0 => Ok(Tool::new(0)),
            Some(None) => {
                let line = self.line;
                let message = format!("tool {number} is not in the tool table");
                let span = if line.has(letter) {
                    line.span(letter)
                } else {
                    line.group_span(group)
                };
                Err(Fault::new(Code::UnknownTool, span, message).help(format!(
                    "add the tool to the table, or name another one with {}",
                    char::from(letter)
                )))
            }
            None if self.settings.tools_without_table => {
                self.emit(Action::Warning(format!(
                    "there is no tool table, so offsets and diameter of tool {number} are 0"
                )));
                Ok(Tool::new(number))
            }
            None => {
                let line = self.line;
                let message = format!("tool {number} has no offsets and no diameter: there is no tool table");
                let span = if line.has(letter) {
                    line.span(letter)
                } else {
                    line.group_span(group)
                };
                Err(Fault::new(Code::UnknownTool, span, message).help(
                    "name a tool table with --tools or program.tool_table of the machine file; \
                     program.without_tool_table = \"zero\" there takes them as 0",
                ))
            }
        }
    }

    /// Codes of group 0 that write offsets, and G28 and G30.
    pub(crate) fn data(&mut self) -> Result<(), Fault> {
        let line = self.line;
        if let Some(non_modal) = line.non_modal() {
            self.execute_non_modal(non_modal)?;
        }
        match line.offset_switch() {
            Some(switch) => self.execute_non_modal(switch),
            None => Ok(()),
        }
    }

    fn execute_non_modal(&mut self, code: NonModal) -> Result<(), Fault> {
        let line = self.line;
        if self.state.cutter.is_on() && !matches!(code, NonModal::Dwell) {
            let span = line.group_span(Group::NonModal);
            let message = format!("{} while cutter compensation is on", code.name());
            return Err(Fault::new(Code::CompensationActive, span, message).help("write G40 first"));
        }
        match code {
            NonModal::Dwell | NonModal::MachineCoordinates => {}
            NonModal::SetData => return self.set_data(),
            NonModal::Home(first) => return self.home(first),
            NonModal::SetHome(first) => {
                let position = self.state.programmed();
                self.parameters.set_axes(first, &position);
            }
            NonModal::LocalOffset | NonModal::SetOffset => {
                let position = self.state.machine_to_program(self.state.programmed()) + self.state.g92;
                for axis in AxisLetter::ALL {
                    let index = axis.index();
                    if let Some(value) = line.axis(index) {
                        let value = value * self.state.word_unit(index);
                        self.state.g92[index] = if code == NonModal::SetOffset {
                            position[index] - value
                        } else {
                            value
                        };
                        check_coordinate(self.state.g92[index], axis, line)?;
                    }
                }
                self.parameters.set_numbered(G92_ACTIVE, 1.0);
                let offset = self.state.g92;
                self.parameters.set_axes(G92, &offset);
            }
            NonModal::ClearOffset => {
                self.state.g92 = Axes::zeros();
                self.parameters.set_numbered(G92_ACTIVE, 0.0);
                self.parameters.set_axes(G92, &Axes::zeros());
            }
            NonModal::SuspendOffset => self.suspend_offset(),
            NonModal::RestoreOffset => self.restore_offset()?,
        }
        Ok(())
    }

    /// G92.2.
    pub(crate) fn suspend_offset(&mut self) {
        self.state.g92 = Axes::zeros();
        self.parameters.set_numbered(G92_ACTIVE, 0.0);
    }

    /// G92.3.
    pub(crate) fn restore_offset(&mut self) -> Result<(), Fault> {
        self.state.g92 = self.parameters.axes(G92);
        for axis in AxisLetter::ALL {
            check_coordinate(self.state.g92[axis.index()], axis, self.line)?;
        }
        self.parameters.set_numbered(G92_ACTIVE, 1.0);
        Ok(())
    }

    fn set_data(&mut self) -> Result<(), Fault> {
        let line = self.line;
        let missing = |text: &str| {
            Err(Fault::new(
                Code::WordMissing,
                line.group_span(Group::NonModal),
                text.to_owned(),
            ))
        };
        let Some(kind) = line.integer(b'L')? else {
            return missing("G10 needs L: 1, 10, 11 write a tool, 2 and 20 a work offset");
        };
        match kind {
            0 => Ok(()),
            2 | 20 => {
                let Some(number) = line.integer(b'P')? else {
                    return missing(
                        "G10 L2 and L20 need P: 1 for G54 to 9 for G59.3, 0 for the one in force",
                    );
                };
                let index = match number {
                    0 => self.state.modes.work_index,
                    number if number as usize <= WORK_OFFSETS => number as usize - 1,
                    _ => {
                        let message = format!("P{number}: there are work offsets from 1 (G54) to 9 (G59.3)");
                        return Err(Fault::new(Code::OutOfRange, line.span(b'P'), message));
                    }
                };
                self.set_work_offset(kind == 20, index)
            }
            1 | 10 | 11 => {
                let Some(number) = line.integer(b'P')? else {
                    return missing("G10 L1, L10 and L11 need P, the number of the tool");
                };
                if number == 0 {
                    let message = "P0: tools in the table have numbers from 1";
                    return Err(Fault::new(Code::OutOfRange, line.span(b'P'), message)
                        .help("write the number of the tool in the spindle: #5400"));
                }
                self.set_tool(kind, number)
            }
            _ => {
                let message = format!("L{kind}: G10 supports L0, L1, L2, L10, L11 and L20");
                let fault = Fault::new(Code::OutOfRange, line.span(b'L'), message);
                Err(match kind {
                    12 | 13 => fault.help("the radius of a tool is R of G10 L1 P.. R.."),
                    50..=52 => {
                        fault.help("the machine file and the tool table replace parameters of the control")
                    }
                    _ => fault,
                })
            }
        }
    }

    fn set_work_offset(&mut self, from_position: bool, index: usize) -> Result<(), Fault> {
        let line = self.line;
        let first = WORK_OFFSET_1 + 20 * index;
        if let Some(degrees) = line.word(b'R') {
            self.parameters.set_numbered(first + AXES, degrees);
        }
        let mut state = *self.state;
        state.modes.work_index = index;
        state.load_work(self.parameters);
        let present = state.machine_to_program(state.programmed());
        let mut target = present;
        for axis in AxisLetter::ALL {
            let axis_index = axis.index();
            if let Some(value) = line.axis(axis_index) {
                target[axis_index] = value * self.state.word_unit(axis_index);
            }
        }
        let shift = state.rotate(present - target);
        // In rotated coordinates an offset along X changes both axes of the machine.
        let is_coupled = from_position && state.rotation[0] != 0.0 && (line.has(b'X') || line.has(b'Y'));
        for axis in AxisLetter::ALL {
            let axis_index = axis.index();
            if line.axis(axis_index).is_some() || is_coupled && axis_index < 2 {
                let value = if from_position {
                    state.work[axis_index] + shift[axis_index]
                } else {
                    target[axis_index]
                };
                check_coordinate(value, axis, line)?;
                self.parameters.set_numbered(first + axis_index, value);
            }
        }
        if index == self.state.modes.work_index {
            self.state.load_work(self.parameters);
        }
        Ok(())
    }

    fn set_tool(&mut self, kind: u32, number: u32) -> Result<(), Fault> {
        let line = self.line;
        let existing = self.tools.as_ref().and_then(|tools| tools.get(number)).copied();
        let mut tool = existing.unwrap_or_else(|| Tool::new(number));
        // The position of the tip without tool length: in the active coordinates, or in those of G59.3.
        let mut state = *self.state;
        state.tool_offset = Axes::zeros();
        if kind == 11 {
            state.modes.work_index = WORK_OFFSETS - 1;
            state.load_work(self.parameters);
            state.g92 = Axes::zeros();
        }
        let tip = state.machine_to_program(state.programmed());
        // An offset acts along the axes of the machine, but the words are along those of the system.
        let mut target = state.rotate_back(tool.offset);
        for axis in AxisLetter::ALL {
            let index = axis.index();
            if let Some(value) = line.axis(index) {
                let value = value * self.state.word_unit(index);
                target[index] = if kind == 1 { value } else { tip[index] - value };
            }
        }
        let rotated = kind != 1 && state.rotation[0] != 0.0;
        let offset = if rotated { state.rotate(target) } else { target };
        // In rotated coordinates a length along X has a component of both axes of the machine.
        let is_coupled = rotated && (line.has(b'X') || line.has(b'Y'));
        for axis in AxisLetter::ALL {
            let index = axis.index();
            if line.axis(index).is_some() || is_coupled && index < 2 {
                check_coordinate(offset[index], axis, line)?;
                tool.offset[index] = offset[index];
            }
        }
        if let Some(radius) = line.word(b'R') {
            if kind != 1 && !line.has_axes() {
                self.emit(Action::Warning(format!(
                    "R{radius} becomes the radius of tool {number}; on other controls G10 L{kind} P R sets its \
                     length (here G10 L1 P{number} Z..) or the wear of its length"
                )));
            }
            tool.diameter_mm = 2.0 * radius * self.state.unit_mm();
        }
        if let Some(angle) = line.word(b'I') {
            tool.front_angle_deg = angle;
        }
        if let Some(angle) = line.word(b'J') {
            tool.back_angle_deg = angle;
        }
        if let Some(orientation) = line.integer(b'Q')? {
            if orientation > MAX_ORIENTATION {
                let message = format!("Q{orientation}: the orientation of a tool is 0 to 9");
                return Err(Fault::new(Code::OutOfRange, line.span(b'Q'), message));
            }
            tool.orientation = orientation;
        }
        self.tools.get_or_insert_default().set(tool);
        if number == self.state.tool {
            self.parameters.publish_tool(&tool);
        }
        Ok(())
    }
}

/// Checks that a machine coordinate is finite and in range.
#[inline]
pub(crate) fn check_coordinate(value: f64, axis: AxisLetter, line: &Statement) -> Result<(), Fault> {
    if value.abs() <= MAX_COORDINATE {
        return Ok(());
    }
    Err(position_too_large(value, axis, line))
}

#[cold]
fn position_too_large(value: f64, axis: AxisLetter, line: &Statement) -> Fault {
    let letter = axis.letter();
    let message = format!("{letter} would be {value:e} in machine coordinates");
    Fault::new(Code::PositionTooLarge, line.span(letter as u8), message)
        .help("no machine travels that far; check offsets and increments")
}
