//! Simulated drives.

use std::path::Path;
use std::process::{Child, Stdio};

use crate::{Domain, evolvent};

/// Simulated drives in a process of their own, `evolvent bridge sim`. Killed when they are dropped.
#[derive(Debug)]
pub struct Drives(Child);

impl Drives {
    /// Starts them on a machine; further options of the command behind. They go without setpoints for 100
    /// periods before they brake, unless an option says otherwise: hosts that are busy keep core or drives
    /// waiting for longer than the usual 10.
    ///
    /// # Panics
    /// They cannot be started.
    #[must_use]
    pub fn start(machine: &Path, domain: &Domain, options: &[&str]) -> Self {
        let mut command = evolvent();
        command
            .args(["bridge", "sim", "--bus-prefix", &domain.prefix, "--machine"])
            .arg(machine);
        if !options.contains(&"--bridge-cycles") {
            command.args(["--bridge-cycles", "100"]);
        }
        let child = command
            .args(options)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the binary to start");
        Self(child)
    }
}

impl Drop for Drives {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _gone = self.0.wait();
    }
}
