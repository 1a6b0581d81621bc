//! What joining, leaving and dying subscribers cost a machine that is served at 10 kHz.
//!
//! `cargo run --release -p evolvent-tests --example joins [JOINS]`: first so many seconds without, then with subscribers that join
//! and leave, one in ten of them killed. Prints the cycle's own work in both, and what a steady reader lost.
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
    let quiet = measure(None);
    let busy = measure(Some(joins));
    println!("                       p50        p99.9      max        steady reader");
    for (what, seen) in [("without", quiet), ("with joins", busy)] {
        println!(
            "own work, {what:<10} {:>7.1} us {:>7.1} us {:>7.1} us   {} read, {} lost",
            seen.work[0] as f64 * 1e-3,
            seen.work[1] as f64 * 1e-3,
            seen.work[2] as f64 * 1e-3,
            seen.read,
            seen.lost
        );
    }
}

fn join(prefix: &str) -> ClientBus {
    let config = ClientConfig {
        prefix: Some(prefix.to_owned()),
        wait: Duration::from_secs(20),
        ..ClientConfig::new(NAME)
    };
    ClientBus::open(&config).expect("a core")
}

struct Seen {
    work: [u64; 3],
    read: u64,
    lost: u64,
}

fn measure(joins: Option<u32>) -> Seen {
    let (workshop, domain) = (Workshop::new(), Domain::new());
    let machine = workshop.mill(NAME, &[]);
    let served = Served::start(
        &machine,
        NAME,
        &domain,
        &workshop.path("state"),
        &["--rate", "10000"],
    );
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
    let begin = Instant::now();
    for k in 0..joins.unwrap_or(0) {
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
    if joins.is_none() {
        std::thread::sleep(Duration::from_secs(20));
    }
    let status = operator.now();
    println!(
        "{:.1} s, {} setpoints",
        begin.elapsed().as_secs_f64(),
        status.cycles
    );
    stop.store(true, Ordering::Relaxed);
    steady.join().expect("the steady reader");
    drop(operator);
    let _finished = served.end();
    Seen {
        work: [status.work_p50_ns, status.work_p999_ns, status.work_max_ns],
        read: counts.0.load(Ordering::Relaxed),
        lost: counts.1.load(Ordering::Relaxed),
    }
}
