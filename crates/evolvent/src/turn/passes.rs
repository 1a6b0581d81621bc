//! The passes that were found, as a part program.

use std::fmt::Write as _;

use super::trial::{Stretch, Trial};

/// A feed stretch shorter than this is joined to its neighbour, mm.
const SHORT_MM: f64 = 0.5;
/// The same in rapid.
const TINY_MM: f64 = 0.06;

/// RS274/NGC with X as the radius. It fits this stock only: no load is looked at.
pub(crate) fn program(trial: &Trial) -> String {
    let (cut, settings) = (&trial.job.cut, &trial.job.settings);
    let mut text = String::new();
    let place = |along: f64, out: f64| cut.position_mm(along, out);
    let (x, z) = place(trial.start.0, trial.start.1);
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "(passes of {}, found by self-programmed turning on a simulated stock)\n(they fit that stock only: nothing \
         watches the load)\nG21 G18 G90 G94 G8 G61\nS{:.0} M3\nG0 X{x:.4}\nG0 Z{z:.4}",
        trial.job.name, settings.spindle_rpm
    );
    let mut from = trial.start;
    for stretch in joined(&trial.stretches, trial.start) {
        let to = (stretch.to_along_mm, stretch.to_out_mm);
        let (x, z) = place(to.0, to.1);
        let _ = match stretch.turns {
            Some(turns) => {
                let feed = length(from, to) / turns * settings.spindle_rpm;
                writeln!(text, "G1 X{x:.4} Z{z:.4} F{feed:.2}")
            }
            None => writeln!(text, "G0 X{x:.4} Z{z:.4}"),
        };
        from = to;
    }
    text.push_str("M5\nM2\n");
    text
}

fn length(from: (f64, f64), to: (f64, f64)) -> f64 {
    (to.0 - from.0).hypot(to.1 - from.1)
}

/// Joins what is short: feeding starts and ends with many changes of feed, moves across with the end of braking.
fn joined(stretches: &[Stretch], start: (f64, f64)) -> Vec<Stretch> {
    let mut list: Vec<(Stretch, f64)> = Vec::new();
    let mut from = start;
    for stretch in stretches {
        let to = (stretch.to_along_mm, stretch.to_out_mm);
        let own = length(from, to);
        from = to;
        if let Some((last, before)) = list.last_mut() {
            let short = own.min(*before);
            let joins = match (last.turns, stretch.turns) {
                (Some(turns), Some(more)) if short < SHORT_MM && last.to_out_mm == to.1 => {
                    last.turns = Some(turns + more);
                    true
                }
                (None, None) => short < TINY_MM,
                _ => false,
            };
            if joins {
                (last.to_along_mm, last.to_out_mm) = to;
                *before += own;
                continue;
            }
        }
        list.push((*stretch, own));
    }
    list.into_iter().map(|(stretch, _)| stretch).collect()
}
