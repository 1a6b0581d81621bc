//! The last feedback of the drives, as far as a run uses it.

use evolvent_bus::{AXES, Feedback};
use evolvent_drive::{BridgeState, DriveAlarm, DriveState};
use evolvent_path::AxisMask;

/// A drive that is not in operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct StoppedDrive {
    axis: usize,
    status_word: u16,
    error_code: u16,
}

/// State of bridge and drives in one feedback message. It fits into one number, so that one thread can pass
/// it to another atomically.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DriveReport {
    state: BridgeState,
    note: u8,
    /// The first drive in fault; otherwise the first one that has left operation; otherwise the first one in
    /// quick stop.
    idle: Option<StoppedDrive>,
}

/// Set in every number, so that 0 means none.
const PRESENT: u64 = 1 << 63;
const IDLE: u64 = 1 << 62;

impl DriveReport {
    pub(crate) fn of(feedback: &Feedback) -> Self {
        let idle = |is_wanted: &dyn Fn(Option<DriveState>) -> bool| {
            let mut axes = AxisMask::from_bits(feedback.axes_mask)
                .axes()
                .filter(|axis| *axis < AXES);
            axes.find(|axis| is_wanted(DriveState::decode(feedback.status_word[*axis] as u16)))
        };
        let is_operating = |state| state == Some(DriveState::OperationEnabled);
        let axis = idle(&|state| state.is_some_and(DriveState::is_fault))
            // The bridge applies a quick stop to the other drives because of this one.
            .or_else(|| idle(&|state| !is_operating(state) && state != Some(DriveState::QuickStopActive)))
            .or_else(|| idle(&|state| !is_operating(state)));
        Self {
            state: BridgeState::from_number(feedback.bridge_state).unwrap_or_default(),
            note: feedback.note as u8,
            idle: axis.map(|axis| StoppedDrive {
                axis,
                status_word: feedback.status_word[axis] as u16,
                error_code: feedback.error_code as u16,
            }),
        }
    }

    /// Every drive follows the setpoints.
    pub(crate) fn follows(&self) -> bool {
        self.idle.is_none() && self.state == BridgeState::Following
    }

    /// The reason why drives that were requested to follow do not.
    pub(crate) fn stop_cause(&self) -> Option<DriveAlarm> {
        if let Some(idle) = self.idle {
            let (axis, status_word) = (idle.axis, u32::from(idle.status_word));
            let state = DriveState::decode(idle.status_word);
            return Some(if state.is_some_and(DriveState::is_fault) {
                DriveAlarm::DriveFault {
                    axis,
                    status_word,
                    error_code: u32::from(idle.error_code),
                }
            } else {
                DriveAlarm::DriveOff { axis, status_word }
            });
        }
        // Single setpoints may be missing.
        let goes_on = matches!(self.state, BridgeState::Following | BridgeState::Bridging);
        (!goes_on).then(|| DriveAlarm::BridgeStopped {
            state: self.state.number(),
            note: u32::from(self.note),
        })
    }

    pub(crate) fn to_bits(self) -> u64 {
        let idle = self.idle.map_or(0, |idle| {
            let words = u64::from(idle.error_code) << 32 | u64::from(idle.status_word) << 16;
            IDLE | words | (idle.axis as u64 & 0xF) << 12
        });
        PRESENT | idle | u64::from(self.note) << 4 | u64::from(self.state.number())
    }

    /// The report from its bits; `None` for 0.
    pub(crate) fn from_bits(bits: u64) -> Option<Self> {
        (bits & PRESENT != 0).then(|| Self {
            state: BridgeState::from_number(bits as u32 & 0xF).unwrap_or_default(),
            note: (bits >> 4) as u8,
            idle: (bits & IDLE != 0).then_some(StoppedDrive {
                axis: (bits >> 12) as usize & 0xF,
                status_word: (bits >> 16) as u16,
                error_code: (bits >> 32) as u16,
            }),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPERATING: u32 = 0x1237;

    fn feedback(state: BridgeState, status_word: [u32; 3]) -> Feedback {
        let mut feedback = Feedback {
            axes_mask: 0b1_0000_0011,
            bridge_state: state.number(),
            note: 2,
            error_code: 0xFF01,
            ..Feedback::default()
        };
        [
            feedback.status_word[0],
            feedback.status_word[1],
            feedback.status_word[8],
        ] = status_word;
        feedback
    }

    /// The report as another thread receives it.
    fn report(state: BridgeState, status_word: [u32; 3]) -> DriveReport {
        let report = DriveReport::of(&feedback(state, status_word));
        assert_eq!(DriveReport::from_bits(report.to_bits()), Some(report));
        report
    }

    #[test]
    fn drives_follow_or_have_stopped_for_a_reason() {
        assert_eq!(DriveReport::from_bits(0), None);
        let all = [OPERATING; 3];
        assert!(report(BridgeState::Following, all).follows());
        for state in [BridgeState::Following, BridgeState::Bridging] {
            assert_eq!(report(state, all).stop_cause(), None);
        }
        for state in [
            BridgeState::Braking,
            BridgeState::Holding,
            BridgeState::Off,
            BridgeState::Waiting,
        ] {
            let (number, stopped) = (state.number(), report(state, all));
            let alarm = DriveAlarm::BridgeStopped {
                state: number,
                note: 2,
            };
            assert_eq!((stopped.follows(), stopped.stop_cause()), (false, Some(alarm)));
        }
        // A quick stop of the other drives does not hide the drive in fault.
        let stopped = report(BridgeState::Following, [0x17, OPERATING, 0x18]);
        let alarm = DriveAlarm::DriveFault {
            axis: 8,
            status_word: 0x18,
            error_code: 0xFF01,
        };
        assert_eq!((stopped.follows(), stopped.stop_cause()), (false, Some(alarm)));
        let stopped = report(BridgeState::Off, [0x17, 0x50, OPERATING]);
        let alarm = DriveAlarm::DriveOff {
            axis: 1,
            status_word: 0x50,
        };
        assert_eq!(stopped.stop_cause(), Some(alarm));
    }
}
