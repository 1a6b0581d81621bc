//! A program with its planner and a cycle, step by step: holds at given setpoints.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use evolvent_gcode::{Action, CanonicalCommand, Interpreter};
use evolvent_machine::{ControlRate, Machine};
use evolvent_motion::{Inputs, MotionState, PathExecutor, PlanConsumer, PlanProducer, Setpoint, plan_queue};
use evolvent_planner::Planner;
use evolvent_runtime::Setup;

/// A machine file at a rate, with a tool table that has every tool.
pub(crate) fn set_up(machine: &Path, rate_hz: f64) -> Setup {
    let text = std::fs::read_to_string(machine).expect("a machine file");
    let loaded = Machine::load(machine).expect("a machine");
    let rate = Some(ControlRate::Hz(rate_hz));
    let mut setup = Setup::new(loaded, machine.to_owned(), text, rate).expect("a rate");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let tools = folder.path().join("tools.tbl");
    let table: String = (1..100).map(|tool| format!("T{tool} P{tool} D3 Z0\n")).collect();
    std::fs::write(&tools, table).expect("a temporary file");
    setup.memory.load_tools(tools).expect("a tool table");
    setup
}

/// A program with its planner and a cycle, run in turn.
pub(crate) struct Driven {
    commands: Box<dyn Iterator<Item = CanonicalCommand>>,
    planner: Planner<PlanProducer<fn() -> bool>>,
    queue: PlanConsumer,
    motion: PathExecutor,
    block: u32,
    has_ended: bool,
}

impl Driven {
    pub(crate) fn new(program: &Path, setup: &Setup, period_ns: u64) -> Self {
        let (producer, queue) = plan_queue((|| false) as fn() -> bool);
        let reader = BufReader::new(File::open(program).expect("a program"));
        let limits = setup.machine.limits();
        Self {
            commands: Box::new(
                Interpreter::new(reader, setup.interpreter_settings())
                    .map(|command| command.expect("a program without errors")),
            ),
            planner: Planner::new(setup.path_limits(), setup.path_rules(1.0), producer),
            queue,
            motion: PathExecutor::new(limits, period_ns, limits.home),
            block: 0,
            has_ended: false,
        }
    }

    /// Plans until the next step does not depend on the planner.
    fn plan(&mut self) {
        while !self.motion.is_ready(&mut self.queue) {
            match self.commands.next() {
                Some(command) => {
                    if let Action::Move(motion) = command.action {
                        self.planner
                            .push(&motion, command.line, self.block)
                            .expect("a plan");
                        self.block += 1;
                    }
                }
                None if self.has_ended => drop(self.planner.poll()),
                None => {
                    self.planner.finish(0).expect("a plan");
                    self.has_ended = true;
                }
            }
        }
    }

    fn step(&mut self, hold: bool) -> Setpoint {
        let inputs = Inputs {
            hold,
            ..Inputs::default()
        };
        self.motion.step(&inputs, &mut self.queue)
    }

    pub(crate) fn whole(mut self) -> Vec<Setpoint> {
        let mut setpoints = Vec::new();
        while !self.motion.is_over() {
            self.plan();
            setpoints.push(self.step(false));
        }
        setpoints
    }

    /// The setpoints until rest of a hold that begins with number `moment`.
    pub(crate) fn held(mut self, moment: usize, is_frozen: bool) -> Vec<Setpoint> {
        let mut setpoints: Vec<Setpoint> = Vec::new();
        loop {
            let hold = setpoints.len() >= moment;
            if !(hold && is_frozen) {
                self.plan();
            }
            let setpoint = self.step(hold);
            assert!(
                self.motion.fault().is_none(),
                "the guard acts: {:?}",
                self.motion.fault()
            );
            setpoints.push(setpoint);
            if hold && matches!(setpoint.state, MotionState::Held | MotionState::Done) {
                return setpoints;
            }
        }
    }
}
