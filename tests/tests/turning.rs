//! Turning with the cutting load, in real time over the real bus: simulated drives cut a simulated stock.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use evolvent_bus::{Setpoint, Status};
use evolvent_tests::job_result::{DONE, FAULT};
use evolvent_tests::{
    Cycle, Domain, Drives, Finished, Launch, Operator, Served, Workshop, cycles, evolvent, repository, run,
    unless_disturbed,
};

/// Bit of `inputs` in the trace: a cutting load has arrived.
const LOAD_CAME: u32 = 32;
/// At rest in a hold.
const HELD: u32 = 3;

/// Simulated drives that cut the stock of a process file.
fn cutting_drives(machine: &Path, process: &Path, domain: &Domain) -> Drives {
    Drives::start(machine, domain, &["--process", process.to_str().expect("UTF-8")])
}

/// A lathe at 500 Hz that is never stopped for lateness, and a short stock. Busy hosts deliver readings late:
/// a reading may be half a second old, which a slow spindle permits.
fn scene(workshop: &Workshop, name: &str) -> (PathBuf, PathBuf) {
    let read = |file: &str| std::fs::read_to_string(repository().join(file)).expect("a shipped file");
    let machine = read("config/machines/lathe-2axis.toml")
        .replace("name = \"lathe-2axis\"", &format!("name = {name:?}"))
        .replace("rate = \"rational\"", "rate = 500")
        + "\n[realtime]\nmax_late_cycles = 0\n";
    let process = read("config/processes/turn-shaft.toml")
        .replace("length_mm = 200.0", "length_mm = 4.0")
        .replace("spindle_rpm = 500.0", "spindle_rpm = 100.0")
        .replace("[[0.0, 10.0], [200.0, 5.0]]", "[[0.0, 3.0], [4.0, 2.5]]")
        .replace("stale_ms = 10.0", "stale_ms = 300.0");
    (
        workshop.write("lathe.toml", machine),
        workshop.write("process.toml", process),
    )
}

#[test]
fn a_cycle_adapts_its_passes_to_the_measured_load() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let (machine, process) = scene(&workshop, "turn-real");
        let program = workshop.write(
            "turn.ngc",
            "G21 G18 G90 G94 G8\nS100 M3\nG0 Z308\nG0 X33.5\nG0 Z300\nF200\nG82 X60 Z296 Q1\nM2\n",
        );
        let _drives = cutting_drives(&machine, &process, &domain);
        let trace = workshop.path("turn.mcap");
        let finished = Launch::in_real_time(&program, &machine, &domain)
            .with(&["--process"])
            .with(&[process.to_str().expect("UTF-8")])
            .trace(&trace)
            .finish();
        let summary = finished.expect_code(&[0, 3]).json();
        assert_eq!(summary["outcome"], "done", "{summary}");
        let notes = summary["notes"].to_string();
        assert!(
            notes.contains("the run ends if they stop by themselves"),
            "{notes}"
        );
        // The tool has cut: at least two passes were measured, and their load is the set one.
        let turning = &summary["turning"];
        let number = |key: &str| turning[key].as_f64().expect("a number");
        assert_eq!((number("cycles"), number("done")), (1.0, 1.0), "{turning}");
        assert!(
            number("passes") >= 1.0 && number("peak_load") > 0.3 * number("set_load"),
            "{turning}"
        );
        assert!(number("peak_load") < 1.3 * number("set_load"), "{turning}");
        // There were readings far above noise, and every change has its reason.
        let table = workshop.path("events.csv");
        let exported = evolvent()
            .args(["trace", "export", "--channel", "events", "-o"])
            .arg(&table)
            .arg(&trace)
            .output()
            .expect("the binary to start");
        assert!(
            exported.status.success(),
            "{}",
            String::from_utf8_lossy(&exported.stderr)
        );
        let events = std::fs::read_to_string(table).expect("a table");
        for expected in ["contact", "settled", "end of the pass", "everything is at size"] {
            assert!(events.contains(expected), "{expected}: {events}");
        }
    });
}

#[test]
fn a_program_without_its_load_does_not_move() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let (machine, process) = scene(&workshop, "turn-none");
        let program = workshop.write(
            "turn.ngc",
            "G21 G18 G90 G94 G8\nS100 M3\nG0 Z308\nG0 X33.5\nG0 Z300\nF200\nG82 X60 Z296 Q1\nM2\n",
        );
        let trace = workshop.path("none.mcap");
        let finished = Launch::in_real_time(&program, &machine, &domain)
            .with(&["--process"])
            .with(&[process.to_str().expect("UTF-8")])
            .trace(&trace)
            .finish();
        let summary = finished.expect_code(&[1]).json();
        assert_eq!(summary["alarm"], 501, "{summary}");
        assert!(
            summary["error"].to_string().contains("no cutting load"),
            "{summary}"
        );
        let driven = cycles(&trace);
        let moved = driven.iter().any(|cycle| cycle.position != driven[0].position);
        assert!(driven.len() > 1000 && !moved, "it has moved");
    });
}

#[test]
fn a_sensor_that_reads_zero_in_a_cut_ends_the_run() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let (machine, process) = scene(&workshop, "turn-zero");
        // Long enough to cut for a minute and more.
        let text = std::fs::read_to_string(&process).expect("a process file");
        let process = workshop.write(
            "process.toml",
            text.replace("length_mm = 4.0", "length_mm = 40.0")
                .replace("[[0.0, 3.0], [4.0, 2.5]]", "[[0.0, 3.0], [40.0, 2.5]]"),
        );
        let program = workshop.write(
            "turn.ngc",
            "G21 G18 G90 G94 G8\nS100 M3\nG0 Z302\nG0 X33.5\nG0 Z300\nF200\nG82 X60 Z260 Q1\nM2\n",
        );
        let options = [
            "--process",
            process.to_str().expect("UTF-8"),
            "--fault",
            "load-zero@25",
        ];
        let _drives = Drives::start(&machine, &domain, &options);
        let finished = Launch::in_real_time(&program, &machine, &domain)
            .with(&["--no-trace", "--process"])
            .with(&[process.to_str().expect("UTF-8")])
            .finish();
        let summary = finished.expect_code(&[1]).json();
        assert_eq!(summary["alarm"], 500, "{summary}");
        assert!(summary["error"].to_string().contains("went away"), "{summary}");
        assert_eq!(summary["turning"]["done"], 0, "{summary}");
    });
}

/// A cut of more than a minute, with the load that simulated drives measure. Returns the summary of the run,
/// the output of the drives, and the result of the action meanwhile.
fn long_cut(
    name: &str,
    options: &[&str],
    disturb: impl FnOnce(&Domain, &Child),
) -> (serde_json::Value, String) {
    let (workshop, domain) = (Workshop::new(), Domain::new());
    let (machine, process) = scene(&workshop, name);
    let text = std::fs::read_to_string(&process).expect("a process file");
    let process = workshop.write(
        "process.toml",
        text.replace("length_mm = 4.0", "length_mm = 40.0")
            .replace("[[0.0, 3.0], [4.0, 2.5]]", "[[0.0, 3.0], [40.0, 2.5]]"),
    );
    let process = process.to_str().expect("UTF-8");
    let program = workshop.write(
        "turn.ngc",
        "G21 G18 G90 G94 G8\nS100 M3\nG0 Z302\nG0 X33.5\nG0 Z300\nF200\nG82 X60 Z260 Q1\nM2\n",
    );
    let mut drives = evolvent()
        .args([
            "bridge",
            "sim",
            "--bus-prefix",
            &domain.prefix,
            "--process",
            process,
        ])
        .args(["--bridge-cycles", "100", "--machine"])
        .arg(&machine)
        .args(options)
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary to start");
    let run = Launch::in_real_time(&program, &machine, &domain)
        .with(&["--no-trace", "--process", process])
        .start();
    disturb(&domain, &run);
    let finished = evolvent_tests::wait(run);
    let _gone = drives.kill();
    let output = drives.wait_with_output().expect("its messages");
    let summary = finished.expect_code(&[1]).json();
    (summary, String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn a_drive_that_fails_ends_the_run_that_cuts_with_it() {
    unless_disturbed(|| {
        let (summary, messages) = long_cut("turn-fault", &["--fault", "fault@8+0.5:Z"], |_, _| {});
        assert_eq!(summary["alarm"], 406, "{summary}");
        let error = summary["error"].to_string();
        assert!(error.contains("the drive of axis Z is in fault"), "{error}");
        assert!(error.contains("so the run was ended"), "{error}");
        assert!(
            messages.contains("no longer follow: the drive of Z is in fault"),
            "{messages}"
        );
        assert_eq!(summary["turning"]["done"], 0, "{summary}");
    });
}

/// Without setpoints the drives brake and hold, and a core that resumes at another position is no longer
/// followed.
#[test]
fn drives_stopped_during_a_suspension_end_the_run() {
    unless_disturbed(|| {
        let name = "turn-silent";
        let (summary, messages) = long_cut(name, &[], |domain, run| {
            let mut setpoints = domain.client(name).setpoints().expect("setpoints");
            let begin = Instant::now();
            // During the cut.
            while !setpoints
                .receive()
                .expect("setpoints")
                .is_some_and(|now| now.position[2] < 299.0)
            {
                assert!(begin.elapsed() < Duration::from_secs(120), "it does not come");
                std::thread::sleep(Duration::from_millis(1));
            }
            for (signal, pause) in [("-STOP", 600), ("-CONT", 0)] {
                let sent = Command::new("kill")
                    .args([signal, &run.id().to_string()])
                    .status();
                assert!(sent.expect("kill").success());
                std::thread::sleep(Duration::from_millis(pause));
            }
        });
        assert_eq!(summary["alarm"], 413, "{summary}");
        let error = summary["error"].to_string();
        assert!(
            error.contains("4 HOLDING, note 2 SILENCE") || error.contains("3 BRAKING"),
            "{error}"
        );
        assert!(
            messages.contains("no longer follow: no usable setpoints arrived for 100 periods"),
            "{messages}"
        );
    });
}

/// A program with adaptive feed: 10 mm at 60 rev/min, 0.4 mm/rev programmed.
struct AdaptiveRun {
    workshop: Workshop,
    domain: Domain,
    drives: Option<Drives>,
    child: Child,
}

const SET: f64 = 1000.0;
const TURN_S: f64 = 1.0;

impl AdaptiveRun {
    fn start(name: &str) -> Self {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let (machine, _) = scene(&workshop, name);
        let read = |file: &str| std::fs::read_to_string(repository().join(file)).expect("a shipped file");
        let process = read("config/processes/turn-shaft.toml")
            .replace("length_mm = 200.0", "length_mm = 10.0")
            .replace("spindle_rpm = 500.0", "spindle_rpm = 60.0")
            .replace("[[0.0, 10.0], [200.0, 5.0]]", "[[0.0, 0.6], [10.0, 2.4]]");
        let process = workshop.write("process.toml", process);
        let adaptive = workshop.write(
            "adaptive.toml",
            format!(
                "set_load = {SET}\noverload = 4000\noverload_ms = 50\ncontact_load = 50\n\
                 feed_exponent = 0.75\nfactor_min = 0.2\nfactor_max = 1.5\nfactor_entry = 0.8\n\
                 factor_idle = 1.5\nturn_ms = {}\nlag_ms = 15\nstale_ms = 400\nslew_up_per_s = 2\n\
                 slew_down_per_s = 100\n",
                1e3 * TURN_S
            ),
        );
        let program = workshop.write(
            "turn.ngc",
            "G21 G18 G90 G94 G8\nS60 M3\nG0 X35 Z304\nG0 X30 Z302\nG1 Z290 F24\nG0 X35\nM2\n",
        );
        let drives = cutting_drives(&machine, &process, &domain);
        let child = Launch::in_real_time(&program, &machine, &domain)
            .with(&["--adaptive"])
            .with(&[adaptive.to_str().expect("UTF-8")])
            .trace(&workshop.path("adaptive.mcap"))
            .start();
        Self {
            workshop,
            domain,
            drives: Some(drives),
            child,
        }
    }

    /// Waits until the tool has reached this position.
    fn waits_for_z(&self, name: &str, z_mm: f64) {
        let mut setpoints = self.domain.client(name).setpoints().expect("setpoints");
        let begin = Instant::now();
        let mut last = None::<Setpoint>;
        while last.is_none_or(|setpoint| setpoint.position[2] > z_mm) {
            match setpoints.receive().expect("setpoints") {
                Some(setpoint) => last = Some(setpoint),
                None => std::thread::sleep(Duration::from_millis(2)),
            }
            assert!(
                begin.elapsed() < Duration::from_secs(120),
                "it does not come: {last:?}"
            );
        }
    }

    fn finish(self) -> (Finished, Vec<Cycle>, Workshop) {
        let finished = evolvent_tests::wait(self.child);
        drop(self.drives);
        let driven = cycles(&self.workshop.path("adaptive.mcap"));
        drop(self.domain);
        (finished, driven, self.workshop)
    }
}

/// Feed of the axis along the cut, mm/s.
fn feed(cycle: &Cycle) -> f64 {
    cycle.velocity[2].abs()
}

/// The first cycle at rest after the last reading of the load, and the seconds between the two.
fn stop_after_last_reading(driven: &[Cycle]) -> (usize, f64) {
    let last = driven
        .iter()
        .rposition(|cycle| cycle.inputs & LOAD_CAME != 0)
        .expect("readings");
    let cycles_to_stop = driven[last..].iter().position(|cycle| feed(cycle) == 0.0);
    let stop = last + cycles_to_stop.expect("a stop");
    let after_s = (driven[stop].due_time_ns - driven[last].due_time_ns) as f64 * 1e-9;
    (stop, after_s)
}

#[test]
fn adaptive_feed_holds_the_measured_load() {
    unless_disturbed(|| {
        let scene = AdaptiveRun::start("adapt-real");
        let (finished, driven, _workshop) = scene.finish();
        let summary = finished.expect_code(&[0, 3]).json();
        assert_eq!(summary["outcome"], "done", "{summary}");
        // From 4 to 9 mm after the face 1.3 to 2.2 mm are cut: the factor that holds the load is within its
        // limits.
        let cut: Vec<&Cycle> = driven
            .iter()
            .filter(|cycle| {
                (291.0..296.0).contains(&cycle.position[2]) && feed(cycle) > 0.0 && feed(cycle) < 2.0
            })
            .collect();
        let mean = cut.iter().map(|cycle| cycle.load).sum::<f64>() / cut.len() as f64;
        assert!(
            cut.len() > 5000 && (mean / SET - 1.0).abs() < 0.05,
            "{mean} of {}",
            cut.len()
        );
        // The programmed feed, 0.4 mm/s, would give 1.3 to 2.2 times the load: the feed holds it.
        let last = cut.last().expect("cycles");
        assert!(feed(last) < 0.22, "{}", feed(last));
        let mut above = 0.0;
        for pair in driven.windows(2) {
            let [before, cycle] = pair else { continue };
            let step_s = (cycle.due_time_ns - before.due_time_ns) as f64 * 1e-9;
            above = if cycle.load > 1.3 * SET {
                above + step_s
            } else {
                0.0
            };
            assert!(
                above <= TURN_S,
                "above 1.3 times the set load for {above} s at {cycle:?}"
            );
        }
    });
}

#[test]
fn adaptive_feed_stops_soon_after_the_last_reading() {
    unless_disturbed(|| {
        let name = "adapt-lost";
        let mut scene = AdaptiveRun::start(name);
        scene.waits_for_z(name, 296.0);
        scene.drives = None;
        let (finished, driven, _workshop) = scene.finish();
        let summary = finished.expect_code(&[1]).json();
        assert_eq!(summary["alarm"], 501, "{summary}");
        let (stop, after_s) = stop_after_last_reading(&driven);
        assert!(after_s <= TURN_S, "{after_s} s after the last reading");
        assert!(
            driven[stop..].iter().all(|cycle| feed(cycle) == 0.0),
            "it moves again"
        );
        assert!(driven[stop].position[2] > 290.5, "in the middle of the cut");
    });
}

/// `evolvent ctl`; its code must be 0.
fn ctl(domain: &Domain, name: &str, command: &[&str]) -> Finished {
    let common = ["ctl", "--machine-name", name, "--bus-prefix", &domain.prefix];
    run(common.iter().chain(command)).expect_code(&[0])
}

/// A served lathe with a process file and simulated drives that cut its stock.
struct ServedLathe {
    drives: Option<Drives>,
    served: Option<Served>,
    operator: Operator,
    workshop: Workshop,
    domain: Domain,
    name: String,
}

impl ServedLathe {
    fn start(name: &str, kind: &str, program: &str) -> Self {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let (machine, process) = scene(&workshop, name);
        if kind == "facing" {
            let text = std::fs::read_to_string(&process).expect("a process file");
            let text = text
                .replace("longitudinal", "facing")
                .replace("z_mm = 300.0", "z_mm = 296.0");
            std::fs::write(&process, text).expect("a process file");
        }
        // Only the sensor may be missing.
        let text = std::fs::read_to_string(&machine).expect("a machine file");
        let machine = workshop.write("lathe.toml", text + "\n[drives]\nfeedback = \"ignore\"\n");
        let program = workshop.write("turn.ngc", program);
        let trace = workshop.path("served.mcap");
        let options = ["--process", process.to_str().expect("UTF-8")];
        let recorded = ["--trace", trace.to_str().expect("UTF-8")];
        let options: Vec<&str> = options.into_iter().chain(recorded).collect();
        let served = Served::start(&machine, name, &domain, &workshop.path("state"), &options);
        let drives = cutting_drives(&machine, &process, &domain);
        let operator = Operator::join(name, &domain);
        let scene = Self {
            drives: Some(drives),
            served: Some(served),
            operator,
            workshop,
            domain,
            name: name.to_owned(),
        };
        ctl(&scene.domain, name, &["up"]);
        ctl(&scene.domain, name, &["load", program.to_str().expect("UTF-8")]);
        scene
    }

    fn ctl(&self, command: &[&str]) {
        ctl(&self.domain, &self.name, command);
    }

    /// Waits until the tip is well past the start of the job along this axis, where it cuts.
    fn waits_for_cut(&mut self, axis: usize, position_mm: f64) {
        self.operator
            .waits("a cut", |status| status.position_machine[axis] < position_mm);
    }

    /// Holds it while it cuts, up to 2.5 mm past this position. A busy host may deliver the command after the
    /// pass: then the next pass is held.
    fn holds_in_the_cut(&mut self, axis: usize, position_mm: f64) -> Status {
        let held = (0..3).find_map(|_| {
            self.waits_for_cut(axis, position_mm);
            self.ctl(&["hold"]);
            let held = self
                .operator
                .waits("rest in a hold", |status| status.state == HELD);
            if (position_mm - 2.5..position_mm).contains(&held.position_machine[axis]) {
                return Some(held);
            }
            self.ctl(&["resume"]);
            let is_before = |status: &Status| status.position_machine[axis] > position_mm;
            self.operator.waits("the next pass", is_before);
            None
        });
        held.expect("a pass that is not over before it is held")
    }

    /// Returns every cycle and the events; the trace was recomputed.
    fn end(mut self) -> (Vec<Cycle>, String) {
        drop(self.operator);
        self.served.take().expect("a core").end().expect_code(&[0, 3]);
        drop(self.drives);
        let trace = self.workshop.path("served.mcap");
        let table = self.workshop.path("events.csv");
        let export = ["trace", "export", "--channel", "events", "-o"].map(std::ffi::OsString::from);
        run(export
            .into_iter()
            .chain([table.clone().into(), trace.clone().into()]))
        .expect_code(&[0]);
        let verified = run([Path::new("trace"), Path::new("verify"), &trace]);
        // Everything was recomputed with the same result; setpoints may have been late.
        let verified = verified.expect_code(&[0, 3]);
        assert!(!verified.out.contains("not compared"), "{}", verified.out);
        (cycles(&trace), std::fs::read_to_string(table).expect("a table"))
    }
}

const LONGITUDINAL: &str =
    "G21 G18 G90 G94 G8\nS100 M3\nG0 Z308\nG0 X33.5\nG0 Z300\nF200\nG82 X60 Z296 Q1\nM2\n";
/// From a diameter of 60 mm to one of 52, to a face at Z296.
const FACING: &str = "G21 G18 G90 G94 G8\nS100 M3\nG0 X38\nG0 Z299.5\nG0 X30\nF200\nG75 X52 Z296 Q1\nM2\n";

#[test]
fn served_load_adaptive_cycles_are_held_and_resumed() {
    unless_disturbed(|| {
        for (name, kind, program, axis, position_mm) in [
            ("turn-served", "longitudinal", LONGITUDINAL, 2, 298.5),
            ("face-served", "facing", FACING, 0, 28.5),
        ] {
            let mut scene = ServedLathe::start(name, kind, program);
            scene.ctl(&["start"]);
            let held = scene.holds_in_the_cut(axis, position_mm);
            std::thread::sleep(Duration::from_millis(500));
            let position = scene.operator.now().position_machine;
            assert_eq!(position, held.position_machine, "it moves in a hold");
            scene.ctl(&["resume"]);
            let status = scene.operator.sees_end(held.job);
            assert_eq!(status.job_result, DONE, "{name}: {}", status.alarm_sentence());
            let (_, events) = scene.end();
            for expected in ["contact", "hold", "everything is at size"] {
                assert!(events.contains(expected), "{name}, {expected}: {events}");
            }
        }
    });
}

#[test]
fn a_served_cycle_stops_soon_after_its_sensor_fails() {
    unless_disturbed(|| {
        let mut scene = ServedLathe::start("turn-blind", "longitudinal", LONGITUDINAL);
        scene.ctl(&["start"]);
        scene.waits_for_cut(2, 298.5);
        let job = scene.operator.now().job;
        scene.drives = None;
        let status = scene.operator.sees_end(job);
        assert_eq!(status.job_result, FAULT);
        assert!(
            status.listed_alarms().contains(&501),
            "{}",
            status.alarm_sentence()
        );
        let (driven, events) = scene.end();
        assert!(events.contains("load sensor"), "{events}");
        let (_, after_s) = stop_after_last_reading(&driven);
        // 100 rev/min.
        assert!(after_s <= 0.6, "{after_s} s after the last reading");
    });
}
