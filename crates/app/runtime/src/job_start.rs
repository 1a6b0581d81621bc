//! The start of a served machine's job, as one line of a trace.
//!
//! This line, the attachments that it names, and the recorded inputs of each cycle are sufficient to
//! recompute the job's setpoints. Numbers are written so that they read back to the same bits.

use std::fmt;

use evolvent_gcode::{MdiPreamble, Outputs, SpindleDirection, SpindleOutput};
use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, SurfaceSpeed};
use evolvent_transfer::{AxesState, Sync, Transfer, TransferError};

use crate::switches::{SwitchState, pairs};

/// A program or a block of MDI.
#[derive(Clone, Debug, PartialEq)]
pub struct ProgramStart {
    /// Whether it is a block of MDI.
    pub is_mdi: bool,
    /// The state with which a block of MDI begins; empty in traces of versions that did not keep the spindle.
    pub restored: MdiPreamble,
    /// Name of the attachment with the text.
    pub program: String,
    /// Name of the attachment with the tool table, if any.
    pub tools: Option<String>,
    /// Name of the attachment with the kept parameters, if any.
    pub parameters: Option<String>,
    /// Prefix of the names of attached subroutine files.
    pub subroutines: String,
    /// Position of the machine, machine coordinates.
    pub position: Axes,
    /// The tool in the spindle.
    pub tool: u32,
    /// The tool selected for the next M6; `None` in traces of versions that did not keep it.
    pub selected_tool: Option<u32>,
    /// Spindle and coolant at the start; `None` in traces of versions that began with all off.
    pub outputs: Option<Outputs>,
    /// The line at which it began; 0 for the first.
    pub start_line: u32,
    /// The switches when its first line was read.
    pub switches: SwitchState,
    /// The feed override that it was planned for.
    pub feed_override: f64,
    /// Numbers of its first block and action.
    pub numbered_from: (u32, u32),
}

/// A jog, a change of one, or a move of homing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SteeredStart {
    /// Whether it replaces a motion in progress.
    pub is_turn: bool,
    /// Limits of velocity and travel with which it was solved; those of acceleration and jerk are the
    /// machine's.
    pub velocity: Axes,
    /// Lower limits of travel.
    pub travel_min: Axes,
    /// Upper limits of travel.
    pub travel_max: Axes,
    /// State of the axes at its start.
    pub from: AxesState,
    /// Positions at its end.
    pub to: Axes,
    /// If given, each axis moves independently, slows down to this speed at once, and keeps it. Otherwise all
    /// axes arrive at the same time.
    pub cruise: Option<Axes>,
}

/// The source of motion from here on.
#[derive(Clone, Debug, PartialEq)]
pub enum JobStart {
    /// A plan.
    Program(Box<ProgramStart>),
    /// A transfer from state to state.
    Steered(Box<SteeredStart>),
    /// The path of the held program, backwards.
    Retrace {
        /// Number of block starts to pass; 0 drives forwards to the position at which the program is held.
        back: u32,
    },
}

impl SteeredStart {
    /// The limits with which it was solved, on a machine with these limits.
    #[must_use]
    pub fn limits(&self, machine: &Limits) -> Limits {
        Limits {
            velocity: self.velocity,
            travel_min: self.travel_min,
            travel_max: self.travel_max,
            ..*machine
        }
    }

    /// Solves the motion, on a machine with these limits.
    ///
    /// # Errors
    /// There is no motion within the limits.
    pub fn solve(&self, machine: &Limits) -> Result<Transfer, TransferError> {
        let limits = self.limits(machine);
        match &self.cruise {
            Some(cruise) => Transfer::solve_slowing(&limits, cruise, &self.from, &self.to),
            None => Transfer::solve(&limits, &self.from, &AxesState::at_rest(self.to), Sync::Time),
        }
    }
}

impl fmt::Display for JobStart {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Program(start) => {
                let what = if start.is_mdi { "mdi" } else { "program" };
                write!(out, "{what}: text={}", start.program)?;
                if let Some(tools) = &start.tools {
                    write!(out, "; tools={tools}")?;
                }
                if let Some(parameters) = &start.parameters {
                    write!(out, "; parameters={parameters}")?;
                }
                let (blocks, actions) = start.numbered_from;
                write!(
                    out,
                    "; subroutines={}; place={}; tool={}; line={}; {}; feed_override={}; blocks={blocks}; \
                     actions={actions}",
                    start.subroutines,
                    list(&start.position),
                    start.tool,
                    start.start_line,
                    start.switches,
                    start.feed_override,
                )?;
                if start.restored != MdiPreamble::default() {
                    let MdiPreamble {
                        lines,
                        active_spindle,
                    } = start.restored;
                    write!(out, "; restored_lines={lines}; active_spindle={active_spindle}")?;
                }
                if let Some(tool) = start.selected_tool {
                    write!(out, "; selected={tool}")?;
                }
                if let Some(outputs) = &start.outputs {
                    for (number, spindle) in outputs.spindles.iter().enumerate() {
                        if number == 0 || *spindle != SpindleOutput::default() {
                            write_spindle(out, spindle, &suffix(number))?;
                        }
                    }
                    write!(out, "; mist={}; flood={}", outputs.mist, outputs.flood)?;
                }
                Ok(())
            }
            Self::Retrace { back } => write!(out, "retrace: back={back}"),
            Self::Steered(start) => {
                let what = if start.is_turn { "turn" } else { "steered" };
                write!(
                    out,
                    "{what}: to={}; from={}; from_velocity={}; from_acceleration={}; velocity={}; \
                     travel_min={}; travel_max={}",
                    list(&start.to),
                    list(&start.from.position),
                    list(&start.from.velocity),
                    list(&start.from.acceleration),
                    list(&start.velocity),
                    list(&start.travel_min),
                    list(&start.travel_max),
                )?;
                if let Some(cruise) = &start.cruise {
                    write!(out, "; cruise={}", list(cruise))?;
                }
                Ok(())
            }
        }
    }
}

/// The nine axes without trailing zeros.
fn list(axes: &Axes) -> String {
    let zero = |value: &f64| value.to_bits() == 0;
    let last = axes
        .iter()
        .rposition(|value| !zero(value))
        .map_or(0, |last| last + 1);
    let texts: Vec<String> = axes.iter().take(last).map(f64::to_string).collect();
    texts.join(",")
}

fn axes(text: &str) -> Option<Axes> {
    let mut axes = Axes::zeros();
    if text.is_empty() {
        return Some(axes);
    }
    for (i, value) in text.split(',').enumerate() {
        if i >= AXES {
            return None;
        }
        axes[i] = value.parse().ok()?;
    }
    Some(axes)
}

impl JobStart {
    /// Reads the line back; `None` if this version does not understand it.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let (what, rest) = text.split_once(": ")?;
        let pairs = pairs(rest)?;
        let get = |key: &str| pairs.get(key).copied();
        let whole = |key: &str| get(key)?.parse::<u32>().ok();
        let number = |key: &str| get(key)?.parse::<f64>().ok();
        let nine = |key: &str| axes(get(key)?);
        match what {
            "program" | "mdi" => Some(Self::Program(Box::new(ProgramStart {
                is_mdi: what == "mdi",
                restored: MdiPreamble {
                    lines: whole("restored_lines").unwrap_or(0),
                    active_spindle: whole("active_spindle").unwrap_or(0),
                },
                program: get("text")?.to_owned(),
                tools: get("tools").map(str::to_owned),
                parameters: get("parameters").map(str::to_owned),
                subroutines: get("subroutines")?.to_owned(),
                position: nine("place")?,
                tool: whole("tool")?,
                selected_tool: whole("selected"),
                outputs: match get("spindle") {
                    None => None,
                    Some(_) => {
                        let mut outputs = Outputs {
                            mist: get("mist")?.parse().ok()?,
                            flood: get("flood")?.parse().ok()?,
                            ..Outputs::default()
                        };
                        for (number, spindle) in outputs.spindles.iter_mut().enumerate() {
                            let suffix = suffix(number);
                            if get(&format!("spindle{suffix}")).is_some() {
                                *spindle = read_spindle(&get, &suffix)?;
                            }
                        }
                        Some(outputs)
                    }
                },
                start_line: whole("line")?,
                switches: SwitchState::of(&pairs)?,
                feed_override: number("feed_override")?,
                numbered_from: (whole("blocks")?, whole("actions")?),
            }))),
            "steered" | "turn" => Some(Self::Steered(Box::new(SteeredStart {
                is_turn: what == "turn",
                velocity: nine("velocity")?,
                travel_min: nine("travel_min")?,
                travel_max: nine("travel_max")?,
                from: AxesState {
                    position: nine("from")?,
                    velocity: nine("from_velocity")?,
                    acceleration: nine("from_acceleration")?,
                },
                to: nine("to")?,
                cruise: match get("cruise") {
                    None => None,
                    Some(text) => Some(axes(text)?),
                },
            }))),
            "retrace" => Some(Self::Retrace { back: whole("back")? }),
            _ => None,
        }
    }
}

/// A name that fits into a line, without characters that separate parts.
pub(crate) fn plain_name(name: &str) -> String {
    name.chars()
        .map(|letter| match letter {
            ';' | '=' | '/' | '\\' => '_',
            letter if letter.is_control() => '_',
            letter => letter,
        })
        .collect()
}

/// Suffix of the keys of a spindle; empty for spindle 0.
fn suffix(number: usize) -> String {
    match number {
        0 => String::new(),
        _ => number.to_string(),
    }
}

fn write_spindle(out: &mut fmt::Formatter<'_>, spindle: &SpindleOutput, suffix: &str) -> fmt::Result {
    let direction = match spindle.direction {
        SpindleDirection::Stopped => 5,
        SpindleDirection::Clockwise => 3,
        SpindleDirection::CounterClockwise => 4,
    };
    write!(
        out,
        "; spindle{suffix}=M{direction}; speed_rpm{suffix}={}",
        spindle.speed_rpm
    )?;
    let Some(surface) = &spindle.surface else {
        return Ok(());
    };
    write!(
        out,
        "; surface_m_min{suffix}={}; surface_max_rpm{suffix}={}; surface_centre{suffix}={}",
        surface.speed_m_min, surface.max_rpm, surface.centre_mm
    )
}

fn read_spindle<'a>(get: &impl Fn(&str) -> Option<&'a str>, suffix: &str) -> Option<SpindleOutput> {
    let number = |key: &str| get(&format!("{key}{suffix}"))?.parse::<f64>().ok();
    Some(SpindleOutput {
        direction: match get(&format!("spindle{suffix}"))? {
            "M3" => SpindleDirection::Clockwise,
            "M4" => SpindleDirection::CounterClockwise,
            "M5" => SpindleDirection::Stopped,
            _ => return None,
        },
        speed_rpm: number("speed_rpm")?,
        surface: match get(&format!("surface_m_min{suffix}")) {
            None => None,
            Some(_) => Some(SurfaceSpeed {
                speed_m_min: number("surface_m_min")?,
                max_rpm: number("surface_max_rpm")?,
                centre_mm: number("surface_centre")?,
            }),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_reads_back_to_the_same_bits() {
        let odd = Axes::from_fn(|i, _| match i {
            0 => 0.1 + 0.2,
            1 => -1.0 / 3.0,
            2 => 5e-324,
            3 => f64::INFINITY,
            4 => -0.0,
            _ => 0.0,
        });
        let program = JobStart::Program(Box::new(ProgramStart {
            is_mdi: true,
            restored: MdiPreamble {
                lines: 5,
                active_spindle: 2,
            },
            program: format!("job-7/{}", plain_name("odd; name=1/2\n.ngc")),
            tools: None,
            parameters: Some("job-3/parameters.var".to_owned()),
            subroutines: "job-7/subroutines/".to_owned(),
            position: odd,
            tool: 12,
            selected_tool: Some(5),
            outputs: Some(Outputs {
                spindles: [
                    SpindleOutput {
                        direction: SpindleDirection::CounterClockwise,
                        speed_rpm: 0.1 + 0.2,
                        surface: Some(SurfaceSpeed {
                            speed_m_min: 0.7 + 0.1,
                            max_rpm: f64::INFINITY,
                            centre_mm: -1.0 / 3.0,
                        }),
                    },
                    SpindleOutput::default(),
                    SpindleOutput {
                        direction: SpindleDirection::Clockwise,
                        speed_rpm: 1.0 / 7.0,
                        surface: None,
                    },
                    SpindleOutput::default(),
                ],
                mist: true,
                flood: false,
            }),
            start_line: 0,
            switches: SwitchState {
                block_delete: true,
                optional_stop: false,
                single_step: true,
                rapid_override: 0.1 + 0.7,
            },
            feed_override: 1.2,
            numbered_from: (4_000_000_000, 3),
        }));
        let steered = JobStart::Steered(Box::new(SteeredStart {
            is_turn: true,
            velocity: odd,
            travel_min: -odd,
            travel_max: odd,
            from: AxesState {
                position: odd * 2.0,
                velocity: odd,
                acceleration: Axes::zeros(),
            },
            to: Axes::repeat(1e300),
            cruise: Some(odd),
        }));
        for start in [program, steered, JobStart::Retrace { back: 12 }] {
            let text = start.to_string();
            let again = JobStart::parse(&text).expect("a line of this version");
            // Compares the representation, since -0 and 0 are equal but not the same.
            assert_eq!(format!("{again:?}"), format!("{start:?}"), "{text}");
        }
    }

    #[test]
    fn what_is_no_line_is_refused() {
        for text in [
            "",
            "program",
            "program: ",
            "turn: to=1",
            "steered: to=1,x",
            "mdi: text",
            "a: b=c",
        ] {
            assert_eq!(JobStart::parse(text), None, "{text:?}");
        }
        let many = (0..10).map(|n| n.to_string()).collect::<Vec<_>>().join(",");
        assert_eq!(axes(&many), None);
    }
}
