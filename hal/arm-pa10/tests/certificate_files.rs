//! Files of a gateway's certificate: made once, the private key for its owner alone.

use std::error::Error;
use std::fs::{Permissions, read_to_string, set_permissions, write};
use std::os::unix::fs::PermissionsExt;

use pb3dp_arm_pa10::arm::{CertificateFileError, GatewayIdentity, PinnedCertificate, write_new_certificate};
use pb3dp_hal_platform::key_file::KeyFileError;

#[test]
fn a_private_key_that_others_can_read_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("arm1.crt");
    let key = write_new_certificate(&file).unwrap();
    assert_eq!(key, folder.path().join("arm1.tls.key"));
    GatewayIdentity::read(&file, &key).unwrap();
    PinnedCertificate::read(&file).unwrap();
    for mode in [0o644, 0o640, 0o604, 0o700] {
        set_permissions(&key, Permissions::from_mode(mode)).unwrap();
        let error = GatewayIdentity::read(&file, &key).unwrap_err();
        assert!(matches!(error, CertificateFileError::Key(KeyFileError::Mode { .. })), "{error}");
        assert!(error.to_string().contains("arm1.tls.key: its mode is"), "{error}");
    }
    set_permissions(&key, Permissions::from_mode(0o400)).unwrap();
    GatewayIdentity::read(&file, &key).unwrap();
}

#[test]
fn existing_files_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("arm1.crt");
    let key = write_new_certificate(&file).unwrap();
    let texts = || (read_to_string(&file).unwrap(), read_to_string(&key).unwrap());
    let before = texts();
    let error = write_new_certificate(&file).unwrap_err().to_string();
    assert!(error.contains("an existing file is never overwritten"), "{error}");
    let other = folder.path().join("arm2.crt");
    write(folder.path().join("arm2.tls.key"), "mine").unwrap();
    assert!(write_new_certificate(&other).unwrap_err().to_string().contains("never overwritten"));
    assert!(!other.exists(), "a certificate without its private key");
    assert_eq!(texts(), before);
}

#[test]
fn what_is_no_certificate_is_refused_without_its_text() {
    let folder = tempfile::tempdir().unwrap();
    let (file, wrong) = (folder.path().join("arm1.crt"), folder.path().join("wrong"));
    let key = write_new_certificate(&file).unwrap();
    write(&wrong, "my secret text").unwrap();
    set_permissions(&wrong, Permissions::from_mode(0o600)).unwrap();
    let other = folder.path().join("other.crt");
    let other_key = write_new_certificate(&other).unwrap();
    let missing = folder.path().join("none");
    // Nobody writes into it: to wait for a writer would never end.
    let pipe = folder.path().join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for (certificate, key, expected) in [
        (&wrong, &key, "holds no certificate as PEM"),
        (&key, &key, "holds no certificate as PEM"),
        (&file, &wrong, "holds no private key as PEM"),
        (&file, &file, "arm1.crt"),
        (&file, &other_key, "cannot be used with its private key"),
        (&missing, &key, "certificate"),
        (&pipe, &key, "not a regular file"),
        (&file, &missing, "key file"),
    ] {
        let error = GatewayIdentity::read(certificate, key).unwrap_err();
        let source = error.source().map(ToString::to_string).unwrap_or_default();
        let text = format!("{error}: {source}");
        assert!(text.contains(expected) && !text.contains("secret text") && !text.contains("PRIVATE"), "{text}");
    }
    assert!(PinnedCertificate::read(&wrong).unwrap_err().to_string().contains("pb3dp gateway certificate FILE"));
}
