//! How a machine is served.

use std::path::{Path, PathBuf};

use crate::job::Setup;

/// How a machine is served.
#[derive(Clone, Debug)]
pub struct ServeConfig {
    /// The machine with its rate.
    pub setup: Setup,
    /// Prefix of iceoryx2; `None` for iceoryx2's default.
    pub bus_prefix: Option<String>,
    /// Where the trace goes.
    pub trace: TraceTo,
    /// Where offsets, tools and parameters are kept: see [`crate::state_folder`].
    pub state_folder: PathBuf,
}

/// Where the trace of a served machine goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TraceTo {
    /// Nothing is recorded.
    Nowhere,
    /// The whole session in one file of unlimited size.
    File(PathBuf),
    /// `NAME-TIME.mcap` in this folder: a new file every hour, begun while nothing moves. The oldest files of
    /// this machine are removed before all of them together exceed the limit.
    Folder {
        /// The folder; it is created if missing.
        folder: PathBuf,
        /// The limit, bytes.
        limit_bytes: u64,
    },
}

/// Messages while a machine is served.
#[derive(Clone, Copy, Debug)]
pub enum ServeNews<'a> {
    /// Commands are accepted from now on. Carries the first trace file, if any.
    Ready(Option<&'a Path>),
    /// A note to the user.
    Note(&'a str),
}
