//! A bridge to hardware.

use std::path::Path;
use std::process::{Child, Stdio};

use rustix::process::{Pid, Signal, kill_process};

use crate::{Domain, Finished, evolvent, wait};

/// A bridge to hardware in a process of its own, `evolvent bridge ...`. Killed when it is dropped.
#[derive(Debug)]
pub struct HardwareBridge(Option<Child>);

impl HardwareBridge {
    /// Starts it on a machine, with its kind and options. What it prints at its end is kept with `--json`.
    ///
    /// # Panics
    /// It cannot be started.
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

    /// Asks it to end, as a service manager does, and waits.
    ///
    /// # Panics
    /// It does not end.
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
