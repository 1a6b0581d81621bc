//! The machine's objections to commands for outputs, inputs and spindles.

use evolvent_gcode::{Action, SpindleDirection};
use evolvent_machine::{SignalKind, SignalSettings, SpindleSettings};

use crate::news::with_article;

/// The reason why the machine cannot carry out an action, and the remedy; `None` if it can, or for actions of
/// no signal.
pub(crate) fn signal_objection(signals: &SignalSettings, action: &Action) -> Option<(String, String)> {
    match *action {
        Action::Output {
            index,
            synchronised,
            on,
        } => {
            let code = match (synchronised, on) {
                (true, true) => "M62",
                (true, false) => "M63",
                (false, true) => "M64",
                (false, false) => "M65",
            };
            let there = signals.output(SignalKind::Digital, index).is_some();
            (!there).then(|| missing_output(signals, &format!("{code} P{index}"), SignalKind::Digital, index))
        }
        Action::AnalogOutput {
            index,
            value,
            synchronised,
        } => {
            let code = if synchronised { "M67" } else { "M68" };
            let what = format!("{code} E{index} Q{value}");
            let Some(output) = signals.output(SignalKind::Analog, index) else {
                return Some(missing_output(signals, &what, SignalKind::Analog, index));
            };
            let [min, max] = output.range;
            let message = format!("{what}: the output {} takes {min} to {max}", output.name);
            let help = format!("write a value from {min} to {max}, or widen min and max in the machine file");
            (!(min..=max).contains(&value)).then_some((message, help))
        }
        Action::WaitInput { index, analog, .. } => {
            let (kind, letter) = if analog {
                (SignalKind::Analog, 'E')
            } else {
                (SignalKind::Digital, 'P')
            };
            if signals.input(kind, index).is_some() {
                return None;
            }
            let there = signals.inputs.iter().filter(|input| input.kind == kind);
            let there = there.map(|input| format!("{} ({})", input.number, input.name));
            Some((
                format!(
                    "M66 {letter}{index}: the machine file has no {} input {index}",
                    kind.name()
                ),
                advice("[[input]]", kind, index, &there.collect::<Vec<_>>()),
            ))
        }
        Action::Spindle {
            spindle,
            direction,
            speed_rpm,
        } => spindle_objection(signals, spindle, direction, speed_rpm),
        // Its speed is limited to the maximum of the spindle.
        Action::SurfaceSpeed {
            spindle, direction, ..
        } => spindle_objection(signals, spindle, direction, 0.0),
        Action::OrientSpindle { spindle, .. } => {
            let settings = signals.spindle(spindle);
            (!settings.is_some_and(SpindleSettings::has_feedback)).then(|| {
                let help = format!(
                    "add feedback = true to a [[spindle]] of number {spindle} in the machine file, and a \
                     bridge that turns it to an angle"
                );
                let message = format!("M19: the machine file has no spindle {spindle} with feedback");
                (message, help)
            })
        }
        _ => None,
    }
}

/// The machine's objection to a direction and speed of a spindle.
fn spindle_objection(
    signals: &SignalSettings,
    number: u32,
    direction: SpindleDirection,
    speed_rpm: f64,
) -> Option<(String, String)> {
    if signals.spindles.is_empty() {
        return None;
    }
    let Some(spindle) = signals.spindle(number) else {
        let help = format!(
            "write $ and the number of another spindle, or number = {number} at one of [[spindle]] in the \
             machine file"
        );
        return Some((format!("the machine has no spindle {number}"), help));
    };
    let name = with_article(number);
    if direction == SpindleDirection::CounterClockwise && !spindle.reverse {
        let help = "write M3, or reverse = true at its [[spindle]] in the machine file".to_owned();
        return Some((format!("M4: {name} turns clockwise only"), help));
    }
    let max = spindle.max_rpm;
    (direction != SpindleDirection::Stopped && speed_rpm > max).then(|| {
        (
            format!("S{speed_rpm}: {name} turns at {max} rpm at most"),
            format!("write S{max} or less, or correct max_rpm at its [[spindle]] in the machine file"),
        )
    })
}

fn missing_output(signals: &SignalSettings, what: &str, kind: SignalKind, index: u32) -> (String, String) {
    let there = signals.outputs.iter().filter(|output| output.kind == kind);
    let there = there.map(|output| format!("{} ({})", output.number, output.name));
    (
        format!("{what}: the machine file has no {} output {index}", kind.name()),
        advice("[[output]]", kind, index, &there.collect::<Vec<_>>()),
    )
}

fn advice(table: &str, kind: SignalKind, index: u32, there: &[String]) -> String {
    let add = format!(
        "add {table} with a name, kind = \"{}\" and number = {index} to the machine file",
        kind.name()
    );
    if there.is_empty() {
        add
    } else {
        format!("{add}, or write one that it has: {}", there.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evolvent_machine::{AtSpeed, OutputRule, OutputSettings};

    #[test]
    fn what_the_machine_lacks_is_named_with_what_it_has() {
        let mut signals = SignalSettings::default();
        let output = |name: &str, kind, number| OutputSettings {
            name: name.to_owned(),
            kind,
            number,
            safe: 0.0,
            range: [0.0, 10.0],
            on_hold: OutputRule::Keep,
            on_stop: OutputRule::Keep,
            on_end: OutputRule::Keep,
        };
        signals.outputs = vec![
            output("clamp", SignalKind::Digital, 3),
            output("laser", SignalKind::Analog, 0),
        ];
        signals.spindles = vec![SpindleSettings {
            number: 0,
            at_speed: AtSpeed::Unknown,
            at_speed_timeout_s: 10.0,
            acceleration_rpm_s: None,
            ramp_rpm_s: None,
            max_rpm: 8000.0,
            reverse: false,
        }];
        let digital = |index| Action::Output {
            index,
            on: true,
            synchronised: true,
        };
        let analog = |value| Action::AnalogOutput {
            index: 0,
            value,
            synchronised: false,
        };
        let spindle = |direction, speed_rpm| Action::Spindle {
            spindle: 0,
            direction,
            speed_rpm,
        };
        let wait = Action::WaitInput {
            index: 1,
            analog: false,
            mode: 3,
            timeout_s: 1.0,
        };
        for good in [
            digital(3),
            analog(10.0),
            spindle(SpindleDirection::Clockwise, 8000.0),
            spindle(SpindleDirection::Stopped, 9000.0),
        ] {
            assert_eq!(signal_objection(&signals, &good), None, "{good:?}");
        }
        let cases = [
            (
                digital(0),
                "M62 P0: the machine file has no digital output 0",
                "3 (clamp)",
            ),
            (
                analog(10.5),
                "M68 E0 Q10.5: the output laser takes 0 to 10",
                "min and max",
            ),
            (
                wait,
                "M66 P1: the machine file has no digital input 1",
                "[[input]]",
            ),
            (
                spindle(SpindleDirection::Clockwise, 8001.0),
                "8000 rpm at most",
                "S8000 or less",
            ),
            (
                spindle(SpindleDirection::CounterClockwise, 10.0),
                "clockwise only",
                "reverse = true",
            ),
        ];
        for (action, message, help) in cases {
            let (said, cure) = signal_objection(&signals, &action).unwrap();
            assert!(said.contains(message) && cure.contains(help), "{said}; {cure}");
        }
    }
}
