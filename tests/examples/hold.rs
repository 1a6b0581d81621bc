//! How soon a hold takes effect: cycles from the newest setpoint that was computed when the control thread judged the
//! command, to the first that is slower.
//!
//! `cargo run --release -p evolvent-tests --example hold [HOLDS]`
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a measurement that cannot be made says why, and prints what it finds"
)]

use evolvent_tests::{Domain, Operator, Served, Workshop};

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
    let mut cycles = Vec::new();
    let mut rest_ms = Vec::new();
    let mut period_ns = 0;
    while cycles.len() < holds as usize {
        let status = operator.waits("full speed", |status| status.feed_mm_s > 99.0);
        // Away from the ends of the lines, where it is slower by itself.
        if status.distance_to_go[0].abs() < 40.0 {
            continue;
        }
        while operator.setpoints.receive().expect("setpoints").is_some() {}
        let answer = operator.says("HOLD");
        let (mut slower, mut rest) = (None, None);
        while rest.is_none() {
            let Some(setpoint) = operator.setpoints.receive().expect("setpoints") else {
                std::thread::sleep(std::time::Duration::from_micros(500));
                continue;
            };
            period_ns = setpoint.period_ns;
            let after = setpoint.sequence.saturating_sub(answer.sequence);
            if setpoint.feed_mm_s < status.feed_mm_s * (1.0 - 1e-4) && setpoint.sequence > answer.sequence {
                slower.get_or_insert(after);
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
    rest_ms.sort_by(f64::total_cmp);
    let (p50, p90) = (cycles.len() / 2, cycles.len() * 9 / 10);
    println!(
        "{} holds at {:.1} Hz, lead 2: first slower setpoint after {} cycles at best, {} in the middle, {} at 90 %, {} at worst; \
         at rest after {:.0} ms in the middle, {:.0} ms at worst",
        cycles.len(),
        1e9 / period_ns as f64,
        cycles[0],
        cycles[p50],
        cycles[p90],
        cycles[cycles.len() - 1],
        rest_ms[p50],
        rest_ms[rest_ms.len() - 1]
    );
    operator.says("STOP");
    drop(operator);
    let _finished = served.end();
}
