//! A bridge's conversion of arriving setpoints to a target for every period of the drives.

use std::collections::VecDeque;

use evolvent_wire::{AXES, Setpoint};

use crate::brake::{Brake, BrakeState};
use crate::follower_settings::{FollowerSettings, SettingsError};
use crate::index_latch::IndexRequest;
use crate::point::Point;
use crate::power::{BridgeState, Note, PowerRequest};
use crate::start_offset::StartOffsets;
use crate::step_check::{StepCheck, TOLERATED_ACCELERATION};

/// Capacity for future setpoints: the longest lead plus a burst.
const CAPACITY: usize = 2048;
/// No core computes setpoints further ahead, ns.
const FURTHEST_NS: u64 = 10_000_000_000;

/// Why a setpoint was not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejection {
    /// A number is not finite.
    NotFinite,
    /// It arrived too late, or not after the previous one.
    Late,
    /// It is implausibly far ahead.
    Future,
    /// No axis can get there from the previous setpoint.
    Jump,
}

impl Rejection {
    const fn note(self) -> Note {
        match self {
            Self::NotFinite => Note::NotFinite,
            Self::Late => Note::Late,
            Self::Future | Self::Jump => Note::Jump,
        }
    }
}

/// Commands to the drives for one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Position of every axis.
    pub position: [f64; AXES],
    /// Velocity, for a feed-forward.
    pub velocity: [f64; AXES],
    /// Acceleration, for a feed-forward.
    pub acceleration: [f64; AXES],
    /// What the follower is doing.
    pub state: BridgeState,
    /// The core's request to the power stages; off if the drives do not follow and the core is silent.
    pub power: PowerRequest,
    /// The core requested power and is silent, and the drives do not follow: `power` is not its request, and
    /// unlocks nothing that waits for *off*.
    pub is_silent: bool,
    /// The core's counter of fault resets; none without a core, and in the first period of each: only what it
    /// counts from there on is a request.
    pub fault_reset: Option<u32>,
    /// The last setpoint that was due.
    pub sequence: u64,
    /// The drives' time minus the due time of the nearest setpoint, ns.
    pub phase_error_ns: i64,
    /// The datum that positions refer to from now on.
    pub datum: u64,
    /// If the datum has changed in this period: the amount to add to every position that the bridge keeps.
    pub datum_shift: Option<[f64; AXES]>,
    /// Number of changes of the datum by an unknown amount: after one, the bridge's positions have another
    /// zero than the core's.
    pub datums_lost: u32,
    /// The requested index pulse: the setpoint's `index_request` and `index_axis`.
    pub index: IndexRequest,
}

impl Target {
    /// The `instance` of the feedback, from that of the session. It differs after each change of datum by an
    /// unknown amount, so that the core homes again.
    #[must_use]
    pub const fn instance(&self, of_session: u64) -> u64 {
        // A session's number is its start in ns since the host started, which reaches the upper 16 bits after
        // three days, or counts from 1. Each of 65536 losses of a session still has a different number. It
        // equals that of another session only if both began a multiple of 2^48 ns apart, to the nanosecond.
        of_session ^ ((self.datums_lost as u64) << 48)
    }
}

/// Follows setpoints by their due times. If they are missing the last motion continues for a few periods,
/// never longer; then every axis brakes within its limits and holds. From there following starts again only
/// with a setpoint at the position of the axes: the core has to adapt to the machine, not the machine to the
/// core. The small permitted distance between setpoint and axis ([`FollowerSettings::sync_tolerance`]) is
/// added to the setpoints, and decays to zero within a twentieth of the limits of each axis.
///
/// May be called by a real-time cycle; only [`Follower::new`] allocates.
#[derive(Clone, Debug)]
pub struct Follower {
    settings: FollowerSettings,
    queue: VecDeque<Point>,
    current: Option<Point>,
    state: BridgeState,
    note: Note,
    missed: u32,
    hold: [f64; AXES],
    brakes: [Brake; AXES],
    brake_since_ns: u64,
    stepped_ns: u64,
    /// Offsets added to the setpoints since following began.
    offsets: StartOffsets,
    datum: u64,
    /// The core of the current setpoint has been followed. Until then it takes over the bridge's datum and
    /// coordinates, and a change of its datum renames nothing.
    is_tied: bool,
    /// No setpoint of the core has been the current one before this period.
    is_new_core: bool,
    datums_lost: u32,
    quick_stop: bool,
    steps: StepCheck,
}

impl Target {
    /// The last request of the core, also while it is silent.
    #[must_use]
    pub const fn requested_power(&self) -> PowerRequest {
        if self.is_silent {
            PowerRequest::On
        } else {
            self.power
        }
    }
}

impl Follower {
    /// Creates a follower that waits for its first setpoint.
    ///
    /// # Errors
    /// An invalid limit.
    pub fn new(settings: FollowerSettings) -> Result<Self, SettingsError> {
        settings.check()?;
        let rest = Brake::new(BrakeState::default(), 1.0, 1.0);
        Ok(Self {
            settings,
            queue: VecDeque::with_capacity(CAPACITY),
            current: None,
            state: BridgeState::Waiting,
            note: Note::None,
            missed: 0,
            hold: [0.0; AXES],
            brakes: [rest; AXES],
            brake_since_ns: 0,
            stepped_ns: 0,
            offsets: StartOffsets::default(),
            datum: 0,
            is_tied: false,
            is_new_core: true,
            datums_lost: 0,
            quick_stop: false,
            steps: StepCheck::default(),
        })
    }

    /// The last problem with setpoints.
    #[must_use]
    pub const fn note(&self) -> Note {
        self.note
    }

    /// Setpoints that were missing, late or rejected.
    #[must_use]
    pub const fn missed(&self) -> u32 {
        self.missed
    }

    /// A message arrived that could not be read: another interface version.
    pub fn refuse_version(&mut self) {
        self.refuse(Note::Version);
    }

    fn refuse(&mut self, note: Note) {
        self.note = note;
        self.missed = self.missed.saturating_add(1);
    }

    /// Accepts a setpoint, in the order of arrival. `now_ns` is of the clock of the due times.
    ///
    /// # Errors
    /// It cannot be used; it then counts as missing.
    pub fn offer(&mut self, now_ns: u64, setpoint: &Setpoint) -> Result<(), Rejection> {
        // A request for a quick stop counts even if the setpoint is otherwise invalid.
        self.quick_stop = PowerRequest::from_number(setpoint.power_request) == PowerRequest::QuickStop;
        let result = self.accept(now_ns, setpoint);
        if let Err(refusal) = result {
            self.refuse(refusal.note());
        }
        result
    }

    fn axes(&self) -> impl Iterator<Item = usize> + use<> {
        self.settings.axes.axes()
    }

    fn accept(&mut self, now_ns: u64, setpoint: &Setpoint) -> Result<(), Rejection> {
        for axis in self.axes() {
            let finite = setpoint.position[axis].is_finite()
                && setpoint.velocity[axis].is_finite()
                && setpoint.acceleration[axis].is_finite();
            if !finite {
                return Err(Rejection::NotFinite);
            }
        }
        let point = Point::of(setpoint, self.settings.axes);
        let patience_ns = self.settings.period_ns * u64::from(self.settings.bridge_cycles.max(1));
        if point.due_ns.saturating_add(patience_ns) < now_ns {
            return Err(Rejection::Late);
        }
        if point.due_ns > now_ns.saturating_add(FURTHEST_NS) {
            return Err(Rejection::Future);
        }
        if let Some(tail) = self.queue.back().or(self.current.as_ref()).copied() {
            if point.sequence < tail.sequence {
                // Another core: the setpoints of the previous one are void.
                self.note = Note::Restart;
                self.queue.clear();
                (self.current, self.is_tied, self.is_new_core) = (None, false, true);
                self.steps.reset();
            } else if point.sequence == tail.sequence {
                return Ok(());
            } else {
                if point.due_ns <= tail.due_ns {
                    return Err(Rejection::Late);
                }
                self.check_step(&tail, &point)?;
                let gap = (point.sequence - tail.sequence - 1).min(u64::from(u32::MAX)) as u32;
                if gap > 0 {
                    self.missed = self.missed.saturating_add(gap);
                    self.note = Note::Gap;
                }
            }
        }
        if self.queue.len() == CAPACITY {
            self.queue.pop_front();
        }
        self.queue.push_back(point);
        Ok(())
    }

    /// Whether every axis can get from one setpoint to the next, if the first is being followed.
    fn check_step(&mut self, tail: &Point, point: &Point) -> Result<(), Rejection> {
        if !self.is_following() {
            return Ok(());
        }
        let is_accepted = if point.datum == tail.datum {
            self.steps.accepts(&self.settings, tail, point)
        } else {
            // A new coordinate for the same position. After a jump that position is unknown.
            self.steps.is_clear() && self.is_renaming(tail, point)
        };
        if is_accepted { Ok(()) } else { Err(Rejection::Jump) }
    }

    /// Rejects queued setpoints that no axis can reach. They arrived while none was followed, when a core may
    /// still be adapting to the position of the axes, so their steps were not checked.
    fn check_queue(&mut self) {
        self.steps.reset();
        let Some(mut tail) = self.current else { return };
        let mut queue = core::mem::take(&mut self.queue);
        let arrived = queue.len();
        queue.retain(|point| {
            let is_possible = self.check_step(&tail, point).is_ok();
            if is_possible {
                tail = *point;
            }
            is_possible
        });
        for _ in queue.len()..arrived {
            self.refuse(Note::Jump);
        }
        self.queue = queue;
    }

    /// One period of the drives at their time `now_ns`. `enabled`: whether every drive follows its target;
    /// `actual`: the positions of the axes.
    pub fn step(&mut self, now_ns: u64, enabled: bool, actual: &[f64; AXES]) -> Target {
        // Before the check for a pause: the brakes start from the last target in the new coordinates.
        let datum_shift = self.come_due(now_ns);
        self.mind_pause(now_ns);
        let mut states = [BrakeState::default(); AXES];
        if !enabled {
            if self.state != BridgeState::Waiting || self.current.is_some() {
                self.state = BridgeState::Off;
            }
            // Measured in the previous coordinates.
            let shift = datum_shift.unwrap_or_default();
            self.hold = std::array::from_fn(|axis| actual[axis] + shift[axis]);
        } else if matches!(self.state, BridgeState::Waiting | BridgeState::Off) {
            self.state = BridgeState::Holding;
        }
        if self.is_following() && !self.follow(now_ns, &mut states) {
            self.begin_braking(&states);
        }
        if self.state == BridgeState::Braking {
            self.brake(now_ns, &mut states);
        }
        if self.state == BridgeState::Holding && self.synchronise(now_ns) {
            self.begin_following(now_ns, &mut states);
        }
        if matches!(
            self.state,
            BridgeState::Waiting | BridgeState::Off | BridgeState::Holding
        ) {
            for axis in 0..AXES {
                states[axis].position = self.hold[axis];
            }
        }
        self.stepped_ns = now_ns;
        let target = self.target(now_ns, &states, datum_shift);
        self.is_new_core &= self.current.is_none();
        target
    }

    /// A bridge that was suspended for longer than it may continue without setpoints does not jump to where
    /// the axes should be by now: they brake from the last target.
    fn mind_pause(&mut self, now_ns: u64) {
        let period_ns = self.settings.period_ns;
        let paused_ns = now_ns.saturating_sub(self.stepped_ns);
        let patience_ns = period_ns * u64::from(self.settings.bridge_cycles.max(2));
        if self.stepped_ns == 0 || paused_ns <= patience_ns {
            return;
        }
        match self.state {
            BridgeState::Following | BridgeState::Bridging => {
                self.state = BridgeState::Braking;
                self.note = Note::Silence;
                self.queue.clear();
                // The brakes start where the last target was.
                self.brake_since_ns = now_ns - period_ns;
            }
            BridgeState::Braking => self.brake_since_ns += paused_ns - period_ns,
            BridgeState::Waiting | BridgeState::Holding | BridgeState::Off => {}
        }
    }

    /// Makes due setpoints the current ones. Returns the shift of a changed datum.
    fn come_due(&mut self, now_ns: u64) -> Option<[f64; AXES]> {
        let mut shift = None;
        while let Some(point) = self.queue.front().filter(|point| point.due_ns <= now_ns).copied() {
            self.queue.pop_front();
            if point.datum == self.datum || self.take_datum(&point, &mut shift) {
                self.current = Some(point);
            }
        }
        shift
    }

    /// Accepts the datum of a setpoint that is due, and adds the change of coordinates to `shift`. Returns
    /// `false` if the setpoint cannot be followed.
    ///
    /// A change of datum changes coordinates only, so it does not matter whether the drives follow: they may
    /// have lost power since the core assigned it.
    fn take_datum(&mut self, point: &Point, shift: &mut Option<[f64; AXES]>) -> bool {
        if let Some(last) = self.current.filter(|_| self.is_tied) {
            if self.is_renaming(&last, point) {
                let shift = shift.get_or_insert([0.0; AXES]);
                for axis in self.axes() {
                    let by = point.position[axis] - last.position[axis];
                    shift[axis] += by;
                    self.hold[axis] += by;
                    self.brakes[axis].rename(by);
                }
            } else if self.is_following() {
                self.refuse(Note::Jump);
                return false;
            } else {
                self.note = Note::Gap;
                self.datums_lost = self.datums_lost.saturating_add(1);
            }
        }
        self.datum = point.datum;
        true
    }

    /// Whether the step from one setpoint to the next is a change of coordinates only, if their datums
    /// differ.
    ///
    /// While they are followed, at most the bridged periods are missing in between. In that time an axis
    /// moves from rest to rest by at most j t^3 / 32: 1.6 um in 10 ms with 50 m/s3. Otherwise a core may have
    /// followed axes that were moved by hand.
    fn is_renaming(&self, last: &Point, point: &Point) -> bool {
        let is_next = point.sequence == last.sequence + 1;
        last.stands() && point.stands() && (is_next || self.is_following())
    }

    const fn is_following(&self) -> bool {
        matches!(self.state, BridgeState::Following | BridgeState::Bridging)
    }

    /// The first period of following: the axes are still where they were held, and at rest.
    fn begin_following(&mut self, now_ns: u64, states: &mut [BrakeState; AXES]) {
        self.state = BridgeState::Following;
        self.is_tied = true;
        self.check_queue();
        self.offsets = StartOffsets::default();
        let _reached = self.follow(now_ns, states);
        self.offsets = StartOffsets::new(now_ns, &self.settings, &self.hold, states);
        let _reached = self.follow(now_ns, states);
    }

    /// Computes the present target positions: those of the setpoints plus the remaining distance of the
    /// start. Returns false if the setpoints have run out.
    fn follow(&mut self, now_ns: u64, states: &mut [BrakeState; AXES]) -> bool {
        let Some(last) = self.current else {
            // The motion of the previous core is void; only the last target of the axes is known.
            for axis in 0..AXES {
                states[axis] = self.brakes[axis].at(0.0);
            }
            self.brake_since_ns = self.stepped_ns;
            return false;
        };
        let is_reached = self.interpolate(now_ns, &last, states);
        let of_ns = if is_reached { now_ns } else { self.brake_since_ns };
        for axis in self.axes() {
            let offset = self.offsets.at(of_ns, axis);
            states[axis].position += offset.position;
            states[axis].velocity += offset.velocity;
            states[axis].acceleration += offset.acceleration;
            if is_reached {
                // A brake would start here if another core replaced this one.
                self.brakes[axis] = self.brake_of(axis, states[axis]);
            }
        }
        is_reached
    }

    /// Computes the present position of the setpoints. Returns false if they have run out; the position is
    /// then that at `brake_since_ns`, when they did.
    fn interpolate(&mut self, now_ns: u64, last: &Point, states: &mut [BrakeState; AXES]) -> bool {
        let period_ns = self.settings.period_ns;
        let patience = u64::from(self.settings.bridge_cycles);
        let age_ns = now_ns.saturating_sub(last.due_ns);
        let next = self
            .queue
            .front()
            .filter(|next| next.sequence - last.sequence <= patience + 1);
        if let Some(next) = next {
            let is_next = next.sequence == last.sequence + 1;
            self.state = if is_next {
                BridgeState::Following
            } else {
                BridgeState::Bridging
            };
            let interval_s = (next.due_ns - last.due_ns) as f64 * 1e-9;
            for axis in 0..AXES {
                states[axis] = if next.datum == last.datum {
                    last.between(next, axis, age_ns as f64 * 1e-9, interval_s)
                } else {
                    last.onward(axis, 1.0, 0.0)
                };
            }
        } else {
            let longest_ns = self.longest_ns();
            let late = age_ns > period_ns + period_ns / 2;
            self.state = if late {
                BridgeState::Bridging
            } else {
                BridgeState::Following
            };
            if late {
                self.note = Note::Silence;
            }
            for axis in 0..AXES {
                let jerk = self.settings.max_jerk[axis];
                states[axis] = last.onward(axis, jerk, age_ns.min(longest_ns) as f64 * 1e-9);
            }
            if age_ns > longest_ns {
                self.missed = self.missed.saturating_add(1);
                self.brake_since_ns = last.due_ns + longest_ns;
                return false;
            }
        }
        true
    }

    /// The age of a setpoint up to which the motion continues without another, ns.
    fn longest_ns(&self) -> u64 {
        let period_ns = self.settings.period_ns;
        (period_ns * u64::from(self.settings.bridge_cycles)).max(period_ns + period_ns / 2)
    }

    fn brake_of(&self, axis: usize, state: BrakeState) -> Brake {
        let limit = self.settings.max_acceleration[axis];
        let state = BrakeState {
            acceleration: state.acceleration.clamp(-limit, limit),
            ..state
        };
        Brake::new(state, limit, self.settings.max_jerk[axis])
    }

    fn begin_braking(&mut self, states: &[BrakeState; AXES]) {
        for axis in self.axes() {
            self.brakes[axis] = self.brake_of(axis, states[axis]);
        }
        self.state = BridgeState::Braking;
        // A setpoint after a pause does not continue the previous one.
        self.queue.clear();
    }

    fn brake(&mut self, now_ns: u64, states: &mut [BrakeState; AXES]) {
        let time_s = now_ns.saturating_sub(self.brake_since_ns) as f64 * 1e-9;
        let mut at_rest = true;
        for axis in self.axes() {
            states[axis] = self.brakes[axis].at(time_s);
            self.hold[axis] = states[axis].position;
            at_rest &= time_s >= self.brakes[axis].duration_s();
        }
        if at_rest {
            self.state = BridgeState::Holding;
        }
    }

    /// Whether the current setpoint is at the position of the axes.
    fn synchronise(&mut self, now_ns: u64) -> bool {
        let Some(current) = self.current else { return false };
        let patience_ns = self.settings.period_ns * u64::from(self.settings.bridge_cycles.max(1));
        if current.power != PowerRequest::On || now_ns.saturating_sub(current.due_ns) > patience_ns {
            return false;
        }
        for axis in self.axes() {
            let off = (current.position[axis] - self.hold[axis]).abs();
            let slow = current.velocity[axis].abs() <= 0.001 * self.settings.max_velocity[axis];
            let hardest = TOLERATED_ACCELERATION * self.settings.max_acceleration[axis];
            let is_possible = slow && current.acceleration[axis].abs() <= hardest;
            // Written so that a value that is not a number does not match.
            if !(off <= self.settings.sync_tolerance[axis] && is_possible) {
                self.note = Note::Jump;
                return false;
            }
        }
        true
    }

    fn target(&self, now_ns: u64, states: &[BrakeState; AXES], datum_shift: Option<[f64; AXES]>) -> Target {
        let mut target = Target {
            position: states.map(|state| state.position),
            velocity: states.map(|state| state.velocity),
            acceleration: states.map(|state| state.acceleration),
            state: self.state,
            power: self.current.map_or(PowerRequest::Off, |current| current.power),
            is_silent: false,
            fault_reset: (self.current)
                .filter(|_| !self.is_new_core)
                .map(|current| current.fault_reset),
            sequence: self.current.map_or(0, |current| current.sequence),
            phase_error_ns: 0,
            datum: self.datum,
            datum_shift,
            datums_lost: self.datums_lost,
            index: self.current.map_or(IndexRequest::NONE, |current| current.index),
        };
        let silent = self.current.is_none() && self.state == BridgeState::Holding;
        if self.state == BridgeState::Braking || silent {
            // Torque is needed for braking, and for holding until another core sends setpoints.
            target.power = PowerRequest::On;
        }
        if matches!(self.state, BridgeState::Waiting | BridgeState::Off) && target.power == PowerRequest::On {
            // Drives come into operation, and find their zero, only while a core is present.
            target.is_silent = self
                .current
                .is_some_and(|current| now_ns.saturating_sub(current.due_ns) > self.longest_ns());
            if target.is_silent {
                (target.power, target.fault_reset) = (PowerRequest::Off, None);
            }
        }
        if self.quick_stop {
            target.power = PowerRequest::QuickStop;
        }
        if let Some(current) = self.current {
            let late_ns = i64::try_from(now_ns.saturating_sub(current.due_ns)).unwrap_or(i64::MAX);
            let period_ns = self.settings.period_ns as i64;
            let early = self
                .queue
                .front()
                .is_some_and(|next| next.due_ns.saturating_sub(now_ns) < late_ns.unsigned_abs());
            target.phase_error_ns = if early { late_ns - period_ns } else { late_ns };
        }
        target
    }
}
