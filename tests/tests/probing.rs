//! Probing on a served machine, with simulated drives and a simulated probe.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::PathBuf;

use evolvent_bus::{ControlRequest, switches};
use evolvent_replay::verify;
use evolvent_tests::job_result::{DONE, FAILED};
use evolvent_tests::{Domain, Drives, Operator, Served, Workshop, command, repository, unless_disturbed};

const BAD_PROGRAM: u32 = 923;
const BEYOND_TRAVEL: u32 = 919;

struct Shop {
    workshop: Workshop,
    machine: PathBuf,
    name: &'static str,
    domain: Domain,
}

impl Shop {
    fn new(name: &'static str) -> Self {
        let workshop = Workshop::new();
        let text = std::fs::read_to_string(workshop.mill(
            name,
            &[("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 1000 ")],
        ))
        .expect("a machine file");
        let cycles = repository().join("config/probing");
        let extra = format!(
            "\n[program]\nsubroutines = [{:?}]\nlog_folder = \"results\"\n[probe]\novertravel_mm = 2\n\
             [signals]\ninput_timeout_ms = 2000\n",
            cycles.display().to_string()
        );
        let machine = workshop.write(&format!("{name}-probe.toml"), text + &extra);
        Self {
            workshop,
            machine,
            name,
            domain: Domain::new(),
        }
    }

    fn serves(&self, options: &[&str]) -> Served {
        Served::start(
            &self.machine,
            self.name,
            &self.domain,
            &self.workshop.path("state"),
            options,
        )
    }

    fn drives(&self, probe: &str) -> Drives {
        Drives::start(&self.machine, &self.domain, &["--probe", probe])
    }

    /// An operator in MDI, with the machine on.
    fn operator(&self) -> Operator {
        let mut operator = Operator::join(self.name, &self.domain);
        operator.waits("drives", |status| status.feedback_age_ns < u64::MAX);
        operator.brings_up();
        operator.says_number("MODE", 2);
        operator
    }

    fn result(&self, name: &str) -> String {
        std::fs::read_to_string(self.workshop.path("results").join(name)).expect("a log file")
    }

    fn numbers(&self, name: &str) -> Vec<f64> {
        let text = self.result(name);
        text.split_whitespace()
            .map(|word| word.parse().expect("a number"))
            .collect()
    }
}

fn mdi(text: &str) -> ControlRequest {
    let mut request = command("MDI");
    assert!(request.set_text(text));
    request
}

#[track_caller]
fn does(operator: &mut Operator, text: &str) {
    let job = operator.does(&mdi(text)).job;
    let status = operator.sees_end(job);
    assert_eq!(status.job_result, DONE, "{text}: {}", status.alarm_sentence());
}

#[test]
fn a_bore_is_measured_and_its_points_are_logged() {
    unless_disturbed(|| {
        let shop = Shop::new("pr-bore");
        let trace = shop.workshop.path("bore.mcap");
        let served = shop.serves(&[&format!("--trace={}", trace.display())]);
        // Centre X5 Y-4, diameter 30, below Z-3: contacts are reported 3 ms late, with their true time.
        let _drives = shop.drives("bore:5,-4,30,-3;delay=3");
        let mut operator = shop.operator();
        let program = shop.workshop.write(
            "bore.ngc",
            "G21 G90 F2000
G1 X4 Y-3
G1 Z-6
(PROBEOPEN points.txt)
o<probe_bore> call [25] [0] [400] [60] [1]
(PROBECLOSE)
(LOGAPPEND,bore.txt)
(LOG,%.6f#<_probe_x> %.6f#<_probe_y> %.6f#<_probe_diameter>)
(LOGCLOSE)
G0 Z5
M2
",
        );
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let job = operator.says("START").job;
        let tripped = operator.waits("contact", |status| status.switches & switches::PROBE_TRIPPED != 0);
        assert_eq!(tripped.switches & switches::PROBE_OPEN, 0);
        // A file that is being written is not visible.
        assert!(!shop.workshop.path("results/points.txt").exists());
        let status = operator.sees_end(job);
        assert_eq!(status.job_result, DONE, "{}", status.alarm_sentence());
        assert!(status.switches & switches::PROBE_OPEN != 0);
        // At 60 mm/min the drives follow within micrometres, and the motion in one period is negligible.
        for (found, expected) in shop.numbers("bore.txt").iter().zip([5.0, -4.0, 30.0]) {
            assert!((found - expected).abs() < 0.01, "{found} is not {expected}");
        }
        let points = shop.numbers("points.txt");
        assert_eq!(points.len(), 12 * 9);
        for point in points.chunks(9) {
            let radius = (point[0] - 5.0).hypot(point[1] + 4.0);
            assert!((radius - 15.0).abs() < 0.05, "{point:?}");
            assert!(
                (point[2] + 6.0).abs() < 0.01 && point[3..] == [0.0; 6],
                "{point:?}"
            );
        }
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let verified = verify(&trace).expect("a trace that can be verified");
        assert!(verified.holds() && !verified.lacks_data(), "{verified:?}");
    });
}

/// Formerly `G0 Z[#5063+2]` moved to Z 2 instead of 2 mm above the contact.
#[test]
fn probe_results_are_available_in_the_next_mdi_block() {
    unless_disturbed(|| {
        let shop = Shop::new("pr-next");
        let trace = shop.workshop.path("next.mcap").display().to_string();
        let served = shop.serves(&["--trace", &trace]);
        let _drives = shop.drives("plane:Z<-5");
        let mut operator = shop.operator();
        does(&mut operator, "G21 G0 Z-2");
        let job = operator.does(&mdi("G38.2 Z-15 F300")).job;
        let probing = operator.waits("the probing feed", |status| status.feed_mm_s > 4.9);
        let to_go = probing.distance_to_go[2];
        assert!(
            (probing.feed_programmed_mm_s, probing.line) == (5.0, 1) && (-13.0..-9.0).contains(&to_go),
            "line {}, {} mm/s, {to_go} mm to go",
            probing.line,
            probing.feed_programmed_mm_s
        );
        let touched = operator.sees_end(job);
        assert_eq!((touched.job_result, touched.distance_to_go[2]), (DONE, 0.0));
        does(&mut operator, "G0 Z[#5063+2]");
        let at = operator.now().position_machine[2];
        assert!((at + 3.0).abs() < 0.05, "Z {at}");
        // They are kept until the next probing move.
        does(&mut operator, "G0 Z[#5063+#5070+2]");
        let at = operator.now().position_machine[2];
        assert!((at + 2.0).abs() < 0.05, "Z {at}");
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let again = verify(std::path::Path::new(&trace)).expect("a trace");
        assert!(again.holds() && again.uncompared == 0, "{again:?}");
    });
}

/// Between contact and rapid the axes are at rest, and when the planner knows the rapid depends on its speed.
#[test]
fn a_rapid_after_a_contact_is_recomputed_bit_for_bit() {
    unless_disturbed(|| {
        let shop = Shop::new("pr-rapid");
        let trace = shop.workshop.path("rapid.mcap").display().to_string();
        let served = shop.serves(&["--trace", &trace]);
        let _drives = shop.drives("plane:Z<-3");
        let mut operator = shop.operator();
        operator.says_number("MODE", 0);
        let program = "G21 G90\nG38.2 Z-20 F600\nG0 Z0\nM2\n";
        let program = shop.workshop.write("rapid.ngc", program);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        for _ in 0..5 {
            let job = operator.says("START").job;
            assert_eq!(operator.sees_end(job).job_result, DONE);
        }
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let again = verify(std::path::Path::new(&trace)).expect("a trace");
        assert!(again.holds() && again.uncompared == 0, "{again:?}");
    });
}

#[test]
fn what_a_contact_is_late_by_is_feed_times_time() {
    unless_disturbed(|| {
        let mut found = Vec::new();
        for (name, probe) in [("pr-plane", "plane:Z<-5"), ("pr-late", "plane:Z<-5;late=20")] {
            let shop = Shop::new(name);
            let served = shop.serves(&[]);
            let _drives = shop.drives(probe);
            let mut operator = shop.operator();
            does(&mut operator, "G21 G0 Z-2");
            does(&mut operator, "(PROBEOPEN plane.txt) G38.2 Z-15 F300");
            found.push(shop.numbers("plane.txt")[2]);
            // Already tripped: an error, and nothing moves.
            let before = operator.now().position_machine;
            let job = operator.does(&mdi("G38.2 Z-15 F300")).job;
            let status = operator.sees_end(job);
            assert_eq!((status.job_result, status.position_machine), (FAILED, before));
            assert!(
                status.alarm_sentence().contains("tripped before"),
                "{}",
                status.alarm_sentence()
            );
            operator.says("CLEAR_ALARMS");
            does(&mut operator, "G38.4 Z0 F300");
            does(&mut operator, "G0 Z0");
            // No contact; too fast for the remaining distance; beyond the travel.
            let job = operator.does(&mdi("G38.2 Z-4 F300")).job;
            let status = operator.sees_end(job);
            assert_eq!(status.job_result, FAILED);
            // The block has one line, whatever was inserted before it.
            let sentence = status.alarm_sentence();
            assert!(
                sentence.starts_with("line 1: ") && sentence.contains("without contact"),
                "{sentence}"
            );
            operator.says("CLEAR_ALARMS");
            for (block, alarm, word) in [
                ("G38.2 Z-9 F15000", BAD_PROGRAM, "overtravel_mm is 2"),
                ("G38.2 Z-900 F300", BEYOND_TRAVEL, "Z"),
            ] {
                let refused = operator.request(&mdi(block));
                assert_eq!(refused.alarm, alarm, "{}", refused.text());
                assert!(refused.text().contains(word), "{}", refused.text());
            }
            // Files in other folders are rejected before anything moves.
            let refused = operator.request(&mdi("(LOGOPEN,../elsewhere.txt)"));
            assert_eq!(refused.alarm, BAD_PROGRAM, "{}", refused.text());
            drop(operator);
            served.end().expect_code(&[0, 3]);
        }
        // 300 mm/min for 20 ms are 100 um.
        assert!((found[0] + 5.0).abs() < 0.01, "{found:?}");
        let late_by = found[0] - found[1];
        assert!((late_by - 0.1).abs() < 0.01, "{found:?}");
    });
}
