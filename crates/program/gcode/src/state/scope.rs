//! The data visible to an expression: parameters and, through the predefined ones, the modal state.

use crate::Settings;
use crate::parameters::names::{NameKind, NormalizedName};
use crate::parameters::system::System;
use crate::parameters::values::{POSITION, Parameters};
use crate::state::machine_state::State;

/// The context of a line.
pub(crate) struct Scope<'a> {
    pub(crate) parameters: &'a Parameters,
    pub(crate) state: &'a State,
    pub(crate) settings: &'a Settings,
    /// The line number.
    pub(crate) line: u32,
}

impl Scope<'_> {
    /// A numbered parameter in the unit that programs read it in.
    #[inline]
    pub(crate) fn numbered(&self, index: usize) -> f64 {
        self.stored(index) / self.settings.parameter_mm(index)
    }

    /// A numbered parameter, lengths of offsets in mm.
    #[inline]
    pub(crate) fn stored(&self, index: usize) -> f64 {
        if let Some(assumption) = &self.parameters.assumption {
            assumption.read_numbered(index);
        }
        if (POSITION..=POSITION + 8).contains(&index) {
            return self.state.program_position(index - POSITION);
        }
        let value = self.parameters.numbered(index);
        if value == 0.0 {
            self.parameters.foreign_reads.read(index);
        }
        value
    }

    /// A named parameter; `None` if not set.
    pub(crate) fn named(&self, name: &NormalizedName) -> Option<f64> {
        let (id, kind) = self.parameters.names.find(name)?;
        if let Some(assumption) = &self.parameters.assumption {
            assumption.read_named(id, kind);
        }
        match kind {
            NameKind::System(system) => Some(self.system(system)),
            _ => self.parameters.named(id, kind),
        }
    }

    fn system(&self, system: System) -> f64 {
        if let Some(axis) = system.axis() {
            return self.state.program_position(axis);
        }
        if let Some(axis) = system.machine_axis() {
            return self.state.machine_position(axis);
        }
        match system {
            System::Line => f64::from(self.line),
            System::CallLevel => self.parameters.depth() as f64,
            System::Value => self.parameters.returned.unwrap_or(0.0),
            System::ValueReturned => f64::from(u8::from(self.parameters.returned.is_some())),
            other => self.state.system(other),
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Runs a function in the scope of the first line of a program.
    pub(crate) fn with_scope<T>(run: impl FnOnce(&Scope<'_>) -> T) -> T {
        let settings = Settings::default();
        let parameters = Parameters::new();
        let state = State::new(&settings);
        run(&Scope {
            parameters: &parameters,
            state: &state,
            settings: &settings,
            line: 1,
        })
    }
}
