//! Turning in fixed passes (G82), for comparison and for machines without a sensor.

use crate::axis::AxisDrive;
use crate::settings::TurningSettings;

/// Equal passes from a height down to the final size, at one feed.
#[derive(Clone, Debug)]
pub struct FixedPasses {
    along: AxisDrive,
    out: AxisDrive,
    heights: Vec<f64>,
    next: usize,
    leg: u8,
    dwell_s: f64,
    start: f64,
    clear: f64,
    speed: f64,
    settings: TurningSettings,
}

impl FixedPasses {
    /// Passes of `depth_mm` from `height_mm` of stock, the last one to size, at `feed_mm_rev`.
    #[must_use]
    pub fn new(settings: &TurningSettings, height_mm: f64, depth_mm: f64, feed_mm_rev: f64) -> Self {
        let count = (height_mm / depth_mm - 1e-9).ceil().clamp(1.0, 1e4) as u32;
        let heights = (1..=count)
            .map(|pass| (height_mm - depth_mm * f64::from(pass)).max(0.0))
            .collect();
        let start = -settings.tool.overhang_mm() - settings.clear_along_mm;
        let clear = settings.allowance_max_mm + settings.clear_out_mm;
        Self {
            along: AxisDrive::new(start, &settings.along_limits),
            out: AxisDrive::new(clear, &settings.out_limits),
            heights,
            next: 0,
            leg: 0,
            dwell_s: 0.0,
            start,
            clear,
            speed: settings.speed_mm_s(feed_mm_rev),
            settings: *settings,
        }
    }

    /// Number of passes.
    #[must_use]
    pub fn passes(&self) -> u32 {
        self.heights.len() as u32
    }

    /// Control period, s.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        self.settings.period_s
    }

    /// The next position along, height, and whether the tool feeds; `None` after the end.
    pub fn step(&mut self) -> Option<(f64, f64, bool)> {
        let settings = &self.settings;
        let height = self.heights.get(self.next).copied();
        match (self.leg, height) {
            (0, Some(height)) => {
                self.out.aim(height, settings.out_speed_mm_s);
                if self.out.has_arrived() {
                    self.leg = 1;
                }
            }
            (0, None) => return None,
            (1, height) => {
                self.along.aim(settings.end_mm(height.unwrap_or(0.0)), self.speed);
                if self.along.has_arrived() {
                    self.dwell_s += settings.period_s;
                    if self.dwell_s > 1.05 * settings.turn_s() {
                        (self.leg, self.dwell_s) = (2, 0.0);
                    }
                }
            }
            (2, height) => {
                let last = self.next + 1 >= self.heights.len();
                let to = if last {
                    self.clear
                } else {
                    height.unwrap_or(0.0) + settings.clear_out_mm
                };
                self.out.aim(to, settings.out_speed_mm_s);
                if self.out.has_arrived() {
                    self.leg = 3;
                }
            }
            _ => {
                self.along.aim(self.start, settings.rapid_mm_s);
                if self.along.has_arrived() {
                    self.next += 1;
                    self.leg = 0;
                }
            }
        }
        let feeds = self.leg == 1;
        let along = self.along.advance(settings.period_s);
        let out = self.out.advance(settings.period_s);
        Some((along.position, out.position, feeds))
    }
}
