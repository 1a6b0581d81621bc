//! Moves in, plan out.

use evolvent_gcode::{Move, MoveKind, PathMode};
use evolvent_machine::Limits;
use evolvent_path::{AxisLetter, Curve};
use thiserror::Error;

use crate::corner::{exact_joint_speed, round_corner};
use crate::limits::PathLimits;
use crate::lookahead::LookAhead;
use crate::step::{PlanSink, Segment, SegmentMarks, Step};

/// A step of the tangent below this is rounding: at 1 m/s and 35 kHz its jerk is below a hundredth of any limit.
const SMOOTH_TANGENT: f64 = 1e-10;
/// A step of the second derivative, 1/mm, below this likewise.
const SMOOTH_CURVATURE: f64 = 1e-7;
/// A joint slower than this, parameter units per s, is a stop.
const SLOWEST_JOINT: f64 = 0.01;
/// Rounding of positions, mm or degrees, that the check of travel forgives.
const TRAVEL_SLACK: f64 = 1e-9;
/// Stretches shorter than this are rounding, parameter units.
const SHORTEST: f64 = 1e-12;
/// Between this and a unit of parameter speed a curve can be joined; below, it starts from a singular point.
const REGULAR_SPEED: f64 = 0.5;

/// How the path is to be followed, the limits of the axes aside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathRules {
    /// Tolerance of G64 without P, mm.
    pub blend_tolerance_mm: f64,
    /// Time in which the jerk limit undoes a step of acceleration in exact-path mode, s.
    pub joint_time_s: f64,
}

/// Why a move cannot be planned.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PlanError<E> {
    /// The move leaves the travel of an axis.
    #[error(
        "axis {} would go to {reached:.4}, beyond its travel limit of {limit:.4}; \
         move the work offset or the part, or change the program",
        axis.letter()
    )]
    Travel {
        /// The axis.
        axis: AxisLetter,
        /// Farthest machine coordinate of the move, mm or degrees.
        reached: f64,
        /// The limit that it passes.
        limit: f64,
    },
    /// The feed of a move is not a positive number.
    #[error("the feed of this move is {feed_mm_s} mm/s; a move needs a feed above 0")]
    Feed {
        /// The feed.
        feed_mm_s: f64,
    },
    /// A move starts elsewhere than the one before ended.
    #[error("axis {} jumps by {distance:.3e} between two moves", axis.letter())]
    Gap {
        /// The axis.
        axis: AxisLetter,
        /// Size of the jump.
        distance: f64,
    },
    /// The consumer of the plan does not take more.
    #[error("the plan is not taken any more")]
    Sink(E),
}

/// The move whose end is still open.
#[derive(Clone, Copy, Debug)]
struct Held {
    motion: Move,
    line: u32,
    block: u32,
    /// Parameter from which on it has not been handed on.
    from: f64,
    /// Whether it begins at a joint that is not smooth.
    joint: bool,
}

/// Plans one program: joins moves, and looks ahead.
#[derive(Debug)]
pub struct Planner<S> {
    ahead: LookAhead<S>,
    rules: PathRules,
    held: Option<Held>,
    deviation: f64,
}

impl<S: PlanSink> Planner<S> {
    /// At rest at the start of the first move.
    #[must_use]
    pub fn new(limits: PathLimits, rules: PathRules, sink: S) -> Self {
        Self {
            ahead: LookAhead::new(limits, sink),
            rules,
            held: None,
            deviation: 0.0,
        }
    }

    /// Where the plan goes.
    #[must_use]
    pub fn sink(&self) -> &S {
        self.ahead.sink()
    }

    /// Where the plan goes.
    pub fn sink_mut(&mut self) -> &mut S {
        self.ahead.sink_mut()
    }

    /// Largest distance between blends planned so far and the programmed path, mm.
    #[must_use]
    pub fn deviation_mm(&self) -> f64 {
        self.deviation
    }

    /// Appends a move. Nothing is planned of a move that is refused.
    ///
    /// # Errors
    /// The move leaves the travel, has no feed, or does not start where the last one ended.
    pub fn push(&mut self, motion: &Move, line: u32, block: u32) -> Result<(), PlanError<S::Error>> {
        let curve = &motion.curve;
        check_travel(curve, self.ahead.limits().axes())?;
        if motion.feed.is_nan() || motion.feed <= 0.0 {
            return Err(PlanError::Feed {
                feed_mm_s: motion.feed,
            });
        }
        let next = Held {
            motion: *motion,
            line,
            block,
            from: 0.0,
            joint: false,
        };
        let Some(held) = self.held.take() else {
            self.held = Some(next);
            return Ok(());
        };
        self.held = Some(held);
        let gap = curve.start() - held.motion.curve.end();
        for axis in AxisLetter::ALL {
            let distance = gap[axis.index()].abs();
            if distance.is_nan() || distance > 1e-6 {
                return Err(PlanError::Gap { axis, distance });
            }
        }
        self.join(held, next).map_err(PlanError::Sink)
    }

    /// Brings the path to rest and appends a step there.
    ///
    /// # Errors
    /// As the sink's.
    pub fn rest(&mut self, step: &Step) -> Result<(), S::Error> {
        self.release()?;
        self.ahead.rest(step)
    }

    /// Brings the path to rest; everything planned becomes final.
    ///
    /// # Errors
    /// As the sink's.
    pub fn finish(&mut self, line: u32) -> Result<(), S::Error> {
        self.release()?;
        self.ahead.finish(line)
    }

    /// Hands on the rest of the open move and stops at its end.
    fn release(&mut self) -> Result<(), S::Error> {
        if let Some(held) = self.held.take() {
            self.hand_on(&held, held.motion.curve.domain())?;
            self.ahead.boundary(0.0)?;
        }
        Ok(())
    }

    fn join(&mut self, held: Held, mut next: Held) -> Result<(), S::Error> {
        let (left, right) = (&held.motion.curve, &next.motion.curve);
        let (end, start) = (left.jet(left.domain()), right.jet(0.0));
        let limits = *self.ahead.limits().axes();
        let smooth = (start.first - end.first).amax() <= SMOOTH_TANGENT
            && (start.second - end.second).amax() <= SMOOTH_CURVATURE;
        let regular = metric(&end.first) > REGULAR_SPEED && metric(&start.first) > REGULAR_SPEED;
        let stop = matches!(held.motion.path_mode, PathMode::ExactStop);
        let mut cap = f64::INFINITY;
        if stop {
            cap = 0.0;
        } else if !regular || !smooth {
            if let Some(tolerance) = self.tolerance(&held.motion, &next.motion) {
                let room = (0.5 * left.domain())
                    .min(left.domain() - held.from)
                    .min(0.5 * right.domain());
                if let Some(rounding) = round_corner(left, right, tolerance, room) {
                    let within = check_travel::<()>(&Curve::Blend(rounding.blend), &limits).is_ok();
                    if within {
                        self.hand_on(&held, left.domain() - rounding.stretch)?;
                        let feed = held.motion.feed.min(next.motion.feed);
                        let marks = SegmentMarks {
                            blend: true,
                            rapid: feed.is_infinite(),
                            joint: false,
                        };
                        let segment = Segment {
                            curve: Curve::Blend(rounding.blend),
                            from: 0.0,
                            length: 2.0 * rounding.stretch,
                            line: next.line,
                            block: next.block,
                            marks,
                        };
                        self.ahead.segment(segment, feed)?;
                        self.deviation = self.deviation.max(rounding.deviation);
                        next.from = rounding.stretch;
                        self.held = Some(next);
                        return Ok(());
                    }
                }
            }
            let joint_time = self.rules.joint_time_s;
            cap = exact_joint_speed(&end, &start, &limits.jerk, &limits.present, joint_time);
            if !regular || cap < SLOWEST_JOINT {
                cap = 0.0;
            }
            next.joint = cap > 0.0;
        }
        self.hand_on(&held, left.domain())?;
        if cap.is_finite() {
            self.ahead.boundary(cap)?;
        }
        self.held = Some(next);
        Ok(())
    }

    /// The tolerance of the corner between two moves, if both may be rounded.
    fn tolerance(&self, left: &Move, right: &Move) -> Option<f64> {
        let of = |motion: &Move| match motion.path_mode {
            PathMode::Blend { tolerance_mm } => Some(tolerance_mm.unwrap_or(self.rules.blend_tolerance_mm)),
            PathMode::ExactPath | PathMode::ExactStop => None,
        };
        let least = of(left)?.min(of(right)?);
        (least > 0.0).then_some(least)
    }

    fn hand_on(&mut self, held: &Held, to: f64) -> Result<(), S::Error> {
        let length = to - held.from;
        if length.is_nan() || length <= SHORTEST {
            return Ok(());
        }
        let rapid = matches!(held.motion.kind, MoveKind::Rapid);
        let marks = SegmentMarks {
            blend: false,
            rapid,
            joint: held.joint,
        };
        let (line, block) = (held.line, held.block);
        let segment = Segment {
            curve: held.motion.curve,
            from: held.from,
            length,
            line,
            block,
            marks,
        };
        self.ahead.segment(segment, held.motion.feed)
    }
}

fn check_travel<E>(curve: &Curve, limits: &Limits) -> Result<(), PlanError<E>> {
    let (low, high) = curve.bounds(0.0, curve.domain());
    for axis in AxisLetter::ALL {
        let i = axis.index();
        if !limits.present[i] {
            continue;
        }
        let (lowest, highest) = (limits.travel_min[i], limits.travel_max[i]);
        if low[i].is_nan() || low[i] < lowest - TRAVEL_SLACK {
            return Err(PlanError::Travel {
                axis,
                reached: low[i],
                limit: lowest,
            });
        }
        if high[i].is_nan() || high[i] > highest + TRAVEL_SLACK {
            return Err(PlanError::Travel {
                axis,
                reached: high[i],
                limit: highest,
            });
        }
    }
    Ok(())
}

/// Speed of the feed metric per unit of parameter speed.
fn metric(first: &evolvent_path::Axes) -> f64 {
    let norm =
        |i: usize| (first[i] * first[i] + first[i + 1] * first[i + 1] + first[i + 2] * first[i + 2]).sqrt();
    let (xyz, uvw, abc) = (norm(0), norm(6), norm(3));
    if xyz > 0.0 {
        xyz
    } else if uvw > 0.0 {
        uvw
    } else {
        abc
    }
}
