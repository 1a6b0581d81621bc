//! A hardware bridge.

use std::path::Path;
use std::process::{Child, Stdio};

use rustix::process::{Pid, Signal, kill_process};

use crate::{Domain, Finished, evolvent, wait};

/// A hardware bridge in its own process, `evolvent bridge ...`. Killed on drop.
#[derive(Debug)]
pub struct HardwareBridge(Option<Child>);

impl HardwareBridge {
    /// Starts the bridge for a machine, with its kind and options. With `--json` its final output is kept.
    ///
    /// # Panics
    /// If it cannot be started.
    #[must_use]
    pub fn start(arguments: &[String], machine: &Path, domain: &Domain) -> Self {
        let reports = arguments.iter().any(|argument| argument == "--json");
        let child = evolvent()
            .arg("bridge")
            .args(arguments)
            .args(["--bus-prefix", &domain.prefix, "--machine"])
            .arg(machine)
            .stdout(if reports { Stdio::piped() } else { Stdio::null() })
            .stderr(Stdio::inherit())
            .spawn()
            .expect("the binary to start");
        Self(Some(child))
    }

    /// Ends the bridge as a service manager does, and waits.
    ///
    /// # Panics
    /// If it does not end.
    #[must_use]
    pub fn end(mut self) -> Finished {
        let child = self.0.take().expect("a child");
        let pid = Pid::from_raw(child.id().cast_signed()).expect("a process");
        kill_process(pid, Signal::TERM).expect("a living process");
        wait(child)
    }
}

impl Drop for HardwareBridge {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            let _gone = child.kill();
            let _gone = child.wait();
        }
    }
}
