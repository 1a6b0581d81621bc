//! The present pass: where it begins, how high it goes, and what it has met.

/// The present pass.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PassPlan {
    /// Number, from 1; 0 before the first pass.
    pub(crate) number: u32,
    /// Height above the final size, mm.
    pub(crate) out_mm: f64,
    /// Maximum height of the tool in this pass, mm.
    pub(crate) highest_mm: f64,
    /// Position at which it begins, mm along the cut.
    pub(crate) start_mm: f64,
    /// End of the stock that it may have to cut, mm; infinite if that is unknown.
    pub(crate) stock_to_mm: f64,
    /// It covers positions that no pass has covered before.
    pub(crate) meets_unknown: bool,
    /// A load has been felt.
    pub(crate) is_touched: bool,
    /// Time for which the tool has dwelt at the end, s.
    pub(crate) end_s: f64,
}

impl PassPlan {
    /// Before the first pass, for a tool at a position and height, mm.
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
