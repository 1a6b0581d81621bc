//! What a cut of a lathe is like.

use evolvent_turning::{CutKind, TurningJob};
use serde::Serialize;
use ts_rs::TS;

/// The process file of turning cycles that find their passes.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct ProcessInfo {
    /// Its name.
    pub name: String,
    /// Along X towards the axis; else along Z towards lower Z.
    pub is_facing: bool,
    /// Final diameter; facing: diameter at which the tool comes in.
    pub diameter_mm: f64,
    /// Z of the face at which the tool comes in; facing: of the finished face.
    pub z_mm: f64,
    /// Length of the cut.
    pub length_mm: f64,
    /// Maximum stock above the final size, in radius or along Z.
    pub allowance_mm: f64,
    /// Height of the stock above the final size over the place from the face, where the file has a stock.
    pub outline_mm: Vec<(f64, f64)>,
    /// Load that is held, as the sensor shows it.
    pub set_load: f64,
    /// Load above which the tool is drawn out, in the same unit.
    pub overload: f64,
}

impl From<&TurningJob> for ProcessInfo {
    fn from(job: &TurningJob) -> Self {
        let settings = &job.settings;
        Self {
            name: job.name.clone(),
            is_facing: job.cut.kind == CutKind::Facing,
            diameter_mm: job.cut.diameter_mm,
            z_mm: job.cut.z_mm,
            length_mm: job.cut.length_mm,
            allowance_mm: job.cut.allowance_max_mm,
            outline_mm: job
                .blank
                .as_ref()
                .map_or_else(Vec::new, |blank| blank.outline_mm.clone()),
            // A sensor with a lever reports more at larger diameters; these are its readings at the final
            // size.
            set_load: settings.scale.reading(settings.regime.set_load, [0.0, 0.0], 0.0),
            overload: settings.scale.reading(settings.overload_n, [0.0, 0.0], 0.0),
        }
    }
}
