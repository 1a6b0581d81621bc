//! The handwheel in machine files.

use evolvent_machine::Machine;
use evolvent_path::AxisLetter;

use crate::common::GOOD;

const WHEEL: &str = r#"
[[input]]
name = "counts"
kind = "analog"
number = 5
[[input]]
name = "axis-x"
number = 40
[[input]]
name = "fine"
number = 41
[[input]]
name = "coarse"
number = 42
[handwheel]
counts = "counts"
steps_mm = [0.01, 0.1]
axis_inputs = { x = "axis-x" }
step_inputs = ["fine", "coarse"]
enable_input = "fine"
"#;

#[test]
fn an_invalid_handwheel_is_rejected_with_advice() {
    let text = format!("{GOOD}{WHEEL}");
    let wheel = Machine::parse(&text, "good.toml").unwrap().handwheel.unwrap();
    assert_eq!(
        (wheel.counts, wheel.counts_per_detent, wheel.enable_input),
        (5, 4.0, Some(41))
    );
    assert_eq!(wheel.axis_inputs, [(AxisLetter::X, 40)]);
    assert_eq!(wheel.step_inputs, [41, 42]);
    assert_eq!(wheel.step(AxisLetter::X, 1), Some(0.1));
    // The values in degrees default to those in mm.
    assert_eq!(wheel.step(AxisLetter::A, 0), Some(0.01));
    assert_eq!(wheel.step(AxisLetter::X, 2), None);
    let usual = Machine::parse(
        &text
            .replace("steps_mm = [0.01, 0.1]\n", "")
            .replace("step_inputs", "#"),
        "usual.toml",
    )
    .unwrap()
    .handwheel
    .unwrap();
    assert_eq!(usual.steps_mm, [0.001, 0.01, 0.1]);
    assert!(Machine::parse(GOOD, "without.toml").unwrap().handwheel.is_none());

    let rejected = |from: &str, to: &str, parts: &[&str]| {
        assert!(text.contains(from), "no {from:?}");
        let message = Machine::parse(&text.replacen(from, to, 1), "bad.toml")
            .unwrap_err()
            .to_string();
        for part in parts {
            assert!(message.contains(part), "{to:?} gives {message}, without {part}");
        }
    };
    let counts = "counts = \"counts\"";
    rejected(
        counts,
        "counts = \"fine\"",
        &["handwheel.counts", "digital", "name an analog input"],
    );
    rejected(
        counts,
        "counts = \"wheel\"",
        &["handwheel.counts", "no input called \"wheel\"", "[[input]]"],
    );
    rejected(
        counts,
        "counts = \"counts\"\ncounts_per_detent = 0",
        &["handwheel.counts_per_detent"],
    );
    let steps = "[0.01, 0.1]";
    rejected(steps, "[]", &["handwheel.steps_mm", "0 steps", "1 to 8"]);
    rejected(steps, "[0.01, 11]", &["handwheel.steps_mm[1]"]);
    rejected(steps, "[0.01, nan]", &["handwheel.steps_mm[1]"]);
    rejected(
        steps,
        "[0.01, 0.1, 1]",
        &["handwheel.step_inputs", "2 inputs", "3 steps"],
    );
    rejected(
        steps,
        "[0.01, 0.1]\nsteps_deg = [1]",
        &["handwheel.steps_deg", "1 steps", "as many"],
    );
    rejected(
        "x = \"axis-x\"",
        "q = \"axis-x\"",
        &["handwheel.axis_inputs.q", "no axis \"q\"", "X"],
    );
    rejected(
        "x = \"axis-x\"",
        "x = \"counts\"",
        &["handwheel.axis_inputs.x", "analog", "digital"],
    );
    rejected(
        "[\"fine\", \"coarse\"]",
        "[\"fine\", \"none\"]",
        &["handwheel.step_inputs[1]", "\"none\""],
    );
    rejected(
        "enable_input = \"fine\"",
        "enable_input = \"?\"",
        &["handwheel.enable_input"],
    );
    rejected("enable_input", "button", &["button", "handwheel"]);
}
