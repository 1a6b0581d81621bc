//! The screen in the browser: options of `evolvent serve` and `evolvent run`.

use std::io::{IsTerminal, Write};
use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;
use evolvent_runtime::Setup;
use evolvent_screen::{Screen, ScreenConfig, ScreenScope};

use crate::CommandError;

/// Options of the screen.
#[derive(Debug, Args)]
pub(crate) struct ScreenArgs {
    /// Serve the page for the browser. Beyond 127.0.0.1 connections are encrypted, the fingerprint of the
    /// certificate is printed, and on a terminal the address is also printed as a QR code.
    #[arg(
        long = "screen",
        value_name = "ADDRESS:PORT",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "127.0.0.1:5300"
    )]
    address: Option<SocketAddr>,
    /// A name by which browsers may address this computer, in addition to its host name and addresses; may be
    /// repeated.
    #[arg(long = "screen-host", value_name = "NAME", requires = "address")]
    hosts: Vec<String>,
    /// Certificate chain of the screen, PEM. Default beyond 127.0.0.1: a generated certificate, kept in the
    /// state folder.
    #[arg(long = "screen-certificate", value_name = "FILE.pem", requires_all = ["address", "key"])]
    certificate: Option<PathBuf>,
    /// Private key of the certificate, PEM.
    #[arg(
        long = "screen-key",
        value_name = "FILE.pem",
        id = "key",
        requires = "certificate"
    )]
    key: Option<PathBuf>,
}

/// Options of a screen from which a machine is operated.
#[derive(Debug, Args)]
pub(crate) struct OperateArgs {
    /// File of macros: buttons of the screen, each with blocks of MDI (config/macros). Default: macros.toml
    /// in the state folder, if it exists.
    #[arg(long = "screen-macros", value_name = "FILE.toml", requires = "address")]
    pub(crate) macros: Option<PathBuf>,
}

impl ScreenArgs {
    pub(crate) const fn is_wanted(&self) -> bool {
        self.address.is_some()
    }

    /// Starts the screen, if requested. Its threads inherit the priority of the caller.
    pub(crate) fn start(
        &self,
        setup: &Setup,
        bus_prefix: Option<&String>,
        scope: ScreenScope,
    ) -> Result<Option<Screen>, CommandError> {
        let Some(address) = self.address else {
            return Ok(None);
        };
        let config = ScreenConfig {
            address,
            hosts: self.hosts.clone(),
            certificate: self.certificate.clone().zip(self.key.clone()),
            setup: setup.clone(),
            bus_prefix: bus_prefix.cloned(),
            scope,
        };
        let started = Screen::start(config);
        started
            .map(Some)
            .map_err(|error| CommandError::Failed(error.to_string()))
    }
}

/// Writes the address to open.
pub(crate) fn write_screen(err: &mut dyn Write, screen: &Screen) -> std::io::Result<()> {
    match screen.watch_address() {
        Some(watch) => {
            writeln!(
                err,
                "screen: {} (this address permits operating the machine)",
                screen.address()
            )?;
            writeln!(err, "        {watch} (to watch only)")?;
        }
        None => writeln!(err, "screen: {}", screen.address())?,
    }
    if let Some(fingerprint) = screen.fingerprint() {
        writeln!(err, "        certificate, SHA-256: {fingerprint}")?;
    }
    // The QR code contains the key for operating the machine, which must not appear in a log.
    if let Some(code) = screen.code().filter(|_| std::io::stderr().is_terminal()) {
        writeln!(err, "{code}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Words {
        #[command(flatten)]
        screen: ScreenArgs,
    }

    fn parse(words: &[&str]) -> Result<ScreenArgs, clap::Error> {
        let words = std::iter::once(&"evolvent").chain(words);
        Words::try_parse_from(words).map(|words| words.screen)
    }

    #[test]
    fn a_screen_without_an_address_binds_to_loopback() {
        assert!(!parse(&[]).unwrap().is_wanted());
        let address = parse(&["--screen"]).unwrap().address.unwrap();
        assert!(address.ip().is_loopback(), "{address}");
    }

    #[test]
    fn a_certificate_comes_with_its_key_and_a_screen() {
        let (certificate, key) = ("--screen-certificate=c.pem", "--screen-key=k.pem");
        parse(&["--screen", certificate, key]).unwrap();
        for words in [["--screen", certificate], ["--screen", key], [certificate, key]] {
            parse(&words).unwrap_err();
        }
    }
}
