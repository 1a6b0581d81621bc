//! A served machine with simulated drives that reply, fail, and die.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::PathBuf;

use evolvent_bus::ControlRequest;
use evolvent_runtime::MonotonicClock;
use evolvent_tests::job_result::{DONE, FAULT};
use evolvent_tests::{Domain, Drives, HOMING, Operator, Served, Workshop, command, unless_disturbed};

struct Scene {
    workshop: Workshop,
    machine: PathBuf,
    // In the order in which they are dropped.
    drives: Option<Drives>,
    served: Option<Served>,
    domain: Domain,
    name: String,
}

impl Scene {
    fn new(name: &str, homing: &str, drives: &[&str]) -> Self {
        Self::with_other_switches(name, homing, homing, drives)
    }

    /// Drives whose home switches are not where the core expects them.
    fn with_other_switches(name: &str, homing: &str, of_drives: &str, drives: &[&str]) -> Self {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let shipped = workshop.mill(name, &[]);
        let text = std::fs::read_to_string(shipped).expect("a machine file");
        // For busy machines: lateness is not tested here.
        let text = text.replace("feedback_timeout_ms = 20", "feedback_timeout_ms = 1000");
        let machine = workshop.write(&format!("{name}.toml"), format!("{text}\n{homing}"));
        let state = workshop.path("state");
        let trace = workshop.path("served.mcap");
        // One scene is recorded: disks of busy hosts delay the drives of the others.
        let options: &[&str] = match name {
            "drv-home" => &["--trace", trace.to_str().expect("UTF-8")],
            _ => &[],
        };
        let served = Served::start(&machine, name, &domain, &state, options);
        let theirs = workshop.write("drives.toml", format!("{text}\n{of_drives}"));
        let bridge = Drives::start(&theirs, &domain, drives);
        Self {
            workshop,
            machine,
            drives: Some(bridge),
            served: Some(served),
            domain,
            name: name.to_owned(),
        }
    }

    fn operator(&self) -> Operator {
        let mut operator = Operator::join(&self.name, &self.domain);
        operator.waits("drives", |status| status.feedback_age_ns < 1_000_000_000);
        operator
    }

    /// The trace, while the scene exists.
    fn trace(&self) -> PathBuf {
        self.workshop.path("served.mcap")
    }

    fn end(mut self) -> Self {
        self.drives = None;
        self.served.take().expect("a core").end().expect_code(&[0, 3]);
        self
    }
}

#[test]
fn homing_finds_machine_zero_with_any_encoder_error() {
    unless_disturbed(|| {
        let scene = Scene::new("drv-home", HOMING, &["--reference-offset", "7.25"]);
        let mut operator = scene.operator();
        operator.brings_up();
        let status = operator.now();
        assert_eq!(status.homed_mask, 0b010, "Y has no switch");
        assert_eq!(status.enabled_mask, 0b111);
        assert!(
            (status.position_machine[0] - 7.25).abs() < 1e-3,
            "the core stands where the drives say"
        );
        operator.says_number("MODE", 2);
        let mut mdi = command("MDI");
        assert!(mdi.set_text("G0 X1"));
        assert_eq!(operator.request(&mdi).alarm, 916);
        let status = operator.homes();
        assert_eq!(
            (status.job_result, status.homed_mask),
            (DONE, 0b111),
            "{}",
            status.alarm_sentence()
        );
        for axis in [0, 2] {
            // Latched at 5 mm/s: one sample of the drives and the delay of the bus.
            let shift = status.home_offset[axis] - 7.25;
            assert!(shift.abs() < 0.1, "axis {axis}: {shift}");
            assert_eq!(status.position_machine[axis], 0.0);
        }
        // The drives now use the coordinates of the core.
        let status = operator.waits("the drives at home", |status| {
            (0..3).all(|axis| (status.position_actual[axis] - status.position_machine[axis]).abs() < 0.01)
        });
        assert_eq!(status.alarm_count, 0);
        operator.says_number("MODE", 2);
        let job = operator.says_text("MDI", "G0 X20").job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        drop(operator);
        let scene = scene.end();
        // The trace contains what the drives measured: their lag during motion, and the remaining lag at
        // rest.
        let mut trace = evolvent_trace::TraceFile::open(&scene.trace()).expect("a complete trace");
        let errors: Vec<f64> = (trace.cycles())
            .map(|cycle| cycle.expect("a readable cycle").following_error[0].abs())
            .filter(|error| !error.is_nan())
            .collect();
        let max = errors.iter().copied().fold(0.0, f64::max);
        assert!(
            errors.len() > 100 && max > 1e-3 && max < 10.0,
            "{} of {max} mm at most",
            errors.len()
        );
    });
}

#[test]
fn a_missing_switch_ends_homing_with_its_alarm() {
    unless_disturbed(|| {
        // The simulated drives have the switch of X at the negative end.
        let wrong = HOMING.replacen(
            "towards = \"negative\"\norder = 1",
            "towards = \"positive\"\norder = 1",
            1,
        );
        let scene = Scene::with_other_switches("drv-missing", &wrong, HOMING, &[]);
        let mut operator = scene.operator();
        operator.brings_up();
        let home_x = ControlRequest {
            axes_mask: 1,
            ..command("HOME")
        };
        let job = operator.does(&home_x).job;
        let status = operator.sees_end(job);
        assert_eq!(status.job_result, FAULT);
        assert_eq!(status.listed_alarms(), [420], "{}", status.alarm_sentence());
        // The axis has stopped at the limit switch beyond the travel.
        let sentence = status.alarm_sentence().to_owned();
        assert!(sentence.contains("axis X"), "{sentence}");
        assert!(
            sentence.contains("limit switch was reached before the home switch"),
            "{sentence}"
        );
        assert_eq!(operator.request(&home_x).alarm, 918);
        operator.says("CLEAR_ALARMS");
        operator.waits("clear", |status| status.alarm_count == 0);
        operator.says("ON");
        operator.waits("power", |status| status.machine_state == 2);
        drop(operator);
        let _over = scene.end();
    });
}

#[test]
fn drive_faults_stop_with_their_alarm_and_are_reset() {
    unless_disturbed(|| {
        for (fault, alarms) in [
            ("fault@4.0:Y", [406, 407]),
            ("frozen@4.0", [402, 401]),
            ("silent@4.0", [401, 402]),
            ("jump@4.0:X", [409, 410]),
            ("ahead@4.0", [416, 416]),
            ("wild@4.0:X", [417, 417]),
        ] {
            let scene = Scene::new("drv-fault", "", &["--fault", fault]);
            let mut operator = scene.operator();
            let program = scene.workshop.long_program(30);
            operator.brings_up();
            operator.says_number("MODE", 0);
            operator.says_text("LOAD", program.to_str().expect("UTF-8"));
            let job = operator.says("START").job;
            let status = operator.sees_end(job);
            assert_eq!(status.job_result, FAULT, "{fault}");
            let first = status.listed_alarms()[0];
            assert!(
                alarms.contains(&first),
                "{fault}: {first} {}",
                status.alarm_sentence()
            );
            let status = operator.waits("off", |status| status.machine_state == 1 && status.power == 0);
            assert_eq!(status.velocity, [0.0; 9], "{fault}");
            assert_eq!(
                operator.request(&command("ON")).alarm,
                918,
                "{fault}: an alarm is latched"
            );
            // A new set of drives, and the machine continues.
            let mut scene = scene;
            scene.drives = None;
            let gone_ns = MonotonicClock::now_ns();
            scene.drives = Some(Drives::start(&scene.machine, &scene.domain, &[]));
            operator.waits("the new drives", |status| {
                status.feedback_age_ns < 200_000_000
                    && status.time_ns.saturating_sub(status.feedback_age_ns) > gone_ns
            });
            operator.says("CLEAR_ALARMS");
            operator.says("ON");
            let status = operator.waits("power or an alarm", |status| {
                status.machine_state == 2 || status.alarm_count > 0
            });
            assert_eq!(status.alarm_count, 0, "{fault}: {}", status.alarm_sentence());
            // They may count from another zero: the operator has to declare the positions.
            assert_eq!(status.homed_mask, 0, "{fault}");
            assert_eq!(operator.homes().job_result, DONE, "{fault}");
            operator.says_number("MODE", 2);
            let job = operator.says_text("MDI", "G91 G0 X5").job;
            assert_eq!(operator.sees_end(job).job_result, DONE, "{fault}");
            drop(operator);
            let _over = scene.end();
        }
    });
}

#[test]
fn an_emergency_stop_stops_axes_and_removes_power() {
    unless_disturbed(|| {
        let scene = Scene::new("drv-estop", "", &[]);
        let mut operator = scene.operator();
        let program = scene.workshop.long_program(30);
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let job = operator.says("START").job;
        operator.waits("motion", |status| status.feed_mm_s > 90.0);
        operator.says("ESTOP");
        let status = operator.sees_end(job);
        assert_eq!(status.machine_state, 0);
        let status = operator.waits("no power", |status| status.power == 0 && status.enabled_mask == 0);
        assert_eq!(status.velocity, [0.0; 9]);
        operator.brings_up();
        operator.says_number("MODE", 2);
        let job = operator.says_text("MDI", "G91 G0 X5").job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        drop(operator);
        let _over = scene.end();
    });
}

/// Drives whose link is lost for a moment, or that were exchanged: homed axes are no longer homed, unless
/// their encoders are absolute.
#[test]
fn machine_zero_is_lost_with_the_link_unless_kept() {
    unless_disturbed(|| {
        for is_absolute in [false, true] {
            let options: &[&str] = if is_absolute { &["--absolute"] } else { &[] };
            let mut scene = Scene::new("drv-link", HOMING, options);
            let mut operator = scene.operator();
            operator.brings_up();
            let job = operator.says("HOME").job;
            let status = operator.sees_end(job);
            assert_eq!(
                (status.job_result, status.homed_mask),
                (DONE, 0b111),
                "{}",
                status.alarm_sentence()
            );
            operator.says("OFF");
            operator.waits("no power", |status| status.power == 0);
            scene.drives = None;
            // At other positions than those of the previous drives, if the reference is not kept.
            let offset: &[&str] = if is_absolute {
                &["--absolute"]
            } else {
                &["--reference-offset", "11.5"]
            };
            scene.drives = Some(Drives::start(&scene.machine, &scene.domain, offset));
            let gone_ns = MonotonicClock::now_ns();
            operator.waits("the new drives", |status| {
                status.feedback_age_ns < 200_000_000
                    && status.time_ns.saturating_sub(status.feedback_age_ns) > gone_ns
            });
            let status = operator.now();
            if is_absolute {
                assert_eq!(
                    (status.homed_mask, status.alarm_count),
                    (0b111, 0),
                    "{}",
                    status.alarm_sentence()
                );
            } else {
                assert_eq!(status.homed_mask, 0);
                assert_eq!(status.listed_alarms(), [418], "{}", status.alarm_sentence());
                let sentence = status.alarm_sentence();
                assert!(
                    sentence.contains("home XYZ again") && sentence.contains("jog to Y0 first"),
                    "{sentence}"
                );
                operator.says("ON");
                operator.waits("power", |status| status.machine_state == 2);
                operator.says_number("MODE", 2);
                let mut mdi = command("MDI");
                assert!(mdi.set_text("G0 X1"));
                assert_eq!(operator.request(&mdi).alarm, 916);
                // X and Z search their switches; Y has none, and the operator declares its position.
                let status = operator.homes();
                assert_eq!(
                    (status.job_result, status.homed_mask),
                    (DONE, 0b111),
                    "{}",
                    status.alarm_sentence()
                );
                assert_eq!(status.position_machine[1], 0.0);
            }
            drop(operator);
            let _over = scene.end();
        }
    });
}

/// A bridge that reports impossible positions before power is on: the core keeps its own.
#[test]
fn impossible_positions_without_power_are_ignored() {
    unless_disturbed(|| {
        let mut scene = Scene::new("drv-wild", "", &[]);
        let mut operator = scene.operator();
        scene.drives = None;
        let before = operator.now();
        let client = scene.domain.client("drv-wild");
        let mut bridge = client.feedback_sender().expect("a bridge's place");
        let hour_ns = 3_600_000_000_000;
        let wrong: [fn(&mut evolvent_bus::Feedback, u64); 4] = [
            |feedback, _| feedback.position[0] = 1e308,
            |feedback, _| feedback.position[1] = -1e9,
            |feedback, ahead| feedback.time_ns += ahead,
            |feedback, _| feedback.datum = u64::MAX,
        ];
        for spoil in wrong {
            for _ in 0..50 {
                let mut feedback = evolvent_bus::Feedback {
                    time_ns: MonotonicClock::now_ns(),
                    axes_mask: 0b111,
                    instance: 5,
                    position: [7.0; 9],
                    ..evolvent_bus::Feedback::default()
                };
                spoil(&mut feedback, hour_ns);
                bridge.send(&feedback).expect("sent");
                std::thread::sleep(std::time::Duration::from_millis(2));
            }
            let status = operator.now();
            assert_eq!(status.position_machine, before.position_machine);
            assert!(
                status
                    .position_actual
                    .iter()
                    .all(|position| position.abs() < 1000.0),
                "{status:?}"
            );
        }
        drop((bridge, client, operator));
        let _over = scene.end();
    });
}
