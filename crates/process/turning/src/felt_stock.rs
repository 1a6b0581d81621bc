//! The stock that the load tells of: contact, depth, and what must still stand.

use crate::backing_off::HARDEST;
use crate::engagement::Engagement;
use crate::settings::TurningSettings;
use crate::tip_contact::TipContact;
use crate::watch::SMOOTHING_S;

/// What was felt of the stock. Places in mm along the cut, heights above the final size.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FeltStock {
    /// Place of contact; none in air.
    pub(crate) contact_mm: Option<f64>,
    /// In a gap of the stock.
    pub(crate) in_air: bool,
    /// What was felt last, and must still be there.
    pub(crate) engagement: Engagement,
    /// Whether that stands under the tip.
    pub(crate) tip: TipContact,
    /// Largest depth since contact and where it was reached.
    pub(crate) grown_mm: (f64, f64),
    /// Place and depth of the cut once it had settled for a revolution.
    pub(crate) settled_mm: (f64, f64),
    /// Height of the shoulder that is backed off from.
    pub(crate) shoulder_mm: f64,
    /// Place by which stock must be met, and its depth: a shoulder that was backed off from, or the cut
    /// before a hold.
    pub(crate) expected_mm: Option<(f64, f64)>,
    /// The load has gone at this place in a way that may be a gap, or a shoulder was backed off from; none
    /// once a depth is felt again. A touch alone proves nothing: off the axis the highest point comes first.
    pub(crate) unproven_mm: Option<f64>,
    /// Load that the sensor still shows of what was cut before, and the fraction of it that goes in a cycle.
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

    /// The edge leaves the stock; shoulders and what is unproven stay.
    pub(crate) fn lose(&mut self) {
        self.in_air = false;
        self.contact_mm = None;
        self.grown_mm = (0.0, 0.0);
        self.engagement.forget();
        self.tip.lose();
        self.expected_mm = None;
    }
}
