//! Places that are too deep or too thin, and what a job has done about them.

/// Deep and thin places of the pass under way, and of the job.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PlaceWatch {
    /// Time for which the cut has been too deep, s.
    pub(crate) deep_s: f64,
    /// Where it began to be too thin, mm along the cut.
    pub(crate) thin_from_mm: Option<f64>,
    /// The feed stays at the one of resumption until this place, mm along the cut.
    pub(crate) cautious_to_mm: Option<f64>,
    /// The highest stock that was felt, mm above the final size.
    pub(crate) highest_felt_mm: f64,
    /// Passes of the job that were ended on a thin place.
    pub(crate) returned_thin: u32,
    /// Of these, those where stock was cut: not at a gap.
    pub(crate) returned_low: u32,
}

impl PlaceWatch {
    /// The edge leaves the stock: the next place is another one.
    pub(crate) fn leave(&mut self) {
        (self.deep_s, self.thin_from_mm) = (0.0, None);
    }
}
