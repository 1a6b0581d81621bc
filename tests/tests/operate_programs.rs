//! Programs on a served machine, over the real bus and in real time.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use evolvent_bus::{ClientBus, ClientConfig, ControlRequest, Setpoint};
use evolvent_tests::job_result::{DONE, STOPPED};
use evolvent_tests::{Operator, Scene, command, speed, unless_disturbed};

const X_ONLY: u32 = 1;

/// Measurements of a reader of every setpoint: differences of the published positions of all axes.
#[derive(Debug, Default)]
struct Measured {
    count: u64,
    lost: u64,
    worst_velocity: f64,
    worst_jerk: f64,
}

struct Watcher {
    stop: Arc<AtomicBool>,
    thread: std::thread::JoinHandle<Measured>,
}

impl Watcher {
    fn start(scene: &Scene) -> Self {
        let (name, prefix) = (scene.name().to_owned(), scene.domain.prefix.clone());
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let (ready_sender, ready) = std::sync::mpsc::channel();
        let thread = std::thread::spawn(move || {
            let config = ClientConfig {
                prefix: Some(prefix),
                wait: Duration::from_secs(120),
                ..ClientConfig::new(&name)
            };
            let bus = ClientBus::open(&config).expect("a core");
            let mut reader = bus.setpoints().expect("setpoints");
            ready_sender.send(()).expect("a test");
            let mut measured = Measured::default();
            let mut past: Vec<[f64; 9]> = Vec::new();
            loop {
                // Setpoints from before the stop request are still read.
                let is_over = stopped.load(Ordering::Relaxed);
                let Some(setpoint) = reader.receive().expect("setpoints") else {
                    if is_over {
                        break;
                    }
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                };
                measured.count += 1;
                let rate = 1e9 / setpoint.period_ns as f64;
                past.insert(0, setpoint.position);
                past.truncate(4);
                for axis in 0..9 {
                    let position = |k: usize| past.get(k).map(|past| past[axis]);
                    if let (Some(a), Some(b)) = (position(0), position(1)) {
                        measured.worst_velocity = measured.worst_velocity.max((a - b).abs() * rate);
                    }
                    if let (Some(a), Some(b), Some(c), Some(d)) =
                        (position(0), position(1), position(2), position(3))
                    {
                        let jerk = (a - 3.0 * b + 3.0 * c - d).abs() * rate.powi(3);
                        measured.worst_jerk = measured.worst_jerk.max(jerk);
                    }
                }
            }
            measured.lost = reader.lost();
            measured
        });
        ready.recv().expect("a watcher");
        Self { stop, thread }
    }

    fn end(self) -> Measured {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().expect("a watcher")
    }
}

#[test]
fn a_program_obeys_all_commands_without_jumps() {
    unless_disturbed(|| {
        let scene = Scene::new("op-program");
        let mut operator = scene.operator();
        let program = scene.workshop.long_program(60);
        let watcher = Watcher::start(&scene);
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let begin = operator.now();
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

        // From the first to the last: no number is missing, no position is skipped.
        let measured = watcher.end();
        let cycles = stopped.cycles - begin.cycles;
        assert!(
            measured.count >= cycles && measured.lost == 0,
            "{measured:?} of {cycles}"
        );
        assert!(measured.worst_velocity <= 1.001 * 500.0, "{measured:?}");
        assert!(measured.worst_jerk <= 1.02 * 200_000.0, "{measured:?}");
        drop(operator);
        scene.end();
    });
}

#[test]
fn a_hold_during_planning_holds_the_program() {
    unless_disturbed(|| {
        let scene = Scene::new("op-early-hold");
        let mut operator = scene.operator();
        let program = scene.workshop.long_program(600);
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        for _ in 0..5 {
            let job = operator.says("START").job;
            operator.says("HOLD");
            let held = operator.waits("the hold", |status| status.state == 3);
            assert_eq!((held.job, held.switches & 8), (job, 8));
            std::thread::sleep(Duration::from_millis(50));
            assert_eq!(operator.now().position_machine, held.position_machine);
            operator.says("RESUME");
            operator.waits("motion", |status| status.state == 1 && status.feed_mm_s > 50.0);
            operator.says("STOP");
            assert_eq!(operator.sees_end(job).job_result, STOPPED);
        }
        drop(operator);
        scene.end();
    });
}

#[test]
fn nothing_resumes_a_program_that_was_told_to_stop() {
    unless_disturbed(|| {
        let scene = Scene::new("op-stop");
        let mut operator = scene.operator();
        let program = scene.workshop.long_program(60);
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let job = operator.says("START").job;
        operator.waits("motion", |status| status.state == 1 && status.feed_mm_s > 90.0);
        operator.says("HOLD");
        operator.says("STOP");
        // While it stops nothing is held; once it has stopped nothing runs.
        let answer = operator.request(&command("RESUME"));
        assert!(
            answer.verdict == 1 && [915, 920].contains(&answer.alarm),
            "{}",
            answer.text()
        );
        assert_eq!(operator.sees_end(job).job_result, STOPPED);
        drop(operator);
        scene.end();
    });
}

#[test]
fn a_long_program_is_checked_whole_before_it_starts() {
    unless_disturbed(|| {
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
        // Rejected until it is checked, and then for its errors: nothing moves.
        let refused = loop {
            let answer = operator.request(&command("START"));
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
            let answer = operator.request(&command("START"));
            if answer.alarm != 926 {
                break answer;
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        let answer = started(&mut operator);
        assert_eq!(answer.verdict, 0, "{}", answer.text());
        operator.says("STOP");
        operator.sees_end(answer.job);
        // Another work offset means other positions: the program is checked again, and now leaves the travel.
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
        assert_eq!(operator.request(&command("START")).alarm, 919);
        drop(operator);
        scene.end();
    });
}

#[test]
fn a_long_loop_is_checked_whole_before_it_starts() {
    unless_disturbed(|| {
        let scene = Scene::new("op-loop");
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 0);
        let started = |operator: &mut Operator| loop {
            let answer = operator.request(&command("START"));
            if answer.alarm != 926 {
                break answer;
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        let body = "G1 X0.1\nG1 X0\n".repeat(10);
        let write = |name: &str, opening: &str, end: &str| {
            let text = format!("G21 G90 F6000\n{opening}\n{body}{end}\nG1 X1 X2\nM2\n");
            scene.workshop.write(name, text)
        };
        let wrong = write("wrong.ngc", "o1 repeat [6000]", "o1 endrepeat");
        operator.says_text("LOAD", wrong.to_str().expect("UTF-8"));
        let refused = started(&mut operator);
        assert_eq!(refused.alarm, 923, "{}", refused.text());
        assert!(refused.text().contains("line 24"), "{}", refused.text());
        assert_eq!(operator.now().job, 0, "nothing moves");

        // An endless program can be started; the reply says how far it was checked.
        let endless = write("endless.ngc", "o1 while [1]", "o1 endwhile");
        operator.says_text("LOAD", endless.to_str().expect("UTF-8"));
        assert_eq!(
            operator.now().operator_message(),
            "",
            "that of the program before"
        );
        let answer = started(&mut operator);
        assert_eq!(answer.verdict, 0, "{}", answer.text());
        let status = operator.now();
        for text in [answer.text(), status.operator_message()] {
            let reason =
                "checked up to line 22: the loop that begins on line 2 has more than 1000000 commands";
            assert!(text.contains(reason), "{text:?}");
        }
        operator.says("STOP");
        operator.sees_end(answer.job);
        drop(operator);
        let finished = scene.finish();
        assert!(
            finished.err.contains("endless.ngc: checked up to line 22"),
            "{}",
            finished.err
        );
    });
}

#[test]
fn single_step_runs_by_block_and_program_stops_wait() {
    unless_disturbed(|| {
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
        let mut stops = Vec::new();
        loop {
            let at = operator.waits("a stop or the end", |status| {
                status.state == 7 || status.job_result != 0
            });
            if at.job_result != 0 {
                break;
            }
            stops.push((at.position_machine[0], at.position_machine[1]));
            if stops.len() == 3 {
                operator.says_number("SINGLE_STEP", 0);
            }
            operator.says("RESUME");
            operator.waits("going on", |status| {
                status.position_machine != at.position_machine || status.job_result != 0
            });
        }
        assert_eq!(operator.sees_end(job).job_result, DONE);
        // After each line that moves; M0 and M1 stop once each, and X20 is never driven.
        assert_eq!(stops, [(5.0, 0.0), (5.0, 5.0), (0.0, 5.0)]);
        drop(operator);
        scene.end();
    });
}

/// Follows setpoints until the machine is held; returns the one with this number, the first that brakes, and
/// the last.
fn sees_hold(operator: &mut Operator, number: u64) -> [Setpoint; 3] {
    let (mut named, brakes) = (None, Cell::new(None));
    let held = operator.follows(
        |setpoint| {
            if setpoint.sequence == number {
                named = Some(*setpoint);
            }
            // A hold before that number was another one.
            if setpoint.sequence <= number {
                brakes.set(None);
            } else if setpoint.state == 2 && brakes.get().is_none() {
                brakes.set(Some(*setpoint));
            }
        },
        // The reply names the setpoint that the control thread knew: the next may still belong to the
        // previous hold.
        |setpoint| setpoint.sequence > number && setpoint.state == 3 && brakes.get().is_some(),
    );
    let brakes = brakes.get().expect("a braking one");
    [named.expect("that setpoint"), brakes, held]
}

#[test]
fn single_step_while_running_holds_in_the_next_line() {
    unless_disturbed(|| {
        let scene = Scene::new("op-step-late");
        let mut operator = scene.operator();
        // Lines 2 to 9 go straight on, 20 mm each; line 11 is a canned cycle of several moves.
        let mut text = "G21 G90 G61 F1200\n".to_owned();
        for line in 2..=9 {
            text += &format!("G1 X{}\n", 20 * (line - 1));
        }
        text += "M0\nG81 X165 Z-3 R1\nG80 G1 X200\nM2\n";
        let program = scene.workshop.write("late.ngc", text);
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let job = operator.says("START").job;
        operator.waits("line 3", |status| status.line >= 3);
        let mut answer = operator.says_number("SINGLE_STEP", 1);
        let mut last_position = [0.0; 9];
        // From a feed of v with a jerk of j, without reaching the acceleration limit, the distance is v
        // sqrt(v / j). The bound leaves 30 ms at the feed.
        let (feed, jerk) = (20.0_f64, 200_000.0);
        let min_mm = feed * (feed / jerk).sqrt();
        let max_mm = min_mm + 3.0 * 0.010 * feed;
        for again in ["RESUME", "STEP", "RESUME"] {
            let [named, brakes, held] = sees_hold(&mut operator, answer.sequence);
            let line = named.line + 1;
            assert_eq!((brakes.line, held.line), (line, line), "{named:?}");
            let begin = 20.0 * f64::from(line - 2);
            assert!(brakes.position[0] >= begin, "{brakes:?}");
            let distance = held.position[0] - brakes.position[0];
            // The first setpoint that brakes has already made one step of the stop.
            assert!(
                (0.85 * min_mm..max_mm).contains(&distance),
                "{distance}, not {min_mm} to {max_mm}"
            );
            let status = operator.now();
            assert_eq!((status.line, status.state, status.switches & 9), (line, 3, 9));
            assert_eq!(status.position_machine, held.position);
            assert_eq!(status.distance_to_go[0], begin + 20.0 - held.position[0]);
            last_position = held.position;
            answer = operator.says(again);
        }
        // At a program stop the next line is the one that begins there.
        let stop = loop {
            let at = operator.waits("the next hold or stop", |status| {
                (status.state == 3 || status.state == 7) && status.position_machine != last_position
            });
            if at.state == 7 {
                break at;
            }
            last_position = at.position_machine;
            operator.says("RESUME");
        };
        assert_eq!((stop.line, stop.position_machine[0]), (10, 160.0));
        let answer = operator.says("STEP");
        let [_, _, held] = sees_hold(&mut operator, answer.sequence);
        assert_eq!((held.line, held.position[2]), (12, 1.0), "{held:?}");
        operator.says_number("SINGLE_STEP", 0);
        operator.says("RESUME");
        let done = operator.sees_end(job);
        assert_eq!((done.job_result, done.position_machine[0]), (DONE, 200.0));
        drop(operator);
        scene.end();
    });
}

#[test]
fn a_step_from_a_stop_drives_one_whole_line() {
    unless_disturbed(|| {
        let scene = Scene::new("op-steps");
        let mut operator = scene.operator();
        let program = (scene.workshop).write("steps.ngc", "G21 G90 F3000\nG1 X5\nG1 Y5\nG1 X0\nG1 Y0\nM2\n");
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let job = operator.says("STEP").job;
        for position in [[5.0, 0.0], [5.0, 5.0], [0.0, 5.0]] {
            let at = operator.waits("a stop", |status| {
                status.state == 7 && status.position_machine[..2] == position
            });
            assert_eq!(at.switches & 9, 1, "held as well");
            operator.says("STEP");
        }
        let done = operator.sees_end(job);
        assert_eq!(
            (done.job_result, done.position_machine[..2].to_vec()),
            (DONE, vec![0.0, 0.0])
        );
        drop(operator);
        scene.end();
    });
}

#[test]
fn the_rapid_override_slows_rapids_only() {
    unless_disturbed(|| {
        let scene = Scene::new("op-rapid");
        let mut operator = scene.operator();
        operator.brings_up();
        let top = |operator: &mut Operator, block: &str| {
            operator.says_number("MODE", 2);
            let job = operator.says_text("MDI", block).job;
            let mut top: f64 = 0.0;
            let moved = Cell::new(false);
            operator.follows(
                |setpoint| {
                    top = top.max(speed(setpoint));
                    moved.set(moved.get() || setpoint.state == 1);
                },
                |setpoint| setpoint.state == 9 && moved.get(),
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
    });
}

/// A dwell of known length, held for a while; then stopped, loaded again, and MDI.
#[test]
fn parts_and_the_time_of_the_program_are_counted() {
    unless_disturbed(|| {
        let scene = Scene::new("parts");
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 0);
        let program = scene
            .workshop
            .write("dwell.ngc", "G21 G94 F600\nG4 P1\nG1 X3\nM2\n");
        let loads = |operator: &mut Operator| {
            operator.says_text("LOAD", &program.display().to_string());
        };
        loads(&mut operator);
        for parts in 1..=2 {
            let job = operator.says("START").job;
            assert_eq!(operator.sees_end(job).job_result, DONE);
            let status = operator.now();
            assert_eq!(status.parts, parts);
            // A dwell of 1 s, and 3 mm at 10 mm/s the first time.
            let wanted = if parts == 1 { 1.3 } else { 1.0 };
            assert!(
                status.program_time_s > wanted && status.program_time_s < wanted + 0.6,
                "{}",
                status.program_time_s
            );
            assert_eq!(status.program_held_s, 0.0);
        }
        // A part that is held and then stopped is not counted.
        operator.says_number("MODE", 2);
        let mdi = operator.says_text("MDI", "G0 X0").job;
        assert_eq!(operator.sees_end(mdi).job_result, DONE);
        assert_eq!(operator.now().parts, 2);
        operator.says_number("MODE", 0);
        let job = operator.says("START").job;
        operator.waits("motion", |status| status.position_machine[0] > 0.5);
        operator.says("HOLD");
        std::thread::sleep(Duration::from_millis(700));
        operator.says("STOP");
        assert_eq!(operator.sees_end(job).job_result, STOPPED);
        let status = operator.now();
        assert_eq!(status.parts, 2);
        assert!(
            status.program_held_s > 0.5 && status.program_held_s < 1.2,
            "{}",
            status.program_held_s
        );
        assert!(
            status.program_time_s > 1.5 && status.program_time_s < 3.0,
            "{}",
            status.program_time_s
        );
        loads(&mut operator);
        assert_eq!(operator.now().parts, 0);
    });
}
