//! Verdicts compared with impulses followed by another program: law and equations from the paper, fixed
//! steps.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use evolvent_chatter::{
    Assessment, Assessor, CuttingTool, DropReason, Mapper, Model, PrincipalAxis, StabilityVerdict,
    nearest_stable,
};
use evolvent_cutting::{ForceLaw, LawDefinition, ToolAngles};

use crate::common::oracle::{End, Oracle};
use crate::common::{Random, campaign, near, tool};

struct Sample {
    tool: CuttingTool,
    rake: f64,
    lead: f64,
}

impl Sample {
    fn law(&self) -> ForceLaw {
        let angles = ToolAngles {
            rake_deg: self.rake,
            lead_deg: self.lead,
        };
        LawDefinition::built_in("40X-R1").unwrap().law(angles).unwrap()
    }

    fn assess(&self) -> Assessment {
        let law = self.law();
        let model = Model::new(self.tool, &law).unwrap();
        Assessor::new(5).assess(&model).unwrap()
    }

    fn oracle(&self) -> Oracle {
        Oracle::new(self.tool, self.rake, self.lead)
    }
}

fn axis(mass_kg: f64, stiffness_n_m: f64, damping_ns_m: f64) -> PrincipalAxis {
    PrincipalAxis {
        mass_kg,
        damping_ns_m,
        stiffness_n_m,
    }
}

/// Both modes grow; the only cycle has a multiplier of 1.83.
fn two_growing() -> Sample {
    Sample {
        tool: CuttingTool {
            axes: [
                axis(
                    1.205_975_314_547_619,
                    6_609_361.562_410_508,
                    19.480_114_116_224_32,
                ),
                axis(
                    1.205_975_314_547_619,
                    2_924_518.712_949_540_5,
                    30.813_336_679_470_34,
                ),
            ],
            beta_deg: 6.286_988_121_715_704,
            speed_m_min: 42.717_076_693_880_98,
            depth_mm: 4.753_013_593_325_191,
            feed_mm_rev: 0.470_719_070_506_107_95,
            radial_ratio: 0.4,
            floor_m_min: 2.0,
        },
        rake: 6.542_058_972_349_974,
        lead: 47.231_519_102_539_714,
    }
}

/// A stable mode beside a growing one has both cycles, one of which seems stable by its amplitude.
fn other_mode_grows() -> Sample {
    Sample {
        tool: CuttingTool {
            axes: [
                axis(
                    0.914_815_360_035_041_8,
                    3_318_331.994_774_047,
                    13.844_799_179_747_332,
                ),
                axis(
                    0.726_468_805_662_628,
                    2_782_804.511_367_479_3,
                    16.305_872_498_555_974,
                ),
            ],
            beta_deg: 38.189_016_306_880_67,
            speed_m_min: 129.012_083_148_759_87,
            depth_mm: 3.676_161_535_655_09,
            feed_mm_rev: 0.376_811_962_119_477_54,
            radial_ratio: 0.4,
            floor_m_min: 2.0,
        },
        rake: 10.0,
        lead: 54.234_836_416_738_496,
    }
}

/// Two modes of almost equal frequency, coupled by the force.
fn coupled(speed_m_min: f64, depth_mm: f64) -> Sample {
    Sample {
        tool: CuttingTool {
            axes: [
                axis(1.2, 3.3e6, 103.478_693_459_088_48),
                axis(1.2, 3.0e6, 98.663_062_997_253_43),
            ],
            beta_deg: 60.0,
            speed_m_min,
            depth_mm,
            feed_mm_rev: 0.2,
            radial_ratio: 0.4,
            floor_m_min: 2.0,
        },
        rake: 10.0,
        lead: 60.0,
    }
}

/// Harmonic balance has a cycle that converges to another one in time, and both modes' branches have the same
/// cycles.
fn with_invented_cycle() -> Sample {
    Sample {
        tool: CuttingTool {
            axes: [
                axis(
                    1.714_344_186_477_898,
                    14_621_091.982_671_978,
                    69.803_298_854_285_6,
                ),
                axis(
                    2.709_165_109_483_884_2,
                    23_190_337.500_788_69,
                    63.152_938_329_192_15,
                ),
            ],
            beta_deg: 70.486_342_901_764_47,
            speed_m_min: 86.379_777_791_722_29,
            depth_mm: 4.815_021_738_739_721,
            feed_mm_rev: 0.339_507_337_697_812_3,
            radial_ratio: 0.735_791_772_961_257_9,
            floor_m_min: 2.0,
        },
        rake: 10.0,
        lead: 58.750_529_390_461_34,
    }
}

#[test]
fn a_cut_with_unstable_cycles_only_leaves_the_model() {
    for (sample, multiplier) in [(two_growing(), 1.83), (other_mode_grows(), 1.05)] {
        let oracle = sample.oracle();
        for [v1, v2] in oracle.directions() {
            for part in [0.001, 0.2, 0.8] {
                // A cut that grows by e^4 in two periods is beyond the model by then.
                let end = oracle.blow(part, v1, v2);
                assert!(
                    end == End::Left || (end == End::TooLarge && part > 0.01),
                    "{end:?}: blow of {part} along {v1} {v2}"
                );
            }
        }
        let whole = sample.assess();
        assert_eq!(whole.verdict, StabilityVerdict::OutOfModel);
        assert!(whole.cycles.iter().all(|known| !known.verified.stable()));
        let known = whole
            .cycles
            .iter()
            .map(|known| known.verified.multipliers[0].norm());
        let min = known.fold(f64::INFINITY, f64::min);
        near(min, multiplier, 5e-3, "multiplier");
        let mut mapper = Mapper::new(5);
        assert_eq!(
            mapper.cell(sample.tool, &sample.law()).verdict,
            Some(StabilityVerdict::OutOfModel)
        );
    }
}

#[test]
fn an_unstable_cycle_is_not_missed() {
    for (depth, harmonics) in [
        (2.606, 5),
        (2.608, 5),
        (2.610, 5),
        (2.608, 3),
        (2.608, 7),
        (2.608, 9),
    ] {
        let sample = coupled(51.05, depth);
        let law = sample.law();
        let model = Model::new(sample.tool, &law).unwrap();
        let whole = Assessor::new(harmonics).assess(&model).unwrap();
        assert_eq!(
            whole.verdict,
            StabilityVerdict::OutOfModel,
            "{depth} mm, {harmonics} harmonics"
        );
        assert!(!whole.cycles.is_empty());
        let cycle = &whole.cycles[0].verified;
        near(1e3 * cycle.amplitude_m[1], 0.4005, 2e-3, "amplitude");
        assert!(!cycle.stable());
        // The steady cut is unstable against an impulse across the cutting speed.
        let oracle = sample.oracle();
        let [.., across] = oracle.directions();
        let ends = [0.4, 0.45, 0.5, 0.55, 0.6].map(|part| oracle.blow(part, across[0], across[1]));
        assert_eq!(ends[0], End::Died);
        assert!(ends.contains(&End::Left), "{ends:?}");
    }
}

#[test]
fn a_cycle_counts_once_and_only_where_it_closes() {
    let whole = with_invented_cycle().assess();
    assert_eq!(whole.verdict, StabilityVerdict::SelfExcited);
    let amplitudes: Vec<f64> = (whole.cycles.iter())
        .map(|known| 1e3 * known.verified.amplitude_m[1])
        .collect();
    assert_eq!(amplitudes.len(), 2, "{amplitudes:?}");
    near(amplitudes[0], 0.369_640, 1e-5, "stable cycle");
    near(amplitudes[1], 0.424_069, 1e-5, "unstable cycle");
    for known in &whole.cycles {
        assert!(known.verified.amplitude_error.abs() < 1e-3 && known.verified.closure < 1e-8);
    }
    // The reason for dropping is reported.
    let landed = |reason: &DropReason| matches!(reason, DropReason::Landed | DropReason::Duplicate);
    assert!(whole.dropped.iter().all(|dropped| landed(&dropped.reason)));
    assert!(whole.can_leave());
}

/// Cuts of random tools with the verdict `Stable` withstand every impulse of another program.
#[test]
fn stable_cuts_bear_every_blow_of_another_program() {
    let (mut random, cases) = campaign(0x0c4a_0010, 25);
    let mut stable = 0;
    for case in 0..cases {
        let mass = random.between(0.7, 3.0);
        let stiffness = random.between(2e6, 2e7);
        let second = random.between(0.85, 1.2);
        let ratio = random.between(0.01, 0.06);
        let sample = Sample {
            tool: CuttingTool {
                axes: [
                    PrincipalAxis::with_ratio(mass, stiffness, ratio),
                    PrincipalAxis::with_ratio(mass, second * stiffness, ratio * random.between(0.7, 1.4)),
                ],
                beta_deg: random.between(0.0, 90.0),
                speed_m_min: random.between(30.0, 200.0),
                depth_mm: random.between(0.3, 3.0),
                feed_mm_rev: random.between(0.15, 0.5),
                radial_ratio: random.between(0.2, 0.8),
                floor_m_min: 2.0,
            },
            rake: 10.0,
            lead: random.between(45.0, 75.0),
        };
        let law = sample.law();
        let Ok(model) = Model::new(sample.tool, &law) else {
            continue;
        };
        let Ok(whole) = Assessor::new(5).assess(&model) else {
            continue;
        };
        let cell = Mapper::new(5).cell(sample.tool, &law);
        if whole.verdict != StabilityVerdict::Stable && cell.verdict != Some(StabilityVerdict::Stable) {
            continue;
        }
        stable += 1;
        let oracle = sample.oracle();
        for [v1, v2] in oracle.directions() {
            for part in [0.3, 0.6, 0.85] {
                let end = oracle.blow(part, v1, v2);
                assert!(
                    matches!(end, End::Died | End::TooLarge),
                    "{end:?}: case {case}: blow of {part} along {v1} {v2}; {:?}",
                    sample.tool
                );
            }
        }
    }
    assert!(stable > cases / 10, "only {stable} of {cases} cuts are stable");
}

/// An unstable and a stable cycle so close that Newton's method converged to the same one from both sides.
#[test]
fn two_close_cycles_are_told_apart() {
    for (speed, depth) in [(86.5, 1.716_25), (103.5, 2.521_25), (114.5, 3.096_25)] {
        let mut sample = steel_tool(0.008);
        (sample.tool.speed_m_min, sample.tool.depth_mm) = (speed, depth);
        let (cell, cycles) = Mapper::new(5).cycles(sample.tool, &sample.law());
        let stable: Vec<bool> = cycles.iter().map(|(_, stable)| *stable).collect();
        assert_eq!(stable, [false, true], "{speed} m/min, {depth} mm");
        assert_eq!(cell.verdict, Some(StabilityVerdict::Bistable));
        // The other program, started between both: it neither dies out nor leaves.
        let oracle = sample.oracle();
        let ends: Vec<End> = (30..90)
            .step_by(4)
            .map(|part| oracle.blow(0.01 * f64::from(part), 0.0, 1.0))
            .collect();
        assert!(
            ends.contains(&End::Died) && ends.contains(&End::Stays),
            "{ends:?}"
        );
    }
}

/// Cuts whose cycle is so unstable that Newton's method in time misses it unless the balance has many
/// harmonics.
#[test]
fn a_strongly_unstable_cycle_is_not_called_stable() {
    let mut deep = coupled(60.0, 1.0);
    deep.tool.speed_m_min = 51.05;
    let mut cuts: Vec<Sample> = Vec::new();
    for depth_mm in [45.0, 50.0, 55.0, 58.0, 60.0] {
        deep.tool.depth_mm = depth_mm;
        cuts.push(Sample { ..deep });
    }
    cuts.push(Sample {
        tool: CuttingTool {
            axes: [
                axis(1.2, 8_407_049.0, 103.478_693_459_088_48),
                axis(1.2, 7_851_250.0, 98.663_062_997_253_43),
            ],
            beta_deg: 50.4,
            speed_m_min: 41.51,
            depth_mm: 14.732,
            feed_mm_rev: 0.44,
            radial_ratio: 0.4,
            floor_m_min: 2.0,
        },
        rake: 10.0,
        lead: 60.0,
    });
    for cut in &cuts {
        let cell = Mapper::new(5).cell(cut.tool, &cut.law());
        let law = cut.law();
        let model = Model::new(cut.tool, &law).unwrap();
        for harmonics in [3, 5, 8] {
            let whole = Assessor::new(harmonics).assess(&model).unwrap();
            let verdicts = [Some(whole.verdict), cell.verdict];
            assert!(
                !verdicts.contains(&Some(StabilityVerdict::Stable)),
                "{harmonics}: {:?}",
                cut.tool
            );
            assert!(
                whole.cycles.iter().any(|known| !known.verified.stable()),
                "{:?}",
                cut.tool
            );
        }
    }
}

/// With five harmonics the branch ends at the speed floor before the cycle that 24 and 48 confirm.
#[test]
fn a_cycle_past_a_coarse_branch_end_is_found() {
    let sample = Sample {
        tool: CuttingTool {
            axes: [
                axis(
                    1.086_953_783_636_629_2,
                    3_849_376.721_814_241_7,
                    145.600_546_588_585_93,
                ),
                axis(1.2, 3_836_269.077_320_25, 152.724_042_763_061_45),
            ],
            beta_deg: 66.160_227_101_892_86,
            speed_m_min: 36.605_861_478_607_42,
            depth_mm: 14.555_888_457_695_02,
            feed_mm_rev: 0.346_707_610_532_360_3,
            radial_ratio: 0.676_125_569_466_977_8,
            floor_m_min: 2.0,
        },
        rake: 10.0,
        lead: 60.0,
    };
    let whole = sample.assess();
    assert_eq!(whole.verdict, StabilityVerdict::OutOfModel);
    assert!(whole.cycles.iter().any(|known| !known.verified.stable()));
}

/// Random cuts at the maximum depth of the tool: near the limit of the model few harmonics are least
/// reliable.
fn deep_cut(random: &mut Random) -> Sample {
    let (stiffness, ratio) = (random.between(3e6, 2e7), random.between(0.01, 0.05));
    let axes = [
        PrincipalAxis::with_ratio(random.between(0.7, 3.0), stiffness, ratio),
        PrincipalAxis::with_ratio(1.2, stiffness * random.between(0.85, 1.2), ratio),
    ];
    Sample {
        tool: CuttingTool {
            axes,
            beta_deg: random.between(0.0, 90.0),
            speed_m_min: random.between(30.0, 120.0),
            depth_mm: random.between(3.0, 20.0),
            feed_mm_rev: random.between(0.2, 0.5),
            radial_ratio: random.between(0.2, 0.8),
            floor_m_min: 2.0,
        },
        rake: 10.0,
        lead: 60.0,
    }
}

/// The verdict of few harmonics equals that of many.
#[test]
fn stable_cuts_are_stable_with_more_harmonics() {
    let (mut random, cases) = campaign(0x0c4a_0011, 30);
    let mut stable = 0;
    for case in 0..cases {
        let sample = deep_cut(&mut random);
        let (tool, law) = (sample.tool, sample.law());
        let Ok(model) = Model::new(tool, &law) else {
            continue;
        };
        let Ok(few) = Assessor::new(5).assess(&model) else {
            continue;
        };
        if few.verdict == StabilityVerdict::Stable {
            stable += 1;
            let many = Assessor::new(16).assess(&model).unwrap();
            // At the very end of a branch many harmonics may find a cycle that few do not, without
            // confirmation.
            let agrees = many.verdict == StabilityVerdict::Stable || many.is_in_doubt();
            assert!(agrees, "case {case}: {:?} {tool:?}", many.verdict);
        }
    }
    println!("{stable} of {cases} are stable");
}

/// A stable cell of a map is stable as a single cut, with one exception in a thousand.
#[test]
fn stable_cells_of_maps_are_stable_by_themselves() {
    /// Without a scan beyond the ends of branches the map reports these as stable.
    const HIDDEN: [usize; 4] = [258, 265, 356, 619];
    let (mut random, cases) = campaign(0x0c4a_0011, 30);
    let (mut stable, mut differ) = (0, Vec::new());
    for case in 0..cases.max(620) {
        let sample = deep_cut(&mut random);
        if case >= cases && !HIDDEN.contains(&case) {
            continue;
        }
        let law = sample.law();
        if Mapper::new(5).cell(sample.tool, &law).verdict != Some(StabilityVerdict::Stable) {
            continue;
        }
        stable += 1;
        let single = sample.assess().verdict;
        if single != StabilityVerdict::Stable {
            differ.push((case, single));
        }
    }
    println!("{stable} cells are stable, of them not by themselves: {differ:?}");
    assert!(differ.len() * 1000 <= cases, "{differ:?}");
}

/// Ten tools; maps are computed in tiles, as the command does.
#[test]
fn the_map_agrees_with_single_calculations() {
    let (mut random, cases) = campaign(0x0c4a_0003, 40);
    let samples = [
        (coupled(60.0, 1.0), [20.0, 250.0], [0.1, 6.0]),
        (coupled(60.0, 1.0), [30.0, 95.0], [1.3, 3.4]),
        (two_growing(), [20.0, 200.0], [0.3, 6.0]),
        (other_mode_grows(), [30.0, 300.0], [0.3, 6.0]),
        (with_invented_cycle(), [30.0, 200.0], [0.3, 8.0]),
        (steel_tool(0.02), [20.0, 120.0], [0.25, 6.0]),
        (steel_tool(0.008), [20.0, 120.0], [0.25, 6.0]),
        (steel_tool(0.03), [15.0, 150.0], [0.2, 6.0]),
        (steel_tool(0.004), [15.0, 150.0], [0.2, 3.0]),
        (steel_tool(0.015), [20.0, 90.0], [1.0, 5.0]),
    ];
    let each = cases.div_ceil(samples.len());
    let (mut differ, mut looked_at) = (Vec::new(), 0);
    for (sample, speeds, depths) in &samples {
        let law = sample.law();
        let mut mapper = Mapper::new(5);
        // A section of a map of 100 x 100 cuts, as large as a tile, at a random position.
        let (first, count) = (random.between(0.0, 84.0).floor(), 16);
        let grid = |range: &[f64; 2], first: f64, count: i32| -> Vec<f64> {
            (0..count)
                .map(|k| range[0] + (range[1] - range[0]) * (first + f64::from(k) + 0.5) / 100.0)
                .collect()
        };
        let (speeds, depths) = (grid(speeds, first, count), grid(depths, 0.0, 100));
        let cells = mapper.tile(sample.tool, &law, &speeds, &depths);
        assert_eq!(cells.len(), speeds.len() * depths.len());
        for _ in 0..each {
            let cell = &cells[random.between(0.0, cells.len() as f64) as usize];
            let cut = CuttingTool {
                speed_m_min: cell.speed_m_min,
                depth_mm: cell.depth_mm,
                ..sample.tool
            };
            let whole = Model::new(cut, &law).and_then(|model| Assessor::new(5).assess(&model));
            let verdict = whole.as_ref().ok().map(|whole| whole.verdict);
            looked_at += 1;
            if verdict != cell.verdict {
                differ.push((cut, cell.verdict, verdict));
                continue;
            }
            let whole = whole
                .ok()
                .filter(|whole| whole.verdict != StabilityVerdict::OutOfModel);
            let stable = whole.as_ref().and_then(Assessment::largest_stable);
            // The error of the balance with loss of contact is 5e-3; the method that found a cell determines
            // its value.
            let expected = stable.map_or([0.0; 2], |known| {
                let of_cycle = known.cycle.amplitude_m(0).max(known.cycle.amplitude_m(1));
                let [first, second] = known.verified.amplitude_m;
                [of_cycle, first.max(second)]
            });
            let is_near = |amplitude: &f64| (cell.amplitude_m - amplitude).abs() <= 2e-3 * amplitude;
            assert!(
                expected.iter().any(is_near),
                "{cut:?}: {} for {expected:?}",
                cell.amplitude_m
            );
        }
    }
    println!("{} of {looked_at} differ", differ.len());
    for (cut, map, single) in &differ {
        println!("map {map:?}, single {single:?}: {cut:?}");
    }
    // None of the 1000 with this seed; with other seeds one within a cell of a border may differ.
    assert!(differ.len() * 500 <= looked_at, "{} differ", differ.len());
}

fn steel_tool(second_ratio: f64) -> Sample {
    Sample {
        tool: tool(60.0, second_ratio),
        rake: 10.0,
        lead: 60.0,
    }
}

#[test]
fn the_advised_speed_is_stable_in_every_way() {
    let sample = coupled(80.0, 1.0);
    let law = sample.law();
    let advised = nearest_stable(&mut Mapper::new(5), sample.tool, &law, [3.0, 400.0]);
    for speed_m_min in advised.into_iter().flatten() {
        let there = Sample {
            tool: CuttingTool {
                speed_m_min,
                ..sample.tool
            },
            ..sample
        };
        assert_eq!(
            there.assess().verdict,
            StabilityVerdict::Stable,
            "{speed_m_min} m/min"
        );
        let oracle = there.oracle();
        for [v1, v2] in oracle.directions() {
            let end = oracle.blow(0.8, v1, v2);
            assert!(
                matches!(end, End::Died | End::TooLarge),
                "{end:?} at {speed_m_min} m/min"
            );
        }
    }
}
