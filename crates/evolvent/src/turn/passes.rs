//! The passes that were found, as a part program.

use std::fmt::Write as _;

use super::trial::{Stretch, Trial};

/// A feed stretch shorter than this is joined to its neighbour, mm.
const SHORT_MM: f64 = 0.5;

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
    for stretch in joined(&trial.stretches, trial.start) {
        let (x, z) = place(stretch.to_along_mm, stretch.to_out_mm);
        let _ = match stretch.feed_mm_rev {
            Some(feed) => {
                let feed = feed * settings.spindle_rpm;
                writeln!(text, "G1 X{x:.4} Z{z:.4} F{feed:.2}")
            }
            None => writeln!(text, "G0 X{x:.4} Z{z:.4}"),
        };
    }
    text.push_str("M5\nM2\n");
    text
}

fn joined(stretches: &[Stretch], start: (f64, f64)) -> Vec<Stretch> {
    let mut list: Vec<Stretch> = Vec::new();
    let mut from = start;
    for stretch in stretches {
        let to = (stretch.to_along_mm, stretch.to_out_mm);
        let length = (to.0 - from.0).abs() + (to.1 - from.1).abs();
        match (list.last_mut(), stretch.feed_mm_rev) {
            (Some(last), Some(feed))
                if length < SHORT_MM && last.feed_mm_rev.is_some() && last.to_out_mm == to.1 =>
            {
                (last.to_along_mm, last.to_out_mm) = to;
                last.feed_mm_rev = last.feed_mm_rev.map(|before| before.min(feed));
            }
            _ => list.push(*stretch),
        }
        from = to;
    }
    list
}
