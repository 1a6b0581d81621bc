//! Process data of a drive: the objects that the bridge exchanges, and their positions.

use thiserror::Error;

use crate::zero_impulse::ProbeNumber;

/// An object in the process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Mapped {
    pub(crate) index: u16,
    pub(crate) sub_index: u8,
    pub(crate) bits: u8,
}

impl Mapped {
    const fn new(index: u16, bits: u8) -> Self {
        Self {
            index,
            sub_index: 0,
            bits,
        }
    }

    const fn of_sub_index(self, sub_index: u8) -> Self {
        Self { sub_index, ..self }
    }

    /// As in objects 1600h and 1A00h.
    pub(crate) const fn number(self) -> u32 {
        (self.index as u32) << 16 | (self.sub_index as u32) << 8 | self.bits as u32
    }

    pub(crate) const fn from_number(number: u32) -> Self {
        Self {
            index: (number >> 16) as u16,
            sub_index: (number >> 8) as u8,
            bits: number as u8,
        }
    }
}

/// Control word, mode.
const NEEDED_OUTPUTS: [Mapped; 2] = [Mapped::new(0x6040, 16), Mapped::new(0x6060, 8)];
const TARGET_POSITION: Mapped = Mapped::new(0x607A, 32);
const TARGET_VELOCITY: Mapped = Mapped::new(0x60FF, 32);
/// Status word, mode, position.
const NEEDED_INPUTS: [Mapped; 3] = [
    Mapped::new(0x6041, 16),
    Mapped::new(0x6061, 8),
    Mapped::new(0x6064, 32),
];
const VELOCITY_OFFSET: Mapped = Mapped::new(0x60B1, 32);
const TORQUE_OFFSET: Mapped = Mapped::new(0x60B2, 16);
const ERROR_CODE: Mapped = Mapped::new(0x603F, 16);
const DIGITAL_INPUTS: Mapped = Mapped::new(0x60FD, 32);
pub(crate) const PHYSICAL_OUTPUTS: Mapped = Mapped::new(0x60FE, 32).of_sub_index(1);
pub(crate) const OUTPUT_MASK: Mapped = Mapped::new(0x60FE, 32).of_sub_index(2);
const TORQUE: Mapped = Mapped::new(0x6077, 16);
const FOLLOWING_ERROR: Mapped = Mapped::new(0x60F4, 32);
const PROBE_FUNCTION: Mapped = Mapped::new(0x60B8, 16);
const PROBE_STATUS: Mapped = Mapped::new(0x60B9, 16);
const PROBE_POSITION: Mapped = Mapped::new(0x60BA, 32);
const PROBE_2_POSITION: Mapped = Mapped::new(0x60BC, 32);

/// The object with the position of a touch probe at its rising edge.
const fn position_object(probe: ProbeNumber) -> Mapped {
    match probe {
        ProbeNumber::One => PROBE_POSITION,
        ProbeNumber::Two => PROBE_2_POSITION,
    }
}

/// The target object of a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum TargetObject {
    /// 607Ah, for axes.
    #[default]
    Position,
    /// 60FFh, for spindles.
    Velocity,
}

impl TargetObject {
    const fn mapped(self) -> Mapped {
        match self {
            Self::Position => TARGET_POSITION,
            Self::Velocity => TARGET_VELOCITY,
        }
    }
}

/// Objects that the network file requests in addition to those of every drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Extras {
    pub(crate) target: TargetObject,
    pub(crate) velocity_offset: bool,
    pub(crate) torque_offset: bool,
    pub(crate) following_error: bool,
    pub(crate) touch_probe: bool,
    /// The touch probe that latches the zero impulse.
    pub(crate) index_probe: Option<ProbeNumber>,
    /// Outputs of the machine are bits of 60FEh.
    pub(crate) digital_outputs: bool,
}

impl Extras {
    const fn has_probe(self) -> bool {
        self.touch_probe || self.index_probe.is_some()
    }

    /// The objects with latched positions.
    fn probe_positions(self) -> impl Iterator<Item = Mapped> {
        let index = self.index_probe.map(position_object);
        let probe = self.touch_probe.then_some(PROBE_POSITION);
        probe
            .into_iter()
            .chain(index.filter(move |index| probe != Some(*index)))
    }
}

/// The objects mapped as the drive's outputs.
pub(crate) fn wanted_outputs(extras: Extras) -> Vec<Mapped> {
    let mut wanted = NEEDED_OUTPUTS.to_vec();
    wanted.push(extras.target.mapped());
    wanted.extend(extras.velocity_offset.then_some(VELOCITY_OFFSET));
    wanted.extend(extras.torque_offset.then_some(TORQUE_OFFSET));
    wanted.extend(extras.has_probe().then_some(PROBE_FUNCTION));
    wanted.extend(extras.digital_outputs.then_some(PHYSICAL_OUTPUTS));
    wanted
}

/// The objects mapped as its inputs.
pub(crate) fn wanted_inputs(extras: Extras) -> Vec<Mapped> {
    let mut wanted = NEEDED_INPUTS.to_vec();
    wanted.extend([ERROR_CODE, DIGITAL_INPUTS, TORQUE]);
    wanted.extend(extras.following_error.then_some(FOLLOWING_ERROR));
    wanted.extend(extras.has_probe().then_some(PROBE_STATUS));
    wanted.extend(extras.probe_positions());
    wanted
}

/// Why process data cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum PdoError {
    /// An object is missing.
    #[error(
        "object {index:04X}h is not in its process data: let the bridge map them (map = true), or map it by \
         start-up objects"
    )]
    Missing {
        /// Index.
        index: u16,
    },
    /// An object does not start at a byte boundary, or has an unexpected size.
    #[error(
        "object {index:04X}h is in its process data with {bits} bits at bit {at}: the bridge needs whole \
         bytes"
    )]
    Unaligned {
        /// Index.
        index: u16,
        /// Its size.
        bits: u8,
        /// Its first bit.
        at: usize,
    },
}

/// What the drive has in 60FEh at start-up: bits of it that the network file does not name keep it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct HeldOutputs {
    pub(crate) physical: u32,
    pub(crate) mask: u32,
}

/// First bytes of the objects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PdoLayout {
    control_word: usize,
    mode: usize,
    target: usize,
    velocity_offset: Option<usize>,
    torque_offset: Option<usize>,
    status_word: usize,
    mode_display: usize,
    position: usize,
    error_code: Option<usize>,
    digital_inputs: Option<usize>,
    torque: Option<usize>,
    following_error: Option<usize>,
    physical_outputs: Option<usize>,
    output_mask: Option<usize>,
    held: HeldOutputs,
    /// Function and status of the touch probes, if one is requested.
    touch_probes: Option<[usize; 2]>,
    /// Position of touch probe 1, if requested.
    probe_position: Option<usize>,
    /// Position at the zero impulse, if requested.
    index_position: Option<usize>,
}

/// The outputs of one period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DriveOutputs {
    pub(crate) control_word: u16,
    pub(crate) mode: i8,
    pub(crate) target: i32,
    pub(crate) velocity_offset: i32,
    pub(crate) torque_offset: i16,
    pub(crate) probe_function: u16,
}

/// The inputs of one period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DriveInputs {
    pub(crate) status_word: u16,
    pub(crate) mode: i8,
    pub(crate) position: i32,
    pub(crate) error_code: u16,
    pub(crate) digital_inputs: u32,
    /// Thousandths of the rated torque.
    pub(crate) torque: i16,
    /// Object 60F4h, if requested.
    pub(crate) following_error: Option<i32>,
    pub(crate) probe_status: u16,
    pub(crate) probe_position: i32,
    /// Position at the zero impulse.
    pub(crate) index_position: i32,
}

fn find(mapped: &[Mapped], wanted: Mapped) -> Result<Option<usize>, PdoError> {
    let mut bit = 0;
    for entry in mapped {
        if (entry.index, entry.sub_index) == (wanted.index, wanted.sub_index) {
            if entry.bits != wanted.bits || bit % 8 != 0 {
                return Err(PdoError::Unaligned {
                    index: entry.index,
                    bits: entry.bits,
                    at: bit,
                });
            }
            return Ok(Some(bit / 8));
        }
        bit += usize::from(entry.bits);
    }
    Ok(None)
}

fn need(mapped: &[Mapped], wanted: Mapped) -> Result<usize, PdoError> {
    find(mapped, wanted)?.ok_or(PdoError::Missing { index: wanted.index })
}

fn put<const N: usize>(image: &mut [u8], at: usize, bytes: [u8; N]) {
    if let Some(slot) = image.get_mut(at..at + N) {
        slot.copy_from_slice(&bytes);
    }
}

fn get<const N: usize>(image: &[u8], at: usize) -> [u8; N] {
    let mut bytes = [0; N];
    if let Some(slot) = image.get(at..at + N) {
        bytes.copy_from_slice(slot);
    }
    bytes
}

impl PdoLayout {
    /// Finds the objects in the mapping of a drive.
    pub(crate) fn new(outputs: &[Mapped], inputs: &[Mapped], extras: Extras) -> Result<Self, PdoError> {
        let [control_word, mode] = NEEDED_OUTPUTS;
        let [status_word, mode_display, position] = NEEDED_INPUTS;
        let offset = |wanted: bool, object| {
            if wanted {
                need(outputs, object).map(Some)
            } else {
                find(outputs, object)
            }
        };
        Ok(Self {
            control_word: need(outputs, control_word)?,
            mode: need(outputs, mode)?,
            target: need(outputs, extras.target.mapped())?,
            velocity_offset: offset(extras.velocity_offset, VELOCITY_OFFSET)?,
            torque_offset: offset(extras.torque_offset, TORQUE_OFFSET)?,
            status_word: need(inputs, status_word)?,
            mode_display: need(inputs, mode_display)?,
            position: need(inputs, position)?,
            error_code: find(inputs, ERROR_CODE)?,
            digital_inputs: find(inputs, DIGITAL_INPUTS)?,
            torque: find(inputs, TORQUE)?,
            following_error: if extras.following_error {
                Some(need(inputs, FOLLOWING_ERROR)?)
            } else {
                None
            },
            physical_outputs: offset(extras.digital_outputs, PHYSICAL_OUTPUTS)?,
            output_mask: find(outputs, OUTPUT_MASK)?,
            held: HeldOutputs::default(),
            touch_probes: if extras.has_probe() {
                Some([need(outputs, PROBE_FUNCTION)?, need(inputs, PROBE_STATUS)?])
            } else {
                None
            },
            probe_position: if extras.touch_probe {
                Some(need(inputs, PROBE_POSITION)?)
            } else {
                None
            },
            index_position: match extras.index_probe {
                Some(probe) => Some(need(inputs, position_object(probe))?),
                None => None,
            },
        })
    }

    /// First bit of the digital inputs; 0 if they are neither present nor needed.
    pub(crate) fn digital_inputs_at(&self, needed: bool) -> Result<u32, PdoError> {
        match self.digital_inputs {
            Some(at) => Ok(8 * at as u32),
            None if needed => Err(PdoError::Missing {
                index: DIGITAL_INPUTS.index,
            }),
            None => Ok(0),
        }
    }

    /// First bit of the physical outputs, if they are process data.
    pub(crate) fn physical_outputs_at(&self) -> Option<u32> {
        self.physical_outputs.map(|at| 8 * at as u32)
    }

    /// Whether 60FEh is process data, which overwrite it in each period.
    pub(crate) const fn writes_digital_outputs(&self) -> bool {
        self.physical_outputs.is_some() || self.output_mask.is_some()
    }

    /// Sends these bits of 60FEh in each period; outputs of the machine are written over them.
    pub(crate) const fn hold_outputs(&mut self, held: HeldOutputs) {
        self.held = held;
    }

    pub(crate) fn write(&self, outputs: &DriveOutputs, image: &mut [u8]) {
        put(image, self.control_word, outputs.control_word.to_le_bytes());
        put(image, self.mode, outputs.mode.to_le_bytes());
        put(image, self.target, outputs.target.to_le_bytes());
        if let Some(at) = self.velocity_offset {
            put(image, at, outputs.velocity_offset.to_le_bytes());
        }
        if let Some(at) = self.torque_offset {
            put(image, at, outputs.torque_offset.to_le_bytes());
        }
        if let Some(at) = self.physical_outputs {
            put(image, at, self.held.physical.to_le_bytes());
        }
        if let Some(at) = self.output_mask {
            put(image, at, self.held.mask.to_le_bytes());
        }
        if let Some([at, _]) = self.touch_probes {
            put(image, at, outputs.probe_function.to_le_bytes());
        }
    }

    pub(crate) fn read(&self, image: &[u8]) -> DriveInputs {
        DriveInputs {
            status_word: u16::from_le_bytes(get(image, self.status_word)),
            mode: i8::from_le_bytes(get(image, self.mode_display)),
            position: i32::from_le_bytes(get(image, self.position)),
            error_code: self.error_code.map_or(0, |at| u16::from_le_bytes(get(image, at))),
            digital_inputs: self
                .digital_inputs
                .map_or(0, |at| u32::from_le_bytes(get(image, at))),
            torque: self.torque.map_or(0, |at| i16::from_le_bytes(get(image, at))),
            following_error: self.following_error.map(|at| i32::from_le_bytes(get(image, at))),
            probe_status: self
                .touch_probes
                .map_or(0, |[_, at]| u16::from_le_bytes(get(image, at))),
            probe_position: self
                .probe_position
                .map_or(0, |at| i32::from_le_bytes(get(image, at))),
            index_position: self
                .index_position
                .map_or(0, |at| i32::from_le_bytes(get(image, at))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VELOCITY: Extras = Extras {
        target: TargetObject::Position,
        velocity_offset: true,
        torque_offset: false,
        following_error: false,
        touch_probe: false,
        index_probe: None,
        digital_outputs: false,
    };

    #[test]
    fn what_is_asked_for_is_mapped_and_read() {
        let extras = Extras {
            following_error: true,
            touch_probe: true,
            ..Extras::default()
        };
        let (outputs, inputs) = (wanted_outputs(extras), wanted_inputs(extras));
        let layout = PdoLayout::new(&outputs, &inputs, extras).expect("complete");
        let mut image = [0_u8; 9];
        let written = DriveOutputs {
            probe_function: 0x11,
            ..DriveOutputs::default()
        };
        layout.write(&written, &mut image);
        assert_eq!(image, [0, 0, 0, 0, 0, 0, 0, 0x11, 0]);
        // 6041h, 6061h, 6064h, 603Fh, 60FDh, 6077h are 15 bytes.
        let mut image = [0_u8; 25];
        image[15..].copy_from_slice(&[0xFD, 0xFF, 0xFF, 0xFF, 3, 0, 0, 0, 1, 0]);
        let read = layout.read(&image);
        assert_eq!(
            (read.following_error, read.probe_status, read.probe_position),
            (Some(-3), 3, 0x1_0000)
        );
        // The latch of the zero impulse in addition: 60BCh follows 60BAh, and must be present.
        let both = Extras {
            index_probe: Some(ProbeNumber::Two),
            ..extras
        };
        assert_eq!(wanted_outputs(both), outputs);
        let layout = PdoLayout::new(&outputs, &wanted_inputs(both), both).expect("complete");
        let mut image = [0_u8; 29];
        image[25..].copy_from_slice(&[7, 0, 0, 0x80]);
        assert_eq!(layout.read(&image).index_position, i32::MIN + 7);
        assert_eq!(
            PdoLayout::new(&outputs, &inputs, both),
            Err(PdoError::Missing { index: 0x60BC })
        );
        let alone = Extras {
            index_probe: Some(ProbeNumber::One),
            ..Extras::default()
        };
        assert_eq!(wanted_inputs(alone)[6..], [PROBE_STATUS, PROBE_POSITION]);
        assert_eq!(
            PdoLayout::new(&wanted_outputs(VELOCITY), &wanted_inputs(alone), alone),
            Err(PdoError::Missing { index: 0x60B8 })
        );
        let without = PdoLayout::new(&outputs, &wanted_inputs(VELOCITY), extras);
        assert_eq!(without, Err(PdoError::Missing { index: 0x60F4 }));
    }

    /// Physical outputs are mapped where they are requested. Where the drive's own mapping has them, or the
    /// mask, they keep what the drive had, because zero would switch its other outputs off.
    #[test]
    fn digital_outputs_keep_the_bits_of_the_drive() {
        let extras = Extras {
            digital_outputs: true,
            ..Extras::default()
        };
        assert_eq!(
            wanted_outputs(extras).last().map(|last| last.number()),
            Some(0x60FE_0120)
        );
        let inputs = wanted_inputs(extras);
        let missing = PdoLayout::new(&wanted_outputs(VELOCITY), &inputs, extras);
        assert_eq!(missing, Err(PdoError::Missing { index: 0x60FE }));
        let mut own = wanted_outputs(Extras::default());
        let layout = PdoLayout::new(&own, &inputs, Extras::default()).expect("complete");
        assert!(!layout.writes_digital_outputs());
        own.extend([OUTPUT_MASK, PHYSICAL_OUTPUTS]);
        for extras in [extras, Extras::default()] {
            let mut layout = PdoLayout::new(&own, &inputs, extras).expect("complete");
            // 6040h, 6060h and 607Ah are 7 bytes, the mask 4.
            assert_eq!(layout.physical_outputs_at(), Some(88));
            assert!(layout.writes_digital_outputs());
            layout.hold_outputs(HeldOutputs {
                physical: 0x0002_0001,
                mask: 0x0003_0000,
            });
            let mut image = [0_u8; 15];
            layout.write(&DriveOutputs::default(), &mut image);
            assert_eq!(image[7..], [0, 0, 3, 0, 1, 0, 2, 0]);
        }
    }

    #[test]
    fn objects_after_gaps_are_found_missing_ones_named() {
        let gap = Mapped::from_number(0x0000_0008);
        let mut outputs = vec![gap];
        outputs.extend(wanted_outputs(VELOCITY));
        let layout = PdoLayout::new(&outputs, &wanted_inputs(VELOCITY), VELOCITY).expect("complete");
        let mut image = [0_u8; 12];
        let written = DriveOutputs {
            control_word: 0x0F,
            mode: 8,
            target: -2,
            velocity_offset: 7,
            torque_offset: 9,
            ..DriveOutputs::default()
        };
        layout.write(&written, &mut image);
        assert_eq!(image, [0, 0x0F, 0, 8, 0xFE, 0xFF, 0xFF, 0xFF, 7, 0, 0, 0]);
        assert_eq!(
            PdoLayout::new(
                &outputs,
                &wanted_inputs(VELOCITY),
                Extras {
                    torque_offset: true,
                    ..VELOCITY
                }
            ),
            Err(PdoError::Missing { index: 0x60B2 })
        );
        outputs[0].bits = 3;
        assert!(matches!(
            PdoLayout::new(&outputs, &wanted_inputs(VELOCITY), Extras::default()),
            Err(PdoError::Unaligned { index: 0x6040, .. })
        ));
    }
}
