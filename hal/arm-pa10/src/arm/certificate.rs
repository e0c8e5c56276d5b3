//! The certificate of a gateway: made, read, and pinned by its hosts.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use pb3dp_hal_platform::certificate::{CertificateError, SelfSigned, self_signed};
use pb3dp_hal_platform::key_file::{KeyFileError, open_regular, read_secret, write_new_secret};
use pb3dp_hal_platform::tcp::TcpConfig;
use pb3dp_hal_platform::transport::ByteLink;
use rustls::client::Resumption;
use rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use rustls::crypto::{CryptoProvider, WebPkiSupportedAlgorithms, ring, verify_tls13_signature};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use rustls::version::TLS13;
use rustls::{
    CertificateError as TlsCertificateError, ClientConfig, ClientConnection, DigitallySignedStruct, PeerIncompatible,
    ServerConfig, ServerConnection, SignatureScheme,
};

use super::tls::TlsLink;

/// Longest certificate file that is read.
const FILE_BYTES_MAX: u64 = 64 * 1024;

/// Name in a new certificate. Hosts compare the whole certificate and no name.
const NAME: &str = "pb3dp-gateway";

/// Why a certificate cannot be used or made.
#[derive(Debug, thiserror::Error)]
pub enum CertificateFileError {
    /// The file cannot be read.
    #[error("certificate {}: cannot be read", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The error of the system.
        #[source]
        source: std::io::Error,
    },
    /// It holds no certificate.
    #[error("certificate {}: it holds no certificate as PEM: make one with `pb3dp gateway certificate FILE`", file.display())]
    NoCertificate {
        /// The file.
        file: PathBuf,
    },
    /// The file of the private key is refused.
    #[error(transparent)]
    Key(#[from] KeyFileError),
    /// It holds no private key.
    #[error("key file {}: it holds no private key as PEM without a password", file.display())]
    NoPrivateKey {
        /// The file.
        file: PathBuf,
    },
    /// Certificate and key do not fit together, or rustls does not know their kind.
    #[error("certificate {}: it cannot be used with its private key", file.display())]
    Unusable {
        /// The file.
        file: PathBuf,
        /// The reason.
        #[source]
        source: rustls::Error,
    },
    /// A new certificate cannot be written.
    #[error("certificate {}: cannot be written; an existing file is never overwritten", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// The error of the system.
        #[source]
        source: std::io::Error,
    },
    /// No certificate can be made.
    #[error("no certificate can be made")]
    Make(#[from] CertificateError),
}

/// Certificate and private key with which a gateway opens TLS connections.
#[derive(Clone, Debug)]
pub struct GatewayIdentity(Arc<ServerConfig>);

impl GatewayIdentity {
    /// Reads a certificate and its private key, which only the user of this program may read.
    ///
    /// # Errors
    /// If a file cannot be read, others can read the key, or the two cannot be used together.
    pub fn read(certificate: &Path, key: &Path) -> Result<Self, CertificateFileError> {
        let chain = read_certificates(certificate)?;
        let no_key = |_| CertificateFileError::NoPrivateKey { file: key.to_owned() };
        let private = PrivateKeyDer::from_pem_slice(&read_secret(key)?).map_err(no_key)?;
        let mut config = ServerConfig::builder_with_provider(provider())
            .with_protocol_versions(&[&TLS13])
            .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, private))
            .map_err(|source| CertificateFileError::Unusable { file: certificate.to_owned(), source })?;
        // Every connection proves key and certificate anew.
        config.send_tls13_tickets = 0;
        Ok(Self(Arc::new(config)))
    }

    /// The side of the gateway on this link, before its handshake.
    ///
    /// # Errors
    /// If rustls cannot begin.
    pub fn accept<L: ByteLink>(&self, link: L) -> Result<TlsLink<L>, rustls::Error> {
        Ok(TlsLink::new(link, ServerConnection::new(Arc::clone(&self.0))?))
    }
}

/// The certificate that a host demands of its gateway: this one and no other. Issuer, names and dates in it do not matter.
#[derive(Clone, Debug)]
pub struct PinnedCertificate(Arc<ClientConfig>);

impl PinnedCertificate {
    /// Reads the certificate.
    ///
    /// # Errors
    /// If the file cannot be read, or holds no certificate.
    pub fn read(file: &Path) -> Result<Self, CertificateFileError> {
        let pinned = read_certificates(file)?.swap_remove(0);
        let provider = provider();
        let algorithms = provider.signature_verification_algorithms;
        let mut config = ClientConfig::builder_with_provider(provider)
            .with_protocol_versions(&[&TLS13])
            .map_err(|source| CertificateFileError::Unusable { file: file.to_owned(), source })?
            .dangerous()
            .with_custom_certificate_verifier(Arc::new(Pin { pinned, algorithms }))
            .with_no_client_auth();
        config.resumption = Resumption::disabled();
        Ok(Self(Arc::new(config)))
    }

    /// The side of the host on a link to this address, before its handshake.
    ///
    /// # Errors
    /// If rustls cannot begin.
    pub fn connect<L: ByteLink>(&self, link: L, tcp: &TcpConfig) -> Result<TlsLink<L>, rustls::Error> {
        // Not sent and not compared: rustls needs a name.
        let name = ServerName::from(tcp.address.ip());
        Ok(TlsLink::new(link, ClientConnection::new(Arc::clone(&self.0), name)?))
    }
}

/// Makes a private key and a certificate for it, in two files that must not exist. Returns the file of the private key: that of the
/// certificate with the ending `.tls.key`.
///
/// # Errors
/// If a file exists or cannot be written.
pub fn write_new_certificate(file: &Path) -> Result<PathBuf, CertificateFileError> {
    let key_file = file.with_extension("tls.key");
    let write = |source| CertificateFileError::Write { file: file.to_owned(), source };
    let SelfSigned { certificate_pem, key_pem } = self_signed(vec![NAME.to_owned()])?;
    let mut opened = File::options().write(true).create_new(true).open(file).map_err(write)?;
    write_new_secret(&key_file, key_pem.as_bytes()).inspect_err(|_| {
        // The empty file of this call: without its key it is of no use, and a second try would find it.
        let _ = std::fs::remove_file(file);
    })?;
    opened.write_all(certificate_pem.as_bytes()).and_then(|()| opened.sync_all()).map_err(write)?;
    Ok(key_file)
}

fn provider() -> Arc<CryptoProvider> {
    Arc::new(ring::default_provider())
}

/// The certificates of a file, at least one.
fn read_certificates(file: &Path) -> Result<Vec<CertificateDer<'static>>, CertificateFileError> {
    let read = |source| CertificateFileError::Read { file: file.to_owned(), source };
    let mut text = Vec::new();
    open_regular(file).and_then(|opened| opened.take(FILE_BYTES_MAX).read_to_end(&mut text)).map_err(read)?;
    let found: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&text).collect();
    found
        .ok()
        .filter(|chain| !chain.is_empty())
        .ok_or_else(|| CertificateFileError::NoCertificate { file: file.to_owned() })
}

/// Accepts one certificate.
#[derive(Debug)]
struct Pin {
    pinned: CertificateDer<'static>,
    algorithms: WebPkiSupportedAlgorithms,
}

impl ServerCertVerifier for Pin {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _name: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        // Both are public: the comparison need not take constant time.
        if end_entity.as_ref() == self.pinned.as_ref() {
            return Ok(ServerCertVerified::assertion());
        }
        Err(TlsCertificateError::ApplicationVerificationFailure.into())
    }

    fn verify_tls12_signature(
        &self,
        _message: &[u8],
        _certificate: &CertificateDer<'_>,
        _signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        Err(PeerIncompatible::ServerTlsVersionIsDisabledByOurConfig.into())
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls13_signature(message, certificate, signed, &self.algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.algorithms.supported_schemes()
    }
}
