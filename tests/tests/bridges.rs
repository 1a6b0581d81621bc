//! Drive bridges: the simulated one, the one inside a process, and the examples in C and Python, all tested
//! by one suite.

use std::fs::read_to_string;
use std::io::Read;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use evolvent_bus::{BusConfig, CoreBus};
use evolvent_ethercat_ring::{DriveSettings, MAIN_INTERFACE, SubDevice, TerminalKind, on_bench};
use evolvent_tests::{
    Domain, Workshop, c_example, evolvent, hold_to_the_suite, repository, unless_disturbed,
};
use serde_json::Value;

/// Names of the cases with this verdict, sorted.
fn verdicts<'a>(cases: &'a [Value], verdict: &str) -> Vec<&'a str> {
    let mut names: Vec<&str> = cases
        .iter()
        .filter(|case| case["verdict"] == verdict)
        .filter_map(|case| case["case"].as_str())
        .collect();
    names.sort_unstable();
    names
}

/// Number of cases that passed, or that the suite reported as not measured because the host was busy.
fn passed(cases: &[Value]) -> usize {
    verdicts(cases, "passed").len() + verdicts(cases, "not measured").len()
}

/// Requirements on outputs and inputs, for bridges that are wired as the suite requires.
const SIGNALS: [&str; 3] = ["inputs", "output_due", "output_safe"];
/// For bridges whose drives do not come into fault on their own.
const OF_FAULTS: &str = "new_core_reset";
/// These, and those for a probe and a spindle.
const LEFT_OUT: [&str; 7] = [
    SIGNALS[0],
    OF_FAULTS,
    SIGNALS[1],
    SIGNALS[2],
    "probe",
    "spindle_angle",
    "spindle_safe",
];

#[test]
fn the_simulated_bridge_does_what_every_bridge_must() {
    let cases = hold_to_the_suite(&[], &[]);
    assert_eq!(verdicts(&cases, "left out"), [OF_FAULTS], "{cases:?}");
    assert_eq!(passed(&cases), 28, "{cases:?}");
    assert_eq!(cases.len(), 29, "each case once: {cases:?}");
}

/// The simulated bridge with this option passes this case.
#[expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]
fn sim_passes(case: &str, option: &str) {
    let program = evolvent().get_program().to_string_lossy().into_owned();
    let command = format!("bridge sim --machine-name {{name}} --bus-prefix {{prefix}} {option}");
    unless_disturbed(|| {
        let output = evolvent()
            .args(["bridge", "test", "--json", "--only", case, "--"])
            .arg(&program)
            .args(command.split(' '))
            .output()
            .expect("the binary to start");
        let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let cases = report["cases"].as_array().expect("cases");
        assert_eq!(passed(cases), 1, "{report}");
    });
}

/// The suite kills a bridge whose drives then come into fault.
#[test]
fn a_new_core_counter_resets_no_fault_of_sim_drives() {
    sim_passes(OF_FAULTS, "--fault fault@0.3+0.05");
}

/// The axes of real machines begin anywhere.
#[test]
fn a_core_is_killed_while_axes_are_far_from_zero() {
    sim_passes("core_kill", "--reference-offset 31");
}

#[test]
fn the_bridge_in_process_passes_the_suite_but_kills() {
    let cases = hold_to_the_suite(&["--in-process"], &[]);
    assert_eq!(
        verdicts(&cases, "left out"),
        ["bridge_kill", OF_FAULTS],
        "{cases:?}"
    );
    assert_eq!(passed(&cases), 27);
}

#[test]
fn so_does_the_example_in_c() {
    let workshop = Workshop::new();
    let program = c_example("bridge", workshop.folder());
    let cases = hold_to_the_suite(&[], &[program.display().to_string()]);
    assert_eq!(passed(&cases), 22, "{cases:?}");
    assert_eq!(verdicts(&cases, "left out"), LEFT_OUT, "{cases:?}");
}

/// Needs EVOLVENT_PYTHON, like all foreign clients.
#[test]
fn so_does_the_example_in_python() {
    let Ok(python) = std::env::var("EVOLVENT_PYTHON") else {
        println!("skipped: run tools/test");
        return;
    };
    let script = repository().join("tools/python/examples/bridge.py");
    let command = [
        python,
        script.display().to_string(),
        "{name}".to_owned(),
        "{prefix}".to_owned(),
    ];
    let cases = hold_to_the_suite(&[], &command);
    assert_eq!(passed(&cases), 22, "{cases:?}");
    assert_eq!(verdicts(&cases, "left out"), LEFT_OUT, "{cases:?}");
}

#[test]
fn each_example_is_shorter_than_60_lines() {
    for example in ["tools/examples/bridge.c", "tools/python/examples/bridge.py"] {
        let text = read_to_string(repository().join(example)).expect("an example");
        assert!(text.lines().count() < 60, "{example}");
    }
}

/// The EtherCAT bridge in a process that is killed: without frames its drives are in fault (7500h) until the
/// next core resets them. Needs the right to create a network namespace.
#[test]
fn the_ethercat_bridge_and_its_core_may_be_killed() {
    let devices = || {
        let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
        devices.extend((2..5).map(|serial| SubDevice::drive(DriveSettings::default(), serial, 10.0)));
        devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
        devices
    };
    let workshop = Workshop::new();
    let shipped = read_to_string(repository().join("config/networks/sim-mill.toml")).expect("a network");
    let changed = shipped.replace("max_lost_cycles = 3 ", "max_lost_cycles = 40 ");
    assert_ne!(shipped, changed);
    let network = workshop.write("network.toml", changed).display().to_string();
    let machine = repository()
        .join("config/machines/mill-ethercat.toml")
        .display()
        .to_string();
    for case in ["bridge_kill", "core_kill", OF_FAULTS] {
        let (network, machine) = (network.clone(), machine.clone());
        unless_disturbed(|| {
            let (network, machine) = (network.clone(), machine.clone());
            on_bench(devices(), move |_ring| {
                let program = evolvent().get_program().to_owned();
                let output = evolvent()
                    .args(["bridge", "test", "--json", "--moments", "3", "--only", case, "--"])
                    .arg(program)
                    .args(["bridge", "ethercat", "--machine", &machine, "--network", &network])
                    .args([
                        "--interface",
                        MAIN_INTERFACE,
                        "--machine-name",
                        "{name}",
                        "--bus-prefix",
                        "{prefix}",
                    ])
                    .output()
                    .expect("the binary to start");
                let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
                let cases = report["cases"].as_array().expect("cases");
                assert_eq!(passed(cases), 1, "{case}: {report}");
            });
        });
    }
}

/// A suite that ends must also end its bridge, which would otherwise keep the bus.
#[test]
fn a_signal_to_the_suite_ends_its_bridge() {
    let workshop = Workshop::new();
    let note = workshop.folder().join("bridge.pid");
    // The shell becomes the bridge, with the same process id.
    let script = format!("echo $$ > {}; exec sleep 60", note.display());
    let mut suite = evolvent()
        .args(["bridge", "test", "--only", "version", "--", "sh", "-c", &script])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary to start");
    let mut bridge = String::new();
    let begin = Instant::now();
    while bridge.trim().is_empty() {
        assert!(begin.elapsed() < Duration::from_secs(30), "no bridge");
        std::thread::sleep(Duration::from_millis(20));
        bridge = read_to_string(&note).unwrap_or_default();
    }
    let process = Path::new("/proc").join(bridge.trim());
    assert!(process.exists());
    let sent = std::process::Command::new("kill")
        .args(["-INT", &suite.id().to_string()])
        .status();
    assert!(sent.expect("kill").success());
    let begin = Instant::now();
    let ended = loop {
        if let Some(ended) = suite.try_wait().expect("the suite") {
            break ended;
        }
        assert!(begin.elapsed() < Duration::from_secs(10), "the suite goes on");
        std::thread::sleep(Duration::from_millis(20));
    };
    let is_gone = !process.exists();
    if !is_gone {
        let _ended = std::process::Command::new("kill").arg(bridge.trim()).status();
    }
    assert!(is_gone, "the bridge goes on");
    assert_eq!(ended.code(), Some(1), "{ended}");
    let mut printed = String::new();
    let from = suite.stderr.as_mut().expect("its messages");
    from.read_to_string(&mut printed).expect("text");
    assert!(printed.contains("stopped by a signal"), "{printed}");
}

/// A script that retries a network for some seconds reads the exit code.
#[test]
fn a_network_that_did_not_come_up_is_no_success() {
    let machine = repository()
        .join("config/machines/mill-ethercat.toml")
        .display()
        .to_string();
    let network = repository()
        .join("config/networks/sim-mill.toml")
        .display()
        .to_string();
    // No device is at the other end of the cable.
    on_bench(Vec::new(), move |_ring| {
        let domain = Domain::new();
        let finished = |has_core: bool, seconds: &str| {
            let mut command = evolvent();
            command.args(["bridge", "ethercat", "--machine", &machine, "--network", &network]);
            command.args(["--interface", MAIN_INTERFACE, "--seconds", seconds]);
            command.args(["--machine-name", "mill-3axis", "--bus-prefix", &domain.prefix]);
            let _core = has_core.then(|| {
                let mut config = BusConfig::new("mill-3axis", "XYZ", 2_000_000);
                config.prefix = Some(domain.prefix.clone());
                CoreBus::open(&config).expect("a bus")
            });
            let output = command.output().expect("the binary to start");
            (
                output.status.code(),
                String::from_utf8_lossy(&output.stderr).into_owned(),
            )
        };
        let (code, printed) = finished(false, "3");
        assert_eq!(code, Some(1), "{printed}");
        assert!(
            printed.contains("the network did not come up within 3 s: no core was running"),
            "{printed}"
        );
        // A busy host may need longer to find the core and to search for devices.
        let mut printed = String::new();
        for seconds in ["3", "10", "30"] {
            let code;
            (code, printed) = finished(true, seconds);
            assert_eq!(code, Some(1), "{printed}");
            if printed.contains("network: no device replies") {
                let end = format!("the network did not come up within {seconds} s: see the messages above");
                assert!(printed.contains(&end), "{printed}");
                return;
            }
        }
        panic!("no device was looked for: {printed}");
    });
}

/// A suite that accepts everything proves nothing: a bridge that replies nothing fails it.
#[test]
fn a_bridge_that_does_nothing_fails() {
    let output = evolvent()
        .args([
            "bridge", "test", "--json", "--only", "version", "--", "sleep", "60",
        ])
        .output()
        .expect("the binary to start");
    assert_eq!(output.status.code(), Some(1));
    let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(report["cases"][0]["verdict"], "failed");
    let why = report["cases"][0]["why"].as_str().unwrap_or_default();
    assert!(why.contains("feedback of a bridge: not within 15 s"), "{why}");
}

/// systemd itself checks the units, if it is installed; the path of the program is replaced by that of the
/// host.
#[test]
fn systemd_finds_nothing_wrong_with_the_units() {
    let workshop = Workshop::new();
    let mut files = Vec::new();
    for unit in [
        "evolvent@.service",
        "evolvent-bridge@.service",
        "evolvent-ethercat@.service",
        "evolvent-mesa@.service",
    ] {
        let text = read_to_string(repository().join("tools/systemd").join(unit)).expect("a unit");
        for line in ["RemoveIPC=no", "LimitMEMLOCK=infinity", "LimitRTPRIO="] {
            assert!(text.contains(line), "{unit}: {line}");
        }
        files.push(workshop.write(unit, text.replace("/usr/local/bin/evolvent", "/bin/true")));
    }
    if !Path::new("/usr/bin/systemd-analyze").exists() {
        println!("skipped: no systemd-analyze here");
        return;
    }
    let output = std::process::Command::new("systemd-analyze")
        .arg("verify")
        .arg("--man=no")
        .args(&files)
        .output()
        .expect("systemd-analyze to start");
    let printed = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && printed.is_empty(), "{printed}");
}
