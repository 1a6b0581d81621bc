//! Reads of numbers that are system variables in macro programs of other dialects. Here they are ordinary
//! parameters, 0 unless the program sets them.

use std::cell::Cell;
use std::collections::BTreeSet;

/// The variables read so far.
#[derive(Debug, Default)]
pub(crate) struct ForeignReads {
    /// Of the present line.
    pending: Cell<Option<usize>>,
    /// Those that have been reported, or need no report.
    reported: BTreeSet<usize>,
    /// Those that the present line has added to them.
    added: Vec<usize>,
}

impl ForeignReads {
    /// Records that an expression reads a parameter that is 0.
    #[inline]
    pub(crate) fn read(&self, index: usize) {
        if (3001..=5046).contains(&index) && equivalent(index).is_some() {
            self.pending.set(Some(index));
        }
    }

    /// A parameter that the program sets is its own, with any value.
    pub(crate) fn set(&mut self, index: usize) {
        if equivalent(index).is_some() {
            self.add(index);
        }
    }

    fn add(&mut self, index: usize) -> bool {
        let is_new = self.reported.insert(index);
        if is_new {
            self.added.push(index);
        }
        is_new
    }

    /// Begins a line, or a part of it.
    #[inline]
    pub(crate) fn begin(&mut self) {
        self.added.clear();
    }

    /// Undoes a rejected line: its warning is lost, and its assignments have no effect.
    #[cold]
    pub(crate) fn roll_back(&mut self) {
        self.pending.set(None);
        for index in self.added.drain(..) {
            self.reported.remove(&index);
        }
    }

    /// The warning of the present line, once for each variable.
    #[inline]
    pub(crate) fn take(&mut self) -> Option<String> {
        self.pending.take().and_then(|index| self.report(index))
    }

    #[cold]
    fn report(&mut self, index: usize) -> Option<String> {
        let (meaning, advice) = equivalent(index).filter(|_| self.add(index))?;
        Some(format!(
            "#{index}, {meaning} in other dialects, is an ordinary parameter here, and 0 because nothing has \
             set it; {advice}"
        ))
    }
}

/// The system variable of other dialects, and its equivalent here.
fn equivalent(index: usize) -> Option<(&'static str, &'static str)> {
    Some(match index {
        3001 | 3002 => ("a clock", "there is none"),
        3011 | 3012 => ("date and time", "there is none"),
        4001..=4130 => (
            "an active code or word",
            "#<_motion_mode>, #<_plane>, #<_metric>, #<_absolute>, #<_feed>, #<_rpm> and similar names give \
             the modes",
        ),
        5001..=5006 | 5041..=5046 => ("a position", "write #5420 for X to #5428 for W"),
        5021..=5026 => (
            "a position of the machine",
            "write #<_abs_x>, #<_abs_y>, #<_abs_z>",
        ),
        _ => return None,
    })
}
