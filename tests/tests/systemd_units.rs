//! The units for systemd: restrictive, for any host, and really started if this runs as root. Checks that
//! cannot be made are reported as "not measured".
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use evolvent_tests::{Workshop, evolvent, repository};

/// The worst permitted rating, in tenths.
const RATING: u32 = 30;

fn units() -> Vec<PathBuf> {
    let folder = repository().join("tools/systemd");
    let entries = std::fs::read_dir(folder).expect("the units");
    let units: Vec<PathBuf> = entries
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "service"))
        .collect();
    assert_eq!(units.len(), 4);
    units
}

#[test]
fn units_are_rated_as_safe_by_systemd() {
    for unit in units() {
        let analyzed = Command::new("systemd-analyze")
            .args(["security", "--offline=true"])
            .arg(format!("--threshold={RATING}"))
            .arg(&unit)
            .output();
        let Ok(analyzed) = analyzed else {
            println!("not measured: no systemd-analyze (apt-get install systemd)");
            return;
        };
        let report = String::from_utf8_lossy(&analyzed.stdout).into_owned();
        let rating = report.lines().last().unwrap_or_default();
        assert!(analyzed.status.success(), "{}: {rating}", unit.display());
    }
}

#[test]
fn units_name_no_core_that_a_host_may_not_have() {
    for unit in units() {
        let text = std::fs::read_to_string(&unit).expect("a unit");
        let names_core = text
            .lines()
            .any(|line| line.trim_start().starts_with("CPUAffinity="));
        assert!(!names_core, "{}", unit.display());
    }
}

/// At boot drives and boards often have no supply yet: with systemd's default limit of five starts in ten
/// seconds a bridge would give up too early.
#[test]
fn bridges_are_started_for_ever() {
    let is_bridge = |unit: &PathBuf| unit.file_stem().is_some_and(|name| name != "evolvent@");
    for unit in units().into_iter().filter(is_bridge) {
        let text = std::fs::read_to_string(&unit).expect("a unit");
        let (head, service) = text.split_once("[Service]").expect("a service");
        assert!(
            head.lines().any(|line| line == "StartLimitIntervalSec=0"),
            "{}",
            unit.display()
        );
        assert!(
            service.lines().any(|line| line == "Restart=always"),
            "{}",
            unit.display()
        );
        // Another start does not correct wrong arguments or files, and would fill the journal.
        assert!(
            service.lines().any(|line| line == "RestartPreventExitStatus=2"),
            "{}",
            unit.display()
        );
    }
}

/// The observed states and actions of the services, line by line (`tests/systemd/probe`).
const FACTS: &str = "active evolvent: active
active evolvent-bridge: active
Uid: 963
CapEff: 0000000000000000
CapBnd: 0000000000000000
NoNewPrivs: 1
Seccomp: 2
user: evolvent
network: its own
bus: evolvent 700
up: 0
home: 0
mdi: 0
estop by another user: 1
operator without sudo: 1
operator: 0
operator looks: 0
operator runs something else: 1
operator runs a bridge: 1
operator as root: 1
stranger: 1
active evolvent: active
restarted: yes
bridge: the same
up again: 0
mdi again: 0
watchdog: yes
stopped: success inactive
traces: 3
bridge stopped: success
";

/// Boots systemd with the units of a folder in separate namespaces until this fact is found. Returns the
/// folder with the results, or the reason why that is impossible.
fn boot(workshop: &Workshop, units: &Path, fact: &str) -> Result<PathBuf, &'static str> {
    // Running the tests as root does not imply permission for a second systemd on the host.
    if std::env::var_os("EVOLVENT_BOOT_SYSTEMD").is_none() {
        return Err("EVOLVENT_BOOT_SYSTEMD=1 boots a systemd in namespaces of its own (as root)");
    }
    if !rustix::process::geteuid().is_root() {
        return Err("not root");
    }
    if !Path::new("/lib/systemd/systemd").exists() || which("unshare").is_none() || which("setpriv").is_none()
    {
        return Err("no systemd, unshare or setpriv");
    }
    let mounts = std::fs::read_to_string("/proc/filesystems").expect("the kernel's file systems");
    if !mounts.contains("cgroup2") {
        return Err("no control groups of version 2");
    }
    let output = workshop.path("systemd");
    std::fs::create_dir_all(&output).expect("a folder");
    let script = repository().join("tests/systemd/boot");
    // With a lead for busy hosts.
    let machine = repository().join("config/machines/mill-3axis.toml");
    let text = std::fs::read_to_string(machine).expect("a machine file");
    let machine = workshop.write("mill-3axis.toml", format!("lead_ms = 28\n{text}"));
    let spaces = [
        "--mount",
        "--pid",
        "--fork",
        "--kill-child=KILL",
        "--ipc",
        "--net",
        "--uts",
    ];
    let log = std::fs::File::create(output.join("log")).expect("a file");
    let mut booted = Command::new("unshare")
        .args(spaces)
        .arg(&script)
        .arg(units)
        .arg(&machine)
        .arg(evolvent().get_program())
        .arg(&output)
        .stdin(Stdio::null())
        .stdout(log.try_clone().expect("a file"))
        .stderr(log)
        .spawn()
        .expect("unshare");
    let begin = Instant::now();
    let is_done = || std::fs::read_to_string(output.join("facts")).is_ok_and(|facts| facts.contains(fact));
    let has_ended = loop {
        std::thread::sleep(Duration::from_millis(100));
        let has_ended = booted.try_wait().expect("its state").is_some();
        if is_done() || has_ended || begin.elapsed() > Duration::from_secs(120) {
            break has_ended;
        }
    };
    let _gone = booted.kill();
    let _gone = booted.wait();
    // Its processes end shortly after it.
    std::thread::sleep(Duration::from_millis(300));
    let _left = Command::new(&script).arg("clean").arg(&output).status();
    if has_ended && !output.join("facts").exists() {
        return Err("systemd does not boot in namespaces here");
    }
    Ok(output)
}

fn which(program: &str) -> Option<PathBuf> {
    let folders = std::env::var_os("PATH")?;
    std::env::split_paths(&folders)
        .map(|folder| folder.join(program))
        .find(|file| file.exists())
}

#[test]
fn units_run_as_they_are_under_systemd() {
    let workshop = Workshop::new();
    let output = match boot(&workshop, &repository().join("tools/systemd"), "bridge stopped") {
        Ok(output) => output,
        Err(reason) => {
            println!("not measured: {reason}");
            return;
        }
    };
    let read = |name: &str| std::fs::read_to_string(output.join(name)).unwrap_or_default();
    if !read("not-measured").is_empty() {
        println!("not measured: {}", read("not-measured").trim());
    }
    let has_sudo = which("sudo").is_some();
    let uid = |line: &str| {
        let is_group = line.starts_with("operator") || line.starts_with("stranger");
        line.starts_with("Uid: ") || is_group && !has_sudo
    };
    let facts = read("facts");
    let found: Vec<&str> = facts.lines().filter(|line| !uid(line)).collect();
    let expected: Vec<&str> = FACTS.lines().filter(|line| !uid(line)).collect();
    assert_eq!(
        found,
        expected,
        "{}\n{}\n{}",
        read("said"),
        read("errors"),
        read("log")
    );
    let status: serde_json::Value = serde_json::from_str(&read("status")).expect("a status");
    assert_eq!(status["position_machine"]["X"], 1.0, "{status}");
    // A user without the right gets a message that names the owner.
    assert!(read("said").contains("user evolvent"), "{}", read("said"));
}

#[test]
fn a_unit_that_is_too_tight_fails_there() {
    let workshop = Workshop::new();
    let units = workshop.path("units");
    std::fs::create_dir(&units).expect("a folder");
    for unit in self::units() {
        let text = std::fs::read_to_string(&unit).expect("a unit");
        let tight = text.replace(
            "RestrictAddressFamilies=AF_UNIX",
            "RestrictAddressFamilies=AF_INET",
        );
        assert_ne!(tight, text);
        std::fs::write(units.join(unit.file_name().expect("a name")), tight).expect("written");
    }
    match boot(&workshop, &units, "user:") {
        Ok(output) => {
            let facts = std::fs::read_to_string(output.join("facts")).unwrap_or_default();
            assert!(!facts.starts_with("active evolvent: active\n"), "{facts}");
        }
        Err(reason) => println!("not measured: {reason}"),
    }
}
