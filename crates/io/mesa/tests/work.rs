//! The cycle's own work for 4 axes, one of them a gantry, compared with a bare loop on the same sockets, and
//! its allocations: none once it runs.
//!
//! An executable of its own, because its allocator counts.

#![expect(clippy::expect_used, clippy::print_stdout, reason = "a test")]

use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use evolvent_bridge_sim::monotonic_ns;
use evolvent_bus::{BusConfig, CoreBus, Setpoint, remove_private_domain};
use evolvent_counting::{CountingAllocator, calls};
use evolvent_drive::{DriveState, PowerRequest};
use evolvent_machine::Machine;
use evolvent_mesa::{BoardSettings, Link, Packet, RunSettings, Space, run_measured};
use evolvent_mesa_board::{Board, BoardModel, BoardServer, now_ns};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const PERIOD_NS: u64 = 1_000_000;
const LEAD: u64 = 50;
/// Time that a bridge waits before its next session, which allocates at its beginning. A session ends if the
/// host keeps this process from running until the position of an encoder is unknown.
const BETWEEN_SESSIONS: Duration = Duration::from_millis(500);
/// Duration of the measurement, s.
const SECONDS: u64 = 5;

fn files(address: IpAddr) -> (Machine, BoardSettings) {
    let machine = evolvent_file_tests::shipped("machines/router-3axis.toml");
    let u = "[[axis]]\nletter = \"U\"\ntravel_min_mm = 0\ntravel_max_mm = 600\nmax_velocity_mm_min = 3000\n\
             max_acceleration_m_s2 = 1.5\nmax_jerk_m_s3 = 40\n\n";
    let machine = machine.replacen("[[input]]", &format!("{u}[[input]]"), 1);
    let board = evolvent_file_tests::shipped("boards/7i96s-router.toml");
    // An analog servo, whose index is requested.
    let u = "[[axis]]\nletter = \"U\"\nencoder = 0\ncounts_per_unit = 4000\npwm = 0\nfull_velocity = 200\n\
             p_gain = 40\n\n";
    let second = "[[axis]]\nletter = \"X\"\nstepgen = 4\nsteps_per_unit = 320\nstep_length_ns = 2500\n\
        step_space_ns = 2500\ndirection_setup_ns = 5000\ndirection_hold_ns = 5000\n\
        home_switch = { pin = 4, inverted = true }\n[axis.gantry]\nmax_difference = 1\n\n";
    let board = board.replacen("[[input]]", &format!("{u}{second}[[input]]"), 1);
    // The servo takes the spindle's generator, the only one of the board.
    let (board, _spindle) = board
        .split_once("[spindle]")
        .expect("a spindle at the end of the file");
    let mut board = BoardSettings::parse(board, "board.toml").expect("a board file");
    // A busy host may keep the bridge from running for longer than a machine would permit.
    (board.address, board.max_lost_packets, board.watchdog_s) = (address, 50, 1.0);
    (
        Machine::parse(&machine, "machine.toml").expect("a machine"),
        board,
    )
}

fn quantile(sorted: &[u64], fraction: f64) -> f64 {
    let index = ((sorted.len() - 1) as f64 * fraction) as usize;
    sorted.get(index).copied().unwrap_or(0) as f64 / 1000.0
}

fn print_times(what: &str, times_ns: &mut [u64]) {
    times_ns.sort_unstable();
    println!(
        "{what}: p50 {:.1}, p99.9 {:.1}, at most {:.1} us of {} cycles",
        quantile(times_ns, 0.5),
        quantile(times_ns, 0.999),
        quantile(times_ns, 1.0),
        times_ns.len()
    );
}

/// Exchanges the same packets without a bridge, at the bridge's priority: one read with a wait for its reply,
/// and one write.
fn bare_loop(address: IpAddr) -> Vec<u64> {
    let parameters = libc::sched_param { sched_priority: 78 };
    // SAFETY: the parameters live through the call; 0 is the calling thread.
    let _allowed = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) };
    let link = Link::open(address).expect("a socket");
    let (mut reading, mut writing) = (Packet::new(), Packet::new());
    reading.write_word(Space::Timer, 0x12, 1).expect("room");
    reading.read(Space::Timer, 0x10, 3).expect("room");
    for (register, count) in [(0x0D00, 1), (0x1000, 3), (0x2100, 4)] {
        reading.read(Space::HostMot2, register, count).expect("room");
    }
    writing.write(0x2000, &[0; 4]).expect("room");
    writing.write(0x4000, &[0]).expect("room");
    writing.write(0x4400, &[0]).expect("room");
    writing.write(0x1000, &[0; 3]).expect("room");
    writing.write(0x0E00, &[0x5A00_0000]).expect("room");
    writing.write_word(Space::Timer, 0x10, 1).expect("room");
    let mut buffer = [0; evolvent_mesa::MAX_PACKET + 8];
    let mut times = Vec::new();
    let mut next = Instant::now();
    while times.len() < (SECONDS * 1_000_000_000 / PERIOD_NS) as usize {
        next += Duration::from_nanos(PERIOD_NS);
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
        let (begin, mut waited) = (Instant::now(), Duration::ZERO);
        link.send(&reading);
        for _ in 0..5 {
            let before = Instant::now();
            if link.receive(&mut buffer).is_some() {
                break;
            }
            link.wait(Duration::from_micros(600));
            waited += before.elapsed();
        }
        link.send(&writing);
        times.push((begin.elapsed().saturating_sub(waited)).as_nanos() as u64);
    }
    times
}

#[test]
fn a_cycle_allocates_nothing_and_its_work_is_told() {
    let process = std::process::id();
    let address = IpAddr::from([127, 31, (process >> 8) as u8, process as u8]);
    let server = BoardServer::start(Board::new(BoardModel::B7i96s, now_ns()), address).expect("an address");
    server.lock().set_drive(0, 4000, 800_000.0);
    server.lock().set_index(0, 2000);
    let (machine, board) = files(address);
    let prefix = format!("mesaw{process}_");
    let settings = RunSettings {
        machine,
        machine_name: Some("mesa-work".to_owned()),
        board,
        prefix: Some(prefix.clone()),
        duration: None,
    };
    let stop = Arc::new(AtomicBool::new(false));
    let bridge = std::thread::spawn({
        let stop = Arc::clone(&stop);
        move || {
            let (mut times, mut allocating) = (Vec::with_capacity(1 << 20), 0_u64);
            let mut last: Option<(u64, Instant)> = None;
            let mut measure = |work_ns: u64| {
                let now = calls();
                let is_of_session = |at: &Instant| at.elapsed() < BETWEEN_SESSIONS;
                allocating += u64::from(last.is_some_and(|(last, at)| is_of_session(&at) && last != now));
                if times.len() < times.capacity() {
                    times.push(work_ns);
                }
                last = Some((calls(), Instant::now()));
            };
            let report = run_measured(&settings, &stop, |text| println!("{text}"), Some(&mut measure));
            (report, times, allocating)
        }
    });
    let mut config = BusConfig::new("mesa-work", "XYZU", PERIOD_NS);
    config.prefix = Some(prefix.clone());
    let mut core = CoreBus::open(&config).expect("a bus");
    let mut setpoint = Setpoint {
        period_ns: PERIOD_NS,
        axes_mask: 0b100_0111,
        state: 1,
        override_ratio: 1.0,
        ..Setpoint::default()
    };
    let mut pulses = 0;
    let (mut next_ns, mut enabled, begin) = (monotonic_ns(), 0_u64, Instant::now());
    // To and fro once all four are in operation.
    while enabled < SECONDS * 1_000_000_000 / PERIOD_NS {
        assert!(
            begin.elapsed() < Duration::from_secs(60),
            "operation within a minute"
        );
        setpoint.sequence += 1;
        setpoint.due_time_ns = next_ns + LEAD * PERIOD_NS;
        setpoint.power_request = if setpoint.sequence > 1000 {
            PowerRequest::On.number()
        } else {
            PowerRequest::Off.number()
        };
        let time = enabled as f64 * PERIOD_NS as f64 * 1e-9;
        for axis in [0, 1, 2, 6] {
            // 1 mm at 2 Hz, from rest.
            let w = std::f64::consts::TAU * 2.0;
            setpoint.position[axis] = 0.5 * (1.0 - (w * time).cos());
            setpoint.velocity[axis] = 0.5 * w * (w * time).sin();
            setpoint.acceleration[axis] = 0.5 * w * w * (w * time).cos();
        }
        if enabled == 0 {
            (setpoint.velocity, setpoint.acceleration) = ([0.0; 9], [0.0; 9]);
        }
        (setpoint.index_request, setpoint.index_axis) = (1 + enabled as u32 / 250, 6);
        let _reached = core.publish_setpoint(&setpoint);
        next_ns = (next_ns + PERIOD_NS).max(monotonic_ns().saturating_sub(LEAD * PERIOD_NS / 2));
        std::thread::sleep(Duration::from_nanos(next_ns.saturating_sub(monotonic_ns())));
        core.admit_readers();
        while let Ok(Some(feedback)) = core.unchecked_feedback() {
            let on = [0, 1, 2, 6].iter().all(|axis: &usize| {
                DriveState::decode(feedback.status_word[*axis] as u16) == Some(DriveState::OperationEnabled)
            });
            let has_pulse = feedback.index_request > 0 && !feedback.index_position.is_nan();
            pulses = pulses.max(if has_pulse { feedback.index_request } else { 0 });
            if on && feedback.bridge_state == 1 && enabled == 0 {
                enabled = 1;
            }
        }
        enabled += u64::from(enabled > 0);
    }
    stop.store(true, Ordering::Relaxed);
    let (report, mut times, allocating) = bridge.join().expect("no panic");
    drop(core);
    let _swept = remove_private_domain(&prefix);
    println!("{:?} {:?}", report.expect("a bridge"), server.lock().traffic());
    for unit in [0, 4] {
        assert!(
            server.lock().motor_steps(unit).abs() > 0.0,
            "motor {unit} has moved"
        );
    }
    assert!(pulses > 1, "index pulses have been latched: {pulses}");
    print_times("bridge, 4 axes", &mut times);
    print_times("bare loop", &mut bare_loop(address));
    assert!(times.len() > 3000, "{} cycles", times.len());
    assert_eq!(allocating, 0, "cycles that have allocated or freed");
}
