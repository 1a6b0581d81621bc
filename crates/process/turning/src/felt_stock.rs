//! The stock by the load: contact, depth, and what must still be there.

use crate::backing_off::HARDEST;
use crate::engagement::Engagement;
use crate::settings::TurningSettings;
use crate::tip_contact::TipContact;
use crate::watch::SMOOTHING_S;

/// The stock that was felt. Positions in mm along the cut, heights above the final size.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FeltStock {
    /// Position of contact; `None` in air.
    pub(crate) contact_mm: Option<f64>,
    /// In a gap of the stock.
    pub(crate) in_air: bool,
    /// The stock that was felt last and must still be there.
    pub(crate) engagement: Engagement,
    /// Whether that stock is under the tip.
    pub(crate) tip: TipContact,
    /// Maximum depth since contact, and its position.
    pub(crate) grown_mm: (f64, f64),
    /// Position and depth of the cut once it had settled for a revolution.
    pub(crate) settled_mm: (f64, f64),
    /// Height of the shoulder at which the tool backed off.
    pub(crate) shoulder_mm: f64,
    /// Position by which stock must be met, and its depth: a shoulder at which the tool backed off, or the
    /// cut before a hold.
    pub(crate) expected_mm: Option<(f64, f64)>,
    /// Position at which the load vanished in a manner that may be a gap, or at which the tool backed off;
    /// `None` once a depth is felt again. A short contact proves nothing: in an eccentric blank the highest
    /// point comes first.
    pub(crate) unproven_mm: Option<f64>,
    /// Decaying reading of the previous cut, and the fraction of it that decays in a cycle.
    pub(crate) residue_n: f64,
    pub(crate) residue_fraction: f64,
}

impl FeltStock {
    /// Nothing was felt.
    pub(crate) fn new(settings: &TurningSettings) -> Self {
        Self {
            contact_mm: None,
            in_air: false,
            engagement: Engagement::new(HARDEST * settings.tool.slope()),
            tip: TipContact::NONE,
            grown_mm: (0.0, 0.0),
            settled_mm: (0.0, 0.0),
            shoulder_mm: 0.0,
            expected_mm: None,
            unproven_mm: None,
            residue_n: 0.0,
            residue_fraction: 1.0 - libm::exp(-settings.period_s / (settings.sensor_lag_s + SMOOTHING_S)),
        }
    }

    /// The edge leaves the stock; shoulders and unproven stock are kept.
    pub(crate) fn lose(&mut self) {
        self.in_air = false;
        self.contact_mm = None;
        self.grown_mm = (0.0, 0.0);
        self.engagement.forget();
        self.tip.lose();
        self.expected_mm = None;
    }
}
