//! Homing by the drive (mode of operation 6): the bridge's side of one axis.

/// The mode of operation.
pub(crate) const HOMING_MODE: i8 = 6;
/// Bit 4 of the control word: homing starts at its rising edge.
pub(crate) const START: u16 = 1 << 4;
/// Bits of the status word in this mode.
const TARGET_REACHED: u16 = 1 << 10;
const ATTAINED: u16 = 1 << 12;
const ERROR: u16 = 1 << 13;
/// Number of periods in which the drive's report of an older homing is ignored.
const BLIND_PERIODS: u32 = 10;

/// Homing settings of one drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingOnDrive {
    /// Object 6098h.
    pub method: i8,
    /// Object 6099h:1, increments/s.
    pub search: u32,
    /// Object 6099h:2, increments/s.
    pub latch: u32,
    /// Object 609Ah, increments/s2; the drive's own if none.
    pub acceleration: Option<u32>,
    /// Machine coordinate of the drive's home position.
    pub position: f64,
    /// Its order in the sequence, the smallest first.
    pub order: u32,
    /// Maximum duration, s.
    pub timeout_s: f64,
}

/// Progress of homing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum HomingProgress {
    /// Not started since the start of the session, or interrupted.
    #[default]
    Needed,
    /// Running for this many periods.
    Running(u32),
    /// The drive knows its position.
    Done,
    /// It has failed, or took too long; until power was off.
    Failed,
}

impl HomingProgress {
    /// One period of a drive in operation in mode 6. `shows_mode`: the drive reports this mode.
    pub(crate) const fn step(self, status_word: u16, shows_mode: bool, max_periods: u32) -> Self {
        match self {
            Self::Needed if shows_mode => Self::Running(0),
            Self::Running(periods) if periods > max_periods => Self::Failed,
            Self::Running(periods) if periods < BLIND_PERIODS => Self::Running(periods + 1),
            Self::Running(_) if status_word & ERROR != 0 => Self::Failed,
            Self::Running(_) if status_word & ATTAINED != 0 && status_word & TARGET_REACHED != 0 => {
                Self::Done
            }
            Self::Running(periods) => Self::Running(periods + 1),
            other => other,
        }
    }

    /// The start bit is low for the first periods, so that its edge is seen.
    pub(crate) const fn control_bits(self) -> u16 {
        match self {
            Self::Running(periods) if periods >= BLIND_PERIODS / 2 => START,
            _ => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn homing_ignores_old_bits_and_ends_by_error_or_time() {
        let run = |status_word: u16, most: u32| {
            let mut progress = HomingProgress::Needed;
            let mut edge = None;
            for period in 0..100 {
                progress = progress.step(status_word, period >= 3, most);
                if edge.is_none() && progress.control_bits() != 0 {
                    edge = Some(period);
                }
                if matches!(progress, HomingProgress::Done | HomingProgress::Failed) {
                    return (progress, edge.expect("an edge"), period);
                }
            }
            (progress, edge.expect("an edge"), 100)
        };
        let (progress, edge, end) = run(ATTAINED | TARGET_REACHED, 1000);
        assert_eq!(progress, HomingProgress::Done);
        assert!(
            edge > 3 && end > edge + 2,
            "low, high, then believed: {edge} {end}"
        );
        assert_eq!(
            run(ATTAINED | TARGET_REACHED | ERROR, 1000).0,
            HomingProgress::Failed
        );
        assert_eq!(run(ATTAINED, 30).0, HomingProgress::Failed, "too long");
        assert!(matches!(run(ATTAINED, 1000).0, HomingProgress::Running(_)));
    }
}
