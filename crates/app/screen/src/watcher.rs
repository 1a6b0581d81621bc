//! The core's state for pages.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::extract::ws::Utf8Bytes;
use evolvent_bus::{
    ClientBus, ClientConfig, EveryStatusReader, FeedbackReader, InputReader, LoadReader, OutputReader,
    ReceiveError, Setpoint, SetpointReader, SpindleReader, Status, flags,
};
use evolvent_control::{Alarm, AlarmKind};
use evolvent_machine::SignalSettings;
use evolvent_path::AxisLetter;
use evolvent_runtime::MonotonicClock;

use crate::hub::{Hub, text};
use crate::messages::{LogKind, ScreenStatus, ToPage};
use crate::sampling::Sampler;
use crate::signal_board::SignalBoard;

/// 60 per second.
const FRAME: Duration = Duration::from_micros(16_667);
/// Interval of the values of inputs and outputs.
const SIGNALS: Duration = Duration::from_millis(100);
/// A core without a status for this time has ended.
const SILENCE: Duration = Duration::from_millis(500);
/// Below this difference, a position in work coordinates equals the machine position minus its offsets, mm.
const ROUNDING_MM: f64 = 1e-6;
/// Maximum number of samples per frame; beyond it the oldest are dropped.
const MAX_SAMPLES: usize = 4096;

/// The next frame of the pages.
#[derive(Clone, Default)]
pub(crate) struct Frame {
    pub(crate) status: Utf8Bytes,
    pub(crate) samples: Bytes,
    /// Values of inputs and outputs; empty if there are none.
    pub(crate) signals: Utf8Bytes,
    /// The status itself.
    pub(crate) present: Option<Arc<Status>>,
}

/// Starts the thread that reads the bus. It retries while there is no core.
pub(crate) fn spawn(
    config: ClientConfig,
    signals: SignalSettings,
    hub: Arc<Hub>,
    stop: Arc<AtomicBool>,
) -> std::io::Result<JoinHandle<()>> {
    std::thread::Builder::new()
        .name("screen-bus".into())
        .spawn(move || {
            while !stop.load(Ordering::Relaxed) {
                let board = SignalBoard::new(signals.clone());
                let opened = ClientBus::open(&config).and_then(|bus| {
                    Ok(Readers {
                        status: bus.every_status()?,
                        setpoints: bus.setpoints()?,
                        // The scope shows the channels that exist.
                        feedback: bus.feedback().ok(),
                        loads: bus.loads().ok(),
                        // A machine without signals has no such channels, and opening them would wait for
                        // them.
                        outputs: (!board.is_empty()).then(|| bus.outputs().ok()).flatten(),
                        inputs: (!board.is_empty()).then(|| bus.inputs().ok()).flatten(),
                        spindles: (!signals.spindles.is_empty())
                            .then(|| bus.spindles().ok())
                            .flatten(),
                        board,
                    })
                });
                match opened {
                    Ok(readers) => watch(readers, Sampler::new(&signals), &hub, &stop),
                    Err(_) => {
                        hub.show(
                            &ToPage::Core { alive: false },
                            Bytes::new(),
                            Utf8Bytes::default(),
                            None,
                        );
                        std::thread::sleep(SILENCE);
                    }
                }
            }
        })
}

/// The subscribed channels.
struct Readers {
    status: EveryStatusReader,
    setpoints: SetpointReader,
    feedback: Option<FeedbackReader>,
    loads: Option<LoadReader>,
    outputs: Option<OutputReader>,
    inputs: Option<InputReader>,
    spindles: Option<SpindleReader>,
    board: SignalBoard,
}

impl Readers {
    /// Reads everything new on the bus and returns the newest setpoint. Returns an error if the connection
    /// breaks.
    fn read(&mut self, sampler: &mut Sampler) -> Result<Option<Setpoint>, ReceiveError> {
        let mut newest = None;
        while let Some(setpoint) = self.setpoints.receive()? {
            sampler.setpoint(setpoint);
            newest = Some(setpoint);
        }
        if let Some(feedback) = &mut self.feedback {
            while let Some(answer) = feedback.receive()? {
                sampler.feedback(answer);
            }
        }
        if let Some(loads) = &mut self.loads {
            while let Some(load) = loads.receive()? {
                sampler.load(&load);
            }
        }
        if let Some(outputs) = &mut self.outputs {
            while let Some(message) = outputs.receive()? {
                self.board.take_outputs(message);
                sampler.signals.take_outputs(message);
            }
        }
        if let Some(inputs) = &mut self.inputs {
            while let Some(message) = inputs.receive()? {
                self.board.take_inputs(message);
                sampler.signals.take_inputs(message);
            }
        }
        if let Some(spindles) = &mut self.spindles {
            while let Some(message) = spindles.receive()? {
                sampler.signals.take_spindle(message);
            }
        }
        Ok(newest)
    }
}

/// Runs until the connection breaks.
fn watch(mut readers: Readers, mut sampler: Sampler, hub: &Hub, stop: &AtomicBool) {
    let (mut last_heard, mut last): (Instant, Option<Status>) = (Instant::now(), None);
    let (mut signals, mut signals_at) = (Utf8Bytes::default(), Instant::now());
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(FRAME);
        let Ok(newest) = readers.read(&mut sampler) else {
            return;
        };
        let mut samples = sampler.take();
        let excess = (samples.len() / sampler.sample_bytes()).saturating_sub(MAX_SAMPLES);
        samples.drain(..excess * sampler.sample_bytes());
        // The log has what is shorter than a frame, too.
        loop {
            match readers.status.receive() {
                Ok(Some(status)) => {
                    last_heard = Instant::now();
                    if let Some(before) = &last {
                        log_changes(hub, before, &status);
                    }
                    last = Some(status);
                }
                Ok(None) => break,
                Err(_) => return,
            }
        }
        if last_heard.elapsed() > SILENCE {
            hub.show(
                &ToPage::Core { alive: false },
                Bytes::new(),
                Utf8Bytes::default(),
                None,
            );
            std::thread::sleep(SILENCE / 2);
            continue;
        }
        if !readers.board.is_empty() && signals_at.elapsed() >= SIGNALS {
            signals_at = Instant::now();
            signals = text(&ToPage::Signals(readers.board.values(MonotonicClock::now_ns())));
        }
        let Some(mut shown) = last else { continue };
        if let Some(setpoint) = newest {
            follow(&mut shown, &setpoint);
        }
        let status = Box::new(ScreenStatus::from(&shown));
        hub.show(
            &ToPage::Status { status },
            Bytes::from(samples),
            signals.clone(),
            Some(Arc::new(shown)),
        );
    }
}

/// Updates a status to the newest setpoint.
fn follow(shown: &mut Status, setpoint: &Setpoint) {
    let work_of = |status: &Status, axis: usize| {
        status.position_machine[axis] - status.work_offset[axis] - status.tool_offset[axis]
    };
    // In a rotated system X and Y are not these differences. Only the core knows the rotation, so its figures
    // remain, one status old.
    let is_rotated =
        [0, 1].map(|axis| (shown.position_work[axis] - work_of(shown, axis)).abs() > ROUNDING_MM);
    let first = if is_rotated.contains(&true) { 2 } else { 0 };
    shorten(shown, setpoint);
    shown.follow(setpoint);
    shown.time_ns = setpoint.due_time_ns;
    for axis in first..shown.position_work.len() {
        shown.position_work[axis] = work_of(shown, axis);
    }
    shown.flags &= !flags::LATE;
}

/// Updates the distance to go to the same moment: the end of the move minus the position. On another line the
/// end is unknown here; without a move the distance is 0.
fn shorten(shown: &mut Status, setpoint: &Setpoint) {
    let has_move = shown.distance_to_go.iter().any(|distance| *distance != 0.0);
    if setpoint.line != shown.line || !has_move {
        return;
    }
    for axis in AxisLetter::ALL {
        let i = axis.index();
        let moved = setpoint.position[i] - shown.position_machine[i];
        // The status has angles within one turn.
        let turns = if axis.is_rotary() {
            (moved / 360.0).round()
        } else {
            0.0
        };
        shown.distance_to_go[i] -= moved - 360.0 * turns;
    }
    let driven_mm = (setpoint.path_mm - shown.path_mm).max(0.0);
    shown.path_to_go_mm = (shown.path_to_go_mm - driven_mm).max(0.0);
}

fn log_changes(hub: &Hub, before: &Status, now: &Status) {
    // The core has no message at the start of a job, so the same text in another job is a new message.
    let is_same_job = now.job == before.job;
    let logged = if is_same_job {
        before.operator_message()
    } else {
        ""
    };
    let message = added(logged, now.operator_message());
    let is_new = !message.is_empty();
    let mut is_logged = false;
    for &number in now.listed_alarms() {
        if before.listed_alarms().contains(&number) {
            continue;
        }
        let alarm = Alarm::from_number(number);
        let kind = match alarm.map(Alarm::kind) {
            Some(AlarmKind::Warning) => LogKind::Warning,
            _ => LogKind::Alarm,
        };
        let cure = alarm.map(|alarm| alarm.sentence().to_owned());
        let is_cause = now.listed_alarms().first() == Some(&number);
        // The core also sends the text of a lost reference as its message, because it remains when the alarm
        // of the lost link is cleared.
        let is_message = is_new && alarm == Some(Alarm::ReferenceLost);
        is_logged |= is_message;
        let text = match (is_cause, now.alarm_sentence(), &cure) {
            _ if is_message => message.to_owned(),
            (true, sentence, _) if !sentence.is_empty() => sentence.to_owned(),
            (_, _, Some(cure)) => cure.clone(),
            _ => format!("alarm {number}"),
        };
        hub.log(kind, Some(number), text, cure);
    }
    if is_new && !is_logged {
        hub.log(LogKind::Message, None, message.to_owned(), None);
    }
}

/// What a message has that the one before it had not: the core adds a message to those at the same stop.
fn added<'a>(before: &str, now: &'a str) -> &'a str {
    match now.strip_prefix(before) {
        Some(more) if !before.is_empty() && !more.is_empty() => more.strip_prefix("; ").unwrap_or(now),
        Some("") => "",
        _ => now,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_messages_at_one_stop_each_is_logged_once() {
        let hub = Hub::new(ToPage::Core { alive: true });
        let mut before = Status::default();
        for message in ["", "one", "one", "one; two", "one; two; three", "", "one", "ones"] {
            let mut now = before;
            now.set_message(message);
            log_changes(&hub, &before, &now);
            before = now;
        }
        let mut other = before;
        other.job += 1;
        log_changes(&hub, &before, &other);
        let logged = hub.log_entries();
        let logged: Vec<_> = logged.iter().map(|entry| entry.text.as_str()).collect();
        assert_eq!(logged, ["one", "two", "three", "one", "ones", "ones"]);
    }

    #[test]
    fn a_lost_link_logs_two_alarms_with_their_texts() {
        let hub = Hub::new(ToPage::Core { alive: true });
        let before = Status::default();
        let mut now = Status::default();
        for alarm in [Alarm::FeedbackStale, Alarm::ReferenceLost] {
            now.push_alarm(alarm.number());
        }
        now.set_alarm_text("the bridge is silent");
        now.set_message("home XYZ again");
        log_changes(&hub, &before, &now);
        log_changes(&hub, &now, &now);
        let logged = hub.log_entries();
        let logged: Vec<_> = logged
            .iter()
            .map(|entry| (entry.number, entry.text.as_str()))
            .collect();
        let expected = [(Some(401), "the bridge is silent"), (Some(418), "home XYZ again")];
        assert_eq!(logged, expected);
    }

    #[test]
    fn what_is_left_of_a_move_ends_where_the_move_ends() {
        let mut status = Status {
            line: 7,
            path_mm: 100.0,
            path_to_go_mm: 50.0,
            ..Status::default()
        };
        (status.position_machine[0], status.distance_to_go[0]) = (15.0, 4.0);
        // The rotary axis has just passed 0.
        (status.position_machine[3], status.distance_to_go[3]) = (359.0, 10.0);
        let mut setpoint = Setpoint {
            line: 7,
            path_mm: 101.0,
            ..Setpoint::default()
        };
        (setpoint.position[0], setpoint.position[3]) = (16.0, 721.0);
        let mut shown = status;
        follow(&mut shown, &setpoint);
        assert_eq!((shown.distance_to_go[0], shown.distance_to_go[3]), (3.0, 8.0));
        assert_eq!(shown.path_to_go_mm, 49.0);
        // The next line has another end, and a jog is not a move of a program.
        let mut next = status;
        follow(&mut next, &Setpoint { line: 8, ..setpoint });
        assert_eq!(next.distance_to_go, status.distance_to_go);
        status.distance_to_go = [0.0; 9];
        follow(&mut status, &setpoint);
        assert_eq!(status.distance_to_go, [0.0; 9]);
    }

    #[test]
    fn a_status_follows_setpoints_unless_rotated() {
        let at = |x: f64, y: f64, z: f64| [x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let status = |work: [f64; 9]| Status {
            position_machine: at(15.0, 26.0, 7.0),
            work_offset: at(5.0, 6.0, 1.0),
            tool_offset: at(0.0, 0.0, 2.0),
            position_work: work,
            ..Status::default()
        };
        let setpoint = Setpoint {
            position: at(16.0, 27.0, 8.0),
            ..Setpoint::default()
        };
        let mut plain = status(at(10.0, 20.0, 4.0));
        follow(&mut plain, &setpoint);
        assert_eq!(plain.position_work, at(11.0, 21.0, 5.0));
        // Rotated by 90 degrees: X of the workpiece is Y of the machine.
        let mut rotated = status(at(20.0, -10.0, 4.0));
        follow(&mut rotated, &setpoint);
        assert_eq!(rotated.position_work, at(20.0, -10.0, 5.0));
        assert_eq!(rotated.position_machine, setpoint.position);
    }
}
