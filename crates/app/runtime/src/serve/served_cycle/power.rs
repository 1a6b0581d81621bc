//! Power of the drives: off at once, and on once the drives have been without it.
//!
//! A bridge that has stopped its drives gives power again only after *off*, and it takes a drive some periods to leave operation. ON
//! right after OFF would come before either: the bridge would miss the *off* between two of its periods, or take the drive that leaves
//! operation late for one that has failed.

use evolvent_drive::{DriveState, PowerRequest};
use evolvent_path::AxisMask;

use super::{CycleState, ServedParts};

/// How long *off* lasts at most for drives that stay in operation without power being requested, ns. A drive stops and closes its brake
/// in less.
const MAX_OFF_NS: u64 = 500_000_000;

/// Power that is wanted and not yet requested.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PowerReturn {
    /// Number of the order.
    wanted: Option<u64>,
    /// The setpoint since which the drives are requested to be off.
    off_since: Option<u64>,
    /// Since when the bridge has replied to it, in periods.
    replied_periods: u64,
    /// The last order that has been carried out.
    order: u64,
}

impl PowerReturn {
    /// An emergency: whoever wanted power has to ask again.
    pub(super) fn cancel(&mut self) {
        self.wanted = None;
    }

    /// The last order that has been carried out.
    pub(super) const fn order(&self) -> u64 {
        self.order
    }

    /// What the drives are requested to do with a setpoint.
    pub(super) fn note(&mut self, power: PowerRequest, sequence: u64) {
        if power == PowerRequest::Off {
            self.off_since.get_or_insert(sequence);
        } else {
            (self.off_since, self.replied_periods) = (None, 0);
        }
    }
}

impl ServedParts {
    pub(super) fn request_power(now: &mut CycleState, id: u64, request: PowerRequest) {
        match request {
            PowerRequest::On if now.drive.power != PowerRequest::On || now.power_off_at_rest => {
                now.power_return.wanted = Some(id);
            }
            PowerRequest::On => now.power_return.order = id,
            PowerRequest::Off | PowerRequest::QuickStop => {
                now.drive.power = request;
                now.power_off_at_rest = false;
                now.power_return.wanted = None;
                now.power_return.order = id;
            }
        }
    }

    /// Requests power that is wanted, once the bridge has replied to a setpoint without it and no drive has torque.
    pub(super) fn return_power(&mut self, now: &mut CycleState) {
        let power = &mut now.power_return;
        let Some(order) = power.wanted else { return };
        if now.drive.power != PowerRequest::Off {
            return;
        }
        if let Some(last) = self.watch.last() {
            if power.off_since.is_none_or(|off_since| last.sequence < off_since) {
                return;
            }
            power.replied_periods += 1;
            let axes = AxisMask::from_bits(last.axes_mask);
            let has_torque = axes.axes().any(|axis| {
                matches!(
                    DriveState::decode((last.status_word[axis] & 0xFFFF) as u16),
                    Some(
                        DriveState::OperationEnabled
                            | DriveState::QuickStopActive
                            | DriveState::FaultReactionActive
                    )
                )
            });
            if has_torque && power.replied_periods * self.period_ns < MAX_OFF_NS {
                return;
            }
        }
        (power.wanted, power.order) = (None, order);
        now.drive.power = PowerRequest::On;
    }
}
