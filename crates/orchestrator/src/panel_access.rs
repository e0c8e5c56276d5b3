//! Who may use the panel: this computer alone, or others with a token and encryption.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use pb3dp_cell::terminal::print_line;
use pb3dp_hal_platform::key_file::read_key;
use pb3dp_panel::{Certificate, Panel, PanelAddress, PanelConfig, Protection, TlsFiles};
use pb3dp_record::text_file::read_text;

/// Address of the panel: this computer only.
pub const PANEL_ADDRESS: &str = "127.0.0.1:8087";

/// Fewest random bytes of a token; nobody guesses 128 bits.
const TOKEN_BYTES_MIN: usize = 16;

/// Options of a panel that other computers may use.
#[derive(Clone, Debug, Default, Args)]
pub struct PanelAccess {
    /// Encrypts the panel and lets only those in who know the token in this file, which `pb3dp gateway key FILE` makes; needed for an
    /// address that other computers reach.
    #[arg(long = "panel-token", value_name = "FILE", help_heading = "Panel for other computers")]
    token: Option<PathBuf>,
    /// Certificate chain as PEM; default: one is made at the start, and its fingerprint is printed.
    #[arg(long = "panel-certificate", value_name = "FILE", requires_all = ["token", "key"], help_heading = "Panel for other computers")]
    certificate: Option<PathBuf>,
    /// Private key of the certificate as PEM, without a password.
    #[arg(
        long = "panel-key",
        value_name = "FILE",
        requires = "certificate",
        help_heading = "Panel for other computers"
    )]
    key: Option<PathBuf>,
    /// Host name by which browsers open the panel; may be repeated. IP addresses and localhost need none.
    #[arg(long = "panel-host", value_name = "NAME", requires = "token", help_heading = "Panel for other computers")]
    hosts: Vec<String>,
}

impl PanelAccess {
    /// A configuration with this access.
    ///
    /// # Errors
    /// A file that cannot be read, or a token file that others can read.
    pub fn config(&self, address: PanelAddress) -> Result<PanelConfig> {
        let mut config = PanelConfig::at(address);
        if let Some(token) = &self.token {
            config.protection = Some(Protection {
                token: read_token(token)?,
                certificate: self.certificate()?,
                host_names: self.hosts.clone(),
            });
        }
        Ok(config)
    }

    fn certificate(&self) -> Result<Certificate> {
        let (Some(certificate), Some(key)) = (&self.certificate, &self.key) else { return Ok(Certificate::Own) };
        let read = |option, file: &Path| {
            read_text(file).with_context(|| format!("{option} {}: cannot be read", file.display()))
        };
        let (certificate_pem, key_pem) = (read("--panel-certificate", certificate)?, read("--panel-key", key)?);
        Ok(Certificate::Given(TlsFiles { certificate_pem, key_pem }))
    }
}

/// The token is the text of a key file: hexadecimal digits.
fn read_token(file: &Path) -> Result<String> {
    let key = read_key(file, TOKEN_BYTES_MIN).context("--panel-token")?;
    Ok(key.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Tells where the panel is, and how its certificate is recognised.
///
/// # Errors
/// If the terminal is gone.
pub fn announce(panel: &Panel, purpose: &str) -> Result<()> {
    print_line(&format!("{} {purpose}", panel.url()))?;
    if let Some(fingerprint) = panel.fingerprint() {
        print_line(&format!("SHA-256 fingerprint of its certificate; compare it in the browser: {fingerprint}"))?;
    }
    Ok(())
}

/// An address with port, or a port of this computer.
///
/// # Errors
/// What else it is, with an example.
pub fn parse_address(text: &str) -> Result<PanelAddress, String> {
    let with_address = match text.parse::<u16>() {
        Ok(port) => format!("127.0.0.1:{port}"),
        Err(_) => text.replacen("localhost:", "127.0.0.1:", 1),
    };
    with_address
        .parse()
        .map_err(|_| format!("{text:?} is no address with a port; for instance {PANEL_ADDRESS}, or only a port: 9000"))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use pb3dp_hal_platform::key_file::write_new_key;

    use std::fs;

    use super::*;

    #[test]
    fn a_port_alone_is_of_this_computer() {
        for (text, address) in [
            ("9000", "127.0.0.1:9000"),
            ("0", "127.0.0.1:0"),
            ("localhost:81", "127.0.0.1:81"),
            ("10.0.0.7:8087", "10.0.0.7:8087"),
            ("[::1]:8087", "[::1]:8087"),
        ] {
            assert_eq!(parse_address(text).map(|address| address.to_string()), Ok(address.to_owned()));
        }
        for wrong in ["", "70000", "here:80", "10.0.0.7", ":80"] {
            let error = parse_address(wrong).unwrap_err();
            assert!(error.contains(&format!("{wrong:?}")) && error.contains("127.0.0.1:8087"), "{error}");
        }
    }

    #[test]
    fn a_token_that_others_can_read_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let token = folder.path().join("token");
        let access = PanelAccess { token: Some(token.clone()), ..PanelAccess::default() };
        let refused = || format!("{:#}", access.config(parse_address("0").unwrap()).err().unwrap());
        assert!(refused().contains("--panel-token: key file") && refused().contains("cannot be read"), "{}", refused());
        write_new_key(&token).unwrap();
        fs::set_permissions(&token, fs::Permissions::from_mode(0o640)).unwrap();
        assert!(refused().contains("its mode is 0640"), "{}", refused());
        fs::set_permissions(&token, fs::Permissions::from_mode(0o600)).unwrap();
        let config = access.config(parse_address("0").unwrap()).unwrap();
        assert_eq!(config.protection.unwrap().token, fs::read_to_string(&token).unwrap().trim());
    }
}
