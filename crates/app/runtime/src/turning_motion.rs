//! A load-adaptive controller as motion between two steps of a plan.

use std::any::Any;

use evolvent_motion::{PathExecutor, ProcessCycle, ProcessInputs, ProcessStatus};
use evolvent_path::{Axes, AxisLetter, Jet};
use evolvent_turning::{AxisPoint, Reason, TurningController, TurningInputs, TurningOutput, TurningState};

/// The cut in machine coordinates: converts positions along it and heights above the final size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TurningFrame {
    /// Position of the tool before and after, machine coordinates.
    pub start: Axes,
    /// The axis along the cut, its coordinate at position 0, and the sign of its direction (1 or -1).
    pub along: (AxisLetter, f64, f64),
    /// The axis across the cut, its coordinate at the final size, and the sign of the height (1 or -1).
    pub out: (AxisLetter, f64, f64),
}

impl TurningFrame {
    /// Position along the cut and height at the start, mm.
    pub(crate) fn start_mm(&self) -> (f64, f64) {
        let of = |(axis, origin, sign): (AxisLetter, f64, f64)| sign * (self.start[axis.index()] - origin);
        (of(self.along), of(self.out))
    }

    /// Machine coordinates of a position and a height. Real-time safe.
    pub(crate) fn position(&self, along_mm: f64, out_mm: f64) -> Axes {
        let mut position = self.start;
        for ((axis, origin, sign), value) in [(self.along, along_mm), (self.out, out_mm)] {
            position[axis.index()] = origin + sign * value;
        }
        position
    }

    fn jet(&self, along: &AxisPoint, out: &AxisPoint) -> Jet {
        let mut jet = Jet::at_rest(self.position(along.position, out.position));
        for ((axis, _, sign), point) in [(self.along, along), (self.out, out)] {
            let i = axis.index();
            jet.first[i] = sign * point.velocity;
            jet.second[i] = sign * point.acceleration;
            jet.third[i] = sign * point.jerk;
        }
        jet
    }
}

/// A controller and its frame.
#[derive(Clone, Debug)]
pub(crate) struct TurningMotion {
    controller: TurningController,
    frame: TurningFrame,
    output: Option<TurningOutput>,
    fault: Option<Reason>,
}

impl TurningMotion {
    /// A controller that starts and ends at the start of the frame.
    pub(crate) fn new(controller: TurningController, frame: TurningFrame) -> Self {
        Self {
            controller,
            frame,
            output: None,
            fault: None,
        }
    }
}

impl ProcessCycle for TurningMotion {
    fn step(&mut self, inputs: &ProcessInputs) -> (Jet, ProcessStatus) {
        let output = self.controller.step(&TurningInputs {
            load: inputs.load,
            start: true,
            hold: inputs.hold,
            feed_override: inputs.feed_override,
        });
        self.output = Some(output);
        let mut jet = self.frame.jet(&output.along, &output.out);
        if self.controller.state() == TurningState::Done && self.controller.is_at_rest() {
            // Exact to the last bit, because the plan continues here.
            jet.position = self.frame.start;
            return (jet, ProcessStatus::Done);
        }
        if output.state != TurningState::Fault {
            return (jet, ProcessStatus::Running);
        }
        if let Some(change) = output.transition {
            self.fault = Some(change.reason);
        }
        (jet, ProcessStatus::Failed)
    }

    fn is_at_rest(&self) -> bool {
        self.controller.is_at_rest()
    }
}

fn of(process: Option<&dyn ProcessCycle>) -> Option<&TurningMotion> {
    (process? as &dyn Any).downcast_ref()
}

/// Output of the turning cycle in the last step, if one moves the axes.
pub(crate) fn turning_output(motion: &PathExecutor) -> Option<&TurningOutput> {
    of(motion.process()).and_then(|turning| turning.output.as_ref())
}

/// The reason why a turning cycle ended the run.
pub(crate) fn turning_fault(motion: &PathExecutor) -> Option<Reason> {
    of(motion.failed_process()).and_then(|turning| turning.fault)
}

#[cfg(test)]
mod tests {
    use evolvent_counting::calls;
    use evolvent_machine::Limits;
    use evolvent_motion::{Inputs, MotionState, plan_queue};
    use evolvent_path::AXES;
    use evolvent_planner::{PlanSink, Step};
    use evolvent_turning::{
        BackOff, Blank, CutLaw, CuttingEdge, Regime, RegimeInput, Sensor, SensorFault, SensorModel,
        TurningSettings, Workpiece,
    };

    use super::*;

    /// Events during a turning cycle.
    #[derive(Clone, Copy, Debug, PartialEq)]
    enum Scene {
        HeldAndSlowed,
        Overload,
        SensorLost,
        Stopped,
    }

    const PERIOD_S: f64 = 0.001;
    const SET: f64 = 2200.0;
    /// Position of the tool before and after: 8 mm before the face, 8 mm above the final size.
    const START_MM: (f64, f64) = (-8.0, 8.0);

    fn turning_settings() -> TurningSettings {
        let law = CutLaw {
            coefficient: 1467.0,
            depth_exponent: 1.0,
            feed_exponent: 0.75,
        };
        let tool = CuttingEdge::new(60.0, 12.0).unwrap();
        let input = RegimeInput {
            law,
            set_load: SET,
            permitted_load: 10_000.0,
            feed_min_mm_rev: 0.2,
            feed_max_mm_rev: 0.7,
            back_off: BackOff::Balanced,
        };
        let regime = Regime::new(&input, &tool).unwrap();
        TurningSettings {
            allowance_max_mm: 8.0,
            period_s: PERIOD_S,
            ..TurningSettings::usual(regime, tool, 500.0, 30.0)
        }
    }

    /// A lathe: X across, as a radius from 30 mm, and Z along, downwards from 300 mm.
    fn lathe() -> (Limits, TurningFrame) {
        let mut limits = Limits {
            present: [false; AXES],
            velocity: Axes::repeat(200.0),
            acceleration: Axes::repeat(2000.0),
            jerk: Axes::repeat(50_000.0),
            travel_min: Axes::repeat(-1000.0),
            travel_max: Axes::repeat(1000.0),
            home: Axes::zeros(),
        };
        let (x, z) = (AxisLetter::X, AxisLetter::Z);
        (limits.present[x.index()], limits.present[z.index()]) = (true, true);
        let mut start = Axes::zeros();
        start[x.index()] = 30.0 + START_MM.1;
        start[z.index()] = 300.0 - START_MM.0;
        let frame = TurningFrame {
            start,
            along: (z, 300.0, -1.0),
            out: (x, 30.0, 1.0),
        };
        (limits, frame)
    }

    #[test]
    fn turning_cycles_do_not_allocate_however_they_end() {
        for scene in [
            Scene::HeldAndSlowed,
            Scene::Overload,
            Scene::SensorLost,
            Scene::Stopped,
        ] {
            let (limits, frame) = lathe();
            let settings = turning_settings();
            let (mut producer, mut queue) = plan_queue(|| true);
            let mut sender = producer.take_processes().unwrap();
            // Two cycles: the first is returned while the second runs.
            for line in [1, 2] {
                let (along, out) = START_MM;
                let controller = TurningController::starting_at(settings, along, out).unwrap();
                let sent = sender.send(Box::new(TurningMotion::new(controller, frame)));
                assert!(sent.is_ok(), "no room");
                producer.step(&Step::Turning { line }).unwrap();
            }
            producer.step(&Step::End { line: 3 }).unwrap();
            producer.commit(3);
            let mut motion = PathExecutor::new(limits, 1_000_000, frame.start);
            let blank = Blank::outline(&[(0.0, 6.5), (15.0, 6.5), (15.0, 3.0), (30.0, 4.0)]);
            let mut piece = Workpiece::new(blank, 30.0, settings.regime.law, settings.tool, 0.12 / PERIOD_S);
            let (uncut, mut line) = (piece.clone(), 1);
            let model = SensorModel {
                lag_s: 0.01,
                noise: 0.02,
                range_max: 20_000.0,
                seed: 3,
            };
            let mut sensor = Sensor::new(model, PERIOD_S);
            let (mut load, mut counted, mut cycles, mut cut, mut backed) = (0.0, 0, 0_u64, 0_u32, 0);
            let mut states = Vec::with_capacity(400_000);
            while !motion.is_over() {
                let struck = cut > 1500;
                let held = scene == Scene::HeldAndSlowed && cycles % 9000 > 8500;
                let inputs = Inputs {
                    hold: held,
                    stop: struck && scene == Scene::Stopped,
                    feed_override: if scene == Scene::HeldAndSlowed && cycles % 5000 > 4000 {
                        0.6
                    } else {
                        1.0
                    },
                    load: sensor.read(
                        if struck && scene == Scene::Overload {
                            3.0 * SET
                        } else {
                            load
                        },
                        (struck && scene == Scene::SensorLost).then_some(SensorFault::Lost),
                    ),
                    ..Inputs::default()
                };
                let before = calls();
                let setpoint = motion.step(&inputs, &mut queue);
                counted += calls() - before;
                states.push(setpoint.state);
                if setpoint.line == 2 && line == 1 {
                    // The next part.
                    (piece, line) = (uncut.clone(), 2);
                }
                let position = (300.0 - setpoint.position[2], setpoint.position[0] - 30.0);
                load = piece.step(position.0, position.1).load;
                if let Some(output) = turning_output(&motion) {
                    cut += u32::from(output.state == TurningState::Cut);
                    backed += u32::from(output.state == TurningState::BackOff);
                }
                cycles += 1;
                assert!(cycles < 400_000, "{scene:?} does not end");
            }
            assert_eq!(counted, 0, "{scene:?}: calls of the allocator in {cycles} cycles");
            assert!(
                cut > 1500 && backed > 0,
                "{scene:?}: {cut} cycles of cut, {backed} of backing off"
            );
            let (state, fault) = (motion.state(), turning_fault(&motion));
            match scene {
                Scene::HeldAndSlowed => {
                    assert_eq!((state, fault), (MotionState::Done, None));
                    assert!(states.contains(&MotionState::Held), "never held");
                    assert!(piece.residual_mm() < 0.1, "{}", piece.residual_mm());
                }
                Scene::Overload => assert!(matches!(fault, Some(Reason::Overload { .. })), "{fault:?}"),
                Scene::SensorLost => assert!(matches!(fault, Some(Reason::Sensor(_))), "{fault:?}"),
                Scene::Stopped => assert_eq!((state, fault), (MotionState::Stopped, None)),
            }
        }
    }
}
