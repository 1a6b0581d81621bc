//! Ownership of the bus: other users, files that were taken or truncated, few descriptors, and reserved
//! connections.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail as tests do, and say what they left out"
)]

mod common;

use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use common::PrivateDomain;
use evolvent_bus::{
    BusError, ClientBus, ControlClient, ControlServer, CoreBus, PLACES_FOR_BRIDGES, PLACES_FOR_OPERATORS,
    bus_folders, remove_private_domain,
};

/// A user that every Linux has.
const NOBODY: u32 = 65_534;

fn is_root() -> bool {
    let mine = std::fs::metadata("/proc/self").expect("this process");
    if mine.uid() != 0 {
        println!("left out: only root can play another user");
    }
    mine.uid() == 0
}

/// The counter of nodes: the segment that iceoryx2 creates for all users.
fn counters(domain: &PrivateDomain) -> Vec<PathBuf> {
    let is_counter = |file: &PathBuf| file.to_string_lossy().ends_with(".global_mgmt");
    domain.files().into_iter().filter(is_counter).collect()
}

fn mode(file: &Path) -> u32 {
    file.metadata().expect("a file").permissions().mode() & 0o777
}

/// Runs something that must end in time on a separate thread, because nothing else could end it.
fn within<T: Send + 'static>(limit: Duration, what: impl FnOnce() -> T + Send + 'static) -> T {
    let (sender, result) = std::sync::mpsc::channel();
    std::thread::spawn(move || sender.send(what()));
    result.recv_timeout(limit).expect("an end in time")
}

#[test]
fn no_file_of_the_bus_has_rights_for_other_users() {
    let domain = PrivateDomain::new();
    let core = CoreBus::open(&domain.core("mill")).expect("a core");
    let client = domain.client("mill");
    let _reader = client.setpoints().expect("a place");
    let _events = client.events().expect("a listener");
    let files = domain.files();
    assert!(files.len() > 15, "{files:?}");
    for file in files.iter().filter(|file| file.exists()) {
        assert_eq!(mode(file) & 0o077, 0, "{} {:o}", file.display(), mode(file));
    }
    assert_eq!(
        counters(&domain).len(),
        1,
        "one that was made here, and none of iceoryx2's own"
    );
    for (folder, _) in bus_folders(Some(&domain.prefix)).expect("folders") {
        assert_eq!(mode(&folder), 0o700, "{}", folder.display());
    }
    drop(core);
}

/// The name of the counter before it exists.
fn counter_to_be(domain: &PrivateDomain) -> PathBuf {
    drop(CoreBus::open(&domain.core("mill")).expect("a core"));
    let counter = counters(domain).remove(0);
    remove_private_domain(&domain.prefix).expect("cleared");
    assert!(!counter.exists());
    counter
}

#[test]
fn truncated_or_world_writable_counter_blocks_nobody() {
    let domain = PrivateDomain::new();
    let core = CoreBus::open(&domain.core("mill")).expect("a core");
    for (size, rights) in [(0, 0o666), (0, 0o600), (16, 0o666), (3, 0o600)] {
        let counter = counters(&domain).remove(0);
        let file = std::fs::OpenOptions::new()
            .write(true)
            .open(&counter)
            .expect("a counter");
        file.set_len(size).expect("cut off");
        std::fs::set_permissions(&counter, std::fs::Permissions::from_mode(rights)).expect("rights");
        let config = domain.client_config("mill");
        within(Duration::from_secs(20), move || {
            ClientBus::open(&config).map(drop)
        })
        .expect("a client");
        assert_eq!(mode(&counters(&domain).remove(0)), 0o600);
    }
    drop(core);
}

#[test]
fn file_of_another_user_is_reported_with_its_owner() {
    if !is_root() {
        return;
    }
    let domain = PrivateDomain::new();
    let counter = counter_to_be(&domain);
    // Root, which this test needs, removes a counter without a size; other users cannot, and get this error.
    {
        std::fs::write(&counter, [0; 16]).expect("a file");
        std::fs::set_permissions(&counter, std::fs::Permissions::from_mode(0o666)).expect("rights");
        chown(&counter, Some(NOBODY), Some(NOBODY)).expect("another owner");
        let config = domain.core("mill");
        let begin = Instant::now();
        let opened = within(Duration::from_secs(20), move || CoreBus::open(&config).map(drop));
        let error = opened.expect_err("not ours");
        assert!(matches!(error, BusError::Foreign { .. }), "{error}");
        let text = error.to_string();
        let file = counter.display().to_string();
        assert!(text.contains("nobody (65534)") && text.contains(&file), "{text}");
        assert!(begin.elapsed() < Duration::from_secs(5));
        std::fs::remove_file(&counter).expect("removed");
    }
    drop(CoreBus::open(&domain.core("mill")).expect("a core again"));
}

/// Not a test of its own: a core in a process with other limits. Does nothing in an ordinary run.
#[test]
fn child_opens_the_bus_and_says_what_became_of_it() {
    let Ok(prefix) = std::env::var("EVOLVENT_OWNERS_PREFIX") else {
        return;
    };
    // Set here, not by the shell: what the parent left open may not leave enough to load this executable.
    if let Ok(files) = std::env::var("EVOLVENT_OWNERS_FILES") {
        let current = Some(files.parse().expect("a number"));
        let maximum = rustix::process::getrlimit(rustix::process::Resource::Nofile).maximum;
        let limit = rustix::process::Rlimit { current, maximum };
        rustix::process::setrlimit(rustix::process::Resource::Nofile, limit).expect("a lower limit");
    }
    let opened = CoreBus::open(&evolvent_bus::BusConfig {
        prefix: Some(prefix),
        ..evolvent_bus::BusConfig::new("mill", "XYZ", common::PERIOD_NS)
    });
    println!(
        "opened: {}",
        opened.map_or_else(|error| error.to_string(), |_| "yes".to_owned())
    );
}

/// Output of a core in another process, started by this shell command.
fn child(domain: &PrivateDomain, shell: &str) -> String {
    let output = Command::new("sh")
        .arg("-c")
        .arg(format!("{shell} exec \"$0\" \"$@\""))
        .arg(std::env::current_exe().expect("a path"))
        .args([
            "--exact",
            "child_opens_the_bus_and_says_what_became_of_it",
            "--nocapture",
            "--test-threads",
            "1",
        ])
        .env("EVOLVENT_OWNERS_PREFIX", &domain.prefix)
        .output()
        .expect("a child");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let message = text
        .split_once("opened: ")
        .map(|(_, rest)| rest.lines().next().unwrap_or_default().to_owned());
    message.unwrap_or(text)
}

#[test]
fn too_few_descriptors_are_named_with_the_limit() {
    let domain = PrivateDomain::new();
    assert_eq!(child(&domain, "export EVOLVENT_OWNERS_FILES=4096;"), "yes");
    for limit in [12, 20, 40] {
        let message = child(&domain, &format!("export EVOLVENT_OWNERS_FILES={limit};"));
        assert!(
            message.contains(&format!("may have {limit}")) && message.contains("ulimit -n"),
            "{limit}: {message}"
        );
    }
}

#[test]
fn folder_of_another_user_is_refused_with_remedy() {
    if !is_root() {
        return;
    }
    let domain = PrivateDomain::new();
    let parent = tempfile::tempdir().expect("a folder");
    let folder = parent.path().join("bus");
    std::fs::create_dir(&folder).expect("a folder");
    let export = format!("export EVOLVENT_RUNTIME_DIR={};", folder.display());
    assert_eq!(child(&domain, &export), "yes");
    chown(&folder, Some(NOBODY), None).expect("another owner");
    let message = child(&domain, &export);
    assert!(
        message.contains("belongs to user nobody") && message.contains("run this as user nobody"),
        "{message}"
    );
    chown(&folder, Some(0), None).expect("ours again");
    std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(0o777)).expect("rights");
    let message = child(&domain, &export);
    assert!(
        message.contains("mode 777") && message.contains("chmod 700"),
        "{message}"
    );
    // The counter of that folder, which no other process uses.
    for counter in counters(&domain) {
        std::fs::remove_file(counter).expect("removed");
    }
}

#[test]
fn missing_core_error_names_owner_of_another_core() {
    if !is_root() {
        return;
    }
    let domain = PrivateDomain::new();
    let segment = PathBuf::from(format!("/dev/shm/{}00000000-x_1.dynamic", domain.prefix));
    std::fs::write(&segment, "").expect("a segment");
    chown(&segment, Some(NOBODY), None).expect("another owner");
    let config = evolvent_bus::ClientConfig {
        wait: Duration::from_millis(30),
        ..domain.client_config("mill")
    };
    let error = ClientBus::open(&config).expect_err("no core of ours").to_string();
    let elsewhere = evolvent_bus::cores_of_other_users(Some(&domain.prefix));
    std::fs::remove_file(&segment).expect("removed");
    assert!(elsewhere.contains("nobody (65534) has a core"), "{elsewhere}");
    assert_eq!(evolvent_bus::cores_of_other_users(Some(&domain.prefix)), "");
    assert!(
        error.contains("nobody (65534) has a core") && error.contains("sudo -u nobody evolvent"),
        "{error}"
    );
}

#[test]
fn screens_leave_places_for_bridges_and_operators() {
    let domain = PrivateDomain::new();
    let core = CoreBus::open(&domain.core("mill")).expect("a core");
    let server = ControlServer::open(&domain.core("mill")).expect("the control service");
    let client = domain.client("mill");
    let readers: Vec<_> = std::iter::from_fn(|| client.setpoints().ok()).take(100).collect();
    assert_eq!(readers.len(), 8);
    let bridges: Vec<_> = std::iter::from_fn(|| client.bridge_setpoints().ok())
        .take(100)
        .collect();
    assert_eq!(bridges.len(), PLACES_FOR_BRIDGES);
    let screens: Vec<_> = std::iter::from_fn(|| client.status().ok()).take(100).collect();
    assert_eq!(screens.len(), 32);
    let operators: Vec<_> = std::iter::from_fn(|| client.operator_status().ok())
        .take(100)
        .collect();
    assert_eq!(operators.len(), PLACES_FOR_OPERATORS);
    let config = domain.client_config("mill");
    let clients: Vec<_> = std::iter::from_fn(|| ControlClient::open(&config).ok())
        .take(100)
        .collect();
    assert_eq!(clients.len(), 32);
    let in_need = (0..PLACES_FOR_OPERATORS).map(|_| ControlClient::open_in_need(&config));
    assert!(in_need.collect::<Vec<_>>().iter().all(Result::is_ok));
    drop((clients, server, core));
}
