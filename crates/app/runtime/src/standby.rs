//! The time before a program that needs a cutting load moves.

use crate::shared::Controls;

/// How long a load is waited for, and drives that answer until they follow, ns.
const PATIENCE_NS: u64 = 15_000_000_000;
/// Drives that measure a load answer within this time after the first reading, ns.
const ANSWER_NS: u64 = 100_000_000;

/// Why a program was not begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NotBegun {
    /// No load has come in.
    NoLoad,
    /// Drives answer, and do not follow.
    DrivesStand,
}

impl NotBegun {
    /// What has happened and what to do.
    pub(crate) fn text(self) -> String {
        let seconds = PATIENCE_NS / 1_000_000_000;
        match self {
            Self::NoLoad => format!(
                "no cutting load has come over the bus within {seconds} s, so nothing was moved: start the load sensor (or \
                 `evolvent bridge sim --process FILE`) with the same machine name and prefix of the bus, or leave out \
                 --process and --adaptive"
            ),
            Self::DrivesStand => format!(
                "drives answer on the bus, and have not followed within {seconds} s, so nothing was moved: see whether they \
                 stand where the machine file says (`home_mm`), and have no fault"
            ),
        }
    }
}

/// Holds a program at its start until a load comes in, and until drives that answer follow: what moves before cuts
/// nothing that anybody feels. Real-time safe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Standby {
    period_ns: u64,
    waits: bool,
    waited_ns: u64,
    /// Since the first reading.
    felt_ns: u64,
}

impl Standby {
    /// For a program that needs a load from the bus, or for one that does not.
    pub(crate) fn new(needs_load: bool, period_ns: u64) -> Self {
        Self {
            period_ns,
            waits: needs_load,
            waited_ns: 0,
            felt_ns: 0,
        }
    }

    /// Whether the program is held in this cycle.
    ///
    /// # Errors
    /// It has been held for too long: the run ends.
    pub(crate) fn step(&mut self, controls: &Controls) -> Result<bool, NotBegun> {
        if !self.waits {
            return Ok(false);
        }
        let felt = controls.load().is_some();
        if felt {
            self.felt_ns = self.felt_ns.saturating_add(self.period_ns);
        }
        let follows = !controls.has_seen_drives() || controls.drives_follow();
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

    const PERIOD_NS: u64 = 1_000_000;

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
        // Drives that answer have to follow.
        controls.set_drives_follow(false);
        assert_eq!(cycles_until_begun(&controls, 15_000), None);
        controls.set_drives_follow(true);
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
        controls.set_drives_follow(false);
        assert_eq!(ends(&controls), Some(NotBegun::DrivesStand));
        let mut none = Standby::new(false, PERIOD_NS);
        assert_eq!(none.step(&controls), Ok(false));
    }
}
