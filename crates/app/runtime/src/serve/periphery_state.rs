//! Spindle, coolant and tool on the operator's side.

use std::sync::mpsc::{self, Sender};

use crate::periphery::Periphery;
use crate::periphery_track::PeripheryOrder;

/// The periphery as the operator knows it, and the channel to the publisher, which reports on the bus with
/// which setpoint it changes.
#[derive(Debug)]
pub(crate) struct PeripheryState {
    now: Periphery,
    publisher: Sender<PeripheryOrder>,
}

impl PeripheryState {
    /// With this tool in the spindle and everything off.
    pub(crate) fn new(tool: u32, publisher: Sender<PeripheryOrder>) -> Self {
        let now = Periphery {
            tool,
            ..Periphery::default()
        };
        let state = Self { now, publisher };
        state.tell(0);
        state
    }

    /// The present state.
    pub(crate) fn now(&self) -> &Periphery {
        &self.now
    }

    /// The channel on which the planner of a job's program reports to the publisher what the program
    /// switches.
    pub(crate) fn of_program(&self, job: u64) -> Sender<(u32, Periphery)> {
        let (planner, planned) = mpsc::channel();
        // If the publisher has ended, nothing is published.
        let _gone = self.publisher.send(PeripheryOrder::Program { job, planned });
        planner
    }

    /// Notes that the program has reached this state. The publisher follows the program on its own.
    pub(crate) fn reach(&mut self, periphery: Periphery) {
        self.now = periphery;
    }

    /// Switches spindle and coolant off after this setpoint, whatever switched them on.
    pub(crate) fn switch_off(&mut self, sequence: u64) {
        self.now.switch_off();
        self.tell(sequence);
    }

    fn tell(&self, sequence: u64) {
        let _gone = self.publisher.send(PeripheryOrder::Behind {
            sequence,
            periphery: Box::new(self.now),
        });
    }
}
