//! Every strategy on every stock of the reference cases, as a table.
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "an example prints its table"
)]
use evolvent_turning::*;

const SET_LOAD: f64 = 2200.0;
/// Length of every piece, mm.
const LENGTH_MM: f64 = 200.0;

/// Tool and law of a case, without the stock.
struct Case {
    law: CutLaw,
    tool: CuttingEdge,
    regime: Regime,
    fast_regime: Regime,
}

fn main() {
    let law = CutLaw {
        coefficient: 2943.0 * libm::pow(103.672_557_568_463_18, -0.15),
        depth_exponent: 1.0,
        feed_exponent: 0.75,
    };
    let tool = CuttingEdge::new(60.0, 12.0).unwrap();
    let regime = |back_off| {
        let input = RegimeInput {
            law,
            set_load: SET_LOAD,
            permitted_load: 10_000.0,
            feed_min_mm_rev: 0.2,
            feed_max_mm_rev: 0.7,
            back_off,
        };
        Regime::new(&input, &tool).unwrap()
    };
    let case = Case {
        law,
        tool,
        regime: regime(BackOff::Balanced),
        fast_regime: regime(BackOff::LeastTime),
    };
    let shown = std::env::args().nth(1);
    let mut sums = std::collections::BTreeMap::new();
    for (name, blank) in blanks() {
        println!("{name}");
        for (variant, settings, sensor) in case.variants() {
            let is_shown = shown.as_deref() == Some(&format!("{name}/{variant}"));
            let (figures, last) = case.adaptive(&blank, settings, sensor, is_shown);
            row(variant, &figures);
            if !figures.done {
                println!("    {last:?}");
            }
            *sums.entry(variant).or_insert(0.0) += figures.time_s;
        }
        for (cycle, figures) in case.fixed(&blank) {
            row(cycle, &figures);
            *sums.entry(cycle).or_insert(0.0) += figures.time_s;
        }
    }
    println!("{sums:#?}");
}

fn blanks() -> [(&'static str, Blank); 10] {
    let outline = |points: &[(f64, f64)]| Blank::outline(points);
    [
        ("uniform_8", Blank::uniform(8.0)),
        ("taper_5_10", outline(&[(0.0, 10.0), (200.0, 5.0)])),
        (
            "gap_8",
            Blank {
                grooves_mm: vec![(80.0, 120.0, 0.0)],
                ..Blank::uniform(8.0)
            },
        ),
        (
            "hardspot_7",
            Blank {
                hard_spots: vec![(60.0, 110.0, 1.35)],
                ..Blank::uniform(7.0)
            },
        ),
        ("uniform_3", Blank::uniform(3.0)),
        ("uniform_10", Blank::uniform(10.0)),
        ("taper_10_5", outline(&[(0.0, 5.0), (200.0, 10.0)])),
        (
            "step_4_8",
            outline(&[(0.0, 4.0), (100.0, 4.0), (100.0, 8.0), (200.0, 8.0)]),
        ),
        (
            "step_8_3",
            outline(&[(0.0, 8.0), (100.0, 8.0), (100.0, 3.0), (200.0, 3.0)]),
        ),
        (
            "bump",
            outline(&[(0.0, 3.0), (80.0, 3.0), (100.0, 7.0), (120.0, 3.0), (200.0, 3.0)]),
        ),
    ]
}

impl Case {
    fn usual(&self) -> TurningSettings {
        TurningSettings {
            overload_n: 9000.0,
            // The stock of the published cases ends with the cut.
            beyond_mm: 0.0,
            ..TurningSettings::usual(self.regime, self.tool, 500.0, LENGTH_MM)
        }
    }

    /// Every strategy with its sensor.
    fn variants(&self) -> [(&'static str, TurningSettings, SensorModel); 6] {
        let (base, fast_regime) = (self.usual(), self.fast_regime);
        let sensor = SensorModel {
            lag_s: 0.01,
            noise: 0.02,
            range_max: 20_000.0,
            seed: 0,
        };
        let fast = |face| TurningSettings {
            regime: fast_regime,
            strategy: Strategy::fast(&fast_regime, face),
            ..base
        };
        let literal = TurningSettings {
            strategy: Strategy::literal(&self.regime),
            ..base
        };
        let slow = TurningSettings {
            sensor_lag_s: 0.1,
            thin_mm: 6.0,
            confirm_s: 0.2,
            ..base
        };
        let continuing = TurningSettings {
            strategy: Strategy {
                on_thin: OnThin::Continue,
                ..Strategy::safe(&self.regime)
            },
            ..base
        };
        [
            ("literal", literal, sensor),
            ("safe", base, sensor),
            ("safe slow", slow, SensorModel { lag_s: 0.1, ..sensor }),
            ("safe continue", continuing, sensor),
            ("fast", fast(false), sensor),
            ("fast face", fast(true), sensor),
        ]
    }

    /// Load-adaptive passes.
    fn adaptive(
        &self,
        blank: &Blank,
        settings: TurningSettings,
        sensor: SensorModel,
        is_shown: bool,
    ) -> (Figures, Option<Reason>) {
        let mut simulation = Simulation::new(settings, blank.clone(), self.law, sensor).unwrap();
        simulation.run(2000.0, |output, _| {
            if let (true, Some(t)) = (is_shown, output.transition) {
                println!(
                    "   {:8.3} s u {:7.2} h {:5.2} P {:5.0} s {:.3} t {:.2} {:?} -> {:?}: {}",
                    t.cycle as f64 * 0.001,
                    t.along_mm,
                    t.out_mm,
                    t.load,
                    t.feed_mm_rev,
                    t.depth_mm,
                    t.from,
                    t.to,
                    t.reason.text()
                );
            }
        })
    }

    /// Fixed passes: at the nominal depth and feed, the fastest ones for known stock, and cautious ones.
    fn fixed(&self, blank: &Blank) -> [(&'static str, Figures); 3] {
        let (base, regime) = (self.usual(), &self.regime);
        let high_mm = blank.highest_mm(LENGTH_MM);
        let run = |depth_mm, feed_mm_rev| {
            let piece = Workpiece::new(blank.clone(), LENGTH_MM, self.law, self.tool, 120.0);
            run_fixed(
                FixedPasses::new(&base, high_mm, depth_mm, feed_mm_rev),
                piece,
                SET_LOAD,
            )
        };
        let known_mm = high_mm / f64::from(regime.fastest_passes(high_mm, LENGTH_MM, 34.0));
        let (depth_mm, feed_mm_rev) = (regime.depth_back_off_mm, regime.feed_back_off_mm_rev);
        [
            ("G82 nominal", run(depth_mm, feed_mm_rev)),
            ("G82 known", run(known_mm, regime.feed_mm_rev(known_mm))),
            ("G82 70 %", run(depth_mm, 0.7 * feed_mm_rev)),
        ]
    }
}

fn row(name: &str, f: &Figures) {
    println!(
        "  {name:14} passes {:2} time {:6.1} air {:5.1} return {:4.1} backs {} peak {:.3} >120% {:.3} >130% \
         {:.3} residual {:.4} under {:.4} holder {} done {}",
        f.passes,
        f.time_s,
        f.air_s,
        f.return_s,
        f.back_offs,
        f.peak / SET_LOAD,
        f.over_120_s,
        f.over_130_s,
        f.residual_mm,
        f.undercut_mm,
        f.hit_holder,
        f.done
    );
}
