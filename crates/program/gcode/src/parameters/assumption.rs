//! Values that depend on the assumed result of a probing move: parameters, the position, offsets, branches.
//!
//! A check has no machine, so it assumes that every probing move makes contact at its end. An error that
//! follows from the assumption is not an error of the program. Values are traced by lines: all parameters
//! that a line sets depend on the result if the line reads one that does, or if it is in a branch that does.

use std::cell::Cell;
use std::collections::BTreeSet;
use std::sync::Arc;

use evolvent_path::AXES;

use crate::Code;
use crate::parameters::names::{NameId, NameKind};
use crate::parameters::values::{
    G92, HOME_G28, INPUT_RESULT, LOCAL_NUMBERED, POSITION, PROBE_TRIPPED, PROBED,
};

/// Parameters that depend on the result.
#[derive(Clone, Debug, Default)]
struct Dependents {
    numbered: BTreeSet<usize>,
    named: BTreeSet<NameId>,
}

/// Values that depend on the assumed results.
#[derive(Debug, Default)]
pub(crate) struct Assumption {
    /// Parameters #31 and up, global names.
    global: Dependents,
    /// Parameters of the active subroutine.
    local: Dependents,
    /// Parameters of the calling subroutines.
    outer: Vec<Dependents>,
    /// The value that the last subroutine returned.
    returned: bool,
    /// Whether the present line has read one of them.
    values_depend: Cell<bool>,
    /// Whether the present line is in a branch that depends on the result.
    pub(crate) is_in_branch: bool,
    /// Whether any condition so far depended on it: from then on it is uncertain which lines are executed.
    pub(crate) has_branched: bool,
    /// File and line of each M2 and M30 that was skipped because it depends on the result.
    pub(crate) skipped_ends: BTreeSet<(Option<Arc<str>>, u32)>,
    /// Number of further times that one was skipped: a maximum ends loops.
    pub(crate) repeated_skips: u32,
    /// The position along each axis.
    pub(crate) position: [bool; AXES],
    /// The positions of G28 and G30.
    pub(crate) home: bool,
    /// Work offset, G92 or tool length along each axis.
    pub(crate) offset: [bool; AXES],
    /// The target of the present line along each axis.
    pub(crate) target: [bool; AXES],
}

impl Assumption {
    pub(crate) fn begin_line(&self) {
        self.values_depend.set(false);
    }

    /// Whether the values of the present line depend on the result.
    pub(crate) fn values_depend(&self) -> bool {
        self.values_depend.get()
    }

    /// Whether the effect of the present line depends on the result.
    pub(crate) fn line_depends(&self) -> bool {
        self.values_depend() || self.is_in_branch
    }

    /// Records that an expression reads a numbered parameter.
    #[cold]
    pub(crate) fn read_numbered(&self, index: usize) {
        let depends = match index {
            PROBED..=PROBE_TRIPPED => true,
            POSITION..=5428 => {
                let axis = index - POSITION;
                self.position[axis] || self.offset[axis]
            }
            HOME_G28..G92 if self.home => true,
            G92..INPUT_RESULT => self.offset.contains(&true) || self.global.numbered.contains(&index),
            1..=LOCAL_NUMBERED => self.local.numbered.contains(&index),
            _ => self.global.numbered.contains(&index),
        };
        self.values_depend.set(self.values_depend() || depends);
    }

    #[cold]
    pub(crate) fn read_named(&self, id: NameId, kind: NameKind) {
        let depends = match kind {
            NameKind::Global => self.global.named.contains(&id),
            NameKind::Local => self.local.named.contains(&id),
            NameKind::System(system) => match (system.axis(), system.machine_axis()) {
                (Some(axis), _) => self.position[axis] || self.offset[axis],
                (_, Some(axis)) => self.position[axis],
                _ => system == crate::parameters::system::System::Value && self.returned,
            },
        };
        self.values_depend.set(self.values_depend() || depends);
    }

    /// Records that the present line sets a numbered parameter.
    pub(crate) fn set_numbered(&mut self, index: usize) {
        let depends = self.line_depends();
        let dependents = if index <= LOCAL_NUMBERED {
            &mut self.local
        } else {
            &mut self.global
        };
        set_dependent(&mut dependents.numbered, index, depends);
        if depends && (G92..INPUT_RESULT).contains(&index) {
            // Offsets that a program sets without G10.
            self.offset = [true; AXES];
        }
    }

    /// Records that the present line sets a named parameter.
    pub(crate) fn set_named(&mut self, id: NameId, kind: NameKind) {
        let depends = self.line_depends();
        match kind {
            NameKind::Global => set_dependent(&mut self.global.named, id, depends),
            NameKind::Local => set_dependent(&mut self.local.named, id, depends),
            NameKind::System(_) => {}
        }
    }

    /// Enters a subroutine with its own parameters.
    pub(crate) fn enter(&mut self, arguments: usize) {
        let outer = std::mem::take(&mut self.local);
        self.outer.push(outer);
        if self.line_depends() {
            self.local.numbered.extend(1..=arguments);
        }
    }

    /// Leaves it.
    pub(crate) fn leave(&mut self) {
        self.local = self.outer.pop().unwrap_or_default();
        self.returned = self.line_depends();
    }

    /// Whether an error of the present line may be due to the assumption alone.
    #[cold]
    pub(crate) fn explains(&self, code: Code, plane: [usize; 2], has_axes: bool) -> bool {
        let is_unknown = |axis: usize| self.position[axis] || self.offset[axis];
        match code {
            Code::ActiveComment => self.has_branched,
            Code::UndefinedParameter | Code::Arithmetic => self.line_depends(),
            Code::ArcNoChord
            | Code::ArcRadiusTooSmall
            | Code::ArcRadiusMismatch
            | Code::ArcZeroRadius
            | Code::ArcRefused
            | Code::InvoluteRefused
            | Code::InvoluteInside
            | Code::InvoluteEqualRadii
            | Code::InvoluteMissed
            | Code::HoleRefused
            | Code::ProfileRefused
            | Code::CompensationEntry
            | Code::CompensationGouge => self.line_depends() || plane.into_iter().any(is_unknown),
            Code::PositionTooLarge | Code::LineRefused | Code::OutOfRange => {
                self.values_depend() || has_axes && (self.is_in_branch || (0..AXES).any(is_unknown))
            }
            Code::NotInteger
            | Code::Negative
            | Code::FeedZero
            | Code::NumberTooLarge
            | Code::ArcTurns
            | Code::InvoluteTurns
            | Code::UnknownTool
            | Code::SubroutineMissing => self.values_depend(),
            _ => false,
        }
    }
}

fn set_dependent<T: Ord>(set: &mut BTreeSet<T>, what: T, depends: bool) {
    if depends {
        set.insert(what);
    } else {
        set.remove(&what);
    }
}
