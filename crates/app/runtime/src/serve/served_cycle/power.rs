//! Power of the drives: off at once, and on once the drives have been without it.
//!
//! A bridge that has stopped its drives gives power again only after *off*, and it takes a drive some periods
//! to leave operation. ON right after OFF would come before either: the bridge would miss the *off* between
//! two of its periods, or take the drive that leaves operation late for one that has failed.

use evolvent_bus::Feedback;
use evolvent_drive::{DriveState, PowerRequest};
use evolvent_path::AxisMask;

use super::{CycleState, ServedParts};

/// How long ON waits at most for the drives, ns: then power is requested, and what hinders it raises its
/// alarm. A brake closes in less (60 to 250 ms by the data sheets of servo motors).
const MAX_OFF_NS: u64 = 500_000_000;
/// The same while a drive brakes by its own quick stop ramp, ns: bridges remove the voltage after 2 s.
const MAX_BRAKING_NS: u64 = 2_500_000_000;

/// An ON that waits.
#[derive(Clone, Copy, Debug)]
struct PendingOn {
    order: u64,
    /// Periods for which it has waited without power.
    periods: u64,
}

/// ON that waits for the drives, and what they were asked before.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PowerOrders {
    pending: Option<PendingOn>,
    /// The setpoint since which the drives are requested to be off.
    off_since: Option<u64>,
    /// The last order that was carried out or refused.
    settled: u64,
}

impl PowerOrders {
    /// After an emergency or a fault power has to be ordered again.
    pub(super) fn cancel(&mut self) {
        if let Some(pending) = self.pending.take() {
            self.settle(pending.order);
        }
    }

    /// An order was carried out or refused. One that was overtaken by a later one changes nothing.
    pub(super) fn settle(&mut self, order: u64) {
        self.settled = self.settled.max(order);
    }

    /// The last order that was carried out or refused.
    pub(super) const fn settled(&self) -> u64 {
        self.settled
    }

    /// Remembers what is requested with a setpoint.
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
            // A job has ended, but the axes still stop by themselves after an emergency or a fault: drives
            // without torque would coast.
            PowerRequest::Off if !self.station.is_at_rest() => {
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

    /// Carries out an ON that waits: once the bridge has replied to a setpoint without power and no drive has
    /// torque, and at once where no bridge is heard, because waiting would hide its alarm.
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
        let newest = self.station.sequence();
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

/// Whether the drive of an axis is in a state of which this is true.
fn has_drive(feedback: &Feedback, is: impl Fn(DriveState) -> bool) -> bool {
    let axes = AxisMask::from_bits(feedback.axes_mask);
    axes.axes().any(|axis| {
        let status_word = (feedback.status_word[axis] & 0xFFFF) as u16;
        DriveState::decode(status_word).is_some_and(&is)
    })
}
