//! Cores that are killed at any moment, and their remaining resources.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

mod common;

use common::PrivateDomain;
use evolvent_bus::{BusConfig, BusError, CoreBus, EventKind, Setpoint, SetpointReader, Status};
use evolvent_random::Random;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const PREFIX: &str = "EVOLVENT_BUS_TEST_PREFIX";
/// The environment variable EVOLVENT_KILLS raises it.
const ROUNDS: u64 = 24;

/// Not a test of its own: the process that is killed. Does nothing in an ordinary run.
#[test]
fn child_core() {
    let Ok(prefix) = std::env::var(PREFIX) else { return };
    let config = BusConfig {
        prefix: Some(prefix),
        ..BusConfig::new("mill", "XYZ", common::PERIOD_NS)
    };
    let mut core = CoreBus::open(&config).expect("a core");
    for sequence in 0.. {
        core.publish_setpoint(&Setpoint {
            sequence,
            line: std::process::id(),
            ..Setpoint::default()
        })
        .expect("sent");
        core.publish_status(&Status {
            sequence,
            ..Status::default()
        })
        .expect("sent");
        core.notify(EventKind::StatusChanged).expect("notified");
        core.feedback().expect("received");
        std::thread::sleep(Duration::from_micros(200));
    }
}

fn start(prefix: &str) -> Child {
    Command::new(std::env::current_exe().expect("a path"))
        .args(["--exact", "child_core", "--test-threads", "1"])
        .env(PREFIX, prefix)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("a child")
}

/// Waits for a setpoint of a child. Each setpoint has its process number, which distinguishes it from those
/// of an earlier core.
fn wait_for_setpoint(setpoints: &mut SetpointReader, child: &Child) {
    let begin = Instant::now();
    loop {
        match setpoints.receive().expect("received") {
            Some(setpoint) if setpoint.line == child.id() => return,
            _ => std::thread::sleep(Duration::from_millis(1)),
        }
        assert!(begin.elapsed() < Duration::from_secs(60), "no setpoints");
    }
}

/// Starts a child and waits until it has opened its whole bus. Its services exist before its publishers, and
/// clients find the services.
fn start_to_publish(domain: &PrivateDomain) -> Child {
    let child = start(&domain.prefix);
    let client = domain.client("mill");
    wait_for_setpoint(&mut client.setpoints().expect("a reader"), &child);
    child
}

fn kill(mut child: Child) {
    child.kill().expect("killed");
    child.wait().expect("waited");
}

#[test]
fn a_core_killed_at_any_moment_starts_again() {
    let domain = PrivateDomain::new();
    let mut random = Random::new();
    let mut slowest = Duration::ZERO;
    let rounds = std::env::var("EVOLVENT_KILLS")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(ROUNDS);
    for round in 0..rounds {
        let child = start(&domain.prefix);
        // Opening takes some 20 ms: half of the kills fall into it.
        std::thread::sleep(Duration::from_micros(random.bits() % 60_000));
        kill(child);
        let begin = Instant::now();
        let mut core = CoreBus::open(&domain.core("mill")).unwrap_or_else(|e| panic!("round {round}: {e}"));
        slowest = slowest.max(begin.elapsed());
        core.publish_setpoint(&Setpoint::default()).expect("sent");
    }
    println!("slowest restart {slowest:?}");
}

/// A process can die between the creation of any two of the files that show whether it is alive.
#[test]
fn nodes_with_broken_monitor_are_removed_with_domain() {
    let parts = [
        "details",
        "node_monitor",
        "node_monitor_context",
        "node_monitor_owner_lock",
    ];
    let domain = PrivateDomain::new();
    let child = start_to_publish(&domain);
    let files = domain.files();
    let folder = files
        .iter()
        .find(|file| file.to_string_lossy().ends_with(".details"))
        .and_then(|file| file.parent())
        .expect("the node's folder");
    let id = folder
        .file_name()
        .expect("its number")
        .to_string_lossy()
        .into_owned();
    for there in 1..1 << parts.len() {
        // Another node, which made only some of its files.
        let other = format!("{}{:02}", &id[..id.len() - 2], 10 + there);
        if other == id {
            continue;
        }
        std::fs::create_dir(folder.with_file_name(&other)).expect("a folder");
        for file in &files {
            let name = file.to_string_lossy();
            let is_there = |k: usize| there >> k & 1 == 1 && name.ends_with(&format!(".{}", parts[k]));
            if name.contains(&id) && (0..parts.len()).any(is_there) {
                std::fs::copy(file, name.replace(&id, &other)).expect("copied");
            }
        }
    }
    kill(child);
    // Another domain that ends shares the folder of nodes and must not remove resources that it could not
    // remove completely.
    let empty = std::fs::read_dir(folder.parent().expect("the nodes"))
        .expect("a list")
        .flatten()
        .map(|entry| entry.path())
        .filter(|node| std::fs::read_dir(node).is_ok_and(|files| files.count() == 0))
        .filter(|node| node.to_string_lossy().contains(&id[..id.len() - 2]))
        .collect::<Vec<_>>();
    assert!(empty.len() >= parts.len(), "{empty:?}");
    let neighbour = PrivateDomain::new();
    drop(CoreBus::open(&neighbour.core("mill")).expect("a core"));
    drop(neighbour);
    for node in &empty {
        assert!(node.exists(), "{} was another domain's", node.display());
    }
    // Removing the folder alone leaves a monitor that nothing searches for.
    std::fs::remove_dir(&empty[0]).expect("removed");
    // The end of the domain asserts that nothing is left of any.
    drop(domain);
    for node in &empty {
        assert!(!node.exists(), "{} is left", node.display());
    }
}

#[test]
fn clients_survive_core_death_and_read_next_core() {
    let domain = PrivateDomain::new();
    let mut random = Random::new();
    let child = start(&domain.prefix);
    let client = domain.client("mill");
    let mut setpoints = client.setpoints().expect("a reader");
    let mut events = client.events().expect("a listener");
    let mut next = Some(child);
    for _ in 0..6 {
        let child = next.take().unwrap_or_else(|| start(&domain.prefix));
        wait_for_setpoint(&mut setpoints, &child);
        std::thread::sleep(Duration::from_micros(random.bits() % 30_000));
        kill(child);
        while setpoints.receive().expect("received").is_some() {}
        events.wait(Duration::ZERO).expect("no broken connection");
    }
    drop((setpoints, events, client));
    drop(CoreBus::open(&domain.core("mill")).expect("a core"));
}

#[test]
fn a_core_in_another_process_is_named_with_its_pid() {
    let domain = PrivateDomain::new();
    let child = start_to_publish(&domain);
    let pid = i32::try_from(child.id()).ok();
    let error = CoreBus::open(&domain.core("mill")).err();
    kill(child);
    assert_eq!(
        error,
        Some(BusError::AlreadyRunning {
            machine_name: "mill".to_owned(),
            pid
        })
    );
    assert!(CoreBus::open(&domain.core("mill")).is_ok());
}

#[test]
fn of_cores_that_start_together_exactly_one_lives() {
    let domain = PrivateDomain::new();
    for _ in 0..5 {
        let barrier = std::sync::Barrier::new(4);
        let opened: Vec<bool> = std::thread::scope(|scope| {
            let (barrier, domain) = (&barrier, &domain);
            let threads: Vec<_> = (0..4)
                .map(|_| {
                    scope.spawn(move || {
                        barrier.wait();
                        let core = CoreBus::open(&domain.core("mill"));
                        barrier.wait();
                        match core {
                            Ok(_) => true,
                            Err(BusError::AlreadyRunning { .. }) => false,
                            Err(other) => panic!("{other}"),
                        }
                    })
                })
                .collect();
            threads
                .into_iter()
                .map(|thread| thread.join().expect("no panic"))
                .collect()
        });
        assert_eq!(opened.iter().filter(|&&open| open).count(), 1, "{opened:?}");
    }
}
