//! Errors, one enum per operation.

use crate::name::NameError;
use thiserror::Error;

/// Why core or client could not open the bus.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum BusError {
    /// The machine's name is not valid in a service name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The prefix is not valid at the start of a file name.
    #[error("the prefix {prefix:?} cannot begin a file name: use 1 to 32 letters, digits, '-' and '_'")]
    Prefix {
        /// The prefix.
        prefix: String,
    },
    /// The control period is invalid.
    #[error("the control period of {period_ns} ns is out of range: it must be 1000 ns to 1 s")]
    Period {
        /// The period in ns.
        period_ns: u64,
    },
    /// The letters are not a set of axes.
    #[error("the axes {axes:?} are not a list of different capital letters of XYZABCUVW")]
    Axes {
        /// The letters.
        axes: String,
    },
    /// The buffer is too small or too large.
    #[error("a setpoint buffer of {setpoints} is out of range: it must be 1 to {max}")]
    SetpointBuffer {
        /// The requested size, in setpoints.
        setpoints: usize,
        /// The largest size.
        max: usize,
    },
    /// The number of subscribers is too small or too large.
    #[error("{subscribers} setpoint subscribers are out of range: it must be 1 to 64")]
    Subscribers {
        /// The requested number.
        subscribers: usize,
    },
    /// iceoryx2 itself does not start.
    #[error(
        "iceoryx2 cannot start ({cause}): check that this user may write to the bus's folder and /dev/shm \
         and that both have free space"
    )]
    Domain {
        /// iceoryx2's name for the cause.
        cause: String,
    },
    /// The folder of the bus cannot be used.
    #[error("the bus's folder {path} {reason}")]
    Folder {
        /// The folder.
        path: String,
        /// The error and its remedy.
        reason: String,
    },
    /// Another user has created a file with the name of one of the bus's files.
    #[error(
        "{path} belongs to {owner} and not to this user, so the bus is not opened: let {owner} or root \
         remove it, or choose \
         another --bus-prefix for core and clients"
    )]
    Foreign {
        /// The file.
        path: String,
        /// Its owner.
        owner: String,
    },
    /// This process may not open enough files.
    #[error(
        "this process has {open} files open and may have {limit}, the bus needs {needed} more: raise the \
         limit \
         (`ulimit -n 1024`, LimitNOFILE= of a service)"
    )]
    Descriptors {
        /// Files that are open.
        open: usize,
        /// The limit.
        limit: u64,
        /// Number of additional files that the bus needs.
        needed: usize,
    },
    /// Another core of the same name is alive.
    #[error(
        "machine {machine_name} is already running{}: stop that core, or give this machine another name",
        pid.map(|pid| format!(", pid {pid}")).unwrap_or_default()
    )]
    AlreadyRunning {
        /// The machine's name.
        machine_name: String,
        /// The process of the other core, if it could be determined.
        pid: Option<i32>,
    },
    /// The service exists with other attributes.
    #[error("{service} does not fit: {differences}; {advice}")]
    Incompatible {
        /// The service.
        service: String,
        /// Each attribute that differs, with both values.
        differences: String,
        /// What to do.
        advice: &'static str,
    },
    /// The service exists with other sizes, and clients of an earlier run keep it alive.
    #[error(
        "{service} exists with other settings ({cause}): clients of an earlier run keep it alive, close \
         them and start again"
    )]
    HeldByClients {
        /// The service.
        service: String,
        /// iceoryx2's name for the cause.
        cause: String,
    },
    /// This user may not use the service.
    #[error(
        "no permission for {service}: a bus belongs to one user, run the core and its clients as the same one"
    )]
    Permission {
        /// The service.
        service: String,
    },
    /// No core was found in time.
    #[error(
        "no core of machine {machine_name} within {waited_ms} ms: start it, or check name and \
         prefix{elsewhere}"
    )]
    NoCore {
        /// The machine's name.
        machine_name: String,
        /// The time waited, in ms.
        waited_ms: u64,
        /// The other users with cores, and what that means; empty if there are none.
        elsewhere: String,
    },
    /// All connections are taken, or the free ones are reserved.
    #[error(
        "{service} has no capacity for another {port} (some connections are reserved for bridges and \
     operators): close one"
    )]
    NoPlace {
        /// The service.
        service: String,
        /// The port to be added.
        port: &'static str,
    },
    /// The memory for the samples could not be allocated.
    #[error(
        "no shared memory for {service}, about {needed_mib} MiB ({cause}): enlarge /dev/shm or choose a \
         smaller setpoint buffer"
    )]
    SharedMemory {
        /// The service.
        service: String,
        /// The required size, in MiB.
        needed_mib: usize,
        /// iceoryx2's name for the cause.
        cause: String,
    },
    /// The service could not be opened, even after waiting.
    #[error("{service} cannot be opened ({cause}): stop every process of this machine and start again")]
    Service {
        /// The service.
        service: String,
        /// iceoryx2's name for the cause.
        cause: String,
    },
}

/// Why a message was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum SendError {
    /// The message could not be passed on; the next one may succeed.
    #[error(
        "the message was not sent on {channel} ({cause}): the bus is damaged or out of memory, restart the \
         core if it persists"
    )]
    NotSent {
        /// The channel.
        channel: &'static str,
        /// iceoryx2's name for the cause.
        cause: &'static str,
    },
}

/// Why a message could not be received.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ReceiveError {
    /// The connection to a sender is damaged.
    #[error("nothing can be received on {channel} ({cause}): open the bus again")]
    Broken {
        /// The channel.
        channel: &'static str,
        /// iceoryx2's name for the cause.
        cause: &'static str,
    },
    /// The sender was built for another version of the contract.
    #[error(
        "a message on {channel} has interface version {version} and {size} bytes, this build supports \
         {known_version} and {known_size}: update the older side"
    )]
    Version {
        /// The channel.
        channel: &'static str,
        /// The sender's version.
        version: u32,
        /// The sender's size in bytes.
        size: u32,
        /// The version of this build.
        known_version: u32,
        /// The size of this build in bytes.
        known_size: u32,
    },
}
