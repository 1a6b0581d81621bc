//! Operates a machine for a long time: the core at 1 kHz with a trace, simulated drives, and three clients:
//! one reads every setpoint, one polls the status, one sends commands (programs, overrides, holds, jogs,
//! MDI).
//!
//! `cargo run --release -p evolvent-tests --example soak [MINUTES [no-trace]]`: reads the memory of each
//! process every ten seconds. At the end it prints the losses, and the growth of the maximum of each minute
//! after the first third: the memory of a job is temporary.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a measurement that cannot be made says why, and prints what it finds"
)]

use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use evolvent_bus::{ClientBus, ClientConfig, ControlRequest};
use evolvent_tests::{Domain, Operator, Random, Workshop, command, evolvent};

const NAME: &str = "soak";
const LOOK_EVERY: Duration = Duration::from_secs(10);

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    match arguments.as_slice() {
        [_, role, prefix] if role == "reader" => read_setpoints(prefix),
        [_, role, prefix] if role == "poller" => poll_status(prefix),
        [_, role, prefix, program] if role == "commander" => operate(prefix, Path::new(program)),
        [_, minutes] => soak(minutes.parse().expect("minutes"), true),
        [_, minutes, word] if word == "no-trace" => soak(minutes.parse().expect("minutes"), false),
        _ => soak(30.0, true),
    }
}

/// Whether the parent wants this process to end: it closes our standard input.
fn over() -> Arc<AtomicBool> {
    let over = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&over);
    std::thread::spawn(move || {
        let _end = std::io::stdin().read_to_end(&mut Vec::new());
        told.store(true, Ordering::Relaxed);
    });
    over
}

fn join(prefix: &str) -> ClientBus {
    let config = ClientConfig {
        prefix: Some(prefix.to_owned()),
        wait: Duration::from_secs(20),
        ..ClientConfig::new(NAME)
    };
    ClientBus::open(&config).expect("a core")
}

fn read_setpoints(prefix: &str) {
    let (over, bus) = (over(), join(prefix));
    let mut reader = bus.setpoints().expect("setpoints");
    let (mut read, mut expected, mut gaps) = (0_u64, None, 0_u64);
    while !over.load(Ordering::Relaxed) {
        while let Some(setpoint) = reader.receive().expect("setpoints") {
            read += 1;
            gaps += u64::from(expected.is_some_and(|expected| expected != setpoint.sequence));
            expected = Some(setpoint.sequence + 1);
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    println!("{read} setpoints read, {} lost, {gaps} gaps", reader.lost());
}

fn poll_status(prefix: &str) {
    let (over, bus) = (over(), join(prefix));
    let mut reader = bus.status().expect("the status");
    let (mut read, mut alarms) = (0_u64, 0_u64);
    let mut last = None;
    while !over.load(Ordering::Relaxed) {
        if let Some(status) = reader.latest().expect("the status")
            && last != Some(status.sequence)
        {
            last = Some(status.sequence);
            read += 1;
            alarms += u64::from(status.alarm_count > 0);
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    println!("{read} snapshots read, {alarms} of them with an alarm");
}

fn operate(prefix: &str, program: &Path) {
    let over = over();
    let domain = std::mem::ManuallyDrop::new(Domain {
        prefix: prefix.to_owned(),
    });
    let (mut operator, mut random) = (Operator::join(NAME, &domain), Random::new());
    operator.waits("drives", |status| status.feedback_age_ns < 1_000_000_000);
    let mut tally = Tally::default();
    while !over.load(Ordering::Relaxed) {
        tally.rounds += 1;
        if round(&mut operator, &mut random, program, &over, &mut tally).is_none() {
            tally.interrupted += 1;
            let status = operator.now();
            println!(
                "cut short, alarms {:?} {}",
                status.listed_alarms(),
                status.alarm_sentence()
            );
            operator.waits("rest", |status| status.activity == 0);
            operator.request(&command("CLEAR_ALARMS"));
        }
    }
    println!(
        "{} commands in {} rounds, {} rounds cut short by a refusal or an alarm",
        tally.commands, tally.rounds, tally.interrupted
    );
}

#[derive(Default)]
struct Tally {
    commands: u64,
    rounds: u64,
    interrupted: u64,
}

/// Everything that an operator does; `None` if a command was rejected.
fn round(
    operator: &mut Operator,
    random: &mut Random,
    program: &Path,
    over: &AtomicBool,
    tally: &mut Tally,
) -> Option<()> {
    let amount = |name: &str, amount: f64| ControlRequest {
        amount,
        ..command(name)
    };
    let number = |name: &str, index: u32| ControlRequest {
        index,
        ..command(name)
    };
    let text = |name: &str, text: &str| {
        let mut request = command(name);
        assert!(request.set_text(text), "too long");
        request
    };
    let mut does = |operator: &mut Operator, request: &ControlRequest| {
        tally.commands += 1;
        let answer = operator.request(request);
        (answer.verdict == 0).then_some(answer.job)
    };
    let ends = |operator: &mut Operator, job: u64| {
        let status = operator.waits("the job's end", |status| {
            status.job > job || (status.job == job && status.job_result != 0)
        });
        (status.alarm_count == 0).then_some(())
    };
    let status = operator.now();
    if status.machine_state == 0 {
        does(operator, &command("ESTOP_RESET"))?;
    }
    if status.machine_state < 2 {
        does(operator, &command("ON"))?;
        operator.waits("power", |status| {
            status.machine_state == 2 || status.alarm_count > 0
        });
    }
    // A continuous jog, one by an increment, and a return to the start of programs.
    does(operator, &number("MODE", 1))?;
    let mut jog = amount("JOG", 20.0);
    (jog.axes_mask, jog.values[2]) = (0b100, -1.0);
    let job = does(operator, &jog)?;
    for _ in 0..20 {
        does(operator, &command("JOG_KEEP"))?;
        std::thread::sleep(Duration::from_millis(30));
    }
    does(operator, &command("JOG_STOP"))?;
    ends(operator, job)?;
    (jog.index, jog.axes_mask, jog.values[0]) = (1, 0b001, 5.0);
    let job = does(operator, &jog)?;
    ends(operator, job)?;
    does(operator, &number("MODE", 2))?;
    let job = does(operator, &text("MDI", "G90 G0 X0 Y0 Z0"))?;
    ends(operator, job)?;
    does(operator, &number("MODE", 0))?;
    does(operator, &text("LOAD", program.to_str().expect("UTF-8")))?;
    let job = does(operator, &command("START"))?;
    for _ in 0..10 {
        if over.load(Ordering::Relaxed) {
            break;
        }
        std::thread::sleep(Duration::from_millis(300 + random.below(500) as u64));
        does(
            operator,
            &amount("FEED_OVERRIDE", 0.1 + 0.1 * random.below(15) as f64),
        )?;
        if random.below(3) == 0 {
            does(operator, &command("HOLD"))?;
            operator.waits("the hold", |status| status.state == 3 || status.alarm_count > 0);
            does(operator, &command("RESUME"))?;
        }
    }
    does(operator, &command("STOP"))?;
    ends(operator, job)
}

struct Watched {
    name: &'static str,
    child: Child,
    /// Seconds, resident KiB, and the anonymous part.
    seen: Vec<(f64, [f64; 2])>,
}

impl Watched {
    fn start(name: &'static str, command: &mut Command) -> Self {
        let child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("a process");
        let seen = Vec::new();
        Self { name, child, seen }
    }

    fn role(name: &'static str, arguments: &[&str]) -> Self {
        let mut command = Command::new(std::env::current_exe().expect("this program"));
        Self::start(name, command.arg(name).args(arguments))
    }

    fn look(&mut self, seconds: f64) {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap_or_default();
        let field = |key: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(key))?;
            line.split_whitespace().next()?.parse().ok()
        };
        if let (Some(all), Some(own)) = (field("VmRSS:"), field("RssAnon:")) {
            self.seen.push((seconds, [all, own]));
        }
    }

    /// The maximum of each minute: first and last, and the slope of a straight line through all of them, KiB
    /// and KiB/min.
    fn growth(&self, which: usize, from: f64) -> [f64; 3] {
        let mut points: Vec<(f64, f64)> = Vec::new();
        for (time, values) in self.seen.iter().filter(|(time, _)| *time >= from) {
            let minute = (time / 60.0).floor();
            match points.last_mut() {
                Some((last, highest)) if *last == minute => *highest = highest.max(values[which]),
                _ => points.push((minute, values[which])),
            }
        }
        let n = points.len().max(1) as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / n;
        let (x, y) = (mean(|point| point.0), mean(|point| point.1));
        let above: f64 = points.iter().map(|point| (point.0 - x) * (point.1 - y)).sum();
        let below: f64 = points.iter().map(|point| (point.0 - x).powi(2)).sum();
        let [first, last] = [points.first(), points.last()].map(|point| point.map_or(0.0, |point| point.1));
        [first, last, if below > 0.0 { above / below } else { 0.0 }]
    }

    /// Closes its input and returns its output.
    fn end(mut self, signal: bool) -> String {
        drop(self.child.stdin.take());
        if signal {
            let pid = rustix::process::Pid::from_raw(self.child.id().cast_signed()).expect("a process");
            let _gone = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        }
        let output = self.child.wait_with_output().expect("a process that ends");
        format!(
            "{} ({})",
            String::from_utf8_lossy(&output.stdout).trim(),
            output.status
        )
    }
}

fn soak(minutes: f64, traced: bool) {
    let (workshop, domain) = (Workshop::new(), Domain::new());
    let machine = workshop.mill(
        NAME,
        &[("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 400 ")],
    );
    let program = workshop.long_program(600);
    let trace = workshop.path("soak.mcap");
    let mut command = evolvent();
    command
        .args([
            "serve",
            "--rate",
            "1000",
            "--json",
            "--bus-prefix",
            &domain.prefix,
        ])
        .arg("--machine")
        .arg(&machine)
        .arg("--state")
        .arg(workshop.path("state"));
    if traced {
        command.arg("--trace").arg(&trace);
    }
    let core = Watched::start("core", &mut command);
    let bridge = Watched::start(
        "bridge",
        evolvent()
            .args([
                "bridge",
                "sim",
                "--bridge-cycles",
                "100",
                "--json",
                "--bus-prefix",
                &domain.prefix,
            ])
            .arg("--machine")
            .arg(&machine),
    );
    let reader = Watched::role("reader", &[&domain.prefix]);
    let poller = Watched::role("poller", &[&domain.prefix]);
    let commander = Watched::role("commander", &[&domain.prefix, program.to_str().expect("UTF-8")]);
    let mut all = [core, bridge, reader, poller, commander];
    let begin = Instant::now();
    while begin.elapsed().as_secs_f64() < 60.0 * minutes {
        std::thread::sleep(LOOK_EVERY.min(Duration::from_secs_f64(6.0 * minutes)));
        for watched in &mut all {
            watched.look(begin.elapsed().as_secs_f64());
        }
        if (all.iter_mut()).any(|watched| !matches!(watched.child.try_wait(), Ok(None))) {
            println!("a process has ended by itself");
            break;
        }
    }
    let whole = begin.elapsed().as_secs_f64();
    println!(
        "{:.1} minutes; memory from {:.1} minutes on",
        whole / 60.0,
        whole / 180.0
    );
    println!(
        "process     resident KiB, at first and at last   KiB/min   of these its own, at first, at \
         last   KiB/min"
    );
    for watched in &all {
        let [first, last, slope] = watched.growth(0, whole / 3.0);
        let [own_first, own_last, own_slope] = watched.growth(1, whole / 3.0);
        println!(
            "{:<10} {first:>14.0} {last:>14.0} {slope:>16.1} {own_first:>16.0} {own_last:>14.0} \
             {own_slope:>14.1}",
            watched.name
        );
    }
    let [core, bridge, reader, poller, commander] = all;
    for watched in [commander, poller, reader] {
        let name = watched.name;
        println!("{name}: {}", watched.end(false));
    }
    println!("core: {}", core.end(true));
    println!("bridge: {}", bridge.end(true));
    let size = trace.metadata().map_or(0, |facts| facts.len());
    println!("trace: {:.1} MB", size as f64 * 1e-6);
}
