//! Conversion of setpoints to messages, and the settings that the publisher needs for it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use evolvent_bus::{BusConfig, CoreBus};
use evolvent_path::{AXES, Axes, AxisMask};

use crate::due_setpoint::DueSetpoint;
use crate::job::{Clock, Setup};
use crate::shared::Controls;

/// Maximum wait for requested subscribers.
const SUBSCRIBER_TIMEOUT: Duration = Duration::from_secs(10);
/// Poll interval of stop requests during that wait.
const SUBSCRIBER_POLL: Duration = Duration::from_millis(50);

/// Settings of the machine for the publisher.
pub(crate) struct Publishing {
    pub config: BusConfig,
    pub lead_cycles: u32,
    pub clock: Clock,
    pub increments: Axes,
    pub axes_mask: u32,
    pub wait_for_subscribers: usize,
    /// Subscribers of this process itself.
    pub own_subscribers: usize,
    pub controls: Arc<Controls>,
}

impl Publishing {
    /// For this machine, on the bus with this prefix.
    pub(crate) fn new(setup: &Setup, clock: Clock, prefix: Option<&str>, controls: Arc<Controls>) -> Self {
        let machine = &setup.machine;
        let mut config = BusConfig::new(&machine.name, &machine.axis_letters(), setup.period_ns);
        config.prefix = prefix.map(str::to_owned);
        Self {
            config,
            lead_cycles: machine.lead_cycles(setup.period_ns),
            clock,
            increments: machine.increments(),
            axes_mask: machine
                .axes
                .iter()
                .map(|axis| axis.letter.index())
                .collect::<AxisMask>()
                .bits(),
            wait_for_subscribers: 0,
            own_subscribers: 0,
            controls,
        }
    }

    /// A setpoint as a message.
    pub(crate) fn message(&self, due: &DueSetpoint) -> evolvent_bus::Setpoint {
        let setpoint = &due.setpoint;
        let [position, velocity, acceleration] = due.sent();
        let mut increments = [0; AXES];
        for i in 0..AXES {
            // The guard has checked the travel, so the value fits.
            increments[i] = (position[i] * self.increments[i]).round() as i64;
        }
        evolvent_bus::Setpoint {
            sequence: setpoint.sequence,
            due_time_ns: due.due_time_ns,
            period_ns: self.config.period_ns,
            position: position.into(),
            velocity: velocity.into(),
            acceleration: acceleration.into(),
            position_increments: increments,
            state: setpoint.state as u32,
            flags: setpoint.flags,
            line: setpoint.line,
            axes_mask: self.axes_mask,
            feed_mm_s: setpoint.feed_mm_s,
            override_ratio: setpoint.feed_override,
            path_mm: setpoint.path_mm,
            power_request: due.drive.power.number(),
            fault_reset: due.drive.fault_reset,
            datum: due.drive.datum,
            index_request: due.drive.index.number,
            index_axis: due.drive.index.axis as u32,
            ..evolvent_bus::Setpoint::default()
        }
    }

    /// Number of connected subscribers of other processes.
    pub(crate) fn listeners(&self, bus: &CoreBus) -> usize {
        bus.setpoint_subscribers().saturating_sub(self.own_subscribers)
    }

    /// Waits for the requested number of subscribers of other processes, or until a stop. Returns their
    /// number.
    pub(crate) fn await_subscribers(&self, bus: &CoreBus) -> usize {
        let wanted = match self.wait_for_subscribers {
            0 => 0,
            others => others + self.own_subscribers,
        };
        let deadline = Instant::now() + SUBSCRIBER_TIMEOUT;
        loop {
            let found = (bus.wait_for_setpoint_subscribers(wanted, SUBSCRIBER_POLL))
                .saturating_sub(self.own_subscribers);
            let enough = found >= self.wait_for_subscribers;
            if enough || self.controls.is_stopping() || Instant::now() >= deadline {
                return found;
            }
        }
    }
}
