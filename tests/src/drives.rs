//! Simulated drives.

use std::path::Path;
use std::process::{Child, Stdio};

use crate::{Domain, evolvent};

/// Simulated drives in their own process, `evolvent bridge sim`. Killed on drop.
#[derive(Debug)]
pub struct Drives(Child);

impl Drives {
    /// Starts drives for a machine, with further options of the command. They run without setpoints for 100
    /// periods before they brake, unless an option says otherwise: busy hosts delay core or drives by more
    /// than the default of 10.
    ///
    /// # Panics
    /// If they cannot be started.
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
