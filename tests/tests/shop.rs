//! A served mill whose held programs are left and continued.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::PathBuf;

use evolvent_bus::{ControlRequest, Status};
use evolvent_machine::Machine;
use evolvent_replay::verify;
use evolvent_tests::{Cycle, Domain, Drives, Operator, Served, Workshop, command, cycles};

pub(crate) const AUTO: u32 = 0;
pub(crate) const HELD: u32 = 3;
/// Bits of `inputs` in a trace.
pub(crate) const FOLLOWS: u32 = 128;
pub(crate) const STEERS: u32 = 256;
pub(crate) const RELOCATED: u32 = 512;
/// A mill that is served, with a trace.
pub(crate) struct Shop {
    pub(crate) workshop: Workshop,
    pub(crate) domain: Domain,
    pub(crate) machine: PathBuf,
    pub(crate) name: &'static str,
}

impl Shop {
    pub(crate) fn new(name: &'static str) -> Self {
        let workshop = Workshop::new();
        let machine = workshop.mill(
            name,
            &[
                ("rate = \"rational\"  ", "rate = 1000.0  "),
                ("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 1000 "),
            ],
        );
        Self {
            workshop,
            domain: Domain::new(),
            machine,
            name,
        }
    }

    pub(crate) fn trace(&self) -> PathBuf {
        self.workshop.path("leaving.mcap")
    }

    /// Starts the core, the drives, and an operator who has brought them up.
    pub(crate) fn opens(&self) -> (Served, Drives, Operator) {
        let trace = self.trace().display().to_string();
        let state = self.workshop.path("state");
        let served = Served::start(
            &self.machine,
            self.name,
            &self.domain,
            &state,
            &["--trace", &trace],
        );
        let drives = Drives::start(&self.machine, &self.domain, &[]);
        let mut operator = Operator::join(self.name, &self.domain);
        operator.waits("drives", |status| status.feedback_age_ns < u64::MAX);
        operator.brings_up();
        (served, drives, operator)
    }

    /// Starts a program and holds it where X is beyond `x` on the side of the square at `y`.
    pub(crate) fn holds(
        &self,
        operator: &mut Operator,
        text: &str,
        until: impl FnMut(&Status) -> bool,
    ) -> Status {
        let program = self.workshop.write("square.ngc", text);
        operator.says_number("MODE", AUTO);
        operator.says_text("LOAD", &program.display().to_string());
        operator.says("START");
        operator.waits("the place of the hold", until);
        operator.says("HOLD");
        operator.waits("a hold", |status| {
            status.state == HELD && status.velocity.iter().all(|v| *v == 0.0)
        })
    }

    /// Ends the core; returns its cycles. The trace is recomputed to the last bit.
    pub(crate) fn ends(&self, served: Served, operator: Operator) -> Vec<Cycle> {
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let again = verify(&self.trace()).expect("a readable trace");
        assert!(again.holds() && again.uncompared == 0, "{again:?}");
        cycles(&self.trace())
    }
}

pub(crate) fn jog(axes_mask: u32, distances: [f64; 3]) -> ControlRequest {
    let mut jog = ControlRequest {
        axes_mask,
        index: 1,
        amount: 30.0,
        ..command("JOG")
    };
    jog.values[..3].copy_from_slice(&distances);
    jog
}

/// Jogs away from the program by a distance, to the end of the jog.
#[track_caller]
pub(crate) fn jogs(operator: &mut Operator, axis: usize, distance: f64) {
    let before = operator.now().position_machine[axis];
    let mut distances = [0.0; 3];
    distances[axis] = distance;
    operator.does(&jog(1 << axis, distances));
    let goal = before + distance;
    operator.waits("the end of the jog", |status| {
        (status.position_machine[axis] - goal).abs() < 1e-9 && status.velocity[axis] == 0.0
    });
    // The return path is known after the cycle has reported the end of the jog.
    operator.waits("the way back", |status| {
        status.away_parts > 0 || status.operator_message().contains("`resume`")
    });
}

/// Asserts that the cycles keep the limits of every axis, by differences of their positions.
#[track_caller]
pub(crate) fn keeps_limits(shop: &Shop, cycles: &[Cycle]) {
    let limits = Machine::load(&shop.machine).expect("the machine file").limits();
    for axis in 0..3 {
        let limits = [
            limits.velocity[axis],
            limits.acceleration[axis],
            limits.jerk[axis],
        ];
        for four in cycles.windows(4) {
            // Drives without power are not at their setpoints: the core follows them by a step that is no
            // motion.
            let is_relocated = four.iter().any(|cycle| cycle.inputs & RELOCATED != 0);
            if four[3].sequence != four[0].sequence + 3 || is_relocated {
                continue;
            }
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| four[k].position[axis]);
            let rates = [
                (d - c) * 1e3,
                (d - 2.0 * c + b) * 1e6,
                (d - 3.0 * c + 3.0 * b - a) * 1e9,
            ];
            for ((value, slack), limit) in rates.iter().zip([1.001, 1.001, 1.02]).zip(limits) {
                let at = four[0].sequence;
                assert!(
                    value.abs() <= limit * slack + 1.0,
                    "axis {axis} at {at}: {value} of {limit}"
                );
            }
        }
    }
}

pub(crate) fn is_away(cycle: &Cycle) -> bool {
    cycle.inputs & (FOLLOWS | STEERS) == FOLLOWS | STEERS
}
