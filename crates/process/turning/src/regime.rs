//! Depths and feeds of self-programmed passes at a set load: equations (1) to (5) of Timiryazev, Mukhin and
//! Ivanov, and the conditions under which they hold.

use crate::law::CutLaw;
use crate::tool::CuttingEdge;
use crate::wear::Wear;
use evolvent_config::plain;

/// Input of the regime.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegimeInput {
    /// The load of a cut.
    pub law: CutLaw,
    /// The load to hold, in the unit of the law.
    pub set_load: f64,
    /// Maximum load of machine, chuck and insert.
    pub permitted_load: f64,
    /// Smallest feed at which chips still break, mm/rev.
    pub feed_min_mm_rev: f64,
    /// Largest feed that the roughness permits, mm/rev.
    pub feed_max_mm_rev: f64,
    /// Choice of the depth to which the tool backs off.
    pub back_off: BackOff,
}

/// Depth to which the tool backs off when a cut is too deep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BackOff {
    /// Equation (4): the remaining depths never need a feed beyond the limits.
    Balanced,
    /// The depth at which the passes take the least time.
    LeastTime,
    /// The depth of this feed, mm/rev.
    Feed(f64),
}

/// Depths and feeds of self-programmed passes.
///
/// ```
/// use evolvent_turning::{BackOff, CutLaw, Regime, RegimeInput, CuttingEdge};
/// let input = RegimeInput {
///     law: CutLaw { coefficient: 1467.0, depth_exponent: 1.0, feed_exponent: 0.75 },
///     set_load: 2200.0,
///     permitted_load: 10_000.0,
///     feed_min_mm_rev: 0.2,
///     feed_max_mm_rev: 0.7,
///     back_off: BackOff::Balanced,
/// };
/// let regime = Regime::new(&input, &CuttingEdge::new(60.0, 12.0)?)?;
/// // Equation (4) of the paper.
/// assert!((regime.feed_back_off_mm_rev - 0.387_268).abs() < 1e-6);
/// assert_eq!(regime.passes(10.0), 3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Regime {
    /// The load of a cut.
    pub law: CutLaw,
    /// The load that is held.
    pub set_load: f64,
    /// Smallest feed, mm/rev.
    pub feed_min_mm_rev: f64,
    /// Largest feed, mm/rev.
    pub feed_max_mm_rev: f64,
    /// Feed that belongs to the depth after backing off, mm/rev: `s_o`.
    pub feed_back_off_mm_rev: f64,
    /// Depth at the smallest feed, mm: `t_max`. The tool backs off from deeper cuts.
    pub depth_max_mm: f64,
    /// Depth after backing off, mm: `t_o`.
    pub depth_back_off_mm: f64,
    /// Depth at the largest feed, mm: shallower cuts do not reach the set load.
    pub depth_full_feed_mm: f64,
    /// Cost of wear beside that of time, for the number of parts; zero for the least time.
    pub wear: Wear,
}

/// Name of the set load in errors.
pub(crate) const SET_LOAD: &str = "the set load";
pub(crate) const PERMITTED_LOAD: &str = "the permitted load";
pub(crate) const SMALLEST_FEED: &str = "the smallest feed";

/// Why there is no valid regime.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RegimeError {
    /// The law is invalid.
    #[error(
        "the force law needs a positive coefficient and exponents above 0.05 and at most 3, and has \
         {coefficient}, {depth_exponent} and {feed_exponent}"
    )]
    Law {
        /// Its coefficient.
        coefficient: f64,
        /// Its exponent of the depth.
        depth_exponent: f64,
        /// Its exponent of the feed.
        feed_exponent: f64,
    },
    /// A number out of range.
    #[error("{name} is {}; it must be a number above 0 and at most {max}", plain(*.value))]
    Number {
        /// Name.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Maximum.
        max: f64,
    },
    /// Feeds in the wrong order.
    #[error("the smallest feed, {min} mm/rev, must lie below the largest, {max} mm/rev")]
    Feeds {
        /// Smallest.
        min: f64,
        /// Largest.
        max: f64,
    },
    /// The range of feeds is too narrow for equation (4).
    #[error(
        "equation (4) would back off to a feed of {feed_mm_rev:.4} mm/rev, above the largest, {max} mm/rev: \
         the largest feed must be at least {min_ratio:.3} times the smallest, and is {ratio:.3} times; \
         lower the smallest feed to {wanted_min:.4} mm/rev or choose the depth of least time"
    )]
    Narrow {
        /// Feed by equation (4).
        feed_mm_rev: f64,
        /// Largest feed.
        max: f64,
        /// Minimum ratio: 2^(xz/yz).
        min_ratio: f64,
        /// Actual ratio.
        ratio: f64,
        /// Largest minimum feed that satisfies the equation.
        wanted_min: f64,
    },
    /// The feed chosen for backing off is outside the limits.
    #[error("the feed after backing off, {feed_mm_rev} mm/rev, must lie above {min} and up to {max} mm/rev")]
    BackOffFeed {
        /// Chosen.
        feed_mm_rev: f64,
        /// Smallest.
        min: f64,
        /// Largest.
        max: f64,
    },
    /// The deepest cut at the smallest feed gives the set load, which exceeds the permitted load.
    #[error("the set load {set_load} is above the permitted load {permitted_load}: lower it")]
    Overload {
        /// Set.
        set_load: f64,
        /// Permitted.
        permitted_load: f64,
    },
    /// The cutting edge is too short for the deepest cut.
    #[error(
        "the deepest cut, {depth_mm:.3} mm at the smallest feed, is longer than the edge can cut, \
         {reach_mm:.3} mm (length times the sine of the lead angle): raise the smallest feed above \
         {wanted_min:.4} mm/rev, lower the set load, or take a longer edge"
    )]
    Edge {
        /// Deepest cut.
        depth_mm: f64,
        /// Maximum depth of the edge.
        reach_mm: f64,
        /// Minimum feed at which the edge is long enough.
        wanted_min: f64,
    },
}

impl Regime {
    /// Computes the values and checks every condition, including those that the paper omits.
    ///
    /// # Errors
    /// The condition that fails, with its numbers.
    pub fn new(input: &RegimeInput, tool: &CuttingEdge) -> Result<Self, RegimeError> {
        let law = input.law;
        if !law.is_sound() {
            return Err(RegimeError::Law {
                coefficient: law.coefficient,
                depth_exponent: law.depth_exponent,
                feed_exponent: law.feed_exponent,
            });
        }
        let (low, high) = (input.feed_min_mm_rev, input.feed_max_mm_rev);
        for (name, value, max) in [
            (SET_LOAD, input.set_load, 1e9),
            (PERMITTED_LOAD, input.permitted_load, 1e9),
            (SMALLEST_FEED, low, 10.0),
            ("the largest feed", high, 10.0),
        ] {
            if !(value > 0.0 && value <= max) {
                return Err(RegimeError::Number { name, value, max });
            }
        }
        if low >= high {
            return Err(RegimeError::Feeds { min: low, max: high });
        }
        if input.set_load > input.permitted_load {
            return Err(RegimeError::Overload {
                set_load: input.set_load,
                permitted_load: input.permitted_load,
            });
        }
        let depth_max_mm = law.depth_mm(input.set_load, low);
        let reach_mm = tool.reach_mm();
        if depth_max_mm > reach_mm {
            return Err(RegimeError::Edge {
                depth_mm: depth_max_mm,
                reach_mm,
                wanted_min: law.feed_mm_rev(input.set_load, reach_mm),
            });
        }
        let depth_full_feed_mm = law.depth_mm(input.set_load, high);
        let feed_back_off_mm_rev = match input.back_off {
            BackOff::Balanced => balanced_feed(&law, low, high)?,
            BackOff::LeastTime => high,
            BackOff::Feed(feed) => {
                if !(feed > low && feed <= high) {
                    return Err(RegimeError::BackOffFeed {
                        feed_mm_rev: feed,
                        min: low,
                        max: high,
                    });
                }
                feed
            }
        };
        Ok(Self {
            law,
            set_load: input.set_load,
            feed_min_mm_rev: low,
            feed_max_mm_rev: high,
            feed_back_off_mm_rev,
            depth_max_mm,
            depth_back_off_mm: law.depth_mm(input.set_load, feed_back_off_mm_rev),
            depth_full_feed_mm,
            wear: Wear::default(),
        })
    }

    /// Remaining depth of equation (3) after backing off from the deepest cut, mm: `t_min`.
    #[must_use]
    pub fn depth_left_mm(&self) -> f64 {
        self.depth_max_mm - self.depth_back_off_mm
    }

    /// Number of passes for an allowance: equation (5), rounded to whole passes. The last pass may take the
    /// deepest cut.
    #[must_use]
    pub fn passes(&self, allowance_mm: f64) -> u32 {
        if allowance_mm <= 0.0 {
            0
        } else if allowance_mm <= self.depth_max_mm {
            1
        } else {
            let more = (allowance_mm - self.depth_max_mm) / self.depth_back_off_mm;
            1 + (more - 1e-9).ceil().clamp(0.0, 1e6) as u32
        }
    }

    /// Feed for a depth at the set load within the limits, mm/rev. Real-time safe.
    #[must_use]
    pub fn feed_mm_rev(&self, depth_mm: f64) -> f64 {
        if depth_mm <= self.depth_full_feed_mm {
            self.feed_max_mm_rev
        } else {
            self.law
                .feed_mm_rev(self.set_load, depth_mm)
                .max(self.feed_min_mm_rev)
        }
    }

    /// Number of equal passes that takes the least time, or with [`Regime::wear`] costs the least. A pass
    /// costs `overhead_rev` revolutions beside its `length_mm` of cut. Real-time safe.
    ///
    /// At constant load the removal rate is proportional to `depth^(1 - xz/yz)`: with `xz > yz` shallow
    /// passes are faster, until the largest feed is reached.
    #[must_use]
    pub fn fastest_passes(&self, allowance_mm: f64, length_mm: f64, overhead_rev: f64) -> u32 {
        let min = (allowance_mm / self.depth_max_mm - 1e-9).ceil().max(1.0);
        let max = (allowance_mm / self.depth_full_feed_mm)
            .ceil()
            .clamp(min, min + 64.0);
        let (mut best, mut best_time, mut passes) = (min, f64::INFINITY, min);
        while passes <= max {
            let depth = allowance_mm / passes;
            let feed = self.feed_mm_rev(depth);
            let time = passes * (length_mm / feed * self.wear.price(depth, feed) + overhead_rev);
            if time < best_time {
                (best, best_time) = (passes, time);
            }
            passes += 1.0;
        }
        best as u32
    }
}

/// Equation (4) with the sign of the difference corrected: `s_o = s_max s_min / (s_max^p - s_min^p)^(1/p)`,
/// `p = yz/xz`.
fn balanced_feed(law: &CutLaw, low: f64, high: f64) -> Result<f64, RegimeError> {
    let p = 1.0 / law.exponent_ratio();
    let difference = libm::pow(high, p) - libm::pow(low, p);
    let feed = high * low / libm::pow(difference, 1.0 / p);
    // s_o <= s_max exactly where s_max/s_min >= 2^(1/p).
    let min_ratio = libm::pow(2.0, 1.0 / p);
    if feed > high {
        return Err(RegimeError::Narrow {
            feed_mm_rev: feed,
            max: high,
            min_ratio,
            ratio: high / low,
            wanted_min: high / min_ratio,
        });
    }
    Ok(feed)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn input() -> RegimeInput {
        RegimeInput {
            law: CutLaw {
                coefficient: 2943.0 * libm::pow(103.672_557_568_463_18, -0.15),
                depth_exponent: 1.0,
                feed_exponent: 0.75,
            },
            set_load: 2200.0,
            permitted_load: 3000.0,
            feed_min_mm_rev: 0.2,
            feed_max_mm_rev: 0.7,
            back_off: BackOff::Balanced,
        }
    }

    fn tool() -> CuttingEdge {
        CuttingEdge::new(60.0, 12.0).unwrap()
    }

    #[test]
    fn the_published_example_comes_out() {
        let regime = Regime::new(&input(), &tool()).unwrap();
        assert!((regime.feed_back_off_mm_rev - 0.387_268_365_888_683_5).abs() < 1e-12);
        assert!((regime.depth_max_mm - 5.014_290_533_615_231).abs() < 1e-9);
        assert!((regime.depth_back_off_mm - 3.054_731_007_986_509).abs() < 1e-9);
        assert!((regime.depth_left_mm() - 1.959_559_525_628_722_6).abs() < 1e-9);
        // The remaining depth takes exactly the largest feed: the meaning of (4).
        assert!((regime.depth_left_mm() - regime.depth_full_feed_mm).abs() < 1e-9);
    }

    #[test]
    fn passes_are_whole_and_the_last_cut_is_deepest() {
        let regime = Regime::new(&input(), &tool()).unwrap();
        for (allowance, passes) in [
            (0.0, 0),
            (5.0, 1),
            (5.1, 2),
            (8.0, 2),
            (8.069, 2),
            (8.07, 3),
            (10.0, 3),
        ] {
            assert_eq!(regime.passes(allowance), passes, "{allowance}");
        }
        // The case file's best number of equal passes.
        assert_eq!(regime.fastest_passes(8.0, 200.0, 34.0), 4);
        assert_eq!(regime.fastest_passes(10.0, 200.0, 34.0), 5);
        assert_eq!(regime.fastest_passes(7.0, 200.0, 34.0), 3);
    }

    #[test]
    fn least_cost_matches_search_over_pass_counts() {
        let mut regime = Regime::new(&input(), &tool()).unwrap();
        let mut changed = 0;
        for ratio in [0.0, 0.2, 1.0, 5.0] {
            for (feed_exponent, depth_exponent) in [(0.6, 0.15), (1.0, 0.3), (0.2, 0.8)] {
                regime.wear = Wear {
                    ratio,
                    feed_mm_rev: 0.3,
                    depth_mm: 3.0,
                    feed_exponent,
                    depth_exponent,
                };
                for tenths in 5..100_u32 {
                    let height = 0.1 * f64::from(tenths);
                    // Machine time and edges in money: 60 an hour, an edge of 5 with a tool life.
                    let (machine, edge) = (60.0 / 3600.0, 5.0);
                    let cost = |n: u32| {
                        let depth = height / f64::from(n);
                        let feed = (2200.0 / (regime.law.coefficient * depth))
                            .powf(1.0 / 0.75)
                            .clamp(0.2, 0.7);
                        let cut_s = 200.0 / feed * 0.12;
                        let scale = (feed / 0.3).powf(feed_exponent) * (depth / 3.0).powf(depth_exponent);
                        let edges = if ratio > 0.0 {
                            cut_s * scale * ratio * machine / edge
                        } else {
                            0.0
                        };
                        f64::from(n) * ((cut_s + 34.0 * 0.12) * machine + edges * edge)
                    };
                    let best = (1..20)
                        .filter(|n| height / f64::from(*n) <= regime.depth_max_mm)
                        .min_by(|a, b| cost(*a).total_cmp(&cost(*b)))
                        .unwrap();
                    let chosen = regime.fastest_passes(height, 200.0, 34.0);
                    assert!(
                        cost(chosen) <= cost(best) * (1.0 + 1e-9),
                        "{height}: {chosen} for {best}, {ratio}"
                    );
                    let least_time = Regime {
                        wear: Wear::default(),
                        ..regime
                    }
                    .fastest_passes(height, 200.0, 34.0);
                    changed += u32::from(chosen != least_time);
                }
            }
        }
        assert!(changed > 50, "{changed}");
    }

    #[test]
    fn what_does_not_fit_is_refused_with_its_numbers() {
        let check = |change: &dyn Fn(&mut RegimeInput)| {
            let mut changed = input();
            change(&mut changed);
            Regime::new(&changed, &tool()).unwrap_err()
        };
        let narrow = check(&|input| input.feed_min_mm_rev = 0.35);
        let RegimeError::Narrow {
            feed_mm_rev,
            min_ratio,
            ratio,
            ..
        } = narrow
        else {
            panic!("{narrow}")
        };
        assert!((feed_mm_rev - 1.1665).abs() < 1e-4, "{feed_mm_rev}");
        assert!((min_ratio - 2.520).abs() < 1e-3 && (ratio - 2.0).abs() < 1e-12);
        assert!(matches!(
            check(&|input| input.feed_min_mm_rev = 0.8),
            RegimeError::Feeds { .. }
        ));
        assert!(matches!(
            check(&|input| input.set_load = f64::NAN),
            RegimeError::Number { .. }
        ));
        assert!(matches!(
            check(&|input| input.permitted_load = 2000.0),
            RegimeError::Overload { .. }
        ));
        assert!(matches!(
            check(&|input| input.law.feed_exponent = 0.0),
            RegimeError::Law { .. }
        ));
        assert!(matches!(
            check(&|input| input.back_off = BackOff::Feed(0.1)),
            RegimeError::BackOffFeed { .. }
        ));
        let short = Regime::new(&input(), &CuttingEdge::new(60.0, 5.0).unwrap()).unwrap_err();
        assert!(matches!(short, RegimeError::Edge { reach_mm, .. } if (reach_mm - 4.330_127).abs() < 1e-6));
    }

    #[test]
    fn the_minimum_range_follows_from_the_exponents() {
        for (x, y) in [(1.0, 0.75), (0.9, 0.8), (1.2, 0.6)] {
            let mut changed = input();
            (changed.law.depth_exponent, changed.law.feed_exponent) = (x, y);
            changed.set_load = 500.0;
            let ratio = 2.0_f64.powf(x / y);
            changed.feed_min_mm_rev = 0.7 / ratio * (1.0 + 1e-6);
            assert!(matches!(
                Regime::new(&changed, &CuttingEdge::new(60.0, 100.0).unwrap()),
                Err(RegimeError::Narrow { .. })
            ));
            changed.feed_min_mm_rev = 0.7 / ratio * (1.0 - 1e-6);
            assert!(Regime::new(&changed, &CuttingEdge::new(60.0, 100.0).unwrap()).is_ok());
        }
    }
}
