//! Random sequences of jogs, increments, stops and life signs: operator and cycle in one thread, in time of their own.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc;

use evolvent_bus::{ControlRequest, Feedback};
use evolvent_control::{CommandCode, JobResult};
use evolvent_drive::{FeedbackWatch, WatchSettings};
use evolvent_machine::Machine;
use evolvent_motion::{DrivenPath, MachineState, Setpoint};
use evolvent_path::{Axes, AxisMask};
use evolvent_random::{Random, cases};
use evolvent_signals::ProbeInput;
use rtrb::{Consumer, Producer, RingBuffer};

use super::operator::{Job, Operator, OperatorConfig};
use super::orders::{CycleEvent, CycleView};
use super::served_cycle::{ServedCycle, ServedParts};
use super::state_store::StateStore;
use crate::core_loop::{CycleBegin, CycleCounts, CycleEnd, SetpointSource};
use crate::job::Setup;
use crate::shared::Controls;

const PERIOD_NS: u64 = 1_000_000;
/// Cycles after which a speed asked for is reached, or an axis at rest: from 500 mm/s with 3000 mm/s2 and its jerk, and the time
/// until a change is applied, also one that came too late the first time.
const SETTLES: u64 = 450;
/// Cycles without a life sign after which a jog without distance begins to stop.
const PATIENCE: u64 = 90;

/// A machine on its own, at rest at home, switched on, in manual mode.
struct Bench {
    operator: Operator,
    cycle: ServedCycle,
    views: Consumer<CycleView>,
    events: Consumer<CycleEvent>,
    answers: Consumer<Feedback>,
    _answers: Producer<Feedback>,
    _to_cycle: Producer<Feedback>,
    _folder: tempfile::TempDir,
    counts: CycleCounts,
    now: u64,
    serial: u64,
    last: Setpoint,
}

impl Bench {
    fn new() -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let text = std::fs::read_to_string(&file).unwrap();
        let machine = Machine::parse(&text, "mill.toml").unwrap();
        let mut setup = Setup::new(machine, file, text, None).unwrap();
        setup.period_ns = PERIOD_NS;
        let limits = setup.machine.limits();
        let (orders, cycle_orders) = RingBuffer::new(1024);
        let (cycle_events, events) = RingBuffer::new(4096);
        let (cycle_views, mut views) = RingBuffer::new(4096);
        let (_to_cycle, feedback) = RingBuffer::new(1);
        let (_answers, answers) = RingBuffer::new(1);
        let (periphery, _publisher) = mpsc::channel();
        let mut cycle = ServedCycle::new(ServedParts {
            station: MachineState::new(limits, PERIOD_NS, limits.home),
            limits,
            period_ns: PERIOD_NS,
            orders: cycle_orders,
            events: cycle_events,
            views: cycle_views,
            feedback,
            watch: FeedbackWatch::new(WatchSettings::new(PERIOD_NS, AxisMask::NONE)),
            signals: None,
            corrections: None,
            probe: ProbeInput::default(),
            wheel_counts: None,
            phase: None,
            controls: Arc::new(Controls::new(1.0)),
            driven: DrivenPath::new(PERIOD_NS),
        });
        let mut counts = CycleCounts::default();
        let last = step(&mut cycle, 0, &mut counts);
        let folder = tempfile::tempdir().unwrap();
        let operator = Operator::new(OperatorConfig {
            keep: StateStore::open(setup.memory.clone(), folder.path()),
            setup,
            folder: folder.path().to_owned(),
            orders,
            recorder: None,
            periphery,
            view: views.pop().unwrap(),
        })
        .unwrap();
        let mut bench = Self {
            operator,
            cycle,
            views,
            events,
            answers,
            _answers,
            _to_cycle,
            _folder: folder,
            counts,
            now: 0,
            serial: 0,
            last,
        };
        for (code, index) in [
            (CommandCode::EstopReset, 0),
            (CommandCode::On, 0),
            (CommandCode::Mode, 1),
        ] {
            let mut command = bench.command(code);
            command.index = index;
            assert!(bench.says(1, command), "{code:?}");
            bench.runs(10);
            bench.ticks();
        }
        bench
    }

    fn command(&self, code: CommandCode) -> ControlRequest {
        ControlRequest {
            command: code as u32,
            ..ControlRequest::default()
        }
    }

    /// Whether it was accepted.
    fn says(&mut self, client: u64, mut request: ControlRequest) -> bool {
        self.serial += 1;
        (request.client, request.serial) = (client, self.serial);
        let answer = self.operator.answer(&request, self.now * PERIOD_NS);
        answer.is_none_or(|answer| answer.verdict == 0)
    }

    fn ticks(&mut self) {
        let (views, events, answers) = (&mut self.views, &mut self.events, &mut self.answers);
        self.operator
            .tick(self.now * PERIOD_NS, views, events, answers, |_| {});
    }

    fn runs(&mut self, cycles: u64) -> Vec<Setpoint> {
        (0..cycles)
            .map(|_| {
                self.now += 1;
                self.last = step(&mut self.cycle, self.now, &mut self.counts);
                self.last
            })
            .collect()
    }
}

fn step(cycle: &mut ServedCycle, number: u64, counts: &mut CycleCounts) -> Setpoint {
    let computed = cycle.step(&CycleBegin {
        number,
        deadline_ns: number * PERIOD_NS,
    });
    cycle.finish(&CycleEnd {
        setpoint: &computed.setpoint,
        lateness_ns: 0,
        work_ns: 0,
        counts,
    });
    computed.setpoint
}

/// What was asked of one axis since all were at rest.
#[derive(Clone, Copy, Debug, Default)]
struct Asked {
    /// Highest speed so far; 0 where nothing was asked.
    top: f64,
    /// Last speed; 0 if the axis is to stop.
    last: f64,
    /// Range that increments permit, if only they have moved it.
    goal: Option<f64>,
    /// How far from `goal` the axis may be as it began to count in motion.
    slack: f64,
    lowest: f64,
    highest: f64,
}

#[test]
fn random_jogs_keep_the_speed_and_the_distance_asked_for_and_the_dead_man() {
    let mut random = Random::seeded(2313);
    let mut bench = Bench::new();
    let (mut taken_over, mut stopped_by_dead_man, mut increments_done) = (0, 0, 0);
    for motion in 0..cases(400) {
        let here = bench.operator.view.setpoint.position;
        let mut asked = [Asked::default(); 3];
        for (i, axis) in asked.iter_mut().enumerate() {
            (axis.lowest, axis.highest) = (here[i], here[i]);
        }
        let (mut is_increment, mut any) = (false, false);
        // Of the present jog: its client, whether it is still held, when its last life sign was.
        let (mut client, mut is_held, mut alive_at) = (0, false, 0);
        let mut changed_at = bench.now;
        let mut log: Vec<String> = Vec::new();
        let commands = 1 + random.below(6);
        let mut left = commands;
        let mut stop_at = None;
        let begun = bench.now;
        let mut result = JobResult::None;
        loop {
            assert!(
                bench.now < begun + 60_000,
                "motion {motion} does not end: {log:?}"
            );
            if left > 0 && (!any || random.below(12) == 0) {
                left -= 1;
                let who = 1 + random.below(3) as u64;
                let was_moving = !matches!(bench.operator.job, Job::None);
                let mut jog = bench.command(CommandCode::Jog);
                let adds = random.below(2) == 0;
                (jog.index, jog.amount) = (u32::from(adds), random.log(1.0, 400.0));
                jog.axes_mask = 1 << random.below(3);
                if random.below(6) == 0 {
                    jog.axes_mask |= 1 << random.below(3);
                }
                for i in AxisMask::from_bits(jog.axes_mask).axes() {
                    let sign = if random.below(2) == 0 { 1.0 } else { -1.0 };
                    jog.values[i] = sign * if adds { random.log(0.01, 40.0) } else { 1.0 };
                }
                // The state that the operator does not know yet.
                let at = bench.last;
                // A jog of this axis may be on its way to the cycle.
                let is_pending = was_moving && bench.now < changed_at + 60;
                if bench.says(who, jog) {
                    taken_over += u32::from(was_moving);
                    log.push(format!(
                        "{} ms: {who} {:?} {:?} at {}",
                        bench.now - begun,
                        &jog.values[..3],
                        jog.index,
                        jog.amount
                    ));
                    (client, is_held, alive_at, changed_at) = (who, !adds, bench.now, bench.now);
                    for (i, axis) in asked.iter_mut().enumerate() {
                        let named = jog.axes_mask >> i & 1 == 1;
                        let limit = bench.operator.limits.velocity[i];
                        if named {
                            axis.last = jog.amount.min(limit);
                            axis.top = axis.top.max(axis.last);
                        } else if !(adds && is_increment) {
                            axis.last = 0.0;
                        }
                        let adds_to_one = adds && is_increment && axis.goal.is_some();
                        if named && adds {
                            let base = if adds_to_one {
                                axis.goal.unwrap_or(at.position[i])
                            } else {
                                at.position[i]
                            };
                            if !adds_to_one {
                                // Where it stops, and by how much late.
                                let v = axis.top.max(at.velocity[i].abs());
                                let moving = is_pending || at.velocity[i] != 0.0 || at.acceleration[i] != 0.0;
                                axis.slack = if moving {
                                    v * (v / 3000.0 + 0.1 + 0.1)
                                } else {
                                    1e-6
                                };
                            }
                            axis.goal = Some(base + jog.values[i]);
                        } else if !(adds && is_increment) {
                            axis.goal = None;
                            if named {
                                (axis.lowest, axis.highest) = (f64::NEG_INFINITY, f64::INFINITY);
                            }
                        }
                        if let Some(goal) = axis.goal {
                            axis.lowest = axis
                                .lowest
                                .min(goal - axis.slack)
                                .min(at.position[i] - axis.slack);
                            axis.highest = axis
                                .highest
                                .max(goal + axis.slack)
                                .max(at.position[i] + axis.slack);
                        }
                    }
                    is_increment = adds;
                } else if !any {
                    break;
                }
                any = true;
            }
            if is_held && random.below(80) == 0 {
                is_held = false;
            }
            if is_held && random.below(5) == 0 {
                let keep = bench.command(CommandCode::JogKeep);
                bench.says(client, keep);
                alive_at = bench.now;
            } else if random.below(10) == 0 {
                // Another client's life sign keeps nothing going.
                let keep = bench.command(CommandCode::JogKeep);
                bench.says(9, keep);
            }
            if random.below(200) == 0 {
                let stop = bench.command(CommandCode::JogStop);
                bench.says(7, stop);
                stop_at.get_or_insert(bench.now);
                left = 0;
                is_held = false;
            }
            // Now and then the control thread sleeps for longer than the lead of a change.
            let cycles = if random.below(25) == 0 {
                20
            } else {
                1 + random.below(6) as u64
            };
            for setpoint in bench.runs(cycles) {
                for (i, axis) in asked.iter().enumerate() {
                    let (speed, at) = (setpoint.velocity[i].abs(), setpoint.position[i]);
                    let bound = |speed: f64| speed * (1.0 + 1e-3) + 1e-6;
                    let moment = bench.now - begun;
                    assert!(
                        speed <= bound(axis.top),
                        "motion {motion}: axis {i} at {speed} mm/s, asked for {axis:?}, {moment} ms: {log:?}"
                    );
                    if bench.now > changed_at + SETTLES {
                        assert!(
                            speed <= bound(axis.last),
                            "motion {motion}: axis {i} still at {speed} mm/s, asked for {axis:?}, {moment} ms: {log:?}"
                        );
                    }
                    assert!(
                        (axis.lowest..=axis.highest).contains(&at),
                        "motion {motion}: axis {i} at {at} mm, asked for {axis:?}, {moment} ms: {log:?}"
                    );
                    let is_dead = !is_increment && bench.now > alive_at + PATIENCE + SETTLES;
                    let is_stopped = stop_at.is_some_and(|stop_at| bench.now > stop_at + SETTLES);
                    assert!(
                        speed == 0.0 || !(is_dead || is_stopped),
                        "motion {motion}: axis {i} at {speed} mm/s without a dead man, {moment} ms: {log:?}"
                    );
                }
            }
            bench.ticks();
            if matches!(bench.operator.job, Job::None) && any {
                result = bench.operator.desk.result();
                break;
            }
        }
        if !any {
            continue;
        }
        stopped_by_dead_man += u32::from(result == JobResult::Stopped && !is_increment && stop_at.is_none());
        let end = bench.operator.view.setpoint;
        assert!(
            end.velocity == Axes::zeros(),
            "motion {motion} has ended and moves: {log:?}"
        );
        if is_increment && result == JobResult::Done {
            increments_done += 1;
            for (i, axis) in asked.iter().enumerate() {
                if let Some(goal) = axis.goal {
                    let off = (end.position[i] - goal).abs();
                    assert!(
                        off <= axis.slack,
                        "motion {motion}: axis {i} ends {off} mm off, {axis:?}: {log:?}"
                    );
                }
            }
        }
        bench.runs(20);
        bench.ticks();
    }
    // Otherwise the test has shown nothing.
    assert!(
        taken_over > 100 && stopped_by_dead_man > 30 && increments_done > 30,
        "{taken_over} {stopped_by_dead_man} {increments_done}"
    );
}
