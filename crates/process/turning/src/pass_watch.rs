//! Deep and thin positions, and the reactions of a job to them.

/// Distance after the expected contact at which caution ends, mm.
pub(crate) const CAUTION_MM: f64 = 1.5;

/// Deep and thin positions of the present pass, and of the job.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PassWatch {
    /// Time for which the cut has been too deep, s.
    pub(crate) deep_s: f64,
    /// Position at which the cut became too thin, mm along the cut.
    pub(crate) thin_from_mm: Option<f64>,
    /// The feed stays at the resume feed up to this position, mm along the cut.
    pub(crate) cautious_to_mm: Option<f64>,
    /// The highest stock that was felt, mm above the final size.
    pub(crate) highest_felt_mm: f64,
    /// Passes of the job that ended on a thin position.
    pub(crate) returned_thin: u32,
    /// Those of them that ended in a cut, not at a gap.
    pub(crate) returned_low: u32,
}

impl PassWatch {
    /// The edge leaves the stock; the next position is considered again.
    pub(crate) fn leave(&mut self) {
        (self.deep_s, self.thin_from_mm) = (0.0, None);
    }
}
