//! Comparison of a recorded cycle with the recomputed setpoint.

use evolvent_motion::Setpoint;
use evolvent_path::{AxisLetter, Jet};
use evolvent_trace::CycleRecord;

use super::{Difference, Verified, text_of};

/// LATE refers to the time of publication, not to the position.
const TIMING_FLAGS: u32 = 1;

pub(super) struct Comparing {
    pub(super) axes: Vec<AxisLetter>,
    pub(super) period_s: f64,
    /// Columns store jerk in single precision.
    pub(super) columns: bool,
}

impl Comparing {
    /// Compares; returns whether they are equal.
    pub(super) fn compare(
        &self,
        record: &CycleRecord,
        setpoint: &Setpoint,
        corrected: Option<&Jet>,
        verified: &mut Verified,
        lines: &[String],
    ) -> bool {
        verified.compared += 1;
        let differs = self.differs(record, setpoint);
        let differs = differs.or_else(|| self.differs_for_drives(record, corrected?));
        let Some((quantity, recorded, recomputed)) = differs else {
            return true;
        };
        verified.differing += 1;
        for axis in &self.axes {
            let i = axis.index();
            let sent = corrected.map_or(0.0, |jet| (record.drive_position[i] - jet.position[i]).abs());
            // NaN if the trace has no value.
            let off = (record.position[i] - setpoint.position[i]).abs().max(sent);
            if off > verified.greatest_difference {
                verified.greatest_difference = off;
            }
        }
        if verified.first_difference.is_none() {
            verified.first_difference = Some(Difference {
                sequence: record.sequence,
                time_s: record.sequence as f64 * self.period_s,
                line: record.line,
                text: text_of(lines, record.line),
                quantity,
                recorded,
                recomputed,
            });
        }
        false
    }

    /// Whether the drives received another setpoint.
    pub(super) fn is_corrected(&self, record: &CycleRecord) -> bool {
        self.axes
            .iter()
            .any(|axis| !record.drive_position[axis.index()].is_nan())
    }

    /// The corrected setpoint, if it differs.
    fn differs_for_drives(&self, record: &CycleRecord, corrected: &Jet) -> Option<(String, f64, f64)> {
        self.axes.iter().find_map(|axis| {
            let (recorded, computed) = (
                record.drive_position[axis.index()],
                corrected.position[axis.index()],
            );
            (recorded.to_bits() != computed.to_bits())
                .then(|| (format!("drive position {}", axis.letter()), recorded, computed))
        })
    }

    fn differs(&self, record: &CycleRecord, setpoint: &Setpoint) -> Option<(String, f64, f64)> {
        if record.sequence != setpoint.sequence {
            return Some((
                "sequence".to_owned(),
                record.sequence as f64,
                setpoint.sequence as f64,
            ));
        }
        let per_axis = [
            ("position", &record.position, &setpoint.position),
            ("velocity", &record.velocity, &setpoint.velocity),
            ("acceleration", &record.acceleration, &setpoint.acceleration),
            ("jerk", &record.jerk, &setpoint.jerk),
        ];
        for (name, recorded, computed) in per_axis {
            for axis in &self.axes {
                let i = axis.index();
                let computed_i = if self.columns && name == "jerk" {
                    f64::from(computed[i] as f32)
                } else {
                    computed[i]
                };
                if recorded[i].to_bits() != computed_i.to_bits() {
                    return Some((format!("{name} {}", axis.letter()), recorded[i], computed[i]));
                }
            }
        }
        let doubles = [
            ("path_mm", record.path_mm, setpoint.path_mm),
            ("feed_mm_s", record.feed_mm_s, setpoint.feed_mm_s),
            ("override", record.override_, setpoint.feed_override),
        ];
        for (name, recorded, computed) in doubles {
            if recorded.to_bits() != computed.to_bits() {
                return Some((name.to_owned(), recorded, computed));
            }
        }
        let wholes = [
            ("line", record.line, setpoint.line),
            ("state", u32::from(record.state), setpoint.state as u32),
            (
                "flags",
                record.flags & !TIMING_FLAGS,
                setpoint.flags & !TIMING_FLAGS,
            ),
        ];
        wholes
            .into_iter()
            .find(|(_, recorded, computed)| recorded != computed)
            .map(|(name, recorded, computed)| (name.to_owned(), f64::from(recorded), f64::from(computed)))
    }
}
