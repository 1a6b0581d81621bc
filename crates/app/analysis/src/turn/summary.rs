//! A trial as text and as a JSON object.

use std::fmt::Write as _;

use evolvent_turning::Figures;
use serde_json::{Value, json};

use super::trial::TurningTrial;

/// One line of the comparison: label, values, time saved by the job in percent.
pub(crate) fn comparison(trial: &TurningTrial) -> Vec<(&'static str, Figures, f64)> {
    let saved = |figures: &Figures| 100.0 * (1.0 - trial.figures.time_s / figures.time_s);
    trial
        .fixed
        .iter()
        .map(|(name, figures)| (*name, *figures, saved(figures)))
        .collect()
}

fn figures_object(figures: &Figures, set_load: f64) -> Value {
    json!({
        "passes": figures.passes,
        "time_s": figures.time_s,
        "air_s": figures.air_s,
        "return_s": figures.return_s,
        "back_offs": figures.back_offs,
        "peak_n": figures.peak,
        "peak_over_set": figures.peak / set_load,
        "over_120_s": figures.over_120_s,
        "longest_over_130_s": figures.over_130_s,
        "residual_mm": figures.residual_mm,
    })
}

impl TurningTrial {
    /// The trial as text; with `log`, every state change and its reason.
    #[must_use]
    pub fn text(&self, log: bool) -> String {
        let (figures, settings) = (&self.figures, &self.job.settings);
        let regime = &settings.regime;
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{} on {}: {} (simulated stock and sensor)\n  \
             set load {:.0} N; feed {:.3} to {:.3} mm/rev; backs off from {:.3} mm to {:.3} mm at {:.4} \
             mm/rev; full feed \
             below {:.3} mm",
            self.job.name,
            self.machine,
            self.outcome(),
            regime.set_load,
            regime.feed_min_mm_rev,
            regime.feed_max_mm_rev,
            regime.depth_max_mm,
            regime.depth_back_off_mm,
            regime.feed_back_off_mm_rev,
            regime.depth_full_feed_mm,
        );
        let _ = writeln!(
            text,
            "  {} passes (equation 5: {}), {} times backed off, {:.1} s, of which {:.1} s in air and {:.1} \
             s moving back",
            figures.passes,
            regime.passes(self.highest_mm),
            figures.back_offs,
            figures.time_s,
            figures.air_s,
            figures.return_s
        );
        let _ = writeln!(
            text,
            "  load at most {:.3} of the set load, above 1.2 for {:.3} s, above 1.3 for {:.3} s at a \
             stretch (a revolution \
             takes {:.3} s)\n  left standing at most {:.4} mm",
            figures.peak / regime.set_load,
            figures.over_120_s,
            figures.over_130_s,
            settings.turn_s(),
            figures.residual_mm
        );
        let _ = writeln!(
            text,
            "\n  against fixed passes (G82)            passes   time s   peak   time saved"
        );
        for (name, fixed, saved) in comparison(self) {
            let _ = writeln!(
                text,
                "    {name:<34}{:>7}{:>9.1}{:>7.3}{saved:>11.1} %",
                fixed.passes,
                fixed.time_s,
                fixed.peak / regime.set_load
            );
        }
        if log {
            let _ = writeln!(text);
            for change in &self.changes {
                let _ = writeln!(
                    text,
                    "  {:9.3} s  pass {:<3} {:>8.2} mm along, {:>6.3} mm out, {:>6.0} N, {:.3} mm/rev: \
                     {:?}, because {}",
                    change.cycle as f64 * settings.period_s,
                    change.pass,
                    change.along_mm,
                    change.out_mm,
                    change.load,
                    change.feed_mm_rev,
                    change.to,
                    change.reason.text()
                );
            }
        }
        text
    }

    /// The trial as one object.
    #[must_use]
    pub fn json(&self) -> Value {
        let regime = &self.job.settings.regime;
        let fixed: serde_json::Map<_, _> = self
            .fixed
            .iter()
            .map(|(name, figures)| ((*name).to_owned(), figures_object(figures, regime.set_load)))
            .collect();
        json!({
            "job": self.job.name,
            "machine": self.machine,
            "outcome": self.outcome(),
            "simulated": true,
            "regime": {
                "set_n": regime.set_load,
                "feed_back_off_mm_rev": regime.feed_back_off_mm_rev,
                "depth_max_mm": regime.depth_max_mm,
                "depth_back_off_mm": regime.depth_back_off_mm,
                "depth_full_feed_mm": regime.depth_full_feed_mm,
                "passes": regime.passes(self.highest_mm),
                "law_misfit": self.job.law_misfit,
            },
            "figures": figures_object(&self.figures, regime.set_load),
            "fixed": fixed,
            "transitions": self.changes.iter().map(|change| json!({
                "time_s": change.cycle as f64 * self.job.settings.period_s,
                "pass": change.pass,
                "from": format!("{:?}", change.from),
                "to": format!("{:?}", change.to),
                "reason": change.reason.text(),
                "along_mm": change.along_mm,
                "out_mm": change.out_mm,
                "load_n": change.load,
                "feed_mm_rev": change.feed_mm_rev,
                "depth_mm": change.depth_mm,
            })).collect::<Vec<_>>(),
        })
    }
}
