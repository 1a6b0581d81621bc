//! How a machine is served.

use std::path::{Path, PathBuf};

use crate::job::Setup;

/// How a machine is served.
#[derive(Clone, Debug)]
pub struct ServeConfig {
    /// The machine at its rate.
    pub setup: Setup,
    /// iceoryx2's prefix; none for iceoryx2's own.
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
    /// The whole session in one file, without a bound.
    File(PathBuf),
    /// `NAME-TIME.mcap` in this folder: a new file every hour, where nothing moves. The oldest files of this
    /// machine are removed before all of them together take more than the bound.
    Folder {
        /// The folder; it is made.
        folder: PathBuf,
        /// The bound, bytes.
        limit_bytes: u64,
    },
}

/// Messages while a machine is served.
#[derive(Clone, Copy, Debug)]
pub enum ServeNews<'a> {
    /// It takes commands from now on; the first trace file, if there is one.
    Ready(Option<&'a Path>),
    /// What the user should know.
    Note(&'a str),
}
