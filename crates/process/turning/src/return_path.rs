//! The return between passes, and to the start.

/// Legs of the return.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Leg {
    Out,
    Back,
    In,
    /// All stock is at size: across to the height of the start, ...
    HomeAcross,
    /// ... and along to its position.
    HomeAlong,
}

/// The present return.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReturnPath {
    pub(crate) leg: Leg,
    /// Height at which the tool goes back, mm.
    pub(crate) out_mm: f64,
    /// Final position, if not simply before the stock: mm along the cut, and height.
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
