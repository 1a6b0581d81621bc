//! Messages to a page.

use serde::Serialize;
use ts_rs::TS;

use super::{
    Lease, LogEntry, MachineInfo, MacroButton, ProgramInfo, Refusal, ScreenStatus, SignalValues, ToolEntry,
    WorkOffset,
};

/// A text message to a page. Binary ones are samples ([`put_sample`](super::put_sample)).
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ToPage {
    /// First of all on a connection.
    Machine {
        /// The machine.
        machine: Box<MachineInfo>,
        /// Version of the server.
        version: String,
    },
    /// The latest status, up to 60 a second.
    Status {
        /// The status.
        status: Box<ScreenStatus>,
    },
    /// The latest values of inputs and outputs, up to 10 a second; only if the machine has any.
    Signals(SignalValues),
    /// Whether a status comes.
    Core {
        /// False while none comes.
        alive: bool,
    },
    /// Who may command.
    Lease(Lease),
    /// The program that pages have loaded.
    Program {
        /// None before the first.
        program: Option<ProgramInfo>,
    },
    /// Offsets and tools as they are kept.
    Kept {
        /// All nine systems.
        offsets: Vec<WorkOffset>,
        /// The table.
        tools: Vec<ToolEntry>,
    },
    /// Buttons with blocks of MDI, from the file of macros.
    Macros {
        /// In the order of the file.
        macros: Vec<MacroButton>,
        /// Why there are none: what is wrong with the file, and where.
        problem: Option<String>,
    },
    /// Answer to a command.
    Answer {
        /// Of the command.
        #[ts(type = "number")]
        id: u64,
        /// Whether it takes effect.
        accepted: bool,
        /// Number of the alarm where it does not.
        alarm: u32,
        /// What was wrong and what to do.
        text: String,
        /// Why the server itself refused it, where it has a name for that.
        refusal: Option<Refusal>,
    },
    /// New entries of the log; on connecting those that are kept.
    Log {
        /// The oldest first.
        entries: Vec<LogEntry>,
    },
    /// The last message: there is nothing more to be shown, and the address is not valid any more.
    End {
        /// Of what.
        what: EndOf,
    },
}

/// What has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, TS)]
#[serde(rename_all = "snake_case")]
pub enum EndOf {
    /// The run of a program.
    Run,
    /// The service.
    Service,
}
