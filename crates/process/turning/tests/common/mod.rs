//! Jobs, stocks and independent checks for the tests.
#![allow(dead_code, unreachable_pub, reason = "each test uses some of it")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may fail, and prints its seed"
)]

mod part;

#[allow(unused_imports, reason = "each test uses a part")]
pub use evolvent_random::{Random, cases};
use evolvent_turning::{
    BackOff, Blank, CutLaw, CuttingEdge, Regime, RegimeInput, SensorModel, Strategy, TurningOutput,
    TurningSettings,
};

pub use part::Part;

pub const SET: f64 = 2200.0;
pub const TURN_S: f64 = 0.12;
pub const PERIOD_S: f64 = 0.002;

/// The reference case: Cp 2943 N, n -0.15 at 103.67 m/min, x 1, y 0.75.
pub fn law() -> CutLaw {
    CutLaw {
        coefficient: 2943.0 * 103.672_557_568_463_18_f64.powf(-0.15),
        depth_exponent: 1.0,
        feed_exponent: 0.75,
    }
}

pub fn tool() -> CuttingEdge {
    CuttingEdge::new(60.0, 12.0).unwrap()
}

pub fn regime(back_off: BackOff) -> Regime {
    regime_of(&tool(), back_off)
}

pub fn regime_of(tool: &CuttingEdge, back_off: BackOff) -> Regime {
    let input = RegimeInput {
        law: law(),
        set_load: SET,
        permitted_load: 10_000.0,
        feed_min_mm_rev: 0.2,
        feed_max_mm_rev: 0.7,
        back_off,
    };
    Regime::new(&input, tool).unwrap()
}

pub fn safe() -> TurningSettings {
    TurningSettings {
        period_s: PERIOD_S,
        ..TurningSettings::usual(regime(BackOff::Balanced), tool(), 500.0, 200.0)
    }
}

pub fn fast() -> TurningSettings {
    let regime = regime(BackOff::LeastTime);
    TurningSettings {
        strategy: Strategy::fast(&regime, true),
        period_s: PERIOD_S,
        ..TurningSettings::usual(regime, tool(), 500.0, 200.0)
    }
}

/// The same if the stock ends with the cut, as in the published cases.
pub mod open {
    use evolvent_turning::TurningSettings;

    fn open(settings: TurningSettings) -> TurningSettings {
        TurningSettings {
            beyond_mm: 0.0,
            ..settings
        }
    }

    pub fn safe() -> TurningSettings {
        open(super::safe())
    }

    pub fn fast() -> TurningSettings {
        open(super::fast())
    }

    pub fn literal() -> TurningSettings {
        open(super::literal())
    }
}

/// The literal strategy causes overloads by itself: its overload limit is out of reach.
pub fn literal() -> TurningSettings {
    TurningSettings {
        strategy: Strategy::literal(&regime(BackOff::Balanced)),
        overload_n: 9000.0,
        ..safe()
    }
}

pub fn sensor(seed: u64) -> SensorModel {
    SensorModel {
        lag_s: 0.01,
        noise: 0.02,
        range_max: 8000.0,
        seed,
    }
}

/// The stocks of the reference cases.
pub fn stocks() -> [(&'static str, Blank); 4] {
    [
        ("uniform 8", Blank::uniform(8.0)),
        ("taper 10 to 5", Blank::outline(&[(0.0, 10.0), (200.0, 5.0)])),
        (
            "8 with a gap",
            Blank {
                grooves_mm: vec![(80.0, 120.0, 0.0)],
                ..Blank::uniform(8.0)
            },
        ),
        (
            "7 with a hard spot",
            Blank {
                hard_spots: vec![(60.0, 110.0, 1.35)],
                ..Blank::uniform(7.0)
            },
        ),
    ]
}

/// A random stock: straight pieces of outline with steps, sometimes a groove or a hard spot.
pub fn random_stock(random: &mut Random) -> Blank {
    let mut points = Vec::new();
    let mut position = 0.0;
    let mut height = random.between(1.0, 9.5);
    while position < 200.0 {
        points.push((position, height));
        position += random.between(20.0, 120.0);
        let end = if random.unit() < 0.5 {
            height
        } else {
            random.between(0.5, 9.5)
        };
        points.push((position, end));
        height = if random.unit() < 0.6 {
            end
        } else {
            random.between(0.5, 9.5)
        };
    }
    let mut blank = Blank::outline(&points);
    if random.unit() < 0.3 {
        let from = random.between(10.0, 150.0);
        blank
            .grooves_mm
            .push((from, from + random.between(5.0, 60.0), 0.0));
    }
    if random.unit() < 0.3 {
        let from = random.between(10.0, 150.0);
        blank
            .hard_spots
            .push((from, from + random.between(5.0, 60.0), random.between(0.8, 1.35)));
    }
    blank
}

/// Velocity, acceleration and jerk of both axes, computed from their positions.
#[derive(Clone, Debug)]
pub struct Limits {
    past: [[f64; 4]; 2],
    count: u32,
    limits: [[f64; 3]; 2],
    period_s: f64,
}

impl Limits {
    pub fn new(settings: &TurningSettings) -> Self {
        let of = |l: &evolvent_turning::ScalarLimits| [l.velocity, l.acceleration, l.jerk];
        Self {
            past: [[0.0; 4]; 2],
            count: 0,
            limits: [of(&settings.along_limits), of(&settings.out_limits)],
            period_s: settings.period_s,
        }
    }

    pub fn check(&mut self, output: &TurningOutput) {
        self.count += 1;
        let t = self.period_s;
        for (axis, position) in [output.along.position, output.out.position]
            .into_iter()
            .enumerate()
        {
            let past = &mut self.past[axis];
            past.rotate_right(1);
            past[0] = position;
            if self.count < 4 {
                continue;
            }
            let [p, q, r, s] = *past;
            let rates = [
                (p - q) / t,
                (p - 2.0 * q + r) / (t * t),
                (p - 3.0 * q + 3.0 * r - s) / (t * t * t),
            ];
            for (order, slack) in [1.001, 1.001, 1.02].into_iter().enumerate() {
                assert!(
                    rates[order].abs() <= self.limits[axis][order] * slack + 1e-3,
                    "axis {axis}, derivative {}: {} at {past:?}, {output:?}",
                    order + 1,
                    rates[order]
                );
            }
        }
    }
}

/// The same with run-out, with flats and keyways, or with both.
pub fn random_rough_stock(random: &mut Random) -> Blank {
    let mut blank = random_stock(random);
    let kind = random.unit();
    if kind < 0.6 {
        // The edge reaches 10.4 mm.
        blank.runout_mm = random.between(0.05, 0.6);
    }
    if kind > 0.4 {
        let count = 1 + (3.0 * random.unit()) as usize;
        for k in 0..count {
            let from = (k as f64 + random.between(0.0, 0.3)) / count as f64;
            let to = from + random.between(0.05, 0.5) / count as f64;
            blank.slots.push((from, to));
        }
    }
    blank
}
