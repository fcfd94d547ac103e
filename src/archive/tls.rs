//! An encrypted connection to PostgreSQL: the chain of certificates and the name of the host are verified.

use std::path::Path;
use std::sync::Arc;

use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject as _;
use rustls::{ClientConfig, RootCertStore};
use tokio_postgres_rustls::MakeRustlsConnect;

use crate::catalogue::ArchiveFinding::NotAnAddress;
use crate::diagnostic::Diagnostic;

/// Trusts the authority whose certificate is in the PEM file `root`, and no other.
pub(super) fn connector(root: &Path) -> Result<MakeRustlsConnect, Diagnostic> {
    let wrong = |why: String| {
        Diagnostic::file(&root.display().to_string(), NotAnAddress { option: "sslrootcert".into(), why })
    };
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_file_iter(root).map_err(|error| wrong(error.to_string()))? {
        let certificate = certificate.map_err(|error| wrong(error.to_string()))?;
        roots.add(certificate).map_err(|error| wrong(error.to_string()))?;
    }
    if roots.is_empty() {
        return Err(wrong("there is no certificate in it".into()));
    }
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|error| wrong(error.to_string()))?
        .with_root_certificates(roots)
        .with_no_client_auth();
    Ok(MakeRustlsConnect::new(config))
}
