//! Commands and their answers.

use crate::layout::{AXES, payload};

/// Bytes of a command's text: the name of a program, or a block of MDI.
pub const COMMAND_TEXT_BYTES: usize = 1024;

/// Bytes of an answer's sentence.
pub const ANSWER_TEXT_BYTES: usize = 512;

payload! {
    /// A command to the core. A client chooses its number once, at random, and counts its commands from 1: a
    /// command that is not newer than the client's last one has no effect.
    pub struct ControlRequest = "evolvent.ControlRequest.v1" {
        /// The client's number, not 0.
        client: u64,
        /// Number of the command, growing from 1 for each client.
        serial: u64,
        /// The command, a number of the list of commands.
        command: u32,
        /// Bit i set: the command is about axis i.
        axes_mask: u32,
        /// A whole number: line to start from, work coordinate system, tool, mode, or 0 and 1 for off and on.
        index: u32,
        /// Bytes of `text` in use.
        text_length: u32,
        /// A ratio (overrides), a speed in mm/s or degrees/s (jog), or a diameter in mm (tool).
        amount: f64,
        /// A number for each axis: mm, degrees for A B C.
        values: [f64; AXES],
        /// A file name or a block of MDI, UTF-8.
        text: [u8; COMMAND_TEXT_BYTES],
        /// Zero; for later versions.
        reserved: [u64; 8],
    }
}

impl ControlRequest {
    /// Writes the text; returns `false` and writes nothing if it is too long.
    #[must_use]
    pub fn set_text(&mut self, text: &str) -> bool {
        let Some(room) = self.text.get_mut(..text.len()) else {
            return false;
        };
        room.copy_from_slice(text.as_bytes());
        self.text_length = text.len() as u32;
        true
    }

    /// The text; none if its length or its bytes are invalid.
    #[must_use]
    pub fn text(&self) -> Option<&str> {
        let bytes = self.text.get(..self.text_length as usize)?;
        core::str::from_utf8(bytes).ok()
    }
}

payload! {
    /// The core's answer to one command.
    pub struct ControlAnswer = "evolvent.ControlAnswer.v1" {
        /// The client's number, as received.
        client: u64,
        /// The command's number, as received.
        serial: u64,
        /// 0 accepted, 1 rejected, 2 not newer than an earlier command and without effect.
        verdict: u32,
        /// Why it was rejected, a number of the list of alarms; 0 if it was accepted.
        alarm: u32,
        /// The last setpoint computed when the command was evaluated.
        sequence: u64,
        /// Number of the job that the command has started; 0 if none.
        job: u64,
        /// Bytes of `text` in use.
        text_length: u32,
        /// The command that `verdict` refers to, as received.
        command: u32,
        /// The error and its remedy, UTF-8.
        text: [u8; ANSWER_TEXT_BYTES],
        /// Zero; for later versions.
        reserved: [u64; 8],
    }
}

impl ControlAnswer {
    /// Writes the sentence. One that is too long ends after a word, with "...".
    pub fn set_text(&mut self, text: &str) {
        self.text_length = crate::status::put_sentence(&mut self.text, text);
    }

    /// The sentence; empty if there is none or if it is not UTF-8.
    #[must_use]
    pub fn text(&self) -> &str {
        crate::status::get_text(&self.text, self.text_length)
    }
}

/// Names and numbers of an answer's `verdict`.
pub const VERDICTS: [(&str, u32); 3] = [("ACCEPTED", 0), ("REJECTED", 1), ("STALE", 2)];

/// Names and numbers of a request's `command`.
pub const COMMANDS: [(&str, u32); 31] = [
    ("ESTOP", 1),
    ("ESTOP_RESET", 2),
    ("ON", 3),
    ("OFF", 4),
    ("MODE", 5),
    ("LOAD", 6),
    ("START", 7),
    ("HOLD", 8),
    ("RESUME", 9),
    ("STEP", 10),
    ("STOP", 11),
    ("RESET", 12),
    ("SINGLE_STEP", 13),
    ("OPTIONAL_STOP", 14),
    ("BLOCK_DELETE", 15),
    ("FEED_OVERRIDE", 16),
    ("RAPID_OVERRIDE", 17),
    ("SPINDLE_OVERRIDE", 18),
    ("MDI", 19),
    ("JOG", 20),
    ("JOG_KEEP", 21),
    ("JOG_STOP", 22),
    ("HOME", 23),
    ("WORK_OFFSET", 24),
    ("TOUCH_OFF", 25),
    ("TOOL", 26),
    ("CLEAR_ALARMS", 27),
    ("SET_OUTPUT", 28),
    ("HANDWHEEL", 29),
    ("RETURN", 30),
    ("RETRACE", 31),
];

/// Names and numbers of `machine_state` in Status.
pub const MACHINE_STATES: [(&str, u32); 3] = [("ESTOP", 0), ("OFF", 1), ("ON", 2)];

/// Names and numbers of `mode` in Status, and of the command MODE.
pub const MODES: [(&str, u32); 3] = [("AUTO", 0), ("MANUAL", 1), ("MDI", 2)];

/// Names and numbers of `activity` in Status.
pub const ACTIVITIES: [(&str, u32); 5] = [("NONE", 0), ("PROGRAM", 1), ("MDI", 2), ("JOG", 3), ("HOMING", 4)];

/// Names and numbers of `job_result` in Status.
pub const JOB_RESULTS: [(&str, u32); 5] = [
    ("NONE", 0),
    ("DONE", 1),
    ("STOPPED", 2),
    ("FAILED", 3),
    ("FAULT", 4),
];

/// Bits of `switches` in [`Status`](crate::Status).
pub mod switches {
    /// Every block waits for RESUME or STEP.
    pub const SINGLE_STEP: u32 = 1 << 0;
    /// M1 stops.
    pub const OPTIONAL_STOP: u32 = 1 << 1;
    /// Blocks that start with `/` are skipped.
    pub const BLOCK_DELETE: u32 = 1 << 2;
    /// A feed hold is in force.
    pub const HOLD: u32 = 1 << 3;
    /// The emergency-stop chain is open or unknown.
    pub const CHAIN_OPEN: u32 = 1 << 4;
    /// The program waits at rest for an input (M66), or for the speed or angle of a spindle (M3, M19).
    pub const INPUT_WAIT: u32 = 1 << 5;
    /// The probe has no contact. Neither this nor the next bit is set if the state is unknown or there is no
    /// probe.
    pub const PROBE_OPEN: u32 = 1 << 6;
    /// The probe has contact.
    pub const PROBE_TRIPPED: u32 = 1 << 7;
    /// The tool in the spindle is not known, because a tool change was broken off: `tool` is the one before it. M61 by MDI names
    /// the tool.
    pub const TOOL_UNKNOWN: u32 = 1 << 8;
}

/// Names and bits of `switches` in Status.
pub const SWITCHES: [(&str, u32); 9] = [
    ("SINGLE_STEP", switches::SINGLE_STEP),
    ("OPTIONAL_STOP", switches::OPTIONAL_STOP),
    ("BLOCK_DELETE", switches::BLOCK_DELETE),
    ("HOLD", switches::HOLD),
    ("CHAIN_OPEN", switches::CHAIN_OPEN),
    ("INPUT_WAIT", switches::INPUT_WAIT),
    ("PROBE_OPEN", switches::PROBE_OPEN),
    ("PROBE_TRIPPED", switches::PROBE_TRIPPED),
    ("TOOL_UNKNOWN", switches::TOOL_UNKNOWN),
];
