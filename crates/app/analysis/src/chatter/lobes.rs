//! Stability lobes: computation and picture.

use evolvent_chatter::{Case, Chatter, ChatterError, ChatterKind, Limit, Lobes, MillingDelay};

use super::chart::{Chart, STABLE, STYLE, UNSTABLE, WIDTH, foot};
use crate::error::AnalysisError;
use crate::figure::svg::{Anchor, Svg};

/// Limits of period doubling.
const FLIP: &str = "#8a3ffc";

/// The lobes of turning or milling.
pub(crate) struct LobeAnswer {
    /// "turning" or "milling".
    pub(crate) kind: &'static str,
    /// Depths that are stable at every speed, per mode, in ascending order.
    pub(crate) minima: Vec<Limit>,
    /// Cuts per revolution.
    pub(crate) cuts_per_rev: u32,
    pub(crate) points: Vec<LobePoint>,
    /// Maximum depth considered, m.
    pub(crate) most_m: f64,
    /// Whether the delay equation was solved.
    pub(crate) exact: bool,
    pub(crate) assumptions: Vec<String>,
}

/// The limits at a spindle speed.
#[derive(Clone, Copy)]
pub(crate) struct LobePoint {
    pub(crate) speed_rpm: f64,
    /// From the frequency domain.
    pub(crate) quick: Option<Limit>,
    /// From the delay equation: depth, m, and the kind of chatter there.
    pub(crate) exact: Option<(f64, Chatter)>,
}

impl LobePoint {
    fn quick_m(&self) -> Option<f64> {
        self.quick.map(|limit| limit.depth_m)
    }

    fn exact_m(&self) -> Option<f64> {
        self.exact.map(|(depth, _)| depth)
    }

    /// The decisive limit, m.
    pub(crate) fn limit_m(&self, exact: bool) -> Option<f64> {
        if exact { self.exact_m() } else { self.quick_m() }
    }

    /// Kind and frequency, Hz, of the decisive limit. The frequency domain yields only Hopf limits.
    pub(crate) fn chatter(&self, exact: bool) -> Option<(ChatterKind, f64)> {
        if exact {
            self.exact
                .map(|(_, chatter)| (chatter.kind, chatter.frequency_hz))
        } else {
            self.quick.map(|limit| (ChatterKind::Hopf, limit.frequency_hz))
        }
    }
}

pub(crate) fn answers(case: &Case) -> Result<Vec<LobeAnswer>, AnalysisError> {
    let failed = |error: ChatterError| AnalysisError::Failed(error.to_string());
    let mut all = Vec::new();
    if let Some(turning) = &case.turning {
        let at = |rpm: f64| MillingDelay::turning(turning, rpm);
        let assumptions = vec![
            "regenerative chatter of a linear tool: cutting force in proportion to chip area, one \
             revolution of delay"
                .to_owned(),
            "no falling force over speed, no process damping; amplitudes are not predicted".to_owned(),
        ];
        // Both methods are exact for turning: the multiplier would only repeat the limit.
        all.push(answer(case, turning, "turning", false, at, assumptions).map_err(failed)?);
    }
    if let Some(milling) = &case.milling {
        let at = |rpm: f64| MillingDelay::milling(milling, rpm);
        let assumptions =
            vec![
            "regenerative chatter of a linear tool: straight, evenly spaced teeth, force in proportion to \
             chip area".to_owned(),
            "zero order: only the mean of the cutting force over a tooth; the delay equation takes all of \
             it".to_owned(),
            "no run-out, no process damping; amplitudes are not predicted".to_owned(),
        ];
        all.push(answer(case, milling, "milling", case.lobes.exact, at, assumptions).map_err(failed)?);
    }
    Ok(all)
}

fn answer(
    case: &Case,
    lobes: &(impl Lobes + Sync),
    kind: &'static str,
    exact: bool,
    delay: impl Fn(f64) -> Result<MillingDelay, ChatterError> + Sync,
    assumptions: Vec<String>,
) -> Result<LobeAnswer, ChatterError> {
    let minima = lobes.minima();
    let least = minima.first().map_or(1e-3, |limit| limit.depth_m);
    let most_m = case
        .lobes
        .max_depth_mm
        .map_or(6.0 * least, |depth| 1e-3 * depth)
        .clamp(1e-6, 1.0);
    let [from, to] = case.lobes.speed_rpm;
    let last = (case.lobes.points - 1) as f64;
    let point = |k: usize| {
        let rpm = from + (to - from) * k as f64 / last;
        let exact = if exact {
            let delay = delay(rpm)?;
            match delay.limit(most_m)? {
                Some(depth) => Some((depth, delay.chatter(depth)?)),
                None => None,
            }
        } else {
            None
        };
        Ok::<_, ChatterError>(LobePoint {
            speed_rpm: rpm,
            quick: lobes.limit_at(rpm),
            exact,
        })
    };
    // Two threads take interleaved halves, so that both take the same time.
    let count = case.lobes.points;
    let every_second = |first: usize| (first..count).step_by(2).map(point).collect::<Vec<_>>();
    let (even, odd) = std::thread::scope(|scope| {
        let other = scope.spawn(|| every_second(1));
        (every_second(0), other.join().unwrap_or_default())
    });
    let mut points = Vec::with_capacity(count);
    let mut odd = odd.into_iter();
    for point in even {
        points.push(point?);
        if let Some(point) = odd.next() {
            points.push(point?);
        }
    }
    Ok(LobeAnswer {
        kind,
        minima,
        cuts_per_rev: lobes.cuts_per_rev(),
        points,
        most_m,
        exact,
        assumptions,
    })
}

pub(crate) fn svg(case: &Case, answers: &[LobeAnswer]) -> String {
    let mut svg = Svg::new(WIDTH);
    svg.text((20.0, 32.0), Anchor::Start, "title", &case.name);
    svg.text((20.0, 52.0), Anchor::Start, "small", &case.description);
    let mut top = 116.0;
    let mut lines = Vec::new();
    for answer in answers {
        let most = 1e3 * answer.most_m;
        let chart = Chart::new((70.0, top), (1100.0, 420.0), case.lobes.speed_rpm, [0.0, most]);
        let least: Vec<String> = answer
            .minima
            .iter()
            .filter(|limit| limit.depth_m < answer.most_m)
            .map(|limit| format!("{:.4} mm at {:.2} Hz", 1e3 * limit.depth_m, limit.frequency_hz))
            .collect();
        let mut says = "limit of the depth, mm: stable below".to_owned();
        if answer.exact {
            says += "; blue: delay equation (violet: period doubling), orange dashed: zero order";
        }
        if !least.is_empty() {
            says += if answer.exact {
                "; dotted: minimum limits of the zero order, "
            } else {
                "; dotted: minimum limits, "
            };
            says += &least.join(" and ");
        }
        let head = format!("Stability lobes, {}", answer.kind);
        chart.frame(&mut svg, &head, "spindle speed, rpm", &says);
        let line = |of: &dyn Fn(&LobePoint) -> Option<f64>| -> Vec<Option<(f64, f64)>> {
            // No limit found: it lies above the picture.
            let point =
                |point: &LobePoint| (point.speed_rpm, of(point).map_or(2.0 * most, |depth| 1e3 * depth));
            answer.points.iter().map(|p| Some(point(p))).collect()
        };
        if answer.exact {
            chart.line(
                &mut svg,
                &line(&LobePoint::quick_m),
                UNSTABLE,
                1.4,
                "stroke-dasharray=\"6 4\"",
            );
            chart.line(&mut svg, &line(&LobePoint::exact_m), STABLE, 2.2, "");
            let doubling: Vec<_> = answer
                .points
                .iter()
                .map(|point| {
                    let (depth, chatter) = point.exact?;
                    (chatter.kind == ChatterKind::Flip).then_some((point.speed_rpm, 1e3 * depth))
                })
                .collect();
            chart.line(&mut svg, &doubling, FLIP, 3.0, "");
        } else {
            chart.line(&mut svg, &line(&LobePoint::quick_m), STABLE, 2.2, "");
        }
        for limit in &answer.minima {
            let depth = 1e3 * limit.depth_m;
            if depth < most {
                let ends = [
                    Some((case.lobes.speed_rpm[0], depth)),
                    Some((case.lobes.speed_rpm[1], depth)),
                ];
                chart.line(&mut svg, &ends, "#555", 1.0, "stroke-dasharray=\"2 3\"");
            }
        }
        top += 530.0;
        lines.extend(answer.assumptions.iter().cloned());
    }
    let end = foot(&mut svg, top - 36.0, &lines);
    svg.finish(end, STYLE)
}
