//! Input and output of a force law.

/// The conditions of a cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// Cutting speed, m/min.
    pub speed_m_min: f64,
    /// Depth of cut, mm.
    pub depth_mm: f64,
    /// Feed, mm/rev.
    pub feed_mm_rev: f64,
}

/// The angles of a tool that laws use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolAngles {
    /// Rake angle, degrees.
    pub rake_deg: f64,
    /// Lead angle between the main cutting edge and the direction of feed, degrees.
    pub lead_deg: f64,
}

/// A force and its partial derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Force {
    /// Tangential force (along the cutting speed, Pz), N.
    pub tangential_n: f64,
    /// Its derivative by the cutting speed, N per m/min.
    pub per_speed: f64,
    /// Its derivative by the depth of cut, N/mm.
    pub per_depth: f64,
    /// Its derivative by the feed, N per mm/rev.
    pub per_feed: f64,
}

/// A force at a fixed feed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SectionForce {
    /// Tangential force, N.
    pub tangential_n: f64,
    /// Its derivative by the cutting speed, N per m/min.
    pub per_speed: f64,
    /// Its derivative by the depth of cut, N/mm.
    pub per_depth: f64,
}
