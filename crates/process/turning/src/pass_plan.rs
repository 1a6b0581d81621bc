//! The pass under way: where it begins, how high it goes, and what it has met.

/// The pass under way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PassPlan {
    /// From 1; 0 before the first one.
    pub(crate) number: u32,
    /// Height above the final size, mm.
    pub(crate) out_mm: f64,
    /// The highest that the tool has been at, mm.
    pub(crate) highest_mm: f64,
    /// Place at which it begins, mm along the cut.
    pub(crate) start_mm: f64,
    /// Place up to which stock may stand that it is to take, mm; without end where that is not known.
    pub(crate) stock_to_mm: f64,
    /// It goes over places that no pass has been over before.
    pub(crate) meets_unknown: bool,
    /// A load has been felt.
    pub(crate) is_touched: bool,
    /// Time for which the tool has stood at the end, s.
    pub(crate) end_s: f64,
}

impl PassPlan {
    /// Before the first pass, for a tool at a place and height, mm.
    pub(crate) fn new(start_mm: (f64, f64)) -> Self {
        Self {
            number: 0,
            out_mm: 0.0,
            highest_mm: start_mm.1,
            start_mm: start_mm.0,
            stock_to_mm: f64::INFINITY,
            meets_unknown: true,
            is_touched: false,
            end_s: 0.0,
        }
    }
}
