//! Why the machine is as slow on a line as it is, and what would help.
//!
//! Three sources: the setpoints of the line ([`Watch`]), the program around it ([`Surroundings`]), and plans made once
//! more with one thing changed ([`Remedy`]): what helps is measured, not guessed.

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
use watch::{Seen, Watch};

/// All that is said of a line; displayed in sentences, or as JSON.
#[derive(Debug, Serialize)]
pub struct Explanation {
    pub(crate) line: u32,
    #[serde(flatten)]
    pub(crate) program: Surroundings,
    #[serde(flatten)]
    pub(crate) seen: Seen,
    /// Why it is slow, in sentences.
    pub(crate) reasons: Vec<String>,
    /// What would help, measured.
    pub(crate) remedies: Vec<Remedy>,
    /// What would help, not measured.
    pub(crate) advice: Vec<String>,
}

impl Explanation {
    fn new(line: u32, program: Surroundings, seen: Seen, remedies: Vec<Remedy>) -> Self {
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

/// Explains one line of a program, from the setpoints of its plan.
pub struct LineExplainer {
    line: u32,
    program: Surroundings,
    watch: Watch,
}

impl LineExplainer {
    /// Reads what the program says around the line.
    ///
    /// # Errors
    /// The program cannot be opened, or has no such line.
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

    /// Takes the next setpoint, with the feed word of its block in mm/s; none on rapids.
    pub fn see(&mut self, setpoint: &Setpoint, feed_word_mm_s: Option<f64>) {
        self.watch.see(setpoint, feed_word_mm_s);
    }

    /// The explanation. Where the plan `is_whole` it is made again with one thing changed at a time, to measure what
    /// helps: nothing can be compared with a plan that failed.
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
