//! Options and actions of `evolvent ctl`.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

/// Options of `evolvent ctl`.
#[derive(Debug, Args)]
pub(crate) struct CtlArgs {
    /// The machine's name. Default: the one that is served on this computer, if it is only one.
    #[arg(long, value_name = "NAME", global = true)]
    pub(crate) machine_name: Option<String>,
    /// Prefix of the bus's files, as the core has it.
    #[arg(long, value_name = "PREFIX", global = true)]
    pub(crate) bus_prefix: Option<String>,
    /// Print one JSON object.
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// How long to wait for a core that is not up yet, s.
    #[arg(long, value_name = "S", default_value_t = 1.0, global = true)]
    pub(crate) patience: f64,
    #[command(subcommand)]
    pub(crate) action: Action,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Switch {
    On,
    Off,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ModeArg {
    Auto,
    Manual,
    Mdi,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Action {
    /// What the machine is doing.
    Status,
    /// Every axis stops by itself, the drives lose power.
    Estop,
    /// Leave the emergency stop.
    EstopReset,
    /// Enable the drives; waits until they are.
    On,
    /// Take power from the drives.
    Off,
    /// Out of the emergency stop and on, in one.
    Up,
    /// Change the mode. Commands that need one change it by themselves.
    Mode {
        /// The mode.
        mode: ModeArg,
    },
    /// Load a program.
    Load {
        /// The program's file.
        program: PathBuf,
    },
    /// Start the loaded program, and say which it is.
    Start {
        /// The program that is meant: another one that is loaded is not started. Needed after a `load` that was rejected.
        program: Option<PathBuf>,
        /// Begin at this line; the machine shows the way there and waits for `resume`.
        #[arg(long, value_name = "N")]
        line: Option<u32>,
        /// Wait for its end.
        #[arg(long)]
        wait: bool,
    },
    /// Hold the feed.
    Hold,
    /// Go on after a hold or a program stop.
    Resume,
    /// Say that the tool that the machine waits for is in the spindle, and go on. Nothing else is resumed by it.
    Loaded {
        /// The tool, 0 for none; refused if the machine waits for another one.
        tool: Option<u32>,
    },
    /// Run one block.
    Step,
    /// Stop within the limits and end the job.
    Stop,
    /// Clear the alarms and forget modes.
    Reset,
    /// Clear the alarms.
    Clear,
    /// Set an output of the machine file by hand: `ctl set clamp on`, `ctl set laser 4.5`. Not while a program runs.
    Set {
        /// Its name.
        output: String,
        /// on, off, or the value of an analog one.
        #[arg(value_parser = output_value, allow_negative_numbers = true)]
        value: f64,
    },
    /// Stop after each block.
    SingleStep {
        /// on or off.
        state: Switch,
    },
    /// Stop at M1; in a running program in lines that are not read yet.
    OptionalStop {
        /// on or off.
        state: Switch,
    },
    /// Leave out lines that begin with `/`; in a running program those that are not read yet.
    BlockDelete {
        /// on or off.
        state: Switch,
    },
    /// Feed override, 0 to 200 percent.
    Override {
        /// Percent.
        percent: f64,
    },
    /// Rapid override, 0 to 100 percent; in a running program for lines that are not read yet.
    Rapid {
        /// Percent.
        percent: f64,
    },
    /// Spindle override, 10 to 200 percent.
    Spindle {
        /// Percent.
        percent: f64,
    },
    /// Execute one block and wait for its end; Ctrl-C stops it. At a program stop (M0) it waits no longer.
    Mdi {
        /// The block.
        block: String,
        /// Do not wait.
        #[arg(long)]
        no_wait: bool,
    },
    /// Move by hand: `jog X+` as long as this command runs, `jog X+ Y- --distance 5` by an increment.
    Jog {
        /// Axes with their directions.
        #[arg(required = true, value_name = "AXIS+|AXIS-")]
        axes: Vec<String>,
        /// By so much each, mm or degrees.
        #[arg(long, value_name = "MM")]
        distance: Option<f64>,
        /// Each at so much at the most, mm/min or degrees/min. Default: a fifth of what the axis can.
        #[arg(long, value_name = "MM_MIN")]
        speed: Option<f64>,
        /// A jog without a distance ends after so long; else with Ctrl-C.
        #[arg(long, value_name = "S")]
        seconds: Option<f64>,
    },
    /// End a jog.
    JogStop,
    /// Let the handwheel move an axis, in manual mode: `handwheel X --step 0.01`; without an axis it moves none.
    Handwheel {
        /// Letter of the axis.
        axis: Option<String>,
        /// Way a detent, mm or degrees. Default: the first step of the machine file.
        #[arg(long, value_name = "MM", requires = "axis")]
        step: Option<f64>,
    },
    /// Home axes, all if none is named, and wait for the end.
    Home {
        /// Letters, as in XYZ.
        axes: Option<String>,
    },
    /// Set a work offset: `offset G54 X10 Y-5`, machine coordinates.
    Offset {
        /// G54 to G59.3.
        system: String,
        /// Axes with values.
        #[arg(required = true, value_name = "AXIS VALUE")]
        values: Vec<String>,
    },
    /// Set the work offset so that the present position reads these values: `touch-off X0 Y0`.
    TouchOff {
        /// Axes with values.
        #[arg(required = true, value_name = "AXIS VALUE")]
        values: Vec<String>,
        /// G54 to G59.3. Default: the active one.
        #[arg(long)]
        system: Option<String>,
    },
    /// Set a tool's offsets and diameter: `tool 7 Z120.5 --diameter 6`.
    Tool {
        /// Its number.
        number: u32,
        /// Axes with offsets.
        #[arg(value_name = "AXIS VALUE")]
        values: Vec<String>,
        /// Diameter, mm.
        #[arg(long, value_name = "MM")]
        diameter: Option<f64>,
    },
    /// Read the tool table again.
    ReloadTools,
}

/// The value of an output from its word.
fn output_value(word: &str) -> Result<f64, String> {
    match word {
        "on" => Ok(1.0),
        "off" => Ok(0.0),
        number => number
            .parse()
            .ok()
            .filter(|value: &f64| value.is_finite())
            .ok_or_else(|| "it must be on, off or a number".to_owned()),
    }
}
