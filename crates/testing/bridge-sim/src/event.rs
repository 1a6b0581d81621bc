//! Events of a running bridge: its core and its drives.

use core::fmt::{self, Display};

use evolvent_drive::{BridgeState, DriveState, Note, PowerRequest, Target};
use evolvent_path::AxisLetter;

use crate::bridge::SimBridge;

/// An event that the user of the bridge should see at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SimEvent {
    /// There is no core yet.
    Waiting,
    /// The bridge has found a core.
    Core {
        /// Letters of its axes.
        axes: String,
        /// Its period, ns.
        period_ns: u64,
    },
    /// The drives followed, and have stopped although power is still requested.
    Stopped(StopCause),
    /// The drives follow again.
    Follows,
}

/// Why the drives have stopped by themselves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopCause {
    /// There was no setpoint to follow.
    Setpoints {
        /// Number of periods for which the motion continued without setpoints.
        periods: u32,
        /// The last problem with setpoints.
        note: Note,
    },
    /// A drive is in fault.
    Fault {
        /// Index of its axis.
        axis: usize,
        /// Object 603Fh.
        error_code: u16,
    },
    /// A drive has left operation.
    Off {
        /// Index of its axis.
        axis: usize,
    },
}

impl Display for StopCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Setpoints { note, .. } if *note == Note::Restart => {
                f.write_str("another core has started, and the motion of the previous one is void")
            }
            Self::Setpoints { periods, note } => {
                let kind = match note {
                    Note::Late => ", the last ones too late",
                    Note::Jump => ", the last ones beyond reach of the axes",
                    Note::NotFinite => ", the last ones not finite",
                    Note::Version => ", the last ones of another interface version",
                    _ => "",
                };
                write!(
                    f,
                    "no usable setpoints arrived for {periods} periods{kind} (the core has ended, or this \
                     host kept it or the bridge from running)"
                )
            }
            Self::Fault { axis, error_code } => {
                let letter = AxisLetter::letter_of(*axis);
                write!(
                    f,
                    "the drive of {letter} is in fault, error code {error_code:#06x}"
                )
            }
            Self::Off { axis } => write!(
                f,
                "the drive of {} has switched itself off",
                AxisLetter::letter_of(*axis)
            ),
        }
    }
}

impl Display for SimEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Waiting => f.write_str("waiting for its core"),
            Self::Core { axes, period_ns } => write!(f, "core found: axes {axes}, {period_ns} ns"),
            Self::Stopped(cause @ StopCause::Setpoints { .. }) => write!(
                f,
                "the drives no longer follow: {cause}; they brake and hold until setpoints begin at \
                 their positions"
            ),
            Self::Stopped(cause) => write!(
                f,
                "the drives no longer follow: {cause}; all of them stop until their power is switched off \
                 and on again"
            ),
            Self::Follows => f.write_str("the drives follow setpoints again"),
        }
    }
}

/// Detects when the drives stop by themselves and when they follow again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum FollowWatch {
    /// The drives have not followed since power was requested.
    #[default]
    Idle,
    Following,
    /// The drives followed and have stopped.
    Stopped,
}

impl FollowWatch {
    /// Updates the state after a period of the bridge.
    pub(crate) fn step(&mut self, bridge: &SimBridge) -> Option<SimEvent> {
        let target = bridge.last_target()?;
        let next = match target.state {
            BridgeState::Following | BridgeState::Bridging => Self::Following,
            _ if *self != Self::Following => return None,
            _ if target.requested_power() == PowerRequest::On => Self::Stopped,
            _ => Self::Idle,
        };
        let last = core::mem::replace(self, next);
        match (last, next) {
            (_, Self::Stopped) => Some(SimEvent::Stopped(stop_cause(bridge, target))),
            (Self::Stopped, Self::Following) => Some(SimEvent::Follows),
            _ => None,
        }
    }
}

fn stop_cause(bridge: &SimBridge, target: &Target) -> StopCause {
    if matches!(target.state, BridgeState::Braking | BridgeState::Holding) {
        return StopCause::Setpoints {
            periods: bridge.bridge_cycles(),
            note: bridge.note(),
        };
    }
    let drives = bridge.drives();
    if let Some(drive) = drives.iter().find(|drive| drive.state().is_fault()) {
        return StopCause::Fault {
            axis: drive.axis().axis,
            error_code: drive.error_code(),
        };
    }
    // The other drives were stopped because of this one.
    let has_left =
        |state: DriveState| !matches!(state, DriveState::OperationEnabled | DriveState::QuickStopActive);
    let off = drives.iter().find(|drive| has_left(drive.state()));
    StopCause::Off {
        axis: off.or(drives.first()).map_or(0, |drive| drive.axis().axis),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Fault, FaultKind, SimSettings};
    use evolvent_bus::Setpoint;

    const PERIOD_NS: u64 = 1_000_000;

    struct Bench {
        bridge: SimBridge,
        watch: FollowWatch,
        sequence: u64,
        now_ns: u64,
        events: Vec<SimEvent>,
    }

    impl Bench {
        fn new(faults: Vec<Fault>) -> Self {
            let mut settings = SimSettings::usual("XY", PERIOD_NS);
            settings.faults = faults;
            Self {
                bridge: SimBridge::new(&settings).unwrap(),
                watch: FollowWatch::default(),
                sequence: 0,
                now_ns: 1_000_000_000,
                events: Vec::new(),
            }
        }

        /// Periods with a setpoint each, or without any.
        fn step(&mut self, periods: u64, power: Option<PowerRequest>) {
            for _ in 0..periods {
                self.now_ns += PERIOD_NS;
                self.sequence += 1;
                if let Some(power) = power {
                    let position = self.bridge.shown_positions();
                    let setpoint = Setpoint {
                        sequence: self.sequence,
                        due_time_ns: self.now_ns + 2 * PERIOD_NS,
                        period_ns: PERIOD_NS,
                        axes_mask: 0b11,
                        power_request: power.number(),
                        position,
                        ..Setpoint::default()
                    };
                    self.bridge.offer(self.now_ns, &setpoint);
                }
                let _feedback = self.bridge.step(self.now_ns);
                self.events.extend(self.watch.step(&self.bridge));
            }
        }
    }

    #[test]
    fn drives_stopped_by_missing_setpoints_reported_once() {
        let mut bench = Bench::new(Vec::new());
        bench.step(1000, Some(PowerRequest::On));
        assert_eq!(bench.events, []);
        bench.step(500, None);
        let messages = bench.events.iter().map(ToString::to_string).collect::<Vec<_>>();
        assert_eq!(messages.len(), 1, "{messages:?}");
        assert!(
            messages[0].contains("no usable setpoints arrived for 10 periods"),
            "{messages:?}"
        );
        bench.step(500, Some(PowerRequest::On));
        assert_eq!(bench.events[1..], [SimEvent::Follows]);
        // A stop that the core requests is no event.
        bench.step(500, Some(PowerRequest::Off));
        bench.step(500, None);
        assert_eq!(bench.events.len(), 2, "{:?}", bench.events);
    }

    #[test]
    fn a_drive_that_fails_is_named() {
        for (kind, wanted) in [
            (FaultKind::Fault, "the drive of Y is in fault"),
            (FaultKind::Off, "the drive of Y has switched itself off"),
        ] {
            let mut bench = Bench::new(vec![Fault {
                kind,
                at_ns: 100_000_000,
                duration_ns: None,
                axis: Some(1),
            }]);
            bench.step(1500, Some(PowerRequest::On));
            let messages = bench.events.iter().map(ToString::to_string).collect::<Vec<_>>();
            assert_eq!(messages.len(), 1, "{messages:?}");
            assert!(messages[0].contains(wanted), "{messages:?}");
        }
    }
}
