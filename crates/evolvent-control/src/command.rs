//! Commands: from the numbers of a request to something with a meaning.

use evolvent_path::{AXES, Axes, AxisLetter};

use crate::alarm::Alarm;
use crate::rules::mode_needed;
use crate::situation::Mode;

/// Largest magnitude of a coordinate, a distance or a speed in a command: mm, degrees, per s.
const MOST: f64 = 1e6;
/// Largest feed and spindle override.
const MOST_OVERRIDE: f64 = 2.0;
/// Work coordinate systems G54 to G59.3.
const SYSTEMS: u32 = 9;

macro_rules! codes {
    ($($(#[doc = $doc:literal])* $name:ident = $number:literal, $text:literal;)*) => {
        /// The number of a command on the bus.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u32)]
        pub enum CommandCode {
            $($(#[doc = $doc])* $name = $number,)*
        }

        impl CommandCode {
            /// All commands in order of their numbers, which begin with 1.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// The name in the bus's bindings.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)*
                }
            }
        }
    };
}

codes! {
    /// Every axis stops by itself, the drives lose power.
    Estop = 1, "ESTOP";
    /// Leaves the emergency stop: off.
    EstopReset = 2, "ESTOP_RESET";
    /// Enables the drives.
    On = 3, "ON";
    /// Takes power from the drives.
    Off = 4, "OFF";
    /// Changes the mode: `index`.
    Mode = 5, "MODE";
    /// Loads the program of file `text`.
    Load = 6, "LOAD";
    /// Starts the program, from line `index` if that is above 1.
    Start = 7, "START";
    /// Holds the feed.
    Hold = 8, "HOLD";
    /// Goes on after a hold or a program stop.
    Resume = 9, "RESUME";
    /// Runs one block of the program.
    Step = 10, "STEP";
    /// Stops within the limits and ends the job.
    Stop = 11, "STOP";
    /// Forgets the modes that programs and MDI have left, and clears the alarms.
    Reset = 12, "RESET";
    /// Single step on or off: `index`.
    SingleStep = 13, "SINGLE_STEP";
    /// Optional stop on or off: `index`.
    OptionalStop = 14, "OPTIONAL_STOP";
    /// Block delete on or off: `index`.
    BlockDelete = 15, "BLOCK_DELETE";
    /// Feed override: `amount`, 0 to 2.
    FeedOverride = 16, "FEED_OVERRIDE";
    /// Rapid override: `amount`, 0 to 1.
    RapidOverride = 17, "RAPID_OVERRIDE";
    /// Spindle override: `amount`, 0 to 2.
    SpindleOverride = 18, "SPINDLE_OVERRIDE";
    /// Executes the block `text`.
    Mdi = 19, "MDI";
    /// Jogs the axes of `axes_mask`: with `index` 0 in the directions of `values` as long as it is kept, with 1 by the
    /// distances in `values`; at `amount` mm/s or degrees/s at most, 0 for the machine's own speed.
    Jog = 20, "JOG";
    /// The client that jogs is still there.
    JogKeep = 21, "JOG_KEEP";
    /// Ends the jog.
    JogStop = 22, "JOG_STOP";
    /// Homes the axes of `axes_mask`, all if it is 0.
    Home = 23, "HOME";
    /// Sets the offsets of work coordinate system `index` (1 is G54, 0 the active one) to `values`.
    WorkOffset = 24, "WORK_OFFSET";
    /// Sets them so that the axes' present positions read `values`.
    TouchOff = 25, "TOUCH_OFF";
    /// Sets tool `index`: offsets `values` of `axes_mask`, diameter `amount`. With index 0 the tool table is read
    /// again.
    Tool = 26, "TOOL";
    /// Clears the alarms.
    ClearAlarms = 27, "CLEAR_ALARMS";
}

impl CommandCode {
    /// The command of a number.
    #[must_use]
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.get((number as usize).checked_sub(1)?).copied()
    }
}

/// The numbers of a request, as they came.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawCommand<'a> {
    /// Number of the command.
    pub command: u32,
    /// Bit i set: about axis i.
    pub axes_mask: u32,
    /// A whole number.
    pub index: u32,
    /// A ratio, a speed or a diameter.
    pub amount: f64,
    /// A number for each axis.
    pub values: [f64; AXES],
    /// The text; none where it is no UTF-8 or too long.
    pub text: Option<&'a str>,
}

/// A jog.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JogCommand {
    /// Bit i set: axis i moves.
    pub axes_mask: u32,
    /// By so much; none for as long as it is kept.
    pub distance: Option<Axes>,
    /// Signs of the directions of a continuous jog; 0 for axes that stand.
    pub direction: Axes,
    /// Speed of each axis at the most, mm/s or degrees/s; none for the machine's own.
    pub speed: Option<f64>,
}

/// A tool's figures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolEntry {
    /// The tool's number, from 1.
    pub number: u32,
    /// Which offsets are set.
    pub axes_mask: u32,
    /// The offsets, mm or degrees.
    pub offset: Axes,
    /// Diameter, mm; none to leave it.
    pub diameter_mm: Option<f64>,
}

/// A command whose numbers make sense.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
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
    /// See [`CommandCode::Load`]: the file's name.
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
    Home(u32),
    /// See [`CommandCode::WorkOffset`].
    WorkOffset {
        /// 1 for G54 to 9 for G59.3; 0 for the active one.
        system: u32,
        /// Which axes.
        axes_mask: u32,
        /// Work zero in machine coordinates.
        values: Axes,
    },
    /// See [`CommandCode::TouchOff`].
    TouchOff {
        /// 1 for G54 to 9 for G59.3; 0 for the active one.
        system: u32,
        /// Which axes.
        axes_mask: u32,
        /// What the present positions are to read.
        values: Axes,
    },
    /// See [`CommandCode::Tool`].
    Tool(ToolEntry),
    /// The tool table is read again.
    ReloadTools,
    /// See [`CommandCode::ClearAlarms`].
    ClearAlarms,
}

/// Why a command is not accepted: a number for programs, a sentence for people.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct Refusal {
    /// The number.
    pub alarm: Alarm,
    /// What was wrong and what to do.
    pub text: String,
}

impl Refusal {
    /// With a sentence of its own.
    #[must_use]
    pub fn new(alarm: Alarm, text: impl Into<String>) -> Self {
        Self {
            alarm,
            text: text.into(),
        }
    }

    /// What the interlocks have against a command.
    #[must_use]
    pub fn by_rule(alarm: Alarm, command: CommandCode) -> Self {
        match (alarm, mode_needed(command)) {
            (Alarm::WrongMode, Some(mode)) => Self::new(
                alarm,
                format!("this needs mode {0}; change to it with `mode {0}`", mode.name()),
            ),
            _ => alarm.into(),
        }
    }
}

impl From<Alarm> for Refusal {
    fn from(alarm: Alarm) -> Self {
        Self::new(alarm, alarm.sentence())
    }
}

impl Command {
    /// Gives the numbers of a request their meaning. `present` are the machine's axes.
    ///
    /// # Errors
    /// The command is unknown, a number is not finite or out of range, an axis is missing, the text is none.
    pub fn decode(raw: &RawCommand<'_>, present: u32) -> Result<(CommandCode, Self), Refusal> {
        let Some(code) = CommandCode::from_number(raw.command) else {
            return Err(Refusal::new(
                Alarm::UnknownCommand,
                format!(
                    "no command has the number {}; update the core or the client",
                    raw.command
                ),
            ));
        };
        // Numbers that the command does not use are checked too: a client that sends rubbish is wrong somewhere.
        if !raw.amount.is_finite() || raw.values.iter().any(|value| !value.is_finite()) {
            return Err(Refusal::new(
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
            CommandCode::FeedOverride => Self::FeedOverride(ratio("the feed override", raw, MOST_OVERRIDE)?),
            CommandCode::RapidOverride => Self::RapidOverride(ratio("the rapid override", raw, 1.0)?),
            CommandCode::SpindleOverride => {
                Self::SpindleOverride(ratio("the spindle override", raw, MOST_OVERRIDE)?)
            }
            CommandCode::Mdi => Self::Mdi(text(raw)?),
            CommandCode::Jog => Self::Jog(jog(raw, present)?),
            CommandCode::JogKeep => Self::JogKeep,
            CommandCode::JogStop => Self::JogStop,
            CommandCode::Home if raw.axes_mask == 0 => Self::Home(present),
            CommandCode::Home => Self::Home(axes(raw, present)?),
            CommandCode::WorkOffset => Self::WorkOffset {
                system: system(raw)?,
                axes_mask: axes(raw, present)?,
                values: values(raw)?,
            },
            CommandCode::TouchOff => Self::TouchOff {
                system: system(raw)?,
                axes_mask: axes(raw, present)?,
                values: values(raw)?,
            },
            CommandCode::Tool if raw.index == 0 => Self::ReloadTools,
            CommandCode::Tool => {
                if raw.index > 99_999 {
                    return Err(range("the tool's number", f64::from(raw.index), 1.0, 99_999.0));
                }
                if raw.amount > 1e4 {
                    return Err(range("the diameter", raw.amount, 0.0, 1e4));
                }
                Self::Tool(ToolEntry {
                    number: raw.index,
                    axes_mask: raw.axes_mask & present,
                    offset: values(raw)?,
                    // Below zero: not given.
                    diameter_mm: (raw.amount >= 0.0).then_some(raw.amount),
                })
            }
            CommandCode::ClearAlarms => Self::ClearAlarms,
        };
        Ok((code, command))
    }
}

impl Command {
    /// Its number on the bus.
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
        }
    }

    /// The number in it that a run has to be computed again with: an override.
    #[must_use]
    pub const fn value(&self) -> Option<f64> {
        match self {
            Self::FeedOverride(ratio) | Self::RapidOverride(ratio) | Self::SpindleOverride(ratio) => {
                Some(*ratio)
            }
            _ => None,
        }
    }
}

impl std::fmt::Display for Command {
    /// A few words, for the trace.
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let letters = |mask: u32| -> String {
            (0..AXES)
                .filter(|i| mask >> i & 1 == 1)
                .map(|i| AxisLetter::ALL[i].letter())
                .collect()
        };
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
                Some(_) => format!("jog {} by an increment", letters(jog.axes_mask)),
                None => format!("jog {}", letters(jog.axes_mask)),
            },
            Self::JogKeep => "jog goes on".to_owned(),
            Self::JogStop => "jog stop".to_owned(),
            Self::Home(mask) => format!("home {}", letters(*mask)),
            Self::WorkOffset {
                system, axes_mask, ..
            } => {
                format!("work offset {system} of {}", letters(*axes_mask))
            }
            Self::TouchOff {
                system, axes_mask, ..
            } => {
                format!("touch off {} in work offset {system}", letters(*axes_mask))
            }
            Self::Tool(entry) => format!("tool {} set", entry.number),
            Self::ReloadTools => "tool table read again".to_owned(),
            Self::ClearAlarms => "alarms cleared".to_owned(),
        };
        formatter.write_str(&text)
    }
}

fn range(what: &str, value: f64, low: f64, high: f64) -> Refusal {
    Refusal::new(
        Alarm::BadNumber,
        format!("{what} is {value}, it must be {low} to {high}"),
    )
}

fn text(raw: &RawCommand<'_>) -> Result<String, Refusal> {
    let Some(text) = raw.text else {
        return Err(Refusal::new(
            Alarm::Malformed,
            "the command's text is no UTF-8 or too long",
        ));
    };
    if text.trim().is_empty() || text.chars().any(|c| c.is_control() && c != '\t') {
        return Err(Refusal::new(
            Alarm::Malformed,
            "the command's text is empty or holds control characters",
        ));
    }
    Ok(text.trim().to_owned())
}

fn switch(raw: &RawCommand<'_>) -> Result<bool, Refusal> {
    match raw.index {
        0 => Ok(false),
        1 => Ok(true),
        other => Err(range("the switch", f64::from(other), 0.0, 1.0)),
    }
}

fn ratio(what: &str, raw: &RawCommand<'_>, most: f64) -> Result<f64, Refusal> {
    if (0.0..=most).contains(&raw.amount) {
        Ok(raw.amount)
    } else {
        Err(range(what, raw.amount, 0.0, most))
    }
}

fn axes(raw: &RawCommand<'_>, present: u32) -> Result<u32, Refusal> {
    if raw.axes_mask == 0 || raw.axes_mask & !present != 0 {
        return Err(Alarm::NoAxis.into());
    }
    Ok(raw.axes_mask)
}

fn system(raw: &RawCommand<'_>) -> Result<u32, Refusal> {
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

fn values(raw: &RawCommand<'_>) -> Result<Axes, Refusal> {
    if let Some(value) = raw.values.iter().find(|value| value.abs() > MOST) {
        return Err(range("a coordinate", *value, -MOST, MOST));
    }
    Ok(Axes::from(raw.values))
}

fn jog(raw: &RawCommand<'_>, present: u32) -> Result<JogCommand, Refusal> {
    let axes_mask = axes(raw, present)?;
    let mut values = values(raw)?;
    for i in 0..AXES {
        if axes_mask >> i & 1 == 0 {
            values[i] = 0.0;
        } else if values[i] == 0.0 {
            return Err(Refusal::new(
                Alarm::BadNumber,
                "an axis to jog has neither direction nor distance",
            ));
        }
    }
    if !(0.0..=MOST).contains(&raw.amount) {
        return Err(range("the speed", raw.amount, 0.0, MOST));
    }
    let is_increment = match raw.index {
        0 => false,
        1 => true,
        other => return Err(range("the kind of jog", f64::from(other), 0.0, 1.0)),
    };
    Ok(JogCommand {
        axes_mask,
        distance: is_increment.then_some(values),
        direction: if is_increment {
            Axes::zeros()
        } else {
            values.map(sign)
        },
        speed: (raw.amount > 0.0).then_some(raw.amount),
    })
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

    const XYZ: u32 = 0b111;

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
        Command::decode(raw, XYZ).unwrap_err().alarm
    }

    #[test]
    fn numbers_and_names_stand_in_order() {
        for (index, &code) in CommandCode::ALL.iter().enumerate() {
            assert_eq!(code as usize, index + 1);
            assert_eq!(CommandCode::from_number(code as u32), Some(code));
        }
        assert_eq!(CommandCode::from_number(0), None);
        assert_eq!(CommandCode::from_number(u32::MAX), None);
    }

    #[test]
    fn a_number_that_is_none_is_refused_wherever_it_stands() {
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

    #[test]
    fn what_is_out_of_range_is_refused() {
        let cases = [
            (
                RawCommand {
                    command: 999,
                    ..raw(CommandCode::On)
                },
                Alarm::UnknownCommand,
            ),
            (
                RawCommand {
                    index: 3,
                    ..raw(CommandCode::Mode)
                },
                Alarm::BadNumber,
            ),
            (
                RawCommand {
                    index: 2,
                    ..raw(CommandCode::BlockDelete)
                },
                Alarm::BadNumber,
            ),
            (
                RawCommand {
                    amount: 2.01,
                    ..raw(CommandCode::FeedOverride)
                },
                Alarm::BadNumber,
            ),
            (
                RawCommand {
                    amount: 1.01,
                    ..raw(CommandCode::RapidOverride)
                },
                Alarm::BadNumber,
            ),
            (
                RawCommand {
                    amount: -0.1,
                    ..raw(CommandCode::SpindleOverride)
                },
                Alarm::BadNumber,
            ),
            (
                RawCommand {
                    text: None,
                    ..raw(CommandCode::Mdi)
                },
                Alarm::Malformed,
            ),
            (
                RawCommand {
                    text: Some("  "),
                    ..raw(CommandCode::Mdi)
                },
                Alarm::Malformed,
            ),
            (
                RawCommand {
                    text: Some("G0\nG1"),
                    ..raw(CommandCode::Mdi)
                },
                Alarm::Malformed,
            ),
            (raw(CommandCode::Jog), Alarm::NoAxis),
            (
                RawCommand {
                    axes_mask: 8,
                    ..raw(CommandCode::Jog)
                },
                Alarm::NoAxis,
            ),
            (
                RawCommand {
                    axes_mask: 1,
                    ..raw(CommandCode::Jog)
                },
                Alarm::BadNumber,
            ),
            (
                RawCommand {
                    axes_mask: 8,
                    ..raw(CommandCode::Home)
                },
                Alarm::NoAxis,
            ),
            (
                RawCommand {
                    axes_mask: 1,
                    index: 10,
                    ..raw(CommandCode::WorkOffset)
                },
                Alarm::BadNumber,
            ),
            (
                RawCommand {
                    axes_mask: 1,
                    values: [1e7; AXES],
                    ..raw(CommandCode::TouchOff)
                },
                Alarm::BadNumber,
            ),
            (
                RawCommand {
                    index: 100_000,
                    ..raw(CommandCode::Tool)
                },
                Alarm::BadNumber,
            ),
        ];
        for (raw, expected) in cases {
            assert_eq!(refused(&raw), expected, "{raw:?}");
        }
    }

    #[test]
    fn a_jog_knows_its_directions_and_leaves_the_other_axes_alone() {
        let mut request = raw(CommandCode::Jog);
        request.axes_mask = 0b101;
        request.values = [-3.0, 7.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        request.amount = 20.0;
        let Ok((_, Command::Jog(continuous))) = Command::decode(&request, XYZ) else {
            panic!("refused");
        };
        assert_eq!(continuous.distance, None);
        assert_eq!(continuous.direction.as_slice()[..3], [-1.0, 0.0, 1.0]);
        assert_eq!(continuous.speed, Some(20.0));
        request.index = 1;
        let Ok((_, Command::Jog(increment))) = Command::decode(&request, XYZ) else {
            panic!("refused");
        };
        assert_eq!(increment.distance.unwrap().as_slice()[..3], [-3.0, 0.0, 0.5]);
    }

    #[test]
    fn home_without_axes_is_home_all() {
        let (_, command) = Command::decode(&raw(CommandCode::Home), XYZ).unwrap();
        assert_eq!(command, Command::Home(XYZ));
    }

    #[test]
    fn a_refusal_for_the_mode_names_the_one_that_is_needed() {
        let refusal = Refusal::by_rule(Alarm::WrongMode, CommandCode::Mdi);
        assert!(refusal.text.contains("mode mdi"), "{refusal}");
        assert_eq!(
            Refusal::by_rule(Alarm::IsOff, CommandCode::Mdi).text,
            Alarm::IsOff.sentence()
        );
    }
}
