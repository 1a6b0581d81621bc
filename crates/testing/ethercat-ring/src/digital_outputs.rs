//! The digital outputs of a drive (60FEh): which of them the bus sets, and which the drive itself.

use crate::drive_settings::OutputMask;
use crate::object::Dictionary;

/// The brake, and the outputs of the manufacturer. CiA 402 reserves the others.
const BRAKE: u32 = 1;
const MANUFACTURER_OUTPUTS: u32 = 0xFFFF_0000;

/// What the bus requests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DigitalOutputs {
    wanted: u32,
    mask: u32,
}

impl DigitalOutputs {
    /// The newest request, by 60FEh.
    pub(crate) fn requested(objects: &Dictionary, mask: OutputMask) -> Self {
        Self {
            wanted: objects.integer(0x60FE, 1) as u32,
            mask: match mask {
                OutputMask::Absent => u32::MAX,
                OutputMask::Writable | OutputMask::Fixed(_) => objects.integer(0x60FE, 2) as u32,
            },
        }
    }

    /// The contacts. Those that the mask does not give to the bus are off, except the brake, which the drive
    /// closes without torque.
    pub(crate) fn contacts(self, has_torque: bool) -> u32 {
        let own = u32::from(!has_torque) & BRAKE;
        (self.wanted & self.mask | own & !self.mask) & (BRAKE | MANUFACTURER_OUTPUTS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive_objects::add_drive_objects;
    use crate::drive_settings::DriveSettings;

    #[test]
    fn outputs_are_of_the_bus_where_the_mask_says() {
        for (output_mask, written, expected) in [
            (OutputMask::Writable, 0, [0x0000_0001, 0]),
            (OutputMask::Writable, 0x8002_0000, [0x8000_0001, 0x8000_0000]),
            (OutputMask::Writable, 0xFFFF_FFFF, [0x8001_0001; 2]),
            (OutputMask::Fixed(0x0001_0001), 0, [0x0001_0001; 2]),
            (OutputMask::Absent, 0, [0x8001_0001; 2]),
        ] {
            let settings = DriveSettings {
                output_mask,
                ..DriveSettings::default()
            };
            let mut objects = Dictionary::default();
            add_drive_objects(&settings, &mut objects);
            objects.set_integer(0x60FE, 1, 0x8001_8001);
            if output_mask == OutputMask::Writable {
                objects.set_integer(0x60FE, 2, written);
            }
            let outputs = DigitalOutputs::requested(&objects, output_mask);
            let contacts = [false, true].map(|has_torque| outputs.contacts(has_torque));
            assert_eq!(contacts, expected, "{output_mask:?} {written:X}");
        }
        assert_eq!(DigitalOutputs::default().contacts(false), 1, "outside OP");
    }
}
