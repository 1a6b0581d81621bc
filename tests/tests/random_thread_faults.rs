//! Random threads and taps on a served lathe whose spindle is simulated with inertia, ripple, encoder and delay.
//!
//! At a random moment the spindle, a drive or the bridge fails, or an operator holds or stops. Every published
//! setpoint keeps the limits and the travel, the machine stops, the alarm names the cause, the trace is
//! recomputed bit for bit, and the next thread works.
//!
//! `EVOLVENT_CASES` makes it a campaign. Each case prints its seed: `EVOLVENT_SEED=SEED EVOLVENT_CASES=1`
//! repeats it.
#![expect(clippy::expect_used, reason = "helpers of tests fail and talk as tests do")]

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use evolvent_bus::Status;
use evolvent_machine::Machine;
use evolvent_random::{Random, cases, seed, seed_of_time};
use evolvent_replay::verify;
use evolvent_tests::job_result::{DONE, FAILED, FAULT, STOPPED};
use evolvent_tests::{Cycle, Domain, Drives, Operator, Served, Workshop, command, unless_disturbed};
use evolvent_trace::TraceFile;

use crate::random_faults::{LONGEST, Trouble, recovers, rests};
use crate::shop::{AUTO, HELD, Shop, keeps_limits};

/// Cases of a run without `EVOLVENT_CASES`.
const USUAL_CASES: usize = 4;
/// X and Z.
const LATHE: u32 = 0b101;
const SPINDLE: &str = "[[spindle]]\nmax_rpm = 4000\nfeedback = true\nat_speed_timeout_s = 4\n";

const TROUBLES: [Trouble; 12] = [
    Trouble::Nothing,
    Trouble::Hold,
    Trouble::Stop,
    Trouble::Stop,
    Trouble::Stop,
    Trouble::EmergencyStop,
    Trouble::Bridge("spindle-fault", &[440, 100]),
    Trouble::Bridge("spindle-silent", &[440, 100]),
    Trouble::Bridge("spindle-stall", &[440, 100]),
    Trouble::Bridge("spindle-slow", &[440, 100]),
    Trouble::Bridge("silent", &[401]),
    Trouble::Bridge("fault:Z", &[406]),
];

/// A program and its fault.
#[derive(Clone, Debug)]
struct Case {
    seed: u64,
    program: String,
    trouble: Trouble,
    /// Time of the fault, s after START; for a fault of the bridge, after its drives became operational.
    moment_s: f64,
    pause_s: f64,
    ripple_percent: f64,
    delay_ms: f64,
    /// The machine file gives the deceleration of the spindle.
    knows_braking: bool,
}

impl Case {
    fn new(seed: u64) -> Self {
        let mut random = Random::mixed(seed);
        let mut case = Self {
            seed,
            program: "G21 G18 G90 G8\n".to_owned(),
            trouble: *random.one_of(&TROUBLES),
            moment_s: random.between(0.05, 8.0),
            pause_s: random.between(0.05, 1.0),
            ripple_percent: random.between(0.0, 2.0),
            delay_ms: random.between(0.0, 3.0),
            knows_braking: random.below(2) == 0,
        };
        for _ in 0..2 + random.below(2) {
            let rpm = random.between(200.0, 700.0);
            let pitch = random.between(0.5, 1.5);
            let kind = random.below(4);
            // A thread may end at the limit of the travel.
            let end = if kind == 1 {
                -100.0
            } else {
                random.between(-25.0, -15.0)
            };
            let cut = match kind {
                0 | 1 => format!("G0 X15 Z{:.3}\nG33 Z{end:.3} K{pitch:.3}\nG0 X20", end + 18.0),
                2 => format!("G0 X15 Z2\nG76 P{pitch:.3} Z{end:.3} I-1 J0.5 K0.8 R1 H0 E2 L2"),
                _ => format!("G0 X0 Z2\nG33.1 Z{end:.3} K{pitch:.3}\nG0 X20"),
            };
            let _written = writeln!(case.program, "S{rpm:.0} M3\n{cut}");
        }
        case.program += "G0 X20 Z5\nM5\nM2\n";
        case
    }

    fn options(&self, is_healthy: bool) -> Vec<String> {
        let mut options: Vec<String> = [
            ("--spindle-acceleration", 3000.0),
            ("--spindle-ripple", self.ripple_percent),
            ("--spindle-delay", self.delay_ms),
        ]
        .into_iter()
        .flat_map(|(name, value)| [name.to_owned(), format!("{value:.3}")])
        .collect();
        if !is_healthy {
            options.extend(self.trouble.fault_options(self.moment_s));
        }
        options
    }
}

fn drives(shop: &Shop, operator: &mut Operator, options: &[String]) -> Drives {
    let options: Vec<&str> = options.iter().map(String::as_str).collect();
    let drives = Drives::start(&shop.machine, &shop.domain, &options);
    operator.waits("drives", |status| status.feedback_age_ns < 100_000_000);
    drives
}

/// Runs a program, with the fault unless the bridge causes it. Returns the last status, or `None` if it could
/// not be started.
fn runs(shop: &Shop, operator: &mut Operator, text: &str, case: Option<&Case>) -> Option<Status> {
    let program = shop.workshop.write("part.ngc", text);
    operator.says_number("MODE", AUTO);
    operator.says_text("LOAD", &program.display().to_string());
    let answer = operator.request(&command("START"));
    if answer.verdict != 0 {
        // A fault of the bridge may come before the start.
        let is_of_bridge = case.is_some_and(|case| case.trouble.is_of_bridge());
        assert!(
            is_of_bridge && operator.now().alarm_count > 0,
            "{}",
            answer.text()
        );
        return None;
    }
    let begin = Instant::now();
    let mut due = case.filter(|case| !case.trouble.is_of_bridge());
    loop {
        let status = operator.waits("a status", |_| true);
        if status.job == answer.job && status.job_result != 0 {
            return Some(status);
        }
        if let Some(case) = due
            && begin.elapsed().as_secs_f64() >= case.moment_s
        {
            due = None;
            match case.trouble {
                Trouble::Hold => {
                    operator.request(&command("HOLD"));
                    std::thread::sleep(Duration::from_secs_f64(case.pause_s));
                    operator.request(&command("RESUME"));
                }
                Trouble::Stop => drop(operator.request(&command("STOP"))),
                Trouble::EmergencyStop => drop(operator.request(&command("ESTOP"))),
                _ => {}
            }
            continue;
        }
        if status.state == HELD && due.is_none() && rests(&status) {
            operator.request(&command("RESUME"));
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

/// Checks the end of the program; returns its result.
fn judges(case: &Case, operator: &mut Operator, ended: Option<Status>) -> u32 {
    let status = operator.waits("rest", |status| rests(status) && status.activity == 0);
    let alarms = status.listed_alarms().to_vec();
    let sentence = status.alarm_sentence();
    let result = ended.map_or(FAULT, |status| status.job_result);
    match case.trouble {
        Trouble::Nothing | Trouble::Hold => assert_eq!(result, DONE, "{alarms:?}: {sentence}"),
        Trouble::Stop => assert!([DONE, STOPPED].contains(&result), "{result}: {sentence}"),
        Trouble::EmergencyStop => assert_ne!(result, FAILED, "{sentence}"),
        trouble => {
            let permitted = trouble.alarms();
            let named =
                alarms.iter().any(|alarm| permitted.contains(alarm)) && sentence.contains(trouble.word());
            assert!(
                result == DONE || [FAILED, FAULT].contains(&result) && named,
                "result {result}, alarms {alarms:?}: {sentence}"
            );
        }
    }
    result
}

fn keeps_travel(shop: &Shop, cycles: &[Cycle]) {
    let limits = Machine::load(&shop.machine).expect("the machine file").limits();
    for cycle in cycles {
        for axis in [0, 2] {
            let at = cycle.position[axis];
            assert!(
                at >= limits.travel_min[axis] - 1e-6 && at <= limits.travel_max[axis] + 1e-6,
                "axis {axis}: {at} at {}",
                cycle.sequence
            );
        }
    }
}

/// Plays a case and returns its outcome.
fn play(case: &Case) -> String {
    let workshop = Workshop::new();
    let braking = if case.knows_braking {
        "acceleration_rpm_s = 2500\n"
    } else {
        ""
    };
    let machine = workshop.lathe("turner", &format!("{SPINDLE}{braking}"));
    let shop = Shop {
        workshop,
        domain: Domain::new(),
        machine,
        name: "turner",
    };
    let (state, trace) = (shop.workshop.path("state"), shop.trace());
    let to = trace.display().to_string();
    let served = Served::start(&shop.machine, shop.name, &shop.domain, &state, &["--trace", &to]);
    let mut operator = Operator::join(shop.name, &shop.domain);
    let first = drives(&shop, &mut operator, &case.options(false));
    if case.trouble.is_of_bridge() {
        operator.says("ESTOP_RESET");
        operator.says("ON");
        operator.waits("power", |status| {
            status.machine_state == 2 || status.alarm_count > 0
        });
    } else {
        recovers(&mut operator, LATHE);
    }
    let ended = runs(&shop, &mut operator, &case.program, Some(case));
    let result = judges(case, &mut operator, ended);
    drop(first);
    // Until then the inputs of the old bridge count, and the new one may not claim them.
    operator.waits("silence", |status| status.feedback_age_ns > 1_200_000_000);
    let second = drives(&shop, &mut operator, &case.options(true));
    recovers(&mut operator, LATHE);
    let again = "G21 G18 G90 G8\nG0 X20 Z5\nS500 M3\nG0 X15\nG33 Z-10 K1\nG0 X20\nM5\nM2\n";
    let ended = runs(&shop, &mut operator, again, None).expect("a start");
    assert_eq!(ended.job_result, DONE, "{}", operator.now().alarm_sentence());
    drop(operator);
    served.end().expect_code(&[0, 1, 3]);
    drop(second);
    let again = verify(&trace).expect("a readable trace");
    assert_eq!(again.limit_violations, 0, "{again:?}");
    assert!(
        again.missing > 0 || again.holds() && again.uncompared == 0,
        "{again:?}"
    );
    let mut file = TraceFile::open(&trace).expect("a complete trace");
    let cycles: Vec<Cycle> = file
        .cycles()
        .map(|cycle| cycle.expect("a readable cycle"))
        .collect();
    keeps_limits(&shop, &cycles);
    keeps_travel(&shop, &cycles);
    format!(
        "{} {:?} at {:.2} s: result {result}, {} cycles",
        case.seed,
        case.trouble,
        case.moment_s,
        cycles.len()
    )
}

#[test]
fn random_faults_in_threads_stop_the_lathe_and_are_named() {
    let (first, count) = (seed(seed_of_time()), cases(USUAL_CASES) as u64);
    let mut failed = Vec::new();
    for number in 0..count {
        let case = Case::new(first.wrapping_add(number));
        // The campaign continues and reports every failure.
        match std::panic::catch_unwind(|| unless_disturbed(|| play(&case))) {
            Ok(report) => println!("{report}"),
            Err(_) => {
                println!("FAILED {case:?}\n{}", case.program);
                failed.push(case.seed);
            }
        }
    }
    assert!(failed.is_empty(), "seeds {failed:?}");
}
