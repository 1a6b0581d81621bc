//! The connection of one page.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::ws::{Message, Utf8Bytes, WebSocket};
use evolvent_control::CommandCode;
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use tokio::sync::mpsc;

use crate::command::{code_of, request_of};
use crate::gate::Role;
use crate::hub::{Visitor, text};
use crate::messages::{CommandMessage, FromPage, LogFact, LogKind, Refusal, ToPage};
use crate::orders::Answer;
use crate::pace::Pace;
use crate::server::Server;

/// A message that is not sent within this time ends the connection.
const SLOW: Duration = Duration::from_secs(10);
/// Commands that are repeated many times per second while a finger moves; they are logged once.
const REPEATED: [CommandCode; 5] = [
    CommandCode::Jog,
    CommandCode::JogStop,
    CommandCode::FeedOverride,
    CommandCode::RapidOverride,
    CommandCode::SpindleOverride,
];
/// Maximum number of messages in one burst, and per second.
const BURST: f64 = 400.0;
const RATE: f64 = 200.0;
/// A page that has control and sends nothing for this time loses it.
const LEASE_SILENCE: Duration = Duration::from_secs(3);

/// Serves a page until its connection ends.
pub(crate) async fn serve(server: Arc<Server>, socket: WebSocket, visitor: Visitor) {
    let role = visitor.role;
    let Some((number, messages)) = server.hub.join(visitor) else {
        return;
    };
    let (sink, stream) = socket.split();
    let pace = Pace::new();
    // Either end ends the other.
    tokio::select! {
        () = write(&server, sink, messages, &pace) => {}
        () = read(&server, stream, number, role, &pace) => {}
    }
    if server.hub.leave(number) {
        server.dispatch.stop_jog();
    }
}

async fn write(
    server: &Server,
    mut sink: SplitSink<WebSocket, Message>,
    mut messages: mpsc::Receiver<Utf8Bytes>,
    pace: &Pace,
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
                if !pace.may_send() {
                    continue;
                }
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

async fn read(
    server: &Arc<Server>,
    mut stream: SplitStream<WebSocket>,
    number: u64,
    role: Role,
    pace: &Pace,
) {
    let (mut left, mut counted, mut last_id) = (BURST, Instant::now(), 0);
    loop {
        let message = match tokio::time::timeout(LEASE_SILENCE, stream.next()).await {
            Ok(Some(Ok(message))) => message,
            Ok(_) => return,
            Err(_) => {
                if server.hub.drop_silent(number) {
                    server.dispatch.stop_jog();
                }
                continue;
            }
        };
        pace.hear();
        let now = Instant::now();
        left = (left + RATE * (now - counted).as_secs_f64()).min(BURST) - 1.0;
        counted = now;
        if left < 0.0 {
            let fact = LogFact::TooManyMessages { page: number };
            server.hub.log_fact(LogKind::Link, None, fact, None);
            return;
        }
        let line = match message {
            Message::Text(line) => line,
            Message::Close(_) => return,
            _ => continue,
        };
        match serde_json::from_str::<FromPage>(&line) {
            Ok(FromPage::Keep) => server.dispatch.keep_jog(number),
            Ok(FromPage::Alive) => {}
            Ok(FromPage::Take { force }) => {
                if server.hub.take(number, force) {
                    server.dispatch.stop_jog();
                }
            }
            Ok(FromPage::Give) => {
                if server.hub.give(number) {
                    server.dispatch.stop_jog();
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
        let name = code.name().to_owned();
        let fact = if answer.accepted {
            LogFact::Accepted {
                command: name,
                page: number,
            }
        } else {
            LogFact::Rejected {
                command: name,
                page: number,
                reason: answer.text.clone(),
                refusal: answer.refusal,
            }
        };
        let alarm = (answer.alarm != 0).then_some(answer.alarm);
        if answer.accepted && REPEATED.contains(&code) {
            server.hub.log_repeated(LogKind::Command, fact);
        } else {
            server.hub.log_fact(LogKind::Command, alarm, fact, None);
        }
    }
    server.hub.answer(number, command.id, answer);
}

async fn answer_of(server: &Server, number: u64, role: Role, command: &CommandMessage) -> Answer {
    let Some(programs) = server.programs.as_ref().filter(|_| role == Role::Operate) else {
        return Refusal::WatchOnly.into();
    };
    let request = match request_of(command, |name| programs.newest(name)) {
        Ok(request) => request,
        Err(text) => return Answer::refused(text),
    };
    server.dispatch.carry_out(number, command, request).await
}

impl crate::hub::Hub {
    /// Reports the result of a command to a page.
    pub(crate) fn answer(&self, number: u64, id: u64, answer: Answer) {
        let Answer {
            accepted,
            alarm,
            text: what,
            refusal,
        } = answer;
        self.tell_one(
            number,
            text(&ToPage::Answer {
                id,
                accepted,
                alarm,
                text: what,
                refusal,
            }),
        );
    }
}
