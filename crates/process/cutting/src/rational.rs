//! A rational function of the speed with a falling section (S. L. Leonov, E. V. Veglov, equation 2).

use crate::error::{ForceError, LawError};
use crate::fixed_power::FixedPower;
use crate::force::{SectionForce, ToolAngles};
use crate::power::number;

/// The coefficients of a law file.
///
/// `Pz = unit_n Kt Klead ((a V k1 + b k2) / (V^2 + f V k5 + g k6) + c k3 / V + d k4)`, V in m/min, with
/// `Kt = depth_factor t^depth_exponent`, `Klead = lead_factor_at_0_deg + lead_factor_per_deg phi`, each of
/// `a` to `g` a value at 1 mm/rev and an exponent of the feed, each of `k1` to `k6` a value at rake angle 0
/// and an exponent of e per degree.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(missing_docs, reason = "the formula above names them")]
pub struct RationalCoefficients {
    pub unit_n: f64,
    pub depth_factor: f64,
    pub depth_exponent: f64,
    pub lead_factor_at_0_deg: f64,
    pub lead_factor_per_deg: f64,
    pub a: [f64; 2],
    pub b: [f64; 2],
    pub c: [f64; 2],
    pub d: [f64; 2],
    pub f: [f64; 2],
    pub g: [f64; 2],
    pub k: [[f64; 2]; 6],
}

/// The law for a tool: its coefficients include rake and lead angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RationalLaw {
    /// a k1, b k2, f k5, g k6, c k3, d k4 at 1 mm/rev, in that order; a, b, c, d with all factors except the
    /// depth's, N.
    terms: [Term; 6],
    depth_exponent: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Term {
    value: f64,
    exponent: f64,
}

impl Term {
    fn at(self, feed: f64) -> f64 {
        self.value * libm::pow(feed, self.exponent)
    }
}

/// The law at a feed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RationalSection<'a> {
    a: f64,
    b: f64,
    f: f64,
    g: f64,
    c: f64,
    d: f64,
    depth_exponent: f64,
    depth_power: &'a FixedPower,
}

impl RationalLaw {
    /// Applies the angles of a tool to the coefficients.
    ///
    /// # Errors
    /// Numbers that are not finite or out of range; a lead angle at which the force would not be positive; a
    /// rake angle at which the law has a pole at every feed (if that does not depend on the feed; otherwise
    /// [`ForceError::Pole`]).
    pub fn new(coefficients: &RationalCoefficients, tool: ToolAngles) -> Result<Self, LawError> {
        let c = coefficients;
        number("rake angle", tool.rake_deg, -45.0, 45.0)?;
        number("lead angle", tool.lead_deg, 1.0, 120.0)?;
        number("unit_n", c.unit_n, 1e-6, 1e6)?;
        number("depth_factor", c.depth_factor, 1e-9, 1e9)?;
        number("depth_exponent", c.depth_exponent, 0.01, 10.0)?;
        number("lead_factor_at_0_deg", c.lead_factor_at_0_deg, -1e3, 1e3)?;
        number("lead_factor_per_deg", c.lead_factor_per_deg, -1e3, 1e3)?;
        let lead = c.lead_factor_at_0_deg + c.lead_factor_per_deg * tool.lead_deg;
        if lead <= 0.0 {
            return Err(LawError::Lead {
                lead_deg: tool.lead_deg,
                factor: lead,
            });
        }
        let names = ["k1", "k2", "k3", "k4", "k5", "k6"];
        let mut k = [0.0; 6];
        for ((k, [value, exponent]), name) in k.iter_mut().zip(c.k).zip(names) {
            number(name, value, 1e-6, 1e6)?;
            number(name, exponent, -1.0, 1.0)?;
            *k = value * libm::exp(exponent * tool.rake_deg);
        }
        let scale = c.unit_n * c.depth_factor * lead;
        let all = [
            ("a", c.a, scale * k[0]),
            ("b", c.b, scale * k[1]),
            ("f", c.f, k[4]),
            ("g", c.g, k[5]),
            ("c", c.c, scale * k[2]),
            ("d", c.d, scale * k[3]),
        ];
        let mut terms = [Term {
            value: 0.0,
            exponent: 0.0,
        }; 6];
        for (term, (name, [value, exponent], factor)) in terms.iter_mut().zip(all) {
            number(name, value, -1e9, 1e9)?;
            number(name, exponent, -10.0, 10.0)?;
            *term = Term {
                value: value * factor,
                exponent,
            };
        }
        let [_, _, f, g, _, _] = terms;
        let ratio = pole_ratio(f.value, g.value);
        if g.exponent == 2.0 * f.exponent && ratio >= 1.0 {
            return Err(LawError::Pole {
                rake_deg: tool.rake_deg,
                ratio,
            });
        }
        Ok(Self {
            terms,
            depth_exponent: c.depth_exponent,
        })
    }

    /// The power of the depth in this law.
    pub(crate) fn depth_power(&self) -> FixedPower {
        FixedPower::new(self.depth_exponent)
    }

    pub(crate) fn at_feed<'a>(
        &self,
        feed: f64,
        depth_power: &'a FixedPower,
    ) -> Result<RationalSection<'a>, ForceError> {
        let [a, b, f, g, c, d] = self.terms.map(|term| term.at(feed));
        let ratio = pole_ratio(f, g);
        // False for NaN too.
        if ratio < 1.0 {
            return Ok(RationalSection {
                a,
                b,
                f,
                g,
                c,
                d,
                depth_exponent: self.depth_exponent,
                depth_power,
            });
        }
        Err(ForceError::Pole {
            feed_mm_rev: feed,
            ratio,
        })
    }

    /// Derivative by the feed in a valid section.
    pub(crate) fn per_feed(&self, section: &RationalSection<'_>, feed: f64, speed: f64, depth: f64) -> f64 {
        let s = section;
        let [ea, eb, ef, eg, ec, ed] = self.terms.map(|term| term.exponent);
        let above = s.a * speed + s.b;
        let below = speed * speed + s.f * speed + s.g;
        let above_by = ea * s.a * speed + eb * s.b;
        let below_by = ef * s.f * speed + eg * s.g;
        let by = (above_by * below - above * below_by) / (below * below) + ec * s.c / speed + ed * s.d;
        s.depth_power.of(depth) * by / feed
    }
}

/// `(f k5)^2 / (4 g k6)`: from 1 on the denominator has real zeros.
fn pole_ratio(f: f64, g: f64) -> f64 {
    if g > 0.0 { f * f / (4.0 * g) } else { f64::INFINITY }
}

impl RationalSection<'_> {
    pub(crate) fn force(&self, speed: f64, depth: f64) -> SectionForce {
        let (factor, fraction, below) = self.parts(speed, depth);
        let force = factor * (fraction + self.c / speed + self.d);
        let by_speed = (self.a - fraction * (2.0 * speed + self.f)) / below - self.c / (speed * speed);
        SectionForce {
            tangential_n: force,
            per_speed: factor * by_speed,
            per_depth: force * self.depth_exponent / depth,
        }
    }

    pub(crate) fn tangential_n(&self, speed: f64, depth: f64) -> f64 {
        let (factor, fraction, _) = self.parts(speed, depth);
        factor * (fraction + self.c / speed + self.d)
    }

    /// Factor of the depth, fraction in the speed, its denominator.
    fn parts(&self, speed: f64, depth: f64) -> (f64, f64, f64) {
        let above = self.a * speed + self.b;
        let below = speed * speed + self.f * speed + self.g;
        (self.depth_power.of(depth), above / below, below)
    }
}
