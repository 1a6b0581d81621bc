//! Measured forces in a table.

use crate::error::{ForceError, LawError};
use crate::force::SectionForce;
use crate::power::number;

/// Maximum number of entries along an axis.
const MAX_ENTRIES: usize = 200;

/// Forces over speed, depth and feed, interpolated by cubics in the logarithms of all four.
///
/// A table that was sampled from a power law is therefore that power law. Force and first derivatives are
/// continuous, and the force is positive everywhere. An axis with one entry uses an exponent instead. Below
/// the first depth and the first feed the power law of the first two entries continues, because a cut begins
/// at zero. Elsewhere the table ends at its last entries.
#[derive(Clone, Debug, PartialEq)]
pub struct ForceTable {
    speed: Axis,
    depth: Axis,
    feed: Axis,
    /// Logarithm of the force: speeds innermost, feeds outermost.
    ln_force: Vec<f64>,
}

#[derive(Clone, Debug, PartialEq)]
struct Axis {
    quantity: &'static str,
    entries: Vec<f64>,
    logs: Vec<f64>,
    /// Exponent where there is one entry.
    exponent: f64,
    /// The power law continues below the first entry.
    open_below: bool,
}

/// Weights of the entries, for the value and for its derivative by the logarithm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Weights {
    first: usize,
    count: usize,
    value: [f64; 4],
    slope: [f64; 4],
    /// Logarithm of the factor by the exponent, and that exponent.
    factor: f64,
    exponent: f64,
}

impl ForceTable {
    /// A table with its axes, and the exponents for axes of one entry (speed, depth, feed).
    ///
    /// `force_n[feed][depth][speed]`, N.
    ///
    /// ```
    /// use evolvent_cutting::{Cut, ForceLaw, ForceTable};
    /// // Two speeds, one depth, one feed; the exponents carry it to other depths and feeds.
    /// let table = ForceTable::new(
    ///     &[60.0, 90.0],
    ///     &[2.0],
    ///     &[0.3],
    ///     &[vec![vec![1500.0, 1400.0]]],
    ///     [None, Some(1.0), Some(0.75)],
    /// )?;
    /// let law = ForceLaw::from(table);
    /// let force = law.force(Cut { speed_m_min: 60.0, depth_mm: 4.0, feed_mm_rev: 0.3 })?;
    /// assert!((force.tangential_n - 3000.0).abs() < 1e-6);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// Axes that do not rise, forces that are not positive or do not fit the axes, a missing exponent.
    pub fn new(
        speed_m_min: &[f64],
        depth_mm: &[f64],
        feed_mm_rev: &[f64],
        force_n: &[Vec<Vec<f64>>],
        exponents: [Option<f64>; 3],
    ) -> Result<Self, LawError> {
        let speed = Axis::new("speed", "m/min", speed_m_min, exponents[0], false)?;
        let depth = Axis::new("depth", "mm depth", depth_mm, exponents[1], true)?;
        let feed = Axis::new("feed", "mm/rev", feed_mm_rev, exponents[2], true)?;
        let fits = force_n.len() == feed.len()
            && force_n.iter().all(|rows| {
                rows.len() == depth.len() && rows.iter().all(|forces| forces.len() == speed.len())
            });
        if !fits {
            return Err(LawError::Shape {
                feeds: feed.len(),
                depths: depth.len(),
                speeds: speed.len(),
            });
        }
        let mut ln_force = Vec::with_capacity(feed.len() * depth.len() * speed.len());
        for &force in force_n.iter().flatten().flatten() {
            number("a force of the table", force, 1e-6, 1e9)?;
            ln_force.push(libm::log(force));
        }
        Ok(Self {
            speed,
            depth,
            feed,
            ln_force,
        })
    }

    pub(crate) fn at_feed(&self, feed: f64) -> Result<Weights, ForceError> {
        self.feed.weights(feed)
    }

    pub(crate) fn force(&self, feed: &Weights, speed: f64, depth: f64) -> Result<SectionForce, ForceError> {
        let [ln, by_speed, by_depth, _] = self.logs(feed, speed, depth)?;
        let force = libm::exp(ln);
        Ok(SectionForce {
            tangential_n: force,
            per_speed: force * by_speed / speed,
            per_depth: force * by_depth / depth,
        })
    }

    pub(crate) fn per_feed(
        &self,
        weights: &Weights,
        feed: f64,
        speed: f64,
        depth: f64,
    ) -> Result<f64, ForceError> {
        let [ln, _, _, by_feed] = self.logs(weights, speed, depth)?;
        Ok(libm::exp(ln) * by_feed / feed)
    }

    /// Logarithm of the force and its derivatives by the logarithms of speed, depth and feed.
    fn logs(&self, feed: &Weights, speed: f64, depth: f64) -> Result<[f64; 4], ForceError> {
        let (along_speed, along_depth) = (self.speed.weights(speed)?, self.depth.weights(depth)?);
        let mut logs = [
            feed.factor + along_speed.factor + along_depth.factor,
            along_speed.exponent,
            along_depth.exponent,
            feed.exponent,
        ];
        for i in 0..feed.count {
            for j in 0..along_depth.count {
                let row = ((feed.first + i) * self.depth.len() + along_depth.first + j) * self.speed.len();
                for k in 0..along_speed.count {
                    let ln = self
                        .ln_force
                        .get(row + along_speed.first + k)
                        .copied()
                        .unwrap_or(f64::NAN);
                    let (f, d, s) = (feed.value[i], along_depth.value[j], along_speed.value[k]);
                    logs[0] += ln * f * d * s;
                    logs[1] += ln * f * d * along_speed.slope[k];
                    logs[2] += ln * f * along_depth.slope[j] * s;
                    logs[3] += ln * feed.slope[i] * d * s;
                }
            }
        }
        Ok(logs)
    }
}

impl Axis {
    fn new(
        name: &'static str,
        quantity: &'static str,
        entries: &[f64],
        exponent: Option<f64>,
        open_below: bool,
    ) -> Result<Self, LawError> {
        if entries.is_empty() || entries.len() > MAX_ENTRIES {
            return Err(LawError::Axis {
                axis: name,
                entry: entries.len(),
                value: f64::NAN,
            });
        }
        let mut last = 0.0;
        for (entry, &value) in entries.iter().enumerate() {
            // False for NaN too; slopes between closer entries are noise.
            if !(value > last * (1.0 + 1e-6) && (1e-6..=1e6).contains(&value)) {
                return Err(LawError::Axis {
                    axis: name,
                    entry,
                    value,
                });
            }
            last = value;
        }
        if entries.len() == 1 && exponent.is_none() {
            return Err(LawError::NoExponent { axis: name });
        }
        let exponent = exponent.unwrap_or(0.0);
        number("an exponent of the table", exponent, -10.0, 10.0)?;
        Ok(Self {
            quantity,
            logs: entries.iter().map(|&value| libm::log(value)).collect(),
            entries: entries.to_vec(),
            exponent,
            open_below,
        })
    }

    fn len(&self) -> usize {
        self.entries.len()
    }

    fn weights(&self, at: f64) -> Result<Weights, ForceError> {
        let x = libm::log(at);
        let (Some(&first), Some(&last)) = (self.logs.first(), self.logs.last()) else {
            return Err(self.outside(at));
        };
        if self.len() == 1 {
            return Ok(Weights {
                first: 0,
                count: 1,
                value: [1.0, 0.0, 0.0, 0.0],
                slope: [0.0; 4],
                factor: self.exponent * (x - first),
                exponent: self.exponent,
            });
        }
        if x < first && self.open_below {
            return Ok(self.below(x, first));
        }
        if !(first..=last).contains(&x) {
            return Err(self.outside(at));
        }
        let i = self
            .logs
            .partition_point(|&log| log <= x)
            .clamp(1, self.len() - 1)
            - 1;
        Ok(self.cubic(i, x))
    }

    /// The power law of the first two entries.
    fn below(&self, x: f64, first: f64) -> Weights {
        let step = self.step(0);
        let part = (x - first) / step;
        Weights {
            first: 0,
            count: 2,
            value: [1.0 - part, part, 0.0, 0.0],
            slope: [-1.0 / step, 1.0 / step, 0.0, 0.0],
            factor: 0.0,
            exponent: 0.0,
        }
    }

    fn step(&self, i: usize) -> f64 {
        match (self.logs.get(i), self.logs.get(i + 1)) {
            (Some(from), Some(to)) => to - from,
            _ => f64::NAN,
        }
    }

    /// Hermite cubic between entries `i` and `i + 1`. Slopes are those of the parabola through three entries,
    /// at the ends of the straight line; all are linear in the entries.
    fn cubic(&self, i: usize, x: f64) -> Weights {
        let first = i.saturating_sub(1);
        let (before, here, after) = (i > 0, i - first, i + 2 < self.len());
        let step = self.step(i);
        let s = (x - self.logs.get(i).copied().unwrap_or(f64::NAN)) / step;
        // Weights of the slopes at both ends, times the step.
        let (mut from, mut to) = ([0.0; 4], [0.0; 4]);
        let add = |slope: &mut [f64; 4], interval: usize, part: f64| {
            // The difference quotient of that interval of the window.
            let width = self.step(first + interval);
            slope[interval] -= part * step / width;
            slope[interval + 1] += part * step / width;
        };
        if before {
            let width = self.step(i - 1);
            add(&mut from, 0, step / (width + step));
            add(&mut from, 1, width / (width + step));
        } else {
            add(&mut from, 0, 1.0);
        }
        if after {
            let width = self.step(i + 1);
            add(&mut to, here, width / (width + step));
            add(&mut to, here + 1, step / (width + step));
        } else {
            add(&mut to, here, 1.0);
        }
        let r = 1.0 - s;
        let (v0, v1) = (r * r * (1.0 + 2.0 * s), s * s * (3.0 - 2.0 * s));
        let (t0, t1) = (s * r * r, -s * s * r);
        let (dv, dt0, dt1) = (6.0 * s * r, r * (1.0 - 3.0 * s), s * (3.0 * s - 2.0));
        let mut value: [f64; 4] = std::array::from_fn(|k| t0 * from[k] + t1 * to[k]);
        let mut slope: [f64; 4] = std::array::from_fn(|k| (dt0 * from[k] + dt1 * to[k]) / step);
        value[here] += v0;
        value[here + 1] += v1;
        slope[here] -= dv / step;
        slope[here + 1] += dv / step;
        Weights {
            first,
            count: (here + 2 + usize::from(after)).min(4),
            value,
            slope,
            factor: 0.0,
            exponent: 0.0,
        }
    }

    fn outside(&self, value: f64) -> ForceError {
        ForceError::Outside {
            quantity: self.quantity,
            value,
            min: self.entries.first().copied().unwrap_or(f64::NAN),
            max: self.entries.last().copied().unwrap_or(f64::NAN),
        }
    }
}
