//! Measures how soon a hold takes effect, at random moments of a program: periods from sending the command to
//! the due time of the first slower setpoint (its computation in time, plus the lead), and setpoints from the
//! newest one computed when the command was authorized. If permitted, the client is a real-time thread of low
//! priority, because the core is to be measured.
//!
//! `cargo run --release -p evolvent-tests --example hold [HOLDS]`
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a measurement that cannot be made says why, and prints what it finds"
)]

use std::time::Duration;

use evolvent_runtime::{MonotonicClock, RealtimeRequest, apply_to_this_thread};
use evolvent_tests::{Domain, Operator, Random, Served, Workshop};

fn main() {
    let holds: u32 = std::env::args()
        .nth(1)
        .map_or(50, |text| text.parse().expect("a number"));
    let (workshop, domain) = (Workshop::new(), Domain::new());
    let machine = workshop.mill("holds", &[]);
    let served = Served::start(&machine, "holds", &domain, &workshop.path("state"), &[]);
    let mut operator = Operator::join("holds", &domain);
    let program = workshop.long_program(600);
    operator.brings_up();
    operator.says_number("MODE", 0);
    operator.says_text("LOAD", program.to_str().expect("UTF-8"));
    operator.says("START");
    // Only now: processes that were started before keep their own scheduling class.
    let request = RealtimeRequest {
        priority: Some(2),
        ..RealtimeRequest::default()
    };
    for note in apply_to_this_thread(&request).notes {
        println!("{note}");
    }
    let mut random = Random::new();
    let (mut cycles, mut periods, mut rest_ms) = (Vec::new(), Vec::new(), Vec::new());
    let mut period_ns = 0;
    while cycles.len() < holds as usize {
        let status = operator.waits("full speed", |status| status.feed_mm_s > 99.0);
        std::thread::sleep(Duration::from_micros(random.below(200_000) as u64));
        // Away from the ends of the lines, where the program itself slows down.
        let status_now = operator.now();
        if status_now.distance_to_go[0].abs() < 40.0 || status_now.feed_mm_s < 99.0 {
            continue;
        }
        while operator.setpoints.receive().expect("setpoints").is_some() {}
        let sent_ns = MonotonicClock::now_ns();
        let answer = operator.says("HOLD");
        let (mut slower, mut rest) = (None, None);
        while rest.is_none() {
            let Some(setpoint) = operator.setpoints.receive().expect("setpoints") else {
                std::thread::sleep(Duration::from_micros(500));
                continue;
            };
            period_ns = setpoint.period_ns;
            let after = setpoint.sequence.saturating_sub(answer.sequence);
            if setpoint.feed_mm_s < status.feed_mm_s * (1.0 - 1e-4)
                && setpoint.sequence > answer.sequence
                && slower.is_none()
            {
                slower = Some(after);
                periods.push(setpoint.due_time_ns.saturating_sub(sent_ns) as f64 / period_ns as f64);
            }
            if setpoint.state == 3 {
                rest = Some(after);
            }
        }
        cycles.push(slower.expect("a slower setpoint"));
        rest_ms.push(rest.unwrap_or(0) as f64 * period_ns as f64 * 1e-6);
        operator.says("RESUME");
    }
    cycles.sort_unstable();
    periods.sort_by(f64::total_cmp);
    rest_ms.sort_by(f64::total_cmp);
    let (p50, p90, p99) = (cycles.len() / 2, cycles.len() * 9 / 10, cycles.len() * 99 / 100);
    let last = cycles.len() - 1;
    println!(
        "{} holds at {:.1} Hz, lead 2",
        cycles.len(),
        1e9 / period_ns as f64
    );
    println!(
        "from the command's leaving to the first slower setpoint's due time: {:.1} periods in the middle, \
         {:.1} at 90 %, {:.1} at 99 %, {:.1} at worst; within 4: {}",
        periods[p50],
        periods[p90],
        periods[p99],
        periods[last],
        periods.iter().filter(|&&periods| periods <= 4.0).count()
    );
    println!(
        "from the newest setpoint when it was judged to the first slower one: {} at best, {} in the middle, \
         {} at 90 %, {} at 99 %, {} at worst",
        cycles[0], cycles[p50], cycles[p90], cycles[p99], cycles[last]
    );
    println!(
        "at rest after {:.0} ms in the middle, {:.0} ms at worst",
        rest_ms[p50], rest_ms[last]
    );
    operator.says("STOP");
    drop(operator);
    let _finished = served.end();
}
