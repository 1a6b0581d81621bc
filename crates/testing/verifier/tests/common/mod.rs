//! Motions computed from formulas, without any planner: rest to rest along each piece by a polynomial of
//! degree seven.

#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]
use evolvent_gcode::Settings;
use evolvent_machine::Machine;
use evolvent_path::{Axes, AxisLetter};
use evolvent_verifier::{Allowances, Judge, Kind, Route, Verdict};

/// Maximum velocity, acceleration and jerk of the fraction of the distance as a function of the fraction of
/// the time: 140 (t - t^2)^3 and its derivatives.
pub(crate) const PEAKS: [f64; 3] = [35.0 / 16.0, 7.513_188_404_399_293, 52.5];

/// Fraction of the distance after a fraction of the time; speed, acceleration and jerk are zero at both ends.
pub(crate) fn smooth(t: f64) -> f64 {
    t * t * t * t * (35.0 + t * (-84.0 + t * (70.0 - 20.0 * t)))
}

/// A machine of equal axes: 200, 2000, 50 000 in mm or degrees and seconds; chord error and increment 1 um.
pub(crate) fn machine(letters: &str) -> Machine {
    let mut text =
        "name = \"equal\"\ndescription = \"\"\nkind = \"mill\"\nincrements_per_mm = 1000\nrate = 1000\n"
            .to_owned();
    if letters.contains(['A', 'B', 'C']) {
        text.push_str("increments_per_degree = 1000\n");
    }
    text.push_str("[path]\nmode = \"exact\"\nblend_tolerance_mm = 0.02\n");
    for letter in letters.chars() {
        let (kind, unit) = if "ABC".contains(letter) {
            ("rotary", "deg")
        } else {
            ("linear", "mm")
        };
        text.push_str(&format!(
            "[[axis]]\nletter = \"{letter}\"\nkind = \"{kind}\"\ntravel_min_{unit} = -10000\n\
             travel_max_{unit} = 10000\nmax_velocity_{unit}_s = 200\nmax_acceleration_{unit}_s2 = 2000\n\
             max_jerk_{unit}_s3 = 50000\nhome_{unit} = 0\n"
        ));
    }
    Machine::parse(&text, "equal.toml").expect("machine")
}

pub(crate) fn axes(values: &[(AxisLetter, f64)]) -> Axes {
    let mut axes = Axes::zeros();
    for (letter, value) in values {
        axes[letter.index()] = *value;
    }
    axes
}

pub(crate) fn xyz(x: f64, y: f64, z: f64) -> Axes {
    axes(&[(AxisLetter::X, x), (AxisLetter::Y, y), (AxisLetter::Z, z)])
}

/// Setpoints, from rest at zero.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    pub(crate) period_ns: u64,
    pub(crate) setpoints: Vec<Axes>,
    at: Axes,
}

impl Motion {
    pub(crate) fn new(rate_hz: f64) -> Self {
        Self {
            period_ns: (1e9 / rate_hz) as u64,
            setpoints: Vec::new(),
            at: Axes::zeros(),
        }
    }

    /// Moves along a curve that is a function of the fraction of its length, in at least this many seconds.
    pub(crate) fn along(mut self, seconds: f64, position: impl Fn(f64) -> Axes) -> Self {
        let count = (seconds * 1e9 / self.period_ns as f64).ceil() as usize;
        for i in 1..=count {
            self.setpoints.push(position(smooth(i as f64 / count as f64)));
        }
        self.at = position(1.0);
        // The last setpoint is exact if the curve is.
        if let Some(last) = self.setpoints.last_mut() {
            *last = self.at;
        }
        self
    }

    pub(crate) fn to(self, end: Axes, seconds: f64) -> Self {
        let start = self.at;
        self.along(seconds, |x| if x < 1.0 { start + (end - start) * x } else { end })
    }

    /// Moves about a centre in the plane of two axes, by an angle in degrees, counter-clockwise from the
    /// first axis to the second.
    pub(crate) fn turn(
        self,
        plane: [usize; 2],
        centre: [f64; 2],
        degrees: f64,
        climb: f64,
        seconds: f64,
    ) -> Self {
        let start = self.at;
        let arm = [start[plane[0]] - centre[0], start[plane[1]] - centre[1]];
        self.along(seconds, |x| {
            let (sin, cos) = (degrees.to_radians() * x).sin_cos();
            let mut point = start;
            point[plane[0]] = centre[0] + cos * arm[0] - sin * arm[1];
            point[plane[1]] = centre[1] + sin * arm[0] + cos * arm[1];
            point[3 - plane[0] - plane[1]] += climb * x;
            point
        })
    }

    pub(crate) fn wait(mut self, seconds: f64) -> Self {
        let count = (seconds * 1e9 / self.period_ns as f64) as usize;
        self.setpoints.extend(std::iter::repeat_n(self.at, count));
        self
    }
}

pub(crate) fn route(program: &str, machine: &Machine) -> Route {
    let settings = Settings {
        axes: machine.limits().present,
        path_mode: evolvent_gcode::PathMode::ExactPath,
        ..Settings::default()
    };
    Route::read(program.as_bytes(), settings, machine).expect("program")
}

pub(crate) fn judge(program: &str, motion: &Motion, machine: &Machine) -> Verdict {
    let route = route(program, machine);
    let mut judge = Judge::new(machine, motion.period_ns, &route);
    for setpoint in &motion.setpoints {
        judge.sample(setpoint);
    }
    judge.finish()
}

pub(crate) fn kinds(verdict: &Verdict) -> Vec<Kind> {
    let violations = verdict.violations(&Allowances::default());
    violations.into_iter().map(|violation| violation.kind).collect()
}
