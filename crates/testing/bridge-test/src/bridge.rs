//! The bridge under test, which can be started, ended and perhaps killed.

use core::time::Duration;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Instant;

use evolvent_bridge_sim::{LoopbackInputs, RunSettings, SpindleSimulation, loopback, run_cutting};
use thiserror::Error;

/// Why a bridge was not started.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{what} could not be started ({cause}): check the command")]
pub struct StartError {
    what: String,
    cause: String,
}

/// A bridge that the suite can test.
pub trait BridgeUnderTest {
    /// Starts the bridge on the bus of a machine; it waits for its core by itself.
    ///
    /// # Errors
    /// The bridge cannot be started.
    fn start(&mut self, machine_name: &str, prefix: &str) -> Result<(), StartError>;

    /// Ends the bridge cleanly.
    fn end(&mut self);

    /// Kills the bridge without any chance to clean up (SIGKILL).
    fn kill(&mut self);

    /// Whether the bridge can be killed.
    fn can_be_killed(&self) -> bool {
        true
    }

    /// Whether the bridge is running.
    fn is_running(&mut self) -> bool;
}

/// A bridge that is started by a command. `{name}` and `{prefix}` in its arguments stand for the machine's
/// name and iceoryx2's prefix. The environment has both as well, as `EVOLVENT_MACHINE_NAME` and
/// `EVOLVENT_BUS_PREFIX`.
#[derive(Debug)]
pub struct ProcessBridge {
    command: Vec<String>,
    child: Option<Child>,
}

impl ProcessBridge {
    /// Takes the command: the program and its arguments.
    #[must_use]
    pub const fn new(command: Vec<String>) -> Self {
        Self { command, child: None }
    }
}

impl BridgeUnderTest for ProcessBridge {
    fn start(&mut self, machine_name: &str, prefix: &str) -> Result<(), StartError> {
        self.end();
        let fill = |text: &String| text.replace("{name}", machine_name).replace("{prefix}", prefix);
        let failed = |cause: String| StartError {
            what: self.command.join(" "),
            cause,
        };
        let program = self
            .command
            .first()
            .ok_or_else(|| failed("no command".to_owned()))?;
        let child = Command::new(fill(program))
            .args(self.command.iter().skip(1).map(fill))
            .env("EVOLVENT_MACHINE_NAME", machine_name)
            .env("EVOLVENT_BUS_PREFIX", prefix)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .map_err(|cause| failed(cause.to_string()))?;
        self.child = Some(child);
        Ok(())
    }

    fn end(&mut self) {
        let Some(mut child) = self.child.take() else {
            return;
        };
        // The system's `kill` command avoids an unsafe system call here.
        let _sent = Command::new("kill")
            .arg("-TERM")
            .arg(child.id().to_string())
            .status();
        let deadline = Instant::now() + Duration::from_secs(3);
        while Instant::now() < deadline {
            if !matches!(child.try_wait(), Ok(None)) {
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let _gone = child.kill();
        let _gone = child.wait();
    }

    fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _gone = child.kill();
            let _gone = child.wait();
        }
    }

    fn is_running(&mut self) -> bool {
        matches!(self.child.as_mut().map(Child::try_wait), Some(Ok(None)))
    }
}

impl Drop for ProcessBridge {
    fn drop(&mut self) {
        self.end();
    }
}

/// Settings of the simulated bridge's probe, in the format of `bridge sim --probe`.
pub const SIMULATED_PROBE: &str = "plane:X>2;delay=1;latched";

type RunBridge = dyn Fn(&str, &str, &AtomicBool) + Send + Sync;

/// A bridge on a thread of this process. It cannot be killed.
pub struct ThreadBridge {
    run: Arc<RunBridge>,
    running: Option<(Arc<AtomicBool>, JoinHandle<()>)>,
}

impl ThreadBridge {
    /// Takes a function of the machine's name, iceoryx2's prefix and a flag that ends the bridge.
    pub fn new(run: impl Fn(&str, &str, &AtomicBool) + Send + Sync + 'static) -> Self {
        Self {
            run: Arc::new(run),
            running: None,
        }
    }

    /// The simulated bridge.
    #[must_use]
    pub fn simulated() -> Self {
        Self::new(|machine_name, prefix, stop| {
            let settings = RunSettings {
                spindles: vec![SpindleSimulation::usual(0)],
                machine_name: machine_name.to_owned(),
                prefix: Some(prefix.to_owned()),
                drives: None,
                faults: Vec::new(),
                probe: SIMULATED_PROBE.parse().ok(),
                drift_ppm: 50.0,
                duration: None,
            };
            // An error shows as missing feedback.
            let _report = run_cutting(
                &settings,
                stop,
                |_| {},
                |_| None,
                Some(loopback(LoopbackInputs::all())),
            );
        })
    }
}

impl BridgeUnderTest for ThreadBridge {
    fn start(&mut self, machine_name: &str, prefix: &str) -> Result<(), StartError> {
        self.end();
        let stop = Arc::new(AtomicBool::new(false));
        let (stopped, run) = (Arc::clone(&stop), Arc::clone(&self.run));
        let (machine_name, prefix) = (machine_name.to_owned(), prefix.to_owned());
        let thread = std::thread::Builder::new()
            .name("bridge".to_owned())
            .spawn(move || run(&machine_name, &prefix, &stopped))
            .map_err(|cause| StartError {
                what: "a thread".to_owned(),
                cause: cause.to_string(),
            })?;
        self.running = Some((stop, thread));
        Ok(())
    }

    fn end(&mut self) {
        if let Some((stop, thread)) = self.running.take() {
            stop.store(true, Ordering::Relaxed);
            // A panic of the bridge fails the test.
            if let Err(panic) = thread.join()
                && !std::thread::panicking()
            {
                std::panic::resume_unwind(panic);
            }
        }
    }

    fn kill(&mut self) {
        self.end();
    }

    fn can_be_killed(&self) -> bool {
        false
    }

    fn is_running(&mut self) -> bool {
        self.running
            .as_ref()
            .is_some_and(|(_, thread)| !thread.is_finished())
    }
}

impl Drop for ThreadBridge {
    fn drop(&mut self) {
        self.end();
    }
}
