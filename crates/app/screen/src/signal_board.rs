//! Values of inputs, outputs and spindles, from the messages of core and bridges.

use evolvent_bus::{MachineInputs, MachineOutputs, PROBE_STATES, SPINDLE_DIRECTIONS};
use evolvent_machine::{SignalKind, SignalSettings};

use crate::messages::SignalValues;

/// Maximum number of bridges whose inputs are kept; beyond it the oldest one is dropped.
const MAX_BRIDGES: usize = 16;
/// Number of the direction of a stopped spindle.
const STOPPED: u32 = SPINDLE_DIRECTIONS[0].1;
/// Number of the direction that turns counter-clockwise.
const COUNTER_CLOCKWISE: u32 = SPINDLE_DIRECTIONS[2].1;

/// The newest messages about the signals of a machine.
#[derive(Debug)]
pub(crate) struct SignalBoard {
    settings: SignalSettings,
    outputs: Option<MachineOutputs>,
    bridges: Vec<MachineInputs>,
}

impl SignalBoard {
    pub(crate) fn new(settings: SignalSettings) -> Self {
        Self {
            settings,
            outputs: None,
            bridges: Vec::new(),
        }
    }

    /// Whether the machine has signals.
    pub(crate) fn is_empty(&self) -> bool {
        self.settings.is_empty()
    }

    pub(crate) fn take_outputs(&mut self, message: MachineOutputs) {
        self.outputs = Some(message);
    }

    pub(crate) fn take_inputs(&mut self, message: MachineInputs) {
        self.bridges.retain(|known| known.instance != message.instance);
        if self.bridges.len() == MAX_BRIDGES {
            self.bridges.remove(0);
        }
        self.bridges.push(message);
    }

    /// The values at a time of CLOCK_MONOTONIC. Inputs older than the input timeout are unknown, as in the
    /// core.
    pub(crate) fn values(&self, now_ns: u64) -> SignalValues {
        let timeout_s = self.settings.input_timeout_s;
        let is_fresh =
            |message: &&MachineInputs| now_ns.saturating_sub(message.time_ns) as f64 * 1e-9 <= timeout_s;
        let fresh = || self.bridges.iter().rev().filter(is_fresh);
        let inputs = self.settings.inputs.iter().map(|input| {
            fresh().find_map(|bridge| match input.kind {
                SignalKind::Digital => bridge.digital_input(input.number).map(f64::from),
                SignalKind::Analog => bridge.analog_input(input.number),
            })
        });
        let outputs = self.settings.outputs.iter().map(|output| {
            self.outputs.as_ref().and_then(|sent| match output.kind {
                SignalKind::Digital => sent.digital_output(output.number).map(f64::from),
                SignalKind::Analog => sent.analog_output(output.number),
            })
        });
        let spindles = self.settings.spindles.iter().map(|spindle| {
            let sent = self.outputs.as_ref()?;
            let at = spindle.number as usize;
            let rpm = sent.spindle_speed_rpm(spindle.number)?;
            Some(match sent.spindle_direction.get(at) {
                // The field keeps the last speed while the spindle is stopped.
                Some(&STOPPED) => 0.0,
                Some(&COUNTER_CLOCKWISE) => -rpm,
                _ => rpm,
            })
        });
        let state = fresh().map(|bridge| bridge.probe).max().unwrap_or(0);
        let state = PROBE_STATES.iter().find(|(_, known)| *known == state);
        SignalValues {
            inputs: inputs.collect(),
            outputs: outputs.collect(),
            spindles_rpm: spindles.collect(),
            probe: self
                .settings
                .probe
                .and(state)
                .map(|(name, _)| name.to_ascii_lowercase()),
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    const FILE: &str = include_str!("../../../../config/machines/mill-3axis.toml");
    const SIGNALS: &str = "
[[input]]
name = \"door\"
number = 3
[[input]]
name = \"wheel\"
kind = \"analog\"
number = 2
[[output]]
name = \"clamp\"
number = 63
[[output]]
name = \"heater\"
kind = \"analog\"
number = 1
max = 10.0
[[spindle]]
max_rpm = 6000
feedback = true
";

    /// Inputs door and wheel, outputs clamp and heater, a spindle with feedback.
    pub(crate) fn settings() -> SignalSettings {
        let machine = evolvent_machine::Machine::parse(&format!("{FILE}{SIGNALS}"), "mill.toml");
        machine.unwrap().signals
    }

    fn board() -> SignalBoard {
        SignalBoard::new(settings())
    }

    #[test]
    fn each_signal_has_its_value_by_name() {
        let mut board = board();
        assert!(!board.is_empty());
        let nothing = board.values(0);
        assert_eq!(nothing.inputs, [None, None]);
        assert_eq!((nothing.outputs, nothing.probe), (vec![None, None], None));
        let mut inputs = MachineInputs {
            time_ns: 1_000_000_000,
            digital_mask: 0b1000,
            digital: 0b1000,
            analog_mask: 0b100,
            ..MachineInputs::default()
        };
        inputs.analog[2] = 123.5;
        board.take_inputs(inputs);
        let mut outputs = MachineOutputs {
            digital_mask: 1 << 63,
            digital: 1 << 63,
            analog_mask: 0b10,
            spindle_mask: 1,
            ..MachineOutputs::default()
        };
        (
            outputs.analog[1],
            outputs.spindle_rpm[0],
            outputs.spindle_direction[0],
        ) = (2.5, 800.0, 2);
        board.take_outputs(outputs);
        let values = board.values(1_050_000_000);
        assert_eq!(values.inputs, [Some(1.0), Some(123.5)]);
        assert_eq!(values.outputs, [Some(1.0), Some(2.5)]);
        assert_eq!(values.spindles_rpm, [Some(-800.0)]);
        // 100 ms are the default timeout.
        assert_eq!(board.values(1_101_000_000).inputs, [None, None]);
    }

    #[test]
    fn invalid_inputs_are_unknown_and_memory_is_bounded() {
        let mut board = board();
        for instance in 0..1000 {
            let mut inputs = MachineInputs {
                instance,
                analog_mask: u32::MAX,
                ..MachineInputs::default()
            };
            inputs.analog[2] = f64::NAN;
            board.take_inputs(inputs);
        }
        assert_eq!(board.bridges.len(), MAX_BRIDGES);
        assert_eq!(board.values(0).inputs, [None, None]);
    }
}
