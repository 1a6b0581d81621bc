//! `evolvent completions`: shell completions.

use std::io::Write;

use clap::{Args, Command};
use clap_complete::Shell;

use crate::{CommandError, Ending};

/// Arguments of `evolvent completions`.
#[derive(Debug, Args)]
#[command(after_help = "Example, for bash: evolvent completions bash > \
                  ~/.local/share/bash-completion/completions/evolvent")]
pub(crate) struct CompletionsArgs {
    /// The shell.
    #[arg(value_enum)]
    shell: Shell,
}

/// Writes the completions to `out`.
///
/// # Errors
///
/// If `out` cannot be written.
pub(crate) fn run(
    args: &CompletionsArgs,
    mut command: Command,
    out: &mut dyn Write,
) -> Result<Ending, CommandError> {
    let mut script = Vec::new();
    // `generate` panics if its writer fails, so it writes to memory.
    clap_complete::generate(args.shell, &mut command, "evolvent", &mut script);
    out.write_all(&script)
        .map_err(|error| CommandError::Failed(format!("the completions could not be written: {error}")))?;
    Ok(Ending::Clean)
}
