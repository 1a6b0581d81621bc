//! Many cycles in one message, column by column: channel `/cycles`.
//!
//! One message per cycle with plain numbers is readable for every reader, but large. If size matters,
//! `/cycles` has all cycles, to the last bit, in about a tenth of the size, and `/cycle` has only every n-th
//! cycle, for viewers. Only jerk is rounded, to a single: it is not published, steps at every knot of the
//! plan, and took half of the size.

use crate::column::{Derivatives, Kind, PackedRef, pack, unpack};
use crate::record::CycleRecord;
use crate::schema::{evolvent, timestamp};

/// A batch is written when it has this many cycles.
pub(crate) const MAX_CYCLES: usize = 2048;
/// A batch that claims to have more is damaged.
const READ_CYCLES: u32 = 1 << 16;

/// A quantity of [`CycleRecord`], by the number of its field in the message `Cycle`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Quantity {
    Lateness = 4,
    Work = 5,
    Path = 6,
    Feed = 7,
    Position = 8,
    Velocity = 9,
    Acceleration = 10,
    Jerk = 11,
    Line = 12,
    State = 13,
    Flags = 14,
    Override = 15,
    Load = 16,
    Inputs = 17,
    FollowingError = 18,
    DrivePosition = 19,
}

/// In the order of writing: derivatives before the quantities that they predict.
const ORDER: [Quantity; 16] = [
    Quantity::Jerk,
    Quantity::Acceleration,
    Quantity::Velocity,
    Quantity::Position,
    Quantity::Lateness,
    Quantity::Work,
    Quantity::Path,
    Quantity::Feed,
    Quantity::Line,
    Quantity::State,
    Quantity::Flags,
    Quantity::Override,
    Quantity::Load,
    Quantity::Inputs,
    Quantity::FollowingError,
    Quantity::DrivePosition,
];

impl Quantity {
    const fn kind(self) -> Kind {
        match self {
            Self::Lateness | Self::Work | Self::Line | Self::State | Self::Flags | Self::Inputs => {
                Kind::Whole
            }
            Self::Jerk => Kind::Single,
            _ => Kind::Double,
        }
    }

    const fn is_per_axis(self) -> bool {
        matches!(
            self,
            Self::Position
                | Self::Velocity
                | Self::Acceleration
                | Self::Jerk
                | Self::FollowingError
                | Self::DrivePosition
        )
    }

    /// The value of an omitted column.
    const fn absent(self) -> u64 {
        match self {
            Self::Load | Self::FollowingError | Self::DrivePosition => f64::NAN.to_bits(),
            _ => 0,
        }
    }

    fn get(self, record: &CycleRecord, axis: usize) -> u64 {
        match self {
            Self::Lateness => record.wake_lateness_ns as u64,
            Self::Work => u64::from(record.work_ns),
            Self::Path => record.path_mm.to_bits(),
            Self::Feed => record.feed_mm_s.to_bits(),
            Self::Position => record.position[axis].to_bits(),
            Self::Velocity => record.velocity[axis].to_bits(),
            Self::Acceleration => record.acceleration[axis].to_bits(),
            Self::Jerk => f64::from(record.jerk[axis] as f32).to_bits(),
            Self::Line => u64::from(record.line),
            Self::State => u64::from(record.state),
            Self::Flags => u64::from(record.flags),
            Self::Override => record.override_.to_bits(),
            Self::Load => record.load.to_bits(),
            Self::Inputs => u64::from(record.inputs),
            Self::FollowingError => record.following_error[axis].to_bits(),
            Self::DrivePosition => record.drive_position[axis].to_bits(),
        }
    }

    /// Sets all cycles at once. `None` if a number does not fit.
    fn set_all(self, records: &mut [CycleRecord], axis: usize, values: &[u64]) -> Option<()> {
        let pairs = records.iter_mut().zip(values);
        match self {
            // The most frequent quantities first, without a test per cycle.
            Self::Position => {
                pairs.for_each(|(record, &value)| record.position[axis] = f64::from_bits(value));
            }
            Self::Velocity => {
                pairs.for_each(|(record, &value)| record.velocity[axis] = f64::from_bits(value));
            }
            Self::Acceleration => {
                pairs.for_each(|(record, &value)| record.acceleration[axis] = f64::from_bits(value));
            }
            Self::Jerk => pairs.for_each(|(record, &value)| record.jerk[axis] = f64::from_bits(value)),
            other => {
                for (record, &value) in pairs {
                    other.set(record, axis, value)?;
                }
            }
        }
        Some(())
    }

    /// `None` if the number does not fit.
    fn set(self, record: &mut CycleRecord, axis: usize, value: u64) -> Option<()> {
        match self {
            Self::Lateness => record.wake_lateness_ns = value as i64,
            Self::Work => record.work_ns = u32::try_from(value).ok()?,
            Self::Path => record.path_mm = f64::from_bits(value),
            Self::Feed => record.feed_mm_s = f64::from_bits(value),
            Self::Position => record.position[axis] = f64::from_bits(value),
            Self::Velocity => record.velocity[axis] = f64::from_bits(value),
            Self::Acceleration => record.acceleration[axis] = f64::from_bits(value),
            Self::Jerk => record.jerk[axis] = f64::from_bits(value),
            Self::Line => record.line = u32::try_from(value).ok()?,
            Self::State => record.state = u8::try_from(value).ok()?,
            Self::Flags => record.flags = u32::try_from(value).ok()?,
            Self::Override => record.override_ = f64::from_bits(value),
            Self::Load => record.load = f64::from_bits(value),
            Self::Inputs => record.inputs = u32::try_from(value).ok()?,
            Self::FollowingError => record.following_error[axis] = f64::from_bits(value),
            Self::DrivePosition => record.drive_position[axis] = f64::from_bits(value),
        }
        Some(())
    }
}

/// Columns of one axis, by quantity: jerk, acceleration, velocity.
#[derive(Debug, Default)]
struct Known {
    jerk: Vec<u64>,
    acceleration: Vec<u64>,
    velocity: Vec<u64>,
}

impl Known {
    /// Stores a column that predicts others.
    fn keep(&mut self, quantity: Quantity, column: &mut Vec<u64>) {
        match quantity {
            Quantity::Jerk => std::mem::swap(&mut self.jerk, column),
            Quantity::Acceleration => std::mem::swap(&mut self.acceleration, column),
            Quantity::Velocity => std::mem::swap(&mut self.velocity, column),
            _ => {}
        }
    }

    fn of(&self, quantity: Quantity, step_s: f64) -> Option<Derivatives<'_>> {
        let (first, second) = match quantity {
            Quantity::Acceleration => (&self.jerk, None),
            Quantity::Velocity => (&self.acceleration, Some(self.jerk.as_slice())),
            Quantity::Position => (&self.velocity, Some(self.acceleration.as_slice())),
            _ => return None,
        };
        Some(Derivatives {
            first,
            second,
            step_s,
        })
    }
}

/// Gathers consecutive cycles.
#[derive(Debug)]
pub(crate) struct Batch {
    records: Vec<CycleRecord>,
    axes: Vec<u8>,
    period_ns: u64,
}

impl Batch {
    pub(crate) fn new(axes: Vec<u8>, period_ns: u64) -> Self {
        Self {
            records: Vec::with_capacity(MAX_CYCLES),
            axes,
            period_ns,
        }
    }

    /// Whether the batch has to be written before this cycle can be added.
    pub(crate) fn must_go_before(&self, record: &CycleRecord) -> bool {
        let Some(last) = self.records.last() else {
            return false;
        };
        self.records.len() >= MAX_CYCLES
            || last.sequence.checked_add(1) != Some(record.sequence)
            || last.due_time_ns.checked_add(self.period_ns) != Some(record.due_time_ns)
    }

    pub(crate) fn push(&mut self, record: &CycleRecord) {
        self.records.push(*record);
    }

    /// Packs the gathered cycles and starts an empty batch.
    pub(crate) fn take(&mut self) -> Option<evolvent::Cycles> {
        let first = *self.records.first()?;
        let step_s = self.period_ns as f64 * 1e-9;
        let mut columns = Vec::new();
        let mut known: Vec<Known> = self.axes.iter().map(|_| Known::default()).collect();
        let mut values = Vec::with_capacity(self.records.len());
        for quantity in ORDER {
            let elements = if quantity.is_per_axis() {
                self.axes.len()
            } else {
                1
            };
            for element in 0..elements {
                let axis = usize::from(self.axes[element]);
                values.clear();
                values.extend(self.records.iter().map(|record| quantity.get(record, axis)));
                if values.iter().any(|&value| value != quantity.absent()) {
                    let derivatives = known[element].of(quantity, step_s);
                    let packed = pack(quantity.kind(), &values, derivatives.as_ref());
                    columns.push(evolvent::Column {
                        field: quantity as u32,
                        element: element as u32,
                        predictor: packed.predictor,
                        coded: packed.coded,
                        rests: packed.rests,
                    });
                }
                known[element].keep(quantity, &mut values);
            }
        }
        let count = self.records.len() as u32;
        self.records.clear();
        Some(evolvent::Cycles {
            timestamp: Some(timestamp(first.due_time_ns)),
            start_sequence: first.sequence,
            count,
            due_time_ns: first.due_time_ns,
            period_ns: self.period_ns,
            column: columns,
        })
    }
}

/// The cycles of a batch; `axes` are the indices of the axes that it carries. `None` if it is invalid.
pub(crate) fn cycles(message: &evolvent::Cycles, axes: &[usize]) -> Option<Vec<CycleRecord>> {
    if message.count > READ_CYCLES {
        return None;
    }
    let count = message.count as usize;
    let last = u64::from(message.count.saturating_sub(1));
    message.start_sequence.checked_add(last)?;
    message
        .due_time_ns
        .checked_add(last.checked_mul(message.period_ns)?)?;
    let mut records: Vec<CycleRecord> = (0..u64::from(message.count))
        .map(|n| CycleRecord {
            sequence: message.start_sequence + n,
            due_time_ns: message.due_time_ns + n * message.period_ns,
            override_: 0.0,
            ..CycleRecord::default()
        })
        .collect();
    let step_s = message.period_ns as f64 * 1e-9;
    let zeros = || vec![0; count];
    let mut known: Vec<Known> = axes
        .iter()
        .map(|_| Known {
            jerk: zeros(),
            acceleration: zeros(),
            velocity: zeros(),
        })
        .collect();
    let mut values = zeros();
    for column in &message.column {
        // Quantities of a later version are skipped.
        let Some(quantity) = ORDER.into_iter().find(|known| *known as u32 == column.field) else {
            continue;
        };
        let element = column.element as usize;
        let elements = if quantity.is_per_axis() { axes.len() } else { 1 };
        if element >= elements {
            return None;
        }
        let packed = PackedRef {
            predictor: column.predictor,
            coded: column.coded,
            rests: &column.rests,
        };
        let derivatives = known.get(element).and_then(|known| known.of(quantity, step_s));
        unpack(quantity.kind(), &packed, count, derivatives.as_ref(), &mut values)?;
        let axis = axes.get(element).copied().unwrap_or(0);
        quantity.set_all(&mut records, axis, &values)?;
        if let Some(known) = known.get_mut(element) {
            known.keep(quantity, &mut values);
        }
    }
    Some(records)
}
