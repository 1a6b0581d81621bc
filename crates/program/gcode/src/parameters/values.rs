//! Numbered and named parameters.
//!
//! The numbered ones contain what LinuxCNC stores there, under the same numbers, lengths in mm: work offsets,
//! positions of G28 and G30, the offset of G92, the tool. Codes read such values from here, so a program can
//! prepare them by assignment.

use evolvent_path::{AXES, Axes};

use crate::Tool;
use crate::parameters::assumption::Assumption;
use crate::parameters::foreign_reads::ForeignReads;
use crate::parameters::names::{NameId, NameKind, Names, NormalizedName};

/// The largest parameter number plus one.
pub(crate) const NUMBERED: usize = 5602;

/// Parameters from 1 to this one belong to the active subroutine.
pub(crate) const LOCAL_NUMBERED: usize = 30;

/// Whether DEBUG comments are shown.
pub(crate) const DEBUG: usize = 5599;
/// Position at which the probe tripped, nine axes in program coordinates and units.
pub(crate) const PROBED: usize = 5061;
/// Whether it tripped.
pub(crate) const PROBE_TRIPPED: usize = 5070;
/// Result of M66.
pub(crate) const INPUT_RESULT: usize = 5399;
/// Position of G28, nine axes.
pub(crate) const HOME_G28: usize = 5161;
/// Position of G30, nine axes.
pub(crate) const HOME_G30: usize = 5181;
/// Whether the offset of G92 is active.
pub(crate) const G92_ACTIVE: usize = 5210;
/// The offset of G92, nine axes.
pub(crate) const G92: usize = 5211;
/// Number of the active work offset, from 1.
pub(crate) const WORK_OFFSET: usize = 5220;
/// First work offset, nine axes and the rotation; the others follow at intervals of 20.
pub(crate) const WORK_OFFSET_1: usize = 5221;
/// Tool in the spindle, then its offsets on nine axes.
pub(crate) const TOOL: usize = 5400;
/// Diameter, front angle, back angle, orientation of the tool in the spindle.
pub(crate) const TOOL_DIAMETER: usize = 5410;
/// Present position in program coordinates and units, nine axes: computed, not stored.
pub(crate) const POSITION: usize = 5420;

/// One change that can be rolled back.
#[derive(Clone, Copy, Debug)]
enum Change {
    Numbered(usize, f64),
    Global(NameId, Option<f64>),
    Local(usize, f64),
    NewLocal,
}

/// The data saved by a call.
#[derive(Clone, Debug)]
struct Frame {
    numbered: [f64; LOCAL_NUMBERED],
    locals: usize,
}

/// All parameters of a program.
#[derive(Debug)]
pub(crate) struct Parameters {
    numbered: Vec<f64>,
    pub(crate) names: Names,
    /// By name; `None` if not set.
    globals: Vec<Option<f64>>,
    /// The local parameters of all frames; those of the active frame start at `base`.
    locals: Vec<(NameId, f64)>,
    base: usize,
    frames: Vec<Frame>,
    undo: Vec<Change>,
    /// The value returned by the last subroutine.
    pub(crate) returned: Option<f64>,
    /// Values that depend on assumed contacts; `None` before the first.
    pub(crate) assumption: Option<Box<Assumption>>,
    pub(crate) foreign_reads: ForeignReads,
}

impl Parameters {
    pub(crate) fn new() -> Self {
        Self {
            numbered: vec![0.0; NUMBERED],
            names: Names::default(),
            globals: Vec::new(),
            locals: Vec::new(),
            base: 0,
            frames: Vec::new(),
            undo: Vec::new(),
            returned: None,
            assumption: None,
            foreign_reads: ForeignReads::default(),
        }
    }

    /// Whether a program must not write this parameter.
    pub(crate) fn is_read_only(index: usize) -> bool {
        matches!(index, TOOL..=5413 | POSITION..=5428)
    }

    /// Whether a numbered parameter is a length that is stored in mm: the linear axes of G28, G30, G92, the
    /// work offsets and the tool, and its diameter.
    pub(crate) fn is_stored_length(index: usize) -> bool {
        let axis_from = |first: usize| index.checked_sub(first).filter(|axis| *axis < AXES);
        let work_axis = || {
            (WORK_OFFSET_1..TOOL)
                .contains(&index)
                .then(|| (index - WORK_OFFSET_1) % 20)
        };
        let axis_parameters = [HOME_G28, HOME_G30, G92, TOOL + 1];
        let axis = axis_parameters.into_iter().find_map(axis_from).or_else(work_axis);
        index == TOOL_DIAMETER || matches!(axis, Some(0..=2 | 6..=8))
    }

    /// A numbered parameter; 0 outside of the range.
    #[inline]
    pub(crate) fn numbered(&self, index: usize) -> f64 {
        self.numbered.get(index).copied().unwrap_or(0.0)
    }

    /// Writes a numbered parameter; no effect outside of the range.
    #[inline]
    pub(crate) fn set_numbered(&mut self, index: usize, value: f64) {
        if let Some(slot) = self.numbered.get_mut(index) {
            self.undo.push(Change::Numbered(index, *slot));
            *slot = value;
        }
    }

    /// Writes the data of the tool in the spindle to the parameters #5400 to #5413.
    pub(crate) fn publish_tool(&mut self, tool: &Tool) {
        self.set_numbered(TOOL, f64::from(tool.number));
        self.set_axes(TOOL + 1, &tool.offset);
        for (index, value) in [
            tool.diameter_mm,
            tool.front_angle_deg,
            tool.back_angle_deg,
            f64::from(tool.orientation),
        ]
        .into_iter()
        .enumerate()
        {
            self.set_numbered(TOOL_DIAMETER + index, value);
        }
    }

    /// Nine consecutive parameters.
    pub(crate) fn axes(&self, first: usize) -> Axes {
        let mut axes = Axes::zeros();
        for index in 0..AXES {
            axes[index] = self.numbered(first + index);
        }
        axes
    }

    pub(crate) fn set_axes(&mut self, first: usize, axes: &Axes) {
        for index in 0..AXES {
            self.set_numbered(first + index, axes[index]);
        }
    }

    /// A named parameter that is not predefined; `None` if not set.
    pub(crate) fn named(&self, id: NameId, kind: NameKind) -> Option<f64> {
        match kind {
            NameKind::Global => self.globals.get(id as usize).copied().flatten(),
            NameKind::Local => {
                let mut locals = self.locals[self.base..].iter();
                locals.find(|(name, _)| *name == id).map(|(_, value)| *value)
            }
            NameKind::System(_) => None,
        }
    }

    /// Writes a named parameter. False if there are too many names, or if the name is predefined.
    pub(crate) fn set_named(&mut self, name: &NormalizedName, value: f64) -> bool {
        let Some((id, kind)) = self.names.intern(name) else {
            return false;
        };
        match kind {
            NameKind::System(_) => return false,
            NameKind::Global => {
                let index = id as usize;
                if self.globals.len() <= index {
                    self.globals.resize(index + 1, None);
                }
                self.undo.push(Change::Global(id, self.globals[index]));
                self.globals[index] = Some(value);
            }
            NameKind::Local => {
                let found = self.locals[self.base..].iter().position(|(name, _)| *name == id);
                if let Some(index) = found {
                    let index = self.base + index;
                    self.undo.push(Change::Local(index, self.locals[index].1));
                    self.locals[index].1 = value;
                } else {
                    self.undo.push(Change::NewLocal);
                    self.locals.push((id, value));
                }
            }
        }
        true
    }

    /// The named parameters visible here, sorted by name.
    pub(crate) fn all_named(&self) -> Vec<(&str, f64)> {
        let mut found: Vec<_> = self
            .names
            .all()
            .filter_map(|(name, id, kind)| Some((name, self.named(id, kind)?)))
            .collect();
        found.sort_unstable_by_key(|(name, _)| *name);
        found
    }

    /// Makes the changes so far permanent.
    #[inline]
    pub(crate) fn commit(&mut self) {
        self.undo.clear();
    }

    /// Undoes the changes since [`commit`](Self::commit).
    pub(crate) fn roll_back(&mut self) {
        while let Some(change) = self.undo.pop() {
            match change {
                Change::Numbered(index, value) => self.numbered[index] = value,
                Change::Global(id, value) => self.globals[id as usize] = value,
                Change::Local(index, value) => self.locals[index].1 = value,
                Change::NewLocal => {
                    self.locals.pop();
                }
            }
        }
    }

    /// Enters a subroutine: its arguments become #1 and following, the rest of #1 to #30 is 0.
    pub(crate) fn enter(&mut self, arguments: &[f64]) {
        let mut saved = [0.0; LOCAL_NUMBERED];
        saved.copy_from_slice(&self.numbered[1..=LOCAL_NUMBERED]);
        self.frames.push(Frame {
            numbered: saved,
            locals: self.base,
        });
        self.base = self.locals.len();
        for (index, slot) in self.numbered[1..=LOCAL_NUMBERED].iter_mut().enumerate() {
            *slot = arguments.get(index).copied().unwrap_or(0.0);
        }
        if let Some(assumption) = &mut self.assumption {
            assumption.enter(arguments.len());
        }
        self.commit();
    }

    /// Leaves a subroutine.
    pub(crate) fn leave(&mut self) {
        self.commit();
        if let Some(frame) = self.frames.pop() {
            self.numbered[1..=LOCAL_NUMBERED].copy_from_slice(&frame.numbered);
            self.locals.truncate(self.base);
            self.base = frame.locals;
            if let Some(assumption) = &mut self.assumption {
                assumption.leave();
            }
        }
    }

    /// Nesting depth of subroutines.
    pub(crate) fn depth(&self) -> usize {
        self.frames.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> NormalizedName {
        NormalizedName::new(text.as_bytes()).unwrap()
    }

    fn read(parameters: &Parameters, text: &str) -> Option<f64> {
        let (id, kind) = parameters.names.find(&name(text))?;
        parameters.named(id, kind)
    }

    #[test]
    fn a_rollback_restores_every_kind_of_parameter() {
        let mut parameters = Parameters::new();
        parameters.set_numbered(7, 1.0);
        assert!(parameters.set_named(&name("a"), 2.0) && parameters.set_named(&name("_global"), 3.0));
        parameters.commit();
        parameters.set_numbered(7, 9.0);
        parameters.set_named(&name("a"), 9.0);
        parameters.set_named(&name("_global"), 9.0);
        parameters.set_named(&name("c"), 9.0);
        parameters.set_named(&name("_other"), 9.0);
        parameters.roll_back();
        assert_eq!(parameters.numbered(7), 1.0);
        assert_eq!(
            (read(&parameters, "a"), read(&parameters, "_global")),
            (Some(2.0), Some(3.0))
        );
        assert_eq!(
            (read(&parameters, "c"), read(&parameters, "_other")),
            (None, None)
        );
    }

    #[test]
    fn a_call_has_its_own_locals_and_arguments() {
        let mut parameters = Parameters::new();
        parameters.set_numbered(1, 5.0);
        parameters.set_numbered(31, 6.0);
        parameters.set_named(&name("a"), 1.0);
        parameters.enter(&[7.0]);
        assert_eq!((parameters.numbered(1), parameters.numbered(2)), (7.0, 0.0));
        assert_eq!((parameters.numbered(31), read(&parameters, "a")), (6.0, None));
        parameters.set_named(&name("a"), 2.0);
        parameters.set_numbered(31, 8.0);
        parameters.leave();
        assert_eq!((parameters.numbered(1), parameters.numbered(31)), (5.0, 8.0));
        assert_eq!(read(&parameters, "a"), Some(1.0));
    }
}
