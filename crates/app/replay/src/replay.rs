//! Publishes recorded setpoints on the bus again.

use evolvent_path::{AXES, AxisMask};
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Duration;

use evolvent_bus::{BusConfig, BusError, CoreBus, ReceiveError, SendError, Setpoint, Status};
use evolvent_drive::DriveState;
use evolvent_motion::flags;
use evolvent_runtime::MonotonicClock;
use evolvent_trace::CycleRecord;

use evolvent_inspect::Selection;
use evolvent_inspect::{InspectError, Opened};

/// Interval of status snapshots.
const STATUS_EVERY_NS: u64 = 50_000_000;
/// Number of times that the replay listens for drives before the first setpoint, and the pause in between:
/// half a second in total. The number is counted, because a process that was suspended for that time has not
/// listened.
const LISTEN_TIMES: u32 = 100;
const LISTEN_EVERY: Duration = Duration::from_millis(5);
/// Number of waits for clients, ten seconds in total; a request to end is noticed after each.
const SUBSCRIBER_TIMES: u32 = 200;
const SUBSCRIBER_EVERY: Duration = Duration::from_millis(50);
/// Maximum sleep, so that a request to end is noticed.
const POLL_INTERVAL_NS: u64 = 20_000_000;

/// Speed of the replay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// Factor on real time; 1 is as recorded.
    Factor(f64),
    /// A number of setpoints for each request of the caller.
    Step,
}

/// Settings of a replay.
#[derive(Clone, Debug)]
pub struct Replay {
    /// The part of the trace.
    pub selection: Selection,
    /// Speed of the replay.
    pub pace: Pace,
    /// The name on the bus; `None` for that of the recorded machine.
    pub machine_name: Option<String>,
    /// Prefix of iceoryx2; `None` for iceoryx2's default.
    pub bus_prefix: Option<String>,
    /// Wait until this many clients subscribe to setpoints.
    pub wait_for_subscribers: usize,
    /// Publish although drives are on. Requires both this and `machine_is_on`.
    pub force: bool,
    /// See `force`.
    pub machine_is_on: bool,
}

/// Why a replay failed or ended early.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// Error of the trace.
    #[error(transparent)]
    Inspect(#[from] InspectError),
    /// Error of the bus, for example because of a live core of that name.
    #[error(
        "{0}; a replay uses the name of a core: end that core, or give the replay another name with \
     --as"
    )]
    Bus(#[from] BusError),
    /// Drives with power listen under this name.
    #[error(
        "drives of {name} are on (a bridge answers with status word {status_word:#06x} on axis {axis}): a \
         replay would \
         move them. Switch them off, or choose another name with --as. If it is intended, use --force \
         --yes-machine-is-on"
    )]
    MachineIsOn {
        /// The machine's name.
        name: String,
        /// Index of the axis, XYZABCUVW.
        axis: usize,
        /// Status word of its drive.
        status_word: u32,
    },
    /// The selection contains nothing of the trace.
    #[error("no cycle of the trace is in this time and these lines")]
    Nothing,
    /// An invalid pace.
    #[error("a speed factor of {0} is not valid; give one from 0.001 to 1000")]
    Pace(f64),
    /// Feedback could not be read.
    #[error("feedback of the drives could not be received: {0}")]
    Listen(#[from] ReceiveError),
    /// A setpoint was not sent.
    #[error("a setpoint could not be published: {0}")]
    Send(#[from] SendError),
}

/// Result of a replay.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Replayed {
    /// Number of setpoints published.
    pub setpoints: u64,
    /// First and last cycle.
    pub first_sequence: u64,
    /// See `first_sequence`.
    pub last_sequence: u64,
    /// Duration, s.
    pub seconds: f64,
    /// Maximum number of clients.
    pub subscribers: u64,
    /// `stop` ended it before the last setpoint of the selection.
    pub stopped: bool,
}

/// Publishes recorded setpoints under the recorded machine's name, as its core did. For a stepped replay,
/// `steps` returns the number of setpoints to publish next. `stop` returns whether to end, which is possible
/// at any time; the result then reports it.
///
/// Drives with power are never moved unless this is confirmed twice: before the first setpoint the replay
/// listens for a bridge that reports a drive in "operation enabled". Setpoints carry no power request, so
/// drives without power stay so.
///
/// # Errors
/// [`ReplayError`].
pub fn replay(
    path: &Path,
    options: &Replay,
    mut steps: impl FnMut(&CycleRecord) -> ControlFlow<(), u64>,
    stop: impl Fn() -> bool,
) -> Result<Replayed, ReplayError> {
    if let Pace::Factor(factor) = options.pace
        && !(0.001..=1000.0).contains(&factor)
    {
        return Err(ReplayError::Pace(factor));
    }
    let mut opened = Opened::open(path)?;
    let name = options
        .machine_name
        .clone()
        .unwrap_or_else(|| opened.run.machine_name.clone());
    let mut config = BusConfig::new(&name, &opened.machine.axis_letters(), opened.run.period_ns);
    config.prefix.clone_from(&options.bus_prefix);
    let mut bus = CoreBus::open(&config)?;
    let axes_mask = opened
        .run
        .axes
        .iter()
        .map(|axis| axis.index())
        .collect::<AxisMask>()
        .bits();
    let mut status = first_status(&opened, axes_mask);
    publish_status(&mut bus, &mut status, None)?;
    if !(options.force && options.machine_is_on) {
        refuse_live_drives(&mut bus, &name, &stop)?;
    }
    let subscribers = wait_for_subscribers(&bus, options.wait_for_subscribers, &stop);
    let mut done = Replayed {
        subscribers: subscribers as u64,
        ..Replayed::default()
    };
    let increments = opened.machine.increments();
    let (first_ns, last_ns) = options.selection.span_ns(opened.run.start_time_ns);
    let selection = options.selection.clone();
    let mut begun: Option<(u64, u64)> = None;
    let mut next_status = 0;
    let mut allowed = 0;
    let mut last: Option<Setpoint> = None;
    let mut cycles = opened
        .trace
        .cycles_between(first_ns, last_ns)
        .filter(|record| {
            record
                .as_ref()
                .map_or(true, |record| selection.has_line(record.line))
        })
        .peekable();
    while let Some(record) = cycles.next() {
        let record = record.map_err(InspectError::from)?;
        if stop() {
            done.stopped = true;
            break;
        }
        let (start, start_due) = *begun.get_or_insert_with(|| (MonotonicClock::now_ns(), record.due_time_ns));
        let since_ns = record.due_time_ns.saturating_sub(start_due);
        let Some(due) = await_due(options.pace, start, since_ns, &stop, &mut allowed, || {
            steps(&record)
        }) else {
            done.stopped = stop();
            break;
        };
        let is_last = cycles.peek().is_none();
        let setpoint = message(
            &record,
            due,
            opened.run.period_ns,
            axes_mask,
            &increments,
            is_last,
        );
        bus.publish_setpoint(&setpoint)?;
        last = Some(setpoint);
        if done.setpoints == 0 {
            done.first_sequence = record.sequence;
        }
        done.setpoints += 1;
        done.last_sequence = record.sequence;
        let now = MonotonicClock::now_ns();
        if now >= next_status {
            next_status = now + STATUS_EVERY_NS;
            bus.admit_readers();
            done.subscribers = done.subscribers.max(bus.setpoint_subscribers() as u64);
            publish_status(&mut bus, &mut status, last.as_ref())?;
        }
    }
    publish_status(&mut bus, &mut status, last.as_ref())?;
    let Some((start, _)) = begun else {
        if done.stopped {
            return Ok(done);
        }
        return Err(ReplayError::Nothing);
    };
    done.seconds = MonotonicClock::now_ns().saturating_sub(start) as f64 * 1e-9;
    Ok(done)
}

/// The status of a replay before its first setpoint.
fn first_status(opened: &Opened, axes_mask: u32) -> Status {
    let mut status = Status::default();
    status.set_program(&format!("replay of {}", opened.run.program_name));
    status.period_ns = opened.run.period_ns;
    status.axes_mask = axes_mask;
    // Off: the status shows a replay, not a machine.
    status.machine_state = 1;
    status
}

/// Waits until the next setpoint, which was due `since_ns` after the first, is due; `None` if the replay is
/// to end. `steps` returns the number to publish next, and is called when no more are `allowed`.
fn await_due(
    pace: Pace,
    start_ns: u64,
    since_ns: u64,
    stop: &impl Fn() -> bool,
    allowed: &mut u64,
    steps: impl FnOnce() -> ControlFlow<(), u64>,
) -> Option<u64> {
    match pace {
        Pace::Factor(factor) => {
            let due = start_ns + (since_ns as f64 / factor) as u64;
            while MonotonicClock::now_ns() < due {
                if stop() {
                    return None;
                }
                let _late = MonotonicClock::sleep_until(due.min(MonotonicClock::now_ns() + POLL_INTERVAL_NS));
            }
            Some(due)
        }
        Pace::Step => {
            if *allowed == 0 {
                match steps() {
                    ControlFlow::Continue(count) => *allowed = count.max(1),
                    ControlFlow::Break(()) => return None,
                }
            }
            *allowed -= 1;
            Some(MonotonicClock::now_ns())
        }
    }
}

/// Waits until this many clients subscribe to setpoints, or until the replay is to end. Returns their number.
fn wait_for_subscribers(bus: &CoreBus, count: usize, stop: &impl Fn() -> bool) -> usize {
    let mut found = bus.wait_for_setpoint_subscribers(count, Duration::ZERO);
    for _ in 0..SUBSCRIBER_TIMES {
        if found >= count || stop() {
            break;
        }
        found = bus.wait_for_setpoint_subscribers(count, SUBSCRIBER_EVERY);
    }
    found
}

/// Checks whether a bridge whose drives have power sends feedback.
fn refuse_live_drives(bus: &mut CoreBus, name: &str, stop: &impl Fn() -> bool) -> Result<(), ReplayError> {
    for _ in 0..LISTEN_TIMES {
        if stop() {
            break;
        }
        bus.admit_readers();
        std::thread::sleep(LISTEN_EVERY);
        while let Some(feedback) = bus.feedback()? {
            // The upper half of the word belongs to the bridge.
            let is_on = |word: u32| DriveState::decode(word as u16) == Some(DriveState::OperationEnabled);
            if let Some(axis) = feedback.status_word.iter().position(|&word| is_on(word)) {
                return Err(ReplayError::MachineIsOn {
                    name: name.to_owned(),
                    axis,
                    status_word: feedback.status_word[axis],
                });
            }
        }
    }
    Ok(())
}

fn publish_status(bus: &mut CoreBus, status: &mut Status, last: Option<&Setpoint>) -> Result<(), SendError> {
    status.sequence += 1;
    status.time_ns = MonotonicClock::now_ns();
    status.setpoint_subscribers = bus.setpoint_subscribers() as u32;
    if let Some(last) = last {
        status.cycles = last.sequence + 1;
        status.follow(last);
    }
    bus.publish_status(status).map(|_| ())
}

fn message(
    record: &CycleRecord,
    due_time_ns: u64,
    period_ns: u64,
    axes_mask: u32,
    increments: &evolvent_path::Axes,
    is_last: bool,
) -> Setpoint {
    // The corrected position, if the core corrected it. Velocity and acceleration are recorded only for the
    // ideal setpoint: the corrections add at most a tenth of them.
    let position: [f64; AXES] = std::array::from_fn(|i| match record.drive_position[i] {
        sent if sent.is_nan() => record.position[i],
        sent => sent,
    });
    // A position in a damaged trace may be arbitrary; `as` clamps it.
    let grid = std::array::from_fn(|i| (position[i] * increments[i]).round() as i64);
    Setpoint {
        sequence: record.sequence,
        due_time_ns,
        period_ns,
        position,
        velocity: record.velocity,
        acceleration: record.acceleration,
        position_increments: grid,
        state: u32::from(record.state),
        flags: record.flags | if is_last { flags::LAST } else { 0 },
        line: record.line,
        axes_mask,
        feed_mm_s: record.feed_mm_s,
        override_ratio: record.override_,
        path_mm: record.path_mm,
        ..Setpoint::default()
    }
}

#[cfg(test)]
mod tests {
    use evolvent_path::Axes;

    use super::*;

    #[test]
    fn the_drives_are_sent_again_what_they_were_sent() {
        let mut record = CycleRecord {
            position: [1.0; AXES],
            drive_position: [f64::NAN; AXES],
            ..CycleRecord::default()
        };
        record.drive_position[1] = 1.0125;
        let sent = message(&record, 5, 1_000_000, 0b11, &Axes::repeat(1000.0), false);
        assert_eq!(sent.position[..3], [1.0, 1.0125, 1.0]);
        assert_eq!(sent.position_increments[..3], [1000, 1013, 1000]);
    }
}
