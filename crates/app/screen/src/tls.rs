//! Encrypted connections: a given certificate, or a generated one.

use std::fs;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

use crate::config::{ScreenConfig, ScreenError};

/// The given certificate, or beyond loopback the generated one.
pub(crate) fn encryption(
    config: &ScreenConfig,
    state_folder: Option<&Path>,
    is_remote: bool,
    names: &[String],
) -> Result<Option<TlsAcceptor>, ScreenError> {
    if let Some((certificate, key)) = &config.certificate {
        return acceptor(certificate, key).map(Some);
    }
    if !is_remote {
        return Ok(None);
    }
    let folder = state_folder.ok_or(ScreenError::NoCertificate)?.join("screen");
    let (certificate, key) = own_certificate(&folder, names)?;
    acceptor(&certificate, &key).map(Some)
}

/// Reads a certificate chain and its key.
fn acceptor(certificate: &Path, key: &Path) -> Result<TlsAcceptor, ScreenError> {
    let fault = |file: &Path, cause: String| ScreenError::Certificate {
        file: file.display().to_string(),
        cause,
    };
    let chain: Result<Vec<CertificateDer<'static>>, _> =
        CertificateDer::pem_file_iter(certificate).and_then(Iterator::collect);
    let chain = chain.map_err(|error| fault(certificate, error.to_string()))?;
    let private = PrivateKeyDer::from_pem_file(key).map_err(|error| fault(key, error.to_string()))?;
    let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| fault(certificate, error.to_string()))?
        .with_no_client_auth()
        .with_single_cert(chain, private)
        .map_err(|error| fault(certificate, error.to_string()))?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}

/// The generated certificate, created once, so that a browser has to accept it only once; created again for
/// other names.
fn own_certificate(folder: &Path, names: &[String]) -> Result<(PathBuf, PathBuf), ScreenError> {
    let (certificate, key) = (folder.join("certificate.pem"), folder.join("key.pem"));
    let of_names = folder.join("names");
    let listed = names.join("\n");
    let is_kept = certificate.is_file()
        && key.is_file()
        && fs::read_to_string(&of_names).is_ok_and(|kept| kept == listed);
    if is_kept {
        return Ok((certificate, key));
    }
    let made = rcgen::generate_simple_self_signed(names).map_err(|error| ScreenError::Certificate {
        file: certificate.display().to_string(),
        cause: error.to_string(),
    })?;
    fs::create_dir_all(folder)?;
    write_private(&key, &made.signing_key.serialize_pem())?;
    fs::write(&certificate, made.cert.pem())?;
    fs::write(&of_names, listed)?;
    Ok((certificate, key))
}

/// A file readable only by its owner, complete or not at all.
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
