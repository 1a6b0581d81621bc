//! Driven and read pins of the board, checked against the firmware's function of each pin.

use super::{MAX_PINS, PWM_DIRECTION, PWM_ENABLE, PWM_OUT, Plan, PlanError, grow, module};
use crate::board_settings::{BoardSettings, Pin};
use crate::description::{Description, PinFunction, RELAY_REFERENCE, tag};
use crate::field_pins::{InputLocation, OutputLocation, filter_location, output_location};

impl Plan {
    /// Reserves all pins that the board file names, after those of the modules: outputs first, so that every
    /// input is checked against all driven pins.
    pub(super) fn use_pins(
        &mut self,
        board: &Description,
        settings: &BoardSettings,
    ) -> Result<(), PlanError> {
        let uses = settings.pin_uses();
        let (driven, read): (Vec<_>, Vec<_>) = uses.into_iter().partition(|used| used.is_driven);
        for used in driven.iter().chain(&read) {
            let result = if used.is_driven {
                self.drive(board, used.pin, &used.key)
            } else {
                self.look_at(board, used.pin)
            };
            result.map_err(|cause| PlanError::At {
                file: settings.file.clone(),
                key: used.key.clone(),
                cause: Box::new(cause),
            })?;
        }
        Ok(())
    }

    /// Adds a field input or output of a smart-serial device.
    fn use_remote(&mut self, remote: usize, is_output: bool, number: usize) -> Result<(), PlanError> {
        let Some(found) = self.remote(remote) else {
            return Ok(());
        };
        let bit = found.field_bit(is_output, number)?;
        if let Some(location) = self.remote_bits[usize::from(is_output)][remote].get_mut(number) {
            *location = bit;
        }
        Ok(())
    }

    /// The function of a pin that the board has.
    pub(super) fn function(&self, board: &Description, pin: usize) -> Result<PinFunction, PlanError> {
        // A board may list more pins than its ports have bits.
        let pins = board.pins.len().min(self.ports * self.port_width).min(MAX_PINS);
        match board.pins.get(pin) {
            Some(function) if pin < pins => Ok(*function),
            _ => Err(PlanError::Pin { pin, pins }),
        }
    }

    fn look_at(&mut self, board: &Description, pin: Pin) -> Result<(), PlanError> {
        if let Some(remote) = pin.remote {
            if pin.slow {
                return Err(PlanError::NoFilter { pin: pin.pin });
            }
            return self.use_remote(remote, false, pin.pin);
        }
        let function = self.function(board, pin.pin)?;
        // The pins of these modules drive transistors: no signal outside of the board can be read there.
        let is_output = matches!(function.tag, tag::RELAY | tag::SIMPLE_OUTPUT) && !function.is_input();
        if let (false, Some(by)) = (is_output, self.driver(pin.pin)) {
            let by = by.to_owned();
            return Err(PlanError::Taken { pin: pin.pin, by });
        }
        if is_output {
            return Err(PlanError::Function {
                pin: pin.pin,
                function: function.to_string(),
                wanted: "an input",
            });
        }
        if let Some(location @ InputLocation::Filter { unit, bit }) = filter_location(function) {
            self.field.use_filter(board, unit, bit, pin.slow)?;
            self.reads[pin.pin] = Some(location);
        } else if pin.slow {
            return Err(PlanError::NoFilter { pin: pin.pin });
        }
        Ok(())
    }

    /// The driver of a pin.
    fn driver(&self, pin: usize) -> Option<&str> {
        let found = self.drivers.iter().find(|(driven, _)| *driven == pin);
        found.map(|(_, by)| by.as_str())
    }

    /// Makes a pin an output, of one driver only. Returns its port and bit.
    pub(super) fn take(&mut self, pin: usize, by: &str) -> Result<(usize, u32), PlanError> {
        if let Some(other) = self.driver(pin) {
            let by = other.to_owned();
            return Err(PlanError::Taken { pin, by });
        }
        self.drivers.push((pin, by.to_owned()));
        let (port, bit) = self.port_bit(pin);
        self.driven[port] |= 1 << bit;
        Ok((port, 1 << bit))
    }

    fn drive(&mut self, board: &Description, pin: Pin, key: &str) -> Result<(), PlanError> {
        if let Some(remote) = pin.remote {
            return self.use_remote(remote, true, pin.pin);
        }
        let function = self.function(board, pin.pin)?;
        let location = output_location(function);
        // Two connected outputs damage each other: an input of the firmware is driven by a receiver or
        // isolator. Outputs of unused modules may be used as plain outputs; isolated outputs only if the
        // bridge sets them.
        let has_module = matches!(function.tag, tag::RELAY | tag::SIMPLE_OUTPUT);
        if function.is_input() || has_module && location.is_none() {
            return Err(PlanError::Function {
                pin: pin.pin,
                function: function.to_string(),
                wanted: "an output",
            });
        }
        let (port, bit) = self.take(pin.pin, key)?;
        let Some(location) = location else {
            return Ok(());
        };
        self.alternate[port] |= bit;
        self.sets[pin.pin] = Some(location);
        match location {
            OutputLocation::Relay { unit, .. } => {
                if let Some(reference) = self.field.use_relay(board, unit)? {
                    self.function(board, reference)?;
                    let by = PinFunction {
                        tag: tag::RELAY,
                        unit: unit as u8,
                        pin: RELAY_REFERENCE,
                    };
                    // Common to all outputs of the unit, so it is taken once.
                    if self.driver(reference).is_none_or(|other| other != by.to_string()) {
                        let (port, bit) = self.take(reference, &by.to_string())?;
                        self.alternate[port] |= bit;
                    }
                }
            }
            OutputLocation::Simple { unit, .. } => self.field.use_simple(board, unit)?,
            OutputLocation::Port { .. } | OutputLocation::Remote { .. } => {}
        }
        Ok(())
    }

    pub(super) fn connect(
        &mut self,
        board: &Description,
        tag: u8,
        what: &'static str,
        unit: usize,
        pins: &[u8],
    ) -> Result<(), PlanError> {
        for pin in pins {
            let Some(pin) = board.pin_of(tag, unit, *pin) else {
                return Err(PlanError::NoPin { what, unit });
            };
            self.function(board, pin)?;
            let (port, bit) = self.take(pin, &format!("{what} {unit}"))?;
            self.alternate[port] |= bit;
        }
        Ok(())
    }

    pub(super) fn use_pwm(&mut self, board: &Description, unit: usize) -> Result<(), PlanError> {
        let found = module(board, tag::PWM, "PWM generator", unit, 5)?;
        grow(&mut self.pwm, found, unit);
        self.connect(board, tag::PWM, "PWM generator", unit, &[PWM_OUT])?;
        // Analog outputs on the board itself have no such pins.
        for pin in [PWM_DIRECTION, PWM_ENABLE] {
            if board.pin_of(tag::PWM, unit, pin).is_some() {
                self.connect(board, tag::PWM, "PWM generator", unit, &[pin])?;
            }
        }
        Ok(())
    }
}
