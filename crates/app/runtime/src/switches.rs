//! Switches that an operator changes while a program is being read; a change applies to commands that are
//! read afterwards.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// State of the switches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SwitchState {
    /// Stop after each line that moves.
    pub single_step: bool,
    /// Stop at M1.
    pub optional_stop: bool,
    /// Skip lines that begin with `/`.
    pub block_delete: bool,
    /// Fraction of the axes' speed that rapids may use, 0 to 1.
    pub rapid_override: f64,
}

/// All off; rapids at the axes' full speed.
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

    /// The present state.
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

/// Changed switches in the middle of a program, as one line of a trace.
///
/// A program is read ahead of the machine, so the time of the change does not determine the lines that it
/// applied to. This does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Switched {
    /// The first command of the program, from 0, that was read with this state.
    pub command: u64,
    /// The last line read before.
    pub line: u32,
    /// The state from there on.
    pub state: SwitchState,
}

impl fmt::Display for Switched {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (line, command, state) = (self.line, self.command, &self.state);
        write!(out, "read behind line {line}: command={command}; {state}")
    }
}

impl Switched {
    /// Reads the line back; `None` if this version does not understand it.
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
    /// The state in a line of a trace.
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

/// Names and values in a line of a trace.
pub(crate) fn pairs(text: &str) -> Option<BTreeMap<&str, &str>> {
    text.split("; ").map(|pair| pair.split_once('=')).collect()
}

/// Source of the switches for a program's planner.
#[derive(Debug)]
pub(crate) enum Switching {
    /// The switches do not change.
    Fixed,
    /// As the operator sets them.
    Operated(Arc<Switches>),
    /// As recorded.
    Recorded(VecDeque<Switched>),
}

impl Switching {
    /// The state for the command of this number; `before` is the state for the preceding command.
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
