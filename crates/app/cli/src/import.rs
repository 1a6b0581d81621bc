//! `evolvent import`: machine files from configurations of other controls.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use evolvent_import::{Import, ImportError, import};

use crate::{CommandError, Ending};

/// Maximum number of lines printed for one reason.
const MAX_LINES: usize = 4;

/// Options of `evolvent import`.
#[derive(Debug, Args)]
pub(crate) struct ImportArgs {
    #[command(subcommand)]
    source: Source,
}

#[derive(Debug, Subcommand)]
enum Source {
    /// Convert a LinuxCNC configuration (2.8 or later): axes, limits, homing, rate, tool table, parameters,
    /// subroutines.
    ///
    /// Writes the machine file, and the tool table and the parameters in mm next to it. Lists the values that
    /// LinuxCNC does not have and every line that was not carried over, with the reason. The configuration is
    /// not changed.
    Linuxcnc(LinuxcncArgs),
}

#[derive(Debug, Args)]
struct LinuxcncArgs {
    /// The INI file; no file of the configuration is replaced, not even with --force
    ini: PathBuf,
    /// The machine file. Default: NAME.toml in this folder, with the NAME of the INI file
    #[arg(long, short, value_name = "FILE.toml")]
    output: Option<PathBuf>,
    /// Replace files that an earlier import wrote
    #[arg(long)]
    force: bool,
    /// Print files, chosen values and lines that were not carried over as one JSON object
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &ImportArgs, out: &mut dyn Write) -> Result<Ending, CommandError> {
    let Source::Linuxcnc(args) = &args.source;
    let default = Path::new(args.ini.file_stem().unwrap_or_default()).with_extension("toml");
    let output = args.output.clone().unwrap_or(default);
    let stem = output
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let result = import(&args.ini, &stem)
        .map_err(|error| CommandError::Usage(error.to_string()))
        .and_then(|import| write(&import, &output, args.force).map(|files| (import, files)));
    let (import, files) = result?;
    let printed = if args.json {
        print_json(&import, &files, out)
    } else {
        print_text(&import, &files, out)
    };
    printed.map_err(|error| CommandError::Failed(error.to_string()))?;
    Ok(Ending::Clean)
}

fn write(import: &Import, output: &Path, force: bool) -> Result<Vec<PathBuf>, CommandError> {
    import.write(output, force).map_err(|error| match error {
        ImportError::Exists { .. } | ImportError::Conflict(_) | ImportError::Extension { .. } => {
            CommandError::Usage(error.to_string())
        }
        error => CommandError::Failed(error.to_string()),
    })
}

fn print_json(import: &Import, files: &[PathBuf], out: &mut dyn Write) -> std::io::Result<()> {
    let files: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    let report = import.report();
    let all = serde_json::json!({ "files": files, "chosen": report.chosen, "dropped": report.dropped });
    writeln!(out, "{all}")
}

fn print_text(import: &Import, files: &[PathBuf], out: &mut dyn Write) -> std::io::Result<()> {
    let report = import.report();
    for file in files {
        writeln!(out, "wrote {}", file.display())?;
    }
    if !report.chosen.is_empty() {
        writeln!(out, "\nChosen, because the configuration does not define it:")?;
    }
    for chosen in &report.chosen {
        writeln!(out, "  {}: {}", chosen.key, chosen.value)?;
    }
    if !report.dropped.is_empty() {
        writeln!(out, "\nNot carried over:")?;
    }
    let mut by_reason: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for line in &report.dropped {
        let at = format!("{}:{} [{}] {}", line.file, line.line, line.section, line.key);
        by_reason.entry(&line.reason).or_default().push(at);
    }
    // Reasons with few lines are specific to this machine and come first.
    let mut by_reason: Vec<_> = by_reason.into_iter().collect();
    by_reason.sort_by_key(|(_, lines)| lines.len());
    for (reason, lines) in by_reason {
        writeln!(out, "  {reason}:")?;
        for line in lines.iter().take(MAX_LINES) {
            writeln!(out, "    {line}")?;
        }
        if let Some(more @ 1..) = lines.len().checked_sub(MAX_LINES) {
            writeln!(out, "    and {more} more (--json lists all)")?;
        }
    }
    writeln!(
        out,
        "\nNext: check travels, limits and homing in the machine file, then `evolvent check` and `evolvent \
         run`."
    )
}
