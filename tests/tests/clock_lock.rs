//! The chain of clocks, with every process as in use: the cycle of the EtherCAT bridge follows the reference
//! clock of a ring that drifts against the clock of this computer, and the loop of the core follows the
//! bridge. Both must report and record the drift of the ring.
//!
//! Needs the right to create a network namespace.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "helpers of tests fail and talk as tests do"
)]

use std::time::{Duration, Instant};

use evolvent_bus::{ControlRequest, FeedbackReader};
use evolvent_ethercat_ring::{DriveSettings, MAIN_INTERFACE, SubDevice, TerminalKind, on_bench};
use evolvent_tests::{
    Domain, HardwareBridge, Operator, Served, Workshop, command, repository, where_undisturbed,
};
use evolvent_trace::TraceFile;
use serde_json::Value;

const PERIOD_NS: f64 = 2e6;
/// The lock settles in 9.4 s with this lead: 500 cycles and ten of its time constants.
const LEAD_CYCLES: u32 = 40;
const SETTLING: Duration = Duration::from_secs(11);
const MEASURED: Duration = Duration::from_secs(20);
/// A pause longer than ten periods of the bridge explains a lost setpoint.
const SUSPENDED: Duration = Duration::from_millis(15);
/// Bounds of drift and mean phase error. Without its integral part the lock finds no drift, and keeps an
/// error of 200 ppm of the period divided by its proportional part: 400 ns / (0.2 / 42) = 84 us.
const DRIFT_PPM: f64 = 5.0;
const MEAN_NS: f64 = 20_000.0;

/// A shipped file with pieces of its text replaced.
fn changed(file: &str, changes: &[(&str, &str)]) -> String {
    let text = std::fs::read_to_string(repository().join("config").join(file)).expect("a file that ships");
    changes.iter().fold(text, |text, (from, to)| {
        assert!(text.contains(from), "{from} is not in {file}");
        text.replacen(from, to, 1)
    })
}

/// The shipped ring. Its reference clock is faster than this computer by this amount, and the other clocks
/// differ from the reference.
fn devices(reference_ppm: f64) -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1).with_drift_ppm(reference_ppm)];
    devices.extend((2..5).map(|serial| {
        let drift_ppm = reference_ppm + 30.0 * (f64::from(serial) - 3.0);
        SubDevice::drive(DriveSettings::default(), serial, drift_ppm)
    }));
    devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
    devices
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().expect(key)
}

/// Replies of the bridge: their number, and the number of missed setpoints in the first and in the last of
/// them.
struct Replies {
    reader: FeedbackReader,
    count: u64,
    missed: Option<[u32; 2]>,
}

impl Replies {
    fn new(reader: FeedbackReader) -> Self {
        Self {
            reader,
            count: 0,
            missed: None,
        }
    }

    fn take(&mut self) {
        while let Some(feedback) = self.reader.receive().expect("feedback") {
            self.count += 1;
            let now = feedback.missed_setpoints;
            self.missed = Some([self.missed.map_or(now, |[first, _]| first), now]);
        }
    }
}

/// Serves the mill with the bridge of the ring for half a minute.
fn follows_the_ring(reference_ppm: f64) {
    let (workshop, domain, name) = (Workshop::new(), Domain::new(), "clock-lock");
    let rate = format!("lead_cycles = {LEAD_CYCLES}\nrate = 500 ");
    let changes = [
        ("name = \"mill-ethercat\"", "name = \"clock-lock\""),
        ("rate = 1000 ", &rate),
        ("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 1000 "),
    ];
    let machine = workshop.write("machine.toml", changed("machines/mill-ethercat.toml", &changes));
    let lost = [("max_lost_cycles = 3 ", "max_lost_cycles = 40 ")];
    let network = workshop.write("network.toml", changed("networks/sim-mill.toml", &lost));
    let trace = workshop.path("lock.mcap");
    let options = ["--trace", trace.to_str().expect("UTF-8")];
    let served = Served::start(&machine, name, &domain, &workshop.path("state"), &options);
    let network = network.to_str().expect("UTF-8");
    let arguments = [
        "ethercat",
        "--json",
        "--network",
        network,
        "--interface",
        MAIN_INTERFACE,
    ];
    let bridge = HardwareBridge::start(&arguments.map(str::to_owned), &machine, &domain);
    let mut operator = Operator::join(name, &domain);
    operator.waits("drives", |status| status.feedback_age_ns < 500_000_000);
    operator.brings_up();
    operator.says_number("MODE", 1);
    let began = Instant::now();
    while began.elapsed() < SETTLING {
        let _newer = operator.now();
        std::thread::sleep(Duration::from_millis(50));
    }
    let bus = domain.client(name);
    let mut replies = Replies::new(bus.feedback().expect("feedback"));
    let (mut count, mut sign) = (0, 1.0);
    let mut job = 0;
    while began.elapsed() < SETTLING + MEASURED {
        replies.take();
        let status = operator.now();
        let drift_ppm = f64::from(status.clock_drift_ppm);
        assert!(
            (drift_ppm + reference_ppm).abs() < 4.0 * DRIFT_PPM,
            "{drift_ppm} ppm"
        );
        assert!(
            (1.0..PERIOD_NS / 4.0).contains(&f64::from(status.phase_error_max_ns)),
            "{} ns",
            status.phase_error_max_ns
        );
        count += 1;
        if job == 0 || status.job == job && status.job_result != 0 {
            // To and fro within the travel of X.
            let mut jog = ControlRequest {
                axes_mask: 1,
                index: 1,
                amount: 20.0,
                ..command("JOG")
            };
            jog.values[0] = 20.0 * sign;
            sign = -sign;
            job = operator.does(&jog).job;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    replies.take();
    operator.sees_end(job);
    operator.says("OFF");
    operator.waits("off", |status| status.machine_state != 2);
    drop(operator);
    let summary = served.end().expect_code(&[0]).json();
    let report = bridge.end().expect_code(&[0]).json();

    let (clock, clocks) = (&summary["clock"], &report["clocks"]);
    println!("{reference_ppm} ppm: core {clock}; bridge {clocks}; {count} observations");
    // This computer is slow if the reference is fast.
    let drift_ppm = number(clock, "drift_ppm");
    assert!((drift_ppm + reference_ppm).abs() < DRIFT_PPM, "{drift_ppm} ppm");
    let mean_ns = number(clock, "phase_mean_ns");
    assert!(mean_ns.abs() < MEAN_NS, "{mean_ns} ns");
    // The phase stayed within a quarter of the period, so no period can have slipped.
    assert!(number(clock, "phase_max_ns") < PERIOD_NS / 4.0);
    assert!(number(clock, "errors") > 0.8 * MEASURED.as_nanos() as f64 / PERIOD_NS);
    let drift_ppm = number(clocks, "drift_ppm");
    assert!((drift_ppm + reference_ppm).abs() < DRIFT_PPM, "{drift_ppm} ppm");

    assert_eq!(
        (
            number(&summary, "late_cycles"),
            number(&summary, "dropped_setpoints")
        ),
        (0.0, 0.0)
    );
    // No period has slipped: the phase was within a quarter of it in every cycle.
    let [before, after] = replies.missed.expect("replies");
    assert_eq!(after, before, "of {} replies", replies.count);
    assert!(replies.count as f64 > 0.8 * MEASURED.as_nanos() as f64 / PERIOD_NS);

    // The trace contains it as well.
    let file = TraceFile::open(&trace).expect("a trace");
    let recorded = |key| file.info().summary_number(key).expect(key);
    assert!((recorded("clock_drift_ppm") - number(clock, "drift_ppm")).abs() < 0.01);
    assert!((recorded("phase_scatter_ns") - number(clock, "phase_scatter_ns")).abs() < 1.0);
    assert!((recorded("phase_max_ns") - number(clock, "phase_max_ns")).abs() < 1.0);
}

#[test]
fn the_core_follows_a_ring_200_ppm_fast_or_slow() {
    for reference_ppm in [200.0, -200.0] {
        where_undisturbed(SUSPENDED, || {
            on_bench(devices(reference_ppm), move |_ring| {
                follows_the_ring(reference_ppm);
            });
        });
    }
}
