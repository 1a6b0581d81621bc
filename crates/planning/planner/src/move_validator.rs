//! What a move must be before it is planned.

use evolvent_machine::Limits;
use evolvent_path::{Axes, AxisLetter, Curve, Move};

use crate::planner::PlanError;

/// Rounding of positions, mm or degrees, that the check of travel forgives.
const TRAVEL_SLACK: f64 = 1e-9;
/// Rounding of positions that may lie between two moves, mm or degrees.
const GAP: f64 = 1e-6;

/// Says of one move after the other whether a [`Planner`](crate::Planner) takes it, without planning anything: to check a
/// program as fast as it can be read.
#[derive(Clone, Debug)]
pub struct MoveValidator {
    limits: Limits,
    end: Option<Axes>,
}

impl MoveValidator {
    /// Before the first move.
    #[must_use]
    pub fn new(limits: &Limits) -> Self {
        Self {
            limits: *limits,
            end: None,
        }
    }

    /// The axes stand elsewhere than the last move ended: a probing move has brought them there.
    pub fn stand_at(&mut self, position: &Axes) {
        self.end = Some(*position);
    }

    /// Checks the next move. One that is refused leaves no trace: the next has to follow on the last that was taken.
    ///
    /// # Errors
    /// The move leaves the travel ([`PlanError::Travel`]), has no feed ([`PlanError::Feed`]), or does not start where the
    /// last one ended ([`PlanError::Gap`]).
    pub fn admit<E>(&mut self, motion: &Move) -> Result<(), PlanError<E>> {
        let curve = &motion.curve;
        check_travel(curve, &self.limits)?;
        if motion.feed.is_nan() || motion.feed <= 0.0 {
            return Err(PlanError::Feed {
                feed_mm_s: motion.feed,
            });
        }
        if let Some(end) = self.end {
            let gap = curve.start() - end;
            for axis in AxisLetter::ALL {
                let distance = gap[axis.index()].abs();
                if distance.is_nan() || distance > GAP {
                    return Err(PlanError::Gap { axis, distance });
                }
            }
        }
        self.end = Some(curve.end());
        Ok(())
    }
}

/// Whether a curve stays within the travel of every axis.
pub(crate) fn check_travel<E>(curve: &Curve, limits: &Limits) -> Result<(), PlanError<E>> {
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
