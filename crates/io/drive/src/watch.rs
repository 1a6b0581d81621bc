//! The core's monitoring of the drives' feedback.

use evolvent_path::AxisMask;
use evolvent_wire::{AXES, Feedback};

use crate::alarm::DriveAlarm;
use crate::command::DriveSetpoint;
use crate::entry::FeedbackBounds;
use crate::power::{BridgeState, PowerRequest};
use crate::status_word::DriveState;

/// Silence after which a bridge counts as ended, ns.
const LINK_LOST_NS: u64 = 1_000_000_000;

/// Whether a bridge is expected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WatchMode {
    /// Feedback is ignored.
    Ignore,
    /// A bridge that has sent feedback must continue to do so while power is on.
    #[default]
    IfPresent,
    /// Without a bridge there is no power.
    Required,
}

/// Settings of the monitoring. Lengths are mm or degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WatchSettings {
    /// Whether a bridge is expected.
    pub mode: WatchMode,
    /// The control period, ns.
    pub period_ns: u64,
    /// Bit i set: the machine has axis i.
    pub axes: AxisMask,
    /// The possible values of feedback.
    pub bounds: FeedbackBounds,
    /// Maximum age of a sample under power, ns.
    pub stale_ns: u64,
    /// Maximum time for the drives to come into operation, ns.
    pub enable_timeout_ns: u64,
    /// Following error permitted at rest.
    pub following_floor: [f64; AXES],
    /// Following error permitted per unit of velocity, s: the bound is the larger of this times the velocity
    /// and the floor.
    pub following_time_s: [f64; AXES],
    /// Time for which a velocity counts after it has ended, because the following error decays with a delay,
    /// s.
    pub memory_s: f64,
}

impl WatchSettings {
    /// The default settings: samples up to 20 ms old, 2 s to come into operation, a following error of 0.5 mm
    /// at rest and the distance of 20 ms in motion.
    #[must_use]
    pub const fn new(period_ns: u64, axes: AxisMask) -> Self {
        Self {
            mode: WatchMode::IfPresent,
            period_ns,
            axes,
            bounds: FeedbackBounds::new(axes),
            stale_ns: 20_000_000,
            enable_timeout_ns: 2_000_000_000,
            following_floor: [0.5; AXES],
            following_time_s: [0.02; AXES],
            memory_s: 0.05,
        }
    }
}

/// The known state of the bridge after a step without an alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presence {
    /// No bridge sends feedback, and none is needed now.
    Absent,
    /// A bridge sends feedback; power is not requested.
    Idle,
    /// Power is requested; the drives are coming into operation, or the axes to their setpoints. Nothing may
    /// be moved yet.
    Enabling,
    /// Every drive is in operation and monitored.
    Operational,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Off,
    Enabling {
        since_ns: u64,
        from_sequence: u64,
    },
    /// Everything is monitored.
    Armed {
        /// When power was requested.
        since_ns: u64,
        /// Every axis has been at its setpoint.
        has_arrived: bool,
    },
}

impl Phase {
    const fn is_armed(self) -> bool {
        matches!(self, Self::Armed { .. })
    }
}

/// A setpoint for which feedback may still arrive.
#[derive(Clone, Copy, Debug)]
struct Sent {
    sequence: u64,
    datum: u64,
    position: [f64; AXES],
    /// Recent peak of the commanded velocity.
    peak: [f64; AXES],
}

/// Compares the feedback with the commands, once per cycle.
///
/// A message that cannot be true ([`FeedbackBounds`]) is never used. Everything else is checked only while
/// power is requested. After the request the drives have a time limit to come into operation; from then on
/// everything is monitored until power is no longer requested. A bridge may begin at a distance from the
/// setpoints and removes it: the drives count as operational once every axis has been within half of its
/// following error, or when the time limit has passed. An alarm is not latched here: it is returned in each
/// step while its cause lasts.
#[derive(Clone, Debug)]
pub struct FeedbackWatch {
    settings: WatchSettings,
    sent: Box<[Sent]>,
    phase: Phase,
    last: Option<Feedback>,
    /// When the last message arrived, whatever its contents.
    message_ns: u64,
    /// When the newest sample was taken, as its bridge reports, but never after its arrival: a clock that is
    /// ahead must not make a sample newer than it is.
    sampled_ns: u64,
    /// `time_ns` of the newest sample.
    newest_time_ns: u64,
    /// Whether the last message brought no newer sample.
    repeats: bool,
    /// Axes whose reference may have moved since the last query.
    reference_lost: AxisMask,
    /// Commanded travel, as far as feedback has arrived, since an axis's position last changed.
    unanswered: [f64; AXES],
    /// Datum and commanded position of the last setpoint with feedback.
    answered: Option<(u64, [f64; AXES])>,
    instance: Option<u64>,
    datum_since_ns: Option<u64>,
}

impl FeedbackWatch {
    /// A monitor that remembers the last 4096 setpoints. Allocates here and never again.
    #[must_use]
    pub fn new(settings: WatchSettings) -> Self {
        const NONE: Sent = Sent {
            sequence: u64::MAX,
            datum: 0,
            position: [0.0; AXES],
            peak: [0.0; AXES],
        };
        Self {
            settings,
            sent: vec![NONE; 4096].into_boxed_slice(),
            phase: Phase::Off,
            last: None,
            message_ns: 0,
            sampled_ns: 0,
            newest_time_ns: 0,
            repeats: false,
            reference_lost: AxisMask::NONE,
            unanswered: [0.0; AXES],
            answered: None,
            instance: None,
            datum_since_ns: None,
        }
    }

    /// The newest feedback; none while no bridge sends any.
    #[must_use]
    pub const fn last(&self) -> Option<&Feedback> {
        self.last.as_ref()
    }

    /// One cycle: the setpoint that was just computed, and the newest feedback since the last step, if any
    /// arrived.
    ///
    /// `now_ns` is of the clock of the feedback's `time_ns`. Call it every cycle, also without power.
    ///
    /// # Errors
    /// The first fault.
    pub fn step(
        &mut self,
        now_ns: u64,
        command: &DriveSetpoint,
        feedback: Option<&Feedback>,
    ) -> Result<Presence, DriveAlarm> {
        self.remember(command);
        if self.settings.mode == WatchMode::Ignore {
            return Ok(Presence::Absent);
        }
        self.follow_request(now_ns, command);
        let previous = self.last;
        if let Some(feedback) = feedback {
            self.message_ns = now_ns;
            self.settings.bounds.check(now_ns, feedback)?;
            self.take(now_ns, feedback, previous.as_ref());
        }
        let (Some(last), true) = (self.last, self.phase != Phase::Off) else {
            return self.without_power(now_ns);
        };
        self.check_life(now_ns, &last)?;
        self.check_drives(now_ns, command, &last)?;
        if self.phase.is_armed() {
            self.check_switches(command, &last)?;
            if feedback.is_some() && !self.repeats {
                let are_near = self.check_positions(now_ns, command, &last, previous.as_ref())?;
                self.note_arrival(now_ns, are_near);
            }
        }
        match self.phase {
            Phase::Armed {
                has_arrived: true, ..
            } => Ok(Presence::Operational),
            _ => Ok(Presence::Enabling),
        }
    }

    /// A constant error within the bound delays operation at most until the time limit of power-on.
    fn note_arrival(&mut self, now_ns: u64, are_near: bool) {
        if let Phase::Armed {
            since_ns,
            has_arrived,
        } = &mut self.phase
        {
            *has_arrived |= are_near || now_ns.saturating_sub(*since_ns) > self.settings.enable_timeout_ns;
        }
    }

    /// Whether a message that arrives now can be true. See [`FeedbackBounds::check`].
    #[must_use]
    pub fn believes(&self, now_ns: u64, feedback: &Feedback) -> bool {
        self.settings.bounds.check(now_ns, feedback).is_ok()
    }

    /// Whether a bridge has sent feedback and its samples are too old now. Invalid messages do not count.
    #[must_use]
    pub fn is_silent(&self, now_ns: u64) -> bool {
        self.last.is_some() && now_ns.saturating_sub(self.sampled_ns) > self.settings.stale_ns
    }

    /// Bit i set: since the last call the link was lost or axis i was moved faster than it can, so that its
    /// positions may refer to another zero. Axes that their bridge reports as absolute are excluded, unless
    /// they jumped.
    pub fn take_reference_lost(&mut self) -> AxisMask {
        core::mem::take(&mut self.reference_lost)
    }

    /// Stores a plausible message.
    fn take(&mut self, now_ns: u64, feedback: &Feedback, previous: Option<&Feedback>) {
        let same = previous.filter(|previous| previous.instance == feedback.instance);
        if let (Some(previous), None) = (previous, same) {
            self.lose_reference(previous, feedback.absolute_mask);
        }
        self.repeats = same.is_some() && feedback.time_ns <= self.newest_time_ns;
        if !self.repeats {
            self.newest_time_ns = feedback.time_ns;
            self.sampled_ns = feedback.time_ns.min(now_ns);
            if let Some(previous) = same.filter(|previous| previous.datum == feedback.datum) {
                self.watch_steps(previous, feedback);
            }
        }
        self.last = Some(*feedback);
    }

    /// Without power only its mechanics limit the motion of an axis: a larger step is an encoder fault.
    fn watch_steps(&mut self, previous: &Feedback, feedback: &Feedback) {
        let interval_s = feedback.time_ns.saturating_sub(previous.time_ns) as f64 * 1e-9;
        let both = AxisMask::from_bits(previous.axes_mask & feedback.axes_mask);
        for axis in (self.settings.axes & both).axes() {
            let step = (feedback.position[axis] - previous.position[axis]).abs();
            let bound = 1.5 * self.settings.bounds.max_velocity[axis] * interval_s;
            if step > bound + self.settings.following_floor[axis] {
                self.reference_lost |= AxisMask::one(axis);
            }
        }
    }

    fn lose_reference(&mut self, last: &Feedback, still_absolute: u32) {
        self.reference_lost |= self
            .settings
            .axes
            .without(AxisMask::from_bits(last.absolute_mask & still_absolute));
    }

    /// Stores the setpoint.
    fn remember(&mut self, command: &DriveSetpoint) {
        let size = self.sent.len() as u64;
        let decay = libm::exp(-(self.settings.period_ns as f64) * 1e-9 / self.settings.memory_s.max(1e-6));
        let before = self.sent[(command.sequence.wrapping_sub(1) % size) as usize];
        let follows = before.sequence == command.sequence.wrapping_sub(1);
        let mut sent = Sent {
            sequence: command.sequence,
            datum: command.datum,
            position: command.position,
            peak: [0.0; AXES],
        };
        for axis in 0..AXES {
            let faded = if follows { before.peak[axis] * decay } else { 0.0 };
            sent.peak[axis] = faded.max(command.velocity[axis].abs());
        }
        self.sent[(command.sequence % size) as usize] = sent;
    }

    fn follow_request(&mut self, now_ns: u64, command: &DriveSetpoint) {
        if command.power != PowerRequest::On {
            self.phase = Phase::Off;
            self.instance = None;
        } else if self.phase == Phase::Off {
            self.phase = Phase::Enabling {
                since_ns: now_ns,
                from_sequence: command.sequence,
            };
            self.datum_since_ns = None;
        }
    }

    /// Without power, or without any feedback yet.
    fn without_power(&mut self, now_ns: u64) -> Result<Presence, DriveAlarm> {
        if let Some(last) = self.last {
            if now_ns.saturating_sub(self.message_ns) > self.settings.stale_ns.max(LINK_LOST_NS) {
                self.last = None;
                self.lose_reference(&last, u32::MAX);
            }
            return Ok(Presence::Idle);
        }
        match self.phase {
            Phase::Enabling { since_ns, .. } if self.settings.mode == WatchMode::Required => {
                let waited_ns = now_ns.saturating_sub(since_ns);
                if waited_ns > self.settings.enable_timeout_ns {
                    return Err(DriveAlarm::Missing { waited_ns });
                }
                Ok(Presence::Enabling)
            }
            _ => Ok(Presence::Absent),
        }
    }

    fn axes(&self) -> impl Iterator<Item = usize> + use<> {
        self.settings.axes.axes()
    }

    fn check_life(&mut self, now_ns: u64, last: &Feedback) -> Result<(), DriveAlarm> {
        let limit_ns = self.settings.stale_ns;
        let mut age_ns = now_ns.saturating_sub(self.sampled_ns);
        if let Phase::Enabling { since_ns, .. } = self.phase {
            // Samples from before the request may be old.
            age_ns = age_ns.min(now_ns.saturating_sub(since_ns));
        }
        if age_ns > limit_ns {
            let sequence = last.sequence;
            let comes = now_ns.saturating_sub(self.message_ns) <= limit_ns;
            return Err(if comes && self.repeats {
                DriveAlarm::Frozen { age_ns, sequence }
            } else {
                DriveAlarm::Stale {
                    age_ns,
                    limit_ns,
                    sequence,
                }
            });
        }
        match self.instance {
            Some(instance) if instance != last.instance => Err(DriveAlarm::BridgeRestarted),
            _ => {
                if self.phase.is_armed() {
                    self.instance = Some(last.instance);
                }
                Ok(())
            }
        }
    }

    /// Power states of the drives; enables the monitoring when all are in operation.
    fn check_drives(
        &mut self,
        now_ns: u64,
        command: &DriveSetpoint,
        last: &Feedback,
    ) -> Result<(), DriveAlarm> {
        let mut waiting = None;
        for axis in self.axes() {
            if !AxisMask::from_bits(last.axes_mask).contains(axis) {
                return Err(DriveAlarm::AxisMissing { axis });
            }
            let status_word = last.status_word[axis];
            let state = DriveState::decode((status_word & 0xFFFF) as u16);
            if state.is_some_and(DriveState::is_fault) {
                return Err(DriveAlarm::DriveFault {
                    axis,
                    status_word,
                    error_code: last.error_code,
                });
            }
            if state != Some(DriveState::OperationEnabled) {
                waiting = waiting.or(Some((axis, status_word)));
            }
        }
        let state = BridgeState::from_number(last.bridge_state);
        match self.phase {
            Phase::Armed { .. } => {
                if let Some((axis, status_word)) = waiting {
                    return Err(DriveAlarm::DriveOff { axis, status_word });
                }
                if last.sequence > command.sequence {
                    let (sequence, sent) = (last.sequence, command.sequence);
                    return Err(DriveAlarm::Implausible { sequence, sent });
                }
                if !matches!(state, Some(BridgeState::Following | BridgeState::Bridging)) {
                    let (state, note) = (last.bridge_state, last.note);
                    return Err(DriveAlarm::BridgeStopped { state, note });
                }
            }
            Phase::Enabling {
                since_ns,
                from_sequence,
            } => {
                let answers = (from_sequence..=command.sequence).contains(&last.sequence);
                if waiting.is_none() && answers && state == Some(BridgeState::Following) {
                    self.phase = Phase::Armed {
                        since_ns,
                        has_arrived: false,
                    };
                    self.unanswered = [0.0; AXES];
                    self.answered = None;
                    self.instance = Some(last.instance);
                    return Ok(());
                }
                let waited_ns = now_ns.saturating_sub(since_ns);
                if waited_ns > self.settings.enable_timeout_ns {
                    return Err(match waiting {
                        Some((axis, status_word)) => DriveAlarm::NotEnabled {
                            axis,
                            status_word,
                            waited_ns,
                        },
                        None => DriveAlarm::BridgeStopped {
                            state: last.bridge_state,
                            note: last.note,
                        },
                    });
                }
            }
            Phase::Off => {}
        }
        Ok(())
    }

    /// A switch stops motion towards it; the axis may move away from it.
    fn check_switches(&self, command: &DriveSetpoint, last: &Feedback) -> Result<(), DriveAlarm> {
        for axis in self.axes() {
            let velocity = command.velocity[axis];
            let positive = velocity > 0.0;
            let pressed = AxisMask::from_bits(if positive {
                last.positive_limit_mask
            } else {
                last.negative_limit_mask
            });
            let expected = command.switches_expected[usize::from(positive)];
            if velocity != 0.0 && pressed.without(expected).contains(axis) {
                return Err(DriveAlarm::LimitSwitch { axis, positive });
            }
        }
        Ok(())
    }

    /// Whether every axis is within half of its following error: the other half is left for the error of a
    /// motion.
    fn check_positions(
        &mut self,
        now_ns: u64,
        command: &DriveSetpoint,
        last: &Feedback,
        previous: Option<&Feedback>,
    ) -> Result<bool, DriveAlarm> {
        let sent = self.sent[(last.sequence % self.sent.len() as u64) as usize];
        if sent.sequence != last.sequence {
            return Ok(false);
        }
        if sent.datum != last.datum {
            // While homing assigns new coordinates, feedback with the previous ones may still arrive.
            let since_ns = *self.datum_since_ns.get_or_insert(now_ns);
            if now_ns.saturating_sub(since_ns) > self.settings.stale_ns {
                return Err(DriveAlarm::Datum {
                    expected: command.datum,
                    found: last.datum,
                });
            }
            return Ok(false);
        }
        self.datum_since_ns = None;
        // Setpoints are sent ahead: only those with feedback can have moved the axes.
        if let Some((datum, before)) = self.answered.replace((sent.datum, sent.position))
            && datum == sent.datum
        {
            for axis in 0..AXES {
                self.unanswered[axis] += (sent.position[axis] - before[axis]).abs();
            }
        }
        let mut are_near = true;
        let interval_ns = previous.map_or(0, |previous| last.time_ns.saturating_sub(previous.time_ns));
        for axis in self.axes() {
            let position = last.position[axis];
            let velocity = sent.peak[axis];
            let floor = self.settings.following_floor[axis];
            if let Some(previous) = previous.filter(|previous| previous.datum == last.datum) {
                let step = position - previous.position[axis];
                let bound = 1.5 * velocity * interval_ns as f64 * 1e-9 + floor;
                if step.abs() > bound {
                    return Err(DriveAlarm::Jump {
                        axis,
                        step,
                        bound,
                        interval_ns,
                    });
                }
                if step.to_bits() << 1 != 0 {
                    self.unanswered[axis] = 0.0;
                }
            }
            let commanded = self.unanswered[axis];
            // Beyond what the delay of the feedback explains.
            let on_the_way = velocity * self.settings.following_time_s[axis];
            if commanded > 0.5 * floor + on_the_way {
                return Err(DriveAlarm::FrozenAxis {
                    axis,
                    commanded,
                    position,
                });
            }
            let error = sent.position[axis] - position;
            let bound = floor.max(velocity * self.settings.following_time_s[axis]);
            if error.abs() > bound {
                return Err(DriveAlarm::FollowingError {
                    axis,
                    error,
                    bound,
                    velocity,
                });
            }
            are_near &= error.abs() <= 0.5 * bound;
        }
        Ok(are_near)
    }
}
