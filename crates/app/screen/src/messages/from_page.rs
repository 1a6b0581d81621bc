//! Messages of a page.

use std::collections::BTreeMap;

use serde::Deserialize;
use ts_rs::TS;

/// A message of a page.
#[derive(Clone, Debug, PartialEq, Deserialize, TS)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum FromPage {
    /// A command to the core.
    Command(CommandMessage),
    /// The operator still holds the jog.
    Keep,
    /// The page receives what the server sends, and still runs. Every page that has the lease sends it.
    Alive,
    /// Asks for the lease.
    Take {
        /// Takes it from a page that has it.
        #[serde(default)]
        force: bool,
    },
    /// Gives the lease back.
    Give,
}

/// A command by the numbers and units of the bus (`docs/contract.md`, Operating).
#[derive(Clone, Debug, PartialEq, Deserialize, TS)]
pub struct CommandMessage {
    /// Grows with every command of a connection; one that is not above the last has no effect.
    #[ts(type = "number")]
    pub id: u64,
    /// Number of the command.
    pub command: u32,
    /// `time_ns` of the newest status that the page had received when the operator pressed. Commands that do
    /// not stop are refused where that is too old: what the operator saw is past.
    #[serde(default)]
    #[ts(type = "number")]
    pub seen_ns: u64,
    /// A JOG that changes the one in motion: it is refused where none moves any more.
    #[serde(default)]
    pub steers: bool,
    /// Bit i: axis i of XYZABCUVW.
    #[serde(default)]
    pub axes_mask: u32,
    /// Line, coordinate system, tool, mode, or 0 and 1.
    #[serde(default)]
    pub index: u32,
    /// Ratio, speed in mm/s or degrees/s, diameter in mm, value of an output.
    #[serde(default)]
    pub amount: f64,
    /// A number by index of the axis (`"0"` X to `"8"` W): mm, degrees.
    #[serde(default)]
    pub values: BTreeMap<String, f64>,
    /// Name of a program, of an output, or a block of MDI.
    #[serde(default)]
    pub text: String,
}
