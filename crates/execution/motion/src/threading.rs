//! Threading: motion that follows the angle of the spindle, between two steps of a plan.
//!
//! Meanwhile the plan does not advance, and the program is not read on. The path is a function of the spindle
//! angle ([`ThreadCam`](crate::thread_cam::ThreadCam)), so every pass is in the same groove, at any speed and
//! after any changes of speed: the axes start before the angle at which the thread begins, so early that they
//! are in phase there. A third-order follower drives them along it. Its corrections for an uneven spindle
//! stay within the acceleration and jerk that the path leaves.

use evolvent_machine::Limits;
use evolvent_path::{Axes, Jet};
use evolvent_signals::{AngleJet, SpindleInput, SpindleKnowledge};

use crate::path_executor::PathExecutor;
use crate::queue::PlanConsumer;
use crate::setpoint::{Inputs, Setpoint};
use crate::thread_cam::{SPEED_RESERVE, ThreadCam, ThreadLeg, ThreadObjection};
use crate::thread_follower::ThreadFollower;
use crate::thread_landing::Landing;
use crate::thread_retreat::ThreadRetreat;
use crate::thread_ripple::FollowedRipple;

/// Maximum distance of the axes from the position for the spindle angle, mm; beyond it the pass is given up.
const PHASE_TOLERANCE_MM: f64 = 0.1;
/// The same as a fraction of the pitch, if that is more, from the moment when the spindle of a tap is commanded
/// to stop or to turn back. Nobody can predict when it does, and what the axes lose meanwhile they recover; a
/// tap that is given up in the hole breaks.
const REVERSAL_TOLERANCE: f64 = 0.25;
/// Ratio of the spindle speed to that at the start of a pass below which the spindle counts as stalled.
const STALL_RATIO: f64 = 0.2;
/// The same ratio below which a spindle that was ordered off counts as stopped: at 20 turns/s and 10 turns/s2
/// it turns by another 0.008.
const REST_RATIO: f64 = 0.02;
/// Maximum time below [`STALL_RATIO`] where it does no harm, s, and in turns at the speed of the pass. Some
/// drives wait at zero speed when a tap reverses. Before the run-in nothing moves, and an encoder of few
/// lines reports a slow speed in jumps.
const STALL_TIMEOUT_S: f64 = 0.5;
const STALL_TIMEOUT_TURNS: f64 = 0.5;
/// Factor by which a reversal of the spindle may take longer than its braking rate implies.
const REVERSAL_MARGIN: f64 = 2.0;
/// Ratio of the spindle speed to that at the start of a pass, or to the return speed of a tap, above which
/// the pass is given up: no command requests such a speed.
const RUNAWAY_RATIO: f64 = 1.5;
/// Time above [`RUNAWAY_RATIO`] after which it is, s: the estimated speed overshoots where a spindle reverses
/// within some samples. The axes follow meanwhile.
const RUNAWAY_TIMEOUT_S: f64 = 0.1;
/// Maximum distance of a tap beyond its depth while the spindle has not turned back: this number of turns,
/// plus its turns in this number of seconds if its braking rate is unknown.
const OVERRUN_TURNS: f64 = 2.0;
const OVERRUN_S: f64 = 0.5;
/// Time in which a spindle is expected to stop from its speed if its braking rate is unknown, s: that of the
/// virtual clock. What a tap needs beyond its depth follows from it.
const EXPECTED_STOP_S: f64 = 0.25;
/// Maximum delay expected between the setpoint of a reversal and the spindle, s.
const REVERSAL_DELAY_S: f64 = 0.005;
/// Expected deviation of the braking distance, as a fraction: twice that of the speed.
const BRAKING_TOLERANCE: f64 = 0.02;
/// Maximum time until the angle of the spindle is reported and known before a pass, s.
const KNOWLEDGE_TIMEOUT_S: f64 = 10.0;
/// Minimum turns before the run-in begins: the pass does not start at an angle that has just passed.
const HEAD_START_TURNS: f64 = 0.02;

/// A spindle that turns back at the end of the thread: rigid tapping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TapReturn {
    /// Speed out of the hole, turns/s.
    pub turns_per_s: f64,
    /// Rate at which the spindle changes its speed, turns/s^2, if known: it is reversed that much earlier,
    /// and the tap stops at the depth. Otherwise it is reversed at the depth, and the tap overruns by the
    /// distance that the spindle needs.
    pub braking: Option<f64>,
}

impl TapReturn {
    /// Turns before the depth at which the spindle is reversed at this speed, turns/s.
    fn braking_turns(&self, turns_per_s: f64) -> f64 {
        self.braking
            .map_or(0.0, |rate| turns_per_s * turns_per_s / (2.0 * rate))
    }

    /// Turns beyond the depth that the spindle is expected to need at this speed, turns/s.
    fn overrun_turns(&self, turns_per_s: f64) -> f64 {
        let stopping = if self.braking.is_some() {
            0.0
        } else {
            0.5 * EXPECTED_STOP_S * turns_per_s
        };
        stopping + REVERSAL_DELAY_S * turns_per_s + BRAKING_TOLERANCE * self.braking_turns(turns_per_s)
    }
}

/// A pass as programmed.
#[derive(Clone, Debug, PartialEq)]
pub struct ThreadPass {
    /// Start position, machine coordinates (mm, degrees).
    pub start: Axes,
    /// Its straight pieces.
    pub legs: Box<[ThreadLeg]>,
    /// Angle at which it begins, as a fraction of a turn from the index pulse: 0 except for multi-start
    /// threads.
    pub start_turns: f64,
    /// Commanded speed, turns/s, negative counter-clockwise.
    pub turns_per_s: f64,
    /// The spindle turns back at the end, and the axes with it to the start.
    pub tap: Option<TapReturn>,
    /// Permitted distance between the chord of two setpoints and the path, mm.
    pub chord_error_mm: f64,
    /// Maximum age of the spindle's angle, s. The axes follow the predicted angle meanwhile.
    pub max_angle_age_s: f64,
    /// An axis and its position at which the tool is clear of the thread: an aborted pass retracts to it.
    pub clear_at: Option<(usize, f64)>,
}

impl ThreadPass {
    /// Whether a machine can cut this thread at the commanded speed. Returns the run-in, mm along the first
    /// leg.
    ///
    /// # Errors
    /// The limit that it cannot keep.
    pub fn check(&self, limits: &Limits, period_s: f64) -> Result<f64, ThreadObjection> {
        let mut cam = ThreadCam::new(
            self.start,
            self.legs.clone(),
            self.tap.is_some(),
            self.chord_error_mm,
        );
        let out = self.tap.map_or(0.0, |tap| tap.turns_per_s);
        cam.shape(self.turns_per_s.abs().max(out), limits, period_s)?;
        if let Some(tap) = self.tap {
            if let Some(rate) = tap.braking {
                let change = self.turns_per_s.abs() + tap.turns_per_s;
                cam.check_reversal(rate, change, reversal_tolerance(&cam), limits)?;
            }
            cam.check_overrun(tap.overrun_turns(self.turns_per_s.abs()), limits)?;
        }
        let first = self
            .legs
            .first()
            .map_or(0.0, |leg| (leg.end - self.start).norm() / leg.turns);
        Ok(first * cam.run_in_turns())
    }
}

/// Maximum distance of the axes from the position for the spindle angle while a tap's spindle stops or reverses, mm.
fn reversal_tolerance(cam: &ThreadCam) -> f64 {
    PHASE_TOLERANCE_MM.max(REVERSAL_TOLERANCE * cam.steepest())
}

/// How a pass has ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ThreadVerdict {
    /// At its end; for a tap, back at its start.
    Done,
    /// The spindle angle is not reported, or its index pulse was not seen: nothing has moved.
    Unknown,
    /// It cannot be cut at the present spindle speed: nothing has moved.
    Refused(ThreadObjection),
    /// The spindle angle is no longer reported: the axes have stopped.
    Lost,
    /// The spindle has slowed down too much: the axes have stopped.
    Stalled,
    /// The axes could not follow the spindle: they have stopped.
    OutOfPhase,
    /// The spindle has not turned back at the depth of a tap: the axes have stopped.
    NotTurnedBack,
    /// The spindle has turned so far beyond the depth of a tap that the travel ends: the axes have stopped.
    AtTravelEnd,
}

/// The result of a pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThreadResult {
    /// How the pass has ended.
    pub verdict: ThreadVerdict,
    /// Final position of the axes.
    pub stop_position: Axes,
    /// It was given up, and the tool was retracted from the thread.
    pub is_clear: bool,
    /// Maximum distance of an axis from the position for the spindle angle, mm, once it was in phase.
    pub worst_mm: f64,
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    /// At rest before the pass, for this many seconds.
    Waiting(f64),
    /// Following the spindle. `turned`: the spindle has been commanded to turn back.
    Following {
        turned: bool,
    },
    /// Removing the remaining error of the follower.
    Landing(Landing),
    /// Given up.
    Stopping(ThreadRetreat, ThreadVerdict),
    Over(ThreadVerdict),
}

/// A pass, driven setpoint by setpoint. It is built outside the cycle and passed in a box by a
/// [`ThreadingSender`](crate::ThreadingSender), before the plan's
/// [`Step::Thread`](evolvent_planner::Step::Thread), and returned with its result.
#[derive(Clone, Debug)]
pub struct Threading {
    cam: ThreadCam,
    follower: ThreadFollower,
    limits: Limits,
    start_turns: f64,
    turns_per_s: f64,
    tap: Option<TapReturn>,
    max_angle_age_s: f64,
    clear_at: Option<(usize, f64)>,
    phase: Phase,
    /// Angle of the spindle at which the thread begins, turns in the direction of rotation.
    origin: Option<f64>,
    /// Speed at the start of the pass.
    begun_at: f64,
    /// Once the pass has begun.
    followed_ripple: Option<FollowedRipple>,
    /// Time since a stop of a tap was requested, s: it follows the spindle until that stops.
    stopping_s: Option<f64>,
    /// Time for which the spindle has been slower than [`STALL_RATIO`], s.
    slow_s: f64,
    /// Time for which the spindle has been faster than [`RUNAWAY_RATIO`], s.
    fast_s: f64,
    /// Last angle since the origin, and its speed.
    turns: f64,
    speed: f64,
    now: Jet,
    worst_mm: f64,
    result: Option<ThreadResult>,
}

/// Effects of a setpoint of a pass other than motion.
struct Driven {
    jet: Jet,
    /// The next action of the program takes effect: the spindle turns back, or forward again.
    acts: bool,
}

impl Threading {
    /// A pass from rest.
    #[must_use]
    pub fn new(pass: ThreadPass, limits: &Limits) -> Self {
        let ThreadPass {
            start,
            legs,
            start_turns,
            turns_per_s,
            tap,
            chord_error_mm,
            max_angle_age_s,
            clear_at,
        } = pass;
        Self {
            follower: ThreadFollower::new(limits, &start, &legs),
            cam: ThreadCam::new(start, legs, tap.is_some(), chord_error_mm),
            limits: *limits,
            start_turns,
            turns_per_s,
            tap,
            max_angle_age_s,
            clear_at,
            phase: Phase::Waiting(0.0),
            origin: None,
            begun_at: 0.0,
            followed_ripple: None,
            stopping_s: None,
            slow_s: 0.0,
            fast_s: 0.0,
            turns: 0.0,
            speed: 0.0,
            now: Jet::at_rest(start),
            worst_mm: 0.0,
            result: None,
        }
    }

    /// The result, once the pass is over.
    #[must_use]
    pub fn result(&self) -> Option<ThreadResult> {
        self.result
    }

    /// Whether nothing moves. Real-time safe.
    pub(crate) fn is_at_rest(&self) -> bool {
        match &self.phase {
            Phase::Waiting(_) | Phase::Over(_) => true,
            Phase::Following { .. } | Phase::Landing(_) => false,
            Phase::Stopping(stop, _) => stop.is_over(),
        }
    }

    /// Angle in the direction of rotation, its speed and acceleration, and the third derivative of the
    /// followed part of its ripple.
    fn angle(&self, spindle: &SpindleInput) -> Option<(AngleJet, f64)> {
        match spindle.knowledge {
            SpindleKnowledge::Tracked | SpindleKnowledge::Imagined => {
                let direction = self.turns_per_s.signum();
                let turns = direction * spindle.mean[0] - self.origin.unwrap_or(0.0);
                let (angle, third) = match &self.followed_ripple {
                    Some(followed) => {
                        followed.add(&spindle.mean, &spindle.ripple, turns, direction, &self.cam)
                    }
                    None => (spindle.mean, 0.0),
                };
                Some((angle.map(|value| direction * value), direction * third))
            }
            SpindleKnowledge::Unknown | SpindleKnowledge::Seeking => None,
        }
    }

    /// At rest before the pass: starts it when the angle approaches.
    fn wait(&mut self, spindle: &SpindleInput, waited: f64, period_s: f64) {
        let Some((angle, _)) = self.angle(spindle) else {
            self.phase = if waited > KNOWLEDGE_TIMEOUT_S {
                Phase::Over(ThreadVerdict::Unknown)
            } else {
                Phase::Waiting(waited + period_s)
            };
            return;
        };
        if spindle.knowledge == SpindleKnowledge::Imagined && angle[2] != 0.0 {
            // No wait of the program has seen the spindle reach its speed; it will.
            return;
        }
        if angle[1] < STALL_RATIO * self.turns_per_s.abs() {
            self.phase = if waited > KNOWLEDGE_TIMEOUT_S {
                Phase::Over(ThreadVerdict::Stalled)
            } else {
                Phase::Waiting(waited + period_s)
            };
            return;
        }
        // A tap returns along the same path, and perhaps faster.
        let fastest = self.tap.map_or(angle[1], |tap| angle[1].max(tap.turns_per_s));
        if let Err(objection) = self.cam.shape(fastest, &self.limits, period_s) {
            self.phase = Phase::Over(ThreadVerdict::Refused(objection));
            return;
        }
        let overrun = self
            .tap
            .map_or(0.0, |tap| tap.overrun_turns(angle[1] / SPEED_RESERVE));
        if let Err(objection) = self.cam.check_overrun(overrun, &self.limits) {
            self.phase = Phase::Over(ThreadVerdict::Refused(objection));
            return;
        }
        self.followed_ripple = Some(FollowedRipple::new(self.cam.steepest(), &self.limits));
        self.begun_at = angle[1];
        // The next turn whose run-in is still ahead.
        let head_start = HEAD_START_TURNS + 2.0 * angle[1] * period_s;
        // A tap shorter than the braking distance of its spindle also needs the rest of it.
        let braking = self.tap.map_or(0.0, |tap| tap.braking_turns(angle[1]));
        let lead = self.cam.run_in_turns().max(braking - self.cam.turns());
        let begins = angle[0] + head_start + lead - self.start_turns;
        self.origin = Some(begins.ceil() + self.start_turns);
        self.phase = Phase::Following { turned: false };
    }

    /// Gives the pass up: every axis stops on its own, and the tool is retracted if the direction is known.
    /// Each axis stops sooner than in the run-out, so none overshoots the end.
    fn give_up(&mut self, verdict: ThreadVerdict) {
        self.phase = Phase::Stopping(
            ThreadRetreat::new(&self.limits, &self.now, self.clear_at),
            verdict,
        );
    }

    /// Whether a stop of the pass follows the spindle, which is ordered off, until it stops: a tap would break
    /// in the hole if the spindle turned on alone. Not if the spindle takes much longer than expected.
    fn follows_to_rest(&self, spindle: &SpindleInput) -> bool {
        let Some(tap) = self.tap else {
            return false;
        };
        let in_the_hole = self.turns > -self.cam.run_in_turns();
        let turns = self.speed.abs() > REST_RATIO * self.begun_at;
        let max_s =
            STALL_TIMEOUT_S + REVERSAL_MARGIN * self.begun_at.max(tap.turns_per_s) / self.braking(tap);
        let is_timely = self.stopping_s.is_none_or(|seconds| seconds < max_s);
        spindle.knowledge == SpindleKnowledge::Tracked && in_the_hole && turns && is_timely
    }

    fn follow(&mut self, spindle: &SpindleInput, turned: bool, period_s: f64) -> bool {
        let (run_out, ended) = self.cam.run_out();
        let known = self
            .angle(spindle)
            .filter(|_| spindle.age_s <= self.max_angle_age_s);
        let (angle, third) = match known {
            Some((angle, third)) => ([angle[0] - self.origin.unwrap_or(0.0), angle[1], angle[2]], third),
            // The pass ends here in any case, with the last known speed.
            None if self.turns >= run_out => ([self.turns + self.speed * period_s, self.speed, 0.0], 0.0),
            None => {
                self.give_up(ThreadVerdict::Lost);
                self.come_to_rest(period_s);
                return false;
            }
        };
        (self.turns, self.speed) = (angle[0], angle[1]);
        self.cam.reshape(angle[0], angle[1].abs(), &self.limits, period_s);
        let cam = self.cam.at(angle[0]);
        let want = cam.compose(angle[1], angle[2], third);
        self.now = self.follower.advance(&self.now, &want, period_s);
        let error = (self.now.position - want.position).abs().max();
        let run_in = self.cam.run_in_turns();
        if angle[0] > -run_in {
            self.worst_mm = self.worst_mm.max(error);
        }
        let ratio = match self.tap {
            Some(tap) if turned => -angle[1] / tap.turns_per_s,
            _ => angle[1] / self.begun_at,
        };
        let has_begun = angle[0] > -run_in;
        let is_stopping = self.stopping_s.is_some();
        self.fast_s = if ratio > RUNAWAY_RATIO {
            self.fast_s + period_s
        } else {
            0.0
        };
        let runs_away = self.fast_s > RUNAWAY_TIMEOUT_S;
        let tolerance_mm = if self.tap.is_some() && (turned || is_stopping) {
            reversal_tolerance(&self.cam)
        } else {
            PHASE_TOLERANCE_MM
        };
        if error > tolerance_mm || runs_away {
            let is_at_edge = !runs_away && self.tap.is_some() && self.follower.leaves_travel(&want);
            self.give_up(if is_at_edge {
                ThreadVerdict::AtTravelEnd
            } else {
                ThreadVerdict::OutOfPhase
            });
            return false;
        }
        if let Some(tap) = self.tap {
            let depth = self.cam.turns();
            if !turned && !is_stopping && angle[0] + tap.braking_turns(angle[1]) >= depth {
                self.phase = Phase::Following { turned: true };
                return true;
            }
            let overrun = self.begun_at * self.begun_at / (2.0 * self.braking(tap));
            if (turned || is_stopping) && angle[0] > depth + OVERRUN_TURNS + overrun {
                self.give_up(ThreadVerdict::NotTurnedBack);
                return false;
            }
            if turned && angle[1] < 0.0 && angle[0] <= -run_in {
                self.land(self.cam.start(), period_s);
                return true;
            }
        } else if angle[0] >= ended {
            self.land(self.cam.end(), period_s);
            return false;
        }
        // While it turns back it may still be fast in the other direction.
        let is_slow = if turned { ratio.abs() } else { ratio } < STALL_RATIO;
        if is_slow && !is_stopping {
            self.slow_s += period_s;
        } else {
            self.slow_s = 0.0;
        }
        if self.slow_s > self.stall_timeout(turned, has_begun) {
            self.give_up(ThreadVerdict::Stalled);
        }
        false
    }

    /// Braking rate of the spindle, turns/s^2.
    fn braking(&self, tap: TapReturn) -> f64 {
        tap.braking.unwrap_or(self.begun_at / (2.0 * OVERRUN_S))
    }

    /// Maximum time for which the spindle may be slower than [`STALL_RATIO`] in this part of the pass, s.
    fn stall_timeout(&self, turned: bool, has_begun: bool) -> f64 {
        let patience = |turns_per_s: f64| STALL_TIMEOUT_S.max(STALL_TIMEOUT_TURNS / turns_per_s);
        match self.tap {
            Some(tap) if turned => {
                let slow = STALL_RATIO * tap.turns_per_s;
                let passed = slow + slow.min(self.begun_at);
                patience(tap.turns_per_s) + REVERSAL_MARGIN * passed / self.braking(tap)
            }
            _ if has_begun => 0.0,
            _ => patience(self.begun_at),
        }
    }

    /// One period of the final correction or of stopping.
    fn come_to_rest(&mut self, period_s: f64) {
        match &mut self.phase {
            Phase::Landing(landing) => {
                self.now = landing.advance(&self.limits, period_s);
                if landing.is_over() {
                    self.phase = Phase::Over(ThreadVerdict::Done);
                }
            }
            Phase::Stopping(stop, verdict) => {
                self.now = stop.advance(period_s);
                if stop.is_over() {
                    self.phase = Phase::Over(*verdict);
                }
            }
            _ => {}
        }
    }

    fn land(&mut self, end: Axes, period_s: f64) {
        let landing = Landing::new(&self.now, end, &self.limits, &self.follower, period_s);
        self.phase = Phase::Landing(landing);
    }

    /// One period; `hold` and `stop` are those of the inputs.
    fn advance(&mut self, spindle: &SpindleInput, hold: bool, stop: bool, period_s: f64) -> Driven {
        let mut acts = false;
        match self.phase {
            Phase::Waiting(waited) if !hold && !stop => self.wait(spindle, waited, period_s),
            Phase::Waiting(_) | Phase::Over(_) => {}
            Phase::Following { .. } if stop && !self.follows_to_rest(spindle) => {
                self.give_up(ThreadVerdict::Lost);
                self.come_to_rest(period_s);
            }
            Phase::Following { turned } => {
                if stop {
                    self.stopping_s = Some(self.stopping_s.unwrap_or(0.0) + period_s);
                }
                acts = self.follow(spindle, turned, period_s);
            }
            Phase::Landing(_) | Phase::Stopping(..) => self.come_to_rest(period_s),
        }
        if let Phase::Over(verdict) = self.phase {
            self.result = Some(ThreadResult {
                verdict,
                stop_position: self.now.position,
                is_clear: verdict != ThreadVerdict::Done
                    && self
                        .clear_at
                        .is_some_and(|(axis, clear)| self.now.position[axis] == clear),
                worst_mm: self.worst_mm,
            });
        }
        Driven { jet: self.now, acts }
    }
}

impl PathExecutor {
    /// One setpoint of a pass.
    pub(crate) fn thread(&mut self, inputs: &Inputs, queue: &mut PlanConsumer) -> Setpoint {
        let Some(threading) = &mut self.threading else {
            return self.step_quick_stop();
        };
        let Driven { jet, acts } = threading.advance(&inputs.spindle, inputs.hold, self.stop, self.period);
        let (is_at_rest, is_over) = (threading.is_at_rest(), threading.result.is_some());
        let line = threading.cam.line(threading.turns);
        if !self.accept(&jet) {
            return self.step_quick_stop();
        }
        self.cursor.line = line;
        if acts {
            self.cursor.actions += 1;
        }
        // A held pass is driven to its end: a tool that stops in a turning groove would spoil it, or break.
        let is_held = inputs.hold && !self.stop;
        self.cursor.state = self.takeover_state(is_held, is_at_rest);
        if is_over && !self.stop {
            self.resume_plan_at(&jet);
            if let Some(threading) = self.threading.take() {
                queue.threadings.give_back(threading);
            }
        }
        self.takeover_setpoint(jet, is_held)
    }
}
