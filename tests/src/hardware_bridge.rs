//! A bridge to hardware.

use std::path::Path;
use std::process::{Child, Stdio};

use crate::{Domain, evolvent};

/// A bridge to hardware in a process of its own, `evolvent bridge ...`. Killed when it is dropped.
#[derive(Debug)]
pub struct HardwareBridge(Child);

impl HardwareBridge {
    /// Starts it on a machine, with its kind and options.
    ///
    /// # Panics
    /// It cannot be started.
    #[must_use]
    pub fn start(arguments: &[String], machine: &Path, domain: &Domain) -> Self {
        let child = evolvent()
            .arg("bridge")
            .args(arguments)
            .args(["--bus-prefix", &domain.prefix, "--machine"])
            .arg(machine)
            .stdout(Stdio::null())
            .stderr(Stdio::inherit())
            .spawn()
            .expect("the binary to start");
        Self(child)
    }
}

impl Drop for HardwareBridge {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _gone = self.0.wait();
    }
}
