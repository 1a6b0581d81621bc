//! One `evolvent run`.

use std::path::Path;
use std::process::{Child, Command, Stdio};

use crate::{Domain, Finished, evolvent};

/// A builder for `evolvent run --json`.
#[derive(Debug)]
pub struct Launch(Command);

impl Launch {
    /// With the virtual clock, without a bus and, by default, without a trace.
    #[must_use]
    pub fn in_virtual_time(program: &Path, machine: &Path) -> Self {
        Self::new(program, machine).with(&["--clock", "virtual", "--no-bus"])
    }

    /// In real time, on a separate bus.
    #[must_use]
    pub fn in_real_time(program: &Path, machine: &Path, domain: &Domain) -> Self {
        Self::new(program, machine).with(&["--clock", "realtime", "--bus-prefix", &domain.prefix])
    }

    fn new(program: &Path, machine: &Path) -> Self {
        let mut command = evolvent();
        command
            .arg("run")
            .arg(program)
            .arg("--machine")
            .arg(machine)
            .arg("--json");
        Self(command)
    }

    /// Adds options.
    #[must_use]
    pub fn with(mut self, options: &[&str]) -> Self {
        self.0.args(options);
        self
    }

    /// Records to a file.
    #[must_use]
    pub fn trace(mut self, file: &Path) -> Self {
        self.0.arg("--trace").arg(file);
        self
    }

    /// Does not record.
    #[must_use]
    pub fn no_trace(self) -> Self {
        self.with(&["--no-trace"])
    }

    /// Runs to the end.
    ///
    /// # Panics
    /// If it cannot be started.
    #[must_use]
    pub fn finish(mut self) -> Finished {
        self.0.output().expect("the binary to start").into()
    }

    /// Starts the run.
    ///
    /// # Panics
    /// If it cannot be started.
    #[must_use]
    pub fn start(mut self) -> Child {
        self.0
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the binary to start")
    }

    /// Starts the run in a shell, after a command of that shell, and waits for its end.
    ///
    /// # Panics
    /// If it cannot be started.
    #[must_use]
    pub fn finish_after(self, shell_command: &str) -> Finished {
        let mut shell = Command::new("bash");
        shell.current_dir(crate::repository()).stdin(Stdio::null());
        shell
            .arg("-c")
            .arg(format!("{shell_command}; exec \"$0\" \"$@\""));
        shell.arg(self.0.get_program()).args(self.0.get_args());
        shell.output().expect("bash to start").into()
    }
}
