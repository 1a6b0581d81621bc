//! The status: all that a screen needs, of one moment.

use crate::layout::{AXES, payload};
use iceoryx2::prelude::ZeroCopySend;

/// Number of alarms that a status holds at most.
pub const MAX_ALARMS: usize = 16;

/// Bytes of a text field, filled up with zeros.
pub const TEXT_BYTES: usize = 128;

payload! {
    /// One coherent snapshot of the core. A reader gets the latest, never a mixture of two.
    ///
    /// The publisher sends at least ten a second; a reader that sees no new `sequence` for longer has lost its core.
    pub struct Status = "evolvent.Status.v1" {
        /// Grows by one from one snapshot to the next.
        sequence: u64,
        /// When the snapshot was taken, in ns of CLOCK_MONOTONIC.
        time_ns: u64,
        /// Setpoints computed since the start.
        cycles: u64,
        /// The control period in ns.
        period_ns: u64,
        /// What the core is doing, a number of the list of states.
        state: u32,
        /// Mode: 0 automatic, 1 manual, 2 MDI.
        mode: u32,
        /// Machine: 0 emergency stop, 1 off, 2 on.
        machine_state: u32,
        /// Bits of the last setpoint's flags.
        flags: u32,
        /// Line of the program that is running, counted from 1; 0 where there is none.
        line: u32,
        /// Bit i set: the machine has axis i.
        axes_mask: u32,
        /// Bit i set: axis i has been homed.
        homed_mask: u32,
        /// Selected tool.
        tool: u32,
        /// Selected work coordinate system times ten: 540 is G54, 591 is G59.1.
        work_system: u32,
        /// Subscribers of the setpoint channel.
        setpoint_subscribers: u32,
        /// Position in machine coordinates: mm, degrees for A B C.
        position_machine: [f64; AXES],
        /// Position in work coordinates: mm, degrees for A B C.
        position_work: [f64; AXES],
        /// Way to the end of the running block, per axis: mm, degrees for A B C.
        distance_to_go: [f64; AXES],
        /// Velocity: mm/s, degrees/s for A B C.
        velocity: [f64; AXES],
        /// Work offset in force, G92 included: mm, degrees for A B C.
        work_offset: [f64; AXES],
        /// Tool offset in force: mm, degrees for A B C.
        tool_offset: [f64; AXES],
        /// Way along the path since the start of the run, in mm.
        path_mm: f64,
        /// Way to the end of what is planned, in mm.
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
        /// Spindle speed in revolutions a minute, negative counter-clockwise.
        spindle_rpm: f64,
        /// Setpoints that left after they were due.
        late_cycles: u64,
        /// Trace records lost for want of room.
        dropped_records: u64,
        /// Setpoints that could not be handed to the bus.
        dropped_setpoints: u64,
        /// Lateness of the last wake-up, in ns.
        wake_lateness_ns: u64,
        /// Median lateness of the wake-ups, in ns.
        wake_lateness_p50_ns: u64,
        /// 99.9 % of the wake-ups were at most this late, in ns.
        wake_lateness_p999_ns: u64,
        /// The latest wake-up since the start, in ns.
        wake_lateness_max_ns: u64,
        /// Median time of a cycle's own work, in ns.
        work_p50_ns: u64,
        /// 99.9 % of the cycles worked at most this long, in ns.
        work_p999_ns: u64,
        /// The longest work of a cycle since the start, in ns.
        work_max_ns: u64,
        /// Number of alarms in force; may be more than are listed.
        alarm_count: u32,
        /// Bytes of `program` in use.
        program_length: u32,
        /// Numbers of the alarms in force, the oldest first.
        alarms: [u32; MAX_ALARMS],
        /// Name of the loaded program, UTF-8.
        program: [u8; TEXT_BYTES],
        /// Zero; for later versions.
        reserved: [u64; 16],
    }
}

impl Status {
    /// Writes the program's name, cut to the room there is at a character's border.
    pub fn set_program(&mut self, name: &str) {
        let length = name.floor_char_boundary_at(TEXT_BYTES);
        self.program = [0; TEXT_BYTES];
        self.program[..length].copy_from_slice(&name.as_bytes()[..length]);
        self.program_length = length as u32;
    }

    /// The program's name; empty where there is none or where it is no UTF-8.
    #[must_use]
    pub fn program_name(&self) -> &str {
        let length = (self.program_length as usize).min(TEXT_BYTES);
        core::str::from_utf8(&self.program[..length]).unwrap_or("")
    }

    /// Adds an alarm. Counted even where the list is full.
    pub fn push_alarm(&mut self, number: u32) {
        if let Some(slot) = self.alarms.get_mut(self.alarm_count as usize) {
            *slot = number;
        }
        self.alarm_count = self.alarm_count.saturating_add(1);
    }

    /// The listed alarms, the oldest first.
    #[must_use]
    pub fn listed_alarms(&self) -> &[u32] {
        &self.alarms[..(self.alarm_count as usize).min(MAX_ALARMS)]
    }
}

/// The standard library has it from Rust 1.91 on.
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
