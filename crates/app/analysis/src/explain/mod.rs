//! Why the machine is slow on a program line, and which change would help.
//!
//! It uses three sources: the setpoints of the line ([`Watch`]), the surrounding program ([`Surroundings`]),
//! and plans repeated with one change each ([`Remedy`]). The benefit of a change is therefore measured, not
//! estimated.

mod remedy;
mod surroundings;
mod watch;
mod words;

use evolvent_machine::Machine;
use evolvent_motion::Setpoint;
use evolvent_runtime::Job;
use serde::Serialize;

use crate::error::AnalysisError;
use remedy::{Remedy, remedies};
use surroundings::Surroundings;
use watch::{LineTiming, Watch};

/// The explanation of a line; displayed as text, or serialized as JSON.
#[derive(Debug, Serialize)]
pub struct Explanation {
    pub(crate) line: u32,
    #[serde(flatten)]
    pub(crate) program: Surroundings,
    #[serde(flatten)]
    pub(crate) seen: LineTiming,
    /// Why the line is slow, in sentences.
    pub(crate) reasons: Vec<String>,
    /// Changes that help, measured.
    pub(crate) remedies: Vec<Remedy>,
    /// Changes that may help, not measured.
    pub(crate) advice: Vec<String>,
}

impl Explanation {
    fn new(line: u32, program: Surroundings, seen: LineTiming, remedies: Vec<Remedy>) -> Self {
        let (reasons, advice) = words::reasons(&program, &seen);
        Self {
            line,
            program,
            seen,
            reasons,
            remedies,
            advice,
        }
    }
}

/// Explains one program line from the setpoints of its plan.
pub struct LineExplainer {
    line: u32,
    program: Surroundings,
    watch: Watch,
}

impl LineExplainer {
    /// Reads the program around the line.
    ///
    /// # Errors
    /// The program cannot be opened, or does not have the line.
    pub fn new(line: u32, job: &Job, machine: &Machine, period_s: f64) -> Result<Self, AnalysisError> {
        let program = Surroundings::read(&job.program, &job.setup, line).map_err(AnalysisError::failed)?;
        if line > program.lines {
            return Err(AnalysisError::Input(format!(
                "{} has {} lines; there is no line {line} to explain",
                job.program.display(),
                program.lines
            )));
        }
        Ok(Self {
            line,
            program,
            watch: Watch::new(line, machine, period_s),
        })
    }

    /// Takes the next setpoint, with the feed word of its block in mm/s; `None` on rapids.
    pub fn see(&mut self, setpoint: &Setpoint, feed_word_mm_s: Option<f64>) {
        self.watch.see(setpoint, feed_word_mm_s);
    }

    /// The explanation. If the plan `is_whole`, it is repeated with one change at a time to measure the
    /// benefit; a plan that failed cannot be compared.
    #[must_use]
    pub fn finish(self, job: &Job, is_whole: bool) -> Explanation {
        let is_measured = is_whole && !self.watch.is_empty();
        let seen = self.watch.finish();
        let measured = if is_measured {
            remedies(job, self.line, &self.program, &seen)
        } else {
            Vec::new()
        };
        Explanation::new(self.line, self.program, seen, measured)
    }
}
