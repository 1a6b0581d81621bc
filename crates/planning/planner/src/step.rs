//! What the planner hands to the cycle: segments of path, and steps over them.

use evolvent_path::{Curve, Jet};
use evolvent_timing::Piece;

use crate::ScalarLimits;

/// Marks of a segment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SegmentMarks {
    /// A blend between two programmed blocks.
    pub blend: bool,
    /// A rapid move.
    pub rapid: bool,
    /// Begins at a step of curvature that exact-path mode does not allow to be eased.
    pub joint: bool,
}

/// A stretch of one curve: regular parameter `from` to `from + length`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// The curve, in machine coordinates.
    pub curve: Curve,
    /// Regular parameter at the start of the stretch.
    pub from: f64,
    /// Parameter length of the stretch.
    pub length: f64,
    /// Program line it belongs to.
    pub line: u32,
    /// Index of its block in the order of execution.
    pub block: u32,
    /// What it is.
    pub marks: SegmentMarks,
}

impl Segment {
    /// Position and derivatives at `x` in `0..=length`. Real-time safe.
    #[must_use]
    pub fn jet(&self, x: f64) -> Jet {
        self.curve.jet(self.from + x)
    }
}

/// A run: consecutive whole segments traversed under one set of scalar limits, with zero acceleration at both
/// ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// Parameter length: the sum over its segments.
    pub length: f64,
    /// Number of segments.
    pub segments: u32,
    /// Limits that every axis, the chord error and the path allow, the feed word aside.
    pub limits: ScalarLimits,
    /// Parameter speed of the programmed feed at 100 %; infinite for rapids.
    pub feed: f64,
}

/// One thing to do, in order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Move as solved by the cycle, which keeps the run's limits (the classic planner).
    Run(Run),
    /// Move by a law that the planner has solved (the near-optimal planner).
    TimedSegment(TimedSegment),
    /// Stand still until a further plan comes: the end of what is known so far, or of a feed hold.
    Wait,
    /// Stand still for so many seconds (G4).
    Dwell {
        /// Seconds.
        seconds: f64,
        /// Program line.
        line: u32,
    },
    /// Stand still until told to go on (M0, M1, M60).
    ProgramStop {
        /// Program line.
        line: u32,
    },
    /// Stand still until the wait for an input is over (M66). The program is not read further before, so nothing follows in the
    /// plan until its result is known.
    InputWait {
        /// Program line.
        line: u32,
    },
    /// A command for the machine's periphery takes effect here, at rest (M3, M6, M8 ...); `action` indexes the
    /// planner's list.
    Action {
        /// Number of the action in order of execution.
        action: u32,
        /// Program line.
        line: u32,
    },
    /// A controller takes over here, at rest, and comes back to the same place: turning in passes that the load finds.
    Turning {
        /// Program line.
        line: u32,
    },
    /// A probing move begins here, at rest, and ends where the probe trips. Nothing follows in the plan until its result is known, and
    /// what follows then begins where the axes stand.
    Probe {
        /// Program line.
        line: u32,
    },
    /// A pass of threading begins here, at rest, and follows the angle of the spindle. Nothing follows in the plan until its result is
    /// known, and what follows then begins where the axes stand.
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

/// One piece of a time law, and where it lies on the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedSegment {
    /// The law, over part of one segment; its `stretch` is the segment's index in the order of handing on.
    pub piece: Piece,
    /// Path parameter from the program's start to the piece's start.
    pub path: f64,
}

impl TimedSegment {
    /// Speed of the path parameter, per s, below which a piece ends at rest: rounding leaves far less, and no plan drives so slowly.
    const AT_REST: f64 = 1e-6;

    /// Whether the motion stops at the piece's end. Real-time safe.
    #[must_use]
    pub fn rests_at_end(&self) -> bool {
        self.piece.law.at(self.piece.duration).0.v <= Self::AT_REST
    }
}

/// Where a programmed block starts on a path that is not cut at every block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockMark {
    /// Path parameter from the program's start to the block's start.
    pub start: f64,
    /// Program line.
    pub line: u32,
    /// Index of the block in the order of execution.
    pub block: u32,
}

/// What the cycle asks of the planner while the program runs. At most one request is open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// Serial number, echoed by the answer.
    pub id: u64,
    /// Segment, and offset in it, at which the new plan takes over.
    pub segment: u64,
    /// Parameter offset in the segment.
    pub offset: f64,
    /// Grid interval of that place.
    pub interval: u64,
    /// Speed and acceleration of the path parameter there; both 0 at rest.
    pub v: f64,
    /// Acceleration of the path parameter.
    pub a: f64,
    /// Steps at rest (dwells, actions, stops) that have been passed.
    pub rests: u64,
    /// Rate, above 0 and at most 1, at which the cycle drives the plan in force there: the state is that of the plan at this rate.
    pub rate: f64,
    /// Feed override to plan for, in `0..=2`.
    pub feed_factor: f64,
}

/// The planner's answer to a [`Request`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Answer {
    /// Serial number of the request.
    pub id: u64,
    /// Step with which to go on from the request's place; none if no plan was found, so that the old one stays.
    pub step: Option<u64>,
}

/// Highest speeds at which a step may be left, acceleration zero.
///
/// Two plans are kept side by side: one for the programmed feed, one for twice the programmed feed. Scaling a
/// plan in time by a factor below 1 keeps every limit, and the larger of two allowed sequences is allowed, so
/// the cycle derives from them, at once and without asking back, boundary speeds for any override from 0 to
/// 200 % that never exceed the feed word times the override.
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
    /// What can go wrong downstream, such as a consumer that has gone.
    type Error;

    /// Appends a segment; it belongs to the next [`Step::Run`].
    ///
    /// # Errors
    /// The consumer does not take more.
    fn segment(&mut self, segment: &Segment) -> Result<(), Self::Error>;

    /// Appends a step, at rest at its end for the time being.
    ///
    /// # Errors
    /// The consumer does not take more.
    fn step(&mut self, step: &Step) -> Result<(), Self::Error>;

    /// Sets the exit speeds of step `index` (counted from 0). Speeds only ever grow, and arrive from the last
    /// step backwards, so that at every moment what the consumer holds ends at rest within the limits.
    fn exit(&mut self, index: u64, speeds: ExitSpeeds);

    /// Step `index` is final and takes `duration` seconds at the programmed feed, without override or hold.
    fn planned(&mut self, index: u64, duration: f64) {
        let _ = (index, duration);
    }

    /// All steps below `count` are final: they will be driven as they are unless the cycle asks for another plan.
    fn finalise(&mut self, count: u64);

    /// Appends the mark of a block's start.
    ///
    /// # Errors
    /// The consumer does not take more.
    fn mark(&mut self, mark: &BlockMark) -> Result<(), Self::Error> {
        let _ = mark;
        Ok(())
    }

    /// Makes step `to` the successor of step `from`. `false` if the consumer has already gone on from `from`.
    fn link(&mut self, from: u64, to: u64) -> bool {
        let _ = (from, to);
        true
    }

    /// The planner's work for a block comes to `seconds` more at the feed in force.
    fn planned_block(&mut self, block: u32, seconds: f64) {
        let _ = (block, seconds);
    }

    /// Whether so many steps, segments and marks can be appended without waiting.
    fn has_room(&self, steps: usize, segments: usize, marks: usize) -> bool {
        let _ = (steps, segments, marks);
        true
    }

    /// A window or a stop is about to be solved: for those who measure.
    fn solving(&mut self) {}

    /// It has been solved, or not, in so many Newton steps.
    fn solved(&mut self, steps: u32) {
        let _ = steps;
    }

    /// Waits a little for room or for a request.
    ///
    /// # Errors
    /// The consumer has gone.
    fn wait(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }

    /// The request that is open, once.
    fn request(&mut self) -> Option<Request> {
        None
    }

    /// Answers a request.
    fn answer(&mut self, answer: Answer) {
        let _ = answer;
    }

    /// Serial number of the last request whose answer the consumer has taken over; 0 for none. Settled by the time
    /// that its next request comes.
    fn taken(&self) -> u64 {
        u64::MAX
    }

    /// Grid interval that the consumer has reached; what lies before is not needed any more.
    fn reached(&self) -> u64 {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boundary_speeds_scale_with_the_override_and_keep_the_doubled_plan() {
        let speeds = ExitSpeeds {
            nominal: 30.0,
            doubled: 40.0,
        };
        // Below 1 the programmed plan slowed down; above, the better of it and of the doubled plan slowed down.
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
