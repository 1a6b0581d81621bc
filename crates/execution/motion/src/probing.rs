//! Probing: a straight move that ends where the probe trips, between two steps of a plan.
//!
//! Meanwhile the plan does not advance, and the program is not read on: the plan continues where the axes
//! have stopped.

use evolvent_machine::Limits;
use evolvent_path::{Axes, Curve, Jet};
use evolvent_planner::{Profile, ScalarLimits, ScalarState};
use evolvent_signals::{ProbeInput, ProbeState};

use crate::path_executor::PathExecutor;
use crate::queue::PlanConsumer;
use crate::setpoint::{Inputs, Setpoint};

/// Rest before the move, s, in addition to the lead. By then the position of an earlier contact has arrived
/// and is not attributed to this move. Drives settle in less time.
const SETTLE_S: f64 = 0.03;
/// Rest at the end of a move without contact, s, in addition to the lead: axes lag behind, and a contact is
/// reported late.
const LINGER_S: f64 = 0.03;
/// Maximum time until the position of a contact arrives, s.
const POSITION_TIMEOUT_S: f64 = 0.5;
/// Fraction of acceleration and jerk that is used: third differences of doubles are noisy.
const USED_FRACTION: f64 = 0.99;

/// A probing move as programmed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbeMove {
    /// The longest path: a straight line.
    pub curve: Curve,
    /// Speed along it, mm/s (degrees/s if only rotary axes move).
    pub feed_mm_s: f64,
    /// Whether the move ends when contact is made; otherwise when it is lost.
    pub toward: bool,
}

impl ProbeMove {
    /// The limits of the axes along the line.
    fn limits(&self, limits: &Limits) -> ScalarLimits {
        let direction = self.curve.jet(0.0).first;
        let min = |of: &Axes| {
            (0..direction.len())
                .filter(|&axis| limits.present[axis] && direction[axis] != 0.0)
                .map(|axis| of[axis] / direction[axis].abs())
                .fold(f64::INFINITY, f64::min)
        };
        ScalarLimits {
            velocity: self.feed_mm_s.min(min(&limits.velocity)),
            acceleration: USED_FRACTION * min(&limits.acceleration),
            jerk: USED_FRACTION * min(&limits.jerk),
        }
    }

    /// Maximum distance that the axes travel after the cycle has seen the contact, mm. It is less near the
    /// end of the move.
    #[must_use]
    pub fn stopping_distance(&self, limits: &Limits) -> f64 {
        let limits = self.limits(limits);
        let from = ScalarState {
            x: 0.0,
            v: limits.velocity,
            a: 0.0,
        };
        Profile::brake(from, f64::INFINITY, 0.0, &limits).end().x
    }
}

/// How a probing move has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeVerdict {
    /// The probe has changed as requested.
    Contact,
    /// The probe has not changed up to the end.
    NoContact,
    /// The probe had changed before the move, which was not started.
    ChangedBefore,
    /// The probe is no longer reported: the axes have stopped.
    Lost,
    /// The probe was not reported before the move, which was not started.
    Unknown,
    /// The position of the contact was not reported in time.
    NoPosition,
    /// With the virtual clock no contact is known: the axes are at the end of the move.
    Imagined,
}

/// The result of a probing move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbeResult {
    /// How the move has ended.
    pub verdict: ProbeVerdict,
    /// Position of the contact, machine coordinates (mm, degrees); without contact, the position of the axes.
    pub position: Axes,
    /// Final position of the axes.
    pub stop_position: Axes,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// At rest before the move, for this many more seconds.
    Settling(f64),
    Moving,
    /// At rest at the end without contact, for this many more seconds.
    Lingering(f64),
    /// At rest after a contact whose position has yet to come, for this many more seconds.
    Awaiting(f64),
    Over,
}

/// The goal for which the profile in force was solved.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Wanted {
    Rest,
    Speed(f64),
}

/// A probing move, driven setpoint by setpoint. Built outside the cycle and handed over in a box by a
/// [`ProbingSender`](crate::ProbingSender), before the plan's [`Step::Probe`](evolvent_planner::Step::Probe),
/// which hands it back with its result.
#[derive(Clone, Debug)]
pub struct Probing {
    order: ProbeMove,
    limits: ScalarLimits,
    lead_s: f64,
    phase: Phase,
    profile: Profile,
    time: f64,
    wanted: Wanted,
    verdict: Option<ProbeVerdict>,
    /// Number of changes of the probe before the move.
    changes_before: u32,
    contact: Option<Axes>,
    result: Option<ProbeResult>,
}

impl Probing {
    /// A move from rest. `lead_s` is the time from the computation of a setpoint until it is due.
    #[must_use]
    pub fn new(order: ProbeMove, limits: &Limits, lead_s: f64) -> Self {
        Self {
            order,
            limits: order.limits(limits),
            lead_s,
            phase: Phase::Settling(lead_s + SETTLE_S),
            profile: Profile::at_rest(0.0),
            time: 0.0,
            wanted: Wanted::Rest,
            verdict: None,
            changes_before: 0,
            contact: None,
            result: None,
        }
    }

    /// The result, once the move is over.
    #[must_use]
    pub fn result(&self) -> Option<ProbeResult> {
        self.result
    }

    /// Whether nothing moves. Real-time safe.
    pub(crate) fn is_at_rest(&self) -> bool {
        self.phase != Phase::Moving || self.has_stopped()
    }

    fn has_stopped(&self) -> bool {
        self.wanted == Wanted::Rest && self.time >= self.profile.duration()
    }

    fn position(&self) -> Axes {
        self.order
            .curve
            .jet(self.profile.at(self.time).0.x.min(self.order.curve.domain()))
            .position
    }

    /// Processes the probe: a change counts however short it was.
    fn observe(&mut self, probe: &ProbeInput) {
        let has_changed = if self.order.toward {
            probe.was_tripped
        } else {
            probe.was_open
        };
        match self.phase {
            Phase::Settling(_) => self.changes_before = probe.now.changes,
            Phase::Moving | Phase::Lingering(_) if self.verdict.is_none() => {
                if has_changed {
                    self.verdict = Some(ProbeVerdict::Contact);
                } else if probe.now.state == ProbeState::Unknown {
                    self.verdict = Some(ProbeVerdict::Lost);
                }
            }
            _ => {}
        }
        // The first position after the start of the move; positions of a bounce come later.
        if self.verdict == Some(ProbeVerdict::Contact)
            && self.contact.is_none()
            && probe.now.changes != self.changes_before
        {
            self.contact = Some(Axes::from_column_slice(&probe.now.position));
        }
    }

    /// The reason why the move may not start, if any.
    fn objection(&self, probe: &ProbeInput) -> Option<ProbeVerdict> {
        match (probe.now.state, self.order.toward) {
            (ProbeState::Unknown, _) => Some(ProbeVerdict::Unknown),
            (ProbeState::Tripped, true) | (ProbeState::Open, false) => Some(ProbeVerdict::ChangedBefore),
            _ => None,
        }
    }

    fn drive(&mut self, wanted: Wanted) {
        if wanted == self.wanted {
            return;
        }
        let (from, _) = self.profile.at(self.time);
        let length = self.order.curve.domain();
        self.profile = match wanted {
            Wanted::Rest => Profile::brake(from, length, 0.0, &self.limits),
            Wanted::Speed(velocity) => {
                let limits = ScalarLimits {
                    velocity,
                    ..self.limits
                };
                Profile::solve(from, length, 0.0, 0.0, &limits)
            }
        };
        (self.wanted, self.time) = (wanted, 0.0);
    }

    /// One period. `brake` for a hold or stop; `factor` scales the feed.
    fn advance(&mut self, probe: &ProbeInput, brake: bool, factor: f64, period: f64) -> Jet {
        self.observe(probe);
        match self.phase {
            Phase::Settling(left) if left > 0.0 => self.phase = Phase::Settling(left - period),
            Phase::Settling(_) if brake => {}
            Phase::Settling(_) => {
                self.verdict = self.objection(probe);
                self.phase = if self.verdict.is_some() {
                    Phase::Over
                } else {
                    Phase::Moving
                };
            }
            _ => {}
        }
        let mut jet = Jet::at_rest(self.position());
        if self.phase == Phase::Moving {
            let stops = brake || self.verdict.is_some() || factor <= 0.0;
            // Never faster than programmed: the error of the position grows with the speed.
            let speed = self.limits.velocity * factor.min(1.0);
            self.drive(if stops { Wanted::Rest } else { Wanted::Speed(speed) });
            self.time += period;
            let (now, jerk) = self.profile.at(self.time);
            let length = self.order.curve.domain();
            if self.time < self.profile.duration() {
                jet = self
                    .order
                    .curve
                    .jet(now.x.min(length))
                    .compose(now.v, now.a, jerk);
            } else {
                jet = Jet::at_rest(self.position());
                let is_imagined = probe.now.state == ProbeState::Imagined;
                self.phase = match self.verdict {
                    Some(ProbeVerdict::Contact) => Phase::Awaiting(POSITION_TIMEOUT_S),
                    Some(_) => Phase::Over,
                    // Held or stopped before the end.
                    None if self.wanted == Wanted::Rest => Phase::Moving,
                    None if is_imagined => {
                        self.verdict = Some(ProbeVerdict::Imagined);
                        Phase::Over
                    }
                    None => Phase::Lingering(self.lead_s + LINGER_S),
                };
            }
        } else if let Phase::Lingering(left) = self.phase {
            self.phase = match self.verdict {
                Some(ProbeVerdict::Contact) => Phase::Awaiting(POSITION_TIMEOUT_S),
                Some(_) => Phase::Over,
                None if left > 0.0 => Phase::Lingering(left - period),
                None => {
                    self.verdict = Some(ProbeVerdict::NoContact);
                    Phase::Over
                }
            };
        }
        if let Phase::Awaiting(left) = self.phase {
            if self.contact.is_some() {
                self.phase = Phase::Over;
            } else if left > 0.0 {
                self.phase = Phase::Awaiting(left - period);
            } else {
                self.verdict = Some(ProbeVerdict::NoPosition);
                self.phase = Phase::Over;
            }
        }
        if let (Phase::Over, Some(verdict)) = (self.phase, self.verdict) {
            let stop_position = jet.position;
            let position = self.contact.unwrap_or(stop_position);
            self.result = Some(ProbeResult {
                verdict,
                position,
                stop_position,
            });
        }
        jet
    }
}

impl PathExecutor {
    /// One setpoint of a probing move.
    pub(crate) fn probe(&mut self, inputs: &Inputs, queue: &mut PlanConsumer) -> Setpoint {
        let Some(probing) = &mut self.probing else {
            return self.step_quick_stop();
        };
        let brake = inputs.hold || self.stop;
        let jet = probing.advance(&inputs.probe, brake, self.feed_override, self.period);
        let (is_at_rest, is_over) = (probing.is_at_rest(), probing.result.is_some());
        if !self.accept(&jet) {
            return self.step_quick_stop();
        }
        let is_held = inputs.hold && !self.stop;
        self.cursor.state = self.takeover_state(is_held, is_at_rest);
        if is_over && !self.stop {
            self.resume_plan_at(&jet);
            if let Some(probing) = self.probing.take() {
                queue.probings.give_back(probing);
            }
        }
        self.takeover_setpoint(jet, is_held)
    }
}
