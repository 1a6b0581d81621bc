//! A core as a process, so that it can be killed.

use core::time::Duration;
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use crate::case::CaseError;
use crate::test_core::{Fate, TestCore};

/// Brings the drives of a bridge up and moves the first axis to and fro until this process is killed. The
/// hidden command `evolvent bridge core` runs this function.
///
/// # Errors
/// The bus cannot be opened, or the bridge does not come up.
pub fn run_core(machine_name: &str, prefix: &str, seconds: f64) -> Result<(), CaseError> {
    let mut core = TestCore::open(machine_name, prefix).map_err(|error| CaseError::new(error.to_string()))?;
    core.bring_up()?;
    let end = Instant::now() + Duration::from_secs_f64(seconds.clamp(0.0, 3600.0));
    while Instant::now() < end {
        core.swing(8.0, 0.8, &mut |_| Fate::Sent);
    }
    Ok(())
}

/// A running core process, which is killed when it is dropped.
#[derive(Debug)]
pub struct CoreProcess(Child);

impl CoreProcess {
    /// Starts `PROGRAM bridge core --machine-name NAME --bus-prefix PREFIX`.
    ///
    /// # Errors
    /// The program cannot be started.
    pub fn start(program: &std::path::Path, machine_name: &str, prefix: &str) -> Result<Self, CaseError> {
        Command::new(program)
            .args([
                "bridge",
                "core",
                "--machine-name",
                machine_name,
                "--bus-prefix",
                prefix,
            ])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map(Self)
            .map_err(|cause| CaseError::new(format!("{}: {cause}", program.display())))
    }

    /// Kills the process.
    pub fn kill(&mut self) {
        let _gone = self.0.kill();
        let _gone = self.0.wait();
    }
}

impl Drop for CoreProcess {
    fn drop(&mut self) {
        self.kill();
    }
}
