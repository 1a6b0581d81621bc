//! `evolvent trace verify`.

use std::io::{self, Write};
use std::path::Path;

use evolvent_replay::{Verified, verify};

use super::{inspect_error, write_error};
use crate::{CommandError, Ending};

pub(super) fn run(file: &Path, json: bool, out: &mut dyn Write) -> Result<Ending, CommandError> {
    let verified = verify(file).map_err(|error| inspect_error(&error))?;
    let written = if json {
        serde_json::to_string(&verified)
            .map_err(io::Error::from)
            .and_then(|text| writeln!(out, "{text}"))
    } else {
        write_verified(out, &verified)
    };
    written.map_err(write_error)?;
    Ok(if !verified.holds() {
        Ending::Negative
    } else if verified.lacks_data() {
        Ending::Lossy
    } else {
        Ending::Clean
    })
}

fn write_verified(out: &mut dyn Write, verified: &Verified) -> io::Result<()> {
    match &verified.first_difference {
        None if verified.compared == 0 => writeln!(
            out,
            "nothing was compared: the trace holds {} cycles, none of which could be recomputed",
            verified.cycles
        )?,
        None if verified.recomputed => writeln!(
            out,
            "the same: {} setpoints recomputed, every bit of position, velocity, acceleration, jerk, path, \
             feed, line, \
             state and flags",
            verified.compared
        )?,
        None => writeln!(out, "not recomputed")?,
        Some(difference) => {
            writeln!(
                out,
                "NOT the same: {} of {} setpoints differ, positions by at most {:e} mm or degrees",
                verified.differing, verified.cycles, verified.greatest_difference
            )?;
            writeln!(
                out,
                "  first at cycle {} ({:.6} s), line {}: {}",
                difference.sequence, difference.time_s, difference.line, difference.text
            )?;
            writeln!(
                out,
                "  {}: recorded {:?}, computed {:?}",
                difference.quantity, difference.recorded, difference.recomputed
            )?;
            if verified.explanations.is_empty() {
                writeln!(
                    out,
                    "  version, platform and machine file are the same: please report this with the trace"
                )?;
            }
        }
    }
    for text in &verified.explanations {
        writeln!(out, "  {text}")?;
    }
    if verified.cycles == 0 {
        // Nothing was checked in this case either.
    } else if verified.violations.is_empty() {
        write!(
            out,
            "every sample is within travel, velocity, acceleration and jerk"
        )?;
        match verified.max_path_error_mm {
            Some(error) => writeln!(out, ", and the path within its tolerance (at most {error:.6} mm)")?,
            None => writeln!(out)?,
        }
    } else {
        for text in &verified.violations {
            writeln!(out, "NOT within limits: {text}")?;
        }
    }
    if verified.jobs > 0 {
        writeln!(
            out,
            "{} motions of a served machine: programs, blocks of MDI, jogs, homing",
            verified.jobs
        )?;
    }
    if verified.uncompared > 0 {
        writeln!(
            out,
            "{} cycles were not compared: what moved the axes there is unknown",
            verified.uncompared
        )?;
    }
    if verified.missing > 0 {
        writeln!(out, "{} cycles are missing in the trace", verified.missing)?;
    }
    verified
        .notes
        .iter()
        .try_for_each(|note| writeln!(out, "note: {note}"))
}
