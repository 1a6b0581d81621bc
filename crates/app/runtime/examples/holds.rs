//! Holds at random moments of a program, with the plan ahead of each, as JSON lines for `shortest_stop.py` beside this file.
//!
//! `cargo run --release -p evolvent-runtime --example holds -- PROGRAM MACHINE RATE COUNT SEED`. In every third hold nobody plans
//! from the hold until the machine is at rest.

#![allow(
    clippy::print_stdout,
    clippy::expect_used,
    clippy::panic,
    reason = "an example prints, and ends where it cannot be set up"
)]

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use evolvent_gcode::{Action, Command, Interpreter};
use evolvent_machine::{ControlRate, Machine};
use evolvent_motion::{Inputs, PathExecutor, PlanConsumer, PlanProducer, Setpoint, State, plan_queue};
use evolvent_path::Axes;
use evolvent_planner::Planner;
use evolvent_random::Random;
use evolvent_runtime::Setup;

/// Time between two samples of the plan.
const SAMPLE_NS: u64 = 100_000;
/// How much of the plan beyond the duration of the hold is written.
const BEYOND_S: f64 = 0.05;

/// A program with its planner and a cycle, hand in hand.
struct Driven {
    commands: Box<dyn Iterator<Item = Command>>,
    planner: Planner<PlanProducer<fn() -> bool>>,
    queue: PlanConsumer,
    motion: PathExecutor,
    block: u32,
    has_ended: bool,
}

impl Driven {
    fn new(program: &Path, setup: &Setup, period_ns: u64) -> Self {
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

    fn whole(mut self) -> Vec<Setpoint> {
        let mut setpoints = Vec::new();
        while !self.motion.is_over() {
            self.plan();
            setpoints.push(self.step(false));
        }
        setpoints
    }

    /// The setpoints up to rest, of a hold that begins with number `moment`.
    fn held(mut self, moment: usize, is_frozen: bool) -> Vec<Setpoint> {
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
            if hold && matches!(setpoint.state, State::Held | State::Done) {
                return setpoints;
            }
        }
    }
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [program, machine, rate, count, seed] = words.as_slice() else {
        panic!("give PROGRAM MACHINE RATE COUNT SEED");
    };
    let (program, machine) = (PathBuf::from(program), PathBuf::from(machine));
    let rate_hz: f64 = rate.parse().expect("a rate in Hz");
    let text = std::fs::read_to_string(&machine).expect("a machine file");
    let loaded = Machine::load(&machine).expect("a machine");
    let mut setup = Setup::new(loaded, machine, text, Some(ControlRate::Hz(rate_hz))).expect("a rate");
    let tools = std::env::temp_dir().join(format!("holds-{}.tbl", std::process::id()));
    let table: String = (1..100).map(|tool| format!("T{tool} P{tool} D3 Z0\n")).collect();
    std::fs::write(&tools, table).expect("a temporary file");
    setup.memory.load_tools(tools.clone()).expect("a tool table");
    drop(std::fs::remove_file(tools));

    let samples = Driven::new(&program, &setup, SAMPLE_NS).whole();
    let plain = Driven::new(&program, &setup, setup.period_ns).whole();
    let moving: Vec<usize> = (1..plain.len())
        .filter(|&k| plain[k - 1].feed_mm_s > 0.0 && plain[k - 1].state == State::Running)
        .collect();
    let mut random = Random::from_state(seed.parse().expect("a seed"));
    for number in 0..count.parse().expect("a number of holds") {
        let moment = moving[random.below(moving.len())];
        let held = Driven::new(&program, &setup, setup.period_ns).held(moment, number % 3 == 0);
        write(&setup, &samples, &held, moment);
    }
}

/// One line: limits, the plan from the hold on, and the motion from the setpoint before the hold to rest.
fn write(setup: &Setup, samples: &[Setpoint], held: &[Setpoint], moment: usize) {
    let limits = setup.machine.limits();
    let period_s = setup.period_ns as f64 * 1e-9;
    let sample_s = SAMPLE_NS as f64 * 1e-9;
    let took_s = (held.len() - moment) as f64 * period_s;
    let from = &held[moment - 1];
    // Both rates begin with the same rest, so the sample of the same path is near.
    let guess = (moment as f64 * period_s / sample_s) as usize;
    let near = guess.saturating_sub(60).min(samples.len() - 1)..(guess + 60).min(samples.len());
    let off = |k: &usize| (samples[*k].path_mm - from.path_mm).abs();
    let begin = near.min_by(|a, b| off(a).total_cmp(&off(b))).expect("a sample");
    let end = (begin + ((took_s + BEYOND_S) / sample_s) as usize).min(samples.len());
    let rows = |setpoints: &[Setpoint], of: fn(&Setpoint) -> Axes| -> String {
        let rows: Vec<String> = setpoints
            .iter()
            .map(|setpoint| format!("{:?}", &of(setpoint).as_slice()[..3]))
            .collect();
        format!("[{}]", rows.join(","))
    };
    let (plan, motion) = (&samples[begin..end], &held[moment - 1..]);
    println!(
        "{{\"line\":{},\"moment\":{moment},\"feed_mm_s\":{},\"took_s\":{took_s},\"period_s\":{period_s},\"sample_s\":{sample_s},\
         \"acceleration\":{:?},\"jerk\":{:?},\"v\":{},\"a\":{},\"j\":{},\"driven_v\":{},\"driven_a\":{}}}",
        from.line,
        from.feed_mm_s,
        &limits.acceleration.as_slice()[..3],
        &limits.jerk.as_slice()[..3],
        rows(plan, |setpoint| setpoint.velocity),
        rows(plan, |setpoint| setpoint.acceleration),
        rows(plan, |setpoint| setpoint.jerk),
        rows(motion, |setpoint| setpoint.velocity),
        rows(motion, |setpoint| setpoint.acceleration),
    );
}
