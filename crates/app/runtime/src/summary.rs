//! Results of a run, compared with every limit.

use std::collections::BTreeMap;
use std::fmt;

use evolvent_machine::Machine;
use evolvent_motion::{Extremes, MotionState};
use evolvent_trace::Histogram;
use serde::{Serialize, Serializer};

use crate::turning_tally::TurningSummary;

/// Largest magnitudes of one axis and their ratios to the limits.
#[derive(Clone, Debug, Serialize)]
pub struct AxisSummary {
    /// The axis's letter.
    pub axis: char,
    /// From first differences of setpoints: mm/s, or degrees/s.
    pub max_velocity_mm_s: f64,
    /// Ratio to the limit.
    pub velocity_ratio: f64,
    /// From second differences: mm/s2, or degrees/s2.
    pub max_acceleration_mm_s2: f64,
    /// Ratio to the limit.
    pub acceleration_ratio: f64,
    /// From third differences: mm/s3, or degrees/s3.
    pub max_jerk_mm_s3: f64,
    /// Ratio to the limit.
    pub jerk_ratio: f64,
    /// Largest jerk within three cycles of a step of curvature in exact-path mode, where only the joint time
    /// bounds it.
    pub max_jerk_at_joints_mm_s3: f64,
}

/// Times of the loop, ns.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct TimingSummary {
    /// Median.
    pub p50_ns: i64,
    /// 99th percentile.
    pub p99_ns: i64,
    /// 99.9th percentile.
    pub p999_ns: i64,
    /// Maximum.
    pub max_ns: i64,
}

impl TimingSummary {
    pub(crate) fn of(histogram: &Histogram) -> Option<Self> {
        (histogram.count() > 0).then(|| Self {
            p50_ns: histogram.percentile_ns(50.0),
            p99_ns: histogram.percentile_ns(99.0),
            p999_ns: histogram.percentile_ns(99.9),
            max_ns: histogram.max_ns(),
        })
    }
}

/// How a run ended. Its name is the same in JSON, in traces and on the terminal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The program ran to its end.
    Done,
    /// An operator stopped it.
    Stopped,
    /// At an error of the program or of a user-defined M code; the program was run up to there.
    Failed,
    /// The core stopped it because of a fault.
    Fault,
}

impl Outcome {
    /// `done`, `stopped`, `failed` or `fault`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Stopped => "stopped",
            Self::Failed => "failed",
            Self::Fault => "fault",
        }
    }

    /// The outcome for the state of the last setpoint.
    pub(crate) const fn of(state: MotionState) -> Self {
        match state {
            MotionState::Done => Self::Done,
            MotionState::Fault => Self::Fault,
            _ => Self::Stopped,
        }
    }
}

impl Serialize for Outcome {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The summary of a run or of an offline plan; its JSON is part of the contract.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The program.
    pub program: String,
    /// The machine's name.
    pub machine: String,
    /// `realtime` or `virtual`.
    pub clock: &'static str,
    /// How it ended.
    pub outcome: Outcome,
    /// Letters of the axes in the order of the machine file; every list below is in that order.
    pub axes: Vec<char>,
    /// Number of setpoints.
    pub cycles: u64,
    /// The control rate.
    pub rate_hz: f64,
    /// The control period.
    pub period_ns: u64,
    /// Path time.
    pub duration_s: f64,
    /// Planned time of the moves at the programmed feed.
    pub planned_duration_s: f64,
    /// Number of moves in the planned part of the program.
    pub moves: u64,
    /// Programmed path driven.
    pub path_length_mm: f64,
    /// Setpoints published after their due time.
    pub late_cycles: u64,
    /// Maximum number of readers of setpoints and bridges connected at the same time. Late setpoints affect
    /// the exit code only if there was one.
    pub listeners: u64,
    /// Trace records lost because a queue was full.
    pub dropped_records: u64,
    /// Setpoints lost on the way to the bus.
    pub dropped_setpoints: u64,
    /// Cycles that were slower than they could have been because the planner had not finished.
    pub starved_cycles: u64,
    /// Largest distance between the chord of two consecutive setpoints and the curve.
    pub max_chord_error_mm: f64,
    /// The permitted chord error.
    pub permitted_chord_error_mm: f64,
    /// Largest distance between driven and programmed path, due to blends.
    pub max_path_error_mm: f64,
    /// End position of the axes, mm or degrees.
    pub end_position: Vec<f64>,
    /// Largest velocities, mm/s or degrees/s.
    pub max_velocity_mm_s: Vec<f64>,
    /// Largest accelerations, mm/s2 or degrees/s2.
    pub max_acceleration_mm_s2: Vec<f64>,
    /// Largest jerks, mm/s3 or degrees/s3.
    pub max_jerk_mm_s3: Vec<f64>,
    /// Ratios to the limits.
    pub velocity_ratio: Vec<f64>,
    /// Ratios to the limits.
    pub acceleration_ratio: Vec<f64>,
    /// Ratios to the limits.
    pub jerk_ratio: Vec<f64>,
    /// The same figures, one entry per axis.
    pub per_axis: Vec<AxisSummary>,
    /// Lateness of the cycle's wake-ups; `None` with the virtual clock.
    pub wake_lateness: Option<TimingSummary>,
    /// Duration of the cycle's own work; `None` with the virtual clock.
    pub work: Option<TimingSummary>,
    /// Results of load-adaptive turning cycles; `None` if there were none.
    pub turning: Option<TurningSummary>,
    /// The trace file, if one was written.
    pub trace: Option<String>,
    /// Number of the alarm that ended the run early.
    pub alarm: Option<u32>,
    /// What ended the run early, as a sentence.
    pub error: Option<String>,
    /// Notes to the user.
    pub notes: Vec<String>,
}

impl Summary {
    /// Whether data was lost to a reader: setpoints that were late for a connected bridge or client, records,
    /// or setpoints.
    #[must_use]
    pub fn is_lossy(&self) -> bool {
        (self.late_cycles > 0 && self.listeners > 0) || self.dropped_records > 0 || self.dropped_setpoints > 0
    }

    /// The part that is stored in the metadata of the trace.
    pub(crate) fn to_metadata(&self) -> BTreeMap<String, String> {
        let pairs = [
            ("outcome", self.outcome.name().to_owned()),
            ("duration_s", self.duration_s.to_string()),
            ("path_length_mm", self.path_length_mm.to_string()),
            ("late_cycles", self.late_cycles.to_string()),
            ("dropped_records", self.dropped_records.to_string()),
            ("max_chord_error_mm", self.max_chord_error_mm.to_string()),
            ("max_path_error_mm", self.max_path_error_mm.to_string()),
        ];
        let notes = (!self.notes.is_empty()).then(|| ("notes", self.notes.join("\n")));
        let error = self.error.clone().map(|text| ("error", text));
        pairs
            .into_iter()
            .chain(notes)
            .chain(error)
            .map(|(key, value)| (key.to_owned(), value))
            .collect()
    }
}

/// The note about late setpoints while no client was connected.
pub(crate) fn late_for_nobody(late: u64) -> String {
    format!(
        "{late} setpoints were published late, but no bridge or client was connected to miss them; run \
         `evolvent doctor` before drives follow"
    )
}

/// Figures per axis in the order of the machine file.
pub(crate) fn axis_summaries(machine: &Machine, extremes: &Extremes) -> Vec<AxisSummary> {
    machine
        .axes
        .iter()
        .map(|axis| {
            let i = axis.letter.index();
            AxisSummary {
                axis: axis.letter.letter(),
                max_velocity_mm_s: extremes.velocity[i],
                velocity_ratio: extremes.velocity[i] / axis.max_velocity,
                max_acceleration_mm_s2: extremes.acceleration[i],
                acceleration_ratio: extremes.acceleration[i] / axis.max_acceleration,
                max_jerk_mm_s3: extremes.jerk[i],
                jerk_ratio: extremes.jerk[i] / axis.max_jerk,
                max_jerk_at_joints_mm_s3: extremes.jerk_at_joints[i],
            }
        })
        .collect()
}
