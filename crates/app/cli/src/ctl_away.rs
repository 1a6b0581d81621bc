//! Excursions from a held program, from the command line.

use std::io::Write;
use std::time::{Duration, Instant};

use evolvent_bus::{ControlAnswer, ControlRequest, Status};
use evolvent_control::{CommandCode, JobResult};
use evolvent_path::{AxisLetter, AxisMask};

use crate::ctl_answer::tell;
use crate::ctl_request::request;
use crate::ctl_session::{MAX_POLLS, POLL, Session};
use crate::{CommandError, Ending};

/// Axes that have not moved for this time are at rest. Between two legs of the return they stop for less
/// time.
const REST: Duration = Duration::from_millis(250);
/// Distance from the target below which a jog has reached it, mm or degrees.
const AT_TARGET: f64 = 1e-6;
/// Number of setpoints after an answer until the ordered motion is visible in the status.
const APPEARS: u64 = 20;

/// Whether a program or block of MDI is active.
pub(crate) fn is_of_program(status: &Status) -> bool {
    matches!(status.activity, 1 | 2)
}

/// Distance of the axis with this index from its target, mm or degrees. Angles of an unlimited axis are shown
/// modulo a turn: if it has moved, it may have turned fully; if it has not moved, it has its old angle.
fn off_target(axis: usize, difference: f64, has_moved: bool) -> f64 {
    if has_moved && AxisLetter::ALL.get(axis).is_some_and(|letter| letter.is_rotary()) {
        let rest = difference.rem_euclid(360.0);
        rest.min(360.0 - rest)
    } else {
        difference.abs()
    }
}

/// Whether the axis with this index has moved by `distance`, mm or degrees. `was_seen`: a status has shown it
/// in motion; a short jog may begin and end between two.
fn has_arrived(axis: usize, from: f64, distance: f64, to: f64, was_seen: bool) -> bool {
    off_target(axis, from + distance - to, was_seen || to != from) <= AT_TARGET
}

/// The axes at rest after an order.
pub(crate) struct Rest {
    status: Status,
    /// The axes that were seen to move since the answer.
    moved: AxisMask,
}

impl Session {
    /// Sends an order that moves the axes away from the held program or back, and waits until they are at
    /// rest.
    pub(crate) fn give_away(
        &mut self,
        order: &ControlRequest,
        out: &mut dyn Write,
    ) -> Result<Ending, CommandError> {
        self.catch_signals()?;
        // An increment from rest has one target; one that is added to another has a different one.
        let start = (self.latest()?)
            .filter(|status| status.velocity.iter().all(|velocity| *velocity == 0.0))
            .filter(|_| order.command == CommandCode::Jog as u32 && order.index == 1)
            .map(|status| status.position_machine);
        let answer = self.send(order)?;
        if answer.verdict != 0 {
            return tell(&answer, None, self.json, out);
        }
        let Rest { status, moved } = self.await_rest(&answer)?;
        let has_ended = !is_of_program(&status) && status.job_result != JobResult::Done as u32;
        if has_ended {
            return Err(CommandError::Failed(
                "the program was stopped before the motion ended".to_owned(),
            ));
        }
        if order.command == CommandCode::Return as u32 && status.away_parts > 0 {
            return Err(CommandError::Failed(format!(
                "the return was stopped: {}",
                status.operator_message()
            )));
        }
        let arrives = |start: &[f64; 9]| {
            (0..start.len()).all(|axis| {
                let (from, to) = (start[axis], status.position_machine[axis]);
                has_arrived(axis, from, order.values[axis], to, moved.contains(axis))
            })
        };
        if start.as_ref().is_some_and(|start| !arrives(start)) {
            return Err(CommandError::Failed(format!(
                "the jog was stopped before its end: {}",
                status.operator_message()
            )));
        }
        if !self.json {
            writeln!(out, "{}", status.operator_message())
                .map_err(|error| CommandError::Failed(error.to_string()))?;
        }
        tell(&answer, None, self.json, out)
    }

    /// Waits until the axes are at rest or the program has ended. A signal stops the motion.
    pub(crate) fn await_rest(&mut self, answer: &ControlAnswer) -> Result<Rest, CommandError> {
        let (mut sequence, mut polls, mut is_stopped) = (0, 0, false);
        let mut moved = AxisMask::NONE;
        let mut since: Option<Instant> = None;
        loop {
            polls += 1;
            if self.is_interrupted() && !is_stopped {
                is_stopped = true;
                self.send(&request(CommandCode::JogStop))?;
            }
            if let Some(status) = self.latest()?
                && status.sequence != sequence
            {
                (sequence, polls) = (status.sequence, 0);
                for (axis, velocity) in status.velocity.iter().enumerate() {
                    moved |= AxisMask::one_if(axis, *velocity != 0.0);
                }
                let rests = status.velocity.iter().all(|velocity| *velocity == 0.0);
                if !rests || status.cycles < answer.sequence + APPEARS {
                    since = None;
                } else if since.get_or_insert_with(Instant::now).elapsed() > REST || !is_of_program(&status) {
                    return if is_stopped {
                        Err(CommandError::Failed(
                            "interrupted: the axes were stopped".to_owned(),
                        ))
                    } else {
                        Ok(Rest { status, moved })
                    };
                }
            }
            if polls > MAX_POLLS {
                return Err(CommandError::Failed("the core has ended".to_owned()));
            }
            std::thread::sleep(POLL);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{has_arrived, off_target};

    #[test]
    fn a_short_jog_arrives_though_no_status_showed_it() {
        // Across 0, where the displayed angle wraps, and a jog that did not begin.
        assert!(has_arrived(3, 359.99, 0.02, 0.01, false));
        assert!(!has_arrived(3, 359.99, 0.02, 359.99, false));
        assert!(!has_arrived(3, 10.0, 360.0, 10.0, false) && has_arrived(3, 10.0, 360.0, 10.0, true));
        assert!(has_arrived(0, 1.0, 0.5, 1.5, false) && !has_arrived(0, 1.0, 0.5, 1.25, true));
    }

    #[test]
    fn a_turn_of_a_rotary_axis_is_no_distance() {
        assert!(off_target(3, 372.0 - 12.0, true) < 1e-9);
        assert!(off_target(3, -31.0 - 329.0, true) < 1e-9);
        assert_eq!(off_target(3, -0.5, true), 0.5);
        assert_eq!(off_target(0, 360.0, true), 360.0);
    }

    /// If nothing has moved, no full turn was made: of a limited axis, or of one whose jog was stopped before
    /// it began.
    #[test]
    fn a_turn_that_never_began_is_missed() {
        assert_eq!(off_target(3, 360.0, false), 360.0);
        assert_eq!(off_target(3, 0.0, false), 0.0);
    }
}
