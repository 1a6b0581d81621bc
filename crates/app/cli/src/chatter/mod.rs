//! `evolvent chatter`: predicts whether a cut vibrates, how strongly, and at which speeds it does not.

#[cfg(test)]
mod tests;

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use evolvent_analysis::{ChatterAnswer, ChatterKick, ChatterRequest, ChatterWarnings, read_chatter_case};
use evolvent_config::{check_outputs, write_whole};

use crate::rate::check_svg_name;
use crate::{CommandError, Ending};

/// Options of `evolvent chatter`.
///
/// A case with [cut], [force] and [tool] computes self-oscillation; one with [turning] or [milling] computes
/// stability lobes. docs/theory-self-oscillation.md explains an example.
#[allow(
    rustdoc::broken_intra_doc_links,
    reason = "sections of a file, and `--help` shows this text as it is"
)]
#[derive(Debug, Args, Default)]
pub(crate) struct ChatterArgs {
    /// The case file (TOML, or JSON with the same keys)
    pub(crate) case: PathBuf,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
    /// Write phase portrait, force over speed, and amplitude, frequency and growth over speed into one SVG
    /// file
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) plot: Option<PathBuf>,
    /// Write the map of speed and depth, one per feed of the case, into one SVG file
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) map: Option<PathBuf>,
    /// Write the diagram of stability lobes into one SVG file
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) lobes: Option<PathBuf>,
    /// Follow an impulse along the cutting speed in time, and write deflections and the spiral in the phase
    /// plane into one SVG file
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) transient: Option<PathBuf>,
    /// Velocity of the impulse, m/s; default: 0.3 of the velocity that brings the cutting speed to the floor
    #[arg(long, value_name = "M_S", requires = "transient", allow_hyphen_values = true)]
    pub(crate) kick: Option<f64>,
    /// Time shown after the impulse, s; default: until small vibrations have changed by e^4
    #[arg(long, value_name = "S", requires = "transient")]
    pub(crate) seconds: Option<f64>,
    /// Compare with the three-stage least squares of the source
    #[arg(long)]
    pub(crate) least_squares: bool,
    /// Number of harmonics, 1 to 32; default: the case's, or 5
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=32))]
    pub(crate) harmonics: Option<u8>,
}

/// Computes the case and writes it to `out`, as text or as one JSON object; notes go to `err`.
///
/// # Errors
/// `Usage` for a bad case, `Failed` if there is no result, or if output or a picture cannot be written.
pub(crate) fn run(
    args: &ChatterArgs,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let mut case = read_chatter_case(&args.case)?;
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
    for (option, given) in [
        ("--harmonics", args.harmonics.is_some()),
        ("--least-squares", args.least_squares),
    ] {
        if given && case.oscillation.is_none() {
            return Err(CommandError::Usage(format!(
                "{}: {option} is for self-oscillation: the case has no [cut], [force] and [tool]; leave it \
                 out",
                args.case.display()
            )));
        }
    }
    check_outputs(
        [&args.plot, &args.map, &args.transient, &args.lobes]
            .into_iter()
            .flatten()
            .map(PathBuf::as_path),
        [(args.case.as_path(), "the case file")],
    )?;
    for (option, value, min, max) in [
        ("--kick", args.kick, -1e3, 1e3),
        ("--seconds", args.seconds, 1e-4, 100.0),
    ] {
        if let Some(value) = value.filter(|value| !(min..=max).contains(value)) {
            return Err(CommandError::Usage(format!(
                "{option} is {value}: give a number from {min} to {max}"
            )));
        }
    }
    if let (Some(oscillation), Some(harmonics)) = (&mut case.oscillation, args.harmonics) {
        oscillation.harmonics = usize::from(harmonics);
    }
    let request = ChatterRequest {
        sweep: args.json || args.plot.is_some(),
        maps: args.map.is_some(),
        kick: args.transient.is_some().then_some(ChatterKick {
            velocity_m_s: args.kick,
            seconds: args.seconds,
        }),
        least_squares: args.least_squares,
    };
    let answer = ChatterAnswer::new(&args.case, case, &request)?;
    for (file, svg) in [
        (&args.plot, args.plot.as_ref().and_then(|_| answer.cycles_svg())),
        (&args.map, args.map.as_ref().and_then(|_| answer.map_svg())),
        (&args.transient, answer.transient_svg()),
        (&args.lobes, args.lobes.as_ref().map(|_| answer.lobes_svg())),
    ] {
        if let (Some(file), Some(svg)) = (file, svg) {
            write_picture(file, &svg, err)?;
        }
    }
    let text = if args.json {
        format!("{:#}\n", answer.json())
    } else {
        answer.text()
    };
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .map_err(|error| CommandError::Failed(format!("cannot write the result: {error}")))?;
    Ok(Ending::Clean)
}

fn write_picture(file: &Path, svg: &str, err: &mut dyn Write) -> Result<(), CommandError> {
    write_whole(file, svg.as_bytes())
        .map_err(|error| CommandError::Failed(format!("{}: cannot write: {error}", file.display())))?;
    // If standard error is closed, nobody is left to inform.
    let _ = writeln!(err, "figures written to {}", file.display());
    Ok(())
}

/// Writes the predictions for a program, followed by the assumptions.
pub(crate) fn write_warnings(warnings: &ChatterWarnings, err: &mut dyn Write, file_name: &str) {
    // If standard error is closed, nobody is left to inform.
    let _ = err.write_all(warnings.text(file_name).as_bytes());
}
