//! Stability lobes: computation and picture.

use evolvent_chatter::{Case, Chatter, ChatterError, ChatterKind, Limit, Lobes, MillingDelay};

use super::chart::{Chart, STABLE, STYLE, UNSTABLE, WIDTH, foot};
use crate::error::AnalysisError;
use crate::figure::svg::{Anchor, Svg};

/// Limits of period doubling.
const FLIP: &str = "#8a3ffc";

/// Maximum number of complex multiplications for the limits of a diagram: about half a minute.
const MAX_WORK: f64 = 1.5e10;
/// Growth of a disturbance below the limit from which on a note reports it.
const NOTED_GROWTH: f64 = 1000.0;

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
    /// Where the delay equation has no limit, with the reason, and where it is not conclusive.
    pub(crate) notes: Vec<String>,
    pub(crate) assumptions: Vec<String>,
}

/// The limits at a spindle speed.
#[derive(Clone, Copy)]
pub(crate) struct LobePoint {
    pub(crate) speed_rpm: f64,
    /// From the frequency domain.
    pub(crate) quick: Option<Limit>,
    /// From the delay equation.
    pub(crate) exact: ExactLimit,
}

/// Result of the delay equation at a spindle speed.
#[derive(Clone, Copy)]
pub(crate) enum ExactLimit {
    /// Not solved: not requested, or see the notes.
    Unknown,
    /// No depth up to the maximum chatters.
    Beyond,
    /// Depth, m, the kind of chatter there, and an upper bound of the growth of a disturbance below it.
    At(f64, Chatter, f64),
}

impl LobePoint {
    fn quick_m(&self) -> Option<f64> {
        self.quick.map(|limit| limit.depth_m)
    }

    /// The limit of the delay equation, m.
    fn exact_m(&self) -> Option<f64> {
        match self.exact {
            ExactLimit::At(depth, ..) => Some(depth),
            ExactLimit::Unknown | ExactLimit::Beyond => None,
        }
    }

    /// Whether the delay equation is decisive; otherwise the frequency domain is.
    pub(crate) fn is_exact(&self) -> bool {
        !matches!(self.exact, ExactLimit::Unknown)
    }

    /// The decisive limit, m.
    pub(crate) fn limit_m(&self) -> Option<f64> {
        if self.is_exact() {
            self.exact_m()
        } else {
            self.quick_m()
        }
    }

    /// Kind and frequency, Hz, of the decisive limit. The frequency domain yields only Hopf limits.
    pub(crate) fn chatter(&self) -> Option<(ChatterKind, f64)> {
        match self.exact {
            ExactLimit::At(_, chatter, _) => Some((chatter.kind, chatter.frequency_hz)),
            ExactLimit::Beyond => None,
            ExactLimit::Unknown => self.quick.map(|limit| (ChatterKind::Hopf, limit.frequency_hz)),
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
    let rpm_of = |k: usize| from + (to - from) * k as f64 / last;
    // Slow speeds take longest: the budget goes to the others first.
    let mut least_rpm = f64::INFINITY;
    if exact {
        let mut left = MAX_WORK;
        for k in (0..case.lobes.points).rev() {
            left -= delay(rpm_of(k))?.limit_work();
            if left < 0.0 {
                break;
            }
            least_rpm = rpm_of(k);
        }
    }
    let point = |k: usize| {
        let rpm = rpm_of(k);
        let solved = if !exact {
            Ok(ExactLimit::Unknown)
        } else if rpm < least_rpm {
            Err(NoLimit::Budget)
        } else {
            exact_limit(&delay(rpm)?, most_m)?
        };
        Ok::<_, ChatterError>((
            LobePoint {
                speed_rpm: rpm,
                quick: lobes.limit_at(rpm),
                exact: solved.as_ref().copied().unwrap_or(ExactLimit::Unknown),
            },
            solved.err(),
        ))
    };
    // Two threads take interleaved halves, so that both take the same time.
    let count = case.lobes.points;
    let every_second = |first: usize| (first..count).step_by(2).map(point).collect::<Vec<_>>();
    let (even, odd) = std::thread::scope(|scope| {
        let other = scope.spawn(|| every_second(1));
        (every_second(0), other.join().unwrap_or_default())
    });
    let mut points = Vec::with_capacity(count);
    let mut missing = Vec::new();
    let mut odd = odd.into_iter();
    for point in even {
        for point in [Some(point), odd.next()].into_iter().flatten() {
            let (point, reason) = point?;
            missing.extend(reason.map(|reason| (point.speed_rpm, reason)));
            points.push(point);
        }
    }
    let notes = notes(&points, &missing);
    Ok(LobeAnswer {
        kind,
        minima,
        cuts_per_rev: lobes.cuts_per_rev(),
        points,
        most_m,
        exact,
        notes,
        assumptions,
    })
}

/// Why the delay equation has no limit at a speed.
#[derive(Clone, Copy, PartialEq)]
enum NoLimit {
    /// The computation of higher speeds used up the permitted work.
    Budget,
    Error(ChatterError),
}

/// The limit of the delay equation, or why there is none.
fn exact_limit(delay: &MillingDelay, most_m: f64) -> Result<Result<ExactLimit, NoLimit>, ChatterError> {
    let solved = delay.limit(most_m).and_then(|depth| {
        Ok(match depth {
            Some(depth) => ExactLimit::At(depth, delay.chatter(depth)?, delay.growth(depth)?),
            None => ExactLimit::Beyond,
        })
    });
    match solved {
        Ok(limit) => Ok(Ok(limit)),
        Err(
            error @ (ChatterError::TooManyWaves { .. }
            | ChatterError::Unresolved { .. }
            | ChatterError::Growth { .. }),
        ) => Ok(Err(NoLimit::Error(error))),
        Err(error) => Err(error),
    }
}

fn notes(points: &[LobePoint], missing: &[(f64, NoLimit)]) -> Vec<String> {
    let range = |speeds: &[f64]| match speeds {
        [] => String::new(),
        [one] => format!("at {one:.0} rpm"),
        [first, .., last] => format!("at {} speeds from {first:.0} to {last:.0} rpm", speeds.len()),
    };
    let of = |is: &dyn Fn(&NoLimit) -> bool| -> Vec<f64> {
        let which = missing.iter().filter(|(_, reason)| is(reason));
        which.map(|(rpm, _)| *rpm).collect()
    };
    let mut notes = Vec::new();
    let reasons: [(Vec<f64>, &str); 4] = [
        (
            of(&|reason| matches!(reason, NoLimit::Budget)),
            "it would take too long; give fewer points or higher speeds",
        ),
        (
            of(&|reason| matches!(reason, NoLimit::Error(ChatterError::TooManyWaves { .. }))),
            "too many waves in a cut for its modes",
        ),
        (
            of(&|reason| matches!(reason, NoLimit::Error(ChatterError::Unresolved { .. }))),
            "it is not resolved",
        ),
        (
            of(&|reason| matches!(reason, NoLimit::Error(ChatterError::Growth { .. }))),
            "below its limit a disturbance grows by too large a factor before it dies out",
        ),
    ];
    for (speeds, why) in reasons {
        if !speeds.is_empty() {
            notes.push(format!(
                "no limit of the delay equation {}: {why}. The zero order is taken there, which may be too \
                 deep",
                range(&speeds)
            ));
        }
    }
    let growing: Vec<f64> = points
        .iter()
        .filter(|point| matches!(point.exact, ExactLimit::At(_, _, growth) if growth > NOTED_GROWTH))
        .map(|point| point.speed_rpm)
        .collect();
    if !growing.is_empty() {
        notes.push(format!(
            "{} a disturbance may grow more than {NOTED_GROWTH:.0} times before it dies out, right below \
             the limit of the delay equation: keep a margin",
            range(&growing)
        ));
    }
    notes
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
            // No limit found: it is above the picture.
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
            let exact: Vec<_> = line(&LobePoint::exact_m)
                .into_iter()
                .zip(&answer.points)
                .map(|(place, point)| place.filter(|_| point.is_exact()))
                .collect();
            chart.line(&mut svg, &exact, STABLE, 2.2, "");
            let doubling: Vec<_> = answer
                .points
                .iter()
                .map(|point| match point.exact {
                    ExactLimit::At(depth, chatter, _) if chatter.kind == ChatterKind::Flip => {
                        Some((point.speed_rpm, 1e3 * depth))
                    }
                    _ => None,
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
        lines.extend(answer.notes.iter().chain(&answer.assumptions).cloned());
    }
    let end = foot(&mut svg, top - 36.0, &lines);
    svg.finish(end, STYLE)
}
