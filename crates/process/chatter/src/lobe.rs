//! Regenerative chatter in the frequency domain: stability lobes of turning and milling from measured modes.
//!
//! The tool cuts the waves that it left a revolution (turning) or a tooth (milling) before. At the limit of
//! stability it vibrates at one frequency, with the depth and the phase between waves at which the loop just
//! closes. For each frequency this gives a depth and, by the phase, one speed for every whole number of waves
//! between two cuts.

use nalgebra::Complex;

use crate::error::{ChatterError, number};

type C = Complex<f64>;

/// A mode of vibration of tool or workpiece, as measured by a modal test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Natural frequency, Hz.
    pub frequency_hz: f64,
    /// Fraction of critical damping.
    pub damping_ratio: f64,
    /// Modal stiffness at the tool tip, N/m.
    pub stiffness_n_m: f64,
}

impl Mode {
    /// Checks the numbers.
    ///
    /// # Errors
    /// A number that is not finite, not positive or out of range.
    pub fn checked(self) -> Result<Self, ChatterError> {
        number("frequency_hz", self.frequency_hz, 0.1, 1e5)?;
        number("damping_ratio", self.damping_ratio, 1e-5, 0.9)?;
        number("stiffness_n_m", self.stiffness_n_m, 1.0, 1e13)?;
        Ok(self)
    }

    /// Deflection per force at a frequency, m/N.
    #[must_use]
    pub fn response(&self, frequency_hz: f64) -> C {
        let ratio = frequency_hz / self.frequency_hz;
        let relative = C::new(1.0 - ratio * ratio, 2.0 * self.damping_ratio * ratio);
        relative.inv() / self.stiffness_n_m
    }
}

/// A mode of a turning tool and its direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurningMode {
    /// The mode.
    pub mode: Mode,
    /// Angle between the mode and the direction of the chip thickness, degrees.
    pub direction_deg: f64,
}

/// A turning operation, for its stability lobes.
///
/// ```
/// use evolvent_chatter::{Lobes, Mode, Turning, TurningMode};
/// let mode = Mode { frequency_hz: 250.0, damping_ratio: 0.02, stiffness_n_m: 2e7 };
/// let turning = Turning::new(&[TurningMode { mode, direction_deg: 0.0 }], 0.0, 2e9)?;
/// let least = turning.minima();
/// // One mode along the chip's thickness: 2 zeta (1 + zeta) k / K.
/// assert!((least[0].depth_m - 2.0 * 0.02 * 1.02 * 2e7 / 2e9).abs() < 1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Turning {
    modes: Vec<(Mode, f64)>,
    coefficient_n_m2: f64,
}

/// The entry and exit of a tooth, and the forces on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MillingCut {
    /// Number of teeth, evenly spaced.
    pub teeth: u32,
    /// Angle at which a tooth enters, from the direction across the feed, degrees: 0 at the start of
    /// up-milling.
    pub entry_deg: f64,
    /// Angle at which it leaves, degrees: 180 at the end of down-milling.
    pub exit_deg: f64,
    /// Tangential cutting coefficient, N/m2.
    pub tangential_n_m2: f64,
    /// Radial cutting coefficient, N/m2.
    pub radial_n_m2: f64,
}

/// A milling operation with modes along the feed (x) and across it (y).
#[derive(Clone, Debug, PartialEq)]
pub struct Milling {
    pub(crate) cut: MillingCut,
    pub(crate) x: Vec<Mode>,
    pub(crate) y: Vec<Mode>,
}

/// A point on the limit of stability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Frequency of the chatter, Hz.
    pub frequency_hz: f64,
    /// Limit of the depth of cut, m.
    pub depth_m: f64,
    /// Fraction of a wave by which successive cuts are out of step, 0 to 1.
    pub phase: f64,
}

impl Limit {
    /// Spindle speed, rpm, at which `waves` whole waves plus the phase are between two cuts of
    /// `cuts_per_rev`.
    #[must_use]
    pub fn speed_rpm(&self, waves: u32, cuts_per_rev: u32) -> f64 {
        60.0 * self.frequency_hz / (f64::from(waves) + self.phase) / f64::from(cuts_per_rev.max(1))
    }
}

/// Limits over the frequency: of turning, or of milling by its zeroth harmonic.
pub trait Lobes {
    /// Limits at a frequency: none, one, or more.
    fn limits(&self, frequency_hz: f64) -> [Option<Limit>; 2];
    /// Modes, which determine the range of frequencies.
    fn modes(&self) -> Vec<Mode>;
    /// Cuts per revolution.
    fn cuts_per_rev(&self) -> u32;

    /// Frequencies to evaluate: 2000 over the modes, denser near each of them.
    fn frequencies(&self) -> Vec<f64> {
        let modes = self.modes();
        let min = modes
            .iter()
            .map(|mode| mode.frequency_hz)
            .fold(f64::INFINITY, f64::min);
        let max = modes.iter().map(|mode| mode.frequency_hz).fold(0.0, f64::max);
        let mut all: Vec<f64> = (0..800)
            .map(|k| 0.3 * min * libm::pow(10.0 * max / min, f64::from(k) / 799.0))
            .collect();
        for mode in &modes {
            // From far below the half width of the resonance to far above it.
            for k in -200..=200 {
                let s = f64::from(k) / 200.0;
                let by = mode.damping_ratio * 20.0 * s * s * s;
                let frequency = mode.frequency_hz * (1.0 + by);
                if frequency > 0.0 {
                    all.push(frequency);
                }
            }
        }
        all.sort_by(f64::total_cmp);
        all.dedup();
        all
    }

    /// The local minima of the limit over the frequency, which are stable at every speed. Accurate to 1e-10
    /// of the frequency.
    fn minima(&self) -> Vec<Limit> {
        let frequencies = self.frequencies();
        let depth = |frequency: f64, root: usize| {
            self.limits(frequency)
                .get(root)
                .copied()
                .flatten()
                .map_or(f64::INFINITY, |limit| limit.depth_m)
        };
        let mut minima = Vec::new();
        for root in 0..2 {
            for three in frequencies.windows(3) {
                let [a, b, c] = [three[0], three[1], three[2]];
                let here = depth(b, root);
                if !here.is_finite() || depth(a, root) < here || depth(c, root) <= here {
                    continue;
                }
                // Golden section: the limit has one minimum between neighbours of a minimum.
                let (mut low, mut high) = (a, c);
                let part = 0.5 * (3.0 - libm::sqrt(5.0));
                for _ in 0..200 {
                    let (left, right) = (low + part * (high - low), high - part * (high - low));
                    if depth(left, root) < depth(right, root) {
                        high = right;
                    } else {
                        low = left;
                    }
                    if high - low <= 1e-10 * high {
                        break;
                    }
                }
                if let Some(limit) = self.limits(0.5 * (low + high))[root] {
                    minima.push(limit);
                }
            }
        }
        minima.sort_by(|a, b| a.depth_m.total_cmp(&b.depth_m));
        minima
    }

    /// The limit of the depth at a spindle speed, to 1e-10 of the frequency; `None` if no depth chatters.
    fn limit_at(&self, speed_rpm: f64) -> Option<Limit> {
        let period = 60.0 / (speed_rpm * f64::from(self.cuts_per_rev()));
        // Between these frequencies the depth is monotone: of many crossings only the one at the lower end is
        // needed.
        let mut frequencies = self.frequencies();
        frequencies.extend(self.minima().iter().map(|limit| limit.frequency_hz));
        frequencies.sort_by(f64::total_cmp);
        let wrapped = |phase: f64| phase - libm::round(phase);
        let mut best: Option<Limit> = None;
        for root in 0..2 {
            let limits = frequencies.iter().map(|&frequency| self.limits(frequency)[root]);
            let limits: Vec<Option<Limit>> = limits.collect();
            for pair in limits.windows(2) {
                let (Some(first), Some(second)) = (pair[0], pair[1]) else {
                    continue;
                };
                let (low, high) = if first.depth_m <= second.depth_m {
                    (first, second)
                } else {
                    (second, first)
                };
                if best.is_some_and(|best| best.depth_m <= low.depth_m) {
                    continue;
                }
                // Waves between two cuts minus those of the phase, which is continuous between neighbours.
                let waves = |limit: &Limit| {
                    limit.frequency_hz * period - low.phase - wrapped(limit.phase - low.phase)
                };
                let (from, to) = (waves(&low), waves(&high));
                let whole = if to >= from {
                    libm::ceil(from)
                } else {
                    libm::floor(from)
                };
                if (whole - from) * (whole - to) > 0.0 {
                    continue;
                }
                let (mut near, mut far) = (low.frequency_hz, high.frequency_hz);
                let mut found = low;
                for _ in 0..60 {
                    let middle = 0.5 * (near + far);
                    let Some(limit) = self.limits(middle)[root] else {
                        break;
                    };
                    found = limit;
                    if (waves(&limit) - whole) * (from - whole) > 0.0 {
                        near = middle;
                    } else {
                        far = middle;
                    }
                }
                // Where roots change their order there is a jump instead of a crossing.
                if (waves(&found) - whole).abs() < 1e-6
                    && best.is_none_or(|best| found.depth_m < best.depth_m)
                {
                    best = Some(found);
                }
            }
        }
        best
    }
}

/// Gain below which a mode counts as not excited: the rounding of two cosines gives 6e-17, a mode at 0.001
/// degrees from the right angle 2e-5.
const UNEXCITED: f64 = 1e-12;

impl Turning {
    /// Modes, the angle between the cutting force and the direction of the chip thickness in degrees, and the
    /// cutting coefficient in N/m2.
    ///
    /// The gain of a mode is the fraction of the force that drives it, times the fraction of its motion that
    /// changes the chip.
    ///
    /// # Errors
    /// No mode, or invalid numbers.
    pub fn new(modes: &[TurningMode], force_deg: f64, coefficient_n_m2: f64) -> Result<Self, ChatterError> {
        number("number of modes", modes.len() as f64, 1.0, 50.0)?;
        number("force direction", force_deg, -360.0, 360.0)?;
        number("cutting coefficient in N/m2", coefficient_n_m2, 1e3, 1e13)?;
        let mut checked = Vec::with_capacity(modes.len());
        for mode in modes {
            number("direction_deg", mode.direction_deg, -360.0, 360.0)?;
            let (along, force) = (mode.direction_deg.to_radians(), force_deg.to_radians());
            let gain = libm::cos(along) * libm::cos(along - force);
            // At a right angle rounded cosines are not exactly 0: a mode that the force does not excite has
            // no limit.
            let gain = if gain.abs() < UNEXCITED { 0.0 } else { gain };
            checked.push((mode.mode.checked()?, gain));
        }
        Ok(Self {
            modes: checked,
            coefficient_n_m2,
        })
    }

    /// Modes with their gains.
    pub(crate) fn gains(&self) -> &[(Mode, f64)] {
        &self.modes
    }

    pub(crate) fn coefficient(&self) -> f64 {
        self.coefficient_n_m2
    }
}

impl Lobes for Turning {
    /// `b = -1 / (2 K Re G)` and the phase `3 pi + 2 arg G` (Y. Altintas, "Manufacturing Automation", chapter
    /// on orthogonal chatter).
    fn limits(&self, frequency_hz: f64) -> [Option<Limit>; 2] {
        let g: C = self
            .modes
            .iter()
            .map(|(mode, gain)| mode.response(frequency_hz) * *gain)
            .sum();
        if g.re >= 0.0 {
            return [None; 2];
        }
        let depth_m = -1.0 / (2.0 * self.coefficient_n_m2 * g.re);
        let phase = libm::atan2(g.im, g.re) / std::f64::consts::PI + 1.5;
        [
            Some(Limit {
                frequency_hz,
                depth_m,
                phase: phase - libm::floor(phase),
            }),
            None,
        ]
    }

    fn modes(&self) -> Vec<Mode> {
        self.modes.iter().map(|(mode, _)| *mode).collect()
    }

    fn cuts_per_rev(&self) -> u32 {
        1
    }
}

impl MillingCut {
    fn checked(self) -> Result<Self, ChatterError> {
        number("teeth", f64::from(self.teeth), 1.0, 100.0)?;
        number("entry_deg", self.entry_deg, 0.0, 180.0)?;
        number("exit_deg", self.exit_deg, self.entry_deg + 0.01, 180.0)?;
        number("tangential coefficient in N/m2", self.tangential_n_m2, 1e3, 1e13)?;
        number("radial coefficient in N/m2", self.radial_n_m2, -1e13, 1e13)?;
        Ok(self)
    }

    /// A cut over a fraction of the tool's diameter, in down-milling (climb) or up-milling (conventional).
    #[must_use]
    pub fn with_immersion(self, part: f64, down: bool) -> Self {
        let (entry, exit) = if down {
            (
                libm::acos((2.0 * part - 1.0).clamp(-1.0, 1.0)),
                std::f64::consts::PI,
            )
        } else {
            (0.0, libm::acos((1.0 - 2.0 * part).clamp(-1.0, 1.0)))
        };
        Self {
            entry_deg: entry.to_degrees(),
            exit_deg: exit.to_degrees(),
            ..self
        }
    }
}

impl Milling {
    /// A cut with its modes along the feed and across it.
    ///
    /// # Errors
    /// No mode, or invalid numbers of the cut.
    pub fn new(cut: MillingCut, x: &[Mode], y: &[Mode]) -> Result<Self, ChatterError> {
        number("number of modes", (x.len() + y.len()) as f64, 1.0, 20.0)?;
        let checked = |modes: &[Mode]| {
            modes
                .iter()
                .map(|mode| mode.checked())
                .collect::<Result<Vec<_>, _>>()
        };
        Ok(Self {
            cut: cut.checked()?,
            x: checked(x)?,
            y: checked(y)?,
        })
    }

    /// The cut.
    #[must_use]
    pub fn cut(&self) -> &MillingCut {
        &self.cut
    }

    /// Mean of the directional factors over the path of a tooth: xx, xy, yx, yy.
    fn directions(&self) -> [f64; 4] {
        let kr = self.cut.radial_n_m2 / self.cut.tangential_n_m2;
        let at = |degrees: f64| {
            let p = degrees.to_radians();
            let (c, s) = (libm::cos(2.0 * p), libm::sin(2.0 * p));
            [
                0.5 * (c - 2.0 * kr * p + kr * s),
                0.5 * (-s - 2.0 * p + kr * c),
                0.5 * (-s + 2.0 * p + kr * c),
                0.5 * (-c - 2.0 * kr * p - kr * s),
            ]
        };
        let (entry, exit) = (at(self.cut.entry_deg), at(self.cut.exit_deg));
        std::array::from_fn(|k| exit[k] - entry[k])
    }
}

impl Lobes for Milling {
    /// The zeroth harmonic of the directional factors: the eigenvalues of a quadratic (Y. Altintas, E. Budak,
    /// "Analytical prediction of stability lobes in milling", 1995). Accurate for large immersion. At small
    /// immersion it misses the lobes of period doubling: see [`crate::MillingDelay`].
    fn limits(&self, frequency_hz: f64) -> [Option<Limit>; 2] {
        let sum = |modes: &[Mode]| modes.iter().map(|mode| mode.response(frequency_hz)).sum::<C>();
        let (gx, gy) = (sum(&self.x), sum(&self.y));
        let [xx, xy, yx, yy] = self.directions();
        let a0 = gx * gy * (xx * yy - xy * yx);
        let a1 = gx * xx + gy * yy;
        let eigenvalues = if a0.norm() <= 1e-12 * a1.norm_sqr() {
            // One direction is stiff.
            [-a1.inv(), C::new(f64::NAN, 0.0)]
        } else {
            let root = (a1 * a1 - a0 * 4.0).sqrt();
            [-(a1 + root) / (a0 * 2.0), -(a1 - root) / (a0 * 2.0)]
        };
        eigenvalues.map(|value| {
            let ratio = value.im / value.re;
            let depth_m = -std::f64::consts::TAU * value.re * (1.0 + ratio * ratio)
                / (f64::from(self.cut.teeth) * self.cut.tangential_n_m2);
            // False for NaN too.
            if !(depth_m > 0.0 && depth_m.is_finite()) {
                return None;
            }
            let phase = 0.5 - libm::atan(ratio) / std::f64::consts::PI;
            Some(Limit {
                frequency_hz,
                depth_m,
                phase: phase - libm::floor(phase),
            })
        })
    }

    fn modes(&self) -> Vec<Mode> {
        self.x.iter().chain(&self.y).copied().collect()
    }

    fn cuts_per_rev(&self) -> u32 {
        self.cut.teeth
    }
}
