//! Options and actions of `evolvent ctl`.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

/// Options of `evolvent ctl`.
#[derive(Debug, Args)]
pub(crate) struct CtlArgs {
    /// The machine's name. Default: the one served on this computer, if there is only one.
    #[arg(long, value_name = "NAME", global = true)]
    pub(crate) machine_name: Option<String>,
    /// Prefix of the bus's files, as for the core.
    #[arg(long, value_name = "PREFIX", global = true)]
    pub(crate) bus_prefix: Option<String>,
    /// Print one JSON object.
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// Time to wait for a core that has not started yet, in s.
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
    /// Show what the machine is doing.
    Status,
    /// Show inputs, outputs, switches of the axes and spindles; an input that no bridge sends is unknown.
    Io {
        /// Machine file, for the names and for the inputs that no bridge sends. Default: the signals that are
        /// sent, by number.
        #[arg(long, value_name = "FILE")]
        machine: Option<PathBuf>,
    },
    /// Emergency stop: every axis stops on its own, the drives lose power.
    Estop,
    /// Leave the emergency stop.
    EstopReset,
    /// Enable the drives and wait until they are enabled.
    On,
    /// Disable the drives.
    Off,
    /// Leave the emergency stop and switch on.
    Up,
    /// Change the mode. Commands that need a mode change it themselves.
    Mode {
        /// The mode.
        mode: ModeArg,
    },
    /// Load a program.
    Load {
        /// The program's file.
        program: PathBuf,
    },
    /// Start the loaded program, and print its name.
    Start {
        /// The intended program: another loaded program is not started. Required after a rejected `load`.
        program: Option<PathBuf>,
        /// Start at this line; the machine shows the approach and waits for `resume`.
        #[arg(long, value_name = "N")]
        line: Option<u32>,
        /// Wait for the end of the program.
        #[arg(long)]
        wait: bool,
    },
    /// Hold the feed.
    Hold,
    /// Continue after a hold or a program stop.
    Resume,
    /// Confirm that the tool that the machine waits for is in the spindle, and continue. Resumes nothing
    /// else.
    Loaded {
        /// The tool, 0 for none; rejected if the machine waits for another one.
        tool: Option<u32>,
    },
    /// Run one block.
    Step,
    /// Stop within the limits and end the job.
    Stop,
    /// Clear the alarms and reset the modes.
    Reset,
    /// Clear the alarms.
    Clear,
    /// Set an output of the machine file by hand: `ctl set clamp on`, `ctl set laser 4.5`. Not while a
    /// program runs.
    Set {
        /// Name of the output.
        output: String,
        /// on, off, or the value of an analog output.
        #[arg(value_parser = output_value, allow_negative_numbers = true)]
        value: f64,
    },
    /// Stop after each block.
    SingleStep {
        /// on or off.
        state: Switch,
    },
    /// Stop at M1; in a running program at lines that have not been read yet.
    OptionalStop {
        /// on or off.
        state: Switch,
    },
    /// Skip lines that start with `/`; in a running program lines that have not been read yet.
    BlockDelete {
        /// on or off.
        state: Switch,
    },
    /// Set the feed override, 0 to 200 percent.
    Override {
        /// Feed override, in percent.
        percent: f64,
    },
    /// Set the rapid override, 0 to 100 percent; in a running program for lines that have not been read yet.
    Rapid {
        /// Rapid override, in percent.
        percent: f64,
    },
    /// Set the spindle override, 10 to 200 percent.
    Spindle {
        /// Spindle override, in percent.
        percent: f64,
    },
    /// Execute one block and wait for its end; Ctrl-C stops it. The wait ends at a program stop (M0).
    Mdi {
        /// The block, quoted or as its words: `mdi G1 X50`. Quote comments, expressions and `$`, which the
        /// shell reads.
        #[arg(required = true, value_name = "BLOCK")]
        block: Vec<String>,
        /// Do not wait.
        #[arg(long)]
        no_wait: bool,
    },
    /// Jog, also while a program is held: `jog X+` as long as this command runs, `jog X+ Y- --distance 5` by
    /// an increment.
    Jog {
        /// Axes with their directions.
        #[arg(required = true, value_name = "AXIS+|AXIS-")]
        axes: Vec<String>,
        /// Distance of each axis, in mm or degrees.
        #[arg(long, value_name = "MM")]
        distance: Option<f64>,
        /// Maximum speed of each axis, mm/min or degrees/min. Default: a fifth of the axis's maximum.
        #[arg(long, value_name = "MM_MIN")]
        speed: Option<f64>,
        /// Duration of a jog without a distance, in s. Default: until Ctrl-C.
        #[arg(long, value_name = "S")]
        seconds: Option<f64>,
    },
    /// Return to the position at which the held program was left, jog by jog and then forwards along the
    /// path. `resume` then continues the program.
    Return {
        /// Maximum speed of reversed jogs, mm/min or degrees/min. Default: a fifth of the axis velocity.
        #[arg(long, value_name = "MM_MIN")]
        speed: Option<f64>,
    },
    /// Retrace the path of the held program to the start of its block, or of an earlier one.
    Retrace {
        /// Number of block starts; 1 is the start of the present block.
        #[arg(default_value_t = 1)]
        blocks: u32,
    },
    /// End a jog, a `return` or a `retrace`.
    JogStop,
    /// Assign the handwheel to an axis, in manual mode: `handwheel X --step 0.01`; without an axis, remove
    /// the assignment.
    Handwheel {
        /// Letter of the axis.
        axis: Option<String>,
        /// Distance per detent, in mm or degrees. Default: the first step of the machine file.
        #[arg(long, value_name = "MM", requires = "axis")]
        step: Option<f64>,
    },
    /// Home axes, or all if none is given, and wait for the end.
    ///
    /// Axes without `[[homing]]` that have lost machine zero are declared to be at their home position: jog
    /// them there first.
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
    /// Set the work offset so that the current position has these coordinates: `touch-off X0 Y0`.
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
        /// Number of the tool.
        number: u32,
        /// Axes with offsets.
        #[arg(value_name = "AXIS VALUE")]
        values: Vec<String>,
        /// Diameter, in mm.
        #[arg(long, value_name = "MM")]
        diameter: Option<f64>,
    },
    /// Reload the tool table.
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
            .ok_or_else(|| "give on, off or a number".to_owned()),
    }
}
