//! Self-signed certificates for TLS servers.

use pem::Pem;
use rcgen::{CertificateParams, PublicKeyData, SerialNumber, SignatureAlgorithm, SigningKey};
use ring::rand::SystemRandom;
use ring::signature::{ECDSA_P256_SHA256_ASN1_SIGNING, EcdsaKeyPair, KeyPair as _};

/// Bytes of a serial number (at most 20: RFC 5280, section 4.1.2.2).
const SERIAL_BYTES: usize = 16;

/// A certificate with its private key, both as PEM.
#[derive(Clone)]
pub struct SelfSigned {
    /// The certificate.
    pub certificate_pem: String,
    /// The private key, PKCS #8.
    pub key_pem: String,
}

/// Why no certificate can be made.
#[derive(Debug, thiserror::Error)]
pub enum CertificateError {
    /// A name cannot be part of a certificate, or signing failed.
    #[error(transparent)]
    Names(#[from] rcgen::Error),
    /// No key or no random number can be made.
    #[error("the system's random numbers cannot be used")]
    Random,
}

/// Makes a key for ECDSA on P-256 and a certificate for these names and addresses.
///
/// # Errors
/// A name with characters other than ASCII, or a system without random numbers.
pub fn self_signed(names: Vec<String>) -> Result<SelfSigned, CertificateError> {
    let random = SystemRandom::new();
    let pkcs8 =
        EcdsaKeyPair::generate_pkcs8(&ECDSA_P256_SHA256_ASN1_SIGNING, &random).map_err(|_| CertificateError::Random)?;
    let pair = EcdsaKeyPair::from_pkcs8(&ECDSA_P256_SHA256_ASN1_SIGNING, pkcs8.as_ref(), &random)
        .map_err(|_| CertificateError::Random)?;
    let mut serial = [0; SERIAL_BYTES];
    getrandom::fill(&mut serial).map_err(|_| CertificateError::Random)?;
    // A serial number is positive.
    serial[0] &= 0x7F;
    let mut params = CertificateParams::new(names)?;
    params.serial_number = Some(SerialNumber::from_slice(&serial));
    let certificate = params.self_signed(&Signer { pair, random })?;
    let key_pem = pem::encode(&Pem::new("PRIVATE KEY", pkcs8.as_ref()));
    Ok(SelfSigned { certificate_pem: certificate.pem(), key_pem })
}

/// A key of `ring` for `rcgen`, whose own connection to `ring` adds a parser of certificates (11 crates) to the lock file.
struct Signer {
    pair: EcdsaKeyPair,
    random: SystemRandom,
}

impl PublicKeyData for Signer {
    fn der_bytes(&self) -> &[u8] {
        self.pair.public_key().as_ref()
    }

    fn algorithm(&self) -> &'static SignatureAlgorithm {
        &rcgen::PKCS_ECDSA_P256_SHA256
    }
}

impl SigningKey for Signer {
    fn sign(&self, message: &[u8]) -> Result<Vec<u8>, rcgen::Error> {
        let signed = self.pair.sign(&self.random, message).map_err(|_| rcgen::Error::RemoteKeyError)?;
        Ok(signed.as_ref().to_vec())
    }
}
