//! State that the threads of a run share without waiting.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use evolvent_motion::{Inputs, MotionState, Setpoint};
use evolvent_turning::{AdaptiveSettings, LoadSample};

use crate::drive_report::DriveReport;
use crate::load_cell::LoadCell;
use evolvent_control::Alarm;

/// Inputs and progress of a run. The cycle reads the inputs once per cycle and sets the progress; no access
/// waits.
#[derive(Debug)]
pub struct Controls {
    feed_override: AtomicU64,
    hold: AtomicBool,
    stop: AtomicBool,
    resume: AtomicBool,
    abandon: AtomicBool,
    program_failed: AtomicBool,
    alarm: AtomicU32,
    /// Adaptive feed, if requested.
    adaptive: Option<AdaptiveSettings>,
    load: LoadCell,
    gauges: Gauges,
    /// The machine waits at rest for a user-defined M code.
    at_command: AtomicBool,
    /// Number of the action before the last user-defined M code that was carried out, plus 1.
    commands_done: AtomicU32,
    /// The emergency-stop chain is closed.
    chain_closed: AtomicBool,
    /// The drives' last feedback as a [`DriveReport`]; 0 before the first.
    drives: AtomicU64,
    /// Number of the setpoint after which all ramps of spindles were at rest, plus 1; 0 while a ramp turns
    /// its spindle.
    ramps_rested: AtomicU64,
}

/// Progress of the run.
#[derive(Debug)]
struct Gauges {
    sequence: AtomicU64,
    path_mm: AtomicU64,
    feed_mm_s: AtomicU64,
    line: AtomicU32,
    state: AtomicU32,
    actions: AtomicU32,
    blocks: AtomicU32,
    resumes: AtomicU32,
}

impl Default for Gauges {
    fn default() -> Self {
        Self {
            sequence: AtomicU64::new(0),
            path_mm: AtomicU64::new(0),
            feed_mm_s: AtomicU64::new(0),
            line: AtomicU32::new(0),
            state: AtomicU32::new(MotionState::Idle as u32),
            actions: AtomicU32::new(0),
            blocks: AtomicU32::new(0),
            resumes: AtomicU32::new(0),
        }
    }
}

impl Controls {
    /// No hold and no stop.
    #[must_use]
    pub fn new(feed_override: f64) -> Self {
        Self {
            feed_override: AtomicU64::new(feed_override.to_bits()),
            hold: AtomicBool::new(false),
            stop: AtomicBool::new(false),
            resume: AtomicBool::new(false),
            abandon: AtomicBool::new(false),
            program_failed: AtomicBool::new(false),
            alarm: AtomicU32::new(0),
            adaptive: None,
            load: LoadCell::default(),
            gauges: Gauges::default(),
            at_command: AtomicBool::new(false),
            commands_done: AtomicU32::new(0),
            chain_closed: AtomicBool::new(false),
            drives: AtomicU64::new(0),
            ramps_rested: AtomicU64::new(0),
        }
    }

    /// Sets whether the machine waits for a user-defined M code. Called by the cycle.
    pub(crate) fn set_at_command(&self, at_command: bool) {
        self.at_command.store(at_command, Ordering::Relaxed);
    }

    /// Notes that the user-defined M code after this action was carried out.
    pub(crate) fn command_done(&self, action: u32) {
        self.commands_done.store(action + 1, Ordering::Release);
    }

    pub(crate) fn is_command_done(&self, action: u32) -> bool {
        self.commands_done.load(Ordering::Acquire) == action + 1
    }

    /// Sets whether the emergency-stop chain is closed, according to the bus.
    pub(crate) fn set_chain_closed(&self, closed: bool) {
        self.chain_closed.store(closed, Ordering::Relaxed);
    }

    pub(crate) fn is_chain_closed(&self) -> bool {
        self.chain_closed.load(Ordering::Relaxed)
    }

    /// Stores feedback of the drives.
    pub(crate) fn set_drives(&self, report: DriveReport) {
        self.drives.store(report.to_bits(), Ordering::Relaxed);
    }

    /// The drives' last feedback; `None` before the first.
    pub(crate) fn drives(&self) -> Option<DriveReport> {
        DriveReport::from_bits(self.drives.load(Ordering::Relaxed))
    }

    /// Notes whether a ramp turns its spindle with this setpoint. Called by the publisher.
    pub(crate) fn report_ramps(&self, sequence: u64, turns: bool) {
        let rested = if turns { 0 } else { sequence + 1 };
        self.ramps_rested.store(rested, Ordering::Relaxed);
    }

    /// Whether all ramps have ended at 0 with this setpoint or a later one.
    pub(crate) fn are_ramps_at_rest_after(&self, sequence: u64) -> bool {
        self.ramps_rested.load(Ordering::Relaxed) > sequence
    }

    /// Keeps the cutting load constant by adapting the feed. Invalid settings have no effect: check them with
    /// [`evolvent_turning::AdaptiveFeed::new`].
    #[must_use]
    pub fn with_adaptive_feed(mut self, settings: AdaptiveSettings) -> Self {
        self.adaptive = Some(settings);
        self
    }

    pub(crate) fn adaptive(&self) -> Option<AdaptiveSettings> {
        self.adaptive
    }

    /// Stores a cutting load and the highest value that its sensor can report. Call it from one thread only:
    /// the one that reads the bus or, without a bus, the one that simulates a sensor.
    pub fn set_load(&self, value: f64, range_max: f64) {
        self.load.observe(value, range_max);
    }

    /// The newest cutting load; `None` before the first.
    pub(crate) fn load(&self) -> Option<LoadSample> {
        self.load.newest()
    }

    /// Sets the feed override; 1 is 100 %.
    pub fn set_override(&self, factor: f64) {
        self.feed_override.store(factor.to_bits(), Ordering::Relaxed);
    }

    /// Holds the feed or releases the hold.
    pub fn set_hold(&self, hold: bool) {
        self.hold.store(hold, Ordering::Relaxed);
    }

    /// Stops within the limits and ends the run.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Whether a stop was requested.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Continues after a program stop.
    pub fn resume(&self) {
        self.resume.store(true, Ordering::Relaxed);
    }

    /// The cycle has ended, so the rest of the plan is not needed.
    pub(crate) fn abandon(&self) {
        self.abandon.store(true, Ordering::Release);
    }

    pub(crate) fn is_abandoned(&self) -> bool {
        self.abandon.load(Ordering::Acquire)
    }

    /// Notes that the plan ends before the program does. Call it before the end of the plan is passed on.
    pub(crate) fn fail_program(&self) {
        self.program_failed.store(true, Ordering::Release);
    }

    pub(crate) fn has_program_failed(&self) -> bool {
        self.program_failed.load(Ordering::Acquire)
    }

    /// Latches an alarm unless one is latched.
    pub(crate) fn raise(&self, alarm: Alarm) {
        let _latched = self
            .alarm
            .compare_exchange(0, alarm.number(), Ordering::Relaxed, Ordering::Relaxed);
    }

    /// Number of the alarm in force; 0 for none.
    pub(crate) fn alarm(&self) -> u32 {
        self.alarm.load(Ordering::Relaxed)
    }

    /// The present inputs of the cycle.
    pub(crate) fn inputs(&self) -> Inputs {
        // Taken once: a resume ends the program stop at which the machine waits, and no later one.
        let resume = self.resume.load(Ordering::Relaxed) && self.resume.swap(false, Ordering::Relaxed);
        let at_stop = self.is_at_program_stop();
        if resume && at_stop {
            self.gauges.resumes.fetch_add(1, Ordering::Relaxed);
        }
        Inputs {
            feed_override: self.feed_override(),
            hold: self.hold.load(Ordering::Relaxed),
            stop: self.stop.load(Ordering::Relaxed),
            resume: resume && at_stop,
            load: self.load(),
            ..Inputs::default()
        }
    }

    fn is_at_program_stop(&self) -> bool {
        self.gauges.state.load(Ordering::Relaxed) == MotionState::ProgramStop as u32
            && !self.at_command.load(Ordering::Relaxed)
    }

    /// The requested feed override.
    pub(crate) fn feed_override(&self) -> f64 {
        f64::from_bits(self.feed_override.load(Ordering::Relaxed))
    }

    pub(crate) fn publish(&self, setpoint: &Setpoint) {
        self.gauges
            .sequence
            .store(setpoint.sequence + 1, Ordering::Relaxed);
        self.gauges
            .path_mm
            .store(setpoint.path_mm.to_bits(), Ordering::Relaxed);
        self.gauges
            .feed_mm_s
            .store(setpoint.feed_mm_s.to_bits(), Ordering::Relaxed);
        self.gauges.line.store(setpoint.line, Ordering::Relaxed);
        self.gauges.state.store(setpoint.state as u32, Ordering::Relaxed);
        self.gauges.actions.store(setpoint.actions, Ordering::Relaxed);
        if !matches!(
            setpoint.state,
            MotionState::Idle | MotionState::Dwell | MotionState::ProgramStop
        ) {
            self.gauges.blocks.store(setpoint.block + 1, Ordering::Relaxed);
        }
    }

    /// The progress of the run.
    #[must_use]
    pub fn progress(&self) -> Progress {
        Progress {
            cycles: self.gauges.sequence.load(Ordering::Relaxed),
            path_mm: f64::from_bits(self.gauges.path_mm.load(Ordering::Relaxed)),
            feed_mm_s: f64::from_bits(self.gauges.feed_mm_s.load(Ordering::Relaxed)),
            line: self.gauges.line.load(Ordering::Relaxed),
            at_program_stop: self.is_at_program_stop(),
            at_command: self.at_command.load(Ordering::Relaxed),
            actions: self.gauges.actions.load(Ordering::Relaxed),
            blocks: self.gauges.blocks.load(Ordering::Relaxed),
            has_ended: self.gauges.state.load(Ordering::Relaxed) == MotionState::Done as u32,
            resumes: self.gauges.resumes.load(Ordering::Relaxed),
        }
    }
}

/// Progress of a run, for display.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Number of setpoints computed.
    pub cycles: u64,
    /// Path travelled.
    pub path_mm: f64,
    /// Speed along the path.
    pub feed_mm_s: f64,
    /// Program line.
    pub line: u32,
    /// Waiting at M0, M1 or M60.
    pub at_program_stop: bool,
    /// Waiting for a user-defined M code (M100 to M199).
    pub at_command: bool,
    /// Number of actions of the periphery that have taken effect.
    pub actions: u32,
    /// Number of blocks begun.
    pub blocks: u32,
    /// The program has reached its end.
    pub has_ended: bool,
    /// Number of program stops that were resumed.
    pub resumes: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_resume_ends_only_one_pending_program_stop() {
        let controls = Controls::new(1.0);
        controls.resume();
        assert!(!controls.inputs().resume, "asked before there was a stop");
        controls
            .gauges
            .state
            .store(MotionState::ProgramStop as u32, Ordering::Relaxed);
        assert!(!controls.inputs().resume, "the wish from before is forgotten");
        controls.resume();
        assert!(controls.inputs().resume);
        assert!(
            !controls.inputs().resume,
            "a second stop in a row waits for its own wish"
        );
        assert_eq!(controls.progress().resumes, 1);
    }

    #[test]
    fn the_first_alarm_stays() {
        let controls = Controls::new(1.0);
        controls.raise(Alarm::Guard);
        controls.raise(Alarm::Lateness);
        assert_eq!(controls.alarm(), Alarm::Guard.number());
    }
}
