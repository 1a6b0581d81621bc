//! A height field independent of the crate's: the stock that an edge leaves along the path of the tip.

use evolvent_turning::{Blank, TurningSettings};

const STEP_MM: f64 = 0.05;
/// Length of the field after the end of the cut.
const BEHIND_MM: f64 = 60.0;

pub struct Part {
    tops: Vec<f64>,
    settings: TurningSettings,
    deepest: f64,
    /// Previous position of the tip.
    before: (f64, f64),
}

impl Part {
    pub fn new(settings: &TurningSettings, blank: &Blank) -> Self {
        let count = ((settings.length_mm + settings.beyond_mm.min(BEHIND_MM)) / STEP_MM) as usize;
        Self {
            tops: (0..count)
                .map(|i| blank.height_mm(i as f64 * STEP_MM) + blank.runout_mm)
                .collect(),
            settings: *settings,
            deepest: 0.0,
            before: (f64::NEG_INFINITY, f64::INFINITY),
        }
    }

    /// Cylinder, cone, and a straight wall at the angle of the edge.
    fn contour(&self, along: f64) -> f64 {
        let settings = &self.settings;
        let cone = |at: f64| settings.cone.map_or(0.0, |cone| cone.height_mm(at));
        let behind = along - settings.length_mm;
        if behind > 0.0 {
            cone(settings.length_mm) + behind * settings.tool.lead_deg().to_radians().tan()
        } else {
            cone(along)
        }
    }

    /// Moves the tip here; the edge covers the positions ahead of it.
    pub fn cut(&mut self, along: f64, out: f64) {
        self.deepest = self.deepest.max(self.contour(along) - out);
        let tool = &self.settings.tool;
        let (from, height) = (self.before.0.min(along), self.before.1.max(out));
        self.before = (along, out);
        let first = (from / STEP_MM - 1e-9).ceil().max(0.0) as usize;
        for (i, top) in self.tops.iter_mut().enumerate().skip(first) {
            let lead = i as f64 * STEP_MM - along;
            if lead > tool.overhang_mm() {
                break;
            }
            // Stock that the tip has passed since then is cut to its height.
            *top = top.min(if lead < 0.0 {
                height
            } else {
                out + lead * tool.slope()
            });
        }
    }

    /// Maximum distance of the tip below the contour, mm.
    pub fn deepest(&self) -> f64 {
        self.deepest
    }

    /// Maximum height of the stock left above the contour, mm.
    pub fn left(&self) -> f64 {
        let above = |(i, top): (usize, &f64)| top - self.contour(i as f64 * STEP_MM);
        self.tops.iter().enumerate().map(above).fold(0.0, f64::max)
    }
}
