//! A curve of another kind, evaluated by its own crate because it is defined by its parametrisation.

use evolvent_path::{Axes, Curve};

use crate::measure::{linear, rotary};

/// Any curve by its regular parameter, scaled so that no point moves faster than the parameter.
#[derive(Clone, Debug)]
pub(crate) struct Other {
    curve: Curve,
    /// Parameter here per parameter of the curve.
    scale: f64,
    length: f64,
}

impl Other {
    pub(crate) fn of(curve: &Curve) -> Self {
        let domain = curve.domain();
        let (first, _, _) = curve.derivative_bounds(0.0, domain);
        let scale = linear(&first).max(rotary(&first)).max(f64::MIN_POSITIVE);
        Self {
            curve: *curve,
            scale,
            length: domain * scale,
        }
    }

    pub(crate) fn length(&self) -> f64 {
        self.length
    }

    pub(crate) fn point(&self, u: f64) -> Axes {
        self.curve.position(u / self.scale)
    }

    pub(crate) fn tangent(&self, u: f64) -> Axes {
        self.curve.jet(u / self.scale).first / self.scale
    }
}
