//! Finding machine zero of one axis.

use evolvent_machine::HomingMethod;
use evolvent_path::{AXES, AxisMask};

use crate::alarm::Alarm;
use crate::homing::{HomingAction, HomingAxis, HomingSample};
use crate::rejection::Rejection;

/// Maximum distance of the search, as a multiple of the travel.
const SEARCH_FRACTION: f64 = 1.1;
/// Maximum distance of backing off, as a fraction of the travel.
const BACK_FRACTION: f64 = 0.5;
/// Maximum time until a bridge accepts a request for an index pulse, ns. The lead of setpoints is at most 28
/// ms, or 1000 cycles.
const TAKEN_OVER_NS: u64 = 5_000_000_000;
/// A latched position may lie outside the searched range by the distance that the axis travels in this time,
/// s: the samples can be that old.
const LATCH_SLACK_S: f64 = 0.1;

/// Maximum time between the two inputs of a switch that is both home and limit switch, ns. Each input has its
/// own filter (the longest is the slow one of a Mesa board, up to 50 ms), and contacts bounce for some
/// milliseconds.
const INPUTS_DIFFER_NS: u64 = 60_000_000;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Begin,
    Search,
    /// The limit switch was pressed at this time during the search, and the home switch may still close:
    /// stop, then check.
    AtLimit {
        since_ns: u64,
    },
    /// The home switch has not closed: stop, then fail.
    LimitFirst,
    /// The switch has closed: stop, then back off.
    Found,
    BackOff,
    /// The switch has opened: stop, then return.
    Left,
    Latch,
    /// Leaves the switch slowly, to the edge at which it opens.
    Leave,
    /// The request has been sent; the axis is at rest.
    Arming {
        since_ns: u64,
    },
    /// Waits for the index pulse; the request was sent at this position and time.
    AwaitIndex {
        from: f64,
        since_ns: u64,
    },
    /// The index pulse did not come.
    NoIndex {
        from: f64,
        is_taken_over: bool,
    },
    /// A pulse was latched at this distance, outside the searched range.
    LatchMissed {
        along: f64,
    },
    /// The edge or pulse was at `position` of the drive.
    Latched {
        position: f64,
        from_switch: Option<f64>,
    },
    Zeroed,
    GoHome,
}

/// The homing of one axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AxisHoming {
    axis: HomingAxis,
    phase: Phase,
    /// A move has been ordered, so rest means that it has ended.
    moving: bool,
    /// Number of the request of this axis for an index pulse.
    request: u32,
    /// Time since which the limit switch in the direction of the search has been pressed with the home switch
    /// open.
    limit_since_ns: Option<u64>,
    /// Position at which the search ends.
    search_end: f64,
    /// The search has been continued once after the limit switch.
    has_resumed: bool,
    /// The home switch also presses the limit switch of the other end: one input serves all three.
    is_shared: bool,
    /// Time since which the shared input has been open again.
    shared_open_ns: Option<u64>,
}

impl AxisHoming {
    pub(crate) const fn new(axis: HomingAxis, request: u32) -> Self {
        Self {
            axis,
            phase: Phase::Begin,
            moving: false,
            request,
            limit_since_ns: None,
            search_end: 0.0,
            has_resumed: false,
            is_shared: false,
            shared_open_ns: None,
        }
    }

    pub(crate) const fn settings(&self) -> &HomingAxis {
        &self.axis
    }

    /// Processes one sample of the drives. After [`HomingAction::Done`] and [`HomingAction::Fail`] the
    /// sequence is over.
    pub(crate) fn step(&mut self, sample: &HomingSample, at_rest: bool) -> HomingAction {
        let i = self.axis.axis.index();
        debug_assert!(i < AXES);
        let position = sample.position[i];
        let closed = sample.switches.contains(i);
        let has_stopped = at_rest && self.moving;
        self.watch_shared(sample, closed);
        if self.has_passed_switch(sample, closed) {
            return self.halt(Phase::LimitFirst);
        }
        match self.phase {
            Phase::Begin if at_rest => self.begin(sample, closed),
            Phase::Search if closed => self.halt(Phase::Found),
            Phase::Search if self.is_at_limit(sample) => self.halt(Phase::AtLimit {
                since_ns: sample.time_ns,
            }),
            Phase::Search if has_stopped => self.switch_missing("within the travel"),
            Phase::Found if at_rest => self.leave_switch(),
            Phase::AtLimit { since_ns } => self.wait_at_limit(sample, since_ns, closed, at_rest),
            Phase::LimitFirst if at_rest => self.limit_first(),
            Phase::BackOff if !closed => self.halt(Phase::Left),
            Phase::BackOff | Phase::Leave if has_stopped && closed => self.switch_stuck(),
            Phase::Left if at_rest => {
                let distance = self.axis.direction * self.axis.travel * BACK_FRACTION;
                self.go(Phase::Latch, distance, self.axis.latch_velocity)
            }
            Phase::Latch if closed => match self.axis.method {
                HomingMethod::SwitchThenIndex { .. } => self.await_index(position, sample.time_ns),
                _ => self.halt(Phase::Latched {
                    position,
                    from_switch: None,
                }),
            },
            Phase::Latch if has_stopped => self.switch_missing("again on the way back"),
            Phase::Leave if !closed => self.await_index(position, sample.time_ns),
            Phase::Arming { since_ns } => self.arm(sample, since_ns, position),
            Phase::AwaitIndex { from, since_ns } => self.watch_index(sample, from, since_ns, has_stopped),
            Phase::NoIndex { from, is_taken_over } if at_rest => {
                self.index_missing((position - from).abs(), is_taken_over)
            }
            Phase::LatchMissed { along } if at_rest => self.latch_missed(along),
            Phase::Latched {
                position,
                from_switch,
            } if at_rest => {
                self.phase = Phase::Zeroed;
                HomingAction::SetZero {
                    axis: self.axis.axis,
                    position,
                    coordinate: self.axis.reference,
                    from_switch,
                }
            }
            Phase::Zeroed if at_rest => {
                self.phase = Phase::GoHome;
                self.moving = true;
                HomingAction::Home {
                    axis: self.axis.axis,
                    position: self.axis.home,
                    speed: self.axis.search_velocity,
                }
            }
            Phase::GoHome if at_rest => HomingAction::Done,
            _ => HomingAction::Wait,
        }
    }

    /// The limit switches, at the negative and the positive end, that this axis handles itself at the moment:
    /// the one in the direction of the search (which may also be the home switch), from the start of the
    /// search until its position is known, and the other one while the home switch presses it too.
    pub(crate) fn expected_limits(&self) -> [AxisMask; 2] {
        let mut expected = [AxisMask::NONE; 2];
        let here = |is_expected: bool| AxisMask::one_if(self.axis.axis.index(), is_expected);
        let end = self.search_limit();
        expected[end] = here(self.looks_for_switch());
        expected[1 - end] = here(self.is_shared);
        expected
    }

    /// Whether the limit switch in the direction of the search may be pressed.
    const fn looks_for_switch(&self) -> bool {
        match self.phase {
            Phase::Search
            | Phase::AtLimit { .. }
            | Phase::LimitFirst
            | Phase::Found
            | Phase::BackOff
            | Phase::Left
            | Phase::Latch => true,
            // Past the edge at which the switch closes, or stopping there.
            Phase::AwaitIndex { .. }
            | Phase::NoIndex { .. }
            | Phase::LatchMissed { .. }
            | Phase::Latched { .. } => matches!(
                self.axis.method,
                HomingMethod::Switch
                    | HomingMethod::SwitchThenIndex {
                        when_opening: false,
                        ..
                    }
            ),
            Phase::Begin | Phase::Leave | Phase::Arming { .. } | Phase::Zeroed | Phase::GoHome => false,
        }
    }

    /// The end of the limit switch in the direction of the search: 0 for the negative, 1 for the positive.
    fn search_limit(&self) -> usize {
        usize::from(self.axis.direction > 0.0)
    }

    fn is_at_limit(&self, sample: &HomingSample) -> bool {
        sample.limits[self.search_limit()].contains(self.axis.axis.index())
    }

    /// Detects one input that serves as home switch and both limit switches. Detection is active while the
    /// axis reaches its home switch or is on it; while the axis leaves the switch, a limit switch of the
    /// other end is the end of the travel.
    fn watch_shared(&mut self, sample: &HomingSample, closed: bool) {
        let i = self.axis.axis.index();
        let other = sample.limits[1 - self.search_limit()].contains(i);
        let comes_onto_it = match self.phase {
            Phase::Begin | Phase::Zeroed => true,
            Phase::BackOff | Phase::Left => false,
            _ => self.looks_for_switch(),
        };
        if other {
            self.shared_open_ns = None;
            self.is_shared |= comes_onto_it && closed && self.is_at_limit(sample);
        } else if self.is_shared {
            let since_ns = *self.shared_open_ns.get_or_insert(sample.time_ns);
            self.is_shared = sample.time_ns.saturating_sub(since_ns) < INPUTS_DIFFER_NS;
        }
    }

    /// Whether the axis has moved onto its limit switch during a slow move without the home switch closing.
    fn has_passed_switch(&mut self, sample: &HomingSample, closed: bool) -> bool {
        let searches = match self.phase {
            Phase::Latch => true,
            Phase::AwaitIndex { .. } => self.looks_for_switch(),
            _ => false,
        };
        if !searches || closed || !self.is_at_limit(sample) {
            self.limit_since_ns = None;
            return false;
        }
        let since_ns = *self.limit_since_ns.get_or_insert(sample.time_ns);
        sample.time_ns.saturating_sub(since_ns) >= INPUTS_DIFFER_NS
    }

    /// The limit switch has stopped the search. The home switch may close a little later.
    fn wait_at_limit(
        &mut self,
        sample: &HomingSample,
        since_ns: u64,
        closed: bool,
        at_rest: bool,
    ) -> HomingAction {
        if closed {
            self.phase = Phase::Found;
            return HomingAction::Wait;
        }
        if !at_rest {
            return HomingAction::Wait;
        }
        // The limit switch bounced, or it belongs to the side of a gantry that came first, whose home switch
        // the bridge has seen since. The search continues, once.
        if !self.is_at_limit(sample) && !self.has_resumed {
            self.has_resumed = true;
            let distance = self.search_end - sample.position[self.axis.axis.index()];
            return self.go(Phase::Search, distance, self.axis.search_velocity);
        }
        if sample.time_ns.saturating_sub(since_ns) < INPUTS_DIFFER_NS {
            return HomingAction::Wait;
        }
        self.limit_first()
    }

    /// The first action, at rest before any move.
    fn begin(&mut self, sample: &HomingSample, closed: bool) -> HomingAction {
        let axis = &self.axis;
        match axis.method {
            HomingMethod::Absolute if sample.absolute.contains(axis.axis.index()) => {
                self.phase = Phase::GoHome;
                HomingAction::TakePosition { axis: axis.axis }
            }
            HomingMethod::Absolute => HomingAction::Fail(Rejection::new(
                Alarm::NotAbsolute,
                format!(
                    "axis {}: its bridge does not report that the encoder counts from machine zero; check \
                     the encoder's battery and the drive's settings",
                    axis.axis.letter()
                ),
            )),
            HomingMethod::Index { .. } => {
                self.phase = Phase::Arming {
                    since_ns: sample.time_ns,
                };
                self.latch_index()
            }
            _ if closed => self.leave_switch(),
            _ if self.is_at_limit(sample) => {
                // The axis is beyond the home switch, or the switch is not connected: there is nowhere to
                // search.
                self.limit_first()
            }
            _ => {
                let distance = axis.direction * axis.travel * SEARCH_FRACTION;
                self.search_end = sample.position[axis.axis.index()] + distance;
                self.go(Phase::Search, distance, axis.search_velocity)
            }
        }
    }

    /// Moves off the closed switch: fast if the edge is searched on the way back, slowly if the edge is
    /// searched while leaving.
    fn leave_switch(&mut self) -> HomingAction {
        let distance = -self.axis.direction * self.axis.travel * BACK_FRACTION;
        match self.axis.method {
            HomingMethod::SwitchThenIndex {
                when_opening: true, ..
            } => self.go(Phase::Leave, distance, self.axis.latch_velocity),
            _ => self.go(Phase::BackOff, distance, self.axis.search_velocity),
        }
    }

    /// The axis moves on and expects the pulse from here.
    fn await_index(&mut self, from: f64, since_ns: u64) -> HomingAction {
        self.phase = Phase::AwaitIndex { from, since_ns };
        self.latch_index()
    }

    fn latch_index(&self) -> HomingAction {
        HomingAction::LatchIndex {
            axis: self.axis.axis,
            request: self.request,
        }
    }

    /// Moves as soon as the bridge would latch the pulse.
    fn arm(&mut self, sample: &HomingSample, since_ns: u64, from: f64) -> HomingAction {
        if sample.index_request == self.request {
            let since_ns = sample.time_ns;
            let distance = self.axis.direction * self.within();
            return self.go(
                Phase::AwaitIndex { from, since_ns },
                distance,
                self.axis.latch_velocity,
            );
        }
        if sample.time_ns.saturating_sub(since_ns) > TAKEN_OVER_NS {
            return self.index_missing(0.0, false);
        }
        HomingAction::Wait
    }

    fn watch_index(
        &mut self,
        sample: &HomingSample,
        from: f64,
        since_ns: u64,
        has_stopped: bool,
    ) -> HomingAction {
        let position = sample.position[self.axis.axis.index()];
        let is_taken_over = sample.index_request == self.request;
        if let (true, Some(latched)) = (is_taken_over, sample.index_position) {
            return self.latched(latched, from);
        }
        let is_too_far = (position - from).abs() > self.within();
        let is_ignored = !is_taken_over && sample.time_ns.saturating_sub(since_ns) > TAKEN_OVER_NS;
        if has_stopped {
            return self.index_missing((position - from).abs(), is_taken_over);
        }
        if is_too_far || is_ignored {
            return self.halt(Phase::NoIndex { from, is_taken_over });
        }
        HomingAction::Wait
    }

    /// The pulse has come; it must lie within the searched range.
    fn latched(&mut self, latched: f64, from: f64) -> HomingAction {
        let direction = match self.axis.method {
            HomingMethod::SwitchThenIndex {
                when_opening: true, ..
            } => -self.axis.direction,
            _ => self.axis.direction,
        };
        let along = (latched - from) * direction;
        let slack = LATCH_SLACK_S * self.axis.latch_velocity;
        // Written so that NaN counts as off the path.
        if !(along >= -slack && along <= self.within() + slack) {
            return self.halt(Phase::LatchMissed { along });
        }
        let has_switch = matches!(self.axis.method, HomingMethod::SwitchThenIndex { .. });
        self.halt(Phase::Latched {
            position: latched,
            from_switch: has_switch.then_some(latched - from),
        })
    }

    const fn within(&self) -> f64 {
        match self.axis.method {
            HomingMethod::SwitchThenIndex { within, .. } | HomingMethod::Index { within } => within,
            HomingMethod::Switch | HomingMethod::Absolute => 0.0,
        }
    }

    fn go(&mut self, phase: Phase, distance: f64, speed: f64) -> HomingAction {
        self.phase = phase;
        self.moving = true;
        HomingAction::Move {
            axis: self.axis.axis,
            distance,
            speed,
        }
    }

    fn halt(&mut self, phase: Phase) -> HomingAction {
        self.phase = phase;
        self.moving = false;
        HomingAction::Stop
    }

    fn switch_missing(&self, what: &str) -> HomingAction {
        HomingAction::Fail(Rejection::new(
            Alarm::HomeSwitchMissing,
            format!(
                "axis {}: the home switch was not found {what}; check its wiring",
                self.axis.axis.letter()
            ),
        ))
    }

    fn limit_first(&self) -> HomingAction {
        HomingAction::Fail(Rejection::new(
            Alarm::HomeSwitchMissing,
            format!(
                "axis {}: the limit switch was reached before the home switch: check the wiring of the home \
                 switch",
                self.axis.axis.letter()
            ),
        ))
    }

    fn switch_stuck(&self) -> HomingAction {
        HomingAction::Fail(Rejection::new(
            Alarm::HomeSwitchStuck,
            format!(
                "axis {}: the home switch stays closed; check its wiring",
                self.axis.axis.letter()
            ),
        ))
    }

    fn latch_missed(&self, along: f64) -> HomingAction {
        HomingAction::Fail(Rejection::new(
            Alarm::IndexMissing,
            format!(
                "axis {}: the bridge latched an index pulse after {along:.4}, but it was expected within \
                 {:.4}; check the bridge's scale of the encoder",
                self.axis.axis.letter(),
                self.within()
            ),
        ))
    }

    fn index_missing(&self, travelled: f64, is_taken_over: bool) -> HomingAction {
        let letter = self.axis.axis.letter();
        let text = if is_taken_over {
            format!(
                "axis {letter}: no index pulse came within {travelled:.4} of {:.4}; check the encoder's \
                 index wire, or increase index_within",
                self.within()
            )
        } else {
            format!(
                "axis {letter}: the bridge did not accept the request for an index pulse; it latches no \
                 index pulses, or none for this axis"
            )
        };
        HomingAction::Fail(Rejection::new(Alarm::IndexMissing, text))
    }
}
