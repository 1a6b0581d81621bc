//! A separate law for the radial force, compared with the ratio where both are equivalent, and with another
//! program.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use evolvent_chatter::{
    Assessor, CuttingTool, Laws, Mapper, Measure, Model, StabilityVerdict, least_squares,
};
use evolvent_cutting::{ForceLaw, LawDefinition, ToolAngles};

use crate::common::oracle::Oracle;
use crate::common::{near, steel, tool};

fn law(text: &str) -> ForceLaw {
    let angles = ToolAngles {
        rake_deg: 10.0,
        lead_deg: 60.0,
    };
    LawDefinition::parse(text, "law.toml")
        .unwrap()
        .law(angles)
        .unwrap()
}

/// The shipped law times a factor.
fn scaled(factor: f64) -> ForceLaw {
    let text = include_str!("../../../../config/laws/40x-r1.toml");
    law(&text.replace("unit_n = 9.80665", &format!("unit_n = {}", 9.80665 * factor)))
}

fn power() -> ForceLaw {
    law(
        "name = \"Py\"\nkind = \"power\"\n[power]\ncoefficient_n = 900.0\nspeed_exponent = -0.3\n\
         depth_exponent = 0.7\nfeed_exponent = 0.6\n",
    )
}

#[test]
fn a_radial_law_in_proportion_is_the_ratio() {
    let (tangential, radial) = (steel(), scaled(0.4));
    let laws = Laws {
        tangential: &tangential,
        radial: Some(&radial),
    };
    for (case, beta) in [
        (tool(60.0, 0.02), 35.0),
        (tool(100.0, 0.008), 35.0),
        (tool(25.0, 0.02), 35.0),
        (tool(60.0, 0.02), 0.0),
    ] {
        let case = CuttingTool {
            beta_deg: beta,
            ..case
        };
        let ratio = Model::new(case, &tangential).unwrap();
        // With a law the ratio has no effect.
        let own = Model::new(
            CuttingTool {
                radial_ratio: 3.0,
                ..case
            },
            laws,
        )
        .unwrap();
        let (a, b) = (
            Assessor::new(5).assess(&ratio).unwrap(),
            Assessor::new(5).assess(&own).unwrap(),
        );
        assert_eq!(a.verdict, b.verdict);
        near(b.equilibrium.force_n, a.equilibrium.force_n, 1e-11, "force");
        for (a, b) in a.equilibrium.modes.iter().zip(&b.equilibrium.modes) {
            near(b.frequency_hz, a.frequency_hz, 1e-9, "small frequency");
            assert!((a.growth_per_s - b.growth_per_s).abs() < 1e-6);
        }
        assert_eq!(a.cycles.len(), b.cycles.len());
        for (a, b) in a.cycles.iter().zip(&b.cycles) {
            // By the balance, and in time.
            near(b.cycle.amplitude_m(1), a.cycle.amplitude_m(1), 1e-6, "amplitude");
            near(b.cycle.frequency_hz, a.cycle.frequency_hz, 1e-8, "frequency");
            near(
                b.verified.amplitude_m[1],
                a.verified.amplitude_m[1],
                1e-6,
                "amplitude in time",
            );
        }
        for (a, b) in a.branches.iter().zip(&b.branches) {
            assert_eq!(a.end, b.end);
        }
    }
}

#[test]
fn radial_law_cycles_match_another_program() {
    let (tangential, radial) = (steel(), power());
    let laws = Laws {
        tangential: &tangential,
        radial: Some(&radial),
    };
    let mut cycles = 0;
    for speed in [45.0, 55.0, 65.0] {
        let case = tool(speed, 0.015);
        let model = Model::new(case, laws).unwrap();
        let whole = Assessor::new(5).assess(&model).unwrap();
        let oracle = Oracle::new(case, 10.0, 60.0).with_radial([900.0, -0.3, 0.7, 0.6]);
        let rest = oracle.rest();
        near(
            whole.equilibrium.deflection_m[1],
            rest[1],
            1e-9,
            "deflection of V2",
        );
        near(
            whole.equilibrium.deflection_m[0],
            rest[0],
            1e-9,
            "deflection of V1",
        );
        assert_eq!(whole.verdict, StabilityVerdict::SelfExcited, "{speed} m/min");
        let stable = whole.largest_stable().unwrap();
        near(
            stable.verified.half_peak_to_peak_m[1],
            oracle.settled(0.3),
            1e-4,
            "half of peak to peak",
        );
        assert!(stable.verified.amplitude_error.abs() < 1e-3, "the balance");
        assert_eq!(Mapper::new(5).cell(case, laws).verdict, Some(whole.verdict));
        cycles += 1;
        // The motion differs from that with the ratio.
        let ratio = Assessor::new(5)
            .assess(&Model::new(case, &tangential).unwrap())
            .unwrap();
        let other = ratio
            .largest_stable()
            .map_or(0.0, |known| known.verified.amplitude_m[1]);
        assert!((other / stable.verified.amplitude_m[1] - 1.0).abs() > 1e-2);
        assert!(least_squares(&model, 1, Measure::Residual).is_err());
    }
    assert_eq!(cycles, 3);
}
