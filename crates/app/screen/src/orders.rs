//! Commands to the core.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use evolvent_bus::{ClientConfig, ControlClient, ControlRequest};
use tokio::sync::oneshot;

/// Maximum wait for an answer: the core reads files for at most 8 s.
const ANSWER: Duration = Duration::from_secs(12);
/// Interval at which a thread checks whether to end.
const LOOK: Duration = Duration::from_millis(100);
/// Maximum number of waiting orders; more are rejected.
const WAITING: usize = 16;

/// The core's answer to a command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Answer {
    pub(crate) accepted: bool,
    pub(crate) alarm: u32,
    pub(crate) text: String,
}

impl Answer {
    /// The command did not reach the core.
    pub(crate) fn refused(text: impl Into<String>) -> Self {
        Self {
            accepted: false,
            alarm: 0,
            text: text.into(),
        }
    }
}

struct Order {
    request: ControlRequest,
    given: Instant,
    max_age: Duration,
    reply: Option<oneshot::Sender<Answer>>,
}

/// A thread of normal priority with a client of the control service: it waits for each answer before the next
/// command, because the core rejects a second command of a client that has no answer yet.
#[derive(Clone)]
pub(crate) struct Orders {
    sender: SyncSender<Order>,
}

impl Orders {
    pub(crate) fn spawn(
        name: &str,
        config: ClientConfig,
        stop: Arc<AtomicBool>,
    ) -> std::io::Result<(Self, JoinHandle<()>)> {
        let (sender, receiver) = sync_channel(WAITING);
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || carry(&config, &stop, &receiver))?;
        Ok((Self { sender }, thread))
    }

    /// Sends a command unless it has then waited for longer than `max_age`.
    pub(crate) async fn give(&self, request: ControlRequest, max_age: Duration) -> Answer {
        let (reply, answer) = oneshot::channel();
        let order = Order {
            request,
            given: Instant::now(),
            max_age,
            reply: Some(reply),
        };
        match self.sender.try_send(order) {
            Ok(()) => answer
                .await
                .unwrap_or_else(|_| Answer::refused("the server is ending")),
            Err(TrySendError::Full(_)) => Answer::refused("too many commands wait for the core; try again"),
            Err(TrySendError::Disconnected(_)) => Answer::refused("the server is ending"),
        }
    }

    /// The same without an answer. If the queue is full, the command is lost.
    pub(crate) fn send(&self, request: ControlRequest, max_age: Duration) {
        // A jog is renewed soon anyway.
        let _lost = self.sender.try_send(Order {
            request,
            given: Instant::now(),
            max_age,
            reply: None,
        });
    }
}

fn carry(config: &ClientConfig, stop: &AtomicBool, orders: &Receiver<Order>) {
    let mut client: Option<ControlClient> = None;
    while !stop.load(Ordering::Relaxed) {
        let order = match orders.recv_timeout(LOOK) {
            Ok(order) => order,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        let answer = if order.given.elapsed() > order.max_age {
            Answer::refused("the command arrived too late and was not sent")
        } else {
            command(&mut client, config, &order.request)
        };
        if let Some(reply) = order.reply {
            // The page may have disconnected.
            let _gone = reply.send(answer);
        }
    }
}

fn command(client: &mut Option<ControlClient>, config: &ClientConfig, request: &ControlRequest) -> Answer {
    if client.is_none() {
        match ControlClient::open(config) {
            Ok(opened) => *client = Some(opened),
            Err(error) => return Answer::refused(error.to_string()),
        }
    }
    let Some(open) = client else {
        return Answer::refused("no core");
    };
    match open.command(request, ANSWER) {
        Ok(answer) => Answer {
            accepted: answer.verdict == 0,
            alarm: answer.alarm,
            text: answer.text().to_owned(),
        },
        Err(error) => {
            *client = None;
            Answer::refused(error.to_string())
        }
    }
}
