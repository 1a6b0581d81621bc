//! Notifications to the service manager: ready, alive, stopping (the protocol of systemd's `sd_notify`).

use std::cell::RefCell;
use std::ffi::OsStr;
use std::io::ErrorKind;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crate::rt::take_turns;

/// The watchdog message; it is sent periodically.
const ALIVE: &str = "WATCHDOG=1";
/// Time for which a message is offered while the manager's queue is full: Linux queues as few as ten
/// messages.
const PATIENCE: Duration = Duration::from_secs(5);
/// Time between two attempts.
const OFFER_EVERY: Duration = Duration::from_millis(2);

/// The manager's socket, if there is one.
#[derive(Debug, Default)]
pub(crate) struct SystemdNotifier {
    socket: Option<(UnixDatagram, SocketAddr)>,
    patience: Duration,
    /// The thread that retries messages which did not fit. It is joined at the end.
    late: RefCell<Option<JoinHandle<()>>>,
    /// Interval of watchdog messages.
    pub watchdog: Option<Duration>,
}

impl SystemdNotifier {
    /// Reads the environment: `NOTIFY_SOCKET`, `WATCHDOG_USEC`, `WATCHDOG_PID`.
    pub(crate) fn of_environment() -> Self {
        let number = |variable: &str| std::env::var(variable).ok()?.parse::<u64>().ok();
        let mine = number("WATCHDOG_PID").is_none_or(|pid| pid == u64::from(std::process::id()));
        let watchdog = number("WATCHDOG_USEC").filter(|&us| mine && us > 0);
        Self {
            socket: std::env::var_os("NOTIFY_SOCKET").and_then(|name| socket(&name)),
            patience: PATIENCE,
            late: RefCell::default(),
            // Twice as often as required.
            watchdog: watchdog.map(|us| Duration::from_micros(us / 2)),
        }
    }

    /// Sends a message to the manager, if there is one. Never waits: the caller may have to stop a machine.
    pub(crate) fn tell(&self, text: &'static str) {
        let Some((socket, address)) = &self.socket else {
            return;
        };
        if text == ALIVE {
            let _next_comes = is_taken(socket, address, text);
            return;
        }
        let is_behind = (self.late.borrow().as_ref()).is_some_and(|late| !late.is_finished());
        if is_behind || !is_taken(socket, address, text) {
            self.offer(socket, address.clone(), text);
        }
    }

    /// Sends a message that did not fit, on a separate thread, after earlier ones that did not fit.
    fn offer(&self, socket: &UnixDatagram, address: SocketAddr, text: &'static str) {
        let Ok(socket) = socket.try_clone() else {
            return;
        };
        let (before, patience) = (self.late.take(), self.patience);
        let offering = thread::Builder::new().name("notifier".into()).spawn(move || {
            take_turns();
            let _ended = before.map(JoinHandle::join);
            let begin = Instant::now();
            while !is_taken(&socket, &address, text) && begin.elapsed() < patience {
                thread::sleep(OFFER_EVERY);
            }
        });
        // Without a thread the message is lost.
        self.late.replace(offering.ok());
    }
}

impl Drop for SystemdNotifier {
    fn drop(&mut self) {
        let _ended = self.late.take().map(JoinHandle::join);
    }
}

/// Whether the message need not be sent again, including when the manager has gone.
fn is_taken(socket: &UnixDatagram, address: &SocketAddr, text: &str) -> bool {
    let sent = socket.send_to_addr(text.as_bytes(), address);
    sent.map_or_else(|error| error.kind() != ErrorKind::WouldBlock, |_| true)
}

fn socket(name: &OsStr) -> Option<(UnixDatagram, SocketAddr)> {
    let address = match name.as_bytes() {
        [b'@', rest @ ..] => SocketAddr::from_abstract_name(rest).ok()?,
        _ => SocketAddr::from_pathname(name).ok()?,
    };
    let socket = UnixDatagram::unbound().ok()?;
    socket.set_nonblocking(true).ok()?;
    Some((socket, address))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A manager's socket, and a notifier connected to it.
    fn listened(folder: &tempfile::TempDir) -> (UnixDatagram, SystemdNotifier) {
        let path = folder.path().join("notify");
        let hears = UnixDatagram::bind(&path).unwrap();
        hears.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let manager = SystemdNotifier {
            socket: socket(path.as_os_str()),
            patience: Duration::from_secs(60),
            late: RefCell::default(),
            watchdog: None,
        };
        (hears, manager)
    }

    fn receive(ear: &UnixDatagram) -> String {
        let mut received = [0; 16];
        let length = ear.recv(&mut received).unwrap();
        String::from_utf8_lossy(&received[..length]).into_owned()
    }

    #[test]
    fn a_manager_hears_what_it_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let (ear, manager) = listened(&folder);
        manager.tell("READY=1");
        assert_eq!(receive(&ear), "READY=1");
        SystemdNotifier::default().tell("nobody");
    }

    #[test]
    fn late_notifications_are_sent_in_order_once_they_fit() {
        let folder = tempfile::tempdir().unwrap();
        let (ear, manager) = listened(&folder);
        let (socket, address) = manager.socket.as_ref().unwrap();
        let mut signs = 0;
        while socket.send_to_addr(ALIVE.as_bytes(), address).is_ok() {
            signs += 1;
        }
        manager.tell(ALIVE);
        assert!(
            manager.late.borrow().is_none(),
            "the next sign of life comes anyway"
        );
        manager.tell("READY=1");
        manager.tell("STOPPING=1");
        for _ in 0..signs {
            assert_eq!(receive(&ear), ALIVE);
        }
        assert_eq!(
            (receive(&ear), receive(&ear)),
            ("READY=1".to_owned(), "STOPPING=1".to_owned())
        );
    }

    #[test]
    fn a_manager_that_has_gone_is_not_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let (ear, manager) = listened(&folder);
        drop(ear);
        manager.tell("STOPPING=1");
        assert!(manager.late.borrow().is_none());
    }
}
