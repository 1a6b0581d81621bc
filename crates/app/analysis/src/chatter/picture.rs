//! The picture of a cut that may vibrate: phase portrait, force, and cycles over speed.

use evolvent_chatter::{Case, Model, StabilityVerdict};

use super::answer::{Answer, SweepPoint};
use super::chart::{Chart, STABLE, STYLE, UNSTABLE, WIDTH, foot, range_of};
use crate::figure::svg::{Anchor, Svg};

const BISTABLE_BAND: &str = "#fdf1d8";
const EXCITED_BAND: &str = "#fbe3dc";
const LOST_BAND: &str = "#e6d5e6";

pub(crate) fn svg(case: &Case, answer: &Answer) -> String {
    let mut svg = Svg::new(WIDTH);
    svg.text((20.0, 32.0), Anchor::Start, "title", &case.name);
    let tool = &answer.tool;
    let subtitle = format!(
        "{}: {} m/min, {} mm deep, {} mm/rev; blue: stable, orange dashed: unstable",
        answer.assessment.verdict.as_str(),
        tool.speed_m_min,
        tool.depth_mm,
        tool.feed_mm_rev
    );
    svg.text((20.0, 52.0), Anchor::Start, "small", &subtitle);
    portrait(&mut svg, answer);
    force(&mut svg, answer);
    amplitude(&mut svg, answer);
    frequency(&mut svg, answer);
    growth(&mut svg, answer);
    let end = foot(&mut svg, 1226.0, &answer.assumptions);
    svg.finish(end, STYLE)
}

/// The motion along the cutting speed: deflection and velocity.
fn portrait(svg: &mut Svg, answer: &Answer) {
    let Ok(model) = Model::new(answer.tool, answer.laws.laws()) else {
        return;
    };
    let orbit = |state: evolvent_chatter::State| {
        let (_, z) = model.machine_axes(state[0], state[1]);
        let (_, velocity) = model.machine_axes(state[2], state[3]);
        Some((1e3 * z, 60.0 * velocity))
    };
    let orbits: Vec<(bool, Vec<_>)> = answer
        .assessment
        .cycles
        .iter()
        .map(|checked| {
            let points = (0..=240).map(|k| orbit(checked.cycle.state(f64::from(k) / 240.0)));
            (checked.verified.stable(), points.collect())
        })
        .collect();
    let [v1, v2] = answer.assessment.equilibrium.deflection_m;
    let rest = 1e3 * model.machine_axes(v1, v2).1;
    let all = || orbits.iter().flat_map(|(_, points)| points.iter().flatten());
    let x = range_of(
        all().map(|point| point.0).chain([rest - 1e-3, rest + 1e-3]),
        f64::NEG_INFINITY,
    );
    let y = range_of(all().map(|point| point.1).chain([-0.1, 0.1]), f64::NEG_INFINITY);
    let chart = Chart::new((70.0, 110.0), (500.0, 360.0), x, y);
    chart.frame(
        svg,
        "Phase portrait",
        "z, deflection along the cutting speed, mm",
        "velocity of z, m/min",
    );
    for (stable, points) in &orbits {
        if *stable {
            chart.line(svg, points, STABLE, 2.2, "");
        } else {
            chart.line(svg, points, UNSTABLE, 1.6, "stroke-dasharray=\"7 4\"");
        }
    }
    svg.circle(chart.project(rest, 0.0), 4.0, "mark");
    if orbits.is_empty() {
        let text = match answer.assessment.verdict {
            StabilityVerdict::OutOfModel => "no cycle within the model: vibration grows out of it",
            _ => "no cycle: every disturbance within the model dies out",
        };
        svg.text((320.0, 140.0), Anchor::Middle, "", text);
    }
}

/// The force over the speed, with the part covered by the vibration.
fn force(svg: &mut Svg, answer: &Answer) {
    let tool = &answer.tool;
    let Ok(section) = answer.laws.law.section(tool.feed_mm_rev) else {
        return;
    };
    let reached = answer
        .assessment
        .cycles
        .iter()
        .map(|checked| checked.cycle.speed_m_min[1])
        .fold(0.0, f64::max);
    let most = answer.asked.sweep.speed_m_min[1].max(1.05 * reached);
    let at = |speed: f64| {
        let force = section.force(speed, tool.depth_mm).ok()?;
        Some((speed, force.tangential_n))
    };
    let least = tool.floor_m_min.max(0.02 * most);
    let curve: Vec<_> = (0..=400)
        .map(|k| at(least + (most - least) * f64::from(k) / 400.0))
        .collect();
    let y = range_of(curve.iter().flatten().map(|point| point.1), 0.0);
    let chart = Chart::new((670.0, 110.0), (500.0, 360.0), [0.0, most], y);
    let covered = answer.laws.law.covered().speed_m_min;
    if covered[1].is_finite() {
        chart.band(svg, covered[0], covered[1], "#eef4ee");
    }
    let head = format!("Tangential force over speed, {}", answer.laws.definition.name);
    chart.frame(
        svg,
        &head,
        "cutting speed, m/min",
        "N, at the depth and feed of the cut; green: where the law's data are from",
    );
    chart.line(svg, &curve, "#444", 1.4, "");
    for checked in &answer.assessment.cycles {
        let [low, high] = checked.cycle.speed_m_min;
        let part: Vec<_> = (0..=200)
            .map(|k| at(low + (high - low) * f64::from(k) / 200.0))
            .collect();
        if checked.verified.stable() {
            chart.line(svg, &part, STABLE, 4.0, "stroke-opacity=\".55\"");
        } else {
            chart.line(svg, &part, UNSTABLE, 2.2, "stroke-dasharray=\"7 4\"");
        }
    }
    if let Some((speed, force)) = at(tool.speed_m_min) {
        svg.circle(chart.project(speed, force), 4.0, "mark");
    }
}

/// Ranges of the speed with a verdict.
fn bands(svg: &mut Svg, chart: &Chart, sweep: &[SweepPoint]) {
    let step = match sweep {
        [first, second, ..] => 0.5 * (second.speed_m_min - first.speed_m_min),
        _ => return,
    };
    // Adjacent ranges with the same verdict form one band, without seams.
    let mut start = 0;
    for k in 0..sweep.len() {
        let ends = k + 1 == sweep.len() || sweep[k + 1].verdict != sweep[k].verdict;
        if !ends {
            continue;
        }
        let colour = match sweep[k].verdict {
            Some(StabilityVerdict::Bistable) => Some(BISTABLE_BAND),
            Some(StabilityVerdict::SelfExcited) => Some(EXCITED_BAND),
            Some(StabilityVerdict::OutOfModel) => Some(LOST_BAND),
            Some(StabilityVerdict::Stable) => None,
            None => Some("#dddddd"),
        };
        if let Some(colour) = colour {
            let (from, to) = (sweep[start].speed_m_min - step, sweep[k].speed_m_min + step);
            chart.band(svg, from, to, colour);
        }
        start = k + 1;
    }
}

/// Draws lines through the cycles of each kind: the largest stable, the largest unstable, and so on.
fn cycles(svg: &mut Svg, chart: &Chart, sweep: &[SweepPoint], value: impl Fn(&(f64, f64, bool)) -> f64) {
    for stable in [false, true] {
        for rank in 0..4 {
            let points: Vec<_> = sweep
                .iter()
                .map(|point| {
                    let mut of_kind = point.cycles.iter().filter(|cycle| cycle.2 == stable);
                    of_kind.nth(rank).map(|cycle| (point.speed_m_min, value(cycle)))
                })
                .collect();
            if stable {
                chart.line(svg, &points, STABLE, 2.2, "");
            } else {
                chart.line(svg, &points, UNSTABLE, 1.8, "stroke-dasharray=\"6 4\"");
            }
            // A single point makes no line.
            for (k, point) in points.iter().enumerate() {
                let alone = |k: Option<usize>| k.and_then(|k| points.get(k)).is_none_or(Option::is_none);
                if let Some((x, y)) = point
                    && alone(k.checked_sub(1))
                    && alone(Some(k + 1))
                {
                    svg.circle(chart.project(*x, *y), 2.5, "mark");
                }
            }
        }
    }
}

fn amplitude(svg: &mut Svg, answer: &Answer) {
    let sweep = &answer.sweep;
    let all = sweep
        .iter()
        .flat_map(|point| point.cycles.iter().map(|cycle| 1e3 * cycle.0));
    let y = [0.0, range_of(all.chain([0.0]), 0.0)[1].max(1e-3)];
    let chart = Chart::new((70.0, 560.0), (1100.0, 240.0), answer.asked.sweep.speed_m_min, y);
    bands(svg, &chart, sweep);
    chart.frame(
        svg,
        "Amplitude over speed",
        "",
        "of V2, mm; red: vibrates by itself, yellow: steady until an impulse sets it vibrating (both \
         branches are there), violet: grows out of the model",
    );
    cycles(svg, &chart, sweep, |cycle| 1e3 * cycle.0);
    chart.upright(svg, answer.tool.speed_m_min);
    let [slower, faster] = answer.stable_m_min;
    // Rounded away from the stability limit, as in the text.
    let slower = slower.map(|at| (at, 0.1 * f64::floor(10.0 * at)));
    let faster = faster.map(|at| (at, 0.1 * f64::ceil(10.0 * at)));
    for (stable, said) in slower.into_iter().chain(faster) {
        let [low, high] = answer.asked.sweep.speed_m_min;
        if (low..=high).contains(&stable) {
            let (x, y) = chart.project(stable, 0.0);
            svg.circle((x, y), 4.0, "mark");
            svg.text(
                (x, y - 9.0),
                Anchor::Middle,
                "small",
                &format!("stable: {said:.1} m/min"),
            );
        }
    }
}

fn frequency(svg: &mut Svg, answer: &Answer) {
    let sweep = &answer.sweep;
    let all = sweep
        .iter()
        .flat_map(|point| point.cycles.iter().map(|cycle| cycle.1));
    let [low, high] = range_of(all, 0.0);
    let middle = 0.5 * (low + high);
    // A nearly constant line is drawn as constant.
    let half = (0.5 * (high - low)).max(1e-3 * middle);
    let chart = Chart::new(
        (70.0, 872.0),
        (1100.0, 110.0),
        answer.asked.sweep.speed_m_min,
        [middle - half, middle + half],
    );
    bands(svg, &chart, sweep);
    chart.frame(svg, "Frequency over speed", "", "Hz");
    cycles(svg, &chart, sweep, |cycle| cycle.1);
    chart.upright(svg, answer.tool.speed_m_min);
}

fn growth(svg: &mut Svg, answer: &Answer) {
    let sweep = &answer.sweep;
    let points: Vec<_> = sweep
        .iter()
        .map(|point| point.growth_per_s.map(|growth| (point.speed_m_min, growth)))
        .collect();
    let y = range_of(
        points.iter().flatten().map(|point| point.1).chain([0.0]),
        f64::NEG_INFINITY,
    );
    let chart = Chart::new((70.0, 1054.0), (1100.0, 110.0), answer.asked.sweep.speed_m_min, y);
    bands(svg, &chart, sweep);
    chart.frame(
        svg,
        "Growth of small vibrations",
        "cutting speed, m/min",
        "1/s; above zero they grow",
    );
    chart.line(svg, &points, "#444", 1.6, "");
    chart.upright(svg, answer.tool.speed_m_min);
}
