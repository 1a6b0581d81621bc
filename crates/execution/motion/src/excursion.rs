//! Excursions: the axes leave a held program, and return to the position at which it is held.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, Jet};
use evolvent_planner::{Profile, ScalarLimits, ScalarState};

use crate::driven_path::DrivenPath;
use crate::path_executor::PathExecutor;
use crate::setpoint::Setpoint;
use crate::setpoint_generator::SetpointGenerator;
use crate::state::MotionState;
use crate::transfer_executor::TransferExecutor;

/// Distance below which two positions are the same, mm or degrees. A solved transfer ends within less of its
/// target.
const NEAR: f64 = 1e-9;
/// Number of setpoints at rest at the held position before the program takes over. The guard's third
/// differences cover four positions, and are all zero then, as if the program had rested there all the time.
const SETTLED: u32 = 4;

/// Maximum rate of path time at which the driven path is retraced.
///
/// The path kept the limits `V`, `A`, `J` of an axis at rate 1. At rate `r` with derivatives `r'`, `r''` the
/// axis has at most velocity `V r`, acceleration `A r^2 + V r'` and jerk `J r^3 + 3 A r r' + V r''`.
/// [`rate_limits`] bounds `r'` and `r''` so that these are at most 0.85 `A` and 0.625 `J`. The quintics
/// between samples have up to 2.18 times the third derivative of the path, so that `J r^3` becomes 0.273 `J`,
/// and the total 0.773 `J`.
const RATE: f64 = 0.5;

/// A motion of the axes away from a held program, and back.
///
/// The [`PathExecutor`] of the program is stepped in every cycle as in any hold, and its setpoints at rest
/// are not published. The excursion therefore cannot influence the program, which continues bit for bit as
/// without it. The positions published are those of the excursion; state, block and actions are those of the
/// program. Real-time safe: no method allocates, locks or waits.
#[derive(Debug)]
pub struct Excursion {
    mover: Mover,
    /// Path time at which the axes were last at rest on the driven path, in cycles; none at its end.
    path_time: Option<f64>,
    /// Position at which the program is held.
    held: Axes,
    /// Number of setpoints at rest since the last motion.
    rests: u32,
}

/// The motion in progress.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "a box would be allocated in the cycle")]
enum Mover {
    None,
    Transfer(Box<TransferExecutor>),
    Path(PathDrive),
}

/// A motion along the driven path, from rest to rest.
#[derive(Clone, Copy, Debug)]
struct PathDrive {
    from: f64,
    to: f64,
    limits: ScalarLimits,
    profile: Profile,
    time: f64,
    is_stopping: bool,
    /// Path time of the last setpoint, in cycles.
    now: f64,
}

/// How a motion of an excursion has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExcursionEnd {
    /// At its target.
    Arrived,
    /// By a stop.
    Stopped,
    /// By a quick stop.
    Fault,
}

impl Excursion {
    /// Begins at the position where a program is held. `None` if it cannot be left there, see
    /// [`PathExecutor::can_be_left`]. Real-time safe.
    #[must_use]
    pub fn begin(motion: &PathExecutor) -> Option<Self> {
        motion.can_be_left().then_some(Self {
            mover: Mover::None,
            path_time: None,
            held: motion.last.position,
            rests: 0,
        })
    }

    /// Whether a motion is in progress. Real-time safe.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        !matches!(self.mover, Mover::None)
    }

    /// Whether the motion in progress stops. Real-time safe.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        match &self.mover {
            Mover::None => false,
            Mover::Transfer(transfer) => transfer.is_stopping(),
            Mover::Path(drive) => drive.is_stopping,
        }
    }

    /// Begins a transfer. Real-time safe.
    ///
    /// # Errors
    /// A motion is in progress, or the transfer does not begin at the present position. The transfer is
    /// returned.
    pub fn steer(
        &mut self,
        generator: &SetpointGenerator,
        transfer: Box<TransferExecutor>,
    ) -> Result<(), Box<TransferExecutor>> {
        if self.is_moving() || !generator.can_steer(&transfer) {
            return Err(transfer);
        }
        self.rests = 0;
        self.mover = Mover::Transfer(transfer);
        Ok(())
    }

    /// Replaces the transfer in progress by one that begins at the state of the last setpoint. Returns
    /// whether it does. Real-time safe.
    pub fn turn(&mut self, generator: &SetpointGenerator, to: &TransferExecutor) -> bool {
        match &mut self.mover {
            Mover::Transfer(transfer) => generator.turn(transfer, to),
            _ => false,
        }
    }

    /// Begins a motion along the driven path: backwards by `back` block starts, or for 0 forwards to its end,
    /// where the program is held. Returns `false` without effect if a motion is in progress, the axes are not
    /// on the path, or the path is not known so far back. Real-time safe.
    pub fn retrace(
        &mut self,
        generator: &SetpointGenerator,
        path: &mut DrivenPath,
        limits: &Limits,
        back: u32,
    ) -> bool {
        let Some(end) = path.end_time() else { return false };
        let from = self.path_time.unwrap_or(end);
        let to = if back == 0 {
            Some(end)
        } else {
            path.block_start(from, back)
        };
        let is_on_path = path
            .at(from)
            .is_some_and(|point| is_near(&point.jet.position, &generator.position()));
        let Some(to) = to.filter(|to| *to != from && is_on_path && !self.is_moving()) else {
            return false;
        };
        let limits = rate_limits(limits);
        let length = (to - from).abs() * generator.period();
        self.rests = 0;
        self.mover = Mover::Path(PathDrive {
            from,
            to,
            limits,
            profile: Profile::solve(rest(), length, 0.0, 0.0, &limits),
            time: 0.0,
            is_stopping: false,
            now: from,
        });
        true
    }

    /// Number of block starts that can be reached backwards from the last position at rest on the path.
    /// Real-time safe: at most 1024 comparisons.
    #[must_use]
    pub fn blocks_before(&self, path: &DrivenPath) -> u32 {
        let time = self.path_time.or_else(|| path.end_time());
        time.map_or(0, |time| path.blocks_before(time))
    }

    /// Whether the last position at rest on the path is not its end. Real-time safe.
    #[must_use]
    pub fn is_retraced(&self) -> bool {
        self.path_time.is_some()
    }

    /// Decelerates to rest from the next setpoint on. Real-time safe.
    pub fn stop(&mut self) {
        match &mut self.mover {
            Mover::None => {}
            Mover::Transfer(transfer) => transfer.stop(),
            Mover::Path(drive) => drive.stop(),
        }
    }

    /// The next setpoint. `plan`: the setpoint of the program's executor with the same number. Real-time
    /// safe.
    pub fn step(
        &mut self,
        generator: &mut SetpointGenerator,
        path: &mut DrivenPath,
        plan: &Setpoint,
    ) -> (Setpoint, Option<ExcursionEnd>) {
        generator.set_override(plan.feed_override);
        let mut line = plan.line;
        let (mut setpoint, ended) = match &mut self.mover {
            Mover::None => {
                self.rests = self.rests.saturating_add(1);
                (generator.rest(plan.state), None)
            }
            Mover::Transfer(transfer) => {
                let setpoint = generator.steer(transfer);
                let ended = match setpoint.state {
                    MotionState::Done => Some(ExcursionEnd::Arrived),
                    MotionState::Stopped => Some(ExcursionEnd::Stopped),
                    _ => None,
                };
                (setpoint, ended)
            }
            Mover::Path(drive) => {
                let (jet, joint, at_line) = drive.advance(path, generator);
                line = at_line;
                let ended = drive.is_over().then_some(if drive.is_stopping {
                    ExcursionEnd::Stopped
                } else {
                    ExcursionEnd::Arrived
                });
                if ended.is_some() {
                    let end = path.end_time();
                    self.path_time = Some(drive.now).filter(|now| Some(*now) != end);
                }
                (generator.lead(jet, joint, drive.is_stopping), ended)
            }
        };
        let ended = if generator.is_quick_stopping() {
            Some(ExcursionEnd::Fault)
        } else {
            ended
        };
        setpoint.flags |= plan.flags & crate::flags::HOLD;
        (setpoint.line, setpoint.feed_override) = (line, plan.feed_override);
        if ended != Some(ExcursionEnd::Fault) {
            setpoint.state = plan.state;
        }
        if ended.is_some() {
            self.end(generator, path, ended == Some(ExcursionEnd::Fault));
        }
        (setpoint, ended)
    }

    /// Ends a motion. Axes near the position at which they left the path are set to exactly that position.
    fn end(&mut self, generator: &mut SetpointGenerator, path: &mut DrivenPath, by_fault: bool) {
        if matches!(self.mover, Mover::Path(_)) {
            self.mover = Mover::None;
        }
        if by_fault {
            return;
        }
        generator.end();
        let point = match self.path_time {
            None => Some(self.held),
            Some(time) => path.at(time).map(|point| point.jet.position),
        };
        if let Some(point) = point.filter(|point| is_near(point, &generator.position())) {
            generator.rest_at(point);
        }
    }

    /// Takes the transfer whose end [`Excursion::step`] has returned, so that the caller can drop it outside
    /// the cycle.
    pub fn take_spent(&mut self) -> Option<Box<TransferExecutor>> {
        match std::mem::replace(&mut self.mover, Mover::None) {
            Mover::Transfer(transfer) => Some(transfer),
            _ => None,
        }
    }

    /// Returns the axes to the program if they have been at rest at its held position for four setpoints. The
    /// excursion is over if this returns `true`. Real-time safe.
    pub fn give_back(&self, generator: &SetpointGenerator, motion: &mut PathExecutor) -> bool {
        let is_back = !self.is_moving()
            && self.path_time.is_none()
            && self.rests >= SETTLED
            && generator.position() == self.held;
        if is_back {
            motion.rejoin(generator.guard());
        }
        is_back
    }
}

impl PathDrive {
    fn stop(&mut self) {
        if self.is_stopping {
            return;
        }
        self.is_stopping = true;
        let (now, _) = self.profile.at(self.time);
        self.profile = Profile::brake(now, f64::INFINITY, 0.0, &self.limits);
        self.time = 0.0;
    }

    fn is_over(&self) -> bool {
        self.time >= self.profile.duration()
    }

    /// The next position and derivatives by time; whether it is at an exact-path joint; its line.
    fn advance(&mut self, path: &mut DrivenPath, generator: &SetpointGenerator) -> (Jet, bool, u32) {
        let period = generator.period();
        self.time += period;
        let (now, jerk) = self.profile.at(self.time);
        let (sign, length) = ((self.to - self.from).signum(), (self.to - self.from).abs());
        let travelled = now.x / period;
        let is_at_end = self.is_over() && (!self.is_stopping || travelled >= length);
        self.now = if is_at_end {
            self.to
        } else {
            self.from + sign * travelled.clamp(0.0, length)
        };
        let Some(point) = path.at(self.now) else {
            return (Jet::at_rest(generator.position()), false, 0);
        };
        let jet = if self.is_over() {
            Jet::at_rest(point.jet.position)
        } else {
            let rate = sign / period;
            point.jet.compose(rate * now.v, rate * now.a, rate * jerk)
        };
        (jet, point.joint, point.line)
    }
}

const fn rest() -> ScalarState {
    ScalarState {
        x: 0.0,
        v: 0.0,
        a: 0.0,
    }
}

/// Limits of the rate of path time, see [`RATE`].
fn rate_limits(limits: &Limits) -> ScalarLimits {
    let (mut acceleration, mut jerk) = (f64::INFINITY, f64::INFINITY);
    for i in 0..AXES {
        if !limits.present[i] {
            continue;
        }
        let (v, a, j) = (limits.velocity[i], limits.acceleration[i], limits.jerk[i]);
        acceleration = acceleration.min(0.6 * a / v).min(0.25 * j / (3.0 * RATE * a));
        jerk = jerk.min(0.25 * j / v);
    }
    ScalarLimits {
        velocity: RATE,
        acceleration,
        jerk,
    }
}

fn is_near(a: &Axes, b: &Axes) -> bool {
    (a - b).iter().all(|distance| distance.abs() <= NEAR)
}

#[cfg(test)]
mod tests {
    use evolvent_random::Random;

    use super::*;

    #[test]
    fn a_path_at_every_limit_is_retraced_within_limits() {
        let mut random = Random::seeded(1604);
        for _ in 0..1000 {
            let mut limits = Limits {
                present: [true; AXES],
                velocity: Axes::repeat(1000.0),
                acceleration: Axes::repeat(1000.0),
                jerk: Axes::repeat(1000.0),
                travel_min: Axes::repeat(-40.0),
                travel_max: Axes::repeat(40.0),
                home: Axes::zeros(),
            };
            for i in 0..3 {
                limits.velocity[i] = random.log(1.0, 2000.0);
                limits.acceleration[i] = random.log(10.0, 50_000.0);
                limits.jerk[i] = random.log(100.0, 2e7);
            }
            let rate = rate_limits(&limits);
            let (r, rises, jerks) = (rate.velocity, rate.acceleration, rate.jerk);
            for i in 0..3 {
                let (v, a, j) = (limits.velocity[i], limits.acceleration[i], limits.jerk[i]);
                assert!(v * r <= 0.5 * v && a * r * r + v * rises <= 0.851 * a);
                let jerk = 2.18 * j * r * r * r + 3.0 * a * r * rises + v * jerks;
                assert!(jerk <= 0.78 * j, "{jerk} of {j}");
            }
        }
    }
}
