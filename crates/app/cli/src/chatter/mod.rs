//! `evolvent chatter`: will this cut vibrate, how strongly, and at which speed not?

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

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use evolvent_chatter::{Case, LawSource, Laws, OscillationCase};
use evolvent_cutting::{ForceLaw, LawDefinition};

pub(crate) use warn::{Warning, warnings};

use crate::rate::{check_svg_name, write_whole};
use crate::user_file::read_text;
use crate::{CommandError, Ending};

/// Options of `evolvent chatter`.
///
/// A case with [cut], [force] and [tool] asks for self-oscillation; one with [turning] or [milling] asks for stability
/// lobes. docs/theory-self-oscillation.md leads through an example.
#[derive(Debug, Args, Default)]
pub(crate) struct ChatterArgs {
    /// The case file (TOML, or JSON with the same keys)
    pub(crate) case: PathBuf,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
    /// Write phase portrait, force over speed, and amplitude, frequency and growth over speed into one SVG file
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) plot: Option<PathBuf>,
    /// Write the map of speed and depth, one for each feed of the case, into one SVG file
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) map: Option<PathBuf>,
    /// Write the diagram of stability lobes into one SVG file
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) lobes: Option<PathBuf>,
    /// Follow a kick along the cutting speed in time, and write deflections and the spiral in the phase plane into one SVG
    /// file
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) transient: Option<PathBuf>,
    /// Velocity of the kick, m/s; default: 0.3 of what brings the cutting speed to the floor
    #[arg(long, value_name = "M_S", requires = "transient", allow_hyphen_values = true)]
    pub(crate) kick: Option<f64>,
    /// Time that is shown after the kick, s; default: until small vibrations have changed by e^4
    #[arg(long, value_name = "S", requires = "transient")]
    pub(crate) seconds: Option<f64>,
    /// Compare with the least squares in three stages
    #[arg(long)]
    pub(crate) least_squares: bool,
    /// Harmonics that are kept, 1 to 32; default: the case's, or 5
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=32))]
    pub(crate) harmonics: Option<u8>,
}

/// Computes the case and writes it to `out`, as text or as one JSON object; what else there is to say goes to `err`.
///
/// # Errors
/// `Usage` for a bad case, `Failed` where there is no answer, or where output or a picture cannot be written.
pub(crate) fn run(
    args: &ChatterArgs,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let mut case = read_case(&args.case)?;
    for (file, there, what) in [
        (
            &args.plot,
            case.oscillation.is_some(),
            "[cut], [force] and [tool]",
        ),
        (&args.map, case.oscillation.is_some(), "[cut], [force] and [tool]"),
        (
            &args.transient,
            case.oscillation.is_some(),
            "[cut], [force] and [tool]",
        ),
        (
            &args.lobes,
            case.turning.is_some() || case.milling.is_some(),
            "[turning] or [milling]",
        ),
    ] {
        let Some(file) = file else { continue };
        check_svg_name(file)?;
        if !there {
            return Err(CommandError::Usage(format!(
                "{}: no picture for {}: the case has no {what}",
                args.case.display(),
                file.display()
            )));
        }
    }
    for (option, value, least, most) in [
        ("--kick", args.kick, -1e3, 1e3),
        ("--seconds", args.seconds, 1e-4, 100.0),
    ] {
        if let Some(value) = value.filter(|value| !(least..=most).contains(value)) {
            return Err(CommandError::Usage(format!(
                "{option} is {value}: give a number from {least} to {most}"
            )));
        }
    }
    if let (Some(oscillation), Some(harmonics)) = (&mut case.oscillation, args.harmonics) {
        oscillation.harmonics = usize::from(harmonics);
    }
    let oscillation = match &case.oscillation {
        Some(asked) => {
            let laws = laws(&args.case, asked)?;
            Some(answer::answer(asked, laws, args)?)
        }
        None => None,
    };
    let lobes = lobes::answers(&case)?;
    if let Some((file, answer)) = args.plot.as_ref().zip(oscillation.as_ref()) {
        write_picture(file, &picture::svg(&case, answer), err)?;
    }
    if let Some((file, answer)) = args.map.as_ref().zip(oscillation.as_ref()) {
        write_picture(file, &map::svg(&case, answer), err)?;
    }
    if let Some((file, answer)) = args.transient.as_ref().zip(oscillation.as_ref())
        && let Some(transient) = &answer.transient
    {
        write_picture(file, &transient::svg(&case, answer, transient), err)?;
    }
    if let Some(file) = &args.lobes {
        write_picture(file, &lobes::svg(&case, &lobes), err)?;
    }
    let text = if args.json {
        format!("{:#}\n", report::json(&case, oscillation.as_ref(), &lobes))
    } else {
        report::text(&case, oscillation.as_ref(), &lobes)
    };
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .map_err(|error| CommandError::Failed(format!("cannot write the result: {error}")))?;
    Ok(Ending::Clean)
}

fn write_picture(file: &Path, svg: &str, err: &mut dyn Write) -> Result<(), CommandError> {
    write_whole(file, svg.as_bytes())
        .map_err(|error| CommandError::Failed(format!("{}: cannot write: {error}", file.display())))?;
    // With standard error gone there is nobody left to tell.
    let _ = writeln!(err, "figures written to {}", file.display());
    Ok(())
}

/// Reads a case file.
pub(crate) fn read_case(file: &Path) -> Result<Case, CommandError> {
    let text = read_text(file, "case file")?;
    Case::parse(&text, &file.display().to_string()).map_err(|error| CommandError::Usage(error.to_string()))
}

/// The law of the tangential force of a case.
fn law(case_file: &Path, asked: &OscillationCase) -> Result<(ForceLaw, LawDefinition), CommandError> {
    definition(case_file, &asked.law, asked)
}

/// The laws of a case, with their definitions.
pub(crate) struct CaseLaws {
    law: ForceLaw,
    definition: LawDefinition,
    /// Of the radial force, if it has one of its own.
    radial: Option<(ForceLaw, LawDefinition)>,
}

impl CaseLaws {
    pub(crate) fn laws(&self) -> Laws<'_> {
        Laws {
            tangential: &self.law,
            radial: self.radial.as_ref().map(|(law, _)| law),
        }
    }

    /// What is assumed of the radial force.
    pub(crate) fn radial_text(&self, asked: &OscillationCase) -> String {
        match &self.radial {
            Some((_, radial)) => format!("radial force by law {}: {}", radial.name, radial.description),
            None => format!(
                "radial force is {} of the tangential force{}",
                asked.radial_ratio.unwrap_or_else(|| self.law.radial_ratio()),
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
pub(crate) fn laws(case_file: &Path, asked: &OscillationCase) -> Result<CaseLaws, CommandError> {
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
) -> Result<(ForceLaw, LawDefinition), CommandError> {
    let usage = |text: String| CommandError::Usage(text);
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
