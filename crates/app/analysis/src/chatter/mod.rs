//! Prediction of chatter: whether a cut vibrates, the amplitude, and the nearest stable speeds.

mod answer;
mod chart;
mod lobes;
mod map;
mod picture;
mod report;
#[cfg(test)]
mod tests;
mod transient;
mod warn;

use std::path::Path;

use evolvent_chatter::{Case, LawSource, Laws, OscillationCase};
use evolvent_cutting::{ForceLaw, LawDefinition};
use serde_json::Value;

pub use warn::{ChatterWarning, ChatterWarnings, chatter_warnings};

use crate::error::AnalysisError;
use crate::user_file::read_text;
use answer::Answer;
use lobes::LobeAnswer;

/// Optional results of a case besides the verdict; each takes time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChatterRequest {
    /// Limit cycles over speed.
    pub sweep: bool,
    /// Maps of speed and depth.
    pub maps: bool,
    /// An impulse whose response is simulated in time.
    pub kick: Option<ChatterKick>,
    /// The comparison with least squares in three stages.
    pub least_squares: bool,
}

/// An impulse in the direction of the cutting speed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChatterKick {
    /// Its velocity, m/s; `None` uses 0.3 of the impulse that lowers the cutting speed to the minimum.
    pub velocity_m_s: Option<f64>,
    /// Simulated duration, s; `None` simulates until small vibrations have changed by the factor e^4.
    pub seconds: Option<f64>,
}

/// The computed results of a case of self-oscillation or of stability lobes.
pub struct ChatterAnswer {
    case: Case,
    oscillation: Option<Answer>,
    lobes: Vec<LobeAnswer>,
}

impl ChatterAnswer {
    /// Computes a case; law files are read from the directory of `case_file`.
    ///
    /// # Errors
    /// An invalid law, or a case without a solution.
    pub fn new(case_file: &Path, case: Case, request: &ChatterRequest) -> Result<Self, AnalysisError> {
        let oscillation = match &case.oscillation {
            Some(asked) => {
                let laws = laws(case_file, asked)?;
                Some(answer::answer(case_file, asked, laws, request)?)
            }
            None => None,
        };
        let lobes = lobes::answers(&case)?;
        Ok(Self {
            case,
            oscillation,
            lobes,
        })
    }

    /// The answer as text.
    #[must_use]
    pub fn text(&self) -> String {
        report::text(&self.case, self.oscillation.as_ref(), &self.lobes)
    }

    /// The answer as a JSON object.
    #[must_use]
    pub fn json(&self) -> Value {
        report::json(&self.case, self.oscillation.as_ref(), &self.lobes)
    }

    /// Phase portrait, force over speed, and cycles over speed as one SVG; `None` without self-oscillation.
    #[must_use]
    pub fn cycles_svg(&self) -> Option<String> {
        Some(picture::svg(&self.case, self.oscillation.as_ref()?))
    }

    /// The maps of speed and depth as one SVG; `None` without self-oscillation.
    #[must_use]
    pub fn map_svg(&self) -> Option<String> {
        Some(map::svg(&self.case, self.oscillation.as_ref()?))
    }

    /// The response to the impulse as one SVG; `None` if no impulse was requested.
    #[must_use]
    pub fn transient_svg(&self) -> Option<String> {
        let answer = self.oscillation.as_ref()?;
        Some(transient::svg(&self.case, answer, answer.transient.as_ref()?))
    }

    /// The diagram of stability lobes as one SVG.
    #[must_use]
    pub fn lobes_svg(&self) -> String {
        lobes::svg(&self.case, &self.lobes)
    }
}

/// Reads a case file.
///
/// # Errors
/// An unreadable or invalid file, with file, line and key.
pub fn read_chatter_case(file: &Path) -> Result<Case, AnalysisError> {
    let text = read_text(file, "case file")?;
    Case::parse(&text, &file.display().to_string()).map_err(|error| AnalysisError::Input(error.to_string()))
}

/// The law of the tangential force of a case.
fn law(case_file: &Path, asked: &OscillationCase) -> Result<(ForceLaw, LawDefinition), AnalysisError> {
    definition(case_file, &asked.law, asked)
}

/// The laws of a case, with their definitions.
pub(crate) struct CaseLaws {
    law: ForceLaw,
    definition: LawDefinition,
    /// The law of the radial force, if it has its own.
    radial: Option<(ForceLaw, LawDefinition)>,
}

impl CaseLaws {
    pub(crate) fn laws(&self) -> Laws<'_> {
        Laws {
            tangential: &self.law,
            radial: self.radial.as_ref().map(|(law, _)| law),
        }
    }

    /// Describes the assumption about the radial force.
    pub(crate) fn radial_text(&self, asked: &OscillationCase) -> String {
        match &self.radial {
            Some((_, radial)) => format!("radial force by law {}: {}", radial.name, radial.description),
            None => format!(
                "radial force is {} of the tangential force{}",
                // Rounded to the precision of a measured ratio.
                (asked.radial_ratio.unwrap_or_else(|| self.law.radial_ratio()) * 1e4).round() / 1e4,
                if asked.radial_ratio.is_some() {
                    " (case file)"
                } else {
                    " (assumed by the law)"
                }
            ),
        }
    }
}

/// The laws of a case.
pub(crate) fn laws(case_file: &Path, asked: &OscillationCase) -> Result<CaseLaws, AnalysisError> {
    let (law, definition) = law(case_file, asked)?;
    let radial = match &asked.radial_law {
        Some(source) => Some(self::definition(case_file, source, asked)?),
        None => None,
    };
    Ok(CaseLaws {
        law,
        definition,
        radial,
    })
}

fn definition(
    case_file: &Path,
    source: &LawSource,
    asked: &OscillationCase,
) -> Result<(ForceLaw, LawDefinition), AnalysisError> {
    let usage = |text: String| AnalysisError::Input(text);
    let definition = match source {
        LawSource::BuiltIn(definition) => (**definition).clone(),
        LawSource::File(name) => {
            let file = case_file.parent().unwrap_or(Path::new("")).join(name);
            let text = read_text(&file, "law file")?;
            LawDefinition::parse(&text, &file.display().to_string())
                .map_err(|error| usage(error.to_string()))?
        }
    };
    let law = definition
        .law(asked.angles)
        .map_err(|error| usage(format!("{}: force: {error}", case_file.display())))?;
    Ok((law, definition))
}
