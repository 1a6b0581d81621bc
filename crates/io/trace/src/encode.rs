//! `/cycle` as protobuf, encoded by hand: this message is written every cycle, directly into the chunk.
//!
//! The wire format (<https://protobuf.dev/programming-guides/encoding/>): a tag, field number × 8 + wire
//! type, then a varint (0), eight bytes (1) or a length and bytes (2). A plain field that is zero is omitted.
//! The test compares it with `prost`, field by field.

use prost::encoding::encode_varint;

use crate::bits::folded;
use crate::record::CycleRecord;

const VARINT: u8 = 0;
const FIXED64: u8 = 1;
const BYTES: u8 = 2;

fn put_number(out: &mut Vec<u8>, field: u8, value: u64) {
    if value != 0 {
        out.push(field << 3 | VARINT);
        encode_varint(value, out);
    }
}

fn put_double(out: &mut Vec<u8>, field: u8, value: f64) {
    // Negative zero is not omitted: the bits must survive.
    if value.to_bits() != 0 {
        out.push(field << 3 | FIXED64);
        out.extend_from_slice(&value.to_le_bytes());
    }
}

fn put_axes(out: &mut Vec<u8>, field: u8, values: &[f64], axes: &[u8]) {
    out.push(field << 3 | BYTES);
    encode_varint(axes.len() as u64 * 8, out);
    for &axis in axes {
        out.extend_from_slice(&values[usize::from(axis)].to_le_bytes());
    }
}

/// Appends the message. `axes` are indices below nine, at least one.
pub(crate) fn put_cycle(out: &mut Vec<u8>, record: &CycleRecord, axes: &[u8]) {
    // 1: the timestamp, itself a message of two varints.
    let length_at = out.len() + 1;
    out.extend_from_slice(&[1 << 3 | BYTES, 0]);
    put_number(out, 1, record.due_time_ns / 1_000_000_000);
    put_number(out, 2, record.due_time_ns % 1_000_000_000);
    out[length_at] = (out.len() - length_at - 1) as u8;

    put_number(out, 2, record.sequence);
    if record.due_time_ns != 0 {
        // Eight plain bytes, not a varint: the compressor finds them again in the message's head.
        out.push(3 << 3 | FIXED64);
        out.extend_from_slice(&record.due_time_ns.to_le_bytes());
    }
    // sint64: the sign goes into the lowest bit.
    put_number(out, 4, folded(record.wake_lateness_ns));
    put_number(out, 5, u64::from(record.work_ns));
    put_double(out, 6, record.path_mm);
    put_double(out, 7, record.feed_mm_s);
    put_axes(out, 8, &record.position, axes);
    put_axes(out, 9, &record.velocity, axes);
    put_axes(out, 10, &record.acceleration, axes);
    put_axes(out, 11, &record.jerk, axes);
    put_number(out, 12, u64::from(record.line));
    put_number(out, 13, u64::from(record.state));
    put_number(out, 14, u64::from(record.flags));
    put_double(out, 15, record.override_);
    if !record.load.is_nan() {
        // 16 needs a tag of two bytes. Explicitly optional, so a zero is written too.
        out.extend_from_slice(&[0x80 | FIXED64, 1]);
        out.extend_from_slice(&record.load.to_le_bytes());
    }
    if record.inputs != 0 {
        out.extend_from_slice(&[0x88 | VARINT, 1]);
        encode_varint(u64::from(record.inputs), out);
    }
    put_known_axes(out, 18, &record.following_error, axes);
    put_known_axes(out, 19, &record.drive_position, axes);
}

/// Appends a list, which is omitted if it is NaN on every axis; `field` needs a tag of two bytes.
fn put_known_axes(out: &mut Vec<u8>, field: u32, values: &[f64], axes: &[u8]) {
    if axes.iter().all(|&axis| values[usize::from(axis)].is_nan()) {
        return;
    }
    encode_varint(u64::from(field << 3 | u32::from(BYTES)), out);
    encode_varint(axes.len() as u64 * 8, out);
    for &axis in axes {
        out.extend_from_slice(&values[usize::from(axis)].to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;
    use crate::schema::{evolvent, timestamp};

    /// The encoding of the same record by `prost`.
    fn by_prost(record: &CycleRecord, axes: &[u8]) -> Vec<u8> {
        let pick = |values: &[f64; 9]| {
            axes.iter()
                .map(|&axis| values[usize::from(axis)])
                .collect::<Vec<_>>()
        };
        let known = |values: &[f64; 9]| {
            let values = pick(values);
            if values.iter().all(|value| value.is_nan()) {
                Vec::new()
            } else {
                values
            }
        };
        evolvent::Cycle {
            timestamp: Some(timestamp(record.due_time_ns)),
            sequence: record.sequence,
            due_time_ns: record.due_time_ns,
            wake_lateness_ns: record.wake_lateness_ns,
            work_ns: record.work_ns,
            path_mm: record.path_mm,
            feed_mm_s: record.feed_mm_s,
            position: pick(&record.position),
            velocity: pick(&record.velocity),
            acceleration: pick(&record.acceleration),
            jerk: pick(&record.jerk),
            line: record.line,
            state: i32::from(record.state),
            flags: record.flags,
            r#override: record.override_,
            load: (!record.load.is_nan()).then_some(record.load),
            inputs: record.inputs,
            following_error: known(&record.following_error),
            drive_position: known(&record.drive_position),
        }
        .encode_to_vec()
    }

    #[test]
    fn hand_written_bytes_are_those_of_prost() {
        let seed = 0x9e37_79b9_7f4a_7c15_u64;
        println!("seed {seed:#x}");
        let mut generator = evolvent_random::Random::from_state(seed);
        let mut random = move || generator.bits();
        for round in 0..20_000 {
            // Shifts give numbers of every length, and sometimes zero.
            let mut number = || {
                if random() % 8 == 0 {
                    0
                } else {
                    random() >> (random() % 64)
                }
            };
            let mut double = {
                let bits = [number(), number(), number(), number()];
                let mut at = 0;
                move || {
                    at += 1;
                    f64::from_bits(bits[at % 4].rotate_left(at as u32 * 7))
                }
            };
            let mut nine = || std::array::from_fn::<f64, 9, _>(|_| double());
            let arrays = [nine(), nine(), nine(), nine()];
            let record = CycleRecord {
                sequence: number(),
                due_time_ns: number(),
                wake_lateness_ns: number() as i64,
                work_ns: number() as u32,
                path_mm: f64::from_bits(number()),
                feed_mm_s: f64::from_bits(number()),
                position: arrays[0],
                velocity: arrays[1],
                acceleration: arrays[2],
                jerk: arrays[3],
                line: number() as u32,
                state: number() as u8,
                flags: number() as u32,
                // prost omits a negative zero, which would lose its sign.
                override_: f64::from_bits(number() | 1),
                load: if round % 3 == 0 {
                    f64::NAN
                } else {
                    f64::from_bits(number())
                },
                inputs: number() as u32,
                following_error: if round % 4 == 0 { arrays[1] } else { [f64::NAN; 9] },
                drive_position: if round % 5 == 0 { arrays[2] } else { [f64::NAN; 9] },
            };
            let axes: Vec<u8> = (0..9).filter(|axis| round >> axis & 1 == 1).chain([3]).collect();
            let mut bytes = Vec::new();
            put_cycle(&mut bytes, &record, &axes);
            assert_eq!(bytes, by_prost(&record, &axes), "round {round}: {record:?}");
        }
    }
}
