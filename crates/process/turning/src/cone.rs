//! The cone after the cylinder of a cut.

use crate::tool::CuttingEdge;

/// Minimum angle between cone and edge, degrees.
const CLEARANCE_DEG: f64 = 1.0;
/// Minimum angle of a cone, degrees.
const MIN_DEG: f64 = 0.1;

/// A cone that rises from the final size at the end of a cylinder up to the end of the cut.
///
/// ```
/// use evolvent_turning::Cone;
/// // A cylinder of 40 mm, then 30 degrees.
/// let cone = Cone::new(40.0, 30.0);
/// assert_eq!(cone.height_mm(40.0), 0.0);
/// assert!((cone.height_mm(50.0) - 5.7735).abs() < 1e-4);
/// assert!((cone.position_mm(5.7735) - 50.0).abs() < 1e-3);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    /// Its start, mm along the cut.
    pub from_mm: f64,
    /// Rise in height per mm along the cut: the tangent of its angle.
    pub slope: f64,
}

/// Why a cone cannot be cut.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the cone rises by {angle_deg:.2} degrees, and an edge with a lead angle of {lead_deg} degrees cuts \
     cones from {MIN_DEG} to {max_deg} degrees: take a tool with another lead angle"
)]
pub struct ConeError {
    /// Angle of the cone.
    pub angle_deg: f64,
    /// Lead angle of the edge.
    pub lead_deg: f64,
    /// Maximum angle of a cone.
    pub max_deg: f64,
}

impl Cone {
    /// A cone from a position along the cut (mm) that rises by an angle in degrees.
    #[must_use]
    pub fn new(from_mm: f64, angle_deg: f64) -> Self {
        Self {
            from_mm,
            slope: libm::tan(angle_deg.to_radians()),
        }
    }

    /// A cone from a position along the cut up to a height over a length, all in mm; `None` if the height or
    /// the length is not positive.
    #[must_use]
    pub fn rising(from_mm: f64, height_mm: f64, length_mm: f64) -> Option<Self> {
        (height_mm > 0.0 && length_mm > 0.0).then(|| Self {
            from_mm,
            slope: height_mm / length_mm,
        })
    }

    /// Its angle against the axis of the work, degrees.
    #[must_use]
    pub fn angle_deg(&self) -> f64 {
        libm::atan(self.slope).to_degrees()
    }

    /// Checks that the edge can cut the cone without cutting into it.
    ///
    /// # Errors
    /// A cone that is too flat, or nearly as steep as the edge.
    pub fn check(&self, tool: &CuttingEdge) -> Result<(), ConeError> {
        let angle_deg = self.angle_deg();
        let max_deg = tool.lead_deg() - CLEARANCE_DEG;
        if (MIN_DEG..=max_deg).contains(&angle_deg) {
            Ok(())
        } else {
            Err(ConeError {
                angle_deg,
                lead_deg: tool.lead_deg(),
                max_deg,
            })
        }
    }

    /// Height of the final contour above the final size at a position, mm. Real-time safe.
    #[must_use]
    pub fn height_mm(&self, along_mm: f64) -> f64 {
        (along_mm - self.from_mm).max(0.0) * self.slope
    }

    /// Position at which the cone reaches a height, mm along the cut: a pass at this height meets it there.
    /// Real-time safe.
    #[must_use]
    pub fn position_mm(&self, height_mm: f64) -> f64 {
        self.from_mm + height_mm.max(0.0) / self.slope
    }
}
