//! Machines made up for a measurement.

use std::fmt::Write as _;
use std::path::PathBuf;

use evolvent_machine::{ControlRate, Machine, PlannerKind};
use evolvent_runtime::Setup;

/// A machine of equal axes with the limits of the standing bench, rotary ones in degrees.
pub(crate) fn equal_axes(letters: &str, rate_hz: f64, planner: Option<PlannerKind>) -> Result<Setup, String> {
    let mut text = String::from(
        "name = \"equal\"\ndescription = \"Equal axes\"\nkind = \"mill\"\nincrements_per_mm = 1000\n\
         rate = 1000\n",
    );
    if letters.contains(['A', 'B', 'C']) {
        text.push_str("increments_per_degree = 1000\n");
    }
    text.push_str("[path]\nmode = \"blend\"\nblend_tolerance_mm = 0.02\n");
    for letter in letters.chars() {
        let (kind, unit) = if "ABC".contains(letter) {
            ("rotary", "deg")
        } else {
            ("linear", "mm")
        };
        // Writing to a string cannot fail.
        let _infallible = write!(
            text,
            "[[axis]]\nletter = \"{letter}\"\nkind = \"{kind}\"\ntravel_min_{unit} = -10000\n\
             travel_max_{unit} = 10000\nmax_velocity_{unit}_s = 200\nmax_acceleration_{unit}_s2 = 2000\n\
             max_jerk_{unit}_s3 = 50000\nhome_{unit} = 0\n"
        );
    }
    let file = PathBuf::from("equal.toml");
    let machine = Machine::parse(&text, "equal.toml").map_err(|error| error.to_string())?;
    let mut setup =
        Setup::new(machine, file, text, Some(ControlRate::Hz(rate_hz))).map_err(|error| error.to_string())?;
    if let Some(planner) = planner {
        setup.machine.path.planner = planner;
    }
    Ok(setup)
}
