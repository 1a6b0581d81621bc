//! The map of speed and depth.

use evolvent_chatter::{Case, MapCell, MapRange, StabilityVerdict};

use super::answer::Answer;
use super::chart::{Chart, STYLE, WIDTH, foot};
use crate::figure::svg::{Anchor, Svg};

/// Colour steps of the amplitude.
const TONES: usize = 9;
const STABLE: &str = "#e9f3ec";
const LOST: &str = "#7b5a86";
const NONE: &str = "#cccccc";
/// From small to large amplitude, where the cut is self-excited.
const EXCITED: [[f64; 3]; 2] = [[252.0, 216.0, 190.0], [166.0, 30.0, 20.0]];
/// The same where the cut is bistable.
const BISTABLE: [[f64; 3]; 2] = [[255.0, 244.0, 190.0], [196.0, 140.0, 0.0]];

pub(crate) fn svg(case: &Case, answer: &Answer) -> String {
    let mut svg = Svg::new(WIDTH);
    let title = format!("{}: speed and depth", case.name);
    svg.text((20.0, 32.0), Anchor::Start, "title", &title);
    let most = answer
        .maps
        .iter()
        .flat_map(|(_, cells)| cells.iter().map(|cell| cell.amplitude_m))
        .fold(0.0, f64::max);
    let mut top = legend(&mut svg, most) + 64.0;
    let range = &answer.asked.map;
    let two = answer.maps.len() > 1;
    let size = if two { (500.0, 380.0) } else { (1100.0, 520.0) };
    for (k, (feed, cells)) in answer.maps.iter().enumerate() {
        let left = if two && k % 2 == 1 { 670.0 } else { 70.0 };
        let chart = Chart::new((left, top), size, range.speed_m_min, range.depth_mm);
        draw(&mut svg, &chart, range, cells, most);
        chart.border(
            &mut svg,
            &format!("Feed {feed} mm/rev"),
            "cutting speed, m/min",
            "depth of cut, mm",
        );
        let tool = &answer.tool;
        let inside = |range: [f64; 2], value: f64| (range[0]..=range[1]).contains(&value);
        if *feed == tool.feed_mm_rev
            && inside(range.speed_m_min, tool.speed_m_min)
            && inside(range.depth_mm, tool.depth_mm)
        {
            svg.circle(chart.project(tool.speed_m_min, tool.depth_mm), 5.0, "mark");
        }
        if !two || k % 2 == 1 || k + 1 == answer.maps.len() {
            top += size.1 + 90.0;
        }
    }
    let end = foot(&mut svg, top - 20.0, &answer.assumptions);
    svg.finish(end, STYLE)
}

fn tone(ends: [[f64; 3]; 2], share: f64) -> String {
    let step = (share * TONES as f64).floor().clamp(0.0, (TONES - 1) as f64) / (TONES - 1) as f64;
    let mix = |k: usize| {
        (ends[0][k] + step * (ends[1][k] - ends[0][k]))
            .round()
            .clamp(0.0, 255.0) as u8
    };
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

fn colour(cell: &MapCell, most: f64) -> String {
    let share = cell.amplitude_m / most.max(1e-12);
    match cell.verdict {
        Some(StabilityVerdict::Stable) => STABLE.to_owned(),
        Some(StabilityVerdict::SelfExcited) => tone(EXCITED, share),
        Some(StabilityVerdict::Bistable) => tone(BISTABLE, share),
        Some(StabilityVerdict::OutOfModel) => LOST.to_owned(),
        None => NONE.to_owned(),
    }
}

/// Draws adjacent cells of one colour in a column as one rectangle.
fn draw(svg: &mut Svg, chart: &Chart, range: &MapRange, cells: &[MapCell], most: f64) {
    let edge =
        |range: [f64; 2], k: usize, count: usize| range[0] + (range[1] - range[0]) * k as f64 / count as f64;
    for (column, cells) in cells.chunks(range.rows.max(1)).enumerate() {
        let (left, right) = (
            chart.x.at(edge(range.speed_m_min, column, range.columns)),
            chart.x.at(edge(range.speed_m_min, column + 1, range.columns)),
        );
        let mut start = 0;
        for k in 0..cells.len() {
            let here = colour(&cells[k], most);
            if cells.get(k + 1).is_some_and(|next| colour(next, most) == here) {
                continue;
            }
            let (below, above) = (
                chart.y.at(edge(range.depth_mm, start, range.rows)),
                chart.y.at(edge(range.depth_mm, k + 1, range.rows)),
            );
            // Slightly wider, so that no gap shows between columns.
            svg.rect((left, above), (right - left + 0.3, below - above + 0.3), &here);
            start = k + 1;
        }
    }
}

fn legend(svg: &mut Svg, most: f64) -> f64 {
    let mut x = 20.0;
    for (fill, text) in [
        (STABLE, "stable: every disturbance dies out"),
        (LOST, "grows, by itself or after an impulse, until the model ends"),
        (NONE, "no steady cut, or no force"),
    ] {
        svg.rect((x, 48.0), (24.0, 12.0), fill);
        svg.text((x + 30.0, 58.5), Anchor::Start, "", text);
        x += 60.0 + 6.6 * text.len() as f64;
    }
    for (row, ends, text) in [
        (0.0, EXCITED, "vibrates by itself, amplitude"),
        (
            1.0,
            BISTABLE,
            "bistable: steady until an impulse sets it vibrating, amplitude",
        ),
    ] {
        let y = 68.0 + 20.0 * row;
        for k in 0..TONES {
            let share = (k as f64 + 0.5) / TONES as f64;
            svg.rect((20.0 + 18.0 * k as f64, y), (18.3, 12.0), &tone(ends, share));
        }
        let text = format!("{text} 0 to {:.3} mm", 1e3 * most);
        svg.text(
            (20.0 + 18.0 * TONES as f64 + 10.0, y + 10.5),
            Anchor::Start,
            "",
            &text,
        );
    }
    104.0
}
