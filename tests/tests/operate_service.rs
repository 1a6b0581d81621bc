//! A machine that is served as a service: what it saves, notifies and records, and how it ends.

use std::process::Stdio;
use std::time::{Duration, Instant};

use evolvent_bus::{ControlRequest, LOAD_KINDS, Load, Setpoint};
use evolvent_tests::{Domain, Operator, Scene, Served, Workshop, command, evolvent, speed, unless_disturbed};

#[test]
fn offsets_and_tools_outlive_a_restart_and_a_kill() {
    unless_disturbed(|| {
        let mut scene = Scene::new("op-keep");
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 2);
        let job = operator.says_text("MDI", "G0 X20 Y-5").job;
        operator.sees_end(job);
        let mut touch = command("TOUCH_OFF");
        (touch.axes_mask, touch.values[0], touch.values[1]) = (0b11, 1.0, 2.0);
        operator.does(&touch);
        let status = operator.now();
        assert_eq!(status.position_work[..2], [1.0, 2.0]);
        assert_eq!(status.work_offset[..2], [19.0, -7.0]);
        let mut tool = ControlRequest {
            index: 7,
            axes_mask: 0b100,
            amount: 6.0,
            ..command("TOOL")
        };
        tool.values[2] = 30.0;
        operator.does(&tool);
        drop(operator);
        scene.served.take().expect("a core").kill();
        scene.restart();
        let mut operator = scene.operator();
        assert_eq!(operator.now().work_offset[..2], [19.0, -7.0]);
        operator.brings_up();
        operator.says_number("MODE", 2);
        let job = operator.says_text("MDI", "T7 M6 G43").job;
        operator.waits("the tool change", |status| status.tool_change == 1);
        operator.says("RESUME");
        let status = operator.sees_end(job);
        assert_eq!((status.tool, status.tool_offset[2]), (7, 30.0));
        drop(operator);
        scene.end();
    });
}

#[test]
fn the_first_signal_stops_on_the_path_and_is_traced() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let domain = Domain::new();
        let machine = workshop.mill("op-signal", &[]);
        let trace = workshop.path("served.mcap");
        let trace_option = trace.to_str().expect("UTF-8").to_owned();
        let served = Served::start(
            &machine,
            "op-signal",
            &domain,
            &workshop.path("state"),
            &["--trace", &trace_option],
        );
        let mut operator = Operator::join("op-signal", &domain);
        let program = workshop.long_program(60);
        operator.brings_up();
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        operator.says("START");
        operator.waits("motion", |status| status.feed_mm_s > 90.0);
        operator.does(&ControlRequest {
            amount: 0.7,
            ..command("FEED_OVERRIDE")
        });
        operator.waits("less", |status| status.feed_mm_s < 75.0);
        let finished = {
            // `timeout` sends one signal to the process and one to its group: that is one request.
            served.signal(rustix::process::Signal::TERM);
            std::thread::sleep(Duration::from_millis(2));
            served.signal(rustix::process::Signal::TERM);
            let mut last: Option<Setpoint> = None;
            let end = operator.follows(
                |setpoint| last = Some(*setpoint),
                |setpoint| setpoint.flags & 128 != 0,
            );
            assert_eq!(speed(&end), 0.0);
            // On the line from (-100, -50) to (100, 50).
            assert!(
                (end.position[0] - 2.0 * end.position[1]).abs() < 1e-6,
                "{:?}",
                end.position
            );
            drop(operator);
            served.wait()
        };
        finished.expect_code(&[0, 3]);
        let mut file = evolvent_trace::TraceFile::open(&trace).expect("a complete trace");
        let events: Vec<_> = file.events().map(|event| event.expect("an event")).collect();
        let commands: Vec<&str> = events
            .iter()
            .filter(|event| event.kind == evolvent_trace::EventKind::Command)
            .map(|event| event.text.as_str())
            .collect();
        for expected in [
            "emergency stop reset",
            "on",
            "mode auto",
            "start",
            "feed override 70.0 %",
        ] {
            assert!(commands.contains(&expected), "{expected}: {commands:?}");
        }
        // The override takes effect in the cycle that the event names.
        let event = events
            .iter()
            .find(|event| event.text == "feed override 70.0 %")
            .expect("the override");
        let cycles = evolvent_tests::cycles(&trace);
        let at = event.sequence as usize;
        assert_eq!((cycles[at - 1].override_, cycles[at].override_), (1.0, 0.7));
    });
}

#[test]
fn systemd_is_notified_of_ready_alive_and_stopping() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let machine = workshop.mill("op-notify", &[]);
        let socket = workshop.path("notify");
        let manager = std::os::unix::net::UnixDatagram::bind(&socket).expect("a socket");
        manager
            .set_read_timeout(Some(Duration::from_secs(120)))
            .expect("a timeout");
        let mut child = evolvent()
            .args(["serve", "--bus-prefix", &domain.prefix, "--machine"])
            .arg(&machine)
            .arg("--state")
            .arg(workshop.path("state"))
            .env("NOTIFY_SOCKET", &socket)
            .env("WATCHDOG_USEC", "100000")
            .env_remove("WATCHDOG_PID")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the binary to start");
        let next_message = || {
            let mut text = [0; 64];
            let length = manager.recv(&mut text).expect("news");
            String::from_utf8_lossy(&text[..length]).into_owned()
        };
        assert_eq!(next_message(), "READY=1");
        let begin = Instant::now();
        for _ in 0..5 {
            assert_eq!(next_message(), "WATCHDOG=1");
        }
        assert!(begin.elapsed() < Duration::from_secs(5));
        let pid = rustix::process::Pid::from_raw(child.id().cast_signed()).expect("a process");
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).expect("a living process");
        while next_message() != "STOPPING=1" {}
        child.wait().expect("a process that ends");
    });
}

#[test]
fn a_cutting_load_is_recorded_while_its_sensor_speaks() {
    unless_disturbed(|| {
        let workshop = Workshop::new();
        let trace = workshop.path("load.mcap");
        let scene = Scene::with("op-load", &["--trace", trace.to_str().expect("UTF-8")]);
        let mut operator = scene.operator();
        let bus = scene.domain.client("op-load");
        let mut sensor = bus.load_sender().expect("the load channel");
        let before = operator.now().cycles;
        for sequence in 1..=300 {
            let load = Load {
                sequence,
                kind: LOAD_KINDS[0].1,
                value: 0.25 * sequence as f64,
                range_max: 1000.0,
                ..Load::default()
            };
            sensor.send(&load).expect("sent");
            std::thread::sleep(Duration::from_millis(2));
        }
        let status = operator.now();
        let end = status.cycles + 2_000_000_000 / status.period_ns;
        operator.waits("two seconds without a load", |status| status.cycles > end);
        drop((operator, sensor, bus));
        scene.end();
        let mut trace = evolvent_trace::TraceFile::open(&trace).expect("a complete trace");
        let loads: Vec<f64> = trace
            .cycles()
            .map(|cycle| cycle.expect("a readable cycle").load)
            .collect();
        let known: Vec<f64> = loads.iter().copied().filter(|load| !load.is_nan()).collect();
        assert!(known.len() > 200 && known.is_sorted(), "{} loads", known.len());
        assert_eq!(known[known.len() - 1], 75.0);
        assert!(loads[before as usize / 2].is_nan(), "before there was a sensor");
        assert!(loads[loads.len() - 1].is_nan(), "long after it was silent");
    });
}
