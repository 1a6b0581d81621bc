//! What a screen is started with.

use std::net::SocketAddr;
use std::path::PathBuf;

use evolvent_runtime::Setup;

/// What a screen is started with.
#[derive(Clone, Debug)]
pub struct ScreenConfig {
    /// Where it listens: an address of this computer only. Port 0 takes a free one.
    pub address: SocketAddr,
    /// The machine that is served.
    pub setup: Setup,
    /// Prefix of the bus.
    pub bus_prefix: Option<String>,
    /// The service's state: offsets and tools are read from here, programs of pages are kept in its folder `programs`.
    pub state_folder: PathBuf,
}

/// Why a screen did not start.
#[derive(Debug, thiserror::Error)]
pub enum ScreenError {
    /// Other computers could reach it.
    #[error(
        "the screen listens on this computer only, not on {0}: the connection would be open to everybody on the network; use \
         127.0.0.1:PORT, and from elsewhere a tunnel: ssh -L PORT:127.0.0.1:PORT HOST"
    )]
    NotLoopback(SocketAddr),
    /// The address is taken or not this computer's.
    #[error("the screen cannot listen on {address}: {source}; choose another port, as in --screen 127.0.0.1:5301")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why.
        source: std::io::Error,
    },
    /// The folder of programs cannot be made, no random numbers, no threads.
    #[error("the screen cannot be started: {0}")]
    Start(#[from] std::io::Error),
}
