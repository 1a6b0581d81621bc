//! Encrypted connections: a given certificate, or a generated one.

use std::fs;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use rcgen::{
    CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, KeyPair, KeyUsagePurpose,
};
use time::OffsetDateTime;

use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{ServerConfig, SupportedCipherSuite};

use crate::config::{ScreenConfig, ScreenError};

const DAY_S: i64 = 86_400;
/// Validity of a generated certificate, days. Browsers reject more than 398 days (CA/Browser Forum, Baseline
/// Requirements 6.3.2, before March 2026); the first and last day count.
const VALID_DAYS: i64 = 396;
/// Days by which the validity begins before the certificate is generated, because clocks of other computers
/// differ.
const BEFORE_DAYS: i64 = 1;
/// A start with fewer days left generates another certificate.
const LEFT_DAYS: i64 = 30;

/// The encryption of connections.
pub(crate) struct Encryption {
    pub(crate) acceptor: TlsAcceptor,
    /// SHA-256 of the certificate, as browsers show it, for the operator to compare.
    pub(crate) fingerprint: String,
}

/// The given certificate or, unless the address is loopback, the generated one.
pub(crate) fn encryption(
    config: &ScreenConfig,
    state_folder: Option<&Path>,
    is_remote: bool,
    names: &[String],
) -> Result<Option<Encryption>, ScreenError> {
    if let Some((certificate, key)) = &config.certificate {
        return acceptor(certificate, key).map(Some);
    }
    if !is_remote {
        return Ok(None);
    }
    let folder = state_folder.ok_or(ScreenError::NoCertificate)?.join("screen");
    let now_s = SystemTime::now().duration_since(UNIX_EPOCH);
    let now_s = now_s.map_or(0, |since| since.as_secs().cast_signed());
    let (certificate, key) = own_certificate(&folder, &config.setup.machine.name, names, now_s)?;
    acceptor(&certificate, &key).map(Some)
}

/// Reads a certificate chain and its key.
fn acceptor(certificate: &Path, key: &Path) -> Result<Encryption, ScreenError> {
    let fault = |file: &Path, cause: String| ScreenError::Certificate {
        file: file.display().to_string(),
        cause,
    };
    let chain: Result<Vec<CertificateDer<'static>>, _> =
        CertificateDer::pem_file_iter(certificate).and_then(Iterator::collect);
    let chain = chain.map_err(|error| fault(certificate, error.to_string()))?;
    let first = chain
        .first()
        .ok_or_else(|| fault(certificate, "it has no certificate".to_owned()))?;
    let fingerprint = fingerprint(first);
    let private = PrivateKeyDer::from_pem_file(key).map_err(|error| fault(key, error.to_string()))?;
    let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| fault(certificate, error.to_string()))?
        .with_no_client_auth()
        .with_single_cert(chain, private)
        .map_err(|error| fault(certificate, error.to_string()))?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(Encryption {
        acceptor: TlsAcceptor::from(Arc::new(config)),
        fingerprint,
    })
}

/// SHA-256 of a certificate, two digits each.
fn fingerprint(certificate: &CertificateDer<'_>) -> String {
    let SupportedCipherSuite::Tls13(suite) = ring::cipher_suite::TLS13_AES_128_GCM_SHA256 else {
        return String::new();
    };
    let digest = suite.common.hash_provider.hash(certificate);
    let digits: Vec<String> = digest.as_ref().iter().map(|byte| format!("{byte:02X}")).collect();
    digits.join(":")
}

/// The generated certificate. It is kept so that a browser has to accept it only once, and generated again
/// for other names and before it expires.
fn own_certificate(
    folder: &Path,
    machine: &str,
    names: &[String],
    now_s: i64,
) -> Result<(PathBuf, PathBuf), ScreenError> {
    let (certificate, key) = (folder.join("certificate.pem"), folder.join("key.pem"));
    let made_for = folder.join("made-for");
    let kept = fs::read_to_string(&made_for).unwrap_or_default();
    if certificate.is_file() && key.is_file() && is_for(&kept, machine, names, now_s) {
        return Ok((certificate, key));
    }
    let begin_s = now_s - BEFORE_DAYS * DAY_S;
    let end_s = begin_s + VALID_DAYS * DAY_S;
    let fault = |cause: &dyn std::fmt::Display| ScreenError::Certificate {
        file: certificate.display().to_string(),
        cause: cause.to_string(),
    };
    let mut params = CertificateParams::new(names).map_err(|error| fault(&error))?;
    params.distinguished_name = DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, machine);
    params.not_before = OffsetDateTime::from_unix_timestamp(begin_s).map_err(|error| fault(&error))?;
    params.not_after = OffsetDateTime::from_unix_timestamp(end_s).map_err(|error| fault(&error))?;
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    let pair = KeyPair::generate().map_err(|error| fault(&error))?;
    let made = params.self_signed(&pair).map_err(|error| fault(&error))?;
    fs::create_dir_all(folder)?;
    // Without this file, an incomplete certificate is not used.
    let _none = fs::remove_file(&made_for);
    write_private(&key, &pair.serialize_pem())?;
    fs::write(&certificate, made.pem())?;
    fs::write(&made_for, note(end_s, machine, names))?;
    Ok((certificate, key))
}

/// The properties of a generated certificate: its end in seconds since 1970, the machine, the names.
fn note(end_s: i64, machine: &str, names: &[String]) -> String {
    format!("{end_s}\n{machine}\n{}", names.join("\n"))
}

fn is_for(kept: &str, machine: &str, names: &[String], now_s: i64) -> bool {
    let end_s = kept.lines().next().and_then(|line| line.parse().ok());
    end_s.is_some_and(|end_s: i64| {
        let left_s = end_s - now_s;
        // If the clock was set back, the certificate begins in the future.
        kept == note(end_s, machine, names) && (LEFT_DAYS * DAY_S..=VALID_DAYS * DAY_S).contains(&left_s)
    })
}

/// Writes a file that only its owner can read, as a whole or not at all.
fn write_private(file: &Path, text: &str) -> std::io::Result<()> {
    let part = file.with_extension("part");
    let _remains = fs::remove_file(&part);
    let mut opened = fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(&part)?;
    opened.write_all(text.as_bytes())?;
    opened.sync_all()?;
    fs::rename(part, file)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A day of 2026.
    const NOW_S: i64 = 1_790_000_000;

    fn names() -> Vec<String> {
        vec![
            "mill-3axis".to_owned(),
            "shop-pc.local".to_owned(),
            "192.168.0.5".to_owned(),
        ]
    }

    /// What OpenSSL reads from a certificate; `None` without OpenSSL.
    fn openssl(certificate: &Path, options: &[&str]) -> Option<String> {
        let mut command = std::process::Command::new("openssl");
        let output = command
            .args(["x509", "-noout", "-in"])
            .arg(certificate)
            .args(options)
            .output();
        output
            .ok()
            .map(|output| String::from_utf8(output.stdout).unwrap())
    }

    #[test]
    fn a_certificate_has_machine_name_usage_and_expiry() {
        let folder = tempfile::tempdir().unwrap();
        let (certificate, key) = own_certificate(folder.path(), "mill-3axis", &names(), NOW_S).unwrap();
        let encryption = acceptor(&certificate, &key).unwrap();
        let Some(text) = openssl(&certificate, &["-text"]) else {
            return;
        };
        assert!(
            text.contains("Subject: CN = mill-3axis") || text.contains("Subject: CN=mill-3axis"),
            "{text}"
        );
        assert!(
            text.contains("DNS:mill-3axis, DNS:shop-pc.local, IP Address:192.168.0.5"),
            "{text}"
        );
        assert!(text.contains("TLS Web Server Authentication"), "{text}");
        // In seconds, so that no calendar is needed here.
        let date = |option| {
            let line = openssl(&certificate, &[option, "-dateopt", "iso_8601"]).unwrap();
            let mut command = std::process::Command::new("date");
            let date = line.trim().split_once('=').unwrap().1.to_owned();
            let output = command.args(["+%s", "--date", &date]).output().unwrap();
            String::from_utf8(output.stdout)
                .unwrap()
                .trim()
                .parse::<i64>()
                .unwrap()
        };
        let (begin_s, end_s) = (date("-startdate"), date("-enddate"));
        assert_eq!(begin_s, NOW_S - DAY_S);
        assert!(end_s - begin_s <= 397 * DAY_S, "{begin_s} to {end_s}");
        let line = openssl(&certificate, &["-fingerprint", "-sha256"]).unwrap();
        assert_eq!(line.trim().split_once('=').unwrap().1, encryption.fingerprint);
    }

    #[test]
    fn a_certificate_is_renewed_thirty_days_before_expiry() {
        let folder = tempfile::tempdir().unwrap();
        let text = |machine: &str, names: &[String], day: i64| {
            let made = own_certificate(folder.path(), machine, names, NOW_S + day * DAY_S).unwrap();
            fs::read_to_string(made.0).unwrap()
        };
        let first = text("mill", &names(), 0);
        let last_day = VALID_DAYS - BEFORE_DAYS - LEFT_DAYS;
        assert_eq!(text("mill", &names(), last_day), first);
        let second = text("mill", &names(), last_day + 1);
        assert_ne!(second, first);
        assert_eq!(text("mill", &names(), last_day + 2), second);
        let third = text("mill", &names()[1..], last_day + 2);
        assert_ne!(third, second);
        assert_ne!(text("lathe", &names()[1..], last_day + 2), third);
        // The clock was wrong when it was made.
        let ahead = text("lathe", &names(), 1000);
        assert_ne!(text("lathe", &names(), 0), ahead);
        // A file of an earlier version, without an end.
        fs::write(folder.path().join("made-for"), names().join("\n")).unwrap();
        let before = fs::read_to_string(folder.path().join("certificate.pem")).unwrap();
        assert_ne!(text("lathe", &names(), 0), before);
    }
}
