//! `evolvent man`: one man page per command and subcommand.

use std::fs;
use std::io::Write;
use std::path::PathBuf;

use clap::{Args, Command};

use crate::{CommandError, Ending};

/// Arguments of `evolvent man`.
#[derive(Debug, Args)]
pub(crate) struct ManArgs {
    /// The folder for the pages; it is created if it does not exist.
    folder: PathBuf,
}

/// Writes the pages into the folder, and its name and their number to `out`.
///
/// # Errors
///
/// If a page cannot be written.
pub(crate) fn run(args: &ManArgs, mut command: Command, out: &mut dyn Write) -> Result<Ending, CommandError> {
    // Fills in the full names of the subcommands, as `--help` shows them.
    command.build();
    let failed = |error| CommandError::Failed(format!("{}: {error}", args.folder.display()));
    fs::create_dir_all(&args.folder).map_err(failed)?;
    let mut count = 0;
    let mut open = vec![(String::from("evolvent"), command)];
    while let Some((name, command)) = open.pop() {
        for child in command.get_subcommands() {
            if child.get_name() != "help" && !child.is_hide_set() {
                open.push((format!("{name}-{}", child.get_name()), child.clone()));
            }
        }
        let page = clap_mangen::Man::new(command.display_name(name.clone()))
            .title(name.clone())
            .manual("Evolvent");
        let mut text = Vec::new();
        page.render(&mut text).map_err(failed)?;
        fs::write(args.folder.join(format!("{name}.1")), text).map_err(failed)?;
        count += 1;
    }
    writeln!(out, "{}: {count} pages", args.folder.display()).map_err(failed)?;
    Ok(Ending::Clean)
}
