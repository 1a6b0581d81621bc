//! A trial core that homes X by its home switch, with the core's own sequence.

use std::time::Instant;

use evolvent_control::{Homing, HomingAction, HomingAxis, HomingSample};
use evolvent_drive::{BridgeState, DriveState};
use evolvent_machine::HomingMethod;
use evolvent_path::{Axes, AxisLetter, AxisMask};

use crate::trial_core::{LATEST, PERIOD_NS, TrialCore, states};

/// Maximum number of attempts, if the host keeps setpoints from arriving.
const ATTEMPTS: u32 = 5;

/// Settings for homing X towards smaller coordinates.
#[derive(Clone, Copy, Debug)]
pub struct HomingTrial {
    /// Speed of the search, mm/s.
    pub search_mm_s: f64,
    /// Speed of the second approach, mm/s.
    pub latch_mm_s: f64,
    /// Acceleration of every move, mm/s2.
    pub acceleration_mm_s2: f64,
    /// Machine coordinate of the edge.
    pub switch_mm: f64,
    /// Machine coordinate at which homing ends.
    pub home_mm: f64,
    /// Length of the travel, mm.
    pub travel_mm: f64,
}

impl HomingTrial {
    fn axis(&self) -> HomingAxis {
        HomingAxis {
            axis: AxisLetter::X,
            method: HomingMethod::Switch,
            order: 0,
            direction: -1.0,
            search_velocity: self.search_mm_s,
            latch_velocity: self.latch_mm_s,
            reference: self.switch_mm,
            travel: self.travel_mm,
            home: self.home_mm,
        }
    }
}

impl TrialCore {
    /// Homes X, whose drive is operational and at rest. `each` is called once per cycle.
    ///
    /// # Errors
    /// The homing sequence has failed, or the drives have left operation.
    ///
    /// # Panics
    /// Homing takes too long.
    pub fn home_x(&mut self, trial: &HomingTrial, mut each: impl FnMut(&mut Self)) -> Result<(), String> {
        let mut homing = Homing::new(vec![trial.axis()], 1);
        // Target and speed of X until it arrives.
        let mut goal: Option<(f64, f64)> = None;
        let (begin, mut attempts, mut is_following) = (Instant::now(), 0, true);
        self.velocity_x = 0.0;
        loop {
            self.move_x(goal, trial.acceleration_mm_s2);
            self.cycle();
            each(self);
            if goal.is_some_and(|(to, _)| self.position[0] == to) {
                (goal, self.velocity_x) = (None, 0.0);
            }
            assert!(
                begin.elapsed() < LATEST,
                "homing takes too long; {:?}",
                self.newest
            );
            let Some(feedback) = self.fresh() else { continue };
            if states(&feedback) != [Some(DriveState::OperationEnabled); 3] {
                self.velocity_x = 0.0;
                return Err(format!(
                    "the drives are {:?}, error {:04X}h",
                    states(&feedback),
                    feedback.error_code
                ));
            }
            let state = BridgeState::from_number(feedback.bridge_state);
            if !matches!(state, Some(BridgeState::Following | BridgeState::Bridging)) {
                // The host kept setpoints from arriving in time, or the bridge from running, so the bridge
                // has stopped the axes: homing starts again from there.
                if is_following {
                    attempts += 1;
                    println!(
                        "homing, attempt {attempts}: {state:?}, {} setpoints missed",
                        feedback.missed_setpoints
                    );
                    assert!(attempts < ATTEMPTS, "the bridge does not follow: {feedback:?}");
                    homing = Homing::new(vec![trial.axis()], 1);
                }
                (goal, self.velocity_x, is_following) = (None, 0.0, false);
                if state != Some(BridgeState::Braking) && feedback.velocity[0].abs() < 0.1 {
                    self.position = feedback.position;
                }
                continue;
            }
            is_following = true;
            if feedback.datum != self.datum {
                continue;
            }
            let sample = HomingSample {
                time_ns: feedback.time_ns,
                position: Axes::from(feedback.position),
                switches: AxisMask::from_bits(feedback.home_switch_mask),
                limits: [feedback.negative_limit_mask, feedback.positive_limit_mask].map(AxisMask::from_bits),
                absolute: AxisMask::from_bits(feedback.absolute_mask),
                index_request: 0,
                index_position: None,
            };
            let at_rest = goal.is_none() && self.velocity_x == 0.0;
            match homing.step(&sample, at_rest) {
                HomingAction::Move { distance, speed, .. } => {
                    goal = Some((self.position[0] + distance, speed));
                }
                HomingAction::Home { position, speed, .. } => goal = Some((position, speed)),
                HomingAction::Stop => goal = None,
                HomingAction::SetZero {
                    position, coordinate, ..
                } => {
                    self.position[0] += coordinate - position;
                    self.datum += 1;
                }
                HomingAction::Wait | HomingAction::TakePosition { .. } | HomingAction::LatchIndex { .. } => {}
                HomingAction::Done => return Ok(()),
                HomingAction::Fail(rejection) => return Err(rejection.to_string()),
            }
        }
    }

    /// Sets the velocity of the next period, towards a goal or to rest.
    fn move_x(&mut self, goal: Option<(f64, f64)>, acceleration: f64) {
        let period_s = PERIOD_NS as f64 * 1e-9;
        let wanted = match goal {
            None => 0.0,
            Some((to, speed)) => {
                let left = to - self.position[0];
                if left.abs() < 1e-3 {
                    (self.position[0], self.velocity_x) = (to, 0.0);
                    return;
                }
                let max_speed = speed.min((2.0 * acceleration * left.abs()).sqrt());
                max_speed.min(left.abs() / period_s) * left.signum()
            }
        };
        let change = acceleration * period_s;
        self.velocity_x += (wanted - self.velocity_x).clamp(-change, change);
    }
}
