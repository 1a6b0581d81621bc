//! The picture: passes over the stock, feed and load over time, and time saved.

use std::fmt::Write as _;

use super::summary::comparison;
use super::trial::{Sample, TurningTrial};
use crate::figure::scale::{Scale, nice_ticks};
use crate::figure::svg::{Anchor, Pen, Svg};

const WIDTH: f64 = 1100.0;
const LEFT: f64 = 70.0;
const RIGHT: f64 = 1070.0;
const STOCK_HEIGHT: f64 = 250.0;
const STRIP_HEIGHT: f64 = 150.0;
/// Colours of the passes, in rotation.
const PASSES: [&str; 6] = ["#1f5fa8", "#c8501e", "#2e8b57", "#8b3fa8", "#b8860b", "#178a9e"];
const STYLE: &str = "text{font:12px sans-serif;fill:#222}.title{font-size:19px;font-weight:600}.head{font-size:14px;font-weight:600}.small{font-size:11px;fill:#555}.grid{stroke:#e4e4e4}.frame{fill:none;stroke:#888}.set{stroke:#b00020;stroke-dasharray:6 4}.final{stroke:#b5b5b5;stroke-width:5}";

/// The whole picture.
pub(crate) fn svg(trial: &TurningTrial, machine: &str) -> String {
    let mut svg = Svg::new(WIDTH);
    let figures = &trial.figures;
    svg.text(
        (20.0, 32.0),
        Anchor::Start,
        "title",
        &format!(
            "{} on {machine}: {}",
            trial.job.name,
            match (figures.done, trial.is_simulated) {
                (true, true) => "at size",
                // The controller has made its last pass, but nothing measures the workpiece.
                (true, false) => "done",
                (false, _) => "stopped",
            }
        ),
    );
    svg.text(
        (20.0, 52.0),
        Anchor::Start,
        "small",
        &format!(
            "{:.1} s, {} passes, load at most {:.2} of the set load; {}",
            figures.time_s,
            figures.passes,
            figures.peak / trial.job.settings.regime.set_load,
            if trial.is_simulated {
                "stock and sensor are simulated"
            } else {
                "the load is that of the sensor, the workpiece is not measured"
            }
        ),
    );
    let below = stock(&mut svg, trial, 90.0);
    let below = strip(
        &mut svg,
        trial,
        below + 60.0,
        "Feed, mm/rev (moves back left out)",
        1.15 * trial.job.settings.regime.feed_max_mm_rev,
        &[
            trial.job.settings.regime.feed_min_mm_rev,
            trial.job.settings.regime.feed_max_mm_rev,
        ],
        |sample| sample.feeds.then_some(sample.feed_mm_rev),
    );
    let set = trial.job.settings.regime.set_load;
    let below = strip(
        &mut svg,
        trial,
        below + 60.0,
        "Load, N (the largest of each moment; set load dashed)",
        (1.08 * figures.peak).max(1.15 * set),
        &[set],
        |sample| Some(sample.load),
    );
    let below = if trial.fixed.is_empty() {
        below + 30.0
    } else {
        bars(&mut svg, trial, below + 66.0)
    };
    svg.finish(below + 20.0, STYLE)
}

fn stock(svg: &mut Svg, trial: &TurningTrial, top: f64) -> f64 {
    let settings = &trial.job.settings;
    let (length, whole) = (settings.length_mm, settings.length_mm + settings.shoulder_mm());
    let head = trial.samples.iter().map(|s| -s.along_mm).fold(5.0, f64::max);
    let height = if trial.is_simulated {
        trial.highest_mm
    } else {
        trial
            .samples
            .iter()
            .map(|sample| sample.out_mm)
            .fold(0.0, f64::max)
    };
    let high = 1.2 * height.max(1.0);
    let across = Scale::new(-head, 1.02 * whole, LEFT, RIGHT);
    let up = Scale::new(-0.06 * high, high, top + STOCK_HEIGHT, top);
    svg.text(
        (LEFT, top - 10.0),
        Anchor::Start,
        "head",
        if trial.is_simulated {
            "Passes over the stock: height above the final size, mm"
        } else {
            "Passes: height above the final size, mm"
        },
    );
    grid(svg, &across, &up, top, STOCK_HEIGHT);
    if trial.is_simulated {
        blank(svg, trial, &across, &up, whole);
    }
    // Drawn before the passes, because the last ones are on it.
    svg.line(
        (across.at(0.0), up.at(0.0)),
        (across.at(length), up.at(0.0)),
        "final",
    );
    // Along the shoulder that the edge leaves along itself.
    let foot = settings.height_at_end_mm();
    svg.line(
        (across.at(length), up.at(foot)),
        (
            across.at(whole),
            up.at(foot + (whole - length) * settings.tool.slope()),
        ),
        "final",
    );
    let mut pen = Pen::default();
    let (mut pass, mut drawing) = (0, false);
    let colour = |pass: u32| PASSES[pass.saturating_sub(1) as usize % PASSES.len()];
    for sample in &trial.samples {
        if sample.pass != pass || !sample.feeds {
            svg.stroke(&pen, colour(pass), 1.6, "");
            pen = Pen::default();
            (pass, drawing) = (sample.pass, false);
        }
        if sample.feeds {
            let (x, y) = (across.at(sample.along_mm), up.at(sample.out_mm));
            if drawing {
                pen.line_to(x, y);
            } else {
                pen.move_to(x, y);
                drawing = true;
            }
        }
    }
    svg.stroke(&pen, colour(pass), 1.6, "");
    key(svg, trial.figures.passes, top - 10.0);
    svg.frame((LEFT, top), (RIGHT - LEFT, STOCK_HEIGHT));
    svg.text(
        (RIGHT, top + STOCK_HEIGHT + 30.0),
        Anchor::End,
        "small",
        "from the face at which the tool comes in, mm",
    );
    top + STOCK_HEIGHT
}

/// The simulated stock over its whole length, mm.
fn blank(svg: &mut Svg, trial: &TurningTrial, across: &Scale, up: &Scale, whole: f64) {
    let mut blank = Pen::default();
    blank.move_to(across.at(0.0), up.at(0.0));
    for i in 0..=1000 {
        let position = whole * f64::from(i) / 1000.0;
        blank.line_to(across.at(position), up.at(trial.blank.height_mm(position)));
    }
    blank.line_to(across.at(whole), up.at(0.0));
    blank.close();
    svg.fill(&blank, "#e9e2d6");
    for &(from, to, _) in &trial.blank.hard_spots {
        svg.text(
            (across.at(0.5 * (from + to)), up.at(0.0) + 12.0),
            Anchor::Middle,
            "small",
            "hard",
        );
    }
}

/// The legend of the pass colours, at the right end of a heading.
fn key(svg: &mut Svg, passes: u32, y: f64) {
    let shown = (passes as usize).min(PASSES.len());
    let mut x = RIGHT;
    let mut entry = |name: &str, width: f64, colour: &str, thick: f64| {
        svg.text((x, y), Anchor::End, "small", name);
        let mut pen = Pen::default();
        pen.move_to(x - width - 22.0, y - 4.0);
        pen.line_to(x - width - 4.0, y - 4.0);
        svg.stroke(&pen, colour, thick, "");
        x -= width + 34.0;
    };
    entry("final size", 52.0, "#b5b5b5", 5.0);
    for pass in (0..shown).rev() {
        let again = if pass + 1 == shown && passes as usize > shown {
            " and so on"
        } else {
            ""
        };
        entry(
            &format!("pass {}{again}", pass + 1),
            38.0 + 5.6 * again.len() as f64,
            PASSES[pass],
            2.0,
        );
    }
}

fn grid(svg: &mut Svg, across: &Scale, up: &Scale, top: f64, height: f64) {
    for tick in nice_ticks(across.low(), across.high(), 10) {
        let x = across.at(tick);
        svg.line((x, top), (x, top + height), "grid");
        svg.text(
            (x, top + height + 15.0),
            Anchor::Middle,
            "small",
            &tick.to_string(),
        );
    }
    for tick in nice_ticks(up.low(), up.high(), 5) {
        let y = up.at(tick);
        svg.line((LEFT, y), (RIGHT, y), "grid");
        svg.text((LEFT - 6.0, y + 4.0), Anchor::End, "small", &tick.to_string());
    }
}

fn strip(
    svg: &mut Svg,
    trial: &TurningTrial,
    top: f64,
    title: &str,
    high: f64,
    marks: &[f64],
    value: impl Fn(&Sample) -> Option<f64>,
) -> f64 {
    let end = trial.samples.last().map_or(1.0, |sample| sample.time_s);
    let across = Scale::new(0.0, end, LEFT, RIGHT);
    let up = Scale::new(0.0, high, top + STRIP_HEIGHT, top);
    svg.text((LEFT, top - 10.0), Anchor::Start, "head", title);
    grid(svg, &across, &up, top, STRIP_HEIGHT);
    for mark in marks {
        svg.line((LEFT, up.at(*mark)), (RIGHT, up.at(*mark)), "set");
    }
    // Minimum and maximum of each pixel: every peak is shown.
    let columns = (RIGHT - LEFT) as usize;
    let mut ranges: Vec<Option<(f64, f64)>> = vec![None; columns + 1];
    for sample in &trial.samples {
        let Some(value) = value(sample) else { continue };
        let column = (((across.at(sample.time_s) - LEFT).max(0.0)) as usize).min(columns);
        let range = ranges[column].get_or_insert((value, value));
        *range = (range.0.min(value), range.1.max(value));
    }
    let mut pen = Pen::default();
    let mut drawing = false;
    for (column, range) in ranges.iter().enumerate() {
        let Some((low, peak)) = range else {
            drawing = false;
            continue;
        };
        let x = LEFT + column as f64 + 0.5;
        if drawing {
            pen.line_to(x, up.at(*peak));
        } else {
            pen.move_to(x, up.at(*peak));
            drawing = true;
        }
        pen.line_to(x, up.at(*low));
    }
    svg.stroke(&pen, "#1f5fa8", 1.0, "");
    svg.frame((LEFT, top), (RIGHT - LEFT, STRIP_HEIGHT));
    svg.text(
        (RIGHT, top + STRIP_HEIGHT + 30.0),
        Anchor::End,
        "small",
        "time, s",
    );
    top + STRIP_HEIGHT
}

/// Durations compared with fixed passes.
fn bars(svg: &mut Svg, trial: &TurningTrial, top: f64) -> f64 {
    svg.text(
        (LEFT, top - 12.0),
        Anchor::Start,
        "head",
        "Time against fixed passes (G82)",
    );
    let mut rows = vec![("this job, stock not known", trial.figures, None)];
    rows.extend(
        comparison(trial)
            .into_iter()
            .map(|(name, figures, saved)| (name, figures, Some(saved))),
    );
    let longest = rows.iter().map(|row| row.1.time_s).fold(1.0, f64::max);
    let scale = Scale::new(0.0, longest, LEFT + 220.0, RIGHT - 290.0);
    let mut y = top;
    for (name, figures, saved) in rows {
        svg.text((LEFT + 212.0, y + 14.0), Anchor::End, "", name);
        let colour = if saved.is_none() { PASSES[0] } else { "#b9b9b9" };
        svg.rect(
            (scale.at(0.0), y),
            (scale.at(figures.time_s) - scale.at(0.0), 20.0),
            colour,
        );
        let saving = saved.map_or(String::new(), |saved| {
            if saved >= 0.0 {
                format!("; this job takes {saved:.1} % less")
            } else {
                format!("; this job takes {:.1} % more", -saved)
            }
        });
        svg.text(
            (scale.at(figures.time_s) + 8.0, y + 14.0),
            Anchor::Start,
            "",
            &format!("{:.1} s, {} passes{saving}", figures.time_s, figures.passes),
        );
        y += 28.0;
    }
    y
}

/// The picture with the log of state changes, as one page.
pub(crate) fn html(trial: &TurningTrial, machine: &str, svg: &str) -> String {
    let escape = |text: &str| {
        text.replace('&', "&amp;")
            .replace('<', "&lt;")
            .replace('>', "&gt;")
    };
    let mut page = format!(
        "<!doctype html><html lang=\"en\"><meta \
         charset=\"utf-8\"><title>{0}</title><style>body{{font:14px sans-serif;margin:24px;max-width:1120px}}table{{border-collapse:collapse}}td,th{{padding:3px 10px;border-bottom:1px solid #ddd;text-align:right}}td:last-child,th:last-child{{text-align:left}}svg{{max-width:100%;height:auto}}</style>{svg}<h2>What \
         happened</h2><p>{1} on {2}: {3}.</p><ul>",
        escape(&trial.job.name),
        escape(&trial.job.name),
        escape(machine),
        escape(&trial.outcome())
    );
    // Writing to a string cannot fail.
    for note in &trial.notes {
        let _ = write!(page, "<li>{}</li>", escape(note));
    }
    page.push_str(
        "</ul><table><tr><th>time s<th>pass<th>place mm<th>height mm<th>load N<th>feed mm/rev<th>state and \
         reason</tr>",
    );
    for change in &trial.changes {
        let _ = write!(
            page,
            "<tr><td>{:.2}<td>{}<td>{:.2}<td>{:.3}<td>{:.0}<td>{:.3}<td>{:?}: {}</tr>",
            change.cycle as f64 * trial.job.settings.period_s,
            change.pass,
            change.along_mm,
            change.out_mm,
            change.load,
            change.feed_mm_rev,
            change.to,
            escape(&change.reason.text())
        );
    }
    page.push_str("</table></html>\n");
    page
}
