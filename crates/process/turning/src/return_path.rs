//! The way back between passes, and home.

/// Parts of the way back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Leg {
    Out,
    Back,
    In,
    /// Everything is at size: across to the height that is to be gone back to, ...
    HomeAcross,
    /// ... and along to the place.
    HomeAlong,
}

/// The way back under way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReturnPath {
    pub(crate) leg: Leg,
    /// Height at which the tool goes back, mm.
    pub(crate) out_mm: f64,
    /// Where the tool goes at the end, if not simply before the stock: mm along the cut, and height.
    pub(crate) home_mm: Option<(f64, f64)>,
}

impl ReturnPath {
    /// For a tool at a height, mm.
    pub(crate) fn new(out_mm: f64, home_mm: Option<(f64, f64)>) -> Self {
        Self {
            leg: Leg::Out,
            out_mm,
            home_mm,
        }
    }
}
