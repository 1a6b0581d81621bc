//! Outputs set by hand.

use evolvent_config::plain;
use evolvent_control::{Alarm, Rejection};
use evolvent_machine::{OutputSettings, SignalKind};
use evolvent_signals::{OutputChange, SignalMoment};

use super::operator::Operator;

impl Operator {
    /// The change that sets the output of this name.
    ///
    /// # Errors
    /// The machine file has no such output, or it does not take the value.
    pub(super) fn output_change(&self, name: &str, value: f64) -> Result<OutputChange, Rejection> {
        let outputs = &self.setup.machine.signals.outputs;
        let Some(output) = outputs.iter().find(|output| output.name == name) else {
            let there: Vec<&str> = outputs.iter().map(|output| output.name.as_str()).collect();
            let text = if there.is_empty() {
                "the machine file has no [[output]]".to_owned()
            } else {
                format!(
                    "the machine file has no output {name}; it has {}",
                    there.join(", ")
                )
            };
            return Err(Rejection::new(Alarm::NoSignal, text));
        };
        change_of(output, value)
    }
}

fn change_of(output: &OutputSettings, value: f64) -> Result<OutputChange, Rejection> {
    // An output set by hand changes at once.
    let mut change = OutputChange::at(SignalMoment::Rest(0));
    match output.kind {
        SignalKind::Digital if value == 0.0 || value == 1.0 => {
            change.set_digital(output.number, value == 1.0);
            Ok(change)
        }
        SignalKind::Digital => {
            let text = format!(
                "the output {} is digital: it takes 0 (off) or 1 (on), not {}",
                output.name,
                plain(value)
            );
            Err(Rejection::new(Alarm::BadNumber, text))
        }
        SignalKind::Analog => {
            let [low, high] = output.range;
            if !(low..=high).contains(&value) {
                let text = format!(
                    "the output {} takes {low} to {high}, not {}",
                    output.name,
                    plain(value)
                );
                return Err(Rejection::new(Alarm::BadNumber, text));
            }
            change.set_analog(output.number, value);
            Ok(change)
        }
    }
}
