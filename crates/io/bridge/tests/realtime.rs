//! The scheduling of both threads of a bridge, and its locked memory: as the kernel reports them.

#![expect(clippy::expect_used, reason = "a test")]

use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

use evolvent_bridge::{BridgeSettings, run_bridge};
use evolvent_bus::{BusConfig, CoreBus, remove_private_domain};
use evolvent_machine::Machine;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use rustix::thread::{CapabilitySet, CapabilitySets, capabilities, set_capabilities};

mod common;

use common::Bench;

/// A thread's scheduling policy and real-time priority: fields 41 and 40 of its `stat`.
fn scheduling(thread: i32) -> (String, String) {
    let text = std::fs::read_to_string(format!("/proc/self/task/{thread}/stat")).expect("a thread");
    // The name in brackets may contain spaces; field 3 follows it.
    let fields: Vec<&str> = text
        .rsplit(')')
        .next()
        .unwrap_or_default()
        .split_whitespace()
        .collect();
    (fields[38].to_owned(), fields[37].to_owned())
}

fn locked_kib() -> u64 {
    let text = std::fs::read_to_string("/proc/self/status").expect("this process");
    let line = text.lines().find(|line| line.starts_with("VmLck:"));
    let number = line.and_then(|line| line.split_whitespace().nth(1)?.parse().ok());
    number.expect("a number")
}

fn this_thread() -> i32 {
    // SAFETY: no memory is concerned.
    unsafe { libc::gettid() }
}

/// Observations of a bridge: scheduling of its threads, locked memory, and its messages.
struct Observed {
    threads: Vec<(&'static str, (String, String))>,
    locked_kib: u64,
    messages: Vec<String>,
}

/// Runs a bridge with a core, and `prepare` at the beginning of its thread.
fn run_one(machine: &Machine, name: &str, prepare: fn()) -> Observed {
    let prefix = format!("rtbr_{name}{}_", std::process::id());
    let mut config = BusConfig::new("real-time", "XYZ", 1_000_000);
    config.prefix = Some(prefix.clone());
    let core = CoreBus::open(&config).expect("a bus");
    let stop = AtomicBool::new(false);
    let messages = Mutex::new(Vec::new());
    let (out, threads) = channel();
    let observed = std::thread::scope(|scope| {
        let (stop, messages, prefix) = (&stop, &messages, prefix.as_str());
        let (of_bus, of_session): (Sender<_>, Sender<_>) = (out.clone(), out);
        scope.spawn(move || {
            prepare();
            let settings = BridgeSettings {
                machine,
                machine_name: Some("real-time"),
                prefix: Some(prefix),
                duration: Some(Duration::from_secs(20)),
            };
            let on_message = |text: &str| {
                if text.starts_with("core found") {
                    let _nobody = of_bus.send(("bus", this_thread()));
                }
                messages.lock().expect("no panic").push(text.to_owned());
            };
            run_bridge(settings, &Bench::<false>, stop, on_message, |ends| {
                let _nobody = of_session.send(("session", this_thread()));
                while !ends.stop.load(Ordering::Relaxed) {
                    std::thread::sleep(Duration::from_millis(1));
                }
                Ok(())
            })
            .expect("a bridge that runs");
        });
        let threads = (0..2)
            .map(|_| {
                let (who, thread) = threads
                    .recv_timeout(Duration::from_secs(20))
                    .expect("both threads");
                (who, scheduling(thread))
            })
            .collect();
        let locked_kib = locked_kib();
        stop.store(true, Ordering::Relaxed);
        (threads, locked_kib)
    });
    drop(core);
    let _removed = remove_private_domain(&prefix);
    Observed {
        threads: observed.0,
        locked_kib: observed.1,
        messages: messages.into_inner().expect("no panic"),
    }
}

/// Drops the rights to real-time scheduling, in the calling thread and those that it starts.
fn drop_rights() {
    let mut sets = capabilities(None).expect("the sets of this thread");
    let real_time = CapabilitySet::SYS_NICE | CapabilitySet::IPC_LOCK | CapabilitySet::SYS_RESOURCE;
    sets = CapabilitySets {
        effective: sets.effective.difference(real_time),
        permitted: sets.permitted.difference(real_time),
        ..sets
    };
    set_capabilities(None, sets).expect("rights to drop");
}

/// The shipped mill, with a priority that no other thread has.
fn mill() -> Machine {
    let text = evolvent_file_tests::shipped("machines/mill-3axis.toml");
    let mut machine = Machine::parse(&text, "mill").expect("a machine");
    machine.realtime.priority = 37;
    assert!(machine.realtime.lock_memory, "the default");
    machine
}

fn notes(observed: &Observed) -> Vec<&str> {
    let messages = observed.messages.iter().map(String::as_str);
    messages.filter(|text| text.starts_with("note: ")).collect()
}

fn set_limit(resource: Resource, bytes: Option<u64>) {
    let limit = Rlimit {
        current: bytes,
        maximum: bytes,
    };
    setrlimit(resource, limit).expect("a limit that this user may set");
}

/// Runs a test in a separate process, because limits and locked memory apply to the whole process. Returns
/// its output; `None` in that process.
fn in_a_process(test: &str) -> Option<String> {
    if std::env::var_os("EVOLVENT_REAL_TIME_CHILD").is_some() {
        return None;
    }
    let output = Command::new(std::env::current_exe().expect("this test"))
        .args([test, "--exact", "--nocapture"])
        .env("EVOLVENT_REAL_TIME_CHILD", "1")
        .output()
        .expect("to start");
    let printed = format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(output.status.success(), "{printed}");
    Some(printed)
}

#[test]
fn what_the_system_refuses_is_told_once() {
    if let Some(printed) = in_a_process("what_the_system_refuses_is_told_once") {
        println!("{printed}");
        return;
    }
    set_limit(Resource::Rtprio, Some(0));
    let max = getrlimit(Resource::Memlock).maximum.unwrap_or(u64::MAX);
    set_limit(Resource::Memlock, Some(max.min(8 << 20)));
    let observed = run_one(&mill(), "without", drop_rights);
    for (who, (policy, _)) in &observed.threads {
        assert_eq!(policy, "0", "{who}: SCHED_OTHER");
    }
    assert_eq!(observed.locked_kib, 0);
    let notes = notes(&observed);
    assert_eq!(notes.len(), 2, "each once: {:?}", observed.messages);
    assert!(notes[0].contains("memory of the bridge is not locked") && notes[0].contains("memlock"));
    let wanted = "no real-time scheduling of the bridge at priority 35";
    assert!(notes[1].contains(wanted), "{notes:?}");
}

#[test]
fn both_threads_run_in_real_time() {
    let mut machine = mill();
    machine.realtime.lock_memory = false;
    let observed = run_one(&machine, "fifo", || {});
    let rights = capabilities(None).expect("the sets of this thread").effective;
    let may_raise = rights.contains(CapabilitySet::SYS_NICE)
        || getrlimit(Resource::Rtprio).current.is_none_or(|max| max >= 35);
    if !may_raise {
        println!("not measured: this user may not run in real time");
        return;
    }
    for (who, scheduling) in &observed.threads {
        let wanted = ("1".to_owned(), "35".to_owned());
        assert_eq!(*scheduling, wanted, "{who}: SCHED_FIFO, two below the cycle");
    }
    assert!(notes(&observed).is_empty(), "{:?}", observed.messages);
}

#[test]
fn memory_is_locked_if_the_machine_file_says_so() {
    if let Some(printed) = in_a_process("memory_is_locked_if_the_machine_file_says_so") {
        println!("{printed}");
        return;
    }
    let mut unlocked = mill();
    unlocked.realtime.lock_memory = false;
    assert_eq!(run_one(&unlocked, "unlocked", || {}).locked_kib, 0);
    let rights = capabilities(None).expect("the sets of this thread").effective;
    let may_lock =
        getrlimit(Resource::Memlock).maximum.is_none() || rights.contains(CapabilitySet::SYS_RESOURCE);
    if !may_lock {
        println!("not measured: this user's memlock is limited");
        return;
    }
    let observed = run_one(&mill(), "locked", || {});
    assert!(observed.locked_kib > 1024, "{} KiB", observed.locked_kib);
    assert!(
        !notes(&observed).iter().any(|note| note.contains("memory")),
        "{:?}",
        observed.messages
    );
}
