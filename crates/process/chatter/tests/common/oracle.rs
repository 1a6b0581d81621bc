//! An independent computation of the same motion: law and equations as printed in the paper, fixed steps, no
//! code of the crate.

#![allow(dead_code, unreachable_pub, reason = "each test uses its part")]

use evolvent_chatter::CuttingTool;

/// A cut, and its rake and lead angles.
pub struct Oracle {
    tool: CuttingTool,
    a: [f64; 6],
    factor: f64,
    /// Coefficient and exponents of speed, depth and feed of a power law for Py.
    radial: Option<[f64; 4]>,
    cos: f64,
    sin: f64,
}

/// The fate of a disturbance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    Died,
    /// The speed stays below the floor for part of every period.
    Left,
    /// Neither.
    Stays,
    /// The impulse itself brings the speed below the floor, within two periods.
    TooLarge,
}

type State = [f64; 4];

impl Oracle {
    pub fn new(tool: CuttingTool, rake: f64, lead: f64) -> Self {
        let s = tool.feed_mm_rev;
        let a = [
            1998.6 * s.powf(1.7) * 1.0756 * f64::exp(-0.00729 * rake),
            -430.02 * s * 0.937 * f64::exp(0.00651 * rake),
            260.13 * s.powf(0.8343) * 1.7054 * f64::exp(-0.0534 * rake),
            596.87 * s.powf(0.912) * 1.066 * f64::exp(-0.00639 * rake),
            -33.5 / s * 0.583 * f64::exp(0.05396 * rake),
            356.4 / (s * s) * 0.3816 * f64::exp(0.09634 * rake),
        ];
        let beta = tool.beta_deg.to_radians();
        Self {
            tool,
            a,
            radial: None,
            factor: 9.80665 * 0.307 * (1.099 - 0.00166 * lead),
            cos: beta.cos(),
            sin: beta.sin(),
        }
    }

    /// With a separate law for the radial force.
    pub fn with_radial(self, law: [f64; 4]) -> Self {
        Self {
            radial: Some(law),
            ..self
        }
    }

    fn radial(&self, v: f64, t: f64) -> f64 {
        match self.radial {
            Some(_) if t <= 0.0 => 0.0,
            Some([c, by_speed, by_depth, by_feed]) => {
                let v = v.max(self.tool.floor_m_min);
                c * v.powf(by_speed) * t.powf(by_depth) * self.tool.feed_mm_rev.powf(by_feed)
            }
            None => self.tool.radial_ratio * self.force(v, t),
        }
    }

    fn force(&self, v: f64, t: f64) -> f64 {
        if t <= 0.0 {
            return 0.0;
        }
        let [a, b, c, d, f, g] = self.a;
        let v = v.max(self.tool.floor_m_min);
        self.factor * t.powf(0.852) * ((a * v + b) / (v * v + f * v + g) + c / v + d)
    }

    pub fn cut(&self, x: &State) -> (f64, f64) {
        let tool = &self.tool;
        (
            tool.speed_m_min + 60.0 * (x[2] * self.sin + x[3] * self.cos),
            tool.depth_mm - 1000.0 * (x[0] * self.cos - x[1] * self.sin),
        )
    }

    fn rate(&self, x: &State) -> State {
        let (v, t) = self.cut(x);
        let pz = self.force(v, t);
        let py = self.radial(v, t);
        let [one, two] = &self.tool.axes;
        let f1 = py * self.cos - pz * self.sin;
        let f2 = -py * self.sin - pz * self.cos;
        [
            x[2],
            x[3],
            (f1 - one.damping_ns_m * x[2] - one.stiffness_n_m * x[0]) / one.mass_kg,
            (f2 - two.damping_ns_m * x[3] - two.stiffness_n_m * x[1]) / two.mass_kg,
        ]
    }

    fn step(&self, x: &State, h: f64) -> State {
        let add = |x: &State, k: &State, by: f64| -> State { std::array::from_fn(|i| x[i] + by * k[i]) };
        let a = self.rate(x);
        let b = self.rate(&add(x, &a, 0.5 * h));
        let c = self.rate(&add(x, &b, 0.5 * h));
        let d = self.rate(&add(x, &c, h));
        std::array::from_fn(|i| x[i] + h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]))
    }

    /// The steady cut: the actual depth that is consistent with the deflection under its force, by bisection.
    pub fn rest(&self) -> State {
        let bent = |t: f64| -> State {
            let v = self.tool.speed_m_min;
            let (pz, py) = (self.force(v, t), self.radial(v, t));
            let [one, two] = &self.tool.axes;
            [
                (py * self.cos - pz * self.sin) / one.stiffness_n_m,
                (-py * self.sin - pz * self.cos) / two.stiffness_n_m,
                0.0,
                0.0,
            ]
        };
        let (mut low, mut high) = (0.0, 100.0 * self.tool.depth_mm);
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if self.cut(&bent(middle)).1 > middle {
                low = middle;
            } else {
                high = middle;
            }
        }
        bent(low)
    }

    /// Half of the distance between the extremes of V2, m, 3 s after an impulse along V2, m/s.
    pub fn settled(&self, blow_m_s: f64) -> f64 {
        let h = 1e-5;
        let mut x = self.rest();
        x[3] += blow_m_s;
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for k in 0..303_000 {
            x = self.step(&x, h);
            if k > 300_000 {
                (low, high) = (low.min(x[1]), high.max(x[1]));
            }
        }
        0.5 * (high - low)
    }

    fn size(&self, x: &State, rest: &State) -> f64 {
        let [one, two] = &self.tool.axes;
        let axis = |m: f64, k: f64, q: f64, v: f64| m * v * v + k * q * q;
        let energy = axis(one.mass_kg, one.stiffness_n_m, x[0] - rest[0], x[2])
            + axis(two.mass_kg, two.stiffness_n_m, x[1] - rest[1], x[3]);
        (2.0 * energy / (one.mass_kg + two.mass_kg)).sqrt()
    }

    /// The fate of an impulse along V1, V2 that is a fraction of the one that brings the speed to the floor.
    pub fn blow(&self, part: f64, v1: f64, v2: f64) -> End {
        let along = (v1 * self.sin + v2 * self.cos).abs().max(0.3);
        let by = part * (self.tool.speed_m_min - self.tool.floor_m_min) / 60.0 / along;
        self.kick([by * v1, by * v2])
    }

    /// The fate of an impulse, m/s along V1 and V2.
    pub fn kick(&self, [v1, v2]: [f64; 2]) -> End {
        let tool = &self.tool;
        let fastest = tool
            .axes
            .iter()
            .map(|axis| axis.frequency_hz())
            .fold(0.0, f64::max);
        let h = 1.0 / (80.0 * fastest);
        let rest = self.rest();
        let mut x = rest;
        x[2] += v1;
        x[3] += v2;
        let first = self.size(&x, &rest);
        let mut early = x;
        for _ in 0..160 {
            early = self.step(&early, h);
            if self.cut(&early).0 <= tool.floor_m_min {
                return End::TooLarge;
            }
        }
        let mut below = 0;
        for _ in 0..150 {
            let (mut slowest, mut size) = (f64::INFINITY, 0.0_f64);
            for _ in 0..800 {
                x = self.step(&x, h);
                slowest = slowest.min(self.cut(&x).0);
                size = size.max(self.size(&x, &rest));
            }
            if !size.is_finite() {
                return End::Left;
            }
            below = if slowest <= tool.floor_m_min { below + 1 } else { 0 };
            if below >= 20 {
                return End::Left;
            }
            if size < 1e-3 * first {
                return End::Died;
            }
        }
        End::Stays
    }

    /// Directions of impulses: principal axes, along the cutting speed, and across it.
    pub fn directions(&self) -> [[f64; 2]; 4] {
        [
            [1.0, 0.0],
            [0.0, 1.0],
            [self.sin, self.cos],
            [self.cos, -self.sin],
        ]
    }
}
