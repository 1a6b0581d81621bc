//! Settings of a screen.

use std::net::SocketAddr;
use std::path::PathBuf;

use evolvent_runtime::{Setup, TraceTo};

/// Settings of a screen.
#[derive(Clone, Debug)]
pub struct ScreenConfig {
    /// The address. Port 0 selects a free port. Connections are encrypted unless it is a loopback address.
    pub address: SocketAddr,
    /// Names by which browsers may address this computer, in addition to its own name and addresses.
    pub hosts: Vec<String>,
    /// Certificate chain and private key, PEM. `None`: a certificate is generated and kept in the state
    /// folder, unless the address is loopback.
    pub certificate: Option<(PathBuf, PathBuf)>,
    /// The served machine.
    pub setup: Setup,
    /// Prefix of the bus.
    pub bus_prefix: Option<String>,
    /// What pages may see and do.
    pub scope: ScreenScope,
}

/// What pages may see and do.
#[derive(Clone, Debug)]
pub enum ScreenScope {
    /// Pages operate a served machine. Offsets and tools are read from this state folder. Uploaded programs
    /// are stored in its folder `programs`, a generated certificate in its folder `screen`.
    Operate {
        /// The service's state folder.
        state_folder: PathBuf,
        /// Where the service records, so that pages can show traces.
        traces: TraceTo,
        /// File of macros; `None` for `macros.toml` in the state folder, if it exists.
        macros: Option<PathBuf>,
        /// Case file of chatter, whose limits are shown.
        chatter: Option<PathBuf>,
    },
    /// Pages watch the run of one program.
    Watch {
        /// The program.
        program: PathBuf,
    },
}

/// Why a screen did not start.
#[derive(Debug, thiserror::Error)]
pub enum ScreenError {
    /// The address is in use or does not belong to this computer.
    #[error(
        "the screen cannot listen on {address}: {source}; choose another port, as in --screen=127.0.0.1:5301"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why.
        source: std::io::Error,
    },
    /// The screen of a run has an address that is not loopback, and no certificate was given.
    #[error(
        "the screen of a run has no folder to keep a certificate in: beyond this computer give one with \
         --screen-certificate and --screen-key"
    )]
    NoCertificate,
    /// The certificate or its key cannot be used.
    #[error("{file}: {cause}; give PEM files of a certificate chain and of its private key")]
    Certificate {
        /// The file.
        file: String,
        /// The error.
        cause: String,
    },
    /// The folder of programs, random numbers or threads are not available.
    #[error("the screen cannot be started: {0}")]
    Start(#[from] std::io::Error),
}
