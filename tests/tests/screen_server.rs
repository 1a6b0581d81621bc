//! The server of the screen and the machine behind it, tested by foreign clients.
#![expect(
    clippy::print_stdout,
    clippy::expect_used,
    reason = "helpers of tests fail and talk as tests do"
)]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use evolvent_runtime::MonotonicClock;
use evolvent_tests::job_result::STOPPED;
use evolvent_tests::{Operator, Scene, cycles, python, unless_disturbed, watched};
use rustix::process::{Pid, Signal, kill_process};

/// Number of undisturbed trials, each of which must stop in time; `EVOLVENT_JOGS` sets more.
const COUNTED: usize = 5;
/// Number of attempts at a jog that a slow host may end early or delay.
const TRIALS: usize = 20;
/// A trial during which the host suspended this process or the core for longer is not counted: that explains
/// a stop later than 100 ms with a timeout of 90 ms.
const PAUSE: Duration = Duration::from_millis(10);

/// The loss of a jog's client.
#[derive(Clone, Copy, Debug)]
enum Loss {
    /// The process is killed; its system closes the connection.
    Killed,
    /// The process is suspended; its connection stays open.
    Frozen,
    /// The connection is reset.
    Cut,
}

fn scene(name: &str) -> (Scene, [String; 2]) {
    scene_with(name, &["--screen=127.0.0.1:0"])
}

fn scene_with(name: &str, options: &[&str]) -> (Scene, [String; 2]) {
    let mut scene = Scene::with(name, options);
    let addresses = scene.served.as_mut().expect("a core").screen();
    (scene, addresses)
}

/// Whether a script of the suite ran; it prints "ok" at its end.
fn client(words: &[&str]) -> Option<String> {
    let mut command = python("screen_client.py")?;
    let output = command.args(words).output().expect("Python to start");
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let faults = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{printed}\n{faults}");
    println!("{printed}");
    Some(printed)
}

#[test]
fn a_jog_of_a_lost_page_stops_within_100_ms() {
    let wanted = std::env::var("EVOLVENT_JOGS").ok();
    let wanted = wanted.map_or(COUNTED, |text| text.parse().expect("a number"));
    let (scene, [address, _]) = scene("screen-jog");
    let mut operator = scene.operator();
    operator.brings_up();
    for loss in [Loss::Killed, Loss::Frozen, Loss::Cut] {
        let (mut stops, mut others, mut early) = (Vec::new(), Vec::new(), 0);
        for _ in 0..TRIALS.max(3 * wanted) {
            let Some(client) = jogger(&address) else { return };
            let (found, beside) = watched(|| stop_behind(&mut operator, client, loss));
            let Some((begins_ms, pause)) = found else {
                early += 1;
                continue;
            };
            let list = if pause.max(beside) < PAUSE {
                &mut stops
            } else {
                &mut others
            };
            list.push(begins_ms);
            if stops.len() == wanted {
                break;
            }
        }
        println!(
            "{loss:?}: counted {stops:.1?} ms; kept waiting by the host {others:.1?} ms; {early} ended early"
        );
        let max_ms = 100.0 + 5.0 * operator.now().period_ns as f64 * 1e-6;
        let late: Vec<f64> = stops
            .iter()
            .copied()
            .filter(|&begins_ms| begins_ms > max_ms)
            .collect();
        assert!(
            late.is_empty(),
            "{loss:?}: the host let it run, and it braked {late:?} ms after"
        );
        if stops.len() < wanted {
            println!(
                "not measured: this host let {} of {wanted} trials run",
                stops.len()
            );
        }
    }
    drop(operator);
    scene.end();
}

/// A page that jogs; `None` without Python.
fn jogger(address: &str) -> Option<Child> {
    let mut command = python("screen_client.py")?;
    let started = command
        .args(["jog", address])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn();
    Some(started.expect("Python to start"))
}

/// ms from the loss of a jog's page to the first setpoint that brakes, and the maximum lateness of the
/// setpoints meanwhile. `None` if the jog had ended before.
fn stop_behind(operator: &mut Operator, mut client: Child, loss: Loss) -> Option<(f64, Duration)> {
    let mut lines = BufReader::new(client.stdout.take().expect("its output")).lines();
    let began = lines
        .next()
        .is_some_and(|line| line.is_ok_and(|line| line == "jogging"));
    // Longer than the dead-man timeout: the jog is renewed.
    std::thread::sleep(Duration::from_millis(400));
    let is_moving = operator.now().velocity[0] > 19.0;
    while operator.setpoints.receive().expect("setpoints").is_some() {}
    let lost_ns = MonotonicClock::now_ns();
    let process = Pid::from_raw(client.id().cast_signed()).expect("a process");
    match loss {
        Loss::Killed => client.kill().expect("killed"),
        Loss::Frozen => kill_process(process, Signal::STOP).expect("frozen"),
        Loss::Cut => writeln!(client.stdin.as_ref().expect("its input"), "cut").expect("told"),
    }
    let slower = (began && is_moving).then(|| {
        let (mut top, mut latest_ns): (f64, u64) = (0.0, 0);
        let slower = operator.follows(
            |setpoint| {
                top = top.max(setpoint.velocity[0]);
                latest_ns = latest_ns.max(MonotonicClock::now_ns().saturating_sub(setpoint.due_time_ns));
            },
            |setpoint| setpoint.state != 1,
        );
        (slower, top, Duration::from_nanos(latest_ns))
    });
    let _gone = client.kill();
    client.wait().expect("a process that ends");
    let status = operator.waits("rest", |status| status.activity == 0);
    assert_eq!(status.velocity[0], 0.0);
    // Back, so that the travel suffices for many trials.
    operator.says_number("MODE", 2);
    let job = operator.says_text("MDI", "G53 G0 X0").job;
    operator.sees_end(job);
    let (slower, top, latest) = slower?;
    assert!(top < 20.01, "{top}");
    // A jog that was no longer at its full speed had ended because a message of its page came too late.
    if slower.state != 4 || slower.due_time_ns < lost_ns || top < 19.99 {
        return None;
    }
    assert_eq!(status.job_result, STOPPED);
    let begins_ms = (slower.due_time_ns - lost_ns) as f64 * 1e-6;
    Some((begins_ms, latest))
}

/// The server opens its connections to the core before anyone presses a button: a jog that waits 250 ms for
/// one is rejected.
#[test]
fn the_first_jog_and_emergency_stop_are_accepted() {
    unless_disturbed(|| {
        let (scene, [address, _]) = scene("screen-first");
        let mut operator = scene.operator();
        operator.brings_up();
        let _printed = client(&["first", &address]);
        drop(operator);
        scene.end();
    });
}

#[test]
fn leases_roles_origins_and_uploads_follow_the_rules() {
    // A command that reaches the server late is rejected, as it must be.
    unless_disturbed(|| {
        let options = ["--screen=127.0.0.1:0", "--trace-limit=1"];
        let (scene, [address, watch]) = scene_with("screen-rules", &options);
        let _printed = client(&["rules", &address, &watch]);
        scene.end();
    });
}

#[test]
fn a_flooding_client_is_disconnected() {
    unless_disturbed(|| {
        let (scene, [address, _]) = scene("screen-limits");
        let _printed = client(&["limits", &address]);
        scene.end();
    });
}

/// Given with its key, a certificate encrypts the page on loopback, too.
#[test]
fn a_page_has_the_certificate_that_it_is_given() {
    unless_disturbed(|| {
        let folder = tempfile::tempdir().expect("a folder");
        let file = |name: &str| folder.path().join(name).display().to_string();
        let (certificate, key) = (file("own.pem"), file("own-key.pem"));
        let made = Command::new("openssl")
            .args(
                "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=own"
                    .split(' '),
            )
            .args([
                "-addext",
                "subjectAltName=IP:127.0.0.1",
                "-out",
                &certificate,
                "-keyout",
                &key,
            ])
            .output();
        if !made.is_ok_and(|made| made.status.success()) {
            println!("not measured: no OpenSSL");
            return;
        }
        let options = [
            "--screen=127.0.0.1:0".to_owned(),
            format!("--screen-certificate={certificate}"),
            format!("--screen-key={key}"),
        ];
        let options: Vec<&str> = options.iter().map(String::as_str).collect();
        let (scene, [address, _]) = scene_with("screen-certificate", &options);
        let _printed = client(&["certificate", &address, &certificate]);
        scene.end();
    });
}

/// The machine stays in emergency stop: no message may be taken for a command that moves.
#[test]
fn ten_thousand_mutated_messages_do_no_harm() {
    let (scene, [address, _]) = scene("screen-hostile");
    let served = scene.served.as_ref().expect("a core").process();
    // One-time allocations have been made.
    let warm = client(&["hostile", &address, "2000", "1"]);
    let before = resident_kib(served);
    if warm.is_none() || client(&["hostile", &address, "10000", "7"]).is_none() {
        return;
    }
    let grown = resident_kib(served).saturating_sub(before);
    println!("resident memory grew by {grown} KiB in 10000 messages");
    assert!(grown < 8 << 10, "{grown} KiB");
    let mut operator = scene.operator();
    let status = operator.now();
    assert_eq!((status.machine_state, status.job), (0, 0));
    drop(operator);
    scene.end();
}

fn resident_kib(process: u32) -> u64 {
    let text = std::fs::read_to_string(format!("/proc/{process}/status")).expect("a process");
    let line = text
        .lines()
        .find(|line| line.starts_with("VmRSS:"))
        .expect("its memory");
    line.split_whitespace()
        .nth(1)
        .and_then(|word| word.parse().ok())
        .expect("a number")
}

#[test]
fn twenty_viewers_do_not_delay_each_other() {
    unless_disturbed(|| {
        let (scene, [address, _]) = scene("screen-crowd");
        let mut operator = scene.operator();
        operator.brings_up();
        let program = std::fs::read_to_string(scene.workshop.long_program(60)).expect("a program");
        let Some(printed) = client(&["crowd", &address, &program, "20", "8"]) else {
            return;
        };
        let found: serde_json::Value = serde_json::from_str(&printed).expect("JSON");
        let status = operator.now();
        println!(
            "late cycles {}, latest wake-up {} ns",
            status.late_cycles, status.wake_lateness_max_ns
        );
        assert_eq!(status.activity, 1, "the program runs");
        // 60 per second if the host has the time; a tenth of it shows that no page waits for another.
        assert!(found["least_frames"].as_u64() > Some(48), "{printed}");
        operator.says("STOP");
        operator.waits("rest", |status| status.activity == 0);
        drop(operator);
        scene.end();
    });
}

/// Number of pairs of phases without and with twenty pages, and the length of each, s; `EVOLVENT_PHASES=20
/// EVOLVENT_PHASE_S=20` measures more.
const PHASES: usize = 2;
const PHASE_S: u64 = 4;

/// The clock of traces.
fn unix_ns() -> u64 {
    let time = SystemTime::now().duration_since(UNIX_EPOCH);
    time.expect("a time after 1970").as_nanos() as u64
}

fn number_of(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).map_or(otherwise, |text| text.parse().expect("a number"))
}

/// Both run the same program, alternately and in one run of the service, so that the host affects both alike.
#[test]
fn cycles_are_as_late_with_twenty_pages_as_with_none() {
    unless_disturbed(|| {
        let folder = tempfile::tempdir().expect("a folder");
        let trace = folder.path().join("crowd.mcap");
        let option = format!("--trace={}", trace.display());
        let (scene, [address, _]) = scene_with("screen-lateness", &["--screen=127.0.0.1:0", &option]);
        let mut operator = scene.operator();
        operator.brings_up();
        let file = scene.workshop.long_program(60);
        let text = std::fs::read_to_string(&file).expect("a program");
        let phase_s = number_of("EVOLVENT_PHASE_S", PHASE_S);
        let mut phases = Vec::new();
        for phase in 0..2 * number_of("EVOLVENT_PHASES", PHASES as u64) {
            let crowded = phase % 2 == 1;
            operator.says_number("MODE", 0);
            if crowded {
                let words = ["crowd", &address, &text, "20", &phase_s.to_string()];
                if client(&words).is_none() {
                    return;
                }
            } else {
                operator.says_text("LOAD", &file.display().to_string());
                operator.says("START");
                std::thread::sleep(Duration::from_secs(phase_s));
            }
            // The last part of both, in which the program runs and all are connected.
            let end_ns = unix_ns();
            phases.push((crowded, end_ns - phase_s * 800_000_000, end_ns));
            operator.says("STOP");
            operator.waits("rest", |status| status.activity == 0);
        }
        drop(operator);
        scene.end();
        let [mut without, mut with] = [Vec::new(), Vec::new()];
        for cycle in cycles(&trace) {
            let of_phase = phases
                .iter()
                .find(|(_, begin, end)| (*begin..*end).contains(&cycle.due_time_ns));
            if let Some((crowded, ..)) = of_phase {
                let list = if *crowded { &mut with } else { &mut without };
                list.push(cycle.wake_lateness_ns.max(0) as f64 * 1e-3);
            }
        }
        let [without, with] = [without, with].map(|mut list| {
            list.sort_by(f64::total_cmp);
            [0.5, 0.99, 0.999].map(|part| list[((list.len() - 1) as f64 * part) as usize])
        });
        let ratio = [0, 1, 2].map(|i| with[i] / without[i]);
        println!(
            "wake-up lateness p50, p99, p99.9 in us: none {without:.1?}, twenty {with:.1?}, ratio {ratio:.2?}"
        );
        assert!(ratio[0] < 2.0, "{ratio:?}");
    });
}

/// One address gets 192 of the 256 connections. Further ones are closed at once, and those that end can be
/// used again.
#[test]
fn one_address_gets_three_quarters_of_the_connections() {
    unless_disturbed(|| {
        let (scene, [address, _]) = scene("screen-slots");
        let host = address.trim_start_matches("http://");
        let host = &host[..host.find('/').expect("a path")];
        let open = || {
            let stream = TcpStream::connect(host).expect("a connection");
            let timeout = Some(Duration::from_millis(500));
            stream.set_read_timeout(timeout).expect("a timeout");
            stream
        };
        // A connection that stays open sends nothing until the timeout.
        let is_open = |mut stream: &TcpStream| {
            let ended = stream.read(&mut [0]);
            ended.is_err_and(|error| error.kind() == std::io::ErrorKind::WouldBlock)
        };
        let held: Vec<TcpStream> = (0..192).map(|_| open()).collect();
        assert!(!is_open(&open()), "one too many");
        assert!(is_open(&held[191]), "the last one");
        drop(held);
        let request = format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n");
        let is_answered = || {
            let mut stream = open();
            stream.write_all(request.as_bytes()).is_ok() && stream.read(&mut [0]).is_ok_and(|read| read > 0)
        };
        let begin = Instant::now();
        while !is_answered() {
            assert!(
                begin.elapsed() < Duration::from_secs(10),
                "connections stay taken"
            );
        }
        scene.end();
    });
}
