//! Motion without a path: jog and homing.

use evolvent_machine::Limits;
use evolvent_path::{Axes, Jet};
use evolvent_transfer::Transfer;

use crate::quick_stop::QuickStop;
use crate::state::MotionState;

/// Tolerance between the start of a transfer and the present state: positions in mm or degrees, velocity and
/// acceleration as fractions of their limits.
const FIT: (f64, f64) = (1e-6, 1e-5);

/// A solved transfer, or a stop of each axis on its own, driven setpoint by setpoint.
///
/// A plain value of about 12 kB: build it outside the cycle and pass it in a box.
#[derive(Clone, Copy, Debug)]
pub struct TransferExecutor {
    transfer: Transfer,
    /// Time of the last setpoint in the transfer, s.
    time: f64,
    stop: Option<QuickStop>,
    stopping: bool,
}

impl TransferExecutor {
    /// A transfer from its start.
    #[must_use]
    pub fn new(transfer: Transfer) -> Self {
        Self {
            transfer,
            time: 0.0,
            stop: None,
            stopping: false,
        }
    }

    /// The transfer that it drives. Real-time safe.
    #[must_use]
    pub fn transfer(&self) -> &Transfer {
        &self.transfer
    }

    /// Stops from the next setpoint on, each axis within its acceleration and jerk. If the transfer ends at
    /// rest at the edge of the travel, the stop does not pass that edge. Real-time safe.
    pub fn stop(&mut self) {
        self.stopping = true;
    }

    /// Whether a stop has been requested. Real-time safe.
    #[must_use]
    pub fn is_stopping(&self) -> bool {
        self.stopping
    }

    /// Time of the last setpoint since the transfer's start, s. Real-time safe.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.time
    }

    /// Whether the axes are at rest for good. Real-time safe.
    #[must_use]
    pub fn is_over(&self) -> bool {
        match &self.stop {
            Some(stop) => stop.is_over(),
            None => !self.stopping && self.time >= self.transfer.duration_s(),
        }
    }

    /// Continues with another transfer if it begins at the state of the last setpoint; otherwise nothing
    /// changes. Real-time safe.
    pub(crate) fn turn_to(&mut self, transfer: &Transfer, last: &Jet, limits: &Limits) -> bool {
        let fits = !self.stopping && fits(transfer, last, limits);
        if fits {
            self.transfer = *transfer;
            self.time = 0.0;
        }
        fits
    }

    /// Position, derivatives and state of the cycle one period later.
    pub(crate) fn advance(&mut self, period: f64, last: &Jet, limits: &Limits) -> (Jet, MotionState) {
        if self.stopping && self.stop.is_none() {
            self.stop = Some(QuickStop::new(limits, last.position, last));
        }
        if let Some(stop) = &mut self.stop {
            let jet = stop.advance(period);
            let state = if stop.is_over() {
                MotionState::Stopped
            } else {
                MotionState::Stopping
            };
            return (jet, state);
        }
        self.time += period;
        let point = self.transfer.at(self.time);
        let jet = Jet {
            position: point.position,
            first: point.velocity,
            second: point.acceleration,
            third: point.jerk,
        };
        let state = if self.is_over() {
            MotionState::Done
        } else {
            MotionState::Running
        };
        (jet, state)
    }
}

/// Whether a transfer begins with this state of the axes. Real-time safe.
pub(crate) fn fits(transfer: &Transfer, last: &Jet, limits: &Limits) -> bool {
    let start = transfer.at(0.0);
    let near = |a: &Axes, b: &Axes, bound: &dyn Fn(usize) -> f64| {
        (0..a.len()).all(|i| !limits.present[i] || (a[i] - b[i]).abs() <= bound(i))
    };
    near(&start.position, &last.position, &|_| FIT.0)
        && near(&start.velocity, &last.first, &|i| FIT.1 * limits.velocity[i])
        && near(&start.acceleration, &last.second, &|i| {
            FIT.1 * limits.acceleration[i]
        })
}
