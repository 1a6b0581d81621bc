//! The response to an impulse: deflection over time, and its spiral in the phase plane.

use evolvent_chatter::{Assessment, Case, CuttingTool, Fate, Laws, Model, State, TransientFollower};
use serde_json::{Value, json};

use super::answer::Answer;
use super::chart::{Chart, STABLE, STYLE, UNSTABLE, WIDTH, foot, range_of};
use crate::figure::svg::{Anchor, Svg};

/// Default size of the impulse, relative to the largest one that keeps the speed above the minimum.
const DEFAULT_PART: f64 = 0.3;
/// Minimum and maximum number of periods of the slowest vibration shown.
const PERIODS: [f64; 2] = [30.0, 400.0];
/// Maximum number of points of a curve in the picture.
const MAX_POINTS: usize = 8000;

/// The motion after an impulse in the direction of the cutting speed.
pub(crate) struct Transient {
    kick_m_s: f64,
    fate: Fate,
    /// Time, s, and state.
    samples: Vec<(f64, State)>,
    /// The intended duration, s, if it takes too many steps.
    cut_off_s: Option<f64>,
}

/// Simulates the response to an impulse, m/s, for `seconds`, or until small vibrations have changed by e^4.
pub(crate) fn transient(
    tool: CuttingTool,
    laws: Laws<'_>,
    assessment: &Assessment,
    kick_m_s: Option<f64>,
    seconds: Option<f64>,
) -> Option<Transient> {
    let model = Model::new(tool, laws).ok()?;
    let rest = &assessment.equilibrium;
    let follower = TransientFollower::new(model, rest);
    let kick_m_s = kick_m_s.unwrap_or(DEFAULT_PART * follower.reach_m_s());
    let (cos, sin) = model.machine_axes(1.0, 0.0);
    // Along z: V1 has its sine, V2 its cosine.
    let start = follower.rest() + State::new(0.0, 0.0, kick_m_s * sin, kick_m_s * cos);
    let period = 1.0 / tool.axes[0].frequency_hz().min(tool.axes[1].frequency_hz());
    let shown = 4.0 / rest.growth_per_s().abs();
    let duration_s = seconds.unwrap_or(shown.clamp(PERIODS[0] * period, PERIODS[1] * period));
    let samples = follower.samples(start, duration_s);
    let end_s = samples.last().map_or(0.0, |(time, _)| *time);
    // The last step may be shorter.
    let is_cut_off = samples.len() > TransientFollower::MAX_STEPS && end_s < (1.0 - 1e-5) * duration_s;
    Some(Transient {
        kick_m_s,
        fate: follower.fate(start),
        samples,
        cut_off_s: is_cut_off.then_some(duration_s),
    })
}

fn fate_word(fate: &Fate) -> &'static str {
    match fate {
        Fate::DiesOut => "dies-out",
        Fate::Settles(_) => "settles",
        Fate::GoesOn => "goes-on",
        Fate::StillGrows => "still-grows",
        Fate::Leaves => "leaves-model",
        Fate::BeginsOutside => "begins-out-of-model",
    }
}

impl Transient {
    /// The outcome as a line of the report.
    pub(crate) fn text(&self) -> String {
        let fate = match &self.fate {
            Fate::DiesOut => "dies out".to_owned(),
            Fate::Settles(cycle) => format!(
                "settles on the cycle of {:.2} Hz, V2 {:.4} mm",
                cycle.frequency_hz,
                1e3 * cycle.amplitude_m[1]
            ),
            Fate::GoesOn => "continues without a cycle".to_owned(),
            Fate::StillGrows => "grows, slower than it was followed".to_owned(),
            Fate::Leaves => "grows out of the model".to_owned(),
            Fate::BeginsOutside => "is too large: it brings the speed to the floor at once".to_owned(),
        };
        let cut_off = match (self.cut_off_s, self.samples.last()) {
            (Some(asked), Some((shown, _))) => format!(
                "; {shown:.1} s of {asked} s shown, which are {} steps",
                TransientFollower::MAX_STEPS
            ),
            _ => String::new(),
        };
        format!(
            "  kick of {:.3} m/s along the cutting speed: {fate}{cut_off}\n",
            self.kick_m_s
        )
    }

    pub(crate) fn json(&self) -> Value {
        json!({
            "kick_m_s": self.kick_m_s,
            "fate": fate_word(&self.fate),
            "duration_s": self.samples.last().map(|(time, _)| time),
            "cut_off_from_s": self.cut_off_s,
        })
    }
}

pub(crate) fn svg(case: &Case, answer: &Answer, transient: &Transient) -> String {
    let mut svg = Svg::new(WIDTH);
    svg.text((20.0, 32.0), Anchor::Start, "title", &case.name);
    svg.text((20.0, 52.0), Anchor::Start, "small", transient.text().trim());
    let Ok(model) = Model::new(answer.tool, answer.laws.laws()) else {
        return svg.finish(80.0, STYLE);
    };
    let [v1, v2] = answer.assessment.equilibrium.deflection_m;
    let (rest_y, rest_z) = model.machine_axes(v1, v2);
    let step = transient.samples.len().div_ceil(MAX_POINTS).max(1);
    // Time, y, velocity of y, z, velocity of z; mm and m/min.
    let points: Vec<[f64; 5]> = transient
        .samples
        .iter()
        .step_by(step)
        .map(|(time, state)| {
            let (y, z) = model.machine_axes(state[0], state[1]);
            let (y_dot, z_dot) = model.machine_axes(state[2], state[3]);
            [*time, 1e3 * y, 60.0 * y_dot, 1e3 * z, 60.0 * z_dot]
        })
        .collect();
    let curve = |x: usize, y: usize| -> Vec<Option<(f64, f64)>> {
        points.iter().map(|point| Some((point[x], point[y]))).collect()
    };
    let range = |k: usize, about: f64| {
        range_of(
            points
                .iter()
                .map(|point| point[k])
                .chain([about - 1e-3, about + 1e-3]),
            f64::NEG_INFINITY,
        )
    };
    let end = points.last().map_or(1.0, |point| point[0]).max(1e-6);
    for (k, top, head, about) in [
        (3, 110.0, "Deflection along the cutting speed", rest_z),
        (1, 360.0, "Deflection across it, away from the workpiece", rest_y),
    ] {
        let chart = Chart::new((70.0, top), (1100.0, 170.0), [0.0, end], range(k, 1e3 * about));
        let says = if k == 3 { "z, mm" } else { "y, mm" };
        chart.frame(&mut svg, head, "time, s", says);
        chart.line(&mut svg, &curve(0, k), "#444", 0.8, "");
    }
    for (x, left, head, label, about) in [
        (
            3,
            70.0,
            "Phase plane along the cutting speed",
            "z, mm; blue: stable cycle, orange dashed: unstable",
            rest_z,
        ),
        (1, 670.0, "Phase plane across it", "y, mm", rest_y),
    ] {
        let chart = Chart::new(
            (left, 620.0),
            (500.0, 420.0),
            range(x, 1e3 * about),
            range(x + 1, 0.0),
        );
        chart.frame(&mut svg, head, label, "velocity, m/min");
        chart.line(&mut svg, &curve(x, x + 1), "#777", 0.6, "");
        for known in &answer.assessment.cycles {
            let orbit: Vec<_> = (0..=240)
                .map(|k| {
                    let state = known.cycle.state(f64::from(k) / 240.0);
                    let (y, z) = model.machine_axes(state[0], state[1]);
                    let (y_dot, z_dot) = model.machine_axes(state[2], state[3]);
                    let (at, velocity) = if x == 3 { (z, z_dot) } else { (y, y_dot) };
                    Some((1e3 * at, 60.0 * velocity))
                })
                .collect();
            if known.verified.stable() {
                chart.line(&mut svg, &orbit, STABLE, 2.2, "");
            } else {
                chart.line(&mut svg, &orbit, UNSTABLE, 1.6, "stroke-dasharray=\"7 4\"");
            }
        }
        svg.circle(chart.project(1e3 * about, 0.0), 4.0, "mark");
    }
    let bottom = foot(&mut svg, 1110.0, &answer.assumptions);
    svg.finish(bottom, STYLE)
}
