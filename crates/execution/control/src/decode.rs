//! Decodes the numbers of a request into a command. Invalid requests are rejected.

use evolvent_config::plain;
use evolvent_path::{AXES, Axes, AxisMask};

use crate::alarm::Alarm;
use crate::command::{JogCommand, OperatorCommand, ToolEntry};
use crate::command_code::CommandCode;
use crate::interlock_state::Mode;
use crate::rejection::Rejection;

/// Largest magnitude of a coordinate, a distance or a speed in a command: mm, degrees, per s.
const MAX_VALUE: f64 = 1e6;
/// Maximum distance per detent of the handwheel, mm or degrees.
const MAX_STEP: f64 = 10.0;
/// Largest feed and spindle override.
const MAX_OVERRIDE: f64 = 2.0;
/// Maximum number of block starts in one retrace.
const MAX_BLOCKS: u32 = 1000;
/// Largest number and diameter of a tool.
const MAX_TOOL: u32 = 99_999;
const MAX_DIAMETER_MM: f64 = 1e4;
/// Minimum spindle override. At 0 the spindle would stop in the cut while the feed continues.
const MIN_SPINDLE_OVERRIDE: f64 = 0.1;
/// Work coordinate systems G54 to G59.3.
const SYSTEMS: u32 = 9;

/// The numbers of a request, as received.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawCommand<'a> {
    /// Code of the command.
    pub command: u32,
    /// Bit i set: applies to axis i.
    pub axes_mask: u32,
    /// A whole number.
    pub index: u32,
    /// A ratio, a speed or a diameter.
    pub amount: f64,
    /// A number for each axis.
    pub values: [f64; AXES],
    /// The text; `None` if it is not UTF-8 or too long.
    pub text: Option<&'a str>,
}

impl OperatorCommand {
    /// Decodes a request. `present` are the axes of the machine.
    ///
    /// # Errors
    /// The command is unknown, a number is not finite or out of range, an axis is missing, or the text is
    /// invalid.
    pub fn decode(raw: &RawCommand<'_>, present: AxisMask) -> Result<(CommandCode, Self), Rejection> {
        let Some(code) = CommandCode::from_number(raw.command) else {
            return Err(Rejection::new(
                Alarm::UnknownCommand,
                format!(
                    "no command has the number {}; update the core or the client",
                    raw.command
                ),
            ));
        };
        // Numbers that the command does not use are checked too: a client that sends invalid numbers has a
        // bug.
        if !raw.amount.is_finite() || raw.values.iter().any(|value| !value.is_finite()) {
            return Err(Rejection::new(
                Alarm::BadNumber,
                "a number of the command is not finite",
            ));
        }
        let command = match code {
            CommandCode::Estop => Self::Estop,
            CommandCode::EstopReset => Self::EstopReset,
            CommandCode::On => Self::On,
            CommandCode::Off => Self::Off,
            CommandCode::Mode => Self::SetMode(
                Mode::from_number(raw.index)
                    .ok_or_else(|| range("the mode", f64::from(raw.index), 0.0, 2.0))?,
            ),
            CommandCode::Load => Self::Load(text(raw)?),
            CommandCode::Start => Self::Start(raw.index),
            CommandCode::Hold => Self::Hold,
            CommandCode::Resume => Self::Resume,
            CommandCode::Step => Self::Step,
            CommandCode::Stop => Self::Stop,
            CommandCode::Reset => Self::Reset,
            CommandCode::SingleStep => Self::SingleStep(switch(raw)?),
            CommandCode::OptionalStop => Self::OptionalStop(switch(raw)?),
            CommandCode::BlockDelete => Self::BlockDelete(switch(raw)?),
            CommandCode::FeedOverride => {
                Self::FeedOverride(ratio("the feed override", raw, (0.0, MAX_OVERRIDE))?)
            }
            CommandCode::RapidOverride => Self::RapidOverride(ratio("the rapid override", raw, (0.0, 1.0))?),
            CommandCode::SpindleOverride => Self::SpindleOverride(ratio(
                "the spindle override",
                raw,
                (MIN_SPINDLE_OVERRIDE, MAX_OVERRIDE),
            )?),
            CommandCode::Mdi => Self::Mdi(text(raw)?),
            CommandCode::Jog => Self::Jog(jog(raw, present)?),
            CommandCode::JogKeep => Self::JogKeep,
            CommandCode::JogStop => Self::JogStop,
            CommandCode::Home if raw.axes_mask == 0 => Self::Home(present),
            CommandCode::Home => Self::Home(axes(raw, present)?),
            CommandCode::WorkOffset => Self::WorkOffset {
                system: system(raw)?,
                axes: axes(raw, present)?,
                values: values(raw)?,
            },
            CommandCode::TouchOff => Self::TouchOff {
                system: system(raw)?,
                axes: axes(raw, present)?,
                values: values(raw)?,
            },
            CommandCode::Tool if raw.index == 0 => Self::ReloadTools,
            CommandCode::Tool => Self::Tool(tool(raw, present)?),
            CommandCode::ClearAlarms => Self::ClearAlarms,
            CommandCode::SetOutput => Self::SetOutput {
                name: text(raw)?,
                value: raw.amount,
            },
            CommandCode::Handwheel => handwheel(raw, present)?,
            CommandCode::Return => Self::Return {
                max_velocity: speed(raw)?,
            },
            CommandCode::Retrace => Self::Retrace(blocks(raw)?),
        };
        Ok((code, command))
    }
}

fn range(what: &str, value: f64, low: f64, high: f64) -> Rejection {
    Rejection::new(
        Alarm::BadNumber,
        format!(
            "{what} is {}, it must be {} to {}",
            plain(value),
            plain(low),
            plain(high)
        ),
    )
}

fn tool(raw: &RawCommand<'_>, present: AxisMask) -> Result<ToolEntry, Rejection> {
    if raw.index > MAX_TOOL {
        return Err(range(
            "the tool's number",
            f64::from(raw.index),
            1.0,
            f64::from(MAX_TOOL),
        ));
    }
    if raw.amount > MAX_DIAMETER_MM {
        return Err(range("the diameter", raw.amount, 0.0, MAX_DIAMETER_MM));
    }
    Ok(ToolEntry {
        number: raw.index,
        // A diameter alone names no axis.
        axes: match raw.axes_mask {
            0 => AxisMask::from_bits(0),
            _ => axes(raw, present)?,
        },
        offset: values(raw)?,
        // Below zero: not given.
        diameter_mm: (raw.amount >= 0.0).then_some(raw.amount),
    })
}

/// Number of block starts to retrace; 0 counts as 1.
fn blocks(raw: &RawCommand<'_>) -> Result<u32, Rejection> {
    if raw.index > MAX_BLOCKS {
        return Err(range(
            "the number of blocks",
            f64::from(raw.index),
            1.0,
            f64::from(MAX_BLOCKS),
        ));
    }
    Ok(raw.index.max(1))
}

/// One axis or none, and its step; 0 for the smallest step of the wheel.
fn handwheel(raw: &RawCommand<'_>, present: AxisMask) -> Result<OperatorCommand, Rejection> {
    if !(0.0..=MAX_STEP).contains(&raw.amount) {
        return Err(range("the step of the handwheel", raw.amount, 0.0, MAX_STEP));
    }
    if raw.axes_mask == 0 {
        return Ok(OperatorCommand::Handwheel {
            axis: None,
            step: None,
        });
    }
    let chosen = axes(raw, present)?;
    let mut each = chosen.axes();
    let axis = each.next();
    if each.next().is_some() {
        return Err(Rejection::new(
            Alarm::NoAxis,
            "the handwheel moves one axis: name one",
        ));
    }
    Ok(OperatorCommand::Handwheel {
        axis,
        step: (raw.amount > 0.0).then_some(raw.amount),
    })
}

fn text(raw: &RawCommand<'_>) -> Result<String, Rejection> {
    let Some(text) = raw.text else {
        return Err(Rejection::new(
            Alarm::Malformed,
            "the command's text is not UTF-8 or is too long",
        ));
    };
    if text.trim().is_empty() || text.chars().any(|c| c.is_control() && c != '\t') {
        return Err(Rejection::new(
            Alarm::Malformed,
            "the command's text is empty or contains control characters",
        ));
    }
    Ok(text.trim().to_owned())
}

fn switch(raw: &RawCommand<'_>) -> Result<bool, Rejection> {
    match raw.index {
        0 => Ok(false),
        1 => Ok(true),
        other => Err(range("the switch", f64::from(other), 0.0, 1.0)),
    }
}

fn ratio(what: &str, raw: &RawCommand<'_>, (min, max): (f64, f64)) -> Result<f64, Rejection> {
    if (min..=max).contains(&raw.amount) {
        Ok(raw.amount)
    } else {
        Err(range(what, raw.amount, min, max))
    }
}

fn axes(raw: &RawCommand<'_>, present: AxisMask) -> Result<AxisMask, Rejection> {
    if raw.axes_mask == 0 || raw.axes_mask & !present.bits() != 0 {
        return Err(Alarm::NoAxis.into());
    }
    Ok(AxisMask::from_bits(raw.axes_mask))
}

fn system(raw: &RawCommand<'_>) -> Result<u32, Rejection> {
    if raw.index > SYSTEMS {
        return Err(range(
            "the work coordinate system",
            f64::from(raw.index),
            0.0,
            f64::from(SYSTEMS),
        ));
    }
    Ok(raw.index)
}

fn values(raw: &RawCommand<'_>) -> Result<Axes, Rejection> {
    if let Some(value) = raw.values.iter().find(|value| value.abs() > MAX_VALUE) {
        return Err(range("a coordinate", *value, -MAX_VALUE, MAX_VALUE));
    }
    Ok(Axes::from(raw.values))
}

fn jog(raw: &RawCommand<'_>, present: AxisMask) -> Result<JogCommand, Rejection> {
    let axes = axes(raw, present)?;
    let mut values = values(raw)?;
    for i in 0..AXES {
        if !axes.contains(i) {
            values[i] = 0.0;
        } else if values[i] == 0.0 {
            return Err(Rejection::new(
                Alarm::BadNumber,
                "an axis to jog has neither direction nor distance",
            ));
        }
    }
    let speed = speed(raw)?;
    let is_increment = match raw.index {
        0 => false,
        1 => true,
        other => return Err(range("the kind of jog", f64::from(other), 0.0, 1.0)),
    };
    Ok(JogCommand {
        axes,
        distance: is_increment.then_some(values),
        direction: if is_increment {
            Axes::zeros()
        } else {
            values.map(sign)
        },
        max_velocity: speed,
    })
}

/// `None` for the jog speed of the machine.
fn speed(raw: &RawCommand<'_>) -> Result<Option<f64>, Rejection> {
    if !(0.0..=MAX_VALUE).contains(&raw.amount) {
        return Err(range("the speed", raw.amount, 0.0, MAX_VALUE));
    }
    Ok((raw.amount > 0.0).then_some(raw.amount))
}

fn sign(value: f64) -> f64 {
    if value > 0.0 {
        1.0
    } else if value < 0.0 {
        -1.0
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const XYZ: AxisMask = AxisMask::from_bits(0b111);

    fn raw(code: CommandCode) -> RawCommand<'static> {
        RawCommand {
            command: code as u32,
            axes_mask: 0,
            index: 0,
            amount: 0.0,
            values: [0.0; AXES],
            text: Some(""),
        }
    }

    fn refused(raw: &RawCommand<'_>) -> Alarm {
        OperatorCommand::decode(raw, XYZ).unwrap_err().alarm
    }

    #[test]
    fn non_finite_numbers_are_rejected_in_every_field() {
        for &code in CommandCode::ALL {
            for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                let amount = RawCommand {
                    amount: bad,
                    ..raw(code)
                };
                assert_eq!(refused(&amount), Alarm::BadNumber, "{code:?}");
                let mut values = raw(code);
                values.values[8] = bad;
                assert_eq!(refused(&values), Alarm::BadNumber, "{code:?}");
            }
        }
    }

    fn indexed(code: CommandCode, index: u32) -> RawCommand<'static> {
        RawCommand { index, ..raw(code) }
    }

    fn of_amount(code: CommandCode, amount: f64) -> RawCommand<'static> {
        RawCommand { amount, ..raw(code) }
    }

    fn of_axes(code: CommandCode, axes_mask: u32) -> RawCommand<'static> {
        RawCommand {
            axes_mask,
            ..raw(code)
        }
    }

    #[test]
    fn what_is_out_of_range_is_refused() {
        let unknown = RawCommand {
            command: 999,
            ..raw(CommandCode::On)
        };
        assert_eq!(refused(&unknown), Alarm::UnknownCommand);
        for raw in [
            indexed(CommandCode::Mode, 3),
            indexed(CommandCode::BlockDelete, 2),
            indexed(CommandCode::Retrace, 1001),
            indexed(CommandCode::Tool, 100_000),
            of_amount(CommandCode::FeedOverride, 2.01),
            of_amount(CommandCode::RapidOverride, 1.01),
            of_amount(CommandCode::SpindleOverride, 0.099),
            of_amount(CommandCode::Handwheel, 10.1),
            of_amount(CommandCode::Return, -0.1),
            of_axes(CommandCode::Jog, 1),
            RawCommand {
                index: 10,
                ..of_axes(CommandCode::WorkOffset, 1)
            },
            RawCommand {
                values: [1e7; AXES],
                ..of_axes(CommandCode::TouchOff, 1)
            },
        ] {
            assert_eq!(refused(&raw), Alarm::BadNumber, "{raw:?}");
        }
        for text in [None, Some("  "), Some("G0\nG1")] {
            let raw = RawCommand {
                text,
                ..raw(CommandCode::Mdi)
            };
            assert_eq!(refused(&raw), Alarm::Malformed, "{raw:?}");
        }
        for raw in [
            raw(CommandCode::Jog),
            of_axes(CommandCode::Jog, 8),
            of_axes(CommandCode::Home, 8),
            of_axes(CommandCode::Handwheel, 3),
            of_axes(CommandCode::Handwheel, 8),
        ] {
            assert_eq!(refused(&raw), Alarm::NoAxis, "{raw:?}");
        }
    }

    #[test]
    fn a_jog_decodes_its_directions_for_its_axes_only() {
        let mut request = raw(CommandCode::Jog);
        request.axes_mask = 0b101;
        request.values = [-3.0, 7.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        request.amount = 20.0;
        let Ok((_, OperatorCommand::Jog(continuous))) = OperatorCommand::decode(&request, XYZ) else {
            panic!("refused");
        };
        assert_eq!(continuous.distance, None);
        assert_eq!(continuous.direction.as_slice()[..3], [-1.0, 0.0, 1.0]);
        assert_eq!(continuous.max_velocity, Some(20.0));
        request.index = 1;
        let Ok((_, OperatorCommand::Jog(increment))) = OperatorCommand::decode(&request, XYZ) else {
            panic!("refused");
        };
        assert_eq!(increment.distance.unwrap().as_slice()[..3], [-3.0, 0.0, 0.5]);
    }

    /// Values up to the limits, with the words that the trace records.
    #[test]
    fn values_at_the_limits_are_decoded_and_described() {
        let values = [MAX_VALUE, -MAX_VALUE, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let xz = 0b101;
        let of = |code: CommandCode, index: u32, amount: f64| RawCommand {
            index,
            amount,
            axes_mask: xz,
            values,
            ..raw(code)
        };
        let tool = |number: u32, axes_mask: u32, diameter_mm: Option<f64>| {
            OperatorCommand::Tool(ToolEntry {
                number,
                axes: AxisMask::from_bits(axes_mask),
                offset: Axes::from(values),
                diameter_mm,
            })
        };
        let cases = [
            (
                of(CommandCode::Tool, 0, 0.0),
                OperatorCommand::ReloadTools,
                "tool table read again",
            ),
            (
                of(CommandCode::Tool, 99_999, 1e4),
                tool(99_999, xz, Some(1e4)),
                "tool 99999 set",
            ),
            (
                of(CommandCode::Tool, 1, 0.0),
                tool(1, xz, Some(0.0)),
                "tool 1 set",
            ),
            (of(CommandCode::Tool, 1, -1.0), tool(1, xz, None), "tool 1 set"),
            (
                RawCommand {
                    // A diameter alone.
                    axes_mask: 0,
                    ..of(CommandCode::Tool, 2, 6.0)
                },
                tool(2, 0, Some(6.0)),
                "tool 2 set",
            ),
            (
                of(CommandCode::WorkOffset, 9, 0.0),
                OperatorCommand::WorkOffset {
                    system: 9,
                    axes: AxisMask::from_bits(xz),
                    values: Axes::from(values),
                },
                "work offset 9 of XZ",
            ),
            (
                of(CommandCode::TouchOff, 0, 0.0),
                OperatorCommand::TouchOff {
                    system: 0,
                    axes: AxisMask::from_bits(xz),
                    values: Axes::from(values),
                },
                "touch off XZ in work offset 0",
            ),
            (
                of(CommandCode::Jog, 1, 0.0),
                OperatorCommand::Jog(JogCommand {
                    axes: AxisMask::from_bits(xz),
                    distance: Some(Axes::from([MAX_VALUE, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])),
                    direction: Axes::zeros(),
                    max_velocity: None,
                }),
                "jog XZ by an increment",
            ),
            (
                of(CommandCode::Home, 0, 0.0),
                OperatorCommand::Home(AxisMask::from_bits(xz)),
                "home XZ",
            ),
            (raw(CommandCode::Home), OperatorCommand::Home(XYZ), "home XYZ"),
            (
                of(CommandCode::Return, 0, 2.5),
                OperatorCommand::Return {
                    max_velocity: Some(2.5),
                },
                "return",
            ),
            (
                of(CommandCode::Retrace, 0, 0.0),
                OperatorCommand::Retrace(1),
                "retrace to the start of the block",
            ),
            (
                of(CommandCode::Retrace, 1000, 0.0),
                OperatorCommand::Retrace(1000),
                "retrace 1000 blocks",
            ),
            (of(CommandCode::Start, 0, 0.0), OperatorCommand::Start(0), "start"),
            (of(CommandCode::Start, 1, 0.0), OperatorCommand::Start(1), "start"),
            (
                of(CommandCode::Start, 2, 0.0),
                OperatorCommand::Start(2),
                "start from line 2",
            ),
            (
                of(CommandCode::Mode, 2, 0.0),
                OperatorCommand::SetMode(Mode::Mdi),
                "mode MDI",
            ),
            (
                of(CommandCode::FeedOverride, 0, 2.0),
                OperatorCommand::FeedOverride(2.0),
                "feed override 200.0 %",
            ),
            (
                of(CommandCode::RapidOverride, 0, 0.0),
                OperatorCommand::RapidOverride(0.0),
                "rapid override 0.0 %",
            ),
            (
                of(CommandCode::SpindleOverride, 0, 0.753),
                OperatorCommand::SpindleOverride(0.753),
                "spindle override 75.3 %",
            ),
        ];
        for (raw, expected, words) in cases {
            let (code, command) = OperatorCommand::decode(&raw, XYZ).unwrap();
            assert_eq!((code as u32, &command), (raw.command, &expected));
            assert_eq!(command.to_string().to_lowercase(), words.to_lowercase());
            // The values that are needed to recompute runs.
            let is_override = words.contains("override");
            assert_eq!(command.value(), is_override.then_some(raw.amount), "{words}");
        }
    }

    #[test]
    fn values_just_beyond_the_limits_and_absent_axes_are_refused() {
        let too_wide = RawCommand {
            amount: 1.000_1e4,
            ..indexed(CommandCode::Tool, 1)
        };
        assert_eq!(refused(&too_wide), Alarm::BadNumber);
        // An axis that the machine does not have is rejected, not dropped.
        let absent = RawCommand {
            axes_mask: 0b1101,
            ..indexed(CommandCode::Tool, 1)
        };
        assert_eq!(refused(&absent), Alarm::NoAxis);
        let far = RawCommand {
            values: [-1.000_1 * MAX_VALUE; AXES],
            ..of_axes(CommandCode::TouchOff, 1)
        };
        let text = OperatorCommand::decode(&far, XYZ).unwrap_err().text;
        assert_eq!(text, "a coordinate is -1000100, it must be -1000000 to 1000000");
    }
}
