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
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Maximum number of waiting orders; more are rejected.
const WAITING: usize = 16;

/// The core's answer to a command.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Answer {
    pub(crate) accepted: bool,
    pub(crate) alarm: u32,
    pub(crate) text: String,
    /// Why the server itself rejected it, if that reason has a name.
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
    /// The control under which it was sent; `None` for commands that every page may send.
    term: Option<Term>,
    reply: Option<oneshot::Sender<Answer>>,
}

/// A thread of normal priority with a client of the control service. It waits for each answer before the next
/// command, because the core rejects a second command of a client that has no answer yet.
#[derive(Clone)]
pub(crate) struct Orders {
    sender: SyncSender<Order>,
}

impl Orders {
    /// `core` is created on the thread and stays there.
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

    /// Sends a command unless it has waited for longer than `max_age`, or the control under which it was sent
    /// has ended.
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

/// The destination of orders.
pub(crate) trait Core {
    /// Connects if necessary, and waits for the core.
    fn open(&mut self) -> Result<(), String>;
    /// Connects if necessary and if there is a core now.
    fn open_early(&mut self);
    /// Sends a command and waits for the answer.
    fn command(&mut self, request: &ControlRequest) -> Answer;
}

/// First and longest time between attempts to connect early: each attempt takes processor time from the core.
const RETRIES: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(5)];

/// The core on the bus.
pub(crate) struct BusCore {
    config: ClientConfig,
    /// Whether it accepts commands: `serve` does, `run` does not.
    is_commanded: bool,
    client: Option<ControlClient>,
    /// When to try again without an order, and the time after that.
    early: (Instant, Duration),
}

impl BusCore {
    pub(crate) fn new(config: ClientConfig, is_commanded: bool) -> Self {
        Self {
            config,
            is_commanded,
            client: None,
            early: (Instant::now(), RETRIES[0]),
        }
    }

    fn connect(&mut self, wait: Duration) -> Result<(), String> {
        if self.client.is_none() {
            let config = ClientConfig {
                wait,
                ..self.config.clone()
            };
            let opened = ControlClient::open(&config).map_err(|error| error.to_string())?;
            self.client = Some(opened);
        }
        Ok(())
    }
}

impl Core for BusCore {
    fn open(&mut self) -> Result<(), String> {
        self.connect(self.config.wait)
    }

    fn open_early(&mut self) {
        let (at, wait) = self.early;
        if !self.is_commanded || self.client.is_some() || Instant::now() < at {
            return;
        }
        let is_open = self.connect(Duration::ZERO).is_ok();
        let next = if is_open {
            RETRIES[0]
        } else {
            (2 * wait).min(RETRIES[1])
        };
        self.early = (Instant::now() + wait, next);
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
        // Opening a client takes up to seconds. An emergency stop must not wait for that, and a jog would
        // expire.
        core.open_early();
        let order = match orders.recv_timeout(POLL_INTERVAL) {
            Ok(order) => order,
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        // There may be no core yet, or no longer. The age is checked at the moment when the command is sent.
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
    /// The reason why it is no longer sent, if any.
    fn expired(&self, hub: &Hub) -> Option<Refusal> {
        if self.given.elapsed() > self.max_age {
            return Some(Refusal::TooLate);
        }
        let is_past = self.term.is_some_and(|term| !hub.is_present(term));
        is_past.then_some(Refusal::LostControl)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use evolvent_disturbance::unless_disturbed;

    use super::*;
    use crate::messages::ToPage;

    /// Maximum age of an order of these tests, which is much longer than a thread takes to run.
    const MAX_AGE: Duration = Duration::from_millis(500);

    /// A core to which connecting takes longer than orders may wait. The second command breaks the
    /// connection.
    #[derive(Default)]
    struct SlowToOpen {
        is_open: bool,
        opened: Arc<AtomicUsize>,
        commands: usize,
    }

    impl Core for SlowToOpen {
        fn open(&mut self) -> Result<(), String> {
            if !self.is_open {
                std::thread::sleep(2 * MAX_AGE);
                self.is_open = true;
                self.opened.fetch_add(1, Ordering::Relaxed);
            }
            Ok(())
        }

        fn open_early(&mut self) {
            self.open().unwrap();
        }

        fn command(&mut self, _request: &ControlRequest) -> Answer {
            self.commands += 1;
            let is_broken = self.commands == 2;
            self.is_open = !is_broken;
            Answer {
                accepted: !is_broken,
                ..Answer::refused("")
            }
        }
    }

    #[test]
    fn orders_find_an_open_connection_even_after_an_error() {
        unless_disturbed(|| {
            let hub = Arc::new(Hub::new(ToPage::Core { alive: true }));
            let stop = Arc::new(AtomicBool::new(false));
            let opened = Arc::new(AtomicUsize::new(0));
            let core = SlowToOpen {
                opened: Arc::clone(&opened),
                ..SlowToOpen::default()
            };
            let (orders, thread) = Orders::spawn("orders", move || core, &hub, &stop).unwrap();
            let until_opened = |times: usize| {
                let begun = Instant::now();
                while opened.load(Ordering::Relaxed) < times {
                    assert!(begun.elapsed() < 20 * MAX_AGE, "opened without an order: {times}");
                    std::thread::sleep(Duration::from_millis(5));
                }
            };
            let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
            let give = || runtime.block_on(orders.give(ControlRequest::default(), MAX_AGE, None));
            until_opened(1);
            assert_eq!(give().refusal, None);
            assert!(!give().accepted, "the connection breaks");
            until_opened(2);
            let answer = give();
            assert!(answer.accepted, "{answer:?}");
            stop.store(true, Ordering::Relaxed);
            thread.join().unwrap();
        });
    }
}
