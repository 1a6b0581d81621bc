//! A trial as text and as a JSON object.

use std::fmt::Write as _;

use evolvent_turning::Figures;
use serde_json::{Value, json};

use super::trial::TurningTrial;

/// One line of the comparison: label, values, time saved by the job in percent.
pub(crate) fn comparison(trial: &TurningTrial) -> Vec<(&'static str, Figures, f64)> {
    let saved = |figures: &Figures| 100.0 * (1.0 - trial.figures.time_s / figures.time_s);
    // A job that was stopped has saved no time.
    let fixed = trial.fixed.iter().filter(|_| trial.figures.done);
    fixed
        .map(|(name, figures)| (*name, *figures, saved(figures)))
        .collect()
}

/// `is_measured`: whether the workpiece is known, so that the remaining material is known too.
fn figures_object(figures: &Figures, set_load: f64, is_measured: bool) -> Value {
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
        "residual_mm": is_measured.then_some(figures.residual_mm),
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
            "{} on {}: {} ({})\n  \
             set load {:.0} N; feed {:.3} to {:.3} mm/rev; backs off from {:.3} mm to {:.3} mm at {:.4} \
             mm/rev; full feed \
             below {:.3} mm",
            self.job.name,
            self.machine,
            self.outcome(),
            if self.is_simulated {
                "simulated stock and sensor"
            } else {
                "load of the sensor"
            },
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
            "  {} passes{}, {} times backed off, {:.1} s, of which {:.1} s in air and {:.1} s moving back",
            figures.passes,
            // The height of the stock is known only if the workpiece is simulated.
            if self.is_simulated {
                format!(" (equation 5: {})", regime.passes(self.highest_mm))
            } else {
                String::new()
            },
            figures.back_offs,
            figures.time_s,
            figures.air_s,
            figures.return_s
        );
        let _ = writeln!(
            text,
            "  load at most {:.3} of the set load, above 1.2 for {:.3} s, above 1.3 for {:.3} s at a \
             stretch (a revolution \
             takes {:.3} s)\n  left standing{}",
            figures.peak / regime.set_load,
            figures.over_120_s,
            figures.over_130_s,
            settings.turn_s(),
            if self.is_simulated {
                format!(" at most {:.4} mm", figures.residual_mm)
            } else {
                ": not measured".to_owned()
            }
        );
        let compared = comparison(self);
        if !compared.is_empty() {
            let _ = writeln!(
                text,
                "\n  against fixed passes (G82)            passes   time s   peak   time saved"
            );
        }
        for (name, fixed, saved) in compared {
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
            .map(|(name, figures)| ((*name).to_owned(), figures_object(figures, regime.set_load, true)))
            .collect();
        json!({
            "job": self.job.name,
            "machine": self.machine,
            "outcome": self.outcome(),
            "simulated": self.is_simulated,
            "regime": {
                "set_n": regime.set_load,
                "feed_back_off_mm_rev": regime.feed_back_off_mm_rev,
                "depth_max_mm": regime.depth_max_mm,
                "depth_back_off_mm": regime.depth_back_off_mm,
                "depth_full_feed_mm": regime.depth_full_feed_mm,
                "passes": self.is_simulated.then(|| regime.passes(self.highest_mm)),
                "law_misfit": self.job.law_misfit,
            },
            "figures": figures_object(&self.figures, regime.set_load, self.is_simulated),
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use evolvent_runtime::Clock;

    use super::*;
    use crate::{TurningRoute, read_process};

    #[test]
    fn results_on_a_real_workpiece_do_not_say_simulated() {
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config");
        let job = read_process(&config.join("processes/turn-shaft.toml")).unwrap();
        let route = TurningRoute {
            clock: Clock::Virtual,
            trace: None,
            bus: false,
            bus_prefix: None,
            on_start: &|_| Ok(()),
        };
        let mut trial = TurningTrial::run(job, &config.join("machines/lathe-2axis.toml"), &route).unwrap();
        assert!(trial.text(false).contains("(simulated stock and sensor)"));
        assert!(trial.json()["simulated"] == true && trial.json()["figures"]["residual_mm"].is_number());
        assert!(trial.svg().contains("at size") && trial.svg().contains("G82"));
        assert!(trial.program().unwrap().contains("\nS500 M3\n"));

        // As after a run in real time.
        trial.is_simulated = false;
        trial.fixed.clear();
        trial.notes.clear();
        trial.job.settings.spindle_rpm = 487.5;
        let (text, json) = (trial.text(false), trial.json());
        assert!(
            text.contains("(load of the sensor)") && text.contains("left standing: not measured"),
            "{text}"
        );
        for word in ["simulated", "equation 5", "G82"] {
            assert!(!text.contains(word), "{word}: {text}");
        }
        assert_eq!(json["simulated"], false);
        assert!(json["figures"]["residual_mm"].is_null() && json["regime"]["passes"].is_null());
        // The log on the page has the reasons given by the controller, for which the last pass is at size.
        let picture = trial.svg();
        for word in ["simulated", "at size", "G82", "over the stock"] {
            assert!(!picture.contains(word), "{word}");
        }
        let program = trial.program().unwrap();
        assert!(
            !program.contains("simulated") && program.contains("\nS487.5 M3\n"),
            "{}",
            &program[..300]
        );

        // Its last pass would end in the middle.
        trial.figures.done = false;
        assert_eq!(trial.program(), None);
    }
}
