//! The planner's output to the cycle: path segments, and steps over them.

use evolvent_path::{Curve, Jet};
use evolvent_timing::TimeLawPiece;

use crate::ScalarLimits;

/// Properties of a segment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SegmentMarks {
    /// A blend between two programmed blocks.
    pub blend: bool,
    /// A rapid move.
    pub rapid: bool,
    /// Starts at a step of curvature that exact-path mode must keep.
    pub joint: bool,
}

/// A path segment: regular parameter `from` to `from + length` of one curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// The curve, in machine coordinates.
    pub curve: Curve,
    /// Regular parameter at the start.
    pub from: f64,
    /// Parameter length.
    pub length: f64,
    /// Program line.
    pub line: u32,
    /// Index of its block in the order of execution.
    pub block: u32,
    /// Its properties.
    pub marks: SegmentMarks,
}

impl Segment {
    /// Position and derivatives at `x` in `0..=length`. Real-time safe.
    #[must_use]
    pub fn jet(&self, x: f64) -> Jet {
        self.curve.jet(self.from + x)
    }
}

/// A run: consecutive whole segments under one set of scalar limits, with zero acceleration at both ends
/// (classic planner).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// Parameter length: the sum over its segments.
    pub length: f64,
    /// Number of segments.
    pub segments: u32,
    /// Limits by axes, chord error and path, without the feed word.
    pub limits: ScalarLimits,
    /// Parameter speed of the programmed feed at 100 %; infinite for rapids.
    pub feed_u_s: f64,
}

/// One step of the plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Motion solved by the cycle within the run's limits (classic planner).
    Run(Run),
    /// Motion by a time law from the planner (time-optimal planner).
    TimedSegment(TimedSegment),
    /// Rest until a further plan arrives: at the end of the known path, or after a feed hold.
    Wait,
    /// Rest for this time (G4).
    Dwell {
        /// Seconds.
        seconds: f64,
        /// Program line.
        line: u32,
    },
    /// Rest until resumed by the operator (M0, M1, M60).
    ProgramStop {
        /// Program line.
        line: u32,
    },
    /// Rest until the wait for an input ends (M66). The program is not read further before, so nothing
    /// follows in the plan until the result is known.
    InputWait {
        /// Program line.
        line: u32,
    },
    /// A command for the periphery of the machine takes effect here, at rest (M3, M6, M8 ...). `action` is
    /// its index in the planner's list.
    Action {
        /// Number of the action in order of execution.
        action: u32,
        /// Program line.
        line: u32,
    },
    /// A controller takes over here, at rest, and returns to the same position: load-adaptive turning passes.
    Turning {
        /// Program line.
        line: u32,
    },
    /// A probing move starts here, at rest, and ends where the probe trips. Nothing follows in the plan until
    /// the result is known; the next move starts at the actual position of the axes.
    Probe {
        /// Program line.
        line: u32,
    },
    /// A threading pass starts here, at rest, and follows the angle of the spindle. Nothing follows in the
    /// plan until the result is known; the next move starts at the actual position of the axes.
    Thread {
        /// Program line.
        line: u32,
    },
    /// The program ends here, at rest.
    End {
        /// Program line.
        line: u32,
    },
}

impl Step {
    /// Whether the axes move from this step on: by the plan, or by the controller or cycle that takes over
    /// here.
    #[must_use]
    pub fn begins_motion(&self) -> bool {
        matches!(
            self,
            Self::Run(_)
                | Self::TimedSegment(_)
                | Self::Turning { .. }
                | Self::Probe { .. }
                | Self::Thread { .. }
        )
    }
}

/// A timed segment: one piece of the time law and its position on the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedSegment {
    /// The law over a part of one segment; its `segment` is the index in the order of hand-over.
    pub piece: TimeLawPiece,
    /// Path parameter from the start of the program to the start of the piece.
    pub path: f64,
}

impl TimedSegment {
    /// Speed of the path parameter, per s, below which a piece ends at rest. Rounding errors are far smaller,
    /// and plans are faster.
    const AT_REST: f64 = 1e-6;

    /// Whether the motion stops at the end of the piece. Real-time safe.
    #[must_use]
    pub fn rests_at_end(&self) -> bool {
        self.piece.law.at(self.piece.duration_s).0.v <= Self::AT_REST
    }
}

/// The start of a programmed block, on a path that is not divided at every block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockMark {
    /// Path parameter from the start of the program to the start of the block.
    pub start: f64,
    /// Program line.
    pub line: u32,
    /// Index of the block in the order of execution.
    pub block: u32,
}

/// A request of the cycle to the planner. At most one is open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReplanRequest {
    /// Serial number, repeated in the reply.
    pub id: u64,
    /// Plan step at that position; at rest the next one. It identifies the window that the cycle executes:
    /// when a run is recomputed, later windows may have been planned although the cycle executes a tail.
    pub step: u64,
    /// Segment at which the new plan takes over.
    pub segment: u64,
    /// Parameter offset in the segment.
    pub offset: f64,
    /// Grid interval of that position.
    pub interval: u64,
    /// Speed of the path parameter there; 0 at rest.
    pub v: f64,
    /// Acceleration of the path parameter there; 0 at rest.
    pub a: f64,
    /// Number of steps at rest (dwells, actions, stops) that have been passed.
    pub rests: u64,
    /// Rate, above 0 and at most 1, at which the cycle executes the present plan there: the state is that of
    /// the plan at this rate.
    pub rate: f64,
    /// Feed override of the new plan, in `0..=2`.
    pub feed_factor: f64,
}

/// The planner's reply to a [`ReplanRequest`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReplanReply {
    /// Serial number of the request.
    pub id: u64,
    /// First step of the new plan; `None` if no plan was found and the old one stays in force.
    pub step: Option<u64>,
}

/// Maximum exit speeds of a step, with zero acceleration.
///
/// Two plans are kept: one for the programmed feed, one for twice the programmed feed. Scaling a plan in time
/// by a factor below 1 keeps every limit, and the maximum of two permitted sequences is permitted. So the
/// cycle derives boundary speeds for any override from 0 to 200 % from them at once, without a request, and
/// they never exceed the feed word times the override.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ExitSpeeds {
    /// At the programmed feed.
    pub nominal: f64,
    /// At twice the programmed feed.
    pub doubled: f64,
}

impl ExitSpeeds {
    /// At rest.
    pub const REST: Self = Self {
        nominal: 0.0,
        doubled: 0.0,
    };

    /// The boundary speed for an override in `0..=2`. Real-time safe.
    #[must_use]
    pub fn at_override(self, factor: f64) -> f64 {
        if factor <= 1.0 {
            self.nominal * factor
        } else {
            self.nominal.max(self.doubled * 0.5 * factor.min(2.0))
        }
    }
}

/// Receives the plan in order. Implemented by the queue to the cycle, and by tests.
pub trait PlanSink {
    /// Errors of the consumer, for example that it has gone.
    type Error;

    /// Appends a segment; it belongs to the next [`Step::Run`].
    ///
    /// # Errors
    /// The consumer has gone.
    fn segment(&mut self, segment: &Segment) -> Result<(), Self::Error>;

    /// Appends a step, which for the time being ends at rest.
    ///
    /// # Errors
    /// The consumer has gone.
    fn step(&mut self, step: &Step) -> Result<(), Self::Error>;

    /// Sets the exit speeds of step `index` (counted from 0). Speeds never decrease, and arrive from the last
    /// step backwards, so that at every moment the consumer's steps end at rest within the limits.
    fn exit(&mut self, index: u64, speeds: ExitSpeeds);

    /// Step `index` is final and takes `duration_s` seconds at the programmed feed, without override or hold.
    fn planned(&mut self, index: u64, duration_s: f64) {
        let _ = (index, duration_s);
    }

    /// All steps below `count` are final: they are executed unchanged unless the cycle requests another plan.
    fn commit(&mut self, count: u64);

    /// Appends the mark of a block's start.
    ///
    /// # Errors
    /// The consumer has gone.
    fn mark(&mut self, mark: &BlockMark) -> Result<(), Self::Error> {
        let _ = mark;
        Ok(())
    }

    /// All steps after `from` are a tail, even if they are declared final, until a step is linked to `from`.
    fn leave_open(&mut self, from: u64) {
        let _ = from;
    }

    /// Appends a [`Step::Wait`] that reserves the link after a stop: the step that follows the stop is later
    /// linked to the Wait. The consumer rests there until then, and sends no request.
    ///
    /// # Errors
    /// The consumer has gone.
    fn reserve_link(&mut self) -> Result<(), Self::Error> {
        self.step(&Step::Wait)
    }

    /// Makes step `to` the successor of step `from`, which was left open or is a reserved Wait. False if the
    /// consumer has already continued from `from`.
    fn link(&mut self, from: u64, to: u64) -> bool {
        let _ = (from, to);
        true
    }

    /// Adds `seconds` at the present feed to the planned time of a block.
    fn planned_block(&mut self, block: u32, seconds: f64) {
        let _ = (block, seconds);
    }

    /// Whether this many steps, segments and marks can be appended without waiting.
    fn has_capacity(&self, steps: usize, segments: usize, marks: usize) -> bool {
        let _ = (steps, segments, marks);
        true
    }

    /// Solving of a window or a stop starts; for measurements.
    fn solving(&mut self) {}

    /// Solving has ended, successfully or not, after this many Newton steps.
    fn solved(&mut self, steps: u32) {
        let _ = steps;
    }

    /// Waits briefly for capacity or a request.
    ///
    /// # Errors
    /// The consumer has gone.
    fn wait(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }

    /// The open request, once.
    fn request(&mut self) -> Option<ReplanRequest> {
        None
    }

    /// Replies to a request.
    fn reply(&mut self, reply: ReplanReply) {
        let _ = reply;
    }

    /// Serial number of the last request whose reply the consumer has taken over; 0 for none. Settled before
    /// its next request.
    fn acknowledged(&self) -> u64 {
        u64::MAX
    }

    /// Serial number of the last request that the consumer has withdrawn; 0 for none. It takes over no reply
    /// to it or to an earlier one, and executes the plan in force before.
    fn withdrawn(&self) -> u64 {
        0
    }

    /// Grid interval that the consumer has reached; everything before it may be dropped.
    fn reached(&self) -> u64 {
        0
    }

    /// Plan step that the consumer has reached: windows that end before it may be dropped.
    fn reached_step(&self) -> u64 {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boundary_speeds_scale_with_the_override() {
        let speeds = ExitSpeeds {
            nominal: 30.0,
            doubled: 40.0,
        };
        // Below 1 the programmed plan slowed down; above, the better of it and the doubled plan slowed down.
        for (factor, expected) in [
            (0.0, 0.0),
            (0.5, 15.0),
            (1.0, 30.0),
            (1.4, 30.0),
            (1.6, 32.0),
            (2.0, 40.0),
            (3.0, 40.0),
        ] {
            let speed = speeds.at_override(factor);
            assert!((speed - expected).abs() < 1e-12, "{factor}: {speed}");
        }
    }
}
