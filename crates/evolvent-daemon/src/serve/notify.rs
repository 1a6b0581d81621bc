//! What a service manager is told: ready, alive, stopping (the protocol of systemd's `sd_notify`).

use std::ffi::OsStr;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::Duration;

/// The manager's socket, if there is one.
#[derive(Debug, Default)]
pub(crate) struct Manager {
    socket: Option<(UnixDatagram, SocketAddr)>,
    /// How often it wants a sign of life.
    pub watchdog: Option<Duration>,
}

impl Manager {
    /// As the environment says: `NOTIFY_SOCKET`, `WATCHDOG_USEC`, `WATCHDOG_PID`.
    pub(crate) fn of_environment() -> Self {
        let number = |variable: &str| std::env::var(variable).ok()?.parse::<u64>().ok();
        let mine = number("WATCHDOG_PID").is_none_or(|pid| pid == u64::from(std::process::id()));
        let watchdog = number("WATCHDOG_USEC").filter(|&us| mine && us > 0);
        Self {
            socket: std::env::var_os("NOTIFY_SOCKET").and_then(|name| socket(&name)),
            // Twice as often as it has to be.
            watchdog: watchdog.map(|us| Duration::from_micros(us / 2)),
        }
    }

    /// Tells the manager; without one nothing happens.
    pub(crate) fn tell(&self, text: &str) {
        if let Some((socket, address)) = &self.socket {
            // A manager that has gone needs no news.
            let _lost = socket.send_to_addr(text.as_bytes(), address);
        }
    }
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

    #[test]
    fn a_manager_hears_what_it_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let hears = UnixDatagram::bind(&path).unwrap();
        let manager = Manager {
            socket: socket(path.as_os_str()),
            watchdog: None,
        };
        manager.tell("READY=1");
        let mut heard = [0; 16];
        let length = hears.recv(&mut heard).unwrap();
        assert_eq!(&heard[..length], b"READY=1");
        Manager::default().tell("nobody");
    }
}
