//! The connection of one page.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::ws::{Message, Utf8Bytes, WebSocket};
use evolvent_bus::{ControlRequest, Status};
use evolvent_control::CommandCode;
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use tokio::sync::mpsc;

use crate::command::{STOPPING, code_of, request_of};
use crate::gate::Role;
use crate::hub::{Visitor, text};
use crate::messages::{CommandMessage, FromPage, LogKind, ToPage};
use crate::orders::Answer;
use crate::server::Server;

/// A message that is not sent within this time ends the connection.
const SLOW: Duration = Duration::from_secs(10);
/// Commands that come many times a second while a finger moves: they are logged once.
const REPEATED: [CommandCode; 5] = [
    CommandCode::Jog,
    CommandCode::JogStop,
    CommandCode::FeedOverride,
    CommandCode::RapidOverride,
    CommandCode::SpindleOverride,
];
/// Maximum number of messages at once, and per second.
const BURST: f64 = 400.0;
const RATE: f64 = 200.0;
/// A jog renewal that has waited longer is out of date.
const KEEP_AGE: Duration = Duration::from_millis(40);
/// The same for a jog.
const JOG_AGE: Duration = Duration::from_millis(250);
/// The same for commands that stop.
const AGE: Duration = Duration::from_secs(5);
/// The same for other commands: who pressed has looked elsewhere since.
const PRESS_AGE: Duration = Duration::from_secs(1);
/// Maximum age of the status that a page had before it when it sent a command that does not stop. A dead link that comes back
/// delivers what was sent on it, many seconds later.
const MAX_SEEN_AGE_NS: u64 = 1_000_000_000;
/// A page that has control and sends nothing for this time loses it.
const LEASE_SILENCE: Duration = Duration::from_secs(3);

/// `activity` of a jog in the status.
const JOG: u32 = 3;

/// Serves a page until its connection ends.
pub(crate) async fn serve(server: Arc<Server>, socket: WebSocket, visitor: Visitor) {
    let role = visitor.role;
    let Some((number, messages)) = server.hub.join(visitor) else {
        return;
    };
    let (sink, stream) = socket.split();
    // The first to end ends the other.
    tokio::select! {
        () = write(&server, sink, messages) => {}
        () = read(&server, stream, number, role) => {}
    }
    if server.hub.leave(number) {
        stop_jog(&server);
    }
}

/// A page that held a jog has disconnected or lost control: the core would notice 90 ms later.
fn stop_jog(server: &Server) {
    if server.jogged.swap(false, std::sync::atomic::Ordering::Relaxed) {
        server.stops.send(plain(CommandCode::JogStop), AGE);
    }
}

fn plain(code: CommandCode) -> ControlRequest {
    ControlRequest {
        command: code as u32,
        ..ControlRequest::default()
    }
}

async fn write(
    server: &Server,
    mut sink: SplitSink<WebSocket, Message>,
    mut messages: mpsc::Receiver<Utf8Bytes>,
) {
    let mut frames = server.hub.frames();
    let mut signals = Utf8Bytes::default();
    loop {
        let (first, others) = tokio::select! {
            biased;
            message = messages.recv() => match message {
                Some(message) => (Message::Text(message), [None, None]),
                None => return,
            },
            changed = frames.changed() => {
                if changed.is_err() {
                    return;
                }
                let frame = frames.borrow_and_update().clone();
                let samples = (!frame.samples.is_empty()).then_some(Message::Binary(frame.samples));
                let is_new = !frame.signals.is_empty() && frame.signals != signals;
                let values = is_new.then(|| {
                    signals = frame.signals.clone();
                    Message::Text(frame.signals)
                });
                (Message::Text(frame.status), [samples, values])
            }
        };
        for message in std::iter::once(first).chain(others.into_iter().flatten()) {
            match tokio::time::timeout(SLOW, sink.send(message)).await {
                Ok(Ok(())) => {}
                _ => return,
            }
        }
    }
}

async fn read(server: &Arc<Server>, mut stream: SplitStream<WebSocket>, number: u64, role: Role) {
    let (mut left, mut counted, mut last_id) = (BURST, Instant::now(), 0);
    loop {
        let message = match tokio::time::timeout(LEASE_SILENCE, stream.next()).await {
            Ok(Some(Ok(message))) => message,
            Ok(_) => return,
            Err(_) => {
                if server.hub.drop_silent(number) {
                    stop_jog(server);
                }
                continue;
            }
        };
        let now = Instant::now();
        left = (left + RATE * (now - counted).as_secs_f64()).min(BURST) - 1.0;
        counted = now;
        if left < 0.0 {
            server.hub.log(
                LogKind::Link,
                None,
                format!("page {number} sent too many messages and was disconnected"),
                None,
            );
            return;
        }
        let line = match message {
            Message::Text(line) => line,
            Message::Close(_) => return,
            _ => continue,
        };
        match serde_json::from_str::<FromPage>(&line) {
            Ok(FromPage::Keep) if server.hub.holds(number) => {
                server.jogs.send(plain(CommandCode::JogKeep), KEEP_AGE);
            }
            Ok(FromPage::Keep | FromPage::Alive) => {}
            Ok(FromPage::Take { force }) => {
                if server.hub.take(number, force) {
                    stop_jog(server);
                }
            }
            Ok(FromPage::Give) => {
                if server.hub.give(number) {
                    stop_jog(server);
                }
            }
            Ok(FromPage::Command(command)) => {
                let is_new = command.id > last_id;
                last_id = last_id.max(command.id);
                if is_new {
                    // Other pages do not wait for its answer.
                    tokio::spawn(carry_out(Arc::clone(server), number, role, command));
                } else {
                    let text = "a command with this number was given before; it has no effect";
                    server.hub.answer(number, command.id, Answer::refused(text));
                }
            }
            Err(error) => {
                let text = format!("unknown message: {error}");
                server.hub.answer(number, 0, Answer::refused(text));
            }
        }
    }
}

async fn carry_out(server: Arc<Server>, number: u64, role: Role, command: CommandMessage) {
    let answer = answer_of(&server, number, role, &command).await;
    if let Some(code) = code_of(command.command)
        && code != CommandCode::JogKeep
    {
        let what = if answer.accepted {
            format!("{} by page {number}", code.name())
        } else {
            format!("{} by page {number} was rejected: {}", code.name(), answer.text)
        };
        let alarm = (answer.alarm != 0).then_some(answer.alarm);
        if answer.accepted && REPEATED.contains(&code) {
            server.hub.log_repeated(LogKind::Command, what);
        } else {
            server.hub.log(LogKind::Command, alarm, what, None);
        }
    }
    server.hub.answer(number, command.id, answer);
}

async fn answer_of(server: &Server, number: u64, role: Role, command: &CommandMessage) -> Answer {
    let Some(programs) = server.programs.as_ref().filter(|_| role == Role::Operate) else {
        return Answer::refused("this page may only watch");
    };
    let request = match request_of(command, |name| programs.newest(name)) {
        Ok(request) => request,
        Err(text) => return Answer::refused(text),
    };
    let is_code = |code: &CommandCode| *code as u32 == command.command;
    if STOPPING.iter().any(is_code) {
        if is_code(&CommandCode::JogStop) {
            // Also after a jog that has not been sent yet: a short press must not start after its end.
            server.jogs.send(request, JOG_AGE);
        }
        return server.stops.give(request, AGE).await;
    }
    if !server.hub.holds(number) {
        return Answer::refused("this page does not have control; take it first");
    }
    if let Some(text) = outdated(server.hub.present().as_deref(), command) {
        return Answer::refused(text);
    }
    match command.command {
        code if code == CommandCode::Jog as u32 => {
            server.jogged.store(true, std::sync::atomic::Ordering::Relaxed);
            let answer = server.jogs.give(request, JOG_AGE).await;
            // The page may have disconnected while the core evaluated the command.
            if !server.hub.holds(number) {
                stop_jog(server);
            }
            answer
        }
        code if code == CommandCode::JogKeep as u32 => server.jogs.give(request, KEEP_AGE).await,
        code if code == CommandCode::Return as u32 || code == CommandCode::Retrace as u32 => {
            // They end with the page, as a jog does: what the program itself does not do, somebody watches.
            server.jogged.store(true, std::sync::atomic::Ordering::Relaxed);
            let answer = server.commands.give(request, PRESS_AGE).await;
            if !server.hub.holds(number) {
                stop_jog(server);
            }
            answer
        }
        _ => server.commands.give(request, PRESS_AGE).await,
    }
}

/// Why a command that does not stop is not carried out any more. Without a status the core rejects it, or nothing moves.
fn outdated(present: Option<&Status>, command: &CommandMessage) -> Option<&'static str> {
    let present = present?;
    if present.time_ns.saturating_sub(command.seen_ns) > MAX_SEEN_AGE_NS {
        return Some("the page was out of date; look at the machine and press again");
    }
    (command.steers && present.activity != JOG).then_some("the jog has ended; press again")
}

impl crate::hub::Hub {
    /// Reports the result of a command to a page.
    pub(crate) fn answer(&self, number: u64, id: u64, answer: Answer) {
        let Answer {
            accepted,
            alarm,
            text: what,
        } = answer;
        self.tell_one(
            number,
            text(&ToPage::Answer {
                id,
                accepted,
                alarm,
                text: what,
            }),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_of_a_page_that_is_out_of_date_is_refused() {
        let mut present = Status {
            time_ns: 100_000_000_000,
            activity: JOG,
            ..Status::default()
        };
        let command = |seen_ns: u64, steers: bool| -> CommandMessage {
            let json = serde_json::json!({"id": 1, "command": 20, "seen_ns": seen_ns, "steers": steers});
            serde_json::from_value(json).unwrap()
        };
        // A second, and the future: the status is that of the last setpoint, which pages may have from the frame before.
        for seen_ns in [99_000_000_000, 100_000_000_000, 100_010_000_000] {
            assert_eq!(outdated(Some(&present), &command(seen_ns, true)), None);
        }
        // A link that was dead for 12 s, and a page that has seen nothing.
        for seen_ns in [98_999_999_999, 88_000_000_000, 0] {
            let text = outdated(Some(&present), &command(seen_ns, false)).unwrap();
            assert!(text.contains("out of date"), "{text}");
        }
        // Somebody has pressed Stop: a change of a jog starts none.
        present.activity = 0;
        let text = outdated(Some(&present), &command(100_000_000_000, true)).unwrap();
        assert!(text.contains("has ended"), "{text}");
        assert_eq!(outdated(Some(&present), &command(100_000_000_000, false)), None);
        assert_eq!(outdated(None, &command(0, true)), None);
    }
}
