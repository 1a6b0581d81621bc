//! Inputs, outputs and spindles in machine files.

use evolvent_machine::Machine;

use crate::common::GOOD;

const SIGNALS: &str = r#"
[[input]]
name = "estop-chain"
number = 0

[[input]]
name = "pressure"
kind = "analog"
number = 0
min = 0
max = 10

[[output]]
name = "clamp"
number = 3
safe_on = true
on_end = "safe"

[[output]]
name = "laser"
kind = "analog"
number = 0
min = 0
max = 100
safe_value = 5
on_hold = "safe"

[[spindle]]
max_rpm = 8000

[[spindle]]
number = 1
max_rpm = 60000
reverse = false

[estop]
input = "estop-chain"

[signals]
input_timeout_ms = 50
"#;

#[test]
fn inputs_outputs_spindles_and_estop_are_read() {
    use evolvent_machine::{EstopSettings, OutputRule, SignalKind};
    let machine = Machine::parse(&format!("{GOOD}{SIGNALS}"), "signals.toml").unwrap();
    let signals = &machine.signals;
    assert_eq!((signals.inputs.len(), signals.outputs.len()), (2, 2));
    assert_eq!(signals.input(SignalKind::Digital, 0).unwrap().name, "estop-chain");
    assert_eq!(signals.input(SignalKind::Analog, 0).unwrap().range, [0.0, 10.0]);
    let clamp = signals.output(SignalKind::Digital, 3).unwrap();
    let rules = (clamp.on_hold, clamp.on_stop, clamp.on_end);
    assert_eq!(rules, (OutputRule::Keep, OutputRule::Keep, OutputRule::Safe));
    let laser = signals.output(SignalKind::Analog, 0).unwrap();
    assert_eq!(
        (clamp.safe, laser.safe, laser.on_hold),
        (1.0, 5.0, OutputRule::Safe)
    );
    assert!(signals.output(SignalKind::Digital, 0).is_none());
    assert_eq!(
        signals
            .spindle(1)
            .map(|spindle| (spindle.max_rpm, spindle.reverse)),
        Some((60_000.0, false))
    );
    let chain = EstopSettings {
        input: 0,
        closed: true,
    };
    assert_eq!((signals.estop, signals.input_timeout_s), (Some(chain), 0.05));
    let without = Machine::parse(GOOD, "without.toml").unwrap();
    assert!(without.signals.is_empty() && without.signals.estop.is_none());
}

#[test]
fn invalid_signals_are_rejected_with_advice() {
    let rejected = |from: &str, to: &str, parts: &[&str]| {
        let text = format!("{GOOD}{SIGNALS}");
        assert!(text.contains(from), "no {from:?}");
        let message = Machine::parse(&text.replacen(from, to, 1), "bad.toml")
            .unwrap_err()
            .to_string();
        for part in parts {
            assert!(message.contains(part), "{to:?} gives {message}, without {part}");
        }
    };
    rejected(
        "name = \"clamp\"",
        "name = \"pressure\"",
        &["output[0].name", "already used by input[1]", "its own name"],
    );
    rejected(
        "name = \"clamp\"",
        "name = \"a b\"",
        &["output[0].name", "1 to 32 letters"],
    );
    rejected("number = 3", "number = 64", &["output[0].number", "0 to 63"]);
    rejected("number = 3", "number = -1", &["output[0].number", "out of range"]);
    rejected(
        "kind = \"analog\"\nnumber = 0\nmin = 0\nmax = 10\n",
        "kind = \"analog\"\nnumber = 16\n",
        &["input[1].number", "0 to 15"],
    );
    rejected(
        "name = \"pressure\"\nkind = \"analog\"",
        "name = \"pressure\"",
        &["input[1]", "digital number 0 is already used by input[0]"],
    );
    rejected(
        "safe_on = true",
        "safe_value = 1",
        &["output[0].safe_value", "safe_on"],
    );
    rejected("safe_on = true", "max = 1", &["output[0].max", "no range"]);
    rejected(
        "safe_value = 5",
        "safe_value = 101",
        &["output[1].safe_value", "between min and max"],
    );
    rejected("safe_value = 5", "safe_value = nan", &["output[1].safe_value"]);
    rejected(
        "safe_value = 5",
        "safe_on = true",
        &["output[1].safe_on", "safe_value"],
    );
    rejected("max = 100", "max = 0", &["output[1].max", "above min"]);
    rejected("on_end = \"safe\"", "on_end = \"off\"", &["on_end"]);
    rejected(
        "number = 1\nmax_rpm",
        "number = 0\nmax_rpm",
        &["spindle[1].number", "spindle 0 already exists"],
    );
    rejected(
        "number = 1\nmax_rpm",
        "number = 4\nmax_rpm",
        &["spindle[1].number", "0 to 3"],
    );
    rejected("max_rpm = 8000", "max_rpm = -1", &["spindle[0].max_rpm"]);
    rejected(
        "input = \"estop-chain\"",
        "input = \"chain\"",
        &["estop.input", "no input called \"chain\"", "[[input]]"],
    );
    rejected(
        "input = \"estop-chain\"",
        "input = \"pressure\"",
        &["estop.input", "analog", "digital"],
    );
    rejected(
        "input_timeout_ms = 50",
        "input_timeout_ms = 0",
        &["signals.input_timeout_ms"],
    );
    rejected(
        "input_timeout_ms = 50",
        "input_timeout = 50",
        &["the unit is missing", "input_timeout_ms"],
    );
}
