//! Commands to the core.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use evolvent_bus::{ClientConfig, ControlClient, ControlRequest};
use tokio::sync::oneshot;

use crate::hub::{Hub, Term};
use crate::messages::Refusal;

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
    /// Why the server itself refused it, where it has a name for that.
    pub(crate) refusal: Option<Refusal>,
}

impl From<Refusal> for Answer {
    fn from(refusal: Refusal) -> Self {
        Self {
            refusal: Some(refusal),
            ..Self::refused(refusal.sentence())
        }
    }
}

impl Answer {
    /// The command did not reach the core.
    pub(crate) fn refused(text: impl Into<String>) -> Self {
        Self {
            accepted: false,
            alarm: 0,
            text: text.into(),
            refusal: None,
        }
    }
}

struct Order {
    request: ControlRequest,
    given: Instant,
    max_age: Duration,
    /// The control under which it was given; none for what every page may send.
    term: Option<Term>,
    reply: Option<oneshot::Sender<Answer>>,
}

/// A thread of normal priority with a client of the control service: it waits for each answer before the next
/// command, because the core rejects a second command of a client that has no answer yet.
#[derive(Clone)]
pub(crate) struct Orders {
    sender: SyncSender<Order>,
}

impl Orders {
    /// `core` is made in the thread, which it does not leave.
    pub(crate) fn spawn<C: Core>(
        name: &str,
        core: impl FnOnce() -> C + Send + 'static,
        hub: &Arc<Hub>,
        stop: &Arc<AtomicBool>,
    ) -> std::io::Result<(Self, JoinHandle<()>)> {
        let (sender, receiver) = sync_channel(WAITING);
        let (hub, stop) = (Arc::clone(hub), Arc::clone(stop));
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || carry(core(), &hub, &stop, &receiver))?;
        Ok((Self { sender }, thread))
    }

    /// Sends a command unless it has then waited for longer than `max_age`, or the control under which it was given has ended.
    pub(crate) async fn give(
        &self,
        request: ControlRequest,
        max_age: Duration,
        term: Option<Term>,
    ) -> Answer {
        let (reply, answer) = oneshot::channel();
        let order = Order {
            request,
            given: Instant::now(),
            max_age,
            term,
            reply: Some(reply),
        };
        match self.sender.try_send(order) {
            Ok(()) => answer.await.unwrap_or_else(|_| Answer::from(Refusal::Ending)),
            Err(TrySendError::Full(_)) => Answer::from(Refusal::Busy),
            Err(TrySendError::Disconnected(_)) => Answer::from(Refusal::Ending),
        }
    }

    /// The same without an answer. If the queue is full, the command is lost.
    pub(crate) fn send(&self, request: ControlRequest, max_age: Duration, term: Option<Term>) {
        // A jog is renewed soon anyway.
        let _lost = self.sender.try_send(Order {
            request,
            given: Instant::now(),
            max_age,
            term,
            reply: None,
        });
    }
}

/// Where orders go.
pub(crate) trait Core {
    /// Connects, if it is not connected.
    fn open(&mut self) -> Result<(), String>;
    /// Sends a command and waits for the answer.
    fn command(&mut self, request: &ControlRequest) -> Answer;
}

/// The core on the bus.
pub(crate) struct BusCore {
    config: ClientConfig,
    client: Option<ControlClient>,
}

impl BusCore {
    pub(crate) fn new(config: ClientConfig) -> Self {
        Self { config, client: None }
    }
}

impl Core for BusCore {
    fn open(&mut self) -> Result<(), String> {
        if self.client.is_none() {
            let opened = ControlClient::open(&self.config).map_err(|error| error.to_string())?;
            self.client = Some(opened);
        }
        Ok(())
    }

    fn command(&mut self, request: &ControlRequest) -> Answer {
        let Some(client) = &mut self.client else {
            return Answer::refused("no core");
        };
        match client.command(request, ANSWER) {
            Ok(answer) => Answer {
                accepted: answer.verdict == 0,
                alarm: answer.alarm,
                text: answer.text().to_owned(),
                refusal: None,
            },
            Err(error) => {
                self.client = None;
                Answer::refused(error.to_string())
            }
        }
    }
}

fn carry(mut core: impl Core, hub: &Hub, stop: &AtomicBool, orders: &Receiver<Order>) {
    while !stop.load(Ordering::Relaxed) {
        let order = match orders.recv_timeout(LOOK) {
            Ok(order) => order,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        // Connecting may take seconds: what is looked at is the moment in which the command leaves.
        let answer = match core.open() {
            Err(text) => Answer::refused(text),
            Ok(()) => match order.expired(hub) {
                Some(refusal) => Answer::from(refusal),
                None => core.command(&order.request),
            },
        };
        if let Some(reply) = order.reply {
            // The page may have disconnected.
            let _gone = reply.send(answer);
        }
    }
}

impl Order {
    /// Why it is not sent any more.
    fn expired(&self, hub: &Hub) -> Option<Refusal> {
        if self.given.elapsed() > self.max_age {
            return Some(Refusal::TooLate);
        }
        let is_past = self.term.is_some_and(|term| !hub.is_present(term));
        is_past.then_some(Refusal::LostControl)
    }
}
