//! A verdict rests on disturbances that were followed, in each direction and both ways.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use evolvent_chatter::{
    Assessment, Assessor, CuttingTool, Fate, Mapper, Model, PrincipalAxis, StabilityVerdict,
};
use evolvent_cutting::{ForceLaw, LawDefinition, ToolAngles};

use crate::common::oracle::{End, Oracle};
use crate::common::{Random, campaign};

const RAKE: f64 = 10.0;
const LEAD: f64 = 60.0;

fn law() -> ForceLaw {
    let angles = ToolAngles {
        rake_deg: RAKE,
        lead_deg: LEAD,
    };
    LawDefinition::built_in("40X-R1").unwrap().law(angles).unwrap()
}

/// From thin cuts at high speeds, where any strong impulse lifts the edge off, to heavy ones.
fn any_cut(random: &mut Random) -> CuttingTool {
    let stiffness = random.between(2e6, 3e7);
    let ratio = random.between(0.01, 0.06);
    CuttingTool {
        axes: [
            PrincipalAxis::with_ratio(random.between(0.7, 6.0), stiffness, ratio),
            PrincipalAxis::with_ratio(
                random.between(0.7, 6.0),
                stiffness * random.between(0.5, 2.0),
                ratio,
            ),
        ],
        beta_deg: random.between(-180.0, 180.0),
        speed_m_min: random.between(40.0, 300.0),
        depth_mm: f64::exp(random.between(f64::ln(1e-4), f64::ln(8.0))),
        feed_mm_rev: random.between(0.1, 0.5),
        radial_ratio: random.between(0.2, 0.8),
        floor_m_min: 2.0,
    }
}

/// 0.05 mm at 200 m/min: an impulse of a tenth of the cutting speed lifts the edge off for most of the time.
fn thin_cut() -> CuttingTool {
    CuttingTool {
        axes: [
            PrincipalAxis::with_ratio(1.5, 8e6, 0.03),
            PrincipalAxis::with_ratio(1.5, 7e6, 0.03),
        ],
        beta_deg: 35.0,
        speed_m_min: 200.0,
        depth_mm: 0.05,
        feed_mm_rev: 0.2,
        radial_ratio: 0.4,
        floor_m_min: 2.0,
    }
}

/// The directions of impulses, of the eight that the other program knows, in which no disturbance was
/// followed.
fn untested(tool: CuttingTool, whole: &Assessment) -> Vec<[f64; 2]> {
    let rest = whole.equilibrium.deflection_m;
    let both = |[v1, v2]: [f64; 2]| [[v1, v2], [-v1, -v2]];
    let directions = Oracle::new(tool, RAKE, LEAD).directions();
    let is_along = |[v1, v2]: [f64; 2]| {
        whole.disturbances.iter().any(|kick| {
            let start = &kick.start;
            let speed = start[2].hypot(start[3]);
            start[0] == rest[0]
                && start[1] == rest[1]
                && start[2] * v1 + start[3] * v2 > 0.999 * speed
                && kick.fate != Fate::BeginsOutside
        })
    };
    let all = directions.into_iter().flat_map(both);
    all.filter(|direction| !is_along(*direction)).collect()
}

#[test]
fn a_thin_cut_is_assessed_by_disturbances() {
    let tool = thin_cut();
    let law = law();
    let model = Model::new(tool, &law).unwrap();
    let whole = Assessor::new(5).assess(&model).unwrap();
    println!("{:?}: {} disturbances", whole.verdict, whole.disturbances.len());
    assert_eq!(untested(tool, &whole), Vec::<[f64; 2]>::new());
    assert_eq!(whole.verdict, StabilityVerdict::Stable);
    assert_eq!(Mapper::new(5).cell(tool, &law).verdict, Some(whole.verdict));
    // The other program finds the same.
    let oracle = Oracle::new(tool, RAKE, LEAD);
    for kick in &whole.disturbances {
        assert_eq!(oracle.kick([kick.start[2], kick.start[3]]), End::Died, "{kick:?}");
    }
}

/// Every "stable" has a disturbance that dies out in each of the eight directions.
#[test]
fn stable_means_that_disturbances_died_out_in_every_direction() {
    let (mut random, cases) = campaign(0x0c4a_0021, 300);
    let law = law();
    let (mut stable, mut empty, mut incomplete, mut map_differs) = (0, 0, Vec::new(), Vec::new());
    let mut verdicts = [0; 4];
    for case in 0..cases {
        let tool = any_cut(&mut random);
        let Ok(model) = Model::new(tool, &law) else {
            continue;
        };
        let Ok(whole) = Assessor::new(5).assess(&model) else {
            continue;
        };
        verdicts[whole.verdict as usize] += 1;
        if whole.verdict != StabilityVerdict::Stable {
            continue;
        }
        stable += 1;
        if whole.disturbances.is_empty() {
            empty += 1;
            println!("without a disturbance: {tool:?}");
        }
        let missing = untested(tool, &whole).len();
        if missing > 0 {
            incomplete.push((case, missing));
        }
        assert!(whole.disturbances.iter().all(|kick| kick.fate == Fate::DiesOut));
        let cell = Mapper::new(5).cell(tool, &law);
        if cell.verdict != Some(StabilityVerdict::Stable) {
            map_differs.push((case, cell.verdict));
        }
    }
    println!(
        "{stable} of {cases} are stable ({verdicts:?}), {empty} of them without a disturbance, {} with untested \
         directions; {} differ in the map: {map_differs:?}",
        incomplete.len(),
        map_differs.len()
    );
    assert!(
        incomplete.is_empty(),
        "{} of {stable}, {empty} empty: {incomplete:?}",
        incomplete.len()
    );
    assert!(stable * 4 > cases, "only {stable} of {cases} are stable");
}
