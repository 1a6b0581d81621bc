//! The status of the bus, for pages.

use evolvent_wire::{ACTIVITIES, AXES, JOB_RESULTS, MACHINE_STATES, MODES, STATES, Status};
use serde::Serialize;
use ts_rs::TS;

use super::SpindleStatus;

/// Names and numbers of `tool_change` in Status.
const TOOL_CHANGES: [(&str, u32); 3] = [("NONE", 0), ("OPERATOR", 1), ("PROGRAM", 2)];

/// The status by the names, units and meanings that its fields have on the bus; lists of axes are in the
/// order XYZABCUVW.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct ScreenStatus {
    /// A name of the list of the bus.
    #[ts(type = "'estop' | 'off' | 'on'")]
    pub machine_state: String,
    /// A name of the list of the bus.
    #[ts(type = "'auto' | 'manual' | 'mdi'")]
    pub mode: String,
    /// A name of the list of the bus.
    #[ts(type = "'none' | 'program' | 'mdi' | 'jog' | 'homing'")]
    pub activity: String,
    /// A name of the list of the bus.
    #[ts(
        type = "'idle' | 'running' | 'holding' | 'held' | 'stopping' | 'stopped' | 'dwell' | 'program_stop' \
                | 'fault' | 'done'"
    )]
    pub state: String,
    /// A name of the list of the bus.
    #[ts(type = "'none' | 'done' | 'stopped' | 'failed' | 'fault'")]
    pub job_result: String,
    /// A name of the list of the bus.
    #[ts(type = "'none' | 'operator' | 'program'")]
    pub tool_change: String,
    /// As on the bus.
    #[ts(type = "number")]
    pub time_ns: u64,
    /// As on the bus.
    pub line: u32,
    /// As on the bus.
    #[ts(type = "number")]
    pub job: u64,
    /// As on the bus.
    pub homed_mask: u32,
    /// As on the bus.
    #[ts(type = "number[]")]
    pub position_machine: [f64; AXES],
    /// As on the bus.
    #[ts(type = "number[]")]
    pub position_work: [f64; AXES],
    /// As on the bus.
    #[ts(type = "number[]")]
    pub distance_to_go: [f64; AXES],
    /// As on the bus.
    #[ts(type = "number[]")]
    pub velocity: [f64; AXES],
    /// As on the bus.
    #[ts(type = "number[]")]
    pub work_offset: [f64; AXES],
    /// As on the bus.
    #[ts(type = "number[]")]
    pub tool_offset: [f64; AXES],
    /// As on the bus.
    #[ts(type = "number[]")]
    pub position_actual: [f64; AXES],
    /// As on the bus.
    #[ts(type = "number[]")]
    pub following_error: [f64; AXES],
    /// As on the bus.
    #[ts(type = "number")]
    pub feedback_age_ns: u64,
    /// As on the bus.
    pub feed_mm_s: f64,
    /// As on the bus.
    pub feed_programmed_mm_s: f64,
    /// As on the bus.
    pub override_ratio: f64,
    /// As on the bus.
    pub rapid_override_ratio: f64,
    /// As on the bus.
    pub spindle_override_ratio: f64,
    /// As on the bus.
    pub spindle_rpm: f64,
    /// The spindles of the machine, the lowest number first.
    pub spindles: Vec<SpindleStatus>,
    /// As on the bus.
    pub coolant: u32,
    /// As on the bus.
    pub tool: u32,
    /// As on the bus.
    pub tool_wanted: u32,
    /// As on the bus.
    pub work_system: u32,
    /// As on the bus.
    pub switches: u32,
    /// As on the bus.
    pub path_mm: f64,
    /// As on the bus.
    pub path_to_go_mm: f64,
    /// As on the bus.
    #[ts(type = "number")]
    pub late_cycles: u64,
    /// As on the bus.
    #[ts(type = "number")]
    pub wake_lateness_ns: u64,
    /// As on the bus.
    pub longest_stop_mm: f64,
    /// As on the bus.
    pub longest_stop_s: f64,
    /// As on the bus.
    pub away_mask: u32,
    /// As on the bus.
    pub away_parts: u32,
    /// As on the bus.
    pub retraced: u32,
    /// As on the bus.
    pub retrace_blocks: u32,
    /// As on the bus.
    pub parts: u32,
    /// As on the bus.
    pub program_time_s: f64,
    /// As on the bus.
    pub program_held_s: f64,
    /// As on the bus.
    pub handwheel_mask: u32,
    /// As on the bus.
    pub handwheel_enabled: u32,
    /// As on the bus.
    pub handwheel_step: f64,
    /// Modal G codes times ten.
    pub modal: Vec<u32>,
    /// Numbers of the alarms in force: their cause first, then the others, the oldest first.
    pub alarms: Vec<u32>,
    /// Name of the loaded program.
    pub program: String,
    /// Sentence of the first of `alarms`.
    pub alarm_text: String,
    /// The program's last message to the operator.
    pub message: String,
}

fn name_of(list: &[(&str, u32)], number: u32) -> String {
    let found = list.iter().find(|(_, known)| *known == number);
    found.map_or_else(|| number.to_string(), |(name, _)| name.to_ascii_lowercase())
}

impl From<&Status> for ScreenStatus {
    fn from(status: &Status) -> Self {
        Self {
            machine_state: name_of(&MACHINE_STATES, status.machine_state),
            mode: name_of(&MODES, status.mode),
            activity: name_of(&ACTIVITIES, status.activity),
            state: name_of(&STATES, status.state),
            job_result: name_of(&JOB_RESULTS, status.job_result),
            tool_change: name_of(&TOOL_CHANGES, status.tool_change),
            time_ns: status.time_ns,
            line: status.line,
            job: status.job,
            homed_mask: status.homed_mask,
            position_machine: status.position_machine,
            position_work: status.position_work,
            distance_to_go: status.distance_to_go,
            velocity: status.velocity,
            work_offset: status.work_offset,
            tool_offset: status.tool_offset,
            position_actual: status.position_actual,
            following_error: status.following_error,
            feedback_age_ns: status.feedback_age_ns,
            feed_mm_s: status.feed_mm_s,
            feed_programmed_mm_s: status.feed_programmed_mm_s,
            override_ratio: status.override_ratio,
            rapid_override_ratio: status.rapid_override_ratio,
            spindle_override_ratio: status.spindle_override_ratio,
            spindle_rpm: status.spindle_rpm,
            spindles: status.spindles().map(SpindleStatus::from).collect(),
            coolant: status.coolant,
            tool: status.tool,
            tool_wanted: status.tool_wanted,
            work_system: status.work_system,
            switches: status.switches,
            path_mm: status.path_mm,
            path_to_go_mm: status.path_to_go_mm,
            late_cycles: status.late_cycles,
            wake_lateness_ns: status.wake_lateness_ns,
            longest_stop_mm: status.longest_stop_mm,
            longest_stop_s: status.longest_stop_s,
            away_mask: status.away_mask,
            away_parts: status.away_parts,
            retraced: status.retraced,
            retrace_blocks: status.retrace_blocks,
            parts: status.parts,
            program_time_s: status.program_time_s,
            program_held_s: status.program_held_s,
            handwheel_mask: status.handwheel_mask,
            handwheel_enabled: status.handwheel_enabled,
            handwheel_step: status.handwheel_step,
            modal: status.modal.iter().copied().filter(|&code| code != 0).collect(),
            alarms: status.listed_alarms().to_vec(),
            program: status.program_name().to_owned(),
            alarm_text: status.alarm_sentence().to_owned(),
            message: status.operator_message().to_owned(),
        }
    }
}
