//! Cycles on their way to the trace.

use evolvent_motion::{Inputs, MotionState, PathExecutor, Setpoint};
use evolvent_path::AXES;
use evolvent_trace::{CycleRecord, PhaseRecord, inputs as recorded};
use evolvent_turning::Transition;

/// A cycle on its way to the trace.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CycleSample {
    pub record: CycleRecord,
    pub block: u32,
    pub actions: u32,
    /// The change of state of a turning cycle, if any.
    pub turning: Option<Transition>,
    /// How the cycle follows the drives' clock, if a phase error was reported.
    pub phase: Option<PhaseRecord>,
}

impl CycleSample {
    /// A sample of a setpoint that is due at this Unix time. `inputs`: the inputs on which it depended, as
    /// bits of the trace.
    pub(crate) fn new(
        setpoint: &Setpoint,
        due_unix_ns: u64,
        lateness_ns: u64,
        work_ns: u64,
        inputs: u32,
    ) -> Self {
        Self {
            record: CycleRecord {
                sequence: setpoint.sequence,
                due_time_ns: due_unix_ns,
                wake_lateness_ns: lateness_ns as i64,
                work_ns: work_ns.min(u64::from(u32::MAX)) as u32,
                path_mm: setpoint.path_mm,
                feed_mm_s: setpoint.feed_mm_s,
                position: setpoint.position.into(),
                velocity: setpoint.velocity.into(),
                acceleration: setpoint.acceleration.into(),
                jerk: setpoint.jerk.into(),
                line: setpoint.line,
                state: setpoint.state as u8,
                flags: setpoint.flags,
                override_: setpoint.feed_override,
                load: f64::NAN,
                inputs,
                following_error: [f64::NAN; AXES],
                drive_position: [f64::NAN; AXES],
            },
            block: setpoint.block,
            actions: setpoint.actions,
            turning: None,
            phase: None,
        }
    }

    /// Number of blocks begun; 0 if nothing moves.
    pub(crate) fn blocks_begun(&self) -> u32 {
        let still =
            [MotionState::Idle, MotionState::Dwell, MotionState::ProgramStop].map(|state| state as u8);
        if still.contains(&self.record.state) {
            0
        } else {
            self.block + 1
        }
    }
}

/// The inputs on which a step along a plan depended besides plan and override, as bits of the trace.
pub(crate) fn input_bits(inputs: &Inputs, motion: &PathExecutor) -> u32 {
    let lag = motion.planner_lag();
    let bits = [
        (inputs.hold, recorded::HOLD),
        (inputs.stop, recorded::STOP),
        (inputs.resume, recorded::RESUME),
        (lag.failed_lookup.is_some(), recorded::WAITED),
        (lag.refused, recorded::REFUSED),
    ];
    let failed_lookup = u32::from(lag.failed_lookup.unwrap_or(0)) << recorded::FAILED_LOOKUP_SHIFT;
    bits.into_iter()
        .filter(|(set, _)| *set)
        .fold(failed_lookup, |sum, (_, bit)| sum | bit)
}
