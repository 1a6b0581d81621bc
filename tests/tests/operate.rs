//! A machine that is served, over the real bus and in real time.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use evolvent_bus::{ClientBus, ClientConfig, ControlRequest, LOAD_KINDS, Load, Setpoint};
use evolvent_tests::{Domain, Operator, Served, Workshop, command, evolvent};

const DONE: u32 = 1;
const STOPPED: u32 = 2;
const X_ONLY: u32 = 1;

struct Scene {
    workshop: Workshop,
    machine: std::path::PathBuf,
    name: String,
    // Last: it checks that nothing is left of the others.
    served: Option<Served>,
    domain: Domain,
}

impl Scene {
    fn new(name: &str) -> Self {
        Self::with(name, &[])
    }

    fn with(name: &str, options: &[&str]) -> Self {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = workshop.mill(name, &[]);
        let state = workshop.path("state");
        let served = Served::start(&machine, name, &domain, &state, options);
        Self {
            workshop,
            machine,
            name: name.to_owned(),
            served: Some(served),
            domain,
        }
    }

    fn operator(&self) -> Operator {
        Operator::join(&self.name, &self.domain)
    }

    fn restart(&mut self) {
        let state = self.workshop.path("state");
        self.served = Some(Served::start(
            &self.machine,
            &self.name,
            &self.domain,
            &state,
            &[],
        ));
    }

    fn end(mut self) {
        self.served.take().expect("a core").end().expect_code(&[0, 3]);
    }
}

/// Reads setpoints until one of which something is true; every one is handed to `see`.
fn follow(
    operator: &mut Operator,
    mut see: impl FnMut(&Setpoint),
    until: impl Fn(&Setpoint) -> bool,
) -> Setpoint {
    let begin = Instant::now();
    loop {
        match operator.setpoints.receive().expect("setpoints") {
            Some(setpoint) => {
                see(&setpoint);
                if until(&setpoint) {
                    return setpoint;
                }
            }
            None => std::thread::sleep(Duration::from_micros(300)),
        }
        assert!(begin.elapsed() < Duration::from_secs(30), "it does not come");
    }
}

/// What somebody saw who read every setpoint: differences of the published positions of all axes.
#[derive(Debug, Default)]
struct Seen {
    count: u64,
    lost: u64,
    worst_velocity: f64,
    worst_jerk: f64,
}

struct Watcher {
    stop: Arc<AtomicBool>,
    thread: std::thread::JoinHandle<Seen>,
}

impl Watcher {
    fn start(scene: &Scene) -> Self {
        let (name, prefix) = (scene.name.clone(), scene.domain.prefix.clone());
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let (ready_sender, ready) = std::sync::mpsc::channel();
        let thread = std::thread::spawn(move || {
            let config = ClientConfig {
                prefix: Some(prefix),
                wait: Duration::from_secs(20),
                ..ClientConfig::new(&name)
            };
            let bus = ClientBus::open(&config).expect("a core");
            let mut reader = bus.setpoints().expect("setpoints");
            ready_sender.send(()).expect("a test");
            let mut seen = Seen::default();
            let mut past: Vec<[f64; 9]> = Vec::new();
            while !stopped.load(Ordering::Relaxed) {
                let Some(setpoint) = reader.receive().expect("setpoints") else {
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                };
                seen.count += 1;
                let rate = 1e9 / setpoint.period_ns as f64;
                past.insert(0, setpoint.position);
                past.truncate(4);
                for axis in 0..9 {
                    let place = |k: usize| past.get(k).map(|past| past[axis]);
                    if let (Some(a), Some(b)) = (place(0), place(1)) {
                        seen.worst_velocity = seen.worst_velocity.max((a - b).abs() * rate);
                    }
                    if let (Some(a), Some(b), Some(c), Some(d)) = (place(0), place(1), place(2), place(3)) {
                        let jerk = (a - 3.0 * b + 3.0 * c - d).abs() * rate.powi(3);
                        seen.worst_jerk = seen.worst_jerk.max(jerk);
                    }
                }
            }
            seen.lost = reader.lost();
            seen
        });
        ready.recv().expect("a watcher");
        Self { stop, thread }
    }

    fn end(self) -> Seen {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().expect("a watcher")
    }
}

fn speed(setpoint: &Setpoint) -> f64 {
    setpoint.velocity.iter().map(|v| v * v).sum::<f64>().sqrt()
}

#[test]
fn a_program_is_started_held_resumed_overridden_and_stopped_and_setpoints_never_jump() {
    let scene = Scene::new("op-program");
    let mut operator = scene.operator();
    let program = scene.workshop.long_program(60);
    let watcher = Watcher::start(&scene);
    operator.brings_up();
    operator.says_number("MODE", 0);
    operator.says_text("LOAD", program.to_str().expect("UTF-8"));
    let job = operator.says("START").job;
    let running = operator.waits("motion", |status| status.state == 1 && status.feed_mm_s > 50.0);
    assert_eq!((running.activity, running.job, running.mode), (1, job, 0));
    assert!(
        running.path_to_go_mm > 100.0 && running.feed_programmed_mm_s == 100.0,
        "{running:?}"
    );
    assert!(running.distance_to_go[0].abs() > 0.0 && running.line > 1);

    operator.says("HOLD");
    let held = operator.waits("rest", |status| status.state == 3);
    assert_eq!(held.feed_mm_s, 0.0);
    assert_eq!(held.switches & 8, 8);
    operator.says("RESUME");
    operator.waits("motion again", |status| {
        status.state == 1 && status.feed_mm_s > 50.0
    });
    operator.does(&ControlRequest {
        amount: 0.5,
        ..command("FEED_OVERRIDE")
    });
    operator.waits("half the feed", |status| {
        (status.feed_mm_s - 50.0).abs() < 1.0 && status.override_ratio == 0.5
    });
    operator.says("STOP");
    let stopped = operator.sees_end(job);
    assert_eq!((stopped.job_result, stopped.activity), (STOPPED, 0));

    // From the first to the last: no number missing, no place left out.
    let seen = watcher.end();
    assert!(seen.count > 200 && seen.lost == 0, "{seen:?}");
    assert!(seen.worst_velocity <= 1.001 * 500.0, "{seen:?}");
    assert!(seen.worst_jerk <= 1.02 * 200_000.0, "{seen:?}");
    drop(operator);
    scene.end();
}

#[test]
fn commands_out_of_place_are_refused_with_number_and_sentence_and_change_nothing() {
    let scene = Scene::new("op-refuse");
    let mut operator = scene.operator();
    let refused = |operator: &mut Operator, request: &ControlRequest, alarm: u32| {
        let answer = operator.ask(request);
        assert_eq!((answer.verdict, answer.alarm), (1, alarm), "{}", answer.text());
        assert!(answer.text().len() > 15);
    };
    refused(&mut operator, &command("ON"), 910);
    operator.brings_up();
    refused(&mut operator, &command("START"), 913);
    refused(&mut operator, &command("HOLD"), 915);
    operator.says_number("MODE", 0);
    refused(&mut operator, &command("START"), 917);
    let mut missing = command("LOAD");
    assert!(missing.set_text("/nowhere/at-all.ngc"));
    refused(&mut operator, &missing, 922);
    let bad = scene.workshop.write("bad.ngc", "G21\nG1 X5000 F100\nM2\n");
    let mut load = command("LOAD");
    assert!(load.set_text(bad.to_str().expect("UTF-8")));
    let answer = operator.ask(&load);
    assert_eq!((answer.verdict, answer.alarm), (1, 919));
    for word in ["line 2", "axis X", "5000", "400"] {
        assert!(answer.text().contains(word), "{}", answer.text());
    }
    let status = operator.now();
    assert_eq!((status.job, status.machine_state, status.mode), (0, 2, 0));
    assert_eq!(status.program_name(), "");
    drop(operator);
    scene.end();
}

#[test]
fn mdi_remembers_modes_moves_and_is_refused_before_anything_moves() {
    let scene = Scene::new("op-mdi");
    let mut operator = scene.operator();
    operator.brings_up();
    operator.says_number("MODE", 2);
    let job = operator.says_text("MDI", "G91 G0 X-10").job;
    assert_eq!(operator.sees_end(job).job_result, DONE);
    let job = operator.says_text("MDI", "G1 X-2.5 Y1 F3000").job;
    let status = operator.sees_end(job);
    assert_eq!(status.job_result, DONE);
    assert!(
        (status.position_machine[0] + 12.5).abs() < 1e-9,
        "G91 is remembered"
    );
    assert!(status.modal.contains(&910));
    // The motion too: a rapid would be ten times as fast.
    while operator.setpoints.receive().expect("setpoints").is_some() {}
    let job = operator.says_text("MDI", "X10").job;
    let (mut top, mut begun): (f64, bool) = (0.0, false);
    follow(
        &mut operator,
        |setpoint| {
            begun |= setpoint.state == 1;
            if begun {
                top = top.max(speed(setpoint));
            }
        },
        |setpoint| setpoint.state == 9,
    );
    let status = operator.sees_end(job);
    assert!((status.position_machine[0] + 2.5).abs() < 1e-9);
    assert!((top - 50.0).abs() < 0.5, "{top} mm/s");
    let mut wrong = command("MDI");
    assert!(wrong.set_text("G90 G1 X9999 F100"));
    let answer = operator.ask(&wrong);
    assert_eq!((answer.verdict, answer.alarm), (1, 919), "{}", answer.text());
    assert!(wrong.set_text("G1 X#"));
    assert_eq!(operator.ask(&wrong).alarm, 923);
    assert_eq!(operator.now().job, job);
    drop(operator);
    scene.end();
}

#[test]
fn offsets_and_tools_outlive_a_restart_and_a_kill() {
    let mut scene = Scene::new("op-keep");
    let mut operator = scene.operator();
    operator.brings_up();
    operator.says_number("MODE", 2);
    let job = operator.says_text("MDI", "G0 X20 Y-5").job;
    operator.sees_end(job);
    let mut touch = command("TOUCH_OFF");
    (touch.axes_mask, touch.values[0], touch.values[1]) = (0b11, 1.0, 2.0);
    operator.does(&touch);
    let status = operator.now();
    assert_eq!(status.position_work[..2], [1.0, 2.0]);
    assert_eq!(status.work_offset[..2], [19.0, -7.0]);
    let mut tool = ControlRequest {
        index: 7,
        axes_mask: 0b100,
        amount: 6.0,
        ..command("TOOL")
    };
    tool.values[2] = 30.0;
    operator.does(&tool);
    drop(operator);
    scene.served.take().expect("a core").kill();
    scene.restart();
    let mut operator = scene.operator();
    assert_eq!(operator.now().work_offset[..2], [19.0, -7.0]);
    operator.brings_up();
    operator.says_number("MODE", 2);
    let job = operator.says_text("MDI", "T7 M6 G43").job;
    let status = operator.sees_end(job);
    assert_eq!((status.tool, status.tool_offset[2]), (7, 30.0));
    drop(operator);
    scene.end();
}

#[test]
fn a_jog_whose_client_is_killed_stops_within_a_tenth_of_a_second() {
    let scene = Scene::new("op-jog");
    let mut operator = scene.operator();
    operator.brings_up();
    let mut jogger = evolvent()
        .args([
            "ctl",
            "--bus-prefix",
            &scene.domain.prefix,
            "jog",
            "X+",
            "--speed",
            "1200",
        ])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the binary to start");
    operator.waits("a jog", |status| {
        status.activity == 3 && status.velocity[0] > 19.0
    });
    // Longer than the dead-man's patience: it is kept going.
    std::thread::sleep(Duration::from_millis(400));
    while operator.setpoints.receive().expect("setpoints").is_some() {}
    jogger.kill().expect("killed");
    let killed = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    let killed_ns = killed.tv_sec.cast_unsigned() * 1_000_000_000 + killed.tv_nsec.cast_unsigned();
    jogger.wait().expect("a process that ends");
    let mut top: f64 = 0.0;
    let slower = follow(
        &mut operator,
        |setpoint| top = top.max(setpoint.velocity[0]),
        |setpoint| setpoint.state == 4,
    );
    let begins_ms = (slower.due_time_ns - killed_ns) as f64 * 1e-6;
    println!("the stop begins {begins_ms:.1} ms after the kill");
    assert!((top - 20.0).abs() < 0.01, "{top}");
    assert!(
        begins_ms <= 100.0 + 5.0 * slower.period_ns as f64 * 1e-6,
        "{begins_ms} ms"
    );
    let status = operator.waits("rest", |status| status.activity == 0);
    assert_eq!((status.job_result, status.velocity[0]), (STOPPED, 0.0));
    drop(operator);
    scene.end();
}

#[test]
fn an_increment_ends_where_it_should_and_a_jog_ends_at_the_soft_limit() {
    let scene = Scene::new("op-increment");
    let mut operator = scene.operator();
    operator.brings_up();
    let mut jog = ControlRequest {
        axes_mask: X_ONLY,
        index: 1,
        amount: 100.0,
        ..command("JOG")
    };
    jog.values[0] = 12.5;
    let job = operator.does(&jog).job;
    let status = operator.sees_end(job);
    assert_eq!((status.job_result, status.position_machine[0]), (DONE, 12.5));
    jog.values[0] = 500.0;
    let answer = operator.ask(&jog);
    assert_eq!((answer.verdict, answer.alarm), (1, 919));
    assert!(answer.text().contains("112.5"), "{}", answer.text());
    // Continuous, with the dead-man kept until it is at the end of the travel.
    let mut jog = ControlRequest {
        axes_mask: X_ONLY,
        amount: 400.0,
        ..command("JOG")
    };
    jog.values[0] = -1.0;
    let job = operator.does(&jog).job;
    let begin = Instant::now();
    let mut result = 0;
    while result == 0 && begin.elapsed() < Duration::from_secs(20) {
        operator.says("JOG_KEEP");
        std::thread::sleep(Duration::from_millis(20));
        let status = operator.waits("a status", |status| status.job == job);
        result = status.job_result;
    }
    let status = operator.now();
    assert_eq!((status.job_result, status.position_machine[0]), (DONE, -400.0));
    drop(operator);
    scene.end();
}

#[test]
fn stale_serials_rubbish_and_floods_change_nothing() {
    let scene = Scene::new("op-rubbish");
    let mut operator = scene.operator();
    let mut rubbish = scene.operator();
    operator.brings_up();
    let before = operator.now();
    let good = ControlRequest {
        amount: 0.1,
        ..command("FEED_OVERRIDE")
    };
    let patience = Duration::from_secs(5);
    // Not by `..good`: this compiler breaks on it in a closure.
    let numbered = |client: u64, serial: u64| {
        let mut request = good;
        (request.client, request.serial) = (client, serial);
        request
    };
    let first = rubbish
        .control
        .send_as_it_is(&numbered(77, 5), patience)
        .expect("an answer");
    assert_eq!((first.verdict, first.client, first.serial), (0, 77, 5));
    operator.does(&ControlRequest { amount: 1.0, ..good });
    let mut random = evolvent_tests::Random::new();
    for _ in 0..300 {
        let mut request = numbered(77, 1 + random.below(5) as u64);
        let kind = random.below(5);
        match kind {
            0 => {}
            1 => (request.serial, request.amount) = (1_000 + random.below(1 << 20) as u64, f64::NAN),
            2 => (request.client, request.interface_version) = (78, random.below(1000) as u32 + 2),
            3 => (request.client, request.struct_size) = (79, random.below(1000) as u32),
            _ => (request.client, request.serial) = (0, 1),
        }
        let answer = rubbish
            .control
            .send_as_it_is(&request, patience)
            .expect("an answer");
        assert_ne!(answer.verdict, 0, "{kind}");
        assert_eq!((answer.client, answer.serial), (request.client, request.serial));
    }
    // Commands that are none, as fast as they can be sent, nobody waiting for an answer.
    for k in 0..3_000 {
        let request = ControlRequest {
            command: 1_000 + k,
            ..ControlRequest::default()
        };
        let _unanswered = rubbish.control.command(&request, Duration::ZERO);
    }
    let after = operator.now();
    assert_eq!(after.override_ratio, 1.0);
    assert_eq!(
        (after.machine_state, after.mode, after.job, after.position_machine),
        (
            before.machine_state,
            before.mode,
            before.job,
            before.position_machine
        )
    );
    assert!(after.commands_rejected >= 300, "{}", after.commands_rejected);
    assert_eq!(after.commands_accepted, before.commands_accepted + 2);
    drop((operator, rubbish));
    scene.end();
}

#[test]
fn a_long_program_is_checked_as_a_whole_before_it_starts() {
    let scene = Scene::new("op-long");
    let mut operator = scene.operator();
    operator.brings_up();
    operator.says_number("MODE", 0);
    let body = "G1 X1.0001 Y2.0002\nG1 X0 Y0\n".repeat(4000);
    let start = format!("G21 G90 F60000\n{body}");
    assert!(start.len() > 64 * 1024);
    let bad = scene
        .workshop
        .write("bad.ngc", format!("{start}G1 X9999\n{body}M2\n"));
    operator.says_text("LOAD", bad.to_str().expect("UTF-8"));
    // Refused until it is checked, and then for what is wrong: nothing moves.
    let refused = loop {
        let answer = operator.ask(&command("START"));
        assert_ne!(answer.verdict, 0, "started");
        if answer.alarm != 926 {
            break answer;
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    assert_eq!(refused.alarm, 919, "{}", refused.text());
    assert!(refused.text().contains("line 8002"), "{}", refused.text());
    let status = operator.now();
    assert_eq!((status.job, status.position_machine), (0, [0.0; 9]));
    assert!(
        status.operator_message().contains("line 8002"),
        "{}",
        status.operator_message()
    );

    let good = scene.workshop.write("good.ngc", format!("{start}M2\n"));
    operator.says_text("LOAD", good.to_str().expect("UTF-8"));
    let started = |operator: &mut Operator| loop {
        let answer = operator.ask(&command("START"));
        if answer.alarm != 926 {
            break answer;
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    let answer = started(&mut operator);
    assert_eq!(answer.verdict, 0, "{}", answer.text());
    operator.says("STOP");
    operator.sees_end(answer.job);
    // Another work offset is another place: it is checked again, and leaves the travel now.
    let mut offset = command("WORK_OFFSET");
    (offset.index, offset.axes_mask, offset.values[0]) = (0, X_ONLY, 399.5);
    operator.does(&offset);
    let answer = started(&mut operator);
    assert_eq!(answer.alarm, 919, "{}", answer.text());
    // A short one is checked again as well.
    let short = scene.workshop.write("short.ngc", "G21 G90 F6000\nG1 X0.2\nM2\n");
    operator.says_text("LOAD", short.to_str().expect("UTF-8"));
    offset.values[0] = 399.9;
    operator.does(&offset);
    assert_eq!(operator.ask(&command("START")).alarm, 919);
    drop(operator);
    scene.end();
}

#[test]
fn single_step_runs_block_by_block_and_program_stops_wait() {
    let scene = Scene::new("op-step");
    let mut operator = scene.operator();
    let text = "G21 G90 F3000\nG1 X5\nG1 Y5\nM0\n/G1 X20\nG1 X0\nM1\nG1 Y0\nM2\n";
    let program = scene.workshop.write("step.ngc", text);
    operator.brings_up();
    operator.says_number("MODE", 0);
    operator.says_number("BLOCK_DELETE", 1);
    operator.says_number("OPTIONAL_STOP", 1);
    operator.says_text("LOAD", program.to_str().expect("UTF-8"));
    let job = operator.says("STEP").job;
    let mut places = Vec::new();
    loop {
        let at = operator.waits("a stop or the end", |status| {
            status.state == 7 || status.job_result != 0
        });
        if at.job_result != 0 {
            break;
        }
        places.push((at.position_machine[0], at.position_machine[1]));
        if places.len() == 3 {
            operator.says_number("SINGLE_STEP", 0);
        }
        operator.says("RESUME");
        operator.waits("going on", |status| {
            status.position_machine != at.position_machine || status.job_result != 0
        });
    }
    assert_eq!(operator.sees_end(job).job_result, DONE);
    // Behind each line that moves, M0 and M1 once, and X20 is never driven.
    assert_eq!(places, [(5.0, 0.0), (5.0, 5.0), (0.0, 5.0)]);
    drop(operator);
    scene.end();
}

#[test]
fn the_first_signal_stops_on_the_path_and_ends_and_every_command_is_in_the_trace() {
    let workshop = Workshop::new();
    let domain = Domain::new();
    let machine = workshop.mill("op-signal", &[]);
    let trace = workshop.path("served.mcap");
    let trace_option = trace.to_str().expect("UTF-8").to_owned();
    let served = Served::start(
        &machine,
        "op-signal",
        &domain,
        &workshop.path("state"),
        &["--trace", &trace_option],
    );
    let mut operator = Operator::join("op-signal", &domain);
    let program = workshop.long_program(60);
    operator.brings_up();
    operator.says_number("MODE", 0);
    operator.says_text("LOAD", program.to_str().expect("UTF-8"));
    operator.says("START");
    operator.waits("motion", |status| status.feed_mm_s > 90.0);
    operator.does(&ControlRequest {
        amount: 0.7,
        ..command("FEED_OVERRIDE")
    });
    operator.waits("less", |status| status.feed_mm_s < 75.0);
    let finished = {
        served.signal(rustix::process::Signal::TERM);
        let mut last: Option<Setpoint> = None;
        let end = follow(
            &mut operator,
            |setpoint| last = Some(*setpoint),
            |setpoint| setpoint.flags & 128 != 0,
        );
        assert_eq!(speed(&end), 0.0);
        // On the line from (-100, -50) to (100, 50).
        assert!(
            (end.position[0] - 2.0 * end.position[1]).abs() < 1e-6,
            "{:?}",
            end.position
        );
        drop(operator);
        served.wait()
    };
    finished.expect_code(&[0, 3]);
    let mut file = evolvent_trace::TraceFile::open(&trace).expect("a complete trace");
    let events: Vec<_> = file.events().map(|event| event.expect("an event")).collect();
    let commands: Vec<&str> = events
        .iter()
        .filter(|event| event.kind == evolvent_trace::EventKind::Command)
        .map(|event| event.text.as_str())
        .collect();
    for expected in [
        "emergency stop reset",
        "on",
        "mode auto",
        "start",
        "feed override 70.0 %",
    ] {
        assert!(commands.contains(&expected), "{expected}: {commands:?}");
    }
    // The override counts from the cycle that the event names.
    let event = events
        .iter()
        .find(|event| event.text == "feed override 70.0 %")
        .expect("the override");
    let cycles = evolvent_tests::cycles(&trace);
    let at = event.sequence as usize;
    assert_eq!((cycles[at - 1].override_, cycles[at].override_), (1.0, 0.7));
}

#[test]
fn a_jog_turns_round_in_motion_without_standing_longer_than_a_cycle() {
    let scene = Scene::new("op-turn");
    let mut operator = scene.operator();
    operator.brings_up();
    let jog = |direction: f64, speed: f64| {
        let mut jog = command("JOG");
        (jog.axes_mask, jog.amount, jog.values[0]) = (X_ONLY, speed, direction);
        jog
    };
    let job = operator.does(&jog(1.0, 50.0)).job;
    operator.waits("a jog", |status| status.velocity[0] > 49.0);
    while operator.setpoints.receive().expect("setpoints").is_some() {}
    assert_eq!(operator.does(&jog(-1.0, 30.0)).job, job, "it is the same job");
    let (mut still, mut last) = (0, f64::NAN);
    follow(
        &mut operator,
        |setpoint| {
            assert_eq!(setpoint.state, 1, "it never stops in between");
            still += u32::from(setpoint.velocity[0] == 0.0);
            if last.is_finite() {
                let step = (setpoint.velocity[0] - last).abs();
                assert!(
                    step <= 5000.0 * 1.001 * setpoint.period_ns as f64 * 1e-9,
                    "{step}"
                );
            }
            last = setpoint.velocity[0];
        },
        |setpoint| setpoint.velocity[0] < -29.9,
    );
    assert!(still <= 1, "{still} cycles at rest");
    operator.says("JOG_STOP");
    assert_eq!(operator.sees_end(job).job_result, STOPPED);
    drop(operator);
    scene.end();
}

#[test]
fn the_rapid_override_slows_rapids_and_leaves_feeds_alone() {
    let scene = Scene::new("op-rapid");
    let mut operator = scene.operator();
    operator.brings_up();
    let top = |operator: &mut Operator, block: &str| {
        operator.says_number("MODE", 2);
        let job = operator.says_text("MDI", block).job;
        let mut top: f64 = 0.0;
        let mut moved = false;
        follow(
            operator,
            |setpoint| {
                top = top.max(speed(setpoint));
                moved |= setpoint.state == 1;
            },
            |setpoint| setpoint.state == 9,
        );
        assert_eq!(operator.sees_end(job).job_result, DONE);
        top
    };
    let full = top(&mut operator, "G0 X200");
    assert!(full > 490.0, "{full}");
    operator.does(&ControlRequest {
        amount: 0.25,
        ..command("RAPID_OVERRIDE")
    });
    let slow = top(&mut operator, "G0 X0");
    assert!((slow - 125.0).abs() < 1.0, "{slow}");
    let feed = top(&mut operator, "G1 X100 F12000");
    assert!((feed - 200.0).abs() < 1.0, "{feed}");
    drop(operator);
    scene.end();
}

#[test]
fn a_service_manager_is_told_when_it_is_ready_alive_and_stopping() {
    let (workshop, domain) = (Workshop::new(), Domain::new());
    let machine = workshop.mill("op-notify", &[]);
    let socket = workshop.path("notify");
    let manager = std::os::unix::net::UnixDatagram::bind(&socket).expect("a socket");
    manager
        .set_read_timeout(Some(Duration::from_secs(20)))
        .expect("a timeout");
    let mut child = evolvent()
        .args(["serve", "--bus-prefix", &domain.prefix, "--machine"])
        .arg(&machine)
        .arg("--state")
        .arg(workshop.path("state"))
        .env("NOTIFY_SOCKET", &socket)
        .env("WATCHDOG_USEC", "100000")
        .env_remove("WATCHDOG_PID")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the binary to start");
    let hear = || {
        let mut text = [0; 64];
        let length = manager.recv(&mut text).expect("news");
        String::from_utf8_lossy(&text[..length]).into_owned()
    };
    assert_eq!(hear(), "READY=1");
    let begin = Instant::now();
    for _ in 0..5 {
        assert_eq!(hear(), "WATCHDOG=1");
    }
    assert!(begin.elapsed() < Duration::from_secs(5));
    let pid = rustix::process::Pid::from_raw(child.id().cast_signed()).expect("a process");
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).expect("a living process");
    while hear() != "STOPPING=1" {}
    child.wait().expect("a process that ends");
}

#[test]
fn a_cutting_load_is_recorded_while_its_sensor_speaks() {
    let workshop = Workshop::new();
    let trace = workshop.path("load.mcap");
    let scene = Scene::with("op-load", &["--trace", trace.to_str().expect("UTF-8")]);
    let mut operator = scene.operator();
    let bus = scene.domain.client("op-load");
    let mut sensor = bus.load_sender().expect("the load channel");
    let before = operator.now().cycles;
    for sequence in 1..=300 {
        let load = Load {
            sequence,
            kind: LOAD_KINDS[0].1,
            value: 0.25 * sequence as f64,
            range_max: 1000.0,
            ..Load::default()
        };
        sensor.send(&load).expect("sent");
        std::thread::sleep(Duration::from_millis(2));
    }
    std::thread::sleep(Duration::from_millis(1500));
    drop((operator, sensor, bus));
    scene.end();
    let mut trace = evolvent_trace::TraceFile::open(&trace).expect("a complete trace");
    let loads: Vec<f64> = trace
        .cycles()
        .map(|cycle| cycle.expect("a readable cycle").load)
        .collect();
    let known: Vec<f64> = loads.iter().copied().filter(|load| !load.is_nan()).collect();
    assert!(known.len() > 200 && known.is_sorted(), "{} loads", known.len());
    assert_eq!(known[known.len() - 1], 75.0);
    assert!(loads[before as usize / 2].is_nan(), "before there was a sensor");
    assert!(loads[loads.len() - 1].is_nan(), "long after it was silent");
}
