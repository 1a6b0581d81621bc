//! How the cycle takes the operator's orders.

use evolvent_drive::PowerRequest;
use evolvent_machine::Limits;
use evolvent_motion::{Inputs, TransferExecutor};
use evolvent_path::Axes;

use super::{CycleState, ServedParts, Turn};
use crate::serve::orders::{ActiveJob, CycleCommand, CycleEvent, Following, NotBegun};
use crate::serve::urgent::Urgent;

/// Maximum number of orders that one cycle takes; more never wait.
const MAX_ORDERS: usize = 32;

impl ServedParts {
    pub(super) fn take_orders(&mut self, now: &mut CycleState) {
        for _ in 0..MAX_ORDERS {
            let next = self.orders.pop();
            // Before each order: an order of the queue may have been sent after an urgent one that had not
            // arrived at the last check.
            self.take_urgent(now);
            let Ok(order) = next else { break };
            let reported = !matches!(order.what, CycleCommand::Turn { .. });
            let renames = matches!(order.what, CycleCommand::Relocate { renames: true, .. });
            let counts = self.take(now, order.id, order.what);
            if reported && counts && order.id > 0 {
                let sequence = self.generator.sequence();
                self.report(CycleEvent::Applied {
                    id: order.id,
                    sequence,
                });
            }
            if renames {
                // Bridges take over a new datum at rest, so motion begins with the next setpoint.
                break;
            }
        }
    }

    /// Takes urgent orders, oldest first.
    fn take_urgent(&mut self, now: &mut CycleState) {
        while let Some((urgent, id)) = now.urgent.take(&self.urgent) {
            let what = match urgent {
                Urgent::Emergency => CycleCommand::Emergency,
                Urgent::Stop => CycleCommand::Stop,
                Urgent::PowerOff => CycleCommand::Power(PowerRequest::Off),
            };
            self.take(now, id, what);
            let sequence = self.generator.sequence();
            self.report(CycleEvent::Applied { id, sequence });
        }
    }

    /// Handles an order of the queue that a later urgent order has overtaken, which it must not undo. Returns
    /// what is to be carried out nevertheless.
    fn skip_overtaken(&mut self, now: &mut CycleState, id: u64, what: CycleCommand) -> Option<CycleCommand> {
        const ANY: [Urgent; 3] = [Urgent::Emergency, Urgent::Stop, Urgent::PowerOff];
        let has_overtaken = |kinds: &[Urgent]| now.urgent.overtook(kinds, id);
        match what {
            CycleCommand::Steer(steering)
                if has_overtaken(&ANY) && matches!(now.work, ActiveJob::Follow(_)) =>
            {
                self.refuse_leaving(ActiveJob::Steer(steering));
            }
            CycleCommand::Steer(steering) if has_overtaken(&ANY) => {
                self.misplace(now, ActiveJob::Steer(steering), NotBegun::Stopped);
            }
            CycleCommand::Follow(job) if has_overtaken(&ANY) => {
                self.misplace(now, ActiveJob::Follow(job), NotBegun::Stopped);
            }
            CycleCommand::Turn { steering, .. } if has_overtaken(&ANY) => {
                let work = ActiveJob::Steer(steering);
                self.report(CycleEvent::TurnReturned { id, work });
            }
            CycleCommand::Retrace { .. } if has_overtaken(&ANY) => self.refuse_leaving(ActiveJob::None),
            CycleCommand::Power(PowerRequest::On)
                if has_overtaken(&[Urgent::Emergency, Urgent::PowerOff]) =>
            {
                now.power_orders.settle(id);
            }
            CycleCommand::LeaveEstop if has_overtaken(&[Urgent::Emergency]) => {}
            // Settings remain valid; holds, resumes and releases of program stops begin nothing that would
            // have to stop.
            what => return Some(what),
        }
        None
    }

    /// Carries an order out. Returns `false` if it has no effect and must not appear in the trace.
    fn take(&mut self, now: &mut CycleState, id: u64, what: CycleCommand) -> bool {
        let Some(what) = self.skip_overtaken(now, id, what) else {
            return false;
        };
        match what {
            CycleCommand::Follow(job) => return self.begin_following(now, job),
            CycleCommand::Steer(steering) if matches!(now.work, ActiveJob::Follow(_)) => {
                return self.leave(now, steering);
            }
            CycleCommand::Retrace { back } => return self.retrace(now, back),
            CycleCommand::Steer(steering) => return self.begin_steering(now, steering),
            CycleCommand::Turn {
                after,
                until_ns,
                steering,
            } => {
                let turn = Turn {
                    after,
                    until_ns,
                    id,
                    steering,
                };
                if let Some(old) = now.turn.replace(turn) {
                    self.report(old.returned());
                }
            }
            CycleCommand::Hold => now.inputs.hold = true,
            // The axes have to return first.
            CycleCommand::Resume(_) if now.excursion.is_some() => {}
            CycleCommand::Resume(stop) => {
                now.inputs.hold = false;
                now.stops.go_on = stop.or(now.stops.go_on);
            }
            CycleCommand::GoOn(stop) => now.stops.go_on = Some(stop),
            CycleCommand::StopSteering => match (&mut now.work, &mut now.excursion) {
                (ActiveJob::Steer(steering), _) => steering.stop(),
                (_, Some(excursion)) => excursion.stop(),
                _ => {}
            },
            CycleCommand::Stop => now.stop_work(),
            CycleCommand::Override(factor) => {
                now.inputs.feed_override = factor;
                self.generator.set_override(factor);
            }
            CycleCommand::SpindleOverride(factor) => now.spindle_override = factor,
            CycleCommand::Emergency => {
                now.is_estop = true;
                self.emergency(now);
            }
            CycleCommand::LeaveEstop => {
                now.is_estop = false;
                if let Some(signals) = &mut self.signals {
                    signals.reset_estop();
                }
            }
            CycleCommand::Outputs(change) => {
                if let Some(signals) = &mut self.signals {
                    signals.set_by_hand(&change);
                }
            }
            CycleCommand::Power(request) => self.request_power(now, id, request),
            CycleCommand::Clear => {
                now.faulted = false;
                now.drive.fault_reset = now.drive.fault_reset.wrapping_add(1);
            }
            CycleCommand::Relocate {
                position,
                limits,
                renames,
            } => self.relocate(now, position, limits, renames),
            CycleCommand::Within(limits) => {
                if now.is_idle() && self.generator.is_at_rest() {
                    self.limits = limits;
                    self.generator.relocate(limits, self.generator.position());
                }
            }
            CycleCommand::KeepJogging(until_ns) => {
                now.keep_until_ns = until_ns;
                if let Some(turn) = &mut now.turn {
                    turn.until_ns = until_ns;
                }
            }
            CycleCommand::ExpectSwitches(mask) => now.switches_expected = mask,
            CycleCommand::LatchIndex(request) => now.drive.index = request,
            CycleCommand::End => {
                now.ending = true;
                now.stop_work();
            }
        }
        true
    }

    /// Begins a job along a plan. Returns whether it has begun.
    fn begin_following(&mut self, now: &mut CycleState, mut job: Box<Following>) -> bool {
        if !now.can_begin() || !self.generator.attach(&mut job.motion) {
            self.misplace(now, ActiveJob::Follow(job), NotBegun::Elsewhere);
            return false;
        }
        now.inputs = Inputs {
            feed_override: now.inputs.feed_override,
            ..Inputs::default()
        };
        (now.stops.go_on, now.stops.at_stop) = (None, None);
        now.program.job = job.job;
        self.driven.forget();
        self.begin_schedule(&mut job);
        now.work = ActiveJob::Follow(job);
        true
    }

    /// Begins a steered motion. Returns whether it has begun.
    fn begin_steering(&mut self, now: &mut CycleState, steering: Box<TransferExecutor>) -> bool {
        let begins = now.can_begin() && self.generator.can_steer(&steering);
        if begins {
            now.work = ActiveJob::Steer(steering);
        } else {
            self.misplace(now, ActiveJob::Steer(steering), NotBegun::Elsewhere);
        }
        begins
    }

    /// Returns a job that cannot begin here.
    fn misplace(&mut self, now: &CycleState, work: ActiveJob, otherwise: NotBegun) {
        let sequence = self.generator.sequence();
        let cause = if now.is_ready() {
            otherwise
        } else {
            NotBegun::Forbidden
        };
        self.report(CycleEvent::Misplaced {
            sequence,
            cause,
            work,
        });
    }

    /// Gives the position at which the axes are at rest these coordinates, and sets the limits.
    fn relocate(&mut self, now: &mut CycleState, position: Axes, limits: Limits, renames: bool) {
        if !now.is_idle() || !self.generator.is_at_rest() {
            return;
        }
        // The sign of a zero is kept: only a recorded change may change a bit of the setpoints.
        let mut here = self.generator.position();
        if here != position {
            here = position;
            now.relocated = true;
            if let Some(corrections) = &mut self.corrections {
                corrections.relocate(&position);
            }
        }
        self.limits = limits;
        self.generator.relocate(limits, here);
        now.drive.datum += u64::from(renames);
    }
}
