//! Power of the drives: off at once, and on after the drives have been without power.
//!
//! A bridge that has stopped its drives restores power only after *off*, and a drive takes some periods to
//! leave operation. An ON directly after OFF would come too early for both: the bridge would miss an *off*
//! between two of its periods, or mistake a drive that is late in leaving operation for one that has failed.

use evolvent_bus::Feedback;
use evolvent_drive::{DriveState, PowerRequest};
use evolvent_path::AxisMask;

use super::{CycleState, ServedParts};

/// Maximum time that ON waits for the drives, ns. After it, power is requested, and whatever prevents it
/// raises its alarm. A brake closes faster (60 to 250 ms according to data sheets of servo motors).
const MAX_OFF_NS: u64 = 500_000_000;
/// The same while a drive brakes along its own quick stop ramp, ns: bridges remove the voltage after 2 s.
const MAX_BRAKING_NS: u64 = 2_500_000_000;

/// A waiting ON.
#[derive(Clone, Copy, Debug)]
struct PendingOn {
    order: u64,
    /// Number of periods for which it has waited without power.
    periods: u64,
}

/// An ON that waits for the drives, and the power requested before.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PowerOrders {
    pending: Option<PendingOn>,
    /// The setpoint since which off has been requested.
    off_since: Option<u64>,
    /// The last order that was carried out or rejected.
    settled: u64,
}

impl PowerOrders {
    /// Cancels a waiting ON: after an emergency stop or a fault, power has to be ordered again.
    pub(super) fn cancel(&mut self) {
        if let Some(pending) = self.pending.take() {
            self.settle(pending.order);
        }
    }

    /// Notes that an order was carried out or rejected. An older order than the last changes nothing.
    pub(super) fn settle(&mut self, order: u64) {
        self.settled = self.settled.max(order);
    }

    /// The last order that was carried out or rejected.
    pub(super) const fn settled(&self) -> u64 {
        self.settled
    }

    /// Stores what is requested with a setpoint.
    pub(super) fn record_request(&mut self, power: PowerRequest, sequence: u64) {
        if power == PowerRequest::Off {
            self.off_since.get_or_insert(sequence);
        } else {
            self.off_since = None;
        }
    }
}

impl ServedParts {
    pub(super) fn request_power(&self, now: &mut CycleState, id: u64, request: PowerRequest) {
        match request {
            PowerRequest::On if now.drive.power != PowerRequest::On || now.power_off_at_rest => {
                now.power_orders.pending = Some(PendingOn {
                    order: id,
                    periods: 0,
                });
            }
            PowerRequest::On => now.power_orders.settle(id),
            // A job has ended, but after an emergency stop or a fault the axes still stop on their own:
            // drives without torque would coast.
            PowerRequest::Off if !self.generator.is_at_rest() => {
                now.power_off_at_rest = true;
                now.power_orders.pending = None;
                now.power_orders.settle(id);
            }
            PowerRequest::Off | PowerRequest::QuickStop => {
                now.drive.power = request;
                now.power_off_at_rest = false;
                now.power_orders.pending = None;
                now.power_orders.settle(id);
            }
        }
    }

    /// Carries out a waiting ON once the bridge has replied to a setpoint without power and no drive has
    /// torque. Without feedback it does so at once, because waiting would hide the alarm.
    pub(super) fn carry_out_on(&mut self, now: &mut CycleState, taken_ns: u64) {
        if now.is_estop || now.faulted {
            now.power_orders.cancel();
            return;
        }
        let orders = &mut now.power_orders;
        let Some(pending) = &mut orders.pending else {
            return;
        };
        if now.drive.power != PowerRequest::Off {
            return;
        }
        pending.periods += 1;
        let pending = *pending;
        let newest = self.generator.sequence();
        let is_answered = |last: &Feedback| {
            let is_reply =
                (orders.off_since).is_some_and(|off_since| (off_since..=newest).contains(&last.sequence));
            is_reply && !has_drive(last, DriveState::has_torque)
        };
        let is_settled = self.watch.is_silent(taken_ns) || self.watch.last().is_none_or(is_answered);
        let brakes = |last: &Feedback| has_drive(last, |state| state == DriveState::QuickStopActive);
        let most_ns = if self.watch.last().is_some_and(brakes) {
            MAX_BRAKING_NS
        } else {
            MAX_OFF_NS
        };
        if is_settled || pending.periods * self.period_ns >= most_ns {
            orders.pending = None;
            orders.settle(pending.order);
            now.drive.power = PowerRequest::On;
            now.stops_for_drives = false;
        }
    }
}

/// Whether any drive is in a state that satisfies the predicate.
fn has_drive(feedback: &Feedback, is: impl Fn(DriveState) -> bool) -> bool {
    let axes = AxisMask::from_bits(feedback.axes_mask);
    axes.axes().any(|axis| {
        let status_word = (feedback.status_word[axis] & 0xFFFF) as u16;
        DriveState::decode(status_word).is_some_and(&is)
    })
}
