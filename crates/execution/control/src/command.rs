//! Commands to the machine.

use evolvent_path::{Axes, AxisLetter, AxisMask};

use crate::command_code::CommandCode;
use crate::interlock_state::Mode;

/// A jog.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JogCommand {
    /// Bit i set: axis i moves.
    pub axes: AxisMask,
    /// Distance of each axis; `None` for a continuous jog, which lasts while it is renewed.
    pub distance: Option<Axes>,
    /// Signs of the directions of a continuous jog; 0 for axes that do not move.
    pub direction: Axes,
    /// Maximum speed of each axis, mm/s or degrees/s; `None` for the jog speed of the machine.
    pub max_velocity: Option<f64>,
}

/// An entry of the tool table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolEntry {
    /// The tool's number, from 1.
    pub number: u32,
    /// Which offsets are set.
    pub axes: AxisMask,
    /// The offsets, mm or degrees.
    pub offset: Axes,
    /// Diameter, mm; `None` leaves it unchanged.
    pub diameter_mm: Option<f64>,
}

/// A valid command: [`OperatorCommand::decode`] has checked its numbers.
///
/// ```
/// use evolvent_control::{Alarm, OperatorCommand, CommandCode, Mode, RawCommand};
/// use evolvent_path::AxisMask;
///
/// let mut raw = RawCommand {
///     command: CommandCode::Mode as u32,
///     axes_mask: 0,
///     index: 1,
///     amount: 0.0,
///     values: [0.0; 9],
///     text: Some(""),
/// };
/// let xyz = AxisMask::from_bits(0b111);
/// let (_, command) = OperatorCommand::decode(&raw, xyz)?;
/// assert_eq!(command, OperatorCommand::SetMode(Mode::Manual));
///
/// raw.amount = f64::NAN;
/// assert_eq!(OperatorCommand::decode(&raw, xyz).unwrap_err().alarm, Alarm::BadNumber);
/// # Ok::<(), evolvent_control::Rejection>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub enum OperatorCommand {
    /// See [`CommandCode::Estop`].
    Estop,
    /// See [`CommandCode::EstopReset`].
    EstopReset,
    /// See [`CommandCode::On`].
    On,
    /// See [`CommandCode::Off`].
    Off,
    /// See [`CommandCode::Mode`].
    SetMode(Mode),
    /// See [`CommandCode::Load`]: the name of the file.
    Load(String),
    /// See [`CommandCode::Start`]: the line, 0 or 1 for the beginning.
    Start(u32),
    /// See [`CommandCode::Hold`].
    Hold,
    /// See [`CommandCode::Resume`].
    Resume,
    /// See [`CommandCode::Step`].
    Step,
    /// See [`CommandCode::Stop`].
    Stop,
    /// See [`CommandCode::Reset`].
    Reset,
    /// See [`CommandCode::SingleStep`].
    SingleStep(bool),
    /// See [`CommandCode::OptionalStop`].
    OptionalStop(bool),
    /// See [`CommandCode::BlockDelete`].
    BlockDelete(bool),
    /// See [`CommandCode::FeedOverride`].
    FeedOverride(f64),
    /// See [`CommandCode::RapidOverride`].
    RapidOverride(f64),
    /// See [`CommandCode::SpindleOverride`].
    SpindleOverride(f64),
    /// See [`CommandCode::Mdi`].
    Mdi(String),
    /// See [`CommandCode::Jog`].
    Jog(JogCommand),
    /// See [`CommandCode::JogKeep`].
    JogKeep,
    /// See [`CommandCode::JogStop`].
    JogStop,
    /// See [`CommandCode::Home`]: the axes, at least one.
    Home(AxisMask),
    /// See [`CommandCode::WorkOffset`].
    WorkOffset {
        /// 1 for G54 to 9 for G59.3; 0 for the active one.
        system: u32,
        /// Which axes.
        axes: AxisMask,
        /// Work zero in machine coordinates.
        values: Axes,
    },
    /// See [`CommandCode::TouchOff`].
    TouchOff {
        /// 1 for G54 to 9 for G59.3; 0 for the active one.
        system: u32,
        /// Which axes.
        axes: AxisMask,
        /// Coordinates that the present positions are to have.
        values: Axes,
    },
    /// See [`CommandCode::Tool`].
    Tool(ToolEntry),
    /// Reads the tool table again.
    ReloadTools,
    /// See [`CommandCode::ClearAlarms`].
    ClearAlarms,
    /// See [`CommandCode::SetOutput`].
    SetOutput {
        /// Name of the output in the machine file.
        name: String,
        /// Value; 0 or 1 for a digital output.
        value: f64,
    },
    /// See [`CommandCode::Handwheel`].
    Handwheel {
        /// Index of the axis; `None` disconnects the wheel.
        axis: Option<usize>,
        /// Distance per detent, mm or degrees; `None` for the smallest step of the wheel.
        step: Option<f64>,
    },
    /// See [`CommandCode::Return`].
    Return {
        /// Maximum speed of each axis, mm/s or degrees/s; `None` for the jog speed of the machine.
        max_velocity: Option<f64>,
    },
    /// See [`CommandCode::Retrace`]: number of block starts, at least one.
    Retrace(u32),
}

impl OperatorCommand {
    /// The code of this command on the bus.
    #[must_use]
    pub const fn code(&self) -> CommandCode {
        match self {
            Self::Estop => CommandCode::Estop,
            Self::EstopReset => CommandCode::EstopReset,
            Self::On => CommandCode::On,
            Self::Off => CommandCode::Off,
            Self::SetMode(_) => CommandCode::Mode,
            Self::Load(_) => CommandCode::Load,
            Self::Start(_) => CommandCode::Start,
            Self::Hold => CommandCode::Hold,
            Self::Resume => CommandCode::Resume,
            Self::Step => CommandCode::Step,
            Self::Stop => CommandCode::Stop,
            Self::Reset => CommandCode::Reset,
            Self::SingleStep(_) => CommandCode::SingleStep,
            Self::OptionalStop(_) => CommandCode::OptionalStop,
            Self::BlockDelete(_) => CommandCode::BlockDelete,
            Self::FeedOverride(_) => CommandCode::FeedOverride,
            Self::RapidOverride(_) => CommandCode::RapidOverride,
            Self::SpindleOverride(_) => CommandCode::SpindleOverride,
            Self::Mdi(_) => CommandCode::Mdi,
            Self::Jog(_) => CommandCode::Jog,
            Self::JogKeep => CommandCode::JogKeep,
            Self::JogStop => CommandCode::JogStop,
            Self::Home(_) => CommandCode::Home,
            Self::WorkOffset { .. } => CommandCode::WorkOffset,
            Self::TouchOff { .. } => CommandCode::TouchOff,
            Self::Tool(_) | Self::ReloadTools => CommandCode::Tool,
            Self::ClearAlarms => CommandCode::ClearAlarms,
            Self::SetOutput { .. } => CommandCode::SetOutput,
            Self::Handwheel { .. } => CommandCode::Handwheel,
            Self::Return { .. } => CommandCode::Return,
            Self::Retrace(_) => CommandCode::Retrace,
        }
    }

    /// The value that is needed to recompute a run: an override, or the value of an output.
    #[must_use]
    pub const fn value(&self) -> Option<f64> {
        match self {
            Self::FeedOverride(ratio) | Self::RapidOverride(ratio) | Self::SpindleOverride(ratio) => {
                Some(*ratio)
            }
            Self::SetOutput { value, .. } => Some(*value),
            _ => None,
        }
    }
}

impl std::fmt::Display for OperatorCommand {
    /// A short description, for the trace.
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let letters =
            |axes: AxisMask| -> String { axes.axes().map(|axis| AxisLetter::ALL[axis].letter()).collect() };
        let percent = |ratio: &f64| format!("{:.1} %", 100.0 * ratio);
        let on = |on: &bool| if *on { "on" } else { "off" };
        let text = match self {
            Self::Estop => "emergency stop".to_owned(),
            Self::EstopReset => "emergency stop reset".to_owned(),
            Self::On => "on".to_owned(),
            Self::Off => "off".to_owned(),
            Self::SetMode(mode) => format!("mode {}", mode.name()),
            Self::Load(file) => format!("load {file}"),
            Self::Start(line) if *line > 1 => format!("start from line {line}"),
            Self::Start(_) => "start".to_owned(),
            Self::Hold => "hold".to_owned(),
            Self::Resume => "resume".to_owned(),
            Self::Step => "step".to_owned(),
            Self::Stop => "stop".to_owned(),
            Self::Reset => "reset".to_owned(),
            Self::SingleStep(state) => format!("single step {}", on(state)),
            Self::OptionalStop(state) => format!("optional stop {}", on(state)),
            Self::BlockDelete(state) => format!("block delete {}", on(state)),
            Self::FeedOverride(ratio) => format!("feed override {}", percent(ratio)),
            Self::RapidOverride(ratio) => format!("rapid override {}", percent(ratio)),
            Self::SpindleOverride(ratio) => format!("spindle override {}", percent(ratio)),
            Self::Mdi(text) => format!("MDI {text}"),
            Self::Jog(jog) => match &jog.distance {
                Some(_) => format!("jog {} by an increment", letters(jog.axes)),
                None => format!("jog {}", letters(jog.axes)),
            },
            Self::JogKeep => "jog continues".to_owned(),
            Self::JogStop => "jog stop".to_owned(),
            Self::Home(axes) => format!("home {}", letters(*axes)),
            Self::WorkOffset { system, axes, .. } => {
                format!("work offset {system} of {}", letters(*axes))
            }
            Self::TouchOff { system, axes, .. } => {
                format!("touch off {} in work offset {system}", letters(*axes))
            }
            Self::Tool(entry) => format!("tool {} set", entry.number),
            Self::ReloadTools => "tool table read again".to_owned(),
            Self::ClearAlarms => "alarms cleared".to_owned(),
            Self::SetOutput { name, value } => format!("output {name} = {value}"),
            Self::Return { .. } => "return".to_owned(),
            Self::Retrace(1) => "retrace to the start of the block".to_owned(),
            Self::Retrace(blocks) => format!("retrace {blocks} blocks"),
            Self::Handwheel { axis: None, .. } => "handwheel off".to_owned(),
            Self::Handwheel {
                axis: Some(axis),
                step,
            } => {
                let letter = letters(AxisMask::one(*axis));
                match step {
                    Some(step) => format!("handwheel {letter} by {step}"),
                    None => format!("handwheel {letter}"),
                }
            }
        };
        formatter.write_str(&text)
    }
}
