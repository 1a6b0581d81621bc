//! A tool changer that a subroutine operates: a served machine with a simulated bridge, whose outputs are
//! wired to its inputs.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::PathBuf;

use evolvent_bus::{ControlRequest, Status, switches};
use evolvent_replay::verify;
use evolvent_tests::job_result::{DONE, FAILED, STOPPED};
use evolvent_tests::{Domain, Drives, Operator, Served, Workshop, command, unless_disturbed};

/// Alarms.
const PROGRAM: u32 = 100;
const CHANGE_BROKEN_OFF: u32 = 103;
const BAD_PROGRAM: u32 = 923;
const TOOL_UNKNOWN: u32 = 930;

const EXTRA: &str = "
[program]
tool_change = \"subroutine\"
magazine = \"random\"
tool_table = \"tools.tbl\"
subroutines = [\"subroutines\"]
[signals]
input_timeout_ms = 2000
[[output]]
name = \"drawbar\"
number = 1
[[input]]
name = \"open\"
number = 1
[[input]]
name = \"carousel\"
number = 2
";

/// To the pocket, drawbar open and closed. The carousel never reaches tool 5, and the drawbar does not open
/// for tool 6.
const CHANGE: &str = "o<toolchange> sub
G21 G90 G53 G1 X[#3] F6000
o10 if [#1 EQ 5]
M66 P2 L3 Q100
o10 endif
o20 if [#1 NE 6]
M64 P1
o20 endif
M66 P1 L3 Q2
o30 if [#5399 EQ -1]
(ABORT,the drawbar does not open)
o30 endif
M65 P1
M66 P1 L4 Q2
G53 G1 X0
o<toolchange> endsub
";

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
        let machine = workshop.write(&format!("{name}-changer.toml"), format!("{text}{EXTRA}"));
        std::fs::create_dir(workshop.path("subroutines")).expect("a folder");
        let _file = workshop.write("subroutines/toolchange.ngc", CHANGE);
        let _file = workshop.write("tools.tbl", "T2 P12\nT3 P13\nT5 P15\nT6 P16\nT0 P10\n");
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

    fn drives(&self) -> Drives {
        Drives::start(&self.machine, &self.domain, &["--loopback"])
    }

    fn operator(&self) -> Operator {
        let mut operator = Operator::join(self.name, &self.domain);
        operator.waits("drives", |status| status.feedback_age_ns < u64::MAX);
        operator
    }

    /// Tool and pocket on the disk, in the order of the tools.
    fn pockets(&self) -> Vec<(u32, u32)> {
        let text = std::fs::read_to_string(self.workshop.path("tools.tbl")).expect("a table");
        let table = evolvent_gcode::ToolTable::parse(&text).expect("a table");
        let mut rows: Vec<_> = table
            .tools()
            .iter()
            .map(|tool| (tool.number, tool.pocket))
            .collect();
        rows.sort_unstable();
        rows
    }

    fn is_marked(&self) -> bool {
        self.workshop.path("state/tool-change").exists()
    }

    fn starts(&self, operator: &mut Operator, text: &str) -> u64 {
        let program = self.workshop.write("part.ngc", text);
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        operator.says("START").job
    }
}

fn mdi(text: &str) -> ControlRequest {
    let mut request = command("MDI");
    assert!(request.set_text(text));
    request
}

/// Declares the tool after an aborted change.
fn names_tool(operator: &mut Operator, tool: u32) {
    operator.says_number("MODE", 2);
    let job = operator.does(&mdi(&format!("M61 Q{tool}"))).job;
    assert_eq!(operator.sees_end(job).job_result, DONE);
}

#[test]
fn tools_move_between_pockets_and_survive_a_restart() {
    unless_disturbed(|| {
        let shop = Shop::new("tch-swap");
        let trace = shop.workshop.path("swap.mcap");
        let option = format!("--trace={}", trace.display());
        let served = shop.serves(&[&option]);
        let drives = shop.drives();
        let mut operator = shop.operator();
        operator.brings_up();
        let job = shop.starts(
            &mut operator,
            "G21 G91 F3000\nT2 M6\nG1 X3\nT3 M6\nT2 M6\nG1 X4\nM2\n",
        );
        let status = operator.waits("the first change", |status| status.tool_change == 2);
        assert_eq!((status.tool, status.tool_wanted), (0, 2));
        // The status may report it first; nothing has moved before the mark is on the disk.
        let begun = std::time::Instant::now();
        loop {
            let position = operator.now().position_machine;
            if shop.is_marked() {
                break;
            }
            assert_eq!(position[..3], [0.0; 3], "moved without a mark");
            assert!(begun.elapsed() < std::time::Duration::from_secs(10), "no mark");
        }
        let status = operator.sees_end(job);
        assert_eq!(
            (status.job_result, status.tool),
            (DONE, 2),
            "{}",
            status.alarm_sentence()
        );
        // Incremental as before, at the previous feed: 3 in the first, 4 from 0 after the last change.
        assert_eq!(status.position_machine[0], 4.0);
        assert!(!shop.is_marked());
        // By hand: 12 is empty, then has 2, then 3.
        assert_eq!(shop.pockets(), [(0, 12), (2, 0), (3, 13), (5, 15), (6, 16)]);
        // A stop after a change keeps the tool in the spindle, and saves it at once.
        operator.says_number("MODE", 0);
        let job = shop.starts(&mut operator, "G21\nT3 M6\nG4 P60\nM2\n");
        operator.waits("the dwell", |status| status.tool == 3 && status.state == 6);
        while shop.is_marked() {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        assert_eq!(shop.pockets(), [(0, 12), (2, 13), (3, 0), (5, 15), (6, 16)]);
        operator.says("STOP");
        assert_eq!(operator.sees_end(job).job_result, STOPPED);
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let verified = verify(&trace).expect("a trace that can be verified");
        assert!(verified.holds() && !verified.lacks_data(), "{verified:?}");
        drop(drives);
        let served = shop.serves(&[]);
        let _drives = shop.drives();
        let mut operator = shop.operator();
        assert_eq!(operator.now().tool, 3);
        operator.brings_up();
        // The same tool again requires no action of the changer.
        let job = shop.starts(&mut operator, "G21\nT3 M6\nT0 M6\nM2\n");
        assert_eq!(operator.sees_end(job).tool, 0);
        assert_eq!(shop.pockets(), [(0, 0), (2, 13), (3, 12), (5, 15), (6, 16)]);
        drop(operator);
        served.end().expect_code(&[0, 3]);
    });
}

#[test]
fn a_power_cut_in_a_change_leaves_the_tool_unknown() {
    unless_disturbed(|| {
        let shop = Shop::new("tch-cut");
        let served = shop.serves(&[]);
        let drives = shop.drives();
        let mut operator = shop.operator();
        operator.brings_up();
        shop.starts(&mut operator, "G21\nT2 M6\nT5 M6\nM2\n");
        operator.waits("the carousel", |status| {
            status.tool == 2 && status.tool_wanted == 5
        });
        let waits_there = |status: &Status| status.position_machine[0] == 15.0 && status.state == 7;
        operator.waits("the pocket", waits_there);
        assert!(shop.is_marked());
        drop(operator);
        served.kill();
        drop(drives);
        let served = shop.serves(&[]);
        let _drives = shop.drives();
        let mut operator = shop.operator();
        let status = operator.waits("the alarm", |status| status.alarms.contains(&CHANGE_BROKEN_OFF));
        assert!(
            status.alarm_sentence().contains("from tool 2 to tool 5"),
            "{}",
            status.alarm_sentence()
        );
        operator.says("CLEAR_ALARMS");
        operator.brings_up();
        let program = shop.workshop.write("plain.ngc", "G21 F1000\nG1 X1\nM2\n");
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        let refused = operator.request(&command("START"));
        assert_eq!(refused.alarm, TOOL_UNKNOWN, "{}", refused.text());
        assert!(refused.text().contains("M61"), "{}", refused.text());
        // Moves are possible, to clear the changer; a change is not.
        operator.says_number("MODE", 2);
        let job = operator.does(&mdi("G0 X3")).job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        let refused = operator.request(&mdi("T3 M6"));
        assert_eq!(refused.alarm, BAD_PROGRAM, "{}", refused.text());
        assert!(
            refused.text().contains("the tool in the spindle is unknown"),
            "{}",
            refused.text()
        );
        assert!(shop.is_marked());
        names_tool(&mut operator, 5);
        assert!(!shop.is_marked());
        assert_eq!(shop.pockets(), [(0, 12), (2, 15), (3, 13), (5, 0), (6, 16)]);
        let job = shop.starts(&mut operator, "G21\nT3 M6\nM2\n");
        assert_eq!(operator.sees_end(job).tool, 3);
        drop(operator);
        served.end().expect_code(&[0, 3]);
    });
}

#[test]
fn stops_and_failures_in_a_change_lose_the_tool() {
    unless_disturbed(|| {
        let shop = Shop::new("tch-stop");
        let served = shop.serves(&[]);
        let _drives = shop.drives();
        let mut operator = shop.operator();
        operator.brings_up();
        // Held during the move to the pocket, at 6 m/min over 12 mm.
        let job = shop.starts(&mut operator, "G21\nT2 M6\nM2\n");
        operator.waits("the change", |status| status.tool_change == 2);
        operator.says("HOLD");
        std::thread::sleep(std::time::Duration::from_millis(100));
        let status = operator.now();
        assert_eq!((status.tool, status.tool_change), (0, 2));
        operator.says("RESUME");
        assert_eq!(operator.sees_end(job).tool, 2);
        // Stopped while it waits for the carousel.
        let job = shop.starts(&mut operator, "G21\nT5 M6\nM2\n");
        operator.waits("the pocket", |status| status.position_machine[0] == 15.0);
        operator.says("STOP");
        let status = operator.sees_end(job);
        assert_eq!((status.job_result, status.tool_change), (STOPPED, 0));
        let status = operator.waits("the alarm", |status| status.alarms.contains(&CHANGE_BROKEN_OFF));
        assert!(
            status.alarm_sentence().contains("M61"),
            "{}",
            status.alarm_sentence()
        );
        operator.says("CLEAR_ALARMS");
        assert_eq!(operator.request(&command("START")).alarm, TOOL_UNKNOWN);
        operator.waits("the unknown tool", |status| {
            status.switches & switches::TOOL_UNKNOWN != 0
        });
        names_tool(&mut operator, 2);
        operator.waits("the tool", |status| status.switches & switches::TOOL_UNKNOWN == 0);
        // A drawbar that does not open: the subroutine gives up, with file and line.
        let job = shop.starts(&mut operator, "G21\nT6 M6\nG1 X9 F100\nM2\n");
        let status = operator.sees_end(job);
        assert_eq!((status.job_result, status.tool), (FAILED, 2));
        assert_eq!(status.position_machine[0], 16.0);
        operator.waits("the alarm", |status| {
            [PROGRAM, CHANGE_BROKEN_OFF]
                .iter()
                .all(|alarm| status.alarms.contains(alarm))
        });
        operator.says("CLEAR_ALARMS");
        names_tool(&mut operator, 2);
        // Also in the emergency stop.
        let job = shop.starts(&mut operator, "G21\nT5 M6\nM2\n");
        operator.waits("the pocket", |status| status.position_machine[0] == 15.0);
        operator.says("ESTOP");
        operator.sees_end(job);
        operator.waits("the alarm", |status| status.alarms.contains(&CHANGE_BROKEN_OFF));
        operator.says("CLEAR_ALARMS");
        operator.brings_up();
        assert_eq!(operator.request(&command("START")).alarm, TOOL_UNKNOWN);
        names_tool(&mut operator, 2);
        // A tool that is not in the table is found before anything moves.
        let program = shop.workshop.write("unknown.ngc", "G21\nT77 M6\nM2\n");
        operator.says_number("MODE", 0);
        let mut load = command("LOAD");
        assert!(load.set_text(program.to_str().expect("UTF-8")));
        let refused = operator.request(&load);
        assert_eq!(refused.alarm, BAD_PROGRAM, "{}", refused.text());
        assert!(refused.text().contains("tool 77"), "{}", refused.text());
        assert!(!shop.is_marked());
        drop(operator);
        served.end().expect_code(&[0, 3]);
    });
}
