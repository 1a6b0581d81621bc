//! Conversion of words on the command line to requests.

use std::io;
use std::path::Path;

use evolvent_bus::ControlRequest;
use evolvent_control::{CommandCode, Mode};
use evolvent_path::{AXES, AxisLetter, AxisMask};

use crate::CommandError;
use crate::ctl_args::{ModeArg, Switch};

pub(crate) fn request(code: CommandCode) -> ControlRequest {
    ControlRequest {
        command: code as u32,
        ..ControlRequest::default()
    }
}

pub(crate) fn indexed(code: CommandCode, index: u32) -> ControlRequest {
    ControlRequest {
        index,
        ..request(code)
    }
}

pub(crate) fn switch(code: CommandCode, state: Switch) -> ControlRequest {
    indexed(code, u32::from(matches!(state, Switch::On)))
}

/// An override, within its range.
pub(crate) fn percent(code: CommandCode, percent: f64) -> Result<ControlRequest, CommandError> {
    let (name, range) = match code {
        CommandCode::RapidOverride => ("rapid", 0.0..=100.0),
        CommandCode::SpindleOverride => ("spindle", 10.0..=200.0),
        _ => ("feed", 0.0..=200.0),
    };
    if !range.contains(&percent) {
        return Err(CommandError::Usage(format!(
            "the {name} override is {} to {} %, not {percent} %",
            range.start(),
            range.end()
        )));
    }
    Ok(ControlRequest {
        amount: percent / 100.0,
        ..request(code)
    })
}

pub(crate) fn mode_of(mode: ModeArg) -> Mode {
    match mode {
        ModeArg::Auto => Mode::Auto,
        ModeArg::Manual => Mode::Manual,
        ModeArg::Mdi => Mode::Mdi,
    }
}

/// Sets a tool's offsets, and its diameter if one is given.
pub(crate) fn tool(
    number: u32,
    values: &[String],
    diameter: Option<f64>,
) -> Result<ControlRequest, CommandError> {
    if number == 0 {
        return Err(CommandError::Usage("tools are numbered from 1".to_owned()));
    }
    if let Some(diameter) = diameter.filter(|diameter| !(diameter.is_finite() && *diameter >= 0.0)) {
        return Err(CommandError::Usage(format!(
            "--diameter {diameter} is out of range: it must be a number of mm from 0"
        )));
    }
    if values.is_empty() && diameter.is_none() {
        return Err(CommandError::Usage(format!(
            "nothing to set for tool {number}: give an offset, as in Z12.5, or --diameter"
        )));
    }
    Ok(ControlRequest {
        index: number,
        amount: diameter.unwrap_or(-1.0),
        ..valued(CommandCode::Tool, values)?
    })
}

pub(crate) fn with_text(code: CommandCode, text: &str) -> Result<ControlRequest, CommandError> {
    let mut wanted = request(code);
    if !wanted.set_text(text) {
        return Err(CommandError::Usage(format!(
            "{} bytes are too long for a command",
            text.len()
        )));
    }
    Ok(wanted)
}

/// An absolute path, because the core has another working directory.
pub(crate) fn absolute(path: &Path) -> Result<String, CommandError> {
    let path = std::path::absolute(path)
        .map_err(|error: io::Error| CommandError::Usage(format!("{}: {error}", path.display())))?;
    path.to_str().map(str::to_owned).ok_or_else(|| {
        CommandError::Usage(format!(
            "{}: the name is not UTF-8; rename the file",
            path.display()
        ))
    })
}

fn axis_of(letter: char) -> Result<usize, CommandError> {
    AxisLetter::from_letter(letter)
        .map(AxisLetter::index)
        .ok_or_else(|| CommandError::Usage(format!("{letter:?} is not an axis; use letters of XYZABCUVW")))
}

pub(crate) fn letters_mask(letters: &str) -> Result<u32, CommandError> {
    letters
        .chars()
        .try_fold(0, |mask, letter| Ok(mask | 1 << axis_of(letter)?))
}

/// `X10` or `X=10` each.
pub(crate) fn valued(code: CommandCode, words: &[String]) -> Result<ControlRequest, CommandError> {
    let mut wanted = request(code);
    let mut values = [0.0; AXES];
    for word in words {
        let bad = || CommandError::Usage(format!("{word:?} is not an axis with a value, as in X12.5"));
        let mut letters = word.chars();
        let axis = axis_of(letters.next().ok_or_else(bad)?)?;
        if AxisMask::from_bits(wanted.axes_mask).contains(axis) {
            return Err(CommandError::Usage(format!(
                "{word:?}: the axis is named twice; name each axis once, with one value"
            )));
        }
        let number = letters.as_str().trim_start_matches('=');
        values[axis] = number.parse().map_err(|_| bad())?;
        wanted.axes_mask |= AxisMask::one(axis).bits();
    }
    wanted.values = values;
    Ok(wanted)
}

pub(crate) fn jog(
    axes: &[String],
    distance: Option<f64>,
    speed: Option<f64>,
) -> Result<ControlRequest, CommandError> {
    let mut wanted = ControlRequest {
        index: u32::from(distance.is_some()),
        amount: speed.unwrap_or(0.0) / 60.0,
        ..request(CommandCode::Jog)
    };
    for word in axes {
        let mut letters = word.chars();
        let (Some(letter), Some(sign), None) = (letters.next(), letters.next(), letters.next()) else {
            return Err(CommandError::Usage(format!(
                "{word:?} is not an axis with a direction, as in X+"
            )));
        };
        let sign = match sign {
            '+' => 1.0,
            '-' => -1.0,
            _ => {
                return Err(CommandError::Usage(format!(
                    "{word:?} is not an axis with a direction, as in X+"
                )));
            }
        };
        let axis = axis_of(letter)?;
        if AxisMask::from_bits(wanted.axes_mask).contains(axis) {
            return Err(CommandError::Usage(format!(
                "{word:?}: axis {} is named twice; name each axis once, with one direction",
                letter.to_ascii_uppercase()
            )));
        }
        wanted.axes_mask |= AxisMask::one(axis).bits();
        wanted.values[axis] = sign * distance.unwrap_or(1.0);
    }
    Ok(wanted)
}

/// One axis and its step, or `None`.
pub(crate) fn handwheel(axis: Option<&str>, step: Option<f64>) -> Result<ControlRequest, CommandError> {
    let axes_mask = axis.map_or(Ok(0), letters_mask)?;
    Ok(ControlRequest {
        axes_mask,
        amount: step.unwrap_or(0.0),
        ..request(CommandCode::Handwheel)
    })
}

/// 1 for G54 to 9 for G59.3.
pub(crate) fn system_number(name: &str) -> Result<u32, CommandError> {
    const NAMES: [&str; 9] = [
        "G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3",
    ];
    let found = NAMES.iter().position(|known| known.eq_ignore_ascii_case(name));
    found
        .map(|index| index as u32 + 1)
        .ok_or_else(|| CommandError::Usage(format!("{name:?} is not one of G54 to G59.3")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_become_masks_and_values() {
        let offset = valued(CommandCode::WorkOffset, &["X10".into(), "z=-2.5".into()]).unwrap();
        assert_eq!(offset.axes_mask, 0b101);
        assert_eq!((offset.values[0], offset.values[2]), (10.0, -2.5));
        assert!(valued(CommandCode::WorkOffset, &["Q1".into()]).is_err());
        assert!(valued(CommandCode::WorkOffset, &["X".into()]).is_err());
        let twice = valued(CommandCode::WorkOffset, &["X10".into(), "x=20".into()]).map(|_| ());
        assert!(format!("{twice:?}").contains("named twice"));
        let jog_both = jog(&["X+".into(), "Y-".into()], Some(5.0), Some(600.0)).unwrap();
        assert_eq!((jog_both.axes_mask, jog_both.index), (0b11, 1));
        assert_eq!(
            (jog_both.values[0], jog_both.values[1], jog_both.amount),
            (5.0, -5.0, 10.0)
        );
        assert!(jog(&["X".into()], None, None).is_err());
        assert!(jog(&["X*".into()], None, None).is_err());
        let z = ["Z1".to_owned()];
        for diameter in [-4.0, f64::NAN, f64::INFINITY] {
            assert!(tool(7, &z, Some(diameter)).is_err(), "{diameter}");
        }
        assert_eq!(tool(7, &z, Some(0.0)).unwrap().amount, 0.0);
        assert_eq!(tool(7, &z, None).unwrap().amount, -1.0);
        assert_eq!(tool(7, &[], Some(4.0)).unwrap().axes_mask, 0);
        assert!(tool(7, &[], None).is_err());
        let twice = jog(&["X+".into(), "X-".into()], Some(1.0), None).map(|_| ());
        assert!(format!("{twice:?}").contains("named twice"));
        let rapid = percent(CommandCode::RapidOverride, 101.0).map(|_| ());
        assert!(format!("{rapid:?}").contains("0 to 100 %, not 101 %"));
        assert!(percent(CommandCode::FeedOverride, 101.0).is_ok());
        assert_eq!(letters_mask("xZ").unwrap(), 0b101);
        assert_eq!(system_number("g59.3").unwrap(), 9);
        assert!(system_number("G60").is_err());
    }
}
