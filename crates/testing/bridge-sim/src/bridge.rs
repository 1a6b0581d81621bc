//! The whole bridge as a pure model.

use evolvent_path::AxisMask;
use std::collections::VecDeque;

use evolvent_bus::{AXES, Feedback, Setpoint};
use evolvent_drive::{DriveState, Follower, IndexLatch, Note, PowerRequest, SettingsError, Target};

use crate::drive::{DriveTrouble, SimDrive};
use crate::fault::{Fault, FaultKind};
use crate::settings::SimSettings;

/// Delay of the fault `late`, ns.
const LATE_NS: u64 = 100_000_000;
/// Size of the fault `jump`, mm or degrees.
const JUMP: f64 = 5.0;
/// An impossible position, mm or degrees.
const WILD: f64 = 1e308;
/// Offset of the time stamps of the fault `ahead`, ns.
const AHEAD_NS: u64 = 3_600_000_000_000;

/// Drives with a follower and faults. Deterministic: the same setpoints at the same times give the same
/// feedback.
#[derive(Clone, Debug)]
pub struct SimBridge {
    follower: Follower,
    drives: Vec<SimDrive>,
    faults: Vec<Fault>,
    period_s: f64,
    bridge_cycles: u32,
    instance: u64,
    axes: AxisMask,
    absolute: bool,
    /// First time at which the drives were operational: time zero of the faults.
    operating_since_ns: Option<u64>,
    /// One drive has left operation; the others stay stopped until power is requested again.
    group_stop: bool,
    last_target: Option<Target>,
    frozen: Option<Feedback>,
    stuck: [Option<f64>; AXES],
    /// The reading of the load at which the sensor froze.
    frozen_load: Option<f64>,
    delayed: VecDeque<Feedback>,
    /// The index pulse that the core requests.
    index: IndexLatch,
}

impl SimBridge {
    /// Creates drives that have just been supplied, with their axes at rest.
    ///
    /// # Errors
    /// A limit is not a positive number.
    pub fn new(settings: &SimSettings) -> Result<Self, SettingsError> {
        Ok(Self {
            follower: Follower::new(settings.follower())?,
            drives: settings
                .axes
                .iter()
                .filter(|axis| axis.axis < AXES)
                .map(|axis| SimDrive::new(*axis))
                .collect(),
            faults: settings.faults.clone(),
            period_s: settings.period_ns as f64 * 1e-9,
            bridge_cycles: settings.follower().bridge_cycles,
            instance: settings.instance,
            axes: settings.axes_mask(),
            absolute: settings.absolute,
            operating_since_ns: None,
            group_stop: false,
            last_target: None,
            frozen: None,
            stuck: [None; AXES],
            frozen_load: None,
            delayed: VecDeque::new(),
            index: IndexLatch::default(),
        })
    }

    /// Accepts a received setpoint. Unusable setpoints are counted and noted in the feedback.
    pub fn offer(&mut self, now_ns: u64, setpoint: &Setpoint) {
        let _noted = self.follower.offer(now_ns, setpoint);
    }

    /// Counts a message of another version of the protocol.
    pub fn refuse_version(&mut self) {
        self.follower.refuse_version();
    }

    /// The drives.
    #[must_use]
    pub fn drives(&self) -> &[SimDrive] {
        &self.drives
    }

    /// The true positions of the axes, in any datum.
    #[must_use]
    pub fn true_positions(&self) -> [f64; AXES] {
        let mut positions = [0.0; AXES];
        for drive in &self.drives {
            positions[drive.axis().axis] = drive.servo().position;
        }
        positions
    }

    /// The positions that the encoders show.
    #[must_use]
    pub fn shown_positions(&self) -> [f64; AXES] {
        let mut positions = [0.0; AXES];
        for drive in &self.drives {
            positions[drive.axis().axis] = drive.shown();
        }
        positions
    }

    /// The last target of the follower; `None` before the first period.
    #[must_use]
    pub const fn last_target(&self) -> Option<&Target> {
        self.last_target.as_ref()
    }

    /// Number of setpoints that were missing, late or refused.
    #[must_use]
    pub const fn missed(&self) -> u32 {
        self.follower.missed()
    }

    /// The last problem with setpoints.
    #[must_use]
    pub const fn note(&self) -> Note {
        self.follower.note()
    }

    /// Number of periods for which the motion continues without setpoints.
    #[must_use]
    pub const fn bridge_cycles(&self) -> u32 {
        self.bridge_cycles
    }

    /// Adds a fault to the schedule. Its `at_ns` counts from the first time that the drives were operational.
    pub fn add_fault(&mut self, fault: Fault) {
        self.faults.push(fault);
    }

    /// The faults of the spindles that are active at `now_ns`.
    #[must_use]
    pub fn spindle_faults(&self, now_ns: u64) -> Vec<FaultKind> {
        let Some(since_ns) = self.operating_since_ns else {
            return Vec::new();
        };
        let age_ns = now_ns.saturating_sub(since_ns);
        let faults = self.faults.iter();
        faults
            .filter(|fault| fault.kind.is_of_spindle() && fault.is_active(age_ns))
            .map(|fault| fault.kind)
            .collect()
    }

    /// First time at which the drives were operational, ns.
    #[must_use]
    pub const fn operating_since_ns(&self) -> Option<u64> {
        self.operating_since_ns
    }

    /// Simulates one period of the drives at their time `now_ns`. Returns the feedback to send, which a fault
    /// may withhold.
    pub fn step(&mut self, now_ns: u64) -> Option<Feedback> {
        let operating = |drive: &SimDrive| drive.state() == DriveState::OperationEnabled;
        let enabled = !self.drives.is_empty() && self.drives.iter().all(operating);
        if enabled {
            self.operating_since_ns.get_or_insert(now_ns);
        }
        let mut actual = [0.0; AXES];
        for drive in &self.drives {
            actual[drive.axis().axis] = drive.shown();
        }
        let target = self.follower.step(now_ns, enabled, &actual);
        if let Some(shift) = target.datum_shift {
            for drive in &mut self.drives {
                drive.rename(shift[drive.axis().axis]);
            }
            self.index.rename(&shift);
        }
        let armed = self.index.take(target.index);
        let power = self.power_for_all(&target);
        for i in 0..self.drives.len() {
            let axis = self.drives[i].axis().axis;
            let trouble = DriveTrouble {
                faulted: self.is_active(FaultKind::Fault, Some(axis), now_ns),
                disabled: self.is_active(FaultKind::Off, Some(axis), now_ns),
                blocked: self.is_active(FaultKind::Blocked, Some(axis), now_ns),
                home_switch: self.home_switch(axis, now_ns),
                without_index: self.is_active(FaultKind::IndexMissing, Some(axis), now_ns),
            };
            let (position, period_s) = (target.position[axis], self.period_s);
            self.drives[i].step(position, power, target.fault_reset, trouble, period_s);
            let is_awaited = armed.is_none() && self.index.awaited() == Some(axis);
            if let (true, Some(pulse)) = (is_awaited, self.drives[i].passed_index()) {
                self.index.latch(pulse);
            }
        }
        self.last_target = Some(target);
        let feedback = self.feedback(now_ns, &target);
        self.spoil(now_ns, feedback)
    }

    /// Returns what the load sensor sends at `now_ns` for a reading and the end of its range; `None` if it
    /// sends nothing.
    pub fn load_reading(&mut self, now_ns: u64, (value, range_max): (f64, f64)) -> Option<(f64, f64)> {
        let is = |kind| self.is_active(kind, None, now_ns);
        if is(FaultKind::LoadLost) {
            return None;
        }
        let shown = if is(FaultKind::LoadZero) {
            0.0
        } else if is(FaultKind::LoadNan) {
            f64::NAN
        } else if is(FaultKind::LoadSaturated) {
            range_max
        } else if is(FaultKind::LoadNegative) {
            -range_max
        } else if is(FaultKind::LoadFrozen) {
            *self.frozen_load.get_or_insert(value)
        } else {
            self.frozen_load = None;
            value
        };
        Some((shown, range_max))
    }

    /// If one drive cannot continue, none does.
    fn power_for_all(&mut self, target: &Target) -> PowerRequest {
        let was_operating = self
            .last_target
            .is_some_and(|last| !matches!(last.state, evolvent_drive::BridgeState::Off));
        let left = self
            .drives
            .iter()
            .any(|drive| drive.state() != DriveState::OperationEnabled);
        let some_operate = self
            .drives
            .iter()
            .any(|drive| drive.state() == DriveState::OperationEnabled);
        if target.power != PowerRequest::On && !target.is_silent {
            self.group_stop = false;
        } else if self.operating_since_ns.is_some() && was_operating && left && some_operate {
            self.group_stop = true;
        }
        if self.group_stop {
            PowerRequest::QuickStop
        } else {
            target.power
        }
    }

    /// Axes whose absolute encoders have lost their zero.
    fn without_absolute(&self, now_ns: u64) -> AxisMask {
        let axes = self.axes.axes();
        axes.filter(|axis| self.is_active(FaultKind::AbsoluteLost, Some(*axis), now_ns))
            .collect()
    }

    /// The state of a home switch that is stuck open or closed.
    fn home_switch(&self, axis: usize, now_ns: u64) -> Option<bool> {
        let kinds = [(FaultKind::SwitchClosed, true), (FaultKind::SwitchOpen, false)];
        let mut stuck = kinds
            .into_iter()
            .filter(|(kind, _)| self.is_active(*kind, Some(axis), now_ns));
        stuck.next().map(|(_, closed)| closed)
    }

    fn is_active(&self, kind: FaultKind, axis: Option<usize>, now_ns: u64) -> bool {
        let Some(since_ns) = self.operating_since_ns else {
            return false;
        };
        let first = self.drives.first().map(|drive| drive.axis().axis);
        self.faults.iter().any(|fault| {
            fault.kind == kind
                && fault.is_active(now_ns.saturating_sub(since_ns))
                && (axis.is_none() || fault.axis.or(first) == axis)
        })
    }

    fn feedback(&self, now_ns: u64, target: &Target) -> Feedback {
        let mut feedback = Feedback {
            sequence: target.sequence,
            time_ns: now_ns,
            phase_error_ns: target.phase_error_ns,
            axes_mask: self.axes.bits(),
            bridge_state: target.state.number(),
            note: self.follower.note().number(),
            fault_reset_done: u32::MAX,
            missed_setpoints: self.follower.missed(),
            datum: target.datum,
            instance: target.instance(self.instance),
            absolute_mask: if self.absolute {
                self.axes.bits() & !self.without_absolute(now_ns).bits()
            } else {
                0
            },
            ..Feedback::default()
        };
        self.index.describe(&mut feedback);
        for drive in &self.drives {
            let axis = drive.axis().axis;
            feedback.position[axis] = drive.shown();
            feedback.velocity[axis] = drive.servo().velocity;
            feedback.following_error[axis] = target.position[axis] - drive.shown();
            feedback.torque_ratio[axis] = drive.torque_ratio();
            feedback.status_word[axis] = u32::from(drive.status_word());
            feedback.home_switch_mask |= AxisMask::one_if(axis, drive.at_home_switch()).bits();
            let [negative, positive] = drive.at_limit_switches();
            feedback.negative_limit_mask |= AxisMask::one_if(axis, negative).bits();
            feedback.positive_limit_mask |= AxisMask::one_if(axis, positive).bits();
            if feedback.error_code == 0 {
                feedback.error_code = u32::from(drive.error_code());
            }
            feedback.fault_reset_done = feedback.fault_reset_done.min(drive.resets_done());
        }
        feedback
    }

    /// Applies the faults of the feedback.
    fn spoil(&mut self, now_ns: u64, mut feedback: Feedback) -> Option<Feedback> {
        for axis in 0..AXES {
            if !self.axes.contains(axis) {
                continue;
            }
            if self.is_active(FaultKind::Stuck, Some(axis), now_ns) {
                feedback.position[axis] = *self.stuck[axis].get_or_insert(feedback.position[axis]);
            } else {
                self.stuck[axis] = None;
            }
            if self.is_active(FaultKind::Jump, Some(axis), now_ns) {
                feedback.position[axis] += JUMP;
            }
            if self.is_active(FaultKind::Nan, Some(axis), now_ns) {
                feedback.position[axis] = f64::NAN;
            }
            if self.is_active(FaultKind::Wild, Some(axis), now_ns) {
                feedback.position[axis] = WILD;
            }
        }
        if self.is_active(FaultKind::Ahead, None, now_ns) {
            feedback.time_ns += AHEAD_NS;
        }
        if self.is_active(FaultKind::Silent, None, now_ns) {
            return None;
        }
        if self.is_active(FaultKind::Frozen, None, now_ns) {
            return Some(*self.frozen.get_or_insert(feedback));
        }
        self.frozen = None;
        if self.is_active(FaultKind::Late, None, now_ns) {
            self.delayed.push_back(feedback);
            let old = self.delayed.front()?.time_ns.saturating_add(LATE_NS) <= now_ns;
            return if old { self.delayed.pop_front() } else { None };
        }
        self.delayed.clear();
        Some(feedback)
    }
}
