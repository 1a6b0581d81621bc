//! Every strategy on every stock of the reference cases, as a table.
#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "an example prints its table"
)]
use evolvent_turning::*;

fn main() {
    let law = CutLaw {
        coefficient: 2943.0 * libm::pow(103.672_557_568_463_18, -0.15),
        depth_exponent: 1.0,
        feed_exponent: 0.75,
    };
    let tool = Tool::new(60.0, 12.0).unwrap();
    let input = RegimeInput {
        law,
        set_load: 2200.0,
        permitted_load: 10_000.0,
        feed_min_mm_rev: 0.2,
        feed_max_mm_rev: 0.7,
        back_off: BackOff::Balanced,
    };
    let regime = Regime::new(&input, &tool).unwrap();
    let fast_regime = Regime::new(
        &RegimeInput {
            back_off: BackOff::LeastTime,
            ..input
        },
        &tool,
    )
    .unwrap();
    let blanks = [
        ("uniform_8", Blank::uniform(8.0)),
        ("taper_5_10", Blank::outline(&[(0.0, 10.0), (200.0, 5.0)])),
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
        ("taper_10_5", Blank::outline(&[(0.0, 5.0), (200.0, 10.0)])),
        (
            "step_4_8",
            Blank::outline(&[(0.0, 4.0), (100.0, 4.0), (100.0, 8.0), (200.0, 8.0)]),
        ),
        (
            "step_8_3",
            Blank::outline(&[(0.0, 8.0), (100.0, 8.0), (100.0, 3.0), (200.0, 3.0)]),
        ),
        (
            "bump",
            Blank::outline(&[(0.0, 3.0), (80.0, 3.0), (100.0, 7.0), (120.0, 3.0), (200.0, 3.0)]),
        ),
    ];
    let verbose = std::env::args().nth(1);
    let mut sums = std::collections::BTreeMap::new();
    for (name, blank) in blanks {
        println!("{name}");
        let base = TurningSettings {
            overload_n: 9000.0,
            ..TurningSettings::usual(regime, tool, 500.0, 200.0)
        };
        let sensor = SensorModel {
            lag_s: 0.01,
            noise: 0.02,
            range_max: 20_000.0,
            seed: 0,
        };
        let slow_sensor = SensorModel { lag_s: 0.1, ..sensor };
        let variants = [
            (
                "literal",
                TurningSettings {
                    strategy: Strategy::literal(&regime),
                    ..base
                },
                sensor,
            ),
            ("safe", base, sensor),
            (
                "safe slow",
                TurningSettings {
                    sensor_lag_s: 0.1,
                    thin_mm: 6.0,
                    confirm_s: 0.2,
                    ..base
                },
                slow_sensor,
            ),
            (
                "safe continue",
                TurningSettings {
                    strategy: Strategy {
                        on_thin: OnThin::Continue,
                        ..Strategy::safe(&regime)
                    },
                    ..base
                },
                sensor,
            ),
            (
                "fast",
                TurningSettings {
                    regime: fast_regime,
                    strategy: Strategy::fast(&fast_regime, false),
                    ..base
                },
                sensor,
            ),
            (
                "fast face",
                TurningSettings {
                    regime: fast_regime,
                    strategy: Strategy::fast(&fast_regime, true),
                    ..base
                },
                sensor,
            ),
        ];
        for (variant, settings, sensor) in variants {
            let mut simulation = Simulation::new(settings, blank.clone(), law, sensor).unwrap();
            let show = verbose.as_deref() == Some(&format!("{name}/{variant}"));
            let (f, last) = simulation.run(2000.0, |output, _| {
                if let (true, Some(t)) = (show, output.transition) {
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
            });
            row(variant, &f);
            if !f.done {
                println!("    {last:?}");
            }
            *sums.entry(variant.to_string()).or_insert(0.0) += f.time_s;
        }
        let high = blank.highest_mm(200.0);
        let piece = || Workpiece::new(blank.clone(), 200.0, law, tool, 120.0);
        let f = run_fixed(
            FixedPasses::new(&base, high, regime.depth_back_off_mm, regime.feed_back_off_mm_rev),
            piece(),
            2200.0,
        );
        row("G82 same load", &f);
        *sums.entry("g82".to_string()).or_insert(0.0) += f.time_s;
        let n = f64::from(regime.fastest_passes(high, 200.0, 34.0));
        let f = run_fixed(
            FixedPasses::new(&base, high, high / n, regime.feed_mm_rev(high / n)),
            piece(),
            2200.0,
        );
        row("G82 known", &f);
        *sums.entry("g82 known".to_string()).or_insert(0.0) += f.time_s;
        let f = run_fixed(
            FixedPasses::new(
                &base,
                high,
                regime.depth_back_off_mm,
                0.7 * regime.feed_back_off_mm_rev,
            ),
            piece(),
            2200.0,
        );
        row("G82 70 %", &f);
        *sums.entry("g82 70".to_string()).or_insert(0.0) += f.time_s;
    }
    println!("{sums:#?}");
}

fn row(name: &str, f: &Figures) {
    println!(
        "  {name:14} passes {:2} time {:6.1} air {:5.1} return {:4.1} backs {} peak {:.3} >120% {:.3} >130% {:.3} residual {:.4} under {:.4} holder {} done {}",
        f.passes,
        f.time_s,
        f.air_s,
        f.return_s,
        f.back_offs,
        f.peak / 2200.0,
        f.over_120_s,
        f.over_130_s,
        f.residual_mm,
        f.undercut_mm,
        f.hit_holder,
        f.done
    );
}
