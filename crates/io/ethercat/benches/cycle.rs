//! The bridge's cycle compared with a bare socket loop on the same ring:
//! `cargo bench -p evolvent-ethercat --bench cycle [-- SECONDS]`.
//!
//! Needs the right to create a network namespace. Times depend on the host and its present load; compare only
//! lines of the same run.

#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a benchmark prints, and ends where it cannot be set up"
)]

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use evolvent_bus::{BusConfig, CoreBus, Setpoint, remove_private_domain};
use evolvent_counting::{CountingAllocator, calls};
use evolvent_drive::PowerRequest;
use evolvent_ethercat::{CycleTime, CycleTimes, Network, RunSettings, run_measured};
use evolvent_ethercat_ring::{
    DriveSettings, MAIN_INTERFACE, PacketSocket, SubDevice, TerminalKind, monotonic_ns, on_bench,
};
use evolvent_machine::Machine;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const LETTERS: &str = "XYZABCUV";
const LEAD_NS: u64 = 40_000_000;
/// The bridge's priority with the shipped machine files.
const PRIORITY: i32 = 78;

fn machine(axes: usize, rate_hz: u64) -> Machine {
    let mut text = format!(
        "name = \"bench\"\nkind = \"mill\"\nincrements_per_mm = 1000\nincrements_per_degree = 1000\n\
         rate = {rate_hz}\n"
    );
    for letter in LETTERS.chars().take(axes) {
        let (unit, speed) = if "ABC".contains(letter) {
            ("deg", "deg_min")
        } else {
            ("mm", "mm_min")
        };
        let (acceleration, jerk) = if unit == "deg" {
            ("deg_s2 = 5000", "deg_s3 = 200000")
        } else {
            ("m_s2 = 5", "m_s3 = 200")
        };
        text.push_str(&format!(
            "[[axis]]\nletter = \"{letter}\"\ntravel_min_{unit} = -400\ntravel_max_{unit} = 400\n\
             max_velocity_{speed} = 30000\nmax_acceleration_{acceleration}\nmax_jerk_{jerk}\n"
        ));
    }
    Machine::parse(&text, "bench.toml").expect("a machine")
}

/// Coupler, drives, 8 digital inputs, 8 digital outputs.
fn devices(axes: usize) -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
    devices
        .extend((0..axes).map(|i| SubDevice::drive(DriveSettings::default(), 2 + i as u32, 5.0 * i as f64)));
    devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 90));
    devices.push(SubDevice::terminal(TerminalKind::DigitalOutput, 91));
    devices
}

fn network(axes: usize) -> Network {
    let mut text = "max_lost_cycles = 50\n".to_owned();
    let mut device = |name: &str, product: u32, more: &str| {
        text.push_str(&format!(
            "[[device]]\nname = \"{name}\"\nvendor = 0x4556534D\nproduct = {product:#x}\n{more}\n"
        ));
    };
    device("coupler", 0x1100, "");
    for letter in LETTERS.chars().take(axes) {
        let unit = if "ABC".contains(letter) { "deg" } else { "mm" };
        device(
            &format!("drive-{letter}"),
            0x402,
            &format!(
                "axis = \
                 {{ letter = \"{letter}\", increments_per_turn = 1048576, turn_{unit} = 5, velocity_offset = true }}"
            ),
        );
    }
    device("inputs", 0x1008, "");
    device("outputs", 0x2008, "");
    Network::parse(&text, "bench.toml").expect("a network")
}

/// Bytes of the bridge's frame: clock, process data, a state check of each device.
fn frame_bytes(axes: usize) -> usize {
    // 6040h, 6060h, 607Ah, 60B1h; 6041h, 6061h, 6064h, 603Fh, 60FDh, 6077h.
    let process_data = axes * (2 + 1 + 4 + 4 + 2 + 1 + 4 + 2 + 4 + 2) + 2;
    14 + 2 + (12 + 8) + (12 + process_data) + (axes + 3) * (12 + 2)
}

fn raise_priority() {
    let parameters = libc::sched_param {
        sched_priority: PRIORITY,
    };
    // SAFETY: the parameters live through the call; 0 is the calling thread.
    let _normal = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) };
}

fn sleep_until(at_ns: u64) {
    let at = libc::timespec {
        tv_sec: (at_ns / 1_000_000_000) as i64,
        tv_nsec: (at_ns % 1_000_000_000) as i64,
    };
    // SAFETY: the time lives through the call; what is left is not asked for.
    let _woken = unsafe {
        libc::clock_nanosleep(
            libc::CLOCK_MONOTONIC,
            libc::TIMER_ABSTIME,
            &raw const at,
            core::ptr::null_mut(),
        )
    };
}

/// Processor time of the calling thread, ns.
fn thread_ns() -> u64 {
    let mut now = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: the time lives through the call.
    let _read = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &raw mut now) };
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// Exchanges a frame of the bridge's length every period, and nothing else.
fn bare_loop(bytes: usize, period_ns: u64, cycles: usize) -> Vec<CycleTime> {
    raise_priority();
    let socket = PacketSocket::open(MAIN_INTERFACE).expect("a socket");
    let mut frame = vec![0xFF; 6];
    frame.extend([0x10, 0, 0, 0, 0, 1, 0x88, 0xA4]);
    let length = (bytes - 16) as u16;
    frame.extend((length | 0x1000).to_le_bytes());
    // One datagram that no device takes.
    frame.extend([0, 0, 0, 0, 0, 0]);
    frame.extend((length - 12).to_le_bytes());
    frame.resize(bytes, 0);
    let mut times = Vec::with_capacity(cycles);
    let mut next_ns = monotonic_ns() + period_ns;
    for _ in 0..cycles {
        sleep_until(next_ns);
        let (woken_ns, processor_ns) = (monotonic_ns(), thread_ns());
        let _lost = socket.send(&frame);
        let begin_ns = monotonic_ns();
        let waited = socket
            .wait(Duration::from_nanos(period_ns * 9 / 10))
            .unwrap_or(false);
        let end_ns = monotonic_ns();
        let _frame = if waited {
            socket.receive(Duration::ZERO)
        } else {
            Ok(None)
        };
        let whole_ns = monotonic_ns() - woken_ns;
        times.push(CycleTime {
            late_ns: woken_ns.saturating_sub(next_ns) as u32,
            work_ns: (whole_ns - (end_ns - begin_ns)) as u32,
            whole_ns: whole_ns as u32,
            processor_ns: (thread_ns() - processor_ns) as u32,
        });
        next_ns += period_ns;
        let late_ns = monotonic_ns().saturating_sub(next_ns);
        if late_ns > period_ns {
            next_ns += late_ns / period_ns * period_ns;
        }
    }
    times
}

/// A core that brings the drives into operation and swings X.
fn drive_core(prefix: &str, axes: usize, period_ns: u64, stop: &AtomicBool) -> bool {
    let letters: String = LETTERS.chars().take(axes).collect();
    let mask = evolvent_path::AxisLetter::ALL
        .iter()
        .filter(|letter| letters.contains(letter.letter()))
        .fold(0, |mask, letter| mask | 1 << letter.index());
    let mut config = BusConfig::new("bench", &letters, period_ns);
    config.prefix = Some(prefix.to_owned());
    let mut bus = CoreBus::open(&config).expect("a bus");
    let (mut sequence, mut next_ns, mut since, mut enabled) = (0_u64, monotonic_ns(), None, false);
    let mut position = [0.0; 9];
    while !stop.load(Ordering::Relaxed) {
        while next_ns < monotonic_ns() + LEAD_NS {
            let mut setpoint = Setpoint {
                sequence,
                due_time_ns: next_ns + LEAD_NS,
                period_ns,
                axes_mask: mask,
                state: 1,
                override_ratio: 1.0,
                ..Setpoint::default()
            };
            if let Some(since) = since {
                setpoint.power_request = PowerRequest::On.number();
                if enabled {
                    let t = (sequence - since) as f64 * period_ns as f64 * 1e-9;
                    let (sine, cosine) = (core::f64::consts::PI * t).sin_cos();
                    setpoint.position[0] = position[0] + 5.0 - 5.0 * cosine;
                    setpoint.velocity[0] = 5.0 * core::f64::consts::PI * sine;
                } else {
                    setpoint.position = position;
                }
            }
            if enabled {
                let x = setpoint.position[0];
                setpoint.position = position;
                setpoint.position[0] = x;
            }
            let _reached = bus.publish_setpoint(&setpoint);
            (sequence, next_ns) = (sequence + 1, next_ns + period_ns);
        }
        bus.admit_readers();
        while let Ok(Some(feedback)) = bus.unchecked_feedback() {
            if since.is_none() {
                position = feedback.position;
                since = Some(sequence);
            }
            let all = (0..9)
                .filter(|axis| mask >> axis & 1 == 1)
                .all(|axis| feedback.status_word[axis] & 0x6F == 0x27);
            if all && !enabled && feedback.bridge_state == 1 {
                (enabled, since) = (true, Some(sequence));
            }
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    enabled
}

fn quantile(mut values: Vec<u32>, share: f64) -> f64 {
    values.sort_unstable();
    let place = ((values.len() as f64 * share) as usize).min(values.len().saturating_sub(1));
    values.get(place).map_or(f64::NAN, |ns| f64::from(*ns) / 1000.0)
}

fn line(name: &str, times: &[CycleTime], period_ns: u64) -> [f64; 3] {
    let of = |pick: fn(&CycleTime) -> u32, share: f64| quantile(times.iter().map(pick).collect(), share);
    let late = times
        .iter()
        .filter(|time| u64::from(time.late_ns) + u64::from(time.whole_ns) > period_ns)
        .count();
    let share = late as f64 / times.len().max(1) as f64;
    println!(
        "  {name:<10} {:>8} | {:7.1} {:7.1} {:8.1} | {:7.1} {:7.1} | {:7.1} {:7.1} {:8.1} | {:7.1} {:7.1} | \
         {:.4} %",
        times.len(),
        of(|time| time.processor_ns, 0.5),
        of(|time| time.processor_ns, 0.999),
        of(|time| time.processor_ns, 1.0),
        of(|time| time.work_ns, 0.5),
        of(|time| time.work_ns, 0.999),
        of(|time| time.late_ns, 0.5),
        of(|time| time.late_ns, 0.999),
        of(|time| time.late_ns, 1.0),
        of(|time| time.whole_ns, 0.5),
        of(|time| time.whole_ns, 0.999),
        100.0 * share,
    );
    [
        of(|time| time.processor_ns, 0.5),
        of(|time| time.processor_ns, 0.999),
        share,
    ]
}

fn measure(axes: usize, rate_hz: u64, seconds: u64) {
    let period_ns = 1_000_000_000 / rate_hz;
    let measured = on_bench(devices(axes), move |ring| {
        println!("{axes} drives at {rate_hz} Hz, {seconds} s each");
        let cycles = (seconds * rate_hz) as usize;
        // Half before and half after the bridge, on separate threads, which inherit the bench's namespace.
        let bare_half = move || {
            std::thread::spawn(move || bare_loop(frame_bytes(axes), period_ns, cycles / 2))
                .join()
                .expect("no panic")
        };
        let mut bare = bare_half();
        let times = CycleTimes::new(cycles, calls);
        let prefix = format!("ecbn{}-{axes}-{rate_hz}_", std::process::id());
        let settings = RunSettings {
            machine: machine(axes, rate_hz),
            machine_name: Some("bench".to_owned()),
            network: network(axes),
            interface: MAIN_INTERFACE.to_owned(),
            prefix: Some(prefix.clone()),
            duration: None,
            dump: None,
        };
        let (stop, stop_core) = (AtomicBool::new(false), AtomicBool::new(false));
        let (report, enabled) = std::thread::scope(|scope| {
            let core = scope.spawn(|| drive_core(&prefix, axes, period_ns, &stop_core));
            let bridge =
                scope.spawn(|| run_measured(&settings, &stop, |text| println!("  {text}"), Some(&times)));
            let begin = std::time::Instant::now();
            while times.cycles().len() < cycles && begin.elapsed() < Duration::from_secs(2 * seconds + 30) {
                std::thread::sleep(Duration::from_millis(200));
            }
            stop.store(true, Ordering::Relaxed);
            let report = bridge.join().expect("no panic");
            stop_core.store(true, Ordering::Relaxed);
            (report, core.join().expect("no panic"))
        });
        let _swept = remove_private_domain(&prefix);
        bare.extend(bare_half());
        println!(
            "  {:<10} {:>8} | {:^24} | {:^15} | {:^24} | {:^15} | late",
            "us",
            "cycles",
            "processor p50 p99.9 most",
            "work p50 p99.9",
            "woken p50 p99.9 most",
            "whole p50 p99.9"
        );
        let [bare_p50, bare_p999, bare_share] = line("bare loop", &bare, period_ns);
        let [p50, p999, share] = line("bridge", &times.cycles(), period_ns);
        println!(
            "  bridge / bare, processor: p50 {:.2}, p99.9 {:.2}; beyond it: p50 {:.1} us, p99.9 {:.1} us; \
             late {:+.4} %",
            p50 / bare_p50,
            p999 / bare_p999,
            p50 - bare_p50,
            p999 - bare_p999,
            100.0 * (share - bare_share),
        );
        println!(
            "  drives in operation: {enabled}; frames lost {}, short {}; allocations and frees in the \
             cycle: {}; ring frames {}",
            report.as_ref().map_or(0, |report| report.lost_frames),
            report.as_ref().map_or(0, |report| report.short_frames),
            times.counted(),
            ring.lock().expect("no panic").frames(),
        );
    });
    if measured.is_none() {
        println!("not measured");
    }
}

fn main() {
    // `cargo bench` passes `--bench`.
    let seconds = std::env::args().find_map(|text| text.parse().ok()).unwrap_or(20);
    for (axes, rate_hz) in [(4, 1000), (8, 1000), (3, 4000)] {
        measure(axes, rate_hz, seconds);
    }
}
