//! The computed passes as a part program.

use std::fmt::Write as _;

use evolvent_config::ProgramNumber;
use evolvent_machine::TurningWords;
use evolvent_turning::{CutKind, TurningJob};

use super::trial::{Stretch, TurningTrial};

/// Feed sections shorter than this are merged with a neighbour, mm.
const SHORT_MM: f64 = 0.5;
/// The same for rapids.
const TINY_MM: f64 = 0.06;

/// RS274/NGC with X as the radius. The program fits this stock only: it does not observe the load.
pub(crate) fn program(trial: &TurningTrial) -> String {
    let (cut, settings) = (&trial.job.cut, &trial.job.settings);
    let mut text = String::new();
    let project = |along: f64, out: f64| {
        let (x, z) = cut.position_mm(along, out);
        (ProgramNumber::rounded(x, 4), ProgramNumber::rounded(z, 4))
    };
    let (x, z) = project(trial.start.0, trial.start.1);
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "(passes of {}, found by self-programmed turning {})\n(they fit that stock only: \
         nothing monitors the load)\nG21 G18 G90 G94 G8 G61\nS{} M3\nG0 X{x}\nG0 Z{z}",
        plain(&trial.job.name),
        if trial.is_simulated {
            "on a simulated stock"
        } else {
            "by the load of a sensor"
        },
        // Exact: the feeds below are computed from it.
        ProgramNumber::exact(settings.spindle_rpm)
    );
    let mut from = trial.start;
    let min_feed = settings.regime.feed_min_mm_rev;
    for stretch in joined(&trial.stretches, trial.start, min_feed) {
        let to = (stretch.to_along_mm, stretch.to_out_mm);
        let (x, z) = project(to.0, to.1);
        let _ = match stretch.turns {
            Some(turns) => {
                let feed = length(from, to) / turns * settings.spindle_rpm;
                writeln!(text, "G1 X{x} Z{z} F{}", ProgramNumber::rounded(feed, 2))
            }
            None => writeln!(text, "G0 X{x} Z{z}"),
        };
        from = to;
    }
    text.push_str("M5\nM2\n");
    text
}

/// The job as a program of one load-adaptive cycle: the tool approaches from outside and returns there.
pub(crate) fn cycle_program(job: &TurningJob, words: TurningWords) -> String {
    let (cut, settings) = (&job.cut, &job.settings);
    let (x, z) = cut.position_mm(0.0, settings.allowance_max_mm);
    let step_mm = settings.cone.map_or(settings.length_mm, |cone| cone.from_mm);
    let (end_x, end_z) = cut.position_mm(step_mm, 0.0);
    let (code, first, second) = match cut.kind {
        // In front of the face, down to the stock, then up to the face; or directly to the outside of the
        // stock.
        CutKind::Longitudinal => {
            let before = z + settings.tool.overhang_mm() + settings.clear_along_mm;
            ("G82", format!("G0 Z{before}\nG0 X{x}"), format!("G0 Z{z}"))
        }
        CutKind::Facing => {
            let before = x + settings.tool.overhang_mm() + settings.clear_along_mm;
            ("G75", format!("G0 X{before}\nG0 Z{z}"), format!("G0 X{x}"))
        }
    };
    // In G8, X is a radius, except for turning cycles of machines that always program diameters.
    let unit = match words {
        TurningWords::Diameter => 2.0,
        TurningWords::Radius | TurningWords::Mode => 1.0,
    };
    let end_x = unit * end_x;
    let cone = settings.cone.map_or_else(String::new, |cone| {
        let (x, z) = cut.position_mm(settings.length_mm, cone.height_mm(settings.length_mm));
        format!(" R{} L{z}", unit * x)
    });
    format!(
        "({}: load-adaptive passes)\nG21 G18 G90 G94 G8 G61 G97\nS{} M3\n{first}\n{second}\nF100\n{code} \
         X{end_x} \
         Z{end_z}{cone} Q1\nM5\nM2\n",
        plain(&job.name),
        cut.spindle_rpm
    )
}

/// Text that is valid in a comment.
fn plain(name: &str) -> String {
    let shown = |c: char| {
        if c.is_ascii_graphic() && !matches!(c, '(' | ')') {
            c
        } else {
            ' '
        }
    };
    name.chars().take(60).map(shown).collect()
}

fn length(from: (f64, f64), to: (f64, f64)) -> f64 {
    (to.0 - from.0).hypot(to.1 - from.1)
}

/// Merges short sections. A feed move starts and ends with many feed changes, a cross move with the end of
/// deceleration. Sections at a cutting feed stay unchanged: at their mean feed, the slow end of an engagement
/// would be cut at the feed of its beginning in air. Below `min_feed`, mm per revolution, an axis
/// accelerates, as it does in the program anyway.
fn joined(stretches: &[Stretch], start: (f64, f64), min_feed: f64) -> Vec<Stretch> {
    let mut list: Vec<(Stretch, f64)> = Vec::new();
    let mut from = start;
    for stretch in stretches {
        let to = (stretch.to_along_mm, stretch.to_out_mm);
        let own = length(from, to);
        from = to;
        if let Some((last, before)) = list.last_mut() {
            let short = own.min(*before);
            let joins = match (last.turns, stretch.turns) {
                (Some(turns), Some(more))
                    if short < SHORT_MM
                        && (*before < min_feed * turns || own < min_feed * more)
                        && last.climbs == stretch.climbs
                        && (stretch.climbs || last.to_out_mm == to.1) =>
                {
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
