//! Whether this process may open enough files: iceoryx2 needs one or two for each service, port and peer, and
//! reports only an internal failure if it cannot open one.

use crate::error::BusError;

/// EMFILE: this process has the maximum number of files open.
const TOO_MANY_FILES: i32 = 24;

/// Services, ports and monitors of a core, and a few clients.
pub(crate) const OF_A_CORE: usize = 80;
/// The same of a client.
pub(crate) const OF_A_CLIENT: usize = 16;

/// Checks that this many more files may be opened.
pub(crate) fn check(needed: usize) -> Result<(), BusError> {
    let limit = rustix::process::getrlimit(rustix::process::Resource::Nofile).current;
    let Some(limit) = limit else { return Ok(()) };
    // Without a list nothing can be counted; the list itself takes a descriptor.
    let open = match std::fs::read_dir("/proc/self/fd") {
        Ok(list) => list.count().saturating_sub(1),
        Err(error) if error.raw_os_error() == Some(TOO_MANY_FILES) => limit as usize,
        Err(_) => return Ok(()),
    };
    if open.saturating_add(needed) as u64 <= limit {
        return Ok(());
    }
    Err(BusError::Descriptors { open, limit, needed })
}
