//! Spindle, coolant and tool for the published setpoints: their state on the bus, and from which setpoint on.

use std::collections::VecDeque;
use std::sync::mpsc::Receiver;

use evolvent_drive::PowerRequest;
use evolvent_motion::MotionState;

use crate::due_setpoint::DueSetpoint;
use crate::periphery::Periphery;

/// Orders for followers of the periphery.
#[derive(Debug)]
pub(crate) enum PeripheryOrder {
    /// The periphery has this state after this setpoint, whatever a program has planned.
    Behind {
        sequence: u64,
        periphery: Box<Periphery>,
    },
    /// A program has begun: it reports changes of the periphery while it is planned, with the number of the
    /// action from which each is in effect.
    Program {
        job: u64,
        planned: Receiver<(u32, Periphery)>,
    },
}

/// A program whose setpoints may be published.
#[derive(Debug)]
struct Program {
    job: u64,
    planned: Receiver<(u32, Periphery)>,
    /// Received from `planned` and not reached yet.
    ahead: VecDeque<(u32, Periphery)>,
}

/// Spindle, coolant and tool for the published setpoints.
#[derive(Debug)]
pub(crate) struct PeripheryTrack {
    now: Periphery,
    orders: Receiver<PeripheryOrder>,
    /// Orders for setpoints that are not published yet.
    behind: VecDeque<(u64, Periphery)>,
    programs: VecDeque<Program>,
}

impl PeripheryTrack {
    /// With this tool in the spindle and everything off.
    pub(crate) fn new(tool: u32, orders: Receiver<PeripheryOrder>) -> Self {
        Self {
            now: Periphery {
                tool,
                ..Periphery::default()
            },
            orders,
            behind: VecDeque::new(),
            programs: VecDeque::new(),
        }
    }

    /// The state with the last published setpoint.
    pub(crate) fn now(&self) -> &Periphery {
        &self.now
    }

    /// Advances to a setpoint. Returns whether anything changed. If the program ends early or the drives have
    /// no power, everything is off, independent of any other thread.
    pub(crate) fn follow(&mut self, due: &DueSetpoint) -> bool {
        let before = self.now;
        for order in self.orders.try_iter() {
            match order {
                PeripheryOrder::Behind { sequence, periphery } => {
                    self.behind.push_back((sequence, *periphery));
                }
                PeripheryOrder::Program { job, planned } => {
                    // A program of the same number was never begun.
                    self.programs.retain(|program| program.job != job);
                    self.programs.push_back(Program {
                        job,
                        planned,
                        ahead: VecDeque::new(),
                    });
                }
            }
        }
        while let Some(&(sequence, periphery)) = self.behind.front()
            && sequence < due.setpoint.sequence
        {
            self.now = periphery;
            self.behind.pop_front();
        }
        // Changes that an earlier program planned and did not reach are discarded.
        while self.programs.front().is_some_and(|program| program.job < due.job) {
            self.programs.pop_front();
        }
        if let Some(program) = self.programs.front_mut().filter(|program| program.job == due.job) {
            // An action is reported before it is added to the plan.
            program.ahead.extend(program.planned.try_iter());
            while let Some(&(action, periphery)) = program.ahead.front()
                && action < due.setpoint.actions
            {
                self.now = periphery;
                program.ahead.pop_front();
            }
        }
        if due.is_of_program && due.setpoint.state == MotionState::Stopping {
            self.now.stop_tap();
        }
        let is_stopped = due.is_of_program && due.setpoint.state == MotionState::Stopped;
        let is_over = is_stopped || due.setpoint.state == MotionState::Fault;
        if is_over || due.drive.power != PowerRequest::On {
            self.now.switch_off();
        }
        self.now != before
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use evolvent_gcode::{Outputs, SPINDLES, SpindleDirection};
    use evolvent_motion::Setpoint;
    use evolvent_path::Axes;

    use super::*;
    use crate::due_setpoint::DriveRequest;
    use crate::periphery::{SpindlePass, UnplannedMove};

    fn due(sequence: u64, job: u64, actions: u32, state: MotionState) -> DueSetpoint {
        let setpoint = Setpoint {
            sequence,
            actions,
            state,
            position: Axes::zeros(),
            velocity: Axes::zeros(),
            acceleration: Axes::zeros(),
            jerk: Axes::zeros(),
            path_mm: 0.0,
            feed_mm_s: 0.0,
            feed_override: 1.0,
            line: 0,
            block: 0,
            flags: 0,
        };
        DueSetpoint {
            setpoint,
            corrected: None,
            due_time_ns: 0,
            drive: DriveRequest::ON,
            job,
            spindle_overrides: [1.0; SPINDLES],
            override_off_mask: 0,
            is_of_program: state != MotionState::Idle,
        }
    }

    fn spindle(speed_rpm: f64) -> Periphery {
        let mut outputs = Outputs::default();
        outputs.spindles[0].direction = SpindleDirection::Clockwise;
        outputs.spindles[0].speed_rpm = speed_rpm;
        Periphery {
            outputs,
            ..Periphery::default()
        }
    }

    /// Coolant stays until the machine has stopped, and a spindle that no tap follows turns until then.
    #[test]
    fn a_stop_in_a_tap_orders_its_spindle_off_at_once() {
        for (is_tap, expected_rpm) in [(true, 0.0), (false, 500.0)] {
            let (orders, receiver) = mpsc::channel();
            let mut track = PeripheryTrack::new(4, receiver);
            let (program, planned) = mpsc::channel();
            orders.send(PeripheryOrder::Program { job: 1, planned }).unwrap();
            let mut in_pass = spindle(500.0);
            in_pass.outputs.flood = true;
            in_pass.in_pass = Some(SpindlePass {
                spindle: 0,
                is_tap,
                motion: UnplannedMove {
                    feed_mm_s: 8.0,
                    end: Axes::zeros(),
                },
            });
            program.send((0, in_pass)).unwrap();
            track.follow(&due(1, 1, 1, MotionState::Running));
            assert_eq!(track.now().outputs.spindle(0).constant_rpm(), 500.0);
            track.follow(&due(2, 1, 1, MotionState::Stopping));
            let stopping = track.now();
            assert_eq!(
                stopping.outputs.spindle(0).constant_rpm(),
                expected_rpm,
                "{is_tap}"
            );
            assert!(stopping.outputs.flood && stopping.in_pass.is_some());
            track.follow(&due(3, 1, 1, MotionState::Stopped));
            assert_eq!(track.now().outputs.spindle(0).constant_rpm(), 0.0);
        }
    }

    /// The publisher lags: everything is recorded before the first setpoint is published.
    #[test]
    fn early_orders_wait_for_their_setpoints() {
        let (orders, receiver) = mpsc::channel();
        let mut track = PeripheryTrack::new(4, receiver);
        let (first, planned) = mpsc::channel();
        orders.send(PeripheryOrder::Program { job: 1, planned }).unwrap();
        first.send((0, spindle(100.0))).unwrap();
        // Never reached: the job is stopped before.
        first.send((7, spindle(700.0))).unwrap();
        let off = Periphery {
            tool: 4,
            ..Periphery::default()
        };
        let behind = PeripheryOrder::Behind {
            sequence: 12,
            periphery: Box::new(off),
        };
        orders.send(behind).unwrap();
        let (second, planned) = mpsc::channel();
        orders.send(PeripheryOrder::Program { job: 2, planned }).unwrap();
        second.send((31, spindle(3100.0))).unwrap();
        let speed = |track: &PeripheryTrack| track.now().outputs.spindle(0).constant_rpm();
        assert!(
            !track.follow(&due(10, 1, 0, MotionState::Running)),
            "the tool is known"
        );
        assert!(track.follow(&due(11, 1, 1, MotionState::Running)));
        assert_eq!(speed(&track), 100.0);
        assert!(
            track.follow(&due(12, 1, 1, MotionState::Stopped)),
            "a stop switches off"
        );
        track.follow(&due(13, 1, 1, MotionState::Idle));
        assert_eq!((speed(&track), track.now().tool), (0.0, 4));
        // Whatever number the second program begins with, pending changes of the first are discarded.
        track.follow(&due(14, 2, 31, MotionState::Running));
        assert_eq!(speed(&track), 0.0);
        track.follow(&due(15, 2, 32, MotionState::Running));
        assert_eq!(speed(&track), 3100.0);
        // A jog that is stopped is not a program.
        let mut jogged = due(16, 2, 32, MotionState::Stopped);
        jogged.is_of_program = false;
        track.follow(&jogged);
        assert_eq!(speed(&track), 3100.0);
        let mut without_power = due(17, 2, 32, MotionState::Running);
        without_power.drive = DriveRequest::OFF;
        assert!(track.follow(&without_power));
        assert_eq!(speed(&track), 0.0);
    }
}
