//! Real-time priority, locked memory, and the privileges to drop once the socket is open.

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use rustix::thread::{CapabilitySet, CapabilitySets, set_capabilities, set_no_new_privs};

/// Gives the calling thread `SCHED_FIFO`.
///
/// # Errors
/// The system does not permit it: a note that says how to permit it.
pub(crate) fn raise_priority(priority: u8) -> Result<(), String> {
    let parameters = libc::sched_param {
        sched_priority: i32::from(priority),
    };
    // Threads that this one starts do not inherit its class.
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: the parameters live through the call; 0 is the calling thread.
    if unsafe { libc::sched_setscheduler(0, policy, &raw const parameters) } == 0 {
        return Ok(());
    }
    let cause = std::io::Error::last_os_error();
    let limit = getrlimit(Resource::Rtprio)
        .current
        .map_or("unlimited".to_owned(), |limit| limit.to_string());
    Err(format!(
        "no real-time scheduling of the bridge at priority {priority} ({cause}; `ulimit -r` is {limit}), so \
         other work on this computer stops the machine: set `rtprio {priority}` in \
         /etc/security/limits.conf (LimitRTPRIO={priority} under systemd) or grant CAP_SYS_NICE"
    ))
}

/// Keeps the memory of the process, now and later, in RAM.
///
/// # Errors
/// The system does not permit it: a note that says how to permit it.
pub(crate) fn lock_memory() -> Result<(), String> {
    // Threads of a bridge drop CAP_IPC_LOCK. Under a finite limit the kernel would then refuse them memory,
    // so the limit has to go.
    if let Some(bytes) = getrlimit(Resource::Memlock).current {
        let none = Rlimit {
            current: None,
            maximum: None,
        };
        setrlimit(Resource::Memlock, none).map_err(|_not_permitted| {
            format!(
                "memory of the bridge is not locked: the limit is {} KiB and must be unlimited; set \
                 `memlock unlimited` in /etc/security/limits.conf (LimitMEMLOCK=infinity under systemd)",
                bytes / 1024
            )
        })?;
    }
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).map_err(|cause| {
        format!(
            "memory of the bridge is not locked ({cause}): set `memlock unlimited` in \
             /etc/security/limits.conf (LimitMEMLOCK=infinity under systemd)"
        )
    })
}

/// Drops every capability of the calling thread, and the ability to acquire new ones.
pub(crate) fn drop_capabilities() -> std::io::Result<()> {
    set_no_new_privs(true)?;
    let none = CapabilitySet::empty();
    set_capabilities(
        None,
        CapabilitySets {
            effective: none,
            permitted: none,
            inheritable: none,
        },
    )?;
    Ok(())
}
