//! The status: everything that a screen shows of one moment.

use crate::layout::{AXES, payload};
use crate::setpoint::Setpoint;

/// Maximum number of alarms in a status.
pub const MAX_ALARMS: usize = 16;

/// Bytes of a text field, padded with zeros.
pub const TEXT_BYTES: usize = 128;

/// Bytes of a sentence, padded with zeros.
pub const SENTENCE_BYTES: usize = 256;

/// Maximum number of modal codes in a status.
pub const MAX_MODAL_CODES: usize = 16;

payload! {
    /// One coherent snapshot of the core. A reader receives the latest, never a mixture of two.
    ///
    /// The publisher sends at least ten per second; a reader that sees no new `sequence` for longer has lost
    /// its core.
    pub struct Status = "evolvent.Status.v1" {
        /// Grows by one per snapshot.
        sequence: u64,
        /// When the snapshot was taken, in ns of CLOCK_MONOTONIC.
        time_ns: u64,
        /// Setpoints computed since the start.
        cycles: u64,
        /// The control period in ns.
        period_ns: u64,
        /// State of the core, a number of the list of states.
        state: u32,
        /// Mode: 0 automatic, 1 manual, 2 MDI.
        mode: u32,
        /// Machine: 0 emergency stop, 1 off, 2 on.
        machine_state: u32,
        /// Bits of the last setpoint's flags.
        flags: u32,
        /// Line of the running program, counted from 1; 0 if none.
        line: u32,
        /// Bit i set: the machine has axis i.
        axes_mask: u32,
        /// Bit i set: axis i has been homed.
        homed_mask: u32,
        /// Tool in the spindle; 0 for none.
        tool: u32,
        /// Selected work coordinate system times ten: 540 is G54, 591 is G59.1.
        work_system: u32,
        /// Subscribers of the setpoint channel.
        setpoint_subscribers: u32,
        /// Position in machine coordinates: mm, degrees for A B C.
        position_machine: [f64; AXES],
        /// Position in work coordinates: mm, degrees for A B C.
        position_work: [f64; AXES],
        /// Distance to the end of the running block, per axis: mm, degrees for A B C.
        distance_to_go: [f64; AXES],
        /// Velocity: mm/s, degrees/s for A B C.
        velocity: [f64; AXES],
        /// Work offset in force, G92 included: mm, degrees for A B C.
        work_offset: [f64; AXES],
        /// Tool offset in force: mm, degrees for A B C.
        tool_offset: [f64; AXES],
        /// Distance along the path since the start of the run, in mm.
        path_mm: f64,
        /// Distance to the end of the planned path, in mm.
        path_to_go_mm: f64,
        /// Speed along the path, in mm/s.
        feed_mm_s: f64,
        /// Programmed speed along the path, in mm/s.
        feed_programmed_mm_s: f64,
        /// Feed override as a ratio: 1 is 100 %.
        override_ratio: f64,
        /// Rapid override as a ratio.
        rapid_override_ratio: f64,
        /// Spindle override as a ratio.
        spindle_override_ratio: f64,
        /// Spindle speed in revolutions per minute, negative counter-clockwise.
        spindle_rpm: f64,
        /// Setpoints that were published after their due time.
        late_cycles: u64,
        /// Trace records lost because the queue was full.
        dropped_records: u64,
        /// Setpoints that could not be passed to the bus.
        dropped_setpoints: u64,
        /// Lateness of the last wake-up, in ns.
        wake_lateness_ns: u64,
        /// Median lateness of the wake-ups, in ns.
        wake_lateness_p50_ns: u64,
        /// 99.9 % of the wake-ups were at most this late, in ns.
        wake_lateness_p999_ns: u64,
        /// Maximum lateness of the wake-ups since the start, in ns.
        wake_lateness_max_ns: u64,
        /// Median time of a cycle's own work, in ns.
        work_p50_ns: u64,
        /// Own work of 99.9 % of the cycles was at most this long, in ns.
        work_p999_ns: u64,
        /// Maximum own work of a cycle since the start, in ns.
        work_max_ns: u64,
        /// Number of alarms in force; may exceed the listed ones.
        alarm_count: u32,
        /// Bytes of `program` in use.
        program_length: u32,
        /// Numbers of the alarms in force: their cause first (the first fault, else the job's, else the first warning), then from the oldest.
        alarms: [u32; MAX_ALARMS],
        /// Name of the loaded program, UTF-8.
        program: [u8; TEXT_BYTES],
        /// What moves the axes, a number of the list of activities.
        activity: u32,
        /// How the last job ended, a number of the list of results.
        job_result: u32,
        /// Number of the job that runs or, at rest, ran last; 0 before the first.
        job: u64,
        /// Bits of the list of switches.
        switches: u32,
        /// Power request to the drives: 0 off, 1 on, 2 quick stop.
        power: u32,
        /// Bit i set: the drive of axis i reports operation enabled.
        enabled_mask: u32,
        /// Bit 0 mist, bit 1 flood.
        coolant: u32,
        /// Modal G codes times ten in no particular order, padded with zeros.
        modal: [u32; MAX_MODAL_CODES],
        /// Position of machine zero in the drives' coordinates, as found by homing: mm, degrees for A B C.
        home_offset: [f64; AXES],
        /// Actual position in machine coordinates, from the bridge: mm, degrees for A B C.
        position_actual: [f64; AXES],
        /// Demanded minus actual position, from the bridge: mm, degrees for A B C.
        following_error: [f64; AXES],
        /// Age of the last feedback, in ns; the largest number if none has arrived.
        feedback_age_ns: u64,
        /// Commands that were accepted.
        commands_accepted: u64,
        /// Commands that were rejected, including stale ones.
        commands_rejected: u64,
        /// Bytes of `alarm_text` in use.
        alarm_text_length: u32,
        /// Bytes of `message` in use.
        message_length: u32,
        /// The sentence of the first of `alarms`: the error and its remedy, UTF-8.
        alarm_text: [u8; SENTENCE_BYTES],
        /// The program's last message to the operator, UTF-8.
        message: [u8; SENTENCE_BYTES],
        /// Tool change that the program waits for: 0 none, 1 by the operator (confirmed by RESUME), 2 by the machine's executable or subroutine.
        tool_change: u32,
        /// If `tool_change` is not 0: the tool to put into the spindle; 0 to empty the spindle.
        tool_wanted: u32,
        /// Longest path that a hold needs to stop at any moment of `job` so far, in mm, with a margin; 0 if unknown.
        longest_stop_mm: f64,
        /// Time of that stop, in s.
        longest_stop_s: f64,
        /// Line of the program at which that hold starts.
        longest_stop_line: u32,
        /// Number of times that the loaded program has reached its end since it was loaded.
        parts: u32,
        /// Running time of the current or last run of the program, in s.
        program_time_s: f64,
        /// Time of it spent in holds and program stops, in s, without waits for a spindle, an input or a user-defined M code.
        program_held_s: f64,
        /// Bit i set: axis i was jogged away from the program that is held.
        away_mask: u32,
        /// Parts of the way back to where the program was left, which `message` tells; 0 where the axes are not away.
        away_parts: u32,
        /// Starts of blocks to which the path of the held program can be driven backwards from here.
        retrace_blocks: u32,
        /// 1 where the axes are, or were before they were jogged, at an earlier place of the path of the held program; else 0.
        retraced: u32,
        /// Bit i set: the handwheel moves axis i; 0 if it moves none.
        handwheel_mask: u32,
        /// 1 where its enabling button is pressed, or where it has none; 0 without a handwheel.
        handwheel_enabled: u32,
        /// Distance of that axis per detent: mm, degrees for A B C; 0 if it moves none.
        handwheel_step: f64,
        /// Bit i set: the machine has spindle i; 0 from cores that tell only `spindle_rpm`.
        spindle_mask: u32,
        /// Bit i set: the program has switched the spindle override off for spindle i (M49, M51 P0).
        spindle_override_off_mask: u32,
        /// Present command of each spindle in revolutions per minute, on its ramp, with its override; negative counter-clockwise.
        spindle_command_rpm: [f32; 4],
        /// Measured speed of each spindle in revolutions per minute, negative counter-clockwise; not a number if none is known.
        spindle_measured_rpm: [f32; 4],
        /// By how much this computer's clock is faster than the drives', as the phase lock has found, in millionths: the mean of a second.
        clock_drift_ppm: f32,
        /// Largest magnitude of the phase error in a second, in ns, at least 1; 0 where the core follows no clock of drives.
        phase_error_max_ns: f32,
    }
}

/// One spindle as a status has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpindleReading {
    /// Its number.
    pub number: u32,
    /// The present command, rpm, negative counter-clockwise.
    pub command_rpm: f64,
    /// The measured speed, rpm, negative counter-clockwise; none if it is not known.
    pub measured_rpm: Option<f64>,
    /// Whether the spindle override counts.
    pub counts_override: bool,
}

impl Status {
    /// Copies the values of a setpoint.
    pub fn follow(&mut self, setpoint: &Setpoint) {
        self.state = setpoint.state;
        self.flags = setpoint.flags;
        self.line = setpoint.line;
        self.position_machine = setpoint.position;
        self.velocity = setpoint.velocity;
        self.path_mm = setpoint.path_mm;
        self.feed_mm_s = setpoint.feed_mm_s;
        self.override_ratio = setpoint.override_ratio;
    }

    /// The spindles of the machine, the lowest number first; of a core that tells only `spindle_rpm`, that one alone.
    pub fn spindles(&self) -> impl Iterator<Item = SpindleReading> + '_ {
        let mask = self.spindle_mask;
        let of_old_core = (mask == 0).then_some(SpindleReading {
            number: 0,
            command_rpm: self.spindle_rpm,
            measured_rpm: None,
            counts_override: true,
        });
        let numbers = (0..self.spindle_command_rpm.len()).filter(move |number| mask >> number & 1 == 1);
        let readings = numbers.map(|number| {
            let measured_rpm = f64::from(self.spindle_measured_rpm[number]);
            SpindleReading {
                number: number as u32,
                command_rpm: f64::from(self.spindle_command_rpm[number]),
                measured_rpm: (!measured_rpm.is_nan()).then_some(measured_rpm),
                counts_override: self.spindle_override_off_mask >> number & 1 == 0,
            }
        });
        of_old_core.into_iter().chain(readings)
    }

    /// Writes the program's name, truncated to the capacity at a character boundary.
    pub fn set_program(&mut self, name: &str) {
        self.program_length = put_text(&mut self.program, name);
    }

    /// The program's name; empty if there is none or if it is not UTF-8.
    #[must_use]
    pub fn program_name(&self) -> &str {
        get_text(&self.program, self.program_length)
    }

    /// Whether a drive reports: without one there is no actual position and no following error.
    #[must_use]
    pub fn has_feedback(&self) -> bool {
        self.feedback_age_ns != u64::MAX
    }

    /// Writes the sentence of the first of `alarms`. One that is too long ends after a word, with "...".
    pub fn set_alarm_text(&mut self, text: &str) {
        self.alarm_text_length = put_sentence(&mut self.alarm_text, text);
    }

    /// The sentence of the first of `alarms`; empty if there is none.
    #[must_use]
    pub fn alarm_sentence(&self) -> &str {
        get_text(&self.alarm_text, self.alarm_text_length)
    }

    /// Writes the message to the operator. One that is too long ends after a word, with "...".
    pub fn set_message(&mut self, text: &str) {
        self.message_length = put_sentence(&mut self.message, text);
    }

    /// The program's last message to the operator; empty if there is none.
    #[must_use]
    pub fn operator_message(&self) -> &str {
        get_text(&self.message, self.message_length)
    }

    /// Adds an alarm. It counts even if the list is full.
    pub fn push_alarm(&mut self, number: u32) {
        if let Some(slot) = self.alarms.get_mut(self.alarm_count as usize) {
            *slot = number;
        }
        self.alarm_count = self.alarm_count.saturating_add(1);
    }

    /// The listed alarms, the cause first and the others in the order in which they came.
    #[must_use]
    pub fn listed_alarms(&self) -> &[u32] {
        &self.alarms[..(self.alarm_count as usize).min(MAX_ALARMS)]
    }
}

/// Writes a text into a field, truncated to the capacity at a character boundary, and returns its length.
pub(crate) fn put_text(field: &mut [u8], text: &str) -> u32 {
    let length = text.floor_char_boundary_at(field.len());
    field.fill(0);
    field[..length].copy_from_slice(&text.as_bytes()[..length]);
    length as u32
}

/// Shows that a sentence goes on.
const CUT: &str = "...";

/// Writes a sentence into a field and returns its length. One that is too long ends after a word, with "...":
/// the beginning of a word can be another word, such as G4 of G49.
pub(crate) fn put_sentence(field: &mut [u8], text: &str) -> u32 {
    if text.len() <= field.len() {
        return put_text(field, text);
    }
    // The character after the last one that fits shows whether a word ends there.
    let room = text.floor_char_boundary_at(field.len().saturating_sub(CUT.len()));
    let seen = text[room..]
        .chars()
        .next()
        .map_or(room, |next| room + next.len_utf8());
    // A single long word, such as a path, is cut.
    let words = text[..seen]
        .rfind(char::is_whitespace)
        .filter(|&end| end > room / 2);
    let words = words.unwrap_or(room);
    let kept = text[..words].trim_end().len();
    let end = kept + CUT.len().min(field.len() - kept);
    field.fill(0);
    field[..kept].copy_from_slice(&text.as_bytes()[..kept]);
    field[kept..end].copy_from_slice(&CUT.as_bytes()[..end - kept]);
    end as u32
}

/// The text in a field; empty if it is not UTF-8.
pub(crate) fn get_text(field: &[u8], length: u32) -> &str {
    let length = (length as usize).min(field.len());
    core::str::from_utf8(&field[..length]).unwrap_or("")
}

/// The standard library has it since Rust 1.91.
trait CharBoundary {
    fn floor_char_boundary_at(&self, limit: usize) -> usize;
}

impl CharBoundary for str {
    fn floor_char_boundary_at(&self, limit: usize) -> usize {
        let mut length = self.len().min(limit);
        while !self.is_char_boundary(length) {
            length -= 1;
        }
        length
    }
}
