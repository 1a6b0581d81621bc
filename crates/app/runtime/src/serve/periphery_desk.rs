//! Spindle, coolant and tool from the operator's side.

use std::sync::mpsc::{self, Sender};

use crate::periphery::Periphery;
use crate::periphery_track::PeripheryOrder;

/// The periphery as the operator knows it, and the way to the publisher, who says on the bus with which
/// setpoint it changes.
#[derive(Debug)]
pub(crate) struct PeripheryDesk {
    now: Periphery,
    publisher: Sender<PeripheryOrder>,
}

impl PeripheryDesk {
    /// With this tool in the spindle, everything off.
    pub(crate) fn new(tool: u32, publisher: Sender<PeripheryOrder>) -> Self {
        let now = Periphery {
            tool,
            ..Periphery::default()
        };
        let desk = Self { now, publisher };
        desk.tell(0);
        desk
    }

    /// As it is.
    pub(crate) fn now(&self) -> &Periphery {
        &self.now
    }

    /// The way by which the planner of a job's program tells the publisher what it switches.
    pub(crate) fn of_program(&self, job: u64) -> Sender<(u32, Periphery)> {
        let (planner, planned) = mpsc::channel();
        // A publisher that has gone publishes nothing of it.
        let _gone = self.publisher.send(PeripheryOrder::Program { job, planned });
        planner
    }

    /// The program has come so far. The publisher follows it by itself.
    pub(crate) fn reach(&mut self, periphery: Periphery) {
        self.now = periphery;
    }

    /// Spindle and coolant go off after this setpoint, whatever has switched them on.
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
