//! Random programs that probe, change tools, tap and cut by G95 and G96, on a served machine with simulated
//! drives.
//! At a random moment one part fails (the probe, the tool changer, the spindle, a drive, the bridge), or
//! an operator holds or stops. Every published setpoint keeps the limits, the machine stops, the alarm names the
//! cause, the trace is recomputed bit for bit, and the next job works.
//!
//! `EVOLVENT_CASES` makes it a campaign. Each case prints its seed: `EVOLVENT_SEED=SEED EVOLVENT_CASES=1`
//! repeats it.
#![expect(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail and talk as tests do"
)]

use std::sync::Mutex;
use std::time::{Duration, Instant};

use evolvent_bus::{Status, switches};
use evolvent_random::{cases, seed, seed_of_time};
use evolvent_replay::verify;
use evolvent_tests::job_result::{DONE, FAILED, FAULT, STOPPED};
use evolvent_tests::{Cycle, Domain, Drives, Operator, Served, Workshop, command, unless_disturbed};
use evolvent_trace::TraceFile;

mod case;
mod trouble;

use self::case::Case;
pub(crate) use self::trouble::Trouble;
use crate::shop::{AUTO, HELD, Shop, keeps_limits};

/// Cases of a run without `EVOLVENT_CASES`, and machines beside each other.
const USUAL_CASES: usize = 6;
const AT_ONCE: usize = 2;
const MANUAL: u32 = 1;
const MDI: u32 = 2;
/// X, Y, Z.
const MILL: u32 = 0b111;
/// Maximum number of cycles of 1 ms of a stop. From 500 mm/s with 5 m/s2 and 200 m/s3 an axis stops in 100 +
/// 25 ms; on the path it takes at most twice that, where the axes have to keep to a corner.
const STOP_CYCLES: u64 = 250;
/// Maximum number of cycles from the reply to a command to the cycle that executes it, on a busy host.
const ORDER_CYCLES: u64 = 50;
/// Longer than `input_timeout_ms`.
const SILENCE: Duration = Duration::from_millis(1600);
/// Longer than any program with all its timeouts.
pub(crate) const LONGEST: Duration = Duration::from_secs(90);

const EXTRA: &str = "
[program]
tool_table = \"tools.tbl\"
subroutines = [\"subroutines\"]
tool_change = \"CHANGE\"
[probe]
overtravel_mm = 2
[signals]
input_timeout_ms = 1500
[[output]]
name = \"drawbar\"
number = 1
[[input]]
name = \"open\"
number = 1
[[spindle]]
max_rpm = 6000
feedback = true
reverse = true
acceleration_rpm_s = 2500
at_speed_timeout_s = 4
";

const CHANGE: &str = "o<toolchange> sub
G21 G90 G53 G1 X[10 * #3] F12000
M64 P1
M66 P1 L3 Q1
o10 if [#5399 EQ -1]
(ABORT,the drawbar does not open)
o10 endif
M65 P1
M66 P1 L4 Q1
G53 G0 X0
o<toolchange> endsub
";

/// The machine of a case.
struct Plant {
    shop: Shop,
    case: Case,
    drives: Option<Drives>,
    operator: Operator,
    /// Setpoints from which the machine has to stop.
    stops: Vec<u64>,
}

fn shop(case: &Case) -> Shop {
    let workshop = Workshop::new();
    let shipped = workshop.mill(
        "faults",
        &[
            ("rate = \"rational\"  ", "rate = 1000.0  "),
            ("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 800 "),
        ],
    );
    let text = std::fs::read_to_string(shipped).expect("a machine file");
    let extra = EXTRA.replace(
        "CHANGE",
        if case.is_operator {
            "operator"
        } else {
            "subroutine"
        },
    );
    let machine = workshop.write("machine.toml", text + &extra);
    std::fs::create_dir(workshop.path("subroutines")).expect("a folder");
    let _file = workshop.write("subroutines/toolchange.ngc", CHANGE);
    let _file = workshop.write("tools.tbl", "T2 P2 Z1\nT3 P3 Z2\nT4 P4\nT5 P5\nT6 P6\nT7 P7\n");
    Shop {
        workshop,
        domain: Domain::new(),
        machine,
        name: "faults",
    }
}

pub(crate) fn rests(status: &Status) -> bool {
    status.velocity.iter().all(|v| *v == 0.0)
}

/// Clears alarms, switches the machine on, homes the axes of this mask, and names the tool if it is unknown.
pub(crate) fn recovers(operator: &mut Operator, axes_mask: u32) {
    let begin = Instant::now();
    while begin.elapsed() < LONGEST {
        let status = operator.now();
        let has_alarms = status.alarm_count > 0;
        if status.activity == 0 && has_alarms {
            operator.request(&command("CLEAR_ALARMS"));
        }
        match status.machine_state {
            0 => drop(operator.request(&command("ESTOP_RESET"))),
            1 => drop(operator.request(&command("ON"))),
            _ if status.activity == 0 && !has_alarms => {
                if status.homed_mask & axes_mask != axes_mask {
                    operator.says_number("MODE", MANUAL);
                    let job = operator.says("HOME").job;
                    assert_eq!(operator.sees_end(job).job_result, DONE, "homing");
                }
                if status.switches & switches::TOOL_UNKNOWN != 0 {
                    operator.says_number("MODE", MDI);
                    let job = operator.says_text("MDI", "M61 Q2").job;
                    assert_eq!(operator.sees_end(job).job_result, DONE, "M61");
                }
                return;
            }
            _ => {}
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let status = operator.now();
    panic!(
        "the machine does not recover: {status:?} {}",
        status.alarm_sentence()
    );
}

impl Plant {
    fn start_drives(&mut self, options: &[String]) {
        if let Some(drives) = self.drives.take() {
            drop(drives);
            // Until then the inputs of the old bridge count, and the new one may not claim them. A silent one has
            // sent them longer than its feedback.
            let dropped = Instant::now();
            self.operator.waits("silence", |status| {
                u128::from(status.feedback_age_ns) > SILENCE.as_nanos() && dropped.elapsed() > SILENCE
            });
        }
        let options: Vec<&str> = options.iter().map(String::as_str).collect();
        self.drives = Some(Drives::start(&self.shop.machine, &self.shop.domain, &options));
        self.operator
            .waits("drives", |status| status.feedback_age_ns < 100_000_000);
    }

    /// Causes the fault, unless the bridge does.
    fn acts(&mut self) {
        match self.case.trouble {
            Trouble::Hold => {
                let answer = self.operator.request(&command("HOLD"));
                if answer.verdict == 0 {
                    self.stops.push(answer.sequence);
                }
                std::thread::sleep(Duration::from_secs_f64(self.case.pause_s));
                let status = self.operator.now();
                assert!(
                    rests(&status) || self.case.pause_s < 0.4 || self.case.taps,
                    "no rest {} s after HOLD",
                    self.case.pause_s
                );
                self.operator.request(&command("RESUME"));
            }
            Trouble::Stop | Trouble::EmergencyStop => {
                let name = if self.case.trouble == Trouble::Stop {
                    "STOP"
                } else {
                    "ESTOP"
                };
                let answer = self.operator.request(&command(name));
                if answer.verdict == 0 {
                    self.stops.push(answer.sequence);
                }
            }
            Trouble::BridgeKilled => {
                drop(self.drives.take());
                std::thread::sleep(Duration::from_secs_f64(0.25 + self.case.pause_s));
                let healthy = self.case.healthy();
                self.start_drives(&healthy);
            }
            _ => {}
        }
    }

    /// Starts the program and operates the machine until it ends. Returns the last status, or `None` if the
    /// program could not be started.
    fn drives_program(&mut self) -> Option<Status> {
        let program = self.shop.workshop.write("part.ngc", &self.case.program);
        self.operator.says_number("MODE", AUTO);
        self.operator.says_text("LOAD", &program.display().to_string());
        let answer = self.operator.request(&command("START"));
        if answer.verdict != 0 {
            // A fault of the bridge may come before the start.
            let status = self.operator.now();
            assert!(
                self.case.trouble.is_of_bridge() && status.alarm_count > 0,
                "{}",
                answer.text()
            );
            return None;
        }
        let begin = Instant::now();
        let mut is_due = true;
        let mut requested: Option<Instant> = None;
        loop {
            let job = answer.job;
            let status = self.operator.waits("a status", |_| true);
            if status.job == job && status.job_result != 0 {
                return Some(status);
            }
            if is_due && begin.elapsed().as_secs_f64() >= self.case.moment_s {
                is_due = false;
                self.acts();
                continue;
            }
            if status.tool_change == 1 {
                let since = requested.get_or_insert_with(Instant::now).elapsed();
                if self.case.trouble == Trouble::ChangerSilent {
                    if since > Duration::from_millis(600) {
                        self.operator.says("STOP");
                    }
                } else if since > Duration::from_millis(100) {
                    self.operator.request(&command("RESUME"));
                    requested = None;
                }
            } else {
                requested = None;
                // A hold during the request for a tool.
                if status.state == HELD && !is_due && rests(&status) {
                    self.operator.request(&command("RESUME"));
                }
            }
            assert!(
                begin.elapsed() < LONGEST,
                "no end: {status:?} {} {}",
                status.alarm_sentence(),
                status.operator_message()
            );
            std::thread::sleep(Duration::from_millis(3));
        }
    }

    /// Checks the end of the program. Returns whether the fault had an effect.
    fn judges(&mut self, ended: Option<Status>) -> bool {
        let status = self
            .operator
            .waits("rest", |status| rests(status) && status.activity == 0);
        self.stops.push(status.cycles);
        let alarms = status.listed_alarms().to_vec();
        let sentence = status.alarm_sentence().to_owned();
        for alarm in &alarms {
            assert!(self.case.permits(*alarm), "alarms {alarms:?}: {sentence}");
        }
        let result = ended.map_or(FAULT, |status| status.job_result);
        let named = alarms
            .iter()
            .any(|alarm| self.case.trouble.alarms().contains(alarm));
        match self.case.trouble {
            Trouble::Nothing | Trouble::Hold | Trouble::ProbeEarly => {
                assert_eq!(result, DONE, "{alarms:?}: {sentence}");
            }
            Trouble::Stop => assert!([DONE, STOPPED].contains(&result), "{result}: {sentence}"),
            Trouble::EmergencyStop => assert_ne!(result, FAILED, "{sentence}"),
            Trouble::ChangerSilent if self.case.is_operator => assert_eq!(result, STOPPED),
            _ => {
                assert!(
                    result == DONE || [FAILED, FAULT].contains(&result) && named,
                    "result {result}, alarms {alarms:?}: {sentence}"
                );
                if result != DONE {
                    assert!(
                        sentence.contains(self.case.trouble.word()),
                        "{alarms:?}: {sentence}"
                    );
                }
            }
        }
        // These faults are in the first part of the program, so nothing can precede them.
        if matches!(self.case.trouble, Trouble::ProbeTripped | Trouble::ProbeStuck) {
            assert_eq!(result, FAILED, "{sentence}");
        }
        result != DONE
    }

    /// With healthy drives everything works again, and core and drives agree on the positions of the axes.
    fn works_again(&mut self) {
        let healthy = self.case.healthy();
        self.start_drives(&healthy);
        recovers(&mut self.operator, MILL);
        self.agrees();
        self.operator.says_number("MODE", MDI);
        for (block, at) in [
            ("G21 G90 G94 G49 G53 G0 Z0", [f64::NAN, f64::NAN, 0.0]),
            ("G0 X7 Y-3", [7.0, -3.0, 0.0]),
            ("G38.3 Z-12 F600", [7.0, -3.0, f64::NAN]),
            ("G53 G0 Z0", [7.0, -3.0, 0.0]),
            ("M3 S900", [7.0, -3.0, 0.0]),
            ("G95 G1 X8 F1", [8.0, -3.0, 0.0]),
            ("G94 M5", [8.0, -3.0, 0.0]),
        ] {
            let job = self.operator.says_text("MDI", block).job;
            let status = self.operator.sees_end(job);
            assert_eq!(status.job_result, DONE, "{block}: {}", status.alarm_sentence());
            for (found, wanted) in status.position_machine.iter().zip(at) {
                assert!(
                    wanted.is_nan() || *found == wanted,
                    "{block}: {:?}",
                    status.position_machine
                );
            }
        }
        self.agrees();
    }

    fn agrees(&mut self) {
        self.operator.waits("drives where the core is", |status| {
            (0..3).all(|axis| (status.position_actual[axis] - status.position_machine[axis]).abs() < 0.01)
        });
    }
}

/// Ends the core and returns the recorded cycles. If none is missing (a busy host may keep the recorder from
/// writing), the trace is recomputed bit for bit.
fn recorded(shop: &Shop, served: Served) -> Vec<Cycle> {
    served.end().expect_code(&[0, 3]);
    let trace = shop.trace();
    let again = verify(&trace).expect("a readable trace");
    assert_eq!(again.limit_violations, 0, "{again:?}");
    if again.missing == 0 {
        assert!(again.holds() && again.uncompared == 0, "{again:?}");
    } else {
        println!(
            "not computed again: {} cycles are missing in the trace",
            again.missing
        );
    }
    let mut file = TraceFile::open(&trace).expect("a complete trace");
    file.cycles()
        .map(|cycle| cycle.expect("a readable cycle"))
        .collect()
}

/// After each stop the axes rest at least once within the bound of the contract.
fn comes_to_rest(cycles: &[Cycle], stops: &[u64]) {
    for stop in stops {
        let until = stop + ORDER_CYCLES + STOP_CYCLES;
        let from = cycles.partition_point(|cycle| cycle.sequence < *stop);
        let of_stop = &cycles[from..cycles.partition_point(|cycle| cycle.sequence < until)];
        let is_whole = of_stop.len() as u64 == until - stop;
        let rests = |cycle: &Cycle| cycle.velocity.iter().all(|v| *v == 0.0);
        assert!(
            !is_whole || of_stop.iter().any(rests),
            "no rest from {stop} to {until}"
        );
    }
}

/// Plays a case and returns its outcome.
fn play(case: &Case) -> String {
    let shop = shop(case);
    let state = shop.workshop.path("state");
    let trace = shop.trace().display().to_string();
    let served = Served::start(
        &shop.machine,
        shop.name,
        &shop.domain,
        &state,
        &["--trace", &trace],
    );
    let operator = Operator::join(shop.name, &shop.domain);
    let mut plant = Plant {
        shop,
        case: case.clone(),
        drives: None,
        operator,
        stops: Vec::new(),
    };
    plant.start_drives(&case.options());
    if case.trouble.is_of_bridge() {
        plant.operator.says("ESTOP_RESET");
        plant.operator.says("ON");
        plant.operator.waits("power", |status| {
            status.machine_state == 2 || status.alarm_count > 0
        });
    } else {
        recovers(&mut plant.operator, MILL);
    }
    let ended = plant.drives_program();
    let result = ended.map_or(0, |status| status.job_result);
    let showed = plant.judges(ended);
    plant.works_again();
    let Plant {
        shop,
        drives,
        operator,
        stops,
        ..
    } = plant;
    drop(operator);
    let cycles = recorded(&shop, served);
    drop(drives);
    keeps_limits(&shop, &cycles);
    if !case.taps {
        comes_to_rest(&cycles, &stops);
    }
    let words = [
        (case.probes, "probe"),
        (case.changes, "change"),
        (case.cuts, "cut"),
        (case.taps, "tap"),
    ];
    let parts: Vec<&str> = words
        .into_iter()
        .filter(|(has, _)| *has)
        .map(|(_, word)| word)
        .collect();
    format!(
        "{} {:?} at {:.2} s, {}{}: result {result}{}, {} cycles",
        case.seed,
        case.trouble,
        case.moment_s,
        parts.join(" "),
        if case.is_operator { ", operator" } else { "" },
        if showed { "" } else { " (had no effect)" },
        cycles.len()
    )
}

#[test]
fn random_faults_stop_the_machine_and_are_named() {
    let (first, count) = (seed(seed_of_time()), cases(USUAL_CASES) as u64);
    let waiting = Mutex::new(0..count);
    let failed = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                loop {
                    let next = waiting.lock().expect("no panic").next();
                    let Some(number) = next else { break };
                    let case = Case::new(first.wrapping_add(number));
                    // The campaign continues and reports every failure.
                    let played = std::panic::catch_unwind(|| unless_disturbed(|| play(&case)));
                    match played {
                        Ok(report) => println!("{report}"),
                        Err(_) => {
                            println!("FAILED {case:?}\n{}", case.program);
                            failed.lock().expect("no panic").push(case.seed);
                        }
                    }
                }
            });
        }
    });
    let failed = failed.into_inner().expect("no panic");
    assert!(failed.is_empty(), "seeds {failed:?}");
}
