//! Encryption of a panel that other computers can reach.

use std::sync::Arc;

use pb3dp_hal_platform::certificate::{SelfSigned, self_signed};
use rustls::ServerConfig;
use rustls::crypto::ring::default_provider;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use sha2::{Digest, Sha256};
use tokio_rustls::TlsAcceptor;

use crate::config::{Certificate, Protection, TlsFiles};
use crate::refusal::Refusal;

/// Shortest token, characters: 16 random letters and digits have more than 80 bits.
const TOKEN_MIN: usize = 16;

/// The certificate that clients see.
#[derive(Clone, Debug)]
pub struct OwnCertificate {
    /// Certificate chain, PEM.
    pub pem: String,
    /// SHA-256 of the first certificate, pairs of digits with colons.
    pub fingerprint: String,
}

/// Encryption of a panel.
pub struct Tls {
    /// Accepts connections.
    pub acceptor: TlsAcceptor,
    /// The certificate.
    pub certificate: OwnCertificate,
}

impl Tls {
    /// Reads the certificate, or makes one.
    ///
    /// # Errors
    /// A token that is too short, or a certificate or key that cannot be used.
    pub fn new(protection: &Protection) -> Result<Self, Refusal> {
        let refused = |what: String| Refusal::Protection { what };
        let length = protection.token.chars().count();
        if length < TOKEN_MIN {
            let what = format!("the token has {length} characters, at least {TOKEN_MIN} are needed: use a longer one");
            return Err(refused(what));
        }
        let files = match &protection.certificate {
            Certificate::Given(files) => files.clone(),
            Certificate::Own => own_certificate(&protection.host_names)?,
        };
        let unusable = |error: &dyn std::fmt::Display| {
            refused(format!(
                "the certificate or its key cannot be used ({error}): give both as PEM, the key without a password"
            ))
        };
        let chain: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(files.certificate_pem.as_bytes()).collect();
        let chain = chain.map_err(|error| unusable(&error))?;
        let first = chain.first().ok_or_else(|| unusable(&"no certificate in it"))?;
        let fingerprint = fingerprint(first);
        let key = PrivateKeyDer::from_pem_slice(files.key_pem.as_bytes()).map_err(|error| unusable(&error))?;
        let mut config = ServerConfig::builder_with_provider(Arc::new(default_provider()))
            .with_safe_default_protocol_versions()
            .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, key))
            .map_err(|error| unusable(&error))?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        let certificate = OwnCertificate { pem: files.certificate_pem, fingerprint };
        Ok(Self { acceptor: TlsAcceptor::from(Arc::new(config)), certificate })
    }
}

/// A new certificate for these names, localhost and its addresses.
fn own_certificate(host_names: &[String]) -> Result<TlsFiles, Refusal> {
    let always = ["localhost", "127.0.0.1", "::1"].map(str::to_owned);
    let names: Vec<String> = host_names.iter().cloned().chain(always).collect();
    let SelfSigned { certificate_pem, key_pem } = self_signed(names).map_err(|error| Refusal::Protection {
        what: format!("no certificate can be made ({error}): check the host names"),
    })?;
    Ok(TlsFiles { certificate_pem, key_pem })
}

fn fingerprint(certificate: &CertificateDer<'_>) -> String {
    let bytes = Sha256::digest(certificate.as_ref());
    bytes.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(":")
}
