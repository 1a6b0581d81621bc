//! Conditions on a move before it is planned.

use evolvent_machine::Limits;
use evolvent_path::{Axes, AxisLetter, Curve, Move};

use crate::planner::PlanError;

/// Tolerance of the travel check, mm or degrees. An axis that has stopped at the end of its travel may be
/// beyond it by half of what the guard of the cycle tolerates (1e-6), and the next motion begins there.
pub const TRAVEL_SLACK: f64 = 6e-7;
/// Rounding of positions tolerated between two moves, mm or degrees.
const MAX_GAP: f64 = 1e-6;

/// Checks whether a [`Planner`](crate::Planner) would accept each move, without planning: for checking
/// programs at the speed of the interpreter.
#[derive(Clone, Debug)]
pub struct MoveValidator {
    limits: Limits,
    end: Option<Axes>,
}

impl MoveValidator {
    /// Starts before the first move.
    #[must_use]
    pub fn new(limits: &Limits) -> Self {
        Self {
            limits: *limits,
            end: None,
        }
    }

    /// Sets the position of the axes when it differs from the end of the last move, as after a probing move.
    pub fn set_position(&mut self, position: &Axes) {
        self.end = Some(*position);
    }

    /// Checks the next move. A rejected move has no effect: the next one has to start at the end of the last
    /// accepted one.
    ///
    /// # Errors
    /// [`PlanError::Travel`] if the move exceeds the travel, [`PlanError::Feed`] if it has no feed,
    /// [`PlanError::Gap`] if it does not start at the end of the last one.
    pub fn validate<E>(&mut self, motion: &Move) -> Result<(), PlanError<E>> {
        let curve = &motion.curve;
        check_travel(curve, &self.limits)?;
        if motion.feed_mm_s.is_nan() || motion.feed_mm_s <= 0.0 {
            return Err(PlanError::Feed {
                feed_mm_s: motion.feed_mm_s,
            });
        }
        if let Some(end) = self.end {
            let gap = curve.start() - end;
            for axis in AxisLetter::ALL {
                let distance = gap[axis.index()].abs();
                if distance.is_nan() || distance > MAX_GAP {
                    return Err(PlanError::Gap { axis, distance });
                }
            }
        }
        self.end = Some(curve.end());
        Ok(())
    }
}

/// Checks that a curve stays within the travel of every axis.
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
