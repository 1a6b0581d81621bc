//! The published tool and law, and random numbers.

#![allow(dead_code, unreachable_pub, reason = "each test uses its part")]
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may fail, and prints its seed"
)]

pub mod oracle;

use evolvent_chatter::{CuttingTool, PrincipalAxis};
use evolvent_cutting::{ForceLaw, LawDefinition, ToolAngles};
pub use evolvent_random::Random;

pub fn steel() -> ForceLaw {
    let tool = ToolAngles {
        rake_deg: 10.0,
        lead_deg: 60.0,
    };
    LawDefinition::built_in("40X-R1").unwrap().law(tool).unwrap()
}

/// The published tool with the damping ratio of its second axis.
pub fn tool(speed_m_min: f64, second_ratio: f64) -> CuttingTool {
    CuttingTool {
        axes: [
            PrincipalAxis::with_ratio(6.0, 30_020_020.401_035_063, 0.03),
            PrincipalAxis::with_ratio(6.0, 14_994_509.394_629_354, second_ratio),
        ],
        beta_deg: 35.0,
        speed_m_min,
        depth_mm: 4.0,
        feed_mm_rev: 0.49,
        radial_ratio: 0.4,
        floor_m_min: 2.0,
    }
}

/// Seed and number of cases: those of the test, or `EVOLVENT_SEED` and `EVOLVENT_CASES` for a longer search.
pub fn campaign(seed: u64, cases: usize) -> (Random, usize) {
    (
        Random::from_state(evolvent_random::seed(seed)),
        evolvent_random::cases(cases),
    )
}

#[track_caller]
pub fn near(value: f64, expected: f64, relative: f64, what: &str) {
    assert!(
        (value / expected - 1.0).abs() <= relative,
        "{what}: {value}, expected {expected} within {relative}"
    );
}
