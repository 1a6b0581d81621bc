//! The cutting edge of a turning tool in the plane of feed.

/// A straight main cutting edge. It rises outwards from the tip and leads: a point of the edge `h` above the
/// tip is `h / tan(lead)` ahead of it in the direction of feed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CuttingEdge {
    lead_deg: f64,
    edge_mm: f64,
    slope: f64,
    reach_mm: f64,
}

/// Why a tool cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ToolError {
    /// The lead angle.
    #[error(
        "the lead angle is {lead_deg} degrees; it must lie from 15 to 89 degrees, so that the depth of cut \
         grows from zero while the tool goes in"
    )]
    Lead {
        /// Given.
        lead_deg: f64,
    },
    /// The length of the edge.
    #[error("the cutting edge is {edge_mm} mm long; it must have 0.1 to 200 mm")]
    Edge {
        /// Given.
        edge_mm: f64,
    },
}

impl CuttingEdge {
    /// Creates an edge with a lead angle (between edge and feed, degrees) and a length in mm.
    ///
    /// # Errors
    /// A lead angle of 90 degrees or more: the load would jump instead of growing.
    pub fn new(lead_deg: f64, edge_mm: f64) -> Result<Self, ToolError> {
        if !(15.0..=89.0).contains(&lead_deg) {
            return Err(ToolError::Lead { lead_deg });
        }
        if !(0.1..=200.0).contains(&edge_mm) {
            return Err(ToolError::Edge { edge_mm });
        }
        let angle = lead_deg.to_radians();
        Ok(Self {
            lead_deg,
            edge_mm,
            slope: libm::tan(angle),
            reach_mm: edge_mm * libm::sin(angle),
        })
    }

    /// Lead angle, degrees.
    #[must_use]
    pub fn lead_deg(&self) -> f64 {
        self.lead_deg
    }

    /// Length of the edge, mm.
    #[must_use]
    pub fn edge_mm(&self) -> f64 {
        self.edge_mm
    }

    /// Rise of the edge per mm of lead: the tangent of the lead angle.
    #[must_use]
    pub fn slope(&self) -> f64 {
        self.slope
    }

    /// Maximum depth of cut of the edge, mm: its length times the sine of the lead angle.
    #[must_use]
    pub fn reach_mm(&self) -> f64 {
        self.reach_mm
    }

    /// Distance of the outer end of the edge ahead of the tip, mm.
    #[must_use]
    pub fn overhang_mm(&self) -> f64 {
        self.reach_mm / self.slope
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_square_to_the_feed_is_refused() {
        for lead in [90.0, 95.0, 0.0, -10.0, f64::NAN] {
            assert!(
                matches!(CuttingEdge::new(lead, 12.0), Err(ToolError::Lead { .. })),
                "{lead}"
            );
        }
        assert!(matches!(
            CuttingEdge::new(60.0, f64::INFINITY),
            Err(ToolError::Edge { .. })
        ));
        let tool = CuttingEdge::new(60.0, 12.0).unwrap();
        assert!((tool.overhang_mm() - 6.0).abs() < 1e-12);
        assert!((tool.reach_mm() - 12.0 * 0.75_f64.sqrt()).abs() < 1e-12);
    }
}
