//! Services of the operating system for real-time threads: scheduler, core, locked memory, absolute
//! deadlines.
//!
//! The only module of this crate with `unsafe`. Nothing here fails a run: what is not permitted is left out
//! and reported in a note that says how to permit it.

use core::num::NonZeroU64;
use rustix::io::Errno;
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit, setpriority_process};
use rustix::thread::{CapabilitySet, CpuSet, capabilities, clock_nanosleep_absolute, sched_setaffinity};
use rustix::time::{ClockId, Timespec, clock_gettime};
use std::fs::File;
use std::io::Write;

const NS_PER_S: u64 = 1_000_000_000;

/// Size of the stack that is touched before the loop starts, so that no page fault occurs later.
const PREFAULT_BYTES: usize = 256 * 1024;

/// The clock of every deadline: `CLOCK_MONOTONIC` in integer ns.
#[derive(Clone, Copy, Debug)]
pub struct MonotonicClock;

impl MonotonicClock {
    /// The time in ns. The cycle may call it: no system call where the clock source allows, no allocation.
    #[must_use]
    pub fn now_ns() -> u64 {
        let now = clock_gettime(ClockId::Monotonic);
        now.tv_sec.unsigned_abs() * NS_PER_S + now.tv_nsec.unsigned_abs()
    }

    /// Sleeps until a moment of this clock; returns at once if it has passed. Returns the lateness of the
    /// wake-up in ns.
    ///
    /// The cycle may call it: one system call, no allocation. Signals do not shorten it.
    #[must_use]
    pub fn sleep_until(deadline_ns: u64) -> u64 {
        let request = Timespec {
            tv_sec: (deadline_ns / NS_PER_S) as i64,
            tv_nsec: (deadline_ns % NS_PER_S) as _,
        };
        // Any other failure would mean an unknown clock; the loop then runs late, which is counted.
        while clock_nanosleep_absolute(ClockId::Monotonic, &request) == Err(Errno::INTR) {}
        Self::now_ns().saturating_sub(deadline_ns)
    }
}

/// Privileges that a thread requests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RealtimeRequest {
    /// Priority under `SCHED_FIFO`, 1 to 99; `None` for the normal scheduler.
    pub priority: Option<u8>,
    /// The core to pin the thread to.
    pub core: Option<usize>,
    /// Whether to lock the memory of the whole process, present and future, in RAM.
    pub lock_memory: bool,
}

/// Privileges that a thread received.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RealtimeGranted {
    /// Priority under `SCHED_FIFO`; `None` for the normal scheduler.
    pub priority: Option<u8>,
    /// The core it is pinned to.
    pub core: Option<usize>,
    /// Whether the process's memory is locked.
    pub memory_locked: bool,
    /// Requests that were not granted, with remedies; empty if all were granted.
    pub notes: Vec<String>,
}

/// Applies a request to the calling thread. Call it before the loop: it allocates and may take milliseconds.
#[must_use]
pub fn apply_to_this_thread(request: &RealtimeRequest) -> RealtimeGranted {
    let mut granted = RealtimeGranted::default();
    let notes = &mut granted.notes;
    if request.lock_memory {
        match lock_memory() {
            Ok(()) => granted.memory_locked = true,
            Err(note) => notes.push(note),
        }
    }
    if let Some(core) = request.core {
        match pin(core) {
            Ok(()) => granted.core = Some(core),
            Err(note) => notes.push(note),
        }
    }
    if let Some(priority) = request.priority {
        match set_fifo(priority) {
            Ok(()) => granted.priority = Some(priority),
            Err(note) => notes.push(note),
        }
    }
    if granted.priority.is_none() {
        // The normal scheduler adds 50 us to every sleep; real-time classes have no slack.
        let _ = rustix::thread::set_current_timer_slack(NonZeroU64::new(1));
    }
    prefault_stack();
    granted
}

fn lock_memory() -> Result<(), String> {
    // Under a finite limit the lock would be granted now and later allocations would fail, which is worse
    // than no lock.
    let limit = getrlimit(Resource::Memlock).current;
    let may_exceed = capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK));
    if let (Some(bytes), false) = (limit, may_exceed) {
        return Err(format!(
            "memory is not locked: the limit is {} KiB and must be unlimited; set `memlock unlimited` in \
             /etc/security/limits.conf (LimitMEMLOCK=infinity under systemd) or grant CAP_IPC_LOCK",
            bytes / 1024
        ));
    }
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE).map_err(|errno| {
        format!(
            "memory is not locked ({errno}): set `memlock unlimited` in /etc/security/limits.conf or \
                 grant CAP_IPC_LOCK"
        )
    })
}

fn pin(core: usize) -> Result<(), String> {
    if core >= CpuSet::MAX_CPU {
        return Err(format!(
            "not pinned: there is no core {core}; choose one of /sys/devices/system/cpu/online"
        ));
    }
    let mut cores = CpuSet::new();
    cores.set(core);
    sched_setaffinity(None, &cores).map_err(|errno| {
        format!(
            "not pinned to core {core} ({errno}): choose one of /sys/devices/system/cpu/online that this \
             process's cpuset allows"
        )
    })
}

fn set_fifo(priority: u8) -> Result<(), String> {
    if !(1..=99).contains(&priority) {
        return Err(format!(
            "no real-time scheduling: priority {priority} is out of range, choose 1 to 99"
        ));
    }
    let Err(cause) = set_class(libc::SCHED_FIFO, priority) else {
        return Ok(());
    };
    let limit = getrlimit(Resource::Rtprio)
        .current
        .map_or("unlimited".to_owned(), |n| n.to_string());
    Err(format!(
        "no real-time scheduling at priority {priority} ({cause}; `ulimit -r` is {limit}): set `rtprio \
         {priority}` in /etc/security/limits.conf (LimitRTPRIO={priority} under systemd) or grant \
         CAP_SYS_NICE"
    ))
}

fn set_class(class: libc::c_int, priority: u8) -> std::io::Result<()> {
    let parameters = libc::sched_param {
        sched_priority: i32::from(priority),
    };
    // Threads that this one starts must not inherit its class.
    let policy = class | libc::SCHED_RESET_ON_FORK;
    // SAFETY: thread 0 is the calling one; the parameters live until the call returns and are only read.
    let result = unsafe { libc::sched_setscheduler(0, policy, &raw const parameters) };
    if result == 0 {
        return Ok(());
    }
    Err(std::io::Error::last_os_error())
}

/// Priority of a thread with interactive work: below every thread of the motion.
const PROMPT: u8 = 1;

/// Gives the calling thread precedence over all threads of the normal scheduler, if permitted; otherwise over
/// most of them. Long work belongs to another thread.
pub(crate) fn raise_priority() {
    if set_class(libc::SCHED_FIFO, PROMPT).is_err() {
        hurry();
    }
}

/// Nice value of an interactive thread on the normal scheduler.
const HURRY: i32 = -10;

/// Gives the calling thread precedence on the normal scheduler, if permitted. Threads that it starts inherit
/// this; see [`take_turns`].
fn hurry() {
    // Without the permission the priority stays normal.
    let _denied = set_nice(HURRY);
    let _ = rustix::thread::set_current_timer_slack(NonZeroU64::new(1));
}

/// Restores normal precedence for the calling thread.
pub(crate) fn take_turns() {
    let _allowed = set_nice(0);
}

fn set_nice(nice: i32) -> rustix::io::Result<()> {
    // Linux keeps the value per thread.
    setpriority_process(Some(rustix::thread::gettid()), nice)
}

/// Minimum size of blocks with their own pages, bytes.
#[cfg(target_env = "gnu")]
const LARGE_BLOCK: libc::c_int = 256 * 1024;

/// Gives large blocks their own pages, which are returned when they are freed, and keeps the pages of small
/// blocks. Call it before other threads start.
///
/// Each job allocates the same queues and grids again, up to 12 MB. In a common heap, whose memory is locked,
/// they would leave holes. Once a small long-lived block is in such a hole, the next job's block no longer
/// fits, and the heap grows. Large blocks are allocated and freed with jobs, while the axes are at rest.
pub(crate) fn separate_large_blocks() {
    #[cfg(target_env = "gnu")]
    {
        // SAFETY: it only sets a number of the allocator.
        let _known = unsafe { libc::mallopt(libc::M_MMAP_THRESHOLD, LARGE_BLOCK) };
        // SAFETY: as above.
        let _known = unsafe { libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX) };
    }
}

/// Touches every page of the stack that the loop may use.
#[inline(never)]
fn prefault_stack() {
    let mut stack = [0u8; PREFAULT_BYTES];
    for byte in stack.iter_mut().step_by(4096) {
        *byte = 1;
    }
    std::hint::black_box(&stack);
}

/// Keeps the processor out of deep sleep states until it is dropped.
#[derive(Debug)]
pub struct LowLatencyHold {
    _file: File,
}

impl LowLatencyHold {
    /// Requests wake-ups without delay from the kernel.
    ///
    /// # Errors
    /// A note for the user if this is not permitted.
    pub fn acquire() -> Result<Self, String> {
        const PATH: &str = "/dev/cpu_dma_latency";
        let open = || -> std::io::Result<File> {
            let mut file = File::options().write(true).open(PATH)?;
            file.write_all(&0i32.to_ne_bytes())?;
            Ok(file)
        };
        open().map(|file| Self { _file: file }).map_err(|cause| {
            format!(
                "deep sleep states stay on ({PATH}: {cause}): give this user write permission by a udev rule"
            )
        })
    }
}

/// Free and total bytes of the file system of a path.
///
/// # Errors
/// The error of the operating system.
pub(crate) fn file_system_bytes(path: &core::ffi::CStr) -> std::io::Result<(u64, u64)> {
    let mut stats = core::mem::MaybeUninit::<libc::statvfs>::zeroed();
    // SAFETY: the path ends with a zero byte, and the pointer is to memory for the whole struct.
    let result = unsafe { libc::statvfs(path.as_ptr(), stats.as_mut_ptr()) };
    if result != 0 {
        return Err(std::io::Error::last_os_error());
    }
    // SAFETY: the struct is plain numbers and was zeroed, then filled by the call.
    let stats = unsafe { stats.assume_init() };
    Ok((
        stats.f_bavail.saturating_mul(stats.f_frsize),
        stats.f_blocks.saturating_mul(stats.f_frsize),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sleep_never_ends_before_its_deadline() {
        for step_ns in [0, 1, 1_000, 50_000, 2_000_000] {
            let deadline_ns = MonotonicClock::now_ns() + step_ns;
            let _ = MonotonicClock::sleep_until(deadline_ns);
            assert!(MonotonicClock::now_ns() >= deadline_ns, "step {step_ns} ns");
        }
    }

    #[test]
    fn a_past_deadline_returns_its_lateness_at_once() {
        let now_ns = MonotonicClock::now_ns();
        assert!(MonotonicClock::sleep_until(now_ns - 5_000_000) >= 5_000_000);
        assert!(MonotonicClock::sleep_until(0) >= now_ns);
    }

    #[test]
    fn nothing_asked_gives_no_note() {
        let granted = apply_to_this_thread(&RealtimeRequest::default());
        assert_eq!(granted, RealtimeGranted::default());
    }

    #[test]
    fn denied_realtime_requests_become_notes_with_advice() {
        for (request, word) in [
            (
                RealtimeRequest {
                    core: Some(1023),
                    ..Default::default()
                },
                "/sys/devices/system/cpu/online",
            ),
            (
                RealtimeRequest {
                    core: Some(usize::MAX),
                    ..Default::default()
                },
                "/sys/devices/system/cpu/online",
            ),
            (
                RealtimeRequest {
                    priority: Some(0),
                    ..Default::default()
                },
                "1 to 99",
            ),
            (
                RealtimeRequest {
                    priority: Some(200),
                    ..Default::default()
                },
                "1 to 99",
            ),
        ] {
            let granted = apply_to_this_thread(&request);
            assert_eq!((granted.core, granted.priority), (None, None));
            assert_eq!(granted.notes.len(), 1, "{:?}", granted.notes);
            assert!(granted.notes[0].contains(word), "{:?}", granted.notes);
        }
    }
}
