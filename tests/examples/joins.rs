//! Measures the cost of joining, leaving and killed subscribers for a machine that is served at 10 kHz.
//!
//! `cargo run --release -p evolvent-tests --example joins [JOINS]`: alternates, in one run and for equal
//! times, between phases without and with subscribers that join and leave, one in ten of them killed. Prints
//! the work of the cycle in each phase, from the trace, and the losses of a steady reader. Only phases of one
//! run can be compared: the load of a shared host changes from minute to minute, and a longer measurement has
//! a larger maximum.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a measurement that cannot be made says why, and prints what it finds"
)]

use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use evolvent_bus::{ClientBus, ClientConfig};
use evolvent_tests::{Domain, Operator, Served, Workshop};

const NAME: &str = "joins";
/// Number of phases with joins and of phases without.
const TURNS: u32 = 4;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if let [_, role, prefix] = arguments.as_slice()
        && role == "victim"
    {
        let _reader = join(prefix).setpoints().expect("setpoints");
        println!("joined");
        std::thread::sleep(Duration::from_secs(60));
        return;
    }
    let joins: u32 = arguments
        .get(1)
        .map_or(1000, |text| text.parse().expect("a number"));
    measure(joins);
}

fn join(prefix: &str) -> ClientBus {
    let config = ClientConfig {
        prefix: Some(prefix.to_owned()),
        wait: Duration::from_secs(20),
        ..ClientConfig::new(NAME)
    };
    ClientBus::open(&config).expect("a core")
}

/// Setpoints of one phase of the run.
struct Part {
    what: &'static str,
    from: u64,
    to: u64,
}

fn measure(joins: u32) {
    let (workshop, domain) = (Workshop::new(), Domain::new());
    let columns = [("[trace]", "[trace]\ncycles = \"columns\"")];
    let machine = workshop.mill(NAME, &columns);
    let trace = workshop.path("joins.mcap");
    let options = ["--rate", "10000", "--trace", trace.to_str().expect("UTF-8")];
    let served = Served::start(&machine, NAME, &domain, &workshop.path("state"), &options);
    let stop = Arc::new(AtomicBool::new(false));
    let counts = Arc::new((AtomicU64::new(0), AtomicU64::new(0)));
    let steady = {
        let (prefix, stop, counts) = (domain.prefix.clone(), Arc::clone(&stop), Arc::clone(&counts));
        std::thread::spawn(move || {
            let bus = join(&prefix);
            let mut reader = bus.setpoints().expect("setpoints");
            while !stop.load(Ordering::Relaxed) {
                while reader.receive().expect("setpoints").is_some() {
                    counts.0.fetch_add(1, Ordering::Relaxed);
                }
                counts.1.store(reader.lost(), Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(2));
            }
        })
    };
    let mut operator = Operator::join(NAME, &domain);
    operator.waits("cycles", |status| status.cycles > 1000);
    let mut parts = Vec::new();
    for _ in 0..TURNS {
        let from = operator.now().cycles;
        let begin = Instant::now();
        come_and_go(&domain, joins / TURNS);
        let middle = operator.now().cycles;
        std::thread::sleep(begin.elapsed());
        let to = operator.now().cycles;
        for (what, from, to) in [("with joins", from, middle), ("without", middle, to)] {
            parts.push(Part { what, from, to });
        }
    }
    stop.store(true, Ordering::Relaxed);
    steady.join().expect("the steady reader");
    let status = operator.now();
    drop(operator);
    let _finished = served.end();
    let mut file = evolvent_trace::TraceFile::open(&trace).expect("a complete trace");
    let mut work: Vec<Vec<u32>> = parts.iter().map(|_| Vec::new()).collect();
    for cycle in file.cycles() {
        let cycle = cycle.expect("a readable cycle");
        let part = parts
            .iter()
            .position(|part| (part.from..part.to).contains(&cycle.sequence));
        if let Some(part) = part {
            work[part].push(cycle.work_ns);
        }
    }
    println!("own work of the cycle, us     p50    p99.9   p99.99   the five largest");
    for (part, mut work) in parts.iter().zip(work) {
        work.sort_unstable();
        let us = |index: usize| f64::from(work[index.min(work.len() - 1)]) * 1e-3;
        let quantile = |share: f64| us((work.len() as f64 * share) as usize);
        let most: Vec<String> = (1..=5).map(|k| format!("{:.0}", us(work.len() - k))).collect();
        println!(
            "{:<12} {:>9} cycles {:>7.1} {:>7.1} {:>8.1}   {}",
            part.what,
            work.len(),
            quantile(0.5),
            quantile(0.999),
            quantile(0.9999),
            most.join(" ")
        );
    }
    println!(
        "{joins} joins; steady reader: {} read, {} lost; late setpoints {}, lost records {}",
        counts.0.load(Ordering::Relaxed),
        counts.1.load(Ordering::Relaxed),
        status.late_cycles,
        status.dropped_records
    );
}

fn come_and_go(domain: &Domain, joins: u32) {
    for k in 0..joins {
        if k % 10 == 9 {
            let mut victim = Command::new(std::env::current_exe().expect("this program"))
                .args(["victim", &domain.prefix])
                .stdout(Stdio::piped())
                .spawn()
                .expect("a victim");
            // Some before they have joined, some after.
            std::thread::sleep(Duration::from_millis(5 + u64::from(k % 7) * 10));
            victim.kill().expect("killed");
            victim.wait().expect("a process that ends");
        } else {
            let bus = join(&domain.prefix);
            let mut reader = bus.setpoints().expect("setpoints");
            let _some = reader.receive().expect("setpoints");
        }
    }
}
