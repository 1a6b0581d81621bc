//! A core that publishes made-up setpoints at a rate, for trying clients.
//!
//!     cargo run -p evolvent-bus --example publish -- NAME RATE_HZ COUNT [PREFIX]
//!
//! Waits up to 10 s for one subscriber, then sends COUNT setpoints, the last one flagged. Setpoint `n` has
//! the position `n + axis / 16` on every axis, so that a reader can check each number.

use evolvent_bus::{BusConfig, CoreBus, EventKind, Setpoint, Status, flags};
use std::error::Error;
use std::time::{Duration, Instant};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [name, rate_hz, count, rest @ ..] = arguments.as_slice() else {
        return Err("usage: publish NAME RATE_HZ COUNT [PREFIX]".into());
    };
    let (rate_hz, count): (u64, u64) = (rate_hz.parse()?, count.parse()?);
    let period_ns = 1_000_000_000u64
        .checked_div(rate_hz)
        .ok_or("a rate of 0 Hz has no period")?;
    let mut config = BusConfig::new(name, "XYZ", period_ns);
    config.prefix = rest.first().cloned();
    let mut core = CoreBus::open(&config)?;
    if core.wait_for_setpoint_subscribers(1, Duration::from_secs(10)) == 0 {
        return Err("no subscriber within 10 s".into());
    }
    core.notify(EventKind::Started)?;
    let begin = Instant::now();
    for sequence in 0..count {
        let due = Duration::from_nanos(sequence * period_ns);
        while let Some(rest) = due.checked_sub(begin.elapsed()) {
            std::thread::sleep(rest);
        }
        core.publish_setpoint(&Setpoint {
            sequence,
            due_time_ns: sequence * period_ns,
            period_ns,
            position: core::array::from_fn(|axis| sequence as f64 + axis as f64 / 16.0),
            flags: if sequence + 1 == count { flags::LAST } else { 0 },
            ..Setpoint::default()
        })?;
        if sequence % rate_hz.div_ceil(10) == 0 {
            core.publish_status(&Status {
                sequence,
                cycles: sequence,
                ..Status::default()
            })?;
        }
    }
    core.notify(EventKind::Done)?;
    // Samples live in the publisher's memory: give readers time to take the last ones.
    std::thread::sleep(Duration::from_secs(1));
    Ok(())
}
