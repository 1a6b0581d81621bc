//! Axes that are not at right angles.

use evolvent_path::{AXES, Axes};

/// How far X, Y and Z are off their right angles: the ratio of the drift of one to the way of the other (1 um/m is 1e-6).
///
/// While Y alone moves forwards by 1 mm, the tool drifts by `xy` mm to larger X; while Z alone does, by `xz` mm to larger X and `yz`
/// mm to larger Y. Positive is an angle of less than 90 degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Squareness {
    /// X drifts with Y.
    pub xy: f64,
    /// X drifts with Z.
    pub xz: f64,
    /// Y drifts with Z.
    pub yz: f64,
}

impl Squareness {
    /// Positions of the slides with which the tool is at `ideal`: the exact inverse of [`tool`](Self::tool). Derivatives likewise.
    #[must_use]
    pub fn slides(&self, ideal: &Axes) -> Axes {
        let mut slides = *ideal;
        slides[1] -= self.yz * ideal[2];
        slides[0] -= self.xy * slides[1] + self.xz * ideal[2];
        slides
    }

    /// Where the tool is with these positions of the slides.
    #[must_use]
    pub fn tool(&self, slides: &Axes) -> Axes {
        let mut tool = *slides;
        tool[0] += self.xy * slides[1] + self.xz * slides[2];
        tool[1] += self.yz * slides[2];
        tool
    }

    /// By how much of the motion of axis `other` that of `axis` grows at the most.
    pub(crate) fn coupling(&self, axis: usize, other: usize) -> f64 {
        match (axis, other) {
            (0, 1) => self.xy.abs(),
            (0, 2) => (self.xz - self.xy * self.yz).abs(),
            (1, 2) => self.yz.abs(),
            _ => 0.0,
        }
    }

    /// Whether it changes nothing.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

/// The number of axes that squareness concerns.
pub(crate) const LINEAR: usize = 3;
const _: () = assert!(LINEAR <= AXES);
