//! A simulator of hardware in its own process.

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use crate::binary::build_program;
use crate::repository;

/// `ethercat-ring` or `mesa-board` in a process, as started by hand. Killed on drop.
#[derive(Debug)]
pub struct Simulator(Child);

impl Simulator {
    /// Starts it. The binary is first brought up to date in the target folder and profile of the running
    /// test, unless it is beside the one that the environment variable `EVOLVENT_BINARY` names.
    ///
    /// # Panics
    /// If it cannot be built or started.
    #[must_use]
    pub fn start(name: &str, arguments: &[&str]) -> Self {
        let child = Command::new(binary(name))
            .current_dir(repository())
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::inherit())
            .spawn()
            .expect("the simulator to start");
        Self(child)
    }

    /// Kills it (SIGKILL), as a crash or a loss of power does.
    ///
    /// # Panics
    /// If it has ended already.
    pub fn kill(mut self) {
        assert!(
            matches!(self.0.try_wait(), Ok(None)),
            "the simulator has ended by itself"
        );
        self.0.kill().expect("killed");
        let _ended = self.0.wait().expect("a process that ends");
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _gone = self.0.wait();
    }
}

fn binary(name: &str) -> PathBuf {
    let beside = std::env::var_os("EVOLVENT_BINARY").map(|binary| PathBuf::from(binary).with_file_name(name));
    if let Some(built) = beside.filter(|built| built.exists()) {
        return built;
    }
    build_program(name)
}
