//! Rights of a running bridge's threads: tried by the threads themselves, and read from the kernel by
//! another.

#![expect(clippy::expect_used, reason = "a test")]

use std::ffi::CString;
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::DirBuilderExt;
use std::path::Path;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use evolvent_bridge::{BridgeError, BridgeSettings, run_bridge};
use evolvent_bus::{BusConfig, CoreBus, RUNTIME_FOLDER, remove_private_domain};
use evolvent_machine::Machine;

mod common;

use common::Bench;

fn socket(family: i32, kind: i32) -> bool {
    // SAFETY: no memory is passed.
    let descriptor = unsafe { libc::socket(family, kind, 0) };
    if descriptor >= 0 {
        // SAFETY: the descriptor was just made and nobody else has it.
        unsafe { libc::close(descriptor) };
    }
    descriptor >= 0
}

fn map_code() -> bool {
    let (code, shared) = (
        libc::PROT_READ | libc::PROT_EXEC,
        libc::MAP_PRIVATE | libc::MAP_ANONYMOUS,
    );
    // SAFETY: a new page, at an address of the kernel's choice.
    let page = unsafe { libc::mmap(core::ptr::null_mut(), 4096, code, shared, -1, 0) };
    page != libc::MAP_FAILED
}

/// What the calling thread can do, by name; `door` is the address of a listening socket.
fn deeds(door: std::net::SocketAddr) -> Vec<(&'static str, bool)> {
    let process = std::process::id() as i32;
    // SAFETY: a signal that does nothing by default, to this process.
    let kills = || unsafe { libc::kill(process, libc::SIGURG) == 0 };
    let forks = || {
        // SAFETY: the child calls nothing but `_exit`.
        let child = unsafe { libc::fork() };
        if child == 0 {
            // SAFETY: it ends this process, and does not return.
            unsafe { libc::_exit(0) };
        }
        child > 0
    };
    let file = std::env::temp_dir().join(format!("evolvent-confined-{}", std::process::id()));
    vec![
        ("read a file", std::fs::read("/etc/passwd").is_ok()),
        ("list a folder", std::fs::read_dir("/etc").is_ok()),
        ("write a file", {
            let is_written = std::fs::write(&file, "x").is_ok();
            let _unconfined = std::fs::remove_file(&file);
            is_written
        }),
        ("run a program", Command::new("true").status().is_ok()),
        ("fork", forks()),
        ("open a raw socket", socket(libc::AF_PACKET, libc::SOCK_RAW)),
        ("open a netlink socket", socket(libc::AF_NETLINK, libc::SOCK_RAW)),
        ("open a UDP socket", UdpSocket::bind("127.0.0.1:0").is_ok()),
        ("connect by TCP", TcpStream::connect(door).is_ok()),
        ("send a signal", kills()),
        ("map code", map_code()),
        ("make a namespace", {
            // SAFETY: no memory is passed.
            let result = unsafe { libc::unshare(libc::CLONE_NEWUSER) };
            result == 0
        }),
    ]
}

/// Fields of a thread's status, as reported by the kernel.
fn status(thread: i32) -> Vec<(String, String)> {
    let text = std::fs::read_to_string(format!("/proc/self/task/{thread}/status")).unwrap_or_default();
    let fields = text.lines().filter_map(|line| line.split_once(':'));
    fields
        .map(|(key, value)| (key.to_owned(), value.trim().to_owned()))
        .collect()
}

struct ThreadReport {
    who: &'static str,
    thread: i32,
    deeds: Vec<(&'static str, bool)>,
}

fn send_report(who: &'static str, door: std::net::SocketAddr, out: &Sender<ThreadReport>) {
    let _nobody = out.send(ThreadReport {
        who,
        // SAFETY: no memory is concerned.
        thread: unsafe { libc::gettid() },
        deeds: deeds(door),
    });
}

/// Runs a bridge beside a core and lets both of its threads try everything.
fn try_everything<const UDP: bool>(prefix: &str) -> (Vec<ThreadReport>, Vec<String>) {
    let machine =
        Machine::parse(&evolvent_file_tests::shipped("machines/mill-3axis.toml"), "mill").expect("a machine");
    let mut config = BusConfig::new("confined", "XYZ", 1_000_000);
    config.prefix = Some(prefix.to_owned());
    let core = CoreBus::open(&config).expect("a bus");
    let listener = TcpListener::bind("127.0.0.1:0").expect("a socket");
    let door = listener.local_addr().expect("its address");
    let stop = AtomicBool::new(false);
    let (out, reports) = channel();
    let messages = Mutex::new(Vec::new());
    let mut found = Vec::new();
    std::thread::scope(|scope| {
        let (stop, messages, machine) = (&stop, &messages, &machine);
        let (of_bus, of_session) = (out.clone(), out);
        scope.spawn(move || {
            let settings = BridgeSettings {
                machine,
                machine_name: Some("confined"),
                prefix: Some(prefix),
                duration: Some(Duration::from_secs(20)),
            };
            let on_message = |text: &str| {
                if text.starts_with("core found") {
                    send_report("bus", door, &of_bus);
                }
                messages.lock().expect("no panic").push(text.to_owned());
            };
            run_bridge(settings, &Bench::<UDP>, stop, on_message, |ends| {
                send_report("session", door, &of_session);
                while !ends.stop.load(Ordering::Relaxed) {
                    std::thread::sleep(Duration::from_millis(1));
                }
                Ok(())
            })
            .expect("a bridge that runs");
        });
        for _ in 0..2 {
            let one = reports
                .recv_timeout(Duration::from_secs(20))
                .expect("both threads to try");
            for (key, value) in status(one.thread) {
                match key.as_str() {
                    "CapEff" | "CapPrm" | "CapInh" | "CapAmb" => {
                        assert!(
                            value.chars().all(|digit| digit == '0'),
                            "{}: {key} {value}",
                            one.who
                        );
                    }
                    "NoNewPrivs" => assert_eq!(value, "1", "{}", one.who),
                    _ => {}
                }
            }
            found.push((one, status));
        }
        stop.store(true, Ordering::Relaxed);
    });
    drop(core);
    let _removed = remove_private_domain(prefix);
    let messages = messages.into_inner().expect("no panic");
    (found.into_iter().map(|(one, _)| one).collect(), messages)
}

#[test]
fn threads_of_a_bridge_can_do_nothing_but_their_work() {
    // Rights of this test itself; a sandbox may forbid more, and then the test proves nothing.
    let listener = TcpListener::bind("127.0.0.1:0").expect("a socket");
    let free = deeds(listener.local_addr().expect("its address"));
    assert!(free.iter().any(|(what, done)| *what == "read a file" && *done));
    for (udp, prefix) in [(false, "conf_a_"), (true, "conf_b_")] {
        let prefix = format!("{prefix}{}_", std::process::id());
        let (reports, messages) = if udp {
            try_everything::<true>(&prefix)
        } else {
            try_everything::<false>(&prefix)
        };
        let lacks = |what: &str| {
            messages
                .iter()
                .any(|text| text.starts_with("rights:") && text.contains(what))
        };
        for one in &reports {
            for (what, done) in &one.deeds {
                let may = udp && one.who == "session" && *what == "open a UDP socket";
                let by_files = matches!(*what, "read a file" | "list a folder" | "write a file");
                if lacks(if by_files { "files" } else { "system calls" }) {
                    println!("not measured: {what}: {messages:?}");
                    continue;
                }
                assert_eq!(*done, may, "{} with UDP {udp}: {what}", one.who);
            }
        }
    }
}

/// Exchanges two folders in one step: a bridge that looked between a removal and a new folder would report that
/// there is none.
fn exchange(one: &Path, other: &Path) {
    let name = |path: &Path| CString::new(path.as_os_str().as_bytes()).expect("a path without a zero");
    let (one, other) = (name(one), name(other));
    let here = libc::AT_FDCWD;
    // SAFETY: both names end in a zero and outlive the call.
    let result = unsafe { libc::renameat2(here, one.as_ptr(), here, other.as_ptr(), libc::RENAME_EXCHANGE) };
    assert_eq!(result, 0, "{}", std::io::Error::last_os_error());
}

/// A bridge cannot access a folder that replaces the one it may use: it reports this and ends, and does not
/// wait without end for a core that it cannot see.
#[test]
fn a_folder_that_is_made_again_ends_the_bridge() {
    // In another process, because the variable applies to the whole process.
    if std::env::var_os("EVOLVENT_CONFINED_CHILD").is_none() {
        let folder = tempfile::tempdir().expect("a folder");
        let output = Command::new(std::env::current_exe().expect("this test"))
            .args([
                "a_folder_that_is_made_again_ends_the_bridge",
                "--exact",
                "--nocapture",
            ])
            .env(RUNTIME_FOLDER, folder.path().join("bus"))
            .env("EVOLVENT_CONFINED_CHILD", "1")
            .output()
            .expect("to start");
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stdout)
        );
        return;
    }
    let folder = std::path::PathBuf::from(std::env::var_os(RUNTIME_FOLDER).expect("a folder"));
    let machine =
        Machine::parse(&evolvent_file_tests::shipped("machines/mill-3axis.toml"), "mill").expect("a machine");
    let stop = AtomicBool::new(false);
    let begin = Instant::now();
    let result = std::thread::scope(|scope| {
        let bridge = scope.spawn(|| {
            let settings = BridgeSettings {
                machine: &machine,
                machine_name: Some("confined"),
                prefix: None,
                duration: Some(Duration::from_secs(20)),
            };
            run_bridge(
                settings,
                &Bench::<false>,
                &stop,
                |text| println!("{text}"),
                |_| Ok(()),
            )
        });
        while !folder.exists() {
            std::thread::sleep(Duration::from_millis(1));
        }
        // By now it is looking for its core.
        std::thread::sleep(Duration::from_millis(200));
        let other = folder.with_extension("other");
        std::fs::DirBuilder::new()
            .mode(0o700)
            .create(&other)
            .expect("another");
        exchange(&folder, &other);
        bridge.join().expect("no panic")
    });
    assert!(matches!(result, Err(BridgeError::Folder { .. })), "{result:?}");
    assert!(begin.elapsed() < Duration::from_secs(15));
}
