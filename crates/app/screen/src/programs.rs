//! Uploaded programs: valid names, checks, and threads of low priority.

use std::path::Path;

use evolvent_gcode::Diagnostic;
use evolvent_runtime::{CheckBounds, Setup, Unchecked, Warning, check};

use crate::kept::present_setup;
use crate::messages::{Finding, ProgramInfo};

/// Maximum number of errors shown.
const ERRORS: usize = 50;
/// Maximum length of a program name, bytes: it fits into the status.
const MAX_NAME: usize = 100;

/// Characters that change how the text around them is shown: a name with them looks like another.
const DIRECTIONS: [std::ops::RangeInclusive<char>; 4] = [
    '\u{200b}'..='\u{200f}',
    '\u{2028}'..='\u{202e}',
    '\u{2060}'..='\u{206f}',
    '\u{feff}'..='\u{feff}',
];

/// Whether a page may use this as a file name: everything that names one file in a folder, can be read, and is
/// not hidden. A backslash separates folders on the computers that programs come from.
pub(crate) fn is_good_name(name: &str) -> bool {
    let is_bad = |letter: char| {
        letter.is_control()
            || ['/', '\\'].contains(&letter)
            || DIRECTIONS.iter().any(|range| range.contains(&letter))
    };
    !name.is_empty()
        && name.len() <= MAX_NAME
        && !name.starts_with('.')
        && name.trim() == name
        && !name.contains(is_bad)
}

/// Checks a program like `evolvent check`.
pub(crate) fn checked(
    file: &Path,
    info: &ProgramInfo,
    setup: &Setup,
    state_folder: Option<&Path>,
) -> ProgramInfo {
    let setup = present_setup(setup, state_folder);
    let (errors, warnings) = match check(file, &setup, CheckBounds::whole(ERRORS)) {
        Ok(found) => {
            let rest = found.unchecked.as_ref().map(unchecked);
            let warnings = found.warnings.into_iter().map(warning);
            (
                found.errors.iter().map(error).collect(),
                warnings.chain(rest).collect(),
            )
        }
        Err(cause) => (vec![unreadable(&cause)], Vec::new()),
    };
    ProgramInfo {
        errors,
        warnings,
        checked: true,
        ..info.clone()
    }
}

fn error(found: &Diagnostic) -> Finding {
    Finding {
        line: found.line,
        column: found.column,
        length: found.length,
        code: found.code.as_str().to_owned(),
        message: found.message.clone(),
        help: found.help.as_deref().unwrap_or_default().to_owned(),
        file: found.file.as_deref().map(str::to_owned),
    }
}

fn warning(found: Warning) -> Finding {
    Finding {
        line: found.line,
        column: 0,
        length: 0,
        code: String::new(),
        message: found.message,
        help: String::new(),
        file: found.file,
    }
}

fn unchecked(rest: &Unchecked) -> Finding {
    Finding {
        line: rest.up_to,
        column: 0,
        length: 0,
        code: String::new(),
        message: format!("{rest}; the rest was not checked"),
        help: String::new(),
        file: None,
    }
}

fn unreadable(cause: &std::io::Error) -> Finding {
    Finding {
        line: 0,
        column: 0,
        length: 0,
        code: String::new(),
        message: format!("the program cannot be read: {cause}"),
        help: "upload it again".to_owned(),
        file: None,
    }
}

/// Niceness of computations that a page waits for: machine control has priority.
const NICE: i32 = 10;
/// Niceness of computations that take minutes: browsers on the same computer have priority, too.
const NICE_FOR_MINUTES: i32 = 19;

/// Runs a function in a separate thread that yields the processor to others.
pub(crate) fn background(name: &str, work: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    std::thread::Builder::new().name(name.to_owned()).spawn(move || {
        set_niceness(NICE);
        work();
    })?;
    Ok(())
}

/// Lowers the priority of the present thread, and of threads that it starts from now on, for work of minutes.
pub(crate) fn work_for_minutes() {
    set_niceness(NICE_FOR_MINUTES);
}

fn set_niceness(nice: i32) {
    // On Linux the niceness belongs to a thread and is inherited by its children.
    let _kept = rustix::process::setpriority_process(Some(rustix::thread::gettid()), nice);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_cam_programs_are_good_and_paths_are_not() {
        for name in [
            "part.ngc",
            "Op#1, rough.nc",
            "a&b.nc",
            "50% \"fine\" <v2>?.ngc",
            "O'Brien; 2 * 3 = $6 @ {x} [y] ~!|^`.tap",
            "Gehäuse Größe 7.ngc",
        ] {
            assert!(is_good_name(name), "{name}");
        }
        let long = "x".repeat(MAX_NAME + 1);
        for name in [
            "",
            ".",
            "..",
            ".part.ngc",
            "a/b.ngc",
            "../a.ngc",
            "a\\b.ngc",
            "a\0.ngc",
            "a\nb.ngc",
            " a.ngc",
            "a.ngc ",
            "a\u{7f}.ngc",
            "a\u{85}.ngc",
            "cgn\u{202e}.exe",
            "\u{feff}a.ngc",
            &long,
        ] {
            assert!(!is_good_name(name), "{name:?}");
        }
    }
}
