//! The records that go into a trace, as plain data.

use evolvent_path::AXES;

/// One control cycle, channel `/cycle`.
///
/// `Copy` and without pointers, so that the cycle passes it through a queue by value. The arrays hold all
/// nine axes, XYZ ABC UVW; the recorder writes those that the machine has, in the order of the machine file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleRecord {
    /// Index of the cycle in the run, from 0.
    pub sequence: u64,
    /// When the setpoint was due, Unix time in ns; the `log_time` of the message.
    pub due_time_ns: u64,
    /// How late the cycle woke up, ns; negative if early.
    pub wake_lateness_ns: i64,
    /// Own work of the cycle, ns.
    pub work_ns: u32,
    /// Length of path travelled since the start of the run, mm.
    pub path_mm: f64,
    /// Speed along the path, mm/s.
    pub feed_mm_s: f64,
    /// Commanded position per axis: mm, degrees for rotary axes.
    pub position: [f64; AXES],
    /// Commanded velocity per axis: mm/s, deg/s.
    pub velocity: [f64; AXES],
    /// Commanded acceleration per axis: mm/s², deg/s².
    pub acceleration: [f64; AXES],
    /// Commanded jerk per axis: mm/s³, deg/s³. Recorded as singles (24 bits).
    pub jerk: [f64; AXES],
    /// Line of the program that the setpoint belongs to, from 1; 0 if none.
    pub line: u32,
    /// State of the cycle: the number on the bus.
    pub state: u8,
    /// Bits as on the bus.
    pub flags: u32,
    /// Feed override in force; 1 is 100 %.
    pub override_: f64,
    /// Cutting load in the unit of its sensor; NaN without a sensor.
    pub load: f64,
    /// Inputs of this cycle: bits of [`inputs`].
    pub inputs: u32,
    /// Commanded minus actual position per axis as last measured, mm, degrees; NaN without feedback.
    pub following_error: [f64; AXES],
    /// Position per axis as sent to the drives, corrected for the errors of the machine, mm, degrees; NaN if
    /// nothing is corrected.
    pub drive_position: [f64; AXES],
}

/// Bits of [`CycleRecord::inputs`]. A run depends only on these, the override, program and machine.
pub mod inputs {
    /// A feed hold was requested.
    pub const HOLD: u32 = 1;
    /// A stop was requested.
    pub const STOP: u32 = 2;
    /// A resume after a program stop was requested.
    pub const RESUME: u32 = 4;
    /// The planner had not finished what the cycle needed: it stood still, or took the tail.
    pub const WAITED: u32 = 8;
    /// The planner had no reply to another override, or none in time, or one that was discarded.
    pub const REFUSED: u32 = 16;
    /// A new reading of the cutting load had arrived: [`load`](super::CycleRecord::load).
    pub const LOAD: u32 = 32;
    /// The load was at the end of its sensor's range.
    pub const LOAD_AT_END: u32 = 64;
    /// Served machine: the setpoint belongs to a job along a plan.
    pub const FOLLOWS: u32 = 128;
    /// Served machine: the setpoint belongs to a jog or to homing.
    pub const STEERS: u32 = 256;
    /// Served machine: at rest, the axes received other coordinates, or were moved without power.
    pub const RELOCATED: u32 = 512;
    /// Served machine: with [`FOLLOWS`] and [`STEERS`], which together mean an excursion from a held program,
    /// its motion was commanded to stop.
    pub const STEERING_STOPS: u32 = 1024;
    /// Run: the program had ended, and the run continued at rest while a spindle slowed down.
    pub const RUNS_ON: u32 = 2048;
    /// Served machine: with [`FOLLOWS`], a fault had set the outputs to their safe values.
    pub const OUTPUTS_SAFE: u32 = 4096;
    /// With [`WAITED`], bits 16 to 23 are the number, within the cycle, of the access to the plan that found
    /// nothing; from 0.
    pub const FAILED_LOOKUP_SHIFT: u32 = 16;
}

impl Default for CycleRecord {
    fn default() -> Self {
        Self {
            sequence: 0,
            due_time_ns: 0,
            wake_lateness_ns: 0,
            work_ns: 0,
            path_mm: 0.0,
            feed_mm_s: 0.0,
            position: [0.0; AXES],
            velocity: [0.0; AXES],
            acceleration: [0.0; AXES],
            jerk: [0.0; AXES],
            line: 0,
            state: 0,
            flags: 0,
            override_: 1.0,
            load: f64::NAN,
            inputs: 0,
            following_error: [f64::NAN; AXES],
            drive_position: [f64::NAN; AXES],
        }
    }
}

/// Kind of an event. The numbers are those of the trace.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum EventKind {
    /// The state changed; the code is the new state's number.
    State = 1,
    /// A fault; the code is its stable number.
    Alarm = 2,
    /// A command that was received.
    Command = 3,
    /// A new feed override; the value is the factor.
    Override = 4,
    /// A feed hold was requested.
    Hold = 5,
    /// Motion was resumed.
    Resume = 6,
    /// The planner had not finished the next part of the path; the machine was slower than possible.
    Starvation = 7,
    /// Setpoints were late.
    Late = 8,
    /// Records were lost because their queue was full; the value is their number.
    Loss = 9,
    /// A message of the program, `(MSG,...)`.
    Message = 10,
    /// A stop was requested.
    Stop = 11,
    /// A warning that did not stop motion; the code is its stable number.
    Warning = 12,
    /// A job of a served machine started, or a jog was replaced; the code is the job's number, the text its
    /// initial state.
    Job = 13,
    /// The planner of a job continued to read with other switches, ahead of the machine; the code is the
    /// job's number, the text the command from which they apply, and their states.
    Switched = 14,
    /// An input changed; the code is its number, plus 64 for an analog one, the value is its value, `None`
    /// while it is unknown.
    Input = 15,
    /// An output changed; the same.
    Output = 16,
    /// A kind that a later version recorded: its text describes it. Only readers return it.
    Later = 255,
}

impl EventKind {
    /// All kinds that are recorded, in the order of their numbers.
    pub const ALL: [Self; 16] = [
        Self::State,
        Self::Alarm,
        Self::Command,
        Self::Override,
        Self::Hold,
        Self::Resume,
        Self::Starvation,
        Self::Late,
        Self::Loss,
        Self::Message,
        Self::Stop,
        Self::Warning,
        Self::Job,
        Self::Switched,
        Self::Input,
        Self::Output,
    ];
}

/// An input or a fault, channel `/event`.
#[derive(Clone, Debug, PartialEq)]
pub struct EventRecord {
    /// When it took effect, Unix time in ns.
    pub time_ns: u64,
    /// The cycle in which it took effect.
    pub sequence: u64,
    /// Kind of the event.
    pub kind: EventKind,
    /// Stable number, see the kind; 0 if none.
    pub code: u32,
    /// Text for the operator.
    pub text: String,
    /// The value (an override factor, a count), so that a run can be recomputed.
    pub value: Option<f64>,
}

/// What a block of the program does. The numbers are those of the trace.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum BlockKind {
    /// Rapid move, G0.
    Rapid = 1,
    /// Straight feed, G1.
    Line = 2,
    /// Arc or helix, G2 and G3.
    Arc = 3,
    /// Involute of a circle, G2.2 and G3.2.
    Involute = 4,
    /// Dwell, G4.
    Dwell = 5,
    /// Program stop or end.
    Stop = 6,
    /// Anything else that takes time or is to be listed.
    Other = 7,
}

impl BlockKind {
    /// All kinds in the order of their numbers.
    pub const ALL: [Self; 7] = [
        Self::Rapid,
        Self::Line,
        Self::Arc,
        Self::Involute,
        Self::Dwell,
        Self::Stop,
        Self::Other,
    ];
}

/// A block that has been executed, channel `/block`.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockRecord {
    /// When the block ended, Unix time in ns.
    pub time_ns: u64,
    /// Line of the program, from 1.
    pub line: u32,
    /// The line's text.
    pub text: String,
    /// What the block does.
    pub kind: BlockKind,
    /// Length of its path, mm.
    pub length_mm: f64,
    /// Duration as planned, s.
    pub planned_duration_s: f64,
    /// Duration as executed, with holds and overrides, s.
    pub true_duration_s: f64,
    /// The first cycle of the block.
    pub start_sequence: u64,
}

/// Lateness and work of the cycles of one second, and how they followed the drives' clock, channel `/timing`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TimingRecord {
    /// When the first of the cycles was due, Unix time in ns.
    pub time_ns: u64,
    /// The first of the cycles.
    pub start_sequence: u64,
    /// Number of cycles.
    pub cycles: u64,
    /// Number of those published after their due time (flag "late").
    pub late_cycles: u64,
    /// Lateness of the wake-ups.
    pub lateness: crate::Histogram,
    /// Duration of their work.
    pub work: crate::Histogram,
    /// Phase lock to the drives' clock.
    pub phase: crate::PhaseTally,
}

/// Severity of a log line. The numbers are those of the public schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum LogLevel {
    /// For developers.
    Debug = 1,
    /// For information.
    Info = 2,
    /// Something to check.
    Warning = 3,
    /// Something failed.
    Error = 4,
    /// The run cannot continue.
    Fatal = 5,
}
