//! A handwheel on a served machine, turned independently of the core.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use evolvent_bus::{ControlRequest, MachineInputs};
use evolvent_random::Random;
use evolvent_replay::verify;
use evolvent_runtime::MonotonicClock;
use evolvent_tests::{Domain, Operator, Served, Workshop, command, cycles, unless_disturbed};

const MANUAL: u32 = 1;
const AUTO: u32 = 0;
const NO_HANDWHEEL: u32 = 931;
const COUNTS: u32 = 3;
const SELECT_X: u64 = 1 << 10;
const SELECT_Z: u64 = 1 << 11;
const STEP_10: u64 = 1 << 13;
const ENABLE: u64 = 1 << 20;
const BUTTONS: u64 = 0b1111 << 10 | ENABLE;
/// mm/s, mm/s2, mm/s3 of X.
const LIMITS: [f64; 3] = [500.0, 5000.0, 200_000.0];

/// A wheel whose axis and step are selected by command.
const BARE: &str = "
[signals]
input_timeout_ms = 500
[[input]]
name = \"wheel\"
kind = \"analog\"
number = 3
[handwheel]
counts = \"wheel\"
";

/// A pendant with selectors and an enabling button.
const PENDANT: &str = "
[signals]
input_timeout_ms = 500
[[input]]
name = \"wheel\"
kind = \"analog\"
number = 3
[[input]]
name = \"wheel-x\"
number = 10
[[input]]
name = \"wheel-z\"
number = 11
[[input]]
name = \"times-1\"
number = 12
[[input]]
name = \"times-10\"
number = 13
[[input]]
name = \"button\"
number = 20
[handwheel]
counts = \"wheel\"
steps_mm = [0.001, 0.01]
axis_inputs = { X = \"wheel-x\", Z = \"wheel-z\" }
step_inputs = [\"times-1\", \"times-10\"]
enable_input = \"button\"
";

/// A pendant whose counts and buttons are sent to the core every 2 ms.
struct Pendant {
    counts: Arc<AtomicI64>,
    buttons: Arc<AtomicU64>,
    is_silent: Arc<AtomicBool>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Pendant {
    /// With buttons, or only the wheel.
    fn start(domain: &Domain, name: &str, buttons_there: u64) -> Self {
        let client = domain.client(name);
        // An encoder that has been turned for years.
        let counts = Arc::new(AtomicI64::new(123_456));
        let buttons = Arc::new(AtomicU64::new(0));
        let (is_silent, is_over) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let (its_counts, its_buttons, its_silence, its_end) = (
            Arc::clone(&counts),
            Arc::clone(&buttons),
            Arc::clone(&is_silent),
            Arc::clone(&is_over),
        );
        let thread = std::thread::spawn(move || {
            let mut sender = client.input_sender().expect("inputs");
            let mut sequence = 0;
            while !its_end.load(Ordering::Acquire) {
                if !its_silence.load(Ordering::Acquire) {
                    sequence += 1;
                    let mut message = MachineInputs {
                        sequence,
                        instance: 78,
                        time_ns: MonotonicClock::now_ns(),
                        digital_mask: buttons_there,
                        digital: its_buttons.load(Ordering::Acquire),
                        analog_mask: 1 << COUNTS,
                        ..MachineInputs::default()
                    };
                    message.analog[COUNTS as usize] = its_counts.load(Ordering::Acquire) as f64;
                    let _gone = sender.send(&message);
                }
                std::thread::sleep(Duration::from_millis(2));
            }
        });
        Self {
            counts,
            buttons,
            is_silent,
            is_over,
            thread: Some(thread),
        }
    }

    fn turns(&self, counts: i64) {
        self.counts.fetch_add(counts, Ordering::AcqRel);
    }

    fn presses(&self, buttons: u64) {
        self.buttons.store(buttons, Ordering::Release);
    }

    fn falls_silent(&self, silent: bool) {
        self.is_silent.store(silent, Ordering::Release);
    }
}

impl Drop for Pendant {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _panicked = thread.join();
        }
    }
}

struct Shop {
    workshop: Workshop,
    domain: Domain,
    machine: PathBuf,
    name: &'static str,
}

impl Shop {
    fn new(name: &'static str, wheel: &str) -> Self {
        let workshop = Workshop::new();
        let text =
            std::fs::read_to_string(workshop.mill(name, &[("rate = \"rational\"  ", "rate = 1000.0  ")]))
                .expect("a machine file");
        let machine = workshop.write(&format!("{name}.toml"), format!("{text}{wheel}"));
        Self {
            workshop,
            domain: Domain::new(),
            machine,
            name,
        }
    }

    fn serves(&self, trace: &str) -> Served {
        let trace = self.workshop.path(trace).display().to_string();
        Served::start(
            &self.machine,
            self.name,
            &self.domain,
            &self.workshop.path("state"),
            &["--trace", &trace],
        )
    }

    fn operator(&self) -> Operator {
        let mut operator = Operator::join(self.name, &self.domain);
        operator.brings_up();
        operator.says_number("MODE", MANUAL);
        operator
    }
}

fn chooses(axes_mask: u32, step: f64) -> ControlRequest {
    ControlRequest {
        axes_mask,
        amount: step,
        ..command("HANDWHEEL")
    }
}

/// Waits until nothing has moved for a tenth of a second; returns the positions.
#[track_caller]
fn rests(operator: &mut Operator) -> [f64; 9] {
    let mut last = ([f64::NAN; 9], 0);
    let status = operator.waits("rest", |status| {
        if status.position_machine != last.0 {
            last = (status.position_machine, status.time_ns);
        }
        status.time_ns > last.1 + 100_000_000
    });
    status.position_machine
}

/// Asserts that the cycles of a trace keep the limits of X, by differences of its positions.
fn keeps_limits(positions: &[f64], rate: f64) {
    for (index, four) in positions.windows(4).enumerate() {
        let [a, b, c, d] = [four[0], four[1], four[2], four[3]];
        let rates = [
            (d - c) * rate,
            (d - 2.0 * c + b) * rate.powi(2),
            (d - 3.0 * c + 3.0 * b - a) * rate.powi(3),
        ];
        for (order, (value, slack)) in rates.iter().zip([1.001, 1.001, 1.02]).enumerate() {
            assert!(
                value.abs() <= LIMITS[order] * slack + 1.0,
                "derivative {} at {index}: {value}, {:?}",
                order + 1,
                &positions[index.saturating_sub(6)..(index + 8).min(positions.len())]
            );
        }
    }
}

#[test]
fn a_random_hand_loses_no_count_and_breaks_no_limit() {
    let seed = 0x5eed_3ee2_u64;
    unless_disturbed(|| {
        let shop = Shop::new("wheel-hand", BARE);
        let served = shop.serves("hand.mcap");
        let mut operator = shop.operator();
        let pendant = Pendant::start(&shop.domain, shop.name, 0);
        operator.does(&chooses(1, 0.1));
        std::thread::sleep(Duration::from_millis(50));
        let mut random = Random::from_state(seed);
        let (mut speed, mut turned) = (0.0_f64, 0_i64);
        for _ in 0..1500 {
            // Up to 250 detents per second, with sudden turns; 25 mm/s of the axis, and much more in the
            // jumps.
            speed = match random.unit() {
                x if x < 0.01 => 4.0 * random.unit() - 2.0,
                x if x < 0.02 => 0.0,
                _ => speed + 0.1 * (random.unit() - 0.5),
            };
            let counts = (speed.clamp(-2.0, 2.0) + random.unit()).floor() as i64;
            turned += counts;
            pendant.turns(counts);
            std::thread::sleep(Duration::from_millis(2));
        }
        let end = rests(&mut operator);
        let expected = 0.1 * turned as f64 / 4.0;
        println!("seed {seed:#x}: {turned} counts, X {}", end[0]);
        assert!((end[0] - expected).abs() < 1e-6, "{} and not {expected}", end[0]);
        assert_eq!((end[1], end[2]), (0.0, 0.0));
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let recorded = cycles(&shop.workshop.path("hand.mcap"));
        let x: Vec<f64> = recorded.iter().map(|cycle| cycle.position[0]).collect();
        keeps_limits(&x, 1000.0);
        let again = verify(&shop.workshop.path("hand.mcap")).expect("a readable trace");
        assert!(again.holds() && again.uncompared == 0, "{again:?}");
    });
}

#[test]
fn an_even_hand_moves_evenly_and_stops_soon() {
    unless_disturbed(|| {
        let shop = Shop::new("wheel-even", BARE);
        let served = shop.serves("even.mcap");
        let mut operator = shop.operator();
        let pendant = Pendant::start(&shop.domain, shop.name, 0);
        operator.does(&chooses(1, 0.1));
        std::thread::sleep(Duration::from_millis(50));
        // One count every 5 ms: 50 detents per second, 5 mm/s.
        for _ in 0..400 {
            pendant.turns(1);
            std::thread::sleep(Duration::from_millis(5));
        }
        let end = rests(&mut operator);
        assert!((end[0] - 10.0).abs() < 1e-6, "{}", end[0]);
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let recorded = cycles(&shop.workshop.path("even.mcap"));
        let x: Vec<f64> = recorded.iter().map(|cycle| cycle.position[0]).collect();
        let begin = x.iter().position(|x| *x > 0.0).expect("it moves");
        let over = x.iter().rposition(|x| *x < 10.0 - 1e-9).expect("it moves");
        let middle = &x[begin + 300..over - 300];
        let speeds: Vec<f64> = middle.windows(2).map(|two| 1000.0 * (two[1] - two[0])).collect();
        let mean = speeds.iter().sum::<f64>() / speeds.len() as f64;
        let spread = (speeds.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / speeds.len() as f64).sqrt();
        println!("mean {mean:.3} mm/s, spread {:.1} %", 100.0 * spread / mean);
        assert!(spread < 0.35 * mean, "{spread} of {mean}");
        let min = speeds.iter().fold(f64::INFINITY, |min, v| min.min(*v));
        assert!(min > 0.0, "it stops between two counts: {min}");
    });
}

#[test]
fn only_a_selected_enabled_live_pendant_moves_an_axis() {
    unless_disturbed(|| {
        let shop = Shop::new("wheel-pendant", PENDANT);
        let served = shop.serves("pendant.mcap");
        let mut operator = shop.operator();
        let pendant = Pendant::start(&shop.domain, shop.name, BUTTONS);
        let turns = |counts: i64| {
            std::thread::sleep(Duration::from_millis(30));
            pendant.turns(counts);
            std::thread::sleep(Duration::from_millis(30));
        };
        // The switches of the pendant select the axis, and no command does.
        let refused = operator.request(&chooses(1, 0.0));
        assert_eq!(
            (refused.verdict, refused.alarm),
            (1, NO_HANDWHEEL),
            "{}",
            refused.text()
        );
        // Without axis, step or button nothing moves, then or afterwards.
        for buttons in [
            ENABLE | STEP_10,
            ENABLE | SELECT_X,
            SELECT_X | STEP_10,
            ENABLE | STEP_10 | SELECT_X | SELECT_Z,
        ] {
            pendant.presses(buttons);
            turns(40);
        }
        pendant.presses(ENABLE | STEP_10 | SELECT_X);
        assert_eq!(rests(&mut operator)[..3], [0.0; 3]);
        turns(40);
        assert!((rests(&mut operator)[0] - 0.1).abs() < 1e-9);
        // Another axis continues with its own counts.
        pendant.presses(ENABLE | STEP_10 | SELECT_Z);
        turns(-80);
        let at = rests(&mut operator);
        assert!((at[0] - 0.1).abs() < 1e-9 && (at[2] + 0.2).abs() < 1e-9, "{at:?}");
        // Other modes and the emergency stop.
        operator.says_number("MODE", AUTO);
        turns(40);
        operator.says_number("MODE", MANUAL);
        operator.says("ESTOP");
        turns(40);
        operator.brings_up();
        assert_eq!(rests(&mut operator)[2], at[2]);
        // A bridge that becomes silent while the wheel is turned, and one that counts from zero again.
        pendant.falls_silent(true);
        turns(400);
        std::thread::sleep(Duration::from_millis(800));
        pendant.falls_silent(false);
        assert_eq!(rests(&mut operator)[2], at[2]);
        pendant.counts.store(0, Ordering::Release);
        assert_eq!(rests(&mut operator)[2], at[2]);
        turns(40);
        assert!((rests(&mut operator)[2] + 0.1).abs() < 1e-9);
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let again = verify(&shop.workshop.path("pendant.mcap")).expect("a readable trace");
        assert!(again.holds() && again.uncompared == 0, "{again:?}");
    });
}

#[test]
fn a_released_button_or_travel_end_drops_counts() {
    unless_disturbed(|| {
        let steps = PENDANT
            .replace("[0.001, 0.01]", "[0.001, 5.0]")
            .replace("input_timeout_ms = 500", "input_timeout_ms = 200");
        let shop = Shop::new("wheel-end", &steps);
        let served = shop.serves("end.mcap");
        let mut operator = shop.operator();
        let pendant = Pendant::start(&shop.domain, shop.name, BUTTONS);
        pendant.presses(ENABLE | STEP_10 | SELECT_X);
        std::thread::sleep(Duration::from_millis(50));
        // 300 mm of motion: the button is released meanwhile.
        pendant.turns(240);
        let moving = Arc::new(Mutex::new(0.0));
        operator.waits("motion", |status| {
            *moving.lock().expect("nobody panicked") = status.position_machine[0];
            status.position_machine[0] > 20.0
        });
        pendant.presses(STEP_10 | SELECT_X);
        let stopped = rests(&mut operator)[0];
        // From 500 mm/s it stops within 35 mm, and the release is seen within a few ms.
        let reached = *moving.lock().expect("nobody panicked");
        assert!(
            stopped < reached + 80.0 && stopped < 299.0,
            "{reached} to {stopped}"
        );
        pendant.presses(ENABLE | STEP_10 | SELECT_X);
        assert_eq!(rests(&mut operator)[0], stopped);
        // The bridge dies meanwhile: 300 mm take 0.7 s, the inputs are unknown after 0.2 s.
        pendant.turns(-240);
        operator.waits("motion", |status| status.position_machine[0] < stopped - 1.0);
        pendant.falls_silent(true);
        let silent = rests(&mut operator)[0];
        assert!(silent > stopped - 280.0, "{stopped} to {silent}");
        pendant.falls_silent(false);
        assert_eq!(rests(&mut operator)[0], silent);
        // Far beyond the end of the travel, in parts; the first detent back moves the axis.
        for _ in 0..5 {
            pendant.turns(300);
            std::thread::sleep(Duration::from_millis(40));
        }
        assert!((rests(&mut operator)[0] - 400.0).abs() < 1e-6);
        pendant.turns(-4);
        assert!((rests(&mut operator)[0] - 395.0).abs() < 1e-6);
        // STOP also ends the motion for good.
        pendant.turns(-240);
        operator.waits("motion", |status| status.position_machine[0] < 380.0);
        operator.says("STOP");
        let stopped = rests(&mut operator)[0];
        assert!(stopped > 100.0 && stopped < 380.0, "{stopped}");
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let recorded = cycles(&shop.workshop.path("end.mcap"));
        let x: Vec<f64> = recorded.iter().map(|cycle| cycle.position[0]).collect();
        keeps_limits(&x, 1000.0);
        let again = verify(&shop.workshop.path("end.mcap")).expect("a readable trace");
        assert!(again.holds() && again.uncompared == 0, "{again:?}");
    });
}

#[test]
fn a_commanded_jog_takes_over_from_a_turning_wheel() {
    unless_disturbed(|| {
        let shop = Shop::new("wheel-jog", BARE);
        let served = shop.serves("jog.mcap");
        let mut operator = shop.operator();
        let pendant = Pendant::start(&shop.domain, shop.name, 0);
        let turns_until = |end: std::time::Instant| {
            while std::time::Instant::now() < end {
                pendant.turns(1);
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        let soon = |ms| std::time::Instant::now() + Duration::from_millis(ms);
        for trial in 1..=8 {
            operator.does(&chooses(1, 0.1));
            std::thread::sleep(Duration::from_millis(30));
            // At any moment of a speed change of the wheel.
            turns_until(soon(150 + trial));
            let mut jog = ControlRequest {
                axes_mask: 2,
                index: 1,
                amount: 20.0,
                ..command("JOG")
            };
            jog.values[1] = 1.5;
            operator.does(&jog);
            // The jog moves its axis although the wheel is still turned.
            turns_until(soon(60));
            operator.does(&chooses(0, 0.0));
            let end = rests(&mut operator);
            assert!(
                (end[1] - 1.5 * trial as f64).abs() < 1e-9,
                "trial {trial}: Y {}",
                end[1]
            );
        }
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let again = verify(&shop.workshop.path("jog.mcap")).expect("a trace");
        assert!(again.holds() && again.uncompared == 0, "{again:?}");
    });
}

#[test]
fn a_machine_without_a_wheel_says_so() {
    let shop = Shop::new("wheel-none", "");
    let served = shop.serves("none.mcap");
    let mut operator = shop.operator();
    let refused = operator.request(&chooses(1, 0.1));
    assert_eq!((refused.verdict, refused.alarm), (1, NO_HANDWHEEL));
    drop(operator);
    served.end().expect_code(&[0, 3]);
}
