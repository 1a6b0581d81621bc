//! Squareness errors between X, Y and Z.

use evolvent_path::{AXES, Axes};

/// Squareness errors of X, Y and Z: the ratio of the drift of one axis to the motion of another (1 um/m is
/// 1e-6).
///
/// While Y alone moves forwards by 1 mm, the tool drifts by `xy` mm towards larger X; while Z alone moves, by
/// `xz` mm towards larger X and by `yz` mm towards larger Y. Positive values are angles below 90 degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Squareness {
    /// Drift of X with Y.
    pub xy: f64,
    /// Drift of X with Z.
    pub xz: f64,
    /// Drift of Y with Z.
    pub yz: f64,
}

impl Squareness {
    /// Slide positions for the tool position `ideal`, the exact inverse of [`tool`](Self::tool). Derivatives
    /// transform alike.
    #[must_use]
    pub fn slides(&self, ideal: &Axes) -> Axes {
        let mut slides = *ideal;
        slides[1] -= self.yz * ideal[2];
        slides[0] -= self.xy * slides[1] + self.xz * ideal[2];
        slides
    }

    /// Tool position for these slide positions.
    #[must_use]
    pub fn tool(&self, slides: &Axes) -> Axes {
        let mut tool = *slides;
        tool[0] += self.xy * slides[1] + self.xz * slides[2];
        tool[1] += self.yz * slides[2];
        tool
    }

    /// Upper bound of the additional motion of `axis` per motion of `other`.
    pub(crate) fn coupling(&self, axis: usize, other: usize) -> f64 {
        match (axis, other) {
            (0, 1) => self.xy.abs(),
            (0, 2) => (self.xz - self.xy * self.yz).abs(),
            (1, 2) => self.yz.abs(),
            _ => 0.0,
        }
    }

    /// Whether all errors are zero.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// The number of axes with squareness errors.
pub(crate) const LINEAR: usize = 3;
const _: () = assert!(LINEAR <= AXES);
