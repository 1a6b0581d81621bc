//! Network namespaces for tests, with virtual cables whose ends are interfaces.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Time limit for the carrier of a cable: a busy host may need that.
const CARRIER: Duration = Duration::from_secs(30);

/// Moves the calling thread to a new network namespace.
///
/// # Errors
/// This user may not create a namespace.
pub fn own_namespace() -> Result<(), String> {
    // SAFETY: a new namespace of the network for the calling thread alone; no memory is concerned.
    let result = unsafe { libc::unshare(libc::CLONE_NEWNET) };
    if result == 0 {
        Ok(())
    } else {
        Err(format!(
            "no network namespace: {}",
            std::io::Error::last_os_error()
        ))
    }
}

/// Runs `ip` of iproute2 in the namespace of the calling thread.
///
/// # Errors
/// The message of `ip`.
pub fn ip(arguments: &[&str]) -> Result<(), String> {
    let ran = Command::new("ip").args(arguments).stdin(Stdio::null()).output();
    match ran {
        Ok(output) if output.status.success() => Ok(()),
        Ok(output) => Err(String::from_utf8_lossy(&output.stderr).trim().to_owned()),
        Err(error) => Err(format!("ip: {error}")),
    }
}

/// Waits until interfaces have a carrier, shortly after they were set up. Frames sent before that are lost.
///
/// # Panics
/// If there is no carrier in time.
pub fn await_carrier(interfaces: &[&str]) {
    let begin = Instant::now();
    while !interfaces.iter().all(|interface| is_up(interface)) {
        assert!(
            begin.elapsed() < CARRIER,
            "the cable has no carrier after {CARRIER:?}"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Whether an interface has a carrier, as the system shows it to this thread.
fn is_up(interface: &str) -> bool {
    let ran = Command::new("ip")
        .args(["-o", "link", "show", "dev", interface])
        .stdin(Stdio::null())
        .output();
    ran.is_ok_and(|output| String::from_utf8_lossy(&output.stdout).contains(" state UP "))
}
