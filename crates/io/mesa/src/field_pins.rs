//! Pins with their own modules: filtered inputs (InM), isolated outputs (SSR, OutM).
//!
//! A 7I96S has all three: its inputs are filtered by InM, four outputs are switched by SSR and two by OutM.
//! SSR drives the gates of isolated transistors through transformers, with an alternating signal between each
//! output pin and a common reference pin.

use crate::description::{Description, Module, PinFunction, RELAY_REFERENCE, tag};
use crate::packet::{Packet, PacketFull, Space};
use crate::plan::PlanError;

/// Maximum number of instances of each of these modules.
pub(crate) const MAX_FIELD_UNITS: usize = 4;
/// Maximum number of data bits of an SSR; pin 32 of the module is its reference.
const RELAYS: u8 = 31;
/// Drive frequency of the isolated gates, Hz: as `hm2_eth` sets it.
const RELAY_HZ: f64 = 1e6;
const RELAY_ENABLE: u32 = 1 << 12;
/// Scan rate of a filter, Hz, with one sample of every input per scan: as `hm2_eth` sets it.
const SCAN_HZ: f64 = 20_000.0;
/// Maximum of the short and the long filter, scans: 6 and 10 bits.
const MAX_SHORT: f64 = 63.0;
const MAX_LONG: f64 = 1023.0;
const MAX_DIVISOR: f64 = 1023.0;

/// The register bit of an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InputLocation {
    /// In the register of a port.
    Port { port: usize, bit: usize },
    /// In the filtered data of an InM.
    Filter { unit: usize, bit: usize },
    /// In the process data of a smart-serial device.
    Remote { remote: usize, bit: usize },
}

/// The register bit of an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OutputLocation {
    /// In the register of a port.
    Port { port: usize, bit: usize },
    /// In the data of an SSR.
    Relay { unit: usize, bit: usize },
    /// In the data of an OutM.
    Simple { unit: usize, bit: usize },
    /// In the process data of a smart-serial device.
    Remote { remote: usize, bit: usize },
}

/// The filter bit of a pin whose function is InM.
pub(crate) const fn filter_location(function: PinFunction) -> Option<InputLocation> {
    let unit = function.unit as usize;
    if function.tag == tag::INPUT_FILTER && function.pin >= 1 && function.pin <= 32 && unit < MAX_FIELD_UNITS
    {
        let bit = function.pin as usize - 1;
        return Some(InputLocation::Filter { unit, bit });
    }
    None
}

/// The data bit of a pin whose function is an output of SSR or OutM.
pub(crate) const fn output_location(function: PinFunction) -> Option<OutputLocation> {
    let (unit, pin) = (function.unit as usize, function.pin & 0x7F);
    if function.pin & 0x80 == 0 || unit >= MAX_FIELD_UNITS || pin == 0 {
        return None;
    }
    let bit = pin as usize - 1;
    match function.tag {
        tag::RELAY if pin <= RELAYS => Some(OutputLocation::Relay { unit, bit }),
        tag::SIMPLE_OUTPUT if pin <= 32 => Some(OutputLocation::Simple { unit, bit }),
        _ => None,
    }
}

/// The modules of a board that the pins of the board file need.
#[derive(Clone, Debug, Default)]
pub(crate) struct FieldPins {
    pub(crate) filter: Option<(Module, usize)>,
    pub(crate) relay: Option<(Module, usize)>,
    pub(crate) simple: Option<(Module, usize)>,
    /// Number of inputs that each filter scans, and those with the long filter.
    widths: [u32; MAX_FIELD_UNITS],
    slow: [u32; MAX_FIELD_UNITS],
}

impl FieldPins {
    /// Adds an input of a filter.
    pub(crate) fn use_filter(
        &mut self,
        board: &Description,
        unit: usize,
        bit: usize,
        slow: bool,
    ) -> Result<(), PlanError> {
        let found = crate::plan::module(board, tag::INPUT_FILTER, "input filter", unit, 5)?;
        crate::plan::grow(&mut self.filter, found, unit);
        let pins = board
            .pins
            .iter()
            .filter_map(|function| filter_location(*function));
        let bits = pins.filter_map(|location| match location {
            InputLocation::Filter { unit: other, bit } if other == unit => Some(bit as u32 + 1),
            _ => None,
        });
        self.widths[unit] = bits.max().unwrap_or(1);
        self.slow[unit] |= u32::from(slow) << bit;
        Ok(())
    }

    /// Adds an output of an SSR. Returns the board's pin of its reference, if any.
    pub(crate) fn use_relay(&mut self, board: &Description, unit: usize) -> Result<Option<usize>, PlanError> {
        let found = crate::plan::module(board, tag::RELAY, "SSR", unit, 2)?;
        crate::plan::grow(&mut self.relay, found, unit);
        Ok(board.pin_of(tag::RELAY, unit, RELAY_REFERENCE))
    }

    /// Adds an output of an OutM.
    pub(crate) fn use_simple(&mut self, board: &Description, unit: usize) -> Result<(), PlanError> {
        let found = crate::plan::module(board, tag::SIMPLE_OUTPUT, "OutM", unit, 1)?;
        crate::plan::grow(&mut self.simple, found, unit);
        Ok(())
    }

    /// Writes for the time before pins are outputs: filters, data of outputs, SSR disabled.
    pub(crate) fn prepare(
        &self,
        packet: &mut Packet,
        times_s: [f64; 2],
        outputs: &FieldOutputs,
    ) -> Result<(), PacketFull> {
        if let Some((filter, count)) = self.filter {
            for unit in 0..count {
                let control = filter_control(f64::from(filter.clock_hz), self.widths[unit], times_s);
                packet.write(filter.address(0, unit), &[control])?;
                packet.write(filter.address(1, unit), &[self.slow[unit]])?;
            }
        }
        if let Some((relay, count)) = self.relay {
            packet.write(relay.address(1, 0), &[0; MAX_FIELD_UNITS][..count])?;
        }
        self.write(packet, outputs)
    }

    /// Enables SSR, after the pins are outputs.
    pub(crate) fn start(&self, packet: &mut Packet) -> Result<(), PacketFull> {
        let Some((relay, count)) = self.relay else {
            return Ok(());
        };
        let divisor = (f64::from(relay.clock_hz) / (2.0 * RELAY_HZ) - 2.0).clamp(0.0, 4095.0);
        let rate = RELAY_ENABLE | divisor.round() as u32;
        packet.write(relay.address(1, 0), &[rate; MAX_FIELD_UNITS][..count])
    }

    /// Writes the data of the outputs.
    pub(crate) fn write(&self, packet: &mut Packet, outputs: &FieldOutputs) -> Result<(), PacketFull> {
        if let Some((relay, count)) = self.relay {
            packet.write(relay.address(0, 0), &outputs.relays[..count])?;
        }
        if let Some((simple, count)) = self.simple {
            packet.write(simple.address(0, 0), &outputs.simple[..count])?;
        }
        Ok(())
    }

    /// Opens all outputs.
    pub(crate) fn release(&self, packet: &mut Packet) -> Result<(), PacketFull> {
        self.write(packet, &FieldOutputs::default())?;
        if let Some((relay, count)) = self.relay {
            packet.write(relay.address(1, 0), &[0; MAX_FIELD_UNITS][..count])?;
        }
        Ok(())
    }

    /// Reads the filtered inputs.
    pub(crate) fn read(&self, packet: &mut Packet) -> Result<(), PacketFull> {
        if let Some((filter, count)) = self.filter {
            packet.read(Space::HostMot2, filter.address(2, 0), count)?;
        }
        Ok(())
    }

    /// Number of filters that are read.
    pub(crate) const fn filters(&self) -> usize {
        match self.filter {
            Some((_, count)) => count,
            None => 0,
        }
    }
}

/// Data registers written every cycle.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FieldOutputs {
    pub(crate) relays: [u32; MAX_FIELD_UNITS],
    pub(crate) simple: [u32; MAX_FIELD_UNITS],
}

/// The control register of a filter. Each input is sampled every `4 width (divisor + 1)` clocks and changes
/// after the given time at the same level. The global inversion is off: board files invert by pin.
fn filter_control(clock_hz: f64, width: u32, [short_s, long_s]: [f64; 2]) -> u32 {
    let width = f64::from(width.max(1));
    let divisor = (clock_hz / (4.0 * SCAN_HZ * width) - 1.0)
        .round()
        .clamp(0.0, MAX_DIVISOR);
    let scan_s = width * 4.0 * (divisor + 1.0) / clock_hz;
    let scans = |time_s: f64, most: f64| (time_s / scan_s).round().clamp(0.0, most) as u32;
    scans(long_s, MAX_LONG) << 22 | scans(short_s, MAX_SHORT) << 16 | (divisor as u32) << 6
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Register map: 100 MHz, 11 inputs, 250 us and 25 ms.
    #[test]
    fn a_filter_scans_twenty_thousand_times_a_second() {
        let control = filter_control(100e6, 11, [250e-6, 25e-3]);
        let (divisor, short, long) = (control >> 6 & 0x3FF, control >> 16 & 0x3F, control >> 22);
        let scan_us = 11.0 * 4.0 * f64::from(divisor + 1) / 100.0;
        assert!((scan_us - 50.0).abs() < 0.5, "{scan_us}");
        assert!((f64::from(short) * scan_us - 250.0).abs() < 25.0, "{short}");
        assert!((f64::from(long) * scan_us - 25_000.0).abs() < 50.0, "{long}");
        // The divisor limits the scan time of a single input.
        let one = filter_control(100e6, 1, [250e-6, 25e-3]);
        assert_eq!(one >> 6 & 0x3FF, 1023);
    }

    #[test]
    fn pins_of_modules_have_their_places() {
        let at = |tag, unit, pin| PinFunction { tag, unit, pin };
        assert_eq!(
            filter_location(at(tag::INPUT_FILTER, 0, 11)),
            Some(InputLocation::Filter { unit: 0, bit: 10 })
        );
        assert_eq!(filter_location(at(tag::INPUT_FILTER, 4, 11)), None);
        assert_eq!(
            output_location(at(tag::RELAY, 0, 0x81)),
            Some(OutputLocation::Relay { unit: 0, bit: 0 })
        );
        assert_eq!(
            output_location(at(tag::SIMPLE_OUTPUT, 0, 0x86)),
            Some(OutputLocation::Simple { unit: 0, bit: 5 })
        );
        // The reference is not an output, and 80h has no number.
        assert_eq!(output_location(at(tag::RELAY, 0, RELAY_REFERENCE)), None);
        assert_eq!(output_location(at(tag::RELAY, 0, 0x80)), None);
    }
}
