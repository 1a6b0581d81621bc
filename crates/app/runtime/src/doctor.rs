//! Suitability of this host for a real-time loop: facts with advice, and lateness measured by a bare loop.

use crate::host::{Interrupts, RemoveIpc, governors, interrupts_allowed_on, names_core, remove_ipc};
use crate::rt::{
    LowLatencyHold, MonotonicClock, RealtimeGranted, RealtimeRequest, apply_to_this_thread, file_system_bytes,
};
use core::time::Duration;
use evolvent_bus::{BusConfig, ClientBus, ClientConfig, CoreBus, Setpoint};
use hdrhistogram::Histogram;
use rustix::process::{Resource, getrlimit};
use std::fs::read_to_string;
use thiserror::Error;

/// Maximum wake-up delay of the histogram, ns; longer ones count as this value.
const LONGEST_NS: u64 = 60_000_000_000;

/// Why a measurement is not possible.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum BareLoopError {
    /// The rate is invalid.
    #[error("a rate of {rate_hz} Hz cannot be measured: choose 1 to 200000")]
    Rate {
        /// The requested rate in Hz.
        rate_hz: f64,
    },
    /// The duration is invalid.
    #[error("{seconds} s cannot be measured: choose more than 0 and at most 3600")]
    Duration {
        /// The requested duration in s.
        seconds: f64,
    },
    /// The operating system cannot start a thread.
    #[error("no thread could be started ({cause}): close other programs and try again")]
    Thread {
        /// The operating system's error.
        cause: String,
    },
}

/// Lateness of a loop's wake-ups.
#[derive(Clone, Debug, PartialEq)]
pub struct LatenessReport {
    /// The rate in Hz.
    pub rate_hz: f64,
    /// The period in ns.
    pub period_ns: u64,
    /// Number of wake-ups.
    pub cycles: u64,
    /// Median lateness, ns.
    pub p50_ns: u64,
    /// 99th percentile of lateness, ns.
    pub p99_ns: u64,
    /// 99.9th percentile of lateness, ns.
    pub p999_ns: u64,
    /// Maximum lateness, ns.
    pub max_ns: u64,
    /// Number of wake-ups late by more than one period.
    pub over_period: u64,
    /// Privileges of the measuring thread.
    pub granted: RealtimeGranted,
}

/// Runs a loop on a separate thread that only wakes up at absolute deadlines.
///
/// It is the reference for a real loop in the same run: its lateness is that of the host.
///
/// # Errors
/// Rate or duration are invalid, or no thread can be started.
pub fn bare_loop(
    rate_hz: f64,
    duration: Duration,
    request: &RealtimeRequest,
) -> Result<LatenessReport, BareLoopError> {
    if !(1.0..=200_000.0).contains(&rate_hz) {
        return Err(BareLoopError::Rate { rate_hz });
    }
    if duration.is_zero() || duration > Duration::from_secs(3600) {
        return Err(BareLoopError::Duration {
            seconds: duration.as_secs_f64(),
        });
    }
    let period_ns = (1e9 / rate_hz) as u64;
    let cycles = (duration.as_nanos() as u64 / period_ns).max(1);
    let failed = |cause: &dyn ToString| BareLoopError::Thread {
        cause: cause.to_string(),
    };
    let mut histogram =
        Histogram::<u64>::new_with_bounds(1, LONGEST_NS, 3).map_err(|cause| failed(&cause))?;
    std::thread::scope(|scope| {
        // A separate thread, so that the caller keeps its scheduler and core.
        let thread = std::thread::Builder::new()
            .name("bare-loop".to_owned())
            .spawn_scoped(scope, || {
                let granted = apply_to_this_thread(request);
                let mut over_period = 0;
                let start_ns = MonotonicClock::now_ns() + 10_000_000;
                for cycle in 0..cycles {
                    let late_ns = MonotonicClock::sleep_until(start_ns + cycle * period_ns);
                    histogram.saturating_record(late_ns);
                    over_period += u64::from(late_ns > period_ns);
                }
                LatenessReport {
                    rate_hz,
                    period_ns,
                    cycles,
                    p50_ns: histogram.value_at_quantile(0.5),
                    p99_ns: histogram.value_at_quantile(0.99),
                    p999_ns: histogram.value_at_quantile(0.999),
                    max_ns: histogram.max(),
                    over_period,
                    granted,
                }
            });
        thread
            .map_err(|cause| failed(&cause))?
            .join()
            .map_err(|_| failed(&"the thread ended unexpectedly"))
    })
}

/// Assessment of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// As recommended.
    Good,
    /// Works, with more lateness than necessary.
    Fair,
    /// Real-time runs will be late or impossible.
    Bad,
}

/// One fact about the host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Name of the fact; stable, for scripts.
    pub name: &'static str,
    /// The observed value.
    pub value: String,
    /// The assessment.
    pub verdict: Verdict,
    /// Remedy, if the value is not good.
    pub advice: Option<String>,
}

impl Finding {
    fn new(name: &'static str, value: impl Into<String>, verdict: Verdict, advice: &str) -> Self {
        let advice = (verdict != Verdict::Good).then(|| advice.to_owned());
        Self {
            name,
            value: value.into(),
            verdict,
            advice,
        }
    }
}

/// Result of an examination.
#[derive(Clone, Debug, PartialEq)]
pub struct DoctorReport {
    /// Facts about the host.
    pub findings: Vec<Finding>,
    /// The measurement.
    pub lateness: LatenessReport,
}

/// Examines the host, then measures with the best privileges available to this user. Takes `duration` and
/// about 0.1 s.
///
/// # Errors
/// Rate or duration are invalid.
pub fn examine(rate_hz: f64, duration: Duration) -> Result<DoctorReport, BareLoopError> {
    let mut findings = facts();
    let isolated = first_core(&file("/sys/devices/system/cpu/isolated"));
    let request = RealtimeRequest {
        priority: Some(80),
        core: isolated,
        lock_memory: true,
    };
    let hold = LowLatencyHold::acquire();
    findings.push(match &hold {
        Ok(_) => Finding::new("sleep_states", "deep states can be kept off", Verdict::Good, ""),
        Err(note) => Finding::new(
            "sleep_states",
            note.clone(),
            Verdict::Fair,
            "permit /dev/cpu_dma_latency",
        ),
    });
    let before = Interrupts::now();
    let lateness = bare_loop(rate_hz, duration, &request)?;
    findings.push(interrupts(&before, &Interrupts::now(), isolated, duration));
    findings.extend(judge(&lateness));
    Ok(DoctorReport { findings, lateness })
}

/// Interrupts of the loop's core during the measurement, or of the core with the most interrupts if none is
/// isolated.
fn interrupts(
    before: &Interrupts,
    after: &Interrupts,
    isolated: Option<usize>,
    duration: Duration,
) -> Finding {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let busiest = (0..cores).max_by_key(|core| total(&after.since(before, *core)));
    let core = isolated.or(busiest).unwrap_or(0);
    let came = after.since(before, core);
    let a_second = total(&came) as f64 / duration.as_secs_f64().max(1e-3);
    let top_sources: Vec<String> = came
        .iter()
        .take(3)
        .map(|(source, count)| format!("{source}: {count}"))
        .collect();
    // An isolated core needs no advice; other cores serve the host.
    let bound = if isolated.is_some() { 10.0 } else { 1000.0 };
    let list = if top_sources.is_empty() {
        String::new()
    } else {
        format!(" ({})", top_sources.join(", "))
    };
    Finding::new(
        "interrupts",
        format!("{a_second:.0} a second on core {core}, besides its timer{list}"),
        if a_second <= bound {
            Verdict::Good
        } else {
            Verdict::Fair
        },
        "keep devices off the loop's core (docs/host.md, interrupts)",
    )
}

fn total(came: &[(String, u64)]) -> u64 {
    came.iter().map(|(_, count)| count).sum()
}

fn judge(lateness: &LatenessReport) -> Vec<Finding> {
    let granted = &lateness.granted;
    let mut findings = vec![
        Finding::new(
            "scheduler",
            granted.priority.map_or("normal".to_owned(), |priority| {
                format!("SCHED_FIFO at priority {priority}")
            }),
            if granted.priority.is_some() {
                Verdict::Good
            } else {
                Verdict::Bad
            },
            "set `rtprio 80` for this user in /etc/security/limits.conf, or grant CAP_SYS_NICE",
        ),
        Finding::new(
            "locked_memory",
            if granted.memory_locked {
                "memory can be locked"
            } else {
                "memory cannot be locked"
            },
            if granted.memory_locked {
                Verdict::Good
            } else {
                Verdict::Bad
            },
            "set `memlock unlimited` for this user in /etc/security/limits.conf, or grant CAP_IPC_LOCK",
        ),
    ];
    let verdict = match lateness.over_period {
        0 if lateness.max_ns * 2 < lateness.period_ns => Verdict::Good,
        0 => Verdict::Fair,
        over if over * 1_000 < lateness.cycles => Verdict::Fair,
        _ => Verdict::Bad,
    };
    findings.push(Finding::new(
        "lateness",
        format!(
            "at {:.0} Hz the latest of {} wake-ups was {:.1} us late, {} later than a period of {:.1} us",
            lateness.rate_hz,
            lateness.cycles,
            lateness.max_ns as f64 / 1e3,
            lateness.over_period,
            lateness.period_ns as f64 / 1e3
        ),
        verdict,
        "choose more lead cycles or a lower rate, and follow the advice of the other findings",
    ));
    findings
}

/// Facts that need no measurement.
fn facts() -> Vec<Finding> {
    let isolated = file("/sys/devices/system/cpu/isolated");
    let mut findings = vec![kernel(), preemption(), hypervisor(), isolated_cores(&isolated)];
    if let Some(core) = first_core(&isolated) {
        findings.extend([tick_on(core), interrupts_of_devices(core)]);
    }
    findings.push(cpu_frequency());
    findings.extend(limits_of_user());
    findings.extend([
        shared_memory_of_user(),
        timer_slack(),
        rt_throttling(),
        timer_resolution(),
        clock_source(),
        shared_memory(),
        bus(),
    ]);
    findings
}

fn kernel() -> Finding {
    Finding::new("kernel", file("/proc/sys/kernel/osrelease"), Verdict::Good, "")
}

fn preemption() -> Finding {
    let version = file("/proc/version");
    let realtime = file("/sys/kernel/realtime") == "1" || version.contains("PREEMPT_RT");
    Finding::new(
        "preemption",
        if realtime {
            "PREEMPT_RT"
        } else if version.contains("PREEMPT") {
            "PREEMPT, without RT"
        } else {
            "no full preemption"
        },
        if realtime { Verdict::Good } else { Verdict::Fair },
        "boot a kernel with PREEMPT_RT (linux-image-rt-amd64 on Debian, a real-time kernel of Ubuntu Pro)",
    )
}

fn hypervisor() -> Finding {
    let hypervisor = file("/proc/cpuinfo")
        .lines()
        .any(|l| l.starts_with("flags") && l.contains(" hypervisor"));
    Finding::new(
        "machine",
        if hypervisor { "virtual" } else { "physical" },
        if hypervisor { Verdict::Fair } else { Verdict::Good },
        "a hypervisor delays wake-ups by tenths of milliseconds: run machines on bare metal",
    )
}

fn isolated_cores(isolated: &str) -> Finding {
    let online = file("/sys/devices/system/cpu/online");
    Finding::new(
        "isolated_cores",
        if isolated.is_empty() {
            format!("none of {online}")
        } else {
            format!("{isolated} of {online}")
        },
        if isolated.is_empty() {
            Verdict::Fair
        } else {
            Verdict::Good
        },
        "boot with `isolcpus=N nohz_full=N rcu_nocbs=N irqaffinity=0` and set that core in the machine file",
    )
}

/// Whether the scheduler's tick is off on an isolated core.
fn tick_on(core: usize) -> Finding {
    let nohz = file("/sys/devices/system/cpu/nohz_full");
    let quiet = names_core(&nohz, core);
    Finding::new(
        "nohz_full",
        if nohz.is_empty() { "none".to_owned() } else { nohz },
        if quiet { Verdict::Good } else { Verdict::Fair },
        "boot with `nohz_full=N rcu_nocbs=N` for the isolated core too: the scheduler's tick then leaves it \
         alone",
    )
}

fn interrupts_of_devices(core: usize) -> Finding {
    let allowed = interrupts_allowed_on(core);
    Finding::new(
        "irq_affinity",
        format!("{} devices may interrupt core {core}", allowed.len()),
        if allowed.is_empty() {
            Verdict::Good
        } else {
            Verdict::Fair
        },
        "boot with `irqaffinity=0`, stop irqbalance, and write 0 to /proc/irq/N/smp_affinity_list \
         (docs/host.md)",
    )
}

fn cpu_frequency() -> Finding {
    let governors = governors();
    let steady = governors.iter().all(|governor| governor == "performance");
    Finding::new(
        "cpu_frequency",
        if governors.is_empty() {
            "not controlled by this kernel".to_owned()
        } else {
            governors.join(", ")
        },
        if steady { Verdict::Good } else { Verdict::Fair },
        "run `cpupower frequency-set -g performance`",
    )
}

/// Real-time priority and locked memory available to this user.
fn limits_of_user() -> [Finding; 2] {
    // A process with the capability needs no limit. What the thread really got is measured below.
    let privileged = rustix::process::geteuid().is_root();
    let limit = |resource| getrlimit(resource).current;
    let said = |limit: Option<u64>| limit.map_or("unlimited".to_owned(), |n| n.to_string());
    let (rtprio, memlock) = (limit(Resource::Rtprio), limit(Resource::Memlock));
    let priority = Finding::new(
        "limit_rtprio",
        said(rtprio),
        if privileged || rtprio.is_none_or(|limit| limit >= 80) {
            Verdict::Good
        } else {
            Verdict::Fair
        },
        "set `rtprio 80` for this user in /etc/security/limits.conf, or LimitRTPRIO=80 in the service",
    );
    let memory = Finding::new(
        "limit_memlock_bytes",
        said(memlock),
        if privileged || memlock.is_none() {
            Verdict::Good
        } else {
            Verdict::Fair
        },
        "set `memlock unlimited` for this user in /etc/security/limits.conf, or LimitMEMLOCK=infinity in \
         the service",
    );
    [priority, memory]
}

/// Whether shared memory survives the end of the user's session.
fn shared_memory_of_user() -> Finding {
    match remove_ipc() {
        RemoveIpc::NoLogind => Finding::new("remove_ipc", "no logind here", Verdict::Good, ""),
        RemoveIpc::Kept => Finding::new(
            "remove_ipc",
            "shared memory outlives a session",
            Verdict::Good,
            "",
        ),
        RemoveIpc::Removed if rustix::process::getuid().as_raw() < 1000 => Finding::new(
            "remove_ipc",
            "a system user's shared memory is kept",
            Verdict::Good,
            "",
        ),
        RemoveIpc::Removed => Finding::new(
            "remove_ipc",
            "logind deletes this user's shared memory at the end of the last session",
            Verdict::Fair,
            "write RemoveIPC=no into /etc/systemd/logind.conf and restart systemd-logind, or run as a \
             system user",
        ),
    }
}

fn timer_slack() -> Finding {
    let slack = rustix::thread::current_timer_slack().map_or("unknown".to_owned(), |n| n.to_string());
    Finding::new("timer_slack_ns", slack, Verdict::Good, "")
}

fn rt_throttling() -> Finding {
    let throttle = file("/proc/sys/kernel/sched_rt_runtime_us");
    Finding::new(
        "rt_throttling",
        if throttle == "-1" {
            "off".to_owned()
        } else {
            format!("{throttle} us a second")
        },
        Verdict::Good,
        "",
    )
}

fn timer_resolution() -> Finding {
    let resolution = rustix::time::clock_getres(rustix::time::ClockId::Monotonic);
    let fine = resolution.tv_sec == 0 && resolution.tv_nsec <= 1_000;
    Finding::new(
        "timer_resolution_ns",
        resolution.tv_nsec.to_string(),
        if fine { Verdict::Good } else { Verdict::Bad },
        "boot a kernel with high-resolution timers (CONFIG_HIGH_RES_TIMERS, no `highres=off`)",
    )
}

fn clock_source() -> Finding {
    let source = file("/sys/devices/system/clocksource/clocksource0/current_clocksource");
    let direct = matches!(
        source.as_str(),
        "tsc" | "arch_sys_counter" | "kvm-clock" | "hyperv_clocksource_tsc_page"
    );
    Finding::new(
        "clock_source",
        source,
        if direct { Verdict::Good } else { Verdict::Fair },
        "a clock read by a system call costs about 1 us a cycle: find out why the kernel distrusts `tsc` \
         (dmesg)",
    )
}

/// Whether a setpoint can be sent over the bus.
fn bus() -> Finding {
    match try_bus() {
        Ok(()) => Finding::new("bus", "a setpoint went from core to client", Verdict::Good, ""),
        Err(cause) => Finding::new(
            "bus",
            cause,
            Verdict::Bad,
            "remove the cause; until then runs need `--no-bus`",
        ),
    }
}

fn shared_memory() -> Finding {
    const MIB: u64 = 1 << 20;
    let advice =
        "enlarge /dev/shm to 256 MiB (`mount -o remount,size=256M /dev/shm`; `--shm-size` for containers)";
    match file_system_bytes(c"/dev/shm") {
        Ok((free, total)) => Finding::new(
            "shared_memory",
            format!("{} MiB free of {} MiB", free / MIB, total / MIB),
            if free >= 128 * MIB {
                Verdict::Good
            } else {
                Verdict::Fair
            },
            advice,
        ),
        Err(cause) => Finding::new(
            "shared_memory",
            format!("/dev/shm: {cause}"),
            Verdict::Bad,
            advice,
        ),
    }
}

/// Sends one setpoint through shared memory, without disturbing running machines.
fn try_bus() -> Result<(), String> {
    let name = format!("doctor-{}-{}", std::process::id(), MonotonicClock::now_ns());
    let mut core =
        CoreBus::open(&BusConfig::new(&name, "XYZ", 1_000_000)).map_err(|error| error.to_string())?;
    let client = ClientConfig::new(&name);
    let client = ClientBus::open(&client).map_err(|error| error.to_string())?;
    let mut setpoints = client.setpoints().map_err(|error| error.to_string())?;
    let sent = Setpoint {
        sequence: 42,
        ..Setpoint::default()
    };
    core.publish_setpoint(&sent).map_err(|error| error.to_string())?;
    match setpoints.receive().map_err(|error| error.to_string())? {
        Some(received) if received == sent => Ok(()),
        Some(_) => Err("a setpoint arrived damaged".to_owned()),
        None => Err("a setpoint did not arrive".to_owned()),
    }
}

/// The text of a small file of the kernel; empty if missing.
fn file(path: &str) -> String {
    read_to_string(path).unwrap_or_default().trim().to_owned()
}

/// The first core of a list such as `2-3,5`.
fn first_core(list: &str) -> Option<usize> {
    list.split([',', '-']).next()?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bare_loop_wakes_once_a_period() {
        let begin_ns = MonotonicClock::now_ns();
        let report =
            bare_loop(1000.0, Duration::from_millis(100), &RealtimeRequest::default()).expect("a loop");
        let taken_ns = MonotonicClock::now_ns() - begin_ns;
        assert_eq!((report.cycles, report.period_ns), (100, 1_000_000));
        assert!(taken_ns >= 99 * 1_000_000, "{taken_ns} ns for 100 periods");
        assert!(report.p50_ns <= report.p99_ns && report.p99_ns <= report.p999_ns);
        assert!(report.p999_ns <= report.max_ns);
    }

    #[test]
    fn absurd_rates_and_durations_are_named() {
        let request = RealtimeRequest::default();
        let second = Duration::from_secs(1);
        for rate_hz in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9] {
            assert!(
                matches!(
                    bare_loop(rate_hz, second, &request),
                    Err(BareLoopError::Rate { .. })
                ),
                "{rate_hz}"
            );
        }
        for duration in [Duration::ZERO, Duration::MAX] {
            assert!(matches!(
                bare_loop(1e3, duration, &request),
                Err(BareLoopError::Duration { .. })
            ));
        }
    }

    #[test]
    fn every_finding_that_is_not_good_says_what_to_do() {
        let report = examine(1000.0, Duration::from_millis(50)).expect("a report");
        for finding in &report.findings {
            assert!(!finding.value.is_empty(), "{finding:?}");
            let advised = finding.advice.as_deref().is_some_and(|advice| !advice.is_empty());
            assert_eq!(advised, finding.verdict != Verdict::Good, "{finding:?}");
        }
    }

    #[test]
    fn the_first_core_of_a_list_is_read() {
        let cases = [
            ("", None),
            ("3", Some(3)),
            ("2-3,5", Some(2)),
            ("1,4", Some(1)),
            ("x", None),
        ];
        for (list, core) in cases {
            assert_eq!(first_core(list), core, "{list:?}");
        }
    }
}
