//! A set of axes as a bit mask, the form used in messages and traces.

use std::ops::{BitAnd, BitOr, BitOrAssign};

use crate::{AXES, AxisLetter};

/// A set of axes. Bit i is axis i, in the order of [`AxisLetter::ALL`]. All functions are real-time safe.
///
/// ```
/// use evolvent_path::{AxisLetter, AxisMask};
///
/// let mask: AxisMask = [AxisLetter::X, AxisLetter::Z].into_iter().collect();
/// assert_eq!(mask.bits(), 0b101);
/// assert!(mask.contains(2) && !mask.contains(1));
/// assert_eq!(mask.axes().collect::<Vec<_>>(), [0, 2]);
/// // Bits that belong to no axis are dropped.
/// assert_eq!(AxisMask::from_bits(u32::MAX), AxisMask::ALL);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct AxisMask(u32);

impl AxisMask {
    /// The empty set.
    pub const NONE: Self = Self(0);
    /// All nine axes.
    pub const ALL: Self = Self((1 << AXES) - 1);

    /// The set with these bits. Bits that belong to no axis are dropped.
    #[must_use]
    pub const fn from_bits(bits: u32) -> Self {
        Self(bits & Self::ALL.0)
    }

    /// The bits of the set.
    #[must_use]
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// The set of one axis, given by its index; empty if no axis has this index.
    #[must_use]
    pub const fn one(axis: usize) -> Self {
        if axis < AXES { Self(1 << axis) } else { Self::NONE }
    }

    /// The set of one axis if the condition holds, otherwise the empty set.
    #[must_use]
    pub const fn one_if(axis: usize, holds: bool) -> Self {
        if holds { Self::one(axis) } else { Self::NONE }
    }

    /// Whether the set contains this axis.
    #[must_use]
    pub const fn contains(self, axis: usize) -> bool {
        self.0 & Self::one(axis).0 != 0
    }

    /// Whether the set is empty.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The axes of this set that are not in `other`.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// The indices of the axes in ascending order.
    pub fn axes(self) -> impl Iterator<Item = usize> {
        (0..AXES).filter(move |axis| self.contains(*axis))
    }
}

impl BitOr for AxisMask {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitOrAssign for AxisMask {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

impl BitAnd for AxisMask {
    type Output = Self;

    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

impl FromIterator<usize> for AxisMask {
    fn from_iter<I: IntoIterator<Item = usize>>(axes: I) -> Self {
        axes.into_iter()
            .fold(Self::NONE, |mask, axis| mask | Self::one(axis))
    }
}

impl FromIterator<AxisLetter> for AxisMask {
    fn from_iter<I: IntoIterator<Item = AxisLetter>>(axes: I) -> Self {
        axes.into_iter().map(AxisLetter::index).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_round_trip_and_others_are_dropped() {
        for bits in 0..1 << AXES {
            let mask = AxisMask::from_bits(bits);
            assert_eq!(mask.bits(), bits);
            let axes: Vec<usize> = mask.axes().collect();
            assert_eq!(axes.iter().copied().collect::<AxisMask>(), mask);
            for axis in 0..40 {
                assert_eq!(mask.contains(axis), axes.contains(&axis));
            }
            assert_eq!(mask.is_empty(), axes.is_empty());
            assert_eq!(mask.without(mask), AxisMask::NONE);
            assert_eq!((mask | AxisMask::ALL) & mask, mask);
        }
        assert_eq!(AxisMask::one(AXES), AxisMask::NONE);
        assert_eq!(AxisMask::one_if(3, true).bits(), 8);
        assert_eq!(AxisMask::one_if(3, false).bits(), 0);
    }
}
