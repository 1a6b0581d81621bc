//! A program that depends on a cutting load: the wait before it moves, and its end if the drives of the cut
//! stop on their own.

use evolvent_drive::DriveAlarm;
use evolvent_machine::FeedbackMode;

use crate::job::Job;
use crate::shared::Controls;

/// Maximum wait for a load, and for drives with feedback to follow, ns.
const PATIENCE_NS: u64 = 15_000_000_000;
/// Drives that measure a load send feedback within this time after the first reading, ns.
const ANSWER_NS: u64 = 100_000_000;

/// Why a program did not begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NotBegun {
    /// No load was received.
    NoLoad,
    /// Drives send feedback but do not follow.
    DrivesStand,
}

impl NotBegun {
    /// What happened, and the remedy.
    pub(crate) fn text(self) -> String {
        let seconds = PATIENCE_NS / 1_000_000_000;
        match self {
            Self::NoLoad => format!(
                "no cutting load was received on the bus within {seconds} s, so nothing was moved: start the \
                 load sensor (or `evolvent bridge sim --process FILE`) with the same machine name and prefix \
                 of the bus, or leave out --process and --adaptive"
            ),
            Self::DrivesStand => format!(
                "drives reply on the bus, but have not followed within {seconds} s, so nothing was moved: \
                 check that they are at the position in the machine file (`home_mm`) and have no fault"
            ),
        }
    }
}

/// Whether the program of a job depends on a load from the bus.
pub(crate) fn needs_load(job: &Job, controls: &Controls) -> bool {
    job.is_realtime() && (job.setup.process.is_some() || controls.adaptive().is_some())
}

/// Holds a program at its start until a load arrives and drives with feedback follow. Without them, before
/// the start or after they have stopped, no sensor would measure a cut. Real-time safe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Standby {
    period_ns: u64,
    waits: bool,
    waited_ns: u64,
    /// Time since the first reading.
    felt_ns: u64,
    watches_drives: bool,
    /// The program has begun, and the drives have followed it.
    have_followed: bool,
}

impl Standby {
    /// For a program that needs a load from the bus, or for one that does not.
    pub(crate) fn new(needs_load: bool, period_ns: u64) -> Self {
        Self {
            period_ns,
            waits: needs_load,
            waited_ns: 0,
            felt_ns: 0,
            watches_drives: needs_load,
            have_followed: false,
        }
    }

    /// Drives whose feedback the machine file ignores do not end the program.
    pub(crate) fn with_drives(mut self, feedback: FeedbackMode) -> Self {
        self.watches_drives &= feedback != FeedbackMode::Ignore;
        self
    }

    /// The reason why drives that have followed the program no longer do so.
    pub(crate) fn drive_stop(&mut self, controls: &Controls) -> Option<DriveAlarm> {
        let report = controls.drives().filter(|_| self.watches_drives && !self.waits)?;
        self.have_followed |= report.follows();
        report.stop_cause().filter(|_| self.have_followed)
    }

    /// Returns whether the program is held in this cycle.
    ///
    /// # Errors
    /// It was held for too long: the run ends.
    pub(crate) fn step(&mut self, controls: &Controls) -> Result<bool, NotBegun> {
        if !self.waits {
            return Ok(false);
        }
        let felt = controls.load().is_some();
        if felt {
            self.felt_ns = self.felt_ns.saturating_add(self.period_ns);
        }
        let follows = controls.drives().is_none_or(|report| report.follows());
        if self.felt_ns > ANSWER_NS && follows {
            self.waits = false;
            return Ok(false);
        }
        self.waited_ns = self.waited_ns.saturating_add(self.period_ns);
        if self.waited_ns <= PATIENCE_NS {
            return Ok(true);
        }
        Err(if felt {
            NotBegun::DrivesStand
        } else {
            NotBegun::NoLoad
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive_report::DriveReport;
    use evolvent_bus::Feedback;
    use evolvent_drive::BridgeState;

    const PERIOD_NS: u64 = 1_000_000;

    fn drives(state: BridgeState) -> DriveReport {
        DriveReport::of(&Feedback {
            bridge_state: state.number(),
            note: 2,
            ..Feedback::default()
        })
    }

    fn cycles_until_begun(controls: &Controls, most: u64) -> Option<u64> {
        let mut standby = Standby::new(true, PERIOD_NS);
        (0..most).find(|_| standby.step(controls) == Ok(false))
    }

    #[test]
    fn a_program_begins_once_a_load_is_there() {
        let controls = Controls::new(1.0);
        assert_eq!(cycles_until_begun(&controls, 15_000), None);
        controls.set_load(0.0, 100.0);
        assert_eq!(cycles_until_begun(&controls, 1000), Some(100));
        // Drives with feedback must follow.
        controls.set_drives(drives(BridgeState::Holding));
        assert_eq!(cycles_until_begun(&controls, 15_000), None);
        controls.set_drives(drives(BridgeState::Following));
        assert_eq!(cycles_until_begun(&controls, 1000), Some(100));
    }

    #[test]
    fn what_never_comes_ends_the_run_with_its_reason() {
        let controls = Controls::new(1.0);
        let ends = |controls: &Controls| {
            let mut standby = Standby::new(true, PERIOD_NS);
            (0..20_000).find_map(|_| standby.step(controls).err())
        };
        assert_eq!(ends(&controls), Some(NotBegun::NoLoad));
        controls.set_load(0.0, 100.0);
        controls.set_drives(drives(BridgeState::Holding));
        assert_eq!(ends(&controls), Some(NotBegun::DrivesStand));
        let mut none = Standby::new(false, PERIOD_NS);
        assert_eq!(none.step(&controls), Ok(false));
    }

    #[test]
    fn drives_that_stop_following_end_the_program() {
        let controls = Controls::new(1.0);
        let mut standby = Standby::new(true, PERIOD_NS);
        controls.set_load(0.0, 100.0);
        // They may be stopped before the program begins.
        for state in [
            BridgeState::Following,
            BridgeState::Holding,
            BridgeState::Following,
        ] {
            controls.set_drives(drives(state));
            assert_eq!(standby.step(&controls), Ok(true));
            assert_eq!(standby.drive_stop(&controls), None);
        }
        while standby.step(&controls) == Ok(true) {}
        for state in [BridgeState::Following, BridgeState::Bridging] {
            controls.set_drives(drives(state));
            assert_eq!(standby.drive_stop(&controls), None);
        }
        let mut ignores = standby.with_drives(FeedbackMode::Ignore);
        controls.set_drives(drives(BridgeState::Holding));
        let stopped = DriveAlarm::BridgeStopped { state: 4, note: 2 };
        assert_eq!(standby.drive_stop(&controls), Some(stopped));
        assert_eq!(ignores.drive_stop(&controls), None);
        let mut none = Standby::new(false, PERIOD_NS);
        assert_eq!(none.drive_stop(&controls), None);
    }
}
