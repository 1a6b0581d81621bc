//! A sink that records the plan and checks the guarantees of the planner.

use std::convert::Infallible;

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes};

use crate::{ExitSpeeds, PlanSink, Run, Segment, Step};

/// The complete output of a planner.
#[derive(Debug, Default)]
pub(crate) struct Recorder {
    pub(crate) segments: Vec<Segment>,
    pub(crate) steps: Vec<Step>,
    pub(crate) exits: Vec<ExitSpeeds>,
    pub(crate) durations: Vec<f64>,
    pub(crate) committed: u64,
}

impl Recorder {
    /// Runs with their entry and exit speeds at the programmed feed.
    pub(crate) fn runs(&self) -> Vec<(Run, f64, f64)> {
        let mut entry = 0.0;
        let mut runs = Vec::new();
        for (step, exit) in self.steps.iter().zip(&self.exits) {
            if let Step::Run(run) = step {
                runs.push((*run, entry, exit.nominal));
            }
            entry = exit.nominal;
        }
        runs
    }
}

impl PlanSink for Recorder {
    type Error = Infallible;

    fn segment(&mut self, segment: &Segment) -> Result<(), Infallible> {
        self.segments.push(*segment);
        Ok(())
    }

    fn step(&mut self, step: &Step) -> Result<(), Infallible> {
        self.steps.push(*step);
        self.exits.push(ExitSpeeds::REST);
        Ok(())
    }

    fn exit(&mut self, index: u64, speeds: ExitSpeeds) {
        let old = &mut self.exits[index as usize];
        assert!(index >= self.committed, "step {index} was final");
        assert!(
            speeds.nominal >= old.nominal && speeds.doubled >= old.doubled,
            "step {index} is lowered from {old:?} to {speeds:?}"
        );
        *old = speeds;
    }

    fn planned(&mut self, index: u64, duration_s: f64) {
        assert_eq!(index as usize, self.durations.len(), "durations come in order");
        self.durations.push(duration_s);
    }

    fn commit(&mut self, count: u64) {
        assert!(count >= self.committed && count as usize <= self.steps.len());
        self.committed = count;
    }
}

/// Nine equal axes with ample travel.
pub(crate) fn equal_axes(velocity: f64, acceleration: f64, jerk: f64) -> Limits {
    Limits {
        present: [true; AXES],
        velocity: Axes::repeat(velocity),
        acceleration: Axes::repeat(acceleration),
        jerk: Axes::repeat(jerk),
        travel_min: Axes::repeat(-1e4),
        travel_max: Axes::repeat(1e4),
        home: Axes::zeros(),
    }
}

/// The point `(x, y)`, all other axes at 0.
pub(crate) fn point(x: f64, y: f64) -> Axes {
    let mut point = Axes::zeros();
    (point[0], point[1]) = (x, y);
    point
}
