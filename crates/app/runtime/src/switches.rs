//! What an operator switches while a program is being read: it counts for the commands that are still to be
//! read.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// How the switches stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SwitchState {
    /// Stop after each line that moves.
    pub single_step: bool,
    /// Stop at M1.
    pub optional_stop: bool,
    /// Leave out lines that begin with `/`.
    pub block_delete: bool,
    /// Share of the axes' speed that rapids may use, 0 to 1.
    pub rapid_override: f64,
}

/// All off; rapids as fast as the axes go.
impl Default for SwitchState {
    fn default() -> Self {
        Self {
            single_step: false,
            optional_stop: false,
            block_delete: false,
            rapid_override: 1.0,
        }
    }
}

/// Switches of one program, as the operator sets them.
#[derive(Debug)]
pub(crate) struct Switches {
    single_step: AtomicBool,
    optional_stop: AtomicBool,
    block_delete: AtomicBool,
    rapid_override: AtomicU64,
}

impl Switches {
    pub(crate) fn new(state: &SwitchState) -> Self {
        Self {
            single_step: AtomicBool::new(state.single_step),
            optional_stop: AtomicBool::new(state.optional_stop),
            block_delete: AtomicBool::new(state.block_delete),
            rapid_override: AtomicU64::new(state.rapid_override.to_bits()),
        }
    }

    /// How they stand now.
    pub(crate) fn state(&self) -> SwitchState {
        SwitchState {
            single_step: self.is_single_step(),
            optional_stop: self.optional_stop.load(Ordering::Relaxed),
            block_delete: self.block_delete.load(Ordering::Relaxed),
            rapid_override: f64::from_bits(self.rapid_override.load(Ordering::Relaxed)),
        }
    }

    pub(crate) fn set_single_step(&self, on: bool) {
        self.single_step.store(on, Ordering::Relaxed);
    }

    pub(crate) fn is_single_step(&self) -> bool {
        self.single_step.load(Ordering::Relaxed)
    }

    pub(crate) fn set_optional_stop(&self, on: bool) {
        self.optional_stop.store(on, Ordering::Relaxed);
    }

    pub(crate) fn set_block_delete(&self, on: bool) {
        self.block_delete.store(on, Ordering::Relaxed);
    }

    pub(crate) fn set_rapid_override(&self, ratio: f64) {
        self.rapid_override.store(ratio.to_bits(), Ordering::Relaxed);
    }
}

/// Other switches in the middle of a program, as one line of a trace.
///
/// When the operator switched does not tell which lines it counted for: a program is read ahead of the
/// machine. This does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Switched {
    /// The first command of the program, from 0, that was read with them.
    pub command: u64,
    /// The line that had been read last.
    pub line: u32,
    /// How they stand from there on.
    pub state: SwitchState,
}

impl fmt::Display for Switched {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (line, command, state) = (self.line, self.command, &self.state);
        write!(out, "read behind line {line}: command={command}; {state}")
    }
}

impl Switched {
    /// Reads the line back. `None` if it makes no sense to this version.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let (line, rest) = text.strip_prefix("read behind line ")?.split_once(": ")?;
        let pairs = pairs(rest)?;
        Some(Self {
            command: pairs.get("command")?.parse().ok()?,
            line: line.parse().ok()?,
            state: SwitchState::of(&pairs)?,
        })
    }
}

impl fmt::Display for SwitchState {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "block_delete={}; optional_stop={}; single_step={}; rapid_override={}",
            self.block_delete, self.optional_stop, self.single_step, self.rapid_override
        )
    }
}

impl SwitchState {
    /// Of what a line of a trace says.
    pub(crate) fn of(pairs: &BTreeMap<&str, &str>) -> Option<Self> {
        let switch = |key: &str| pairs.get(key)?.parse::<bool>().ok();
        Some(Self {
            single_step: switch("single_step")?,
            optional_stop: switch("optional_stop")?,
            block_delete: switch("block_delete")?,
            rapid_override: pairs.get("rapid_override")?.parse().ok()?,
        })
    }
}

/// Names and values of a line of a trace.
pub(crate) fn pairs(text: &str) -> Option<BTreeMap<&str, &str>> {
    text.split("; ").map(|pair| pair.split_once('=')).collect()
}

/// Where a program's planner learns how the switches stand.
#[derive(Debug)]
pub(crate) enum Switching {
    /// Nothing is switched.
    Fixed,
    /// As the operator has them.
    Operated(Arc<Switches>),
    /// As they were read.
    Recorded(VecDeque<Switched>),
}

impl Switching {
    /// How they stand before the command of this number is read; `before` is how they stood before the last.
    pub(crate) fn at(&mut self, command: u64, before: SwitchState) -> SwitchState {
        match self {
            Self::Fixed => before,
            Self::Operated(switches) => switches.state(),
            Self::Recorded(changes) => {
                let come = changes
                    .iter()
                    .take_while(|change| change.command <= command)
                    .count();
                changes
                    .drain(..come)
                    .next_back()
                    .map_or(before, |change| change.state)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STATE: SwitchState = SwitchState {
        single_step: true,
        optional_stop: false,
        block_delete: true,
        rapid_override: 0.1 + 0.2,
    };

    #[test]
    fn a_line_reads_back_to_the_same_bits() {
        let switched = Switched {
            command: u64::MAX,
            line: 17,
            state: STATE,
        };
        let text = switched.to_string();
        assert_eq!(Switched::parse(&text), Some(switched), "{text}");
        for broken in [
            "",
            "read behind line 17: command=1",
            "read behind line x: command=1; a=b",
        ] {
            assert_eq!(Switched::parse(broken), None, "{broken}");
        }
        assert_eq!(Switched::parse(&text.replace("true", "perhaps")), None);
    }

    #[test]
    fn what_was_recorded_counts_from_its_command_on() {
        let off = SwitchState {
            single_step: false,
            ..STATE
        };
        let change = |command, state| Switched {
            command,
            line: 0,
            state,
        };
        let mut recorded = Switching::Recorded([change(3, off), change(5, STATE)].into());
        let mut state = STATE;
        let steps: Vec<bool> = (0..7)
            .map(|command| {
                state = recorded.at(command, state);
                state.single_step
            })
            .collect();
        assert_eq!(steps, [true, true, true, false, false, true, true]);
    }
}
