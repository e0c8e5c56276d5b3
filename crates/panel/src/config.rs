//! Configuration of the panel.

use std::fmt;
pub use std::net::SocketAddr as PanelAddress;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use pb3dp_cell::camera_controls::ControlDesk;

use crate::log_lines::LogLines;

/// Pushes the simulated target: offset in metres and angle in radians, relative to its start.
pub type Push = Arc<dyn Fn([f64; 3], f64) -> Result<(), String> + Send + Sync>;

/// Protection of a panel that other computers can reach.
#[derive(Clone)]
pub struct Protection {
    /// The token; every request must have it.
    pub token: String,
    /// The certificate.
    pub certificate: Certificate,
    /// Host names of the certificate; IP addresses and localhost are accepted anyway.
    pub host_names: Vec<String>,
}

/// Where the certificate comes from.
#[derive(Clone)]
pub enum Certificate {
    /// From files.
    Given(TlsFiles),
    /// Made at the start, for [`Protection::host_names`], localhost and its addresses; the operator compares the fingerprint.
    Own,
}

/// A certificate chain with its key.
#[derive(Clone)]
pub struct TlsFiles {
    /// Certificate chain, PEM, the own certificate first.
    pub certificate_pem: String,
    /// Private key, PEM.
    pub key_pem: String,
}

impl fmt::Debug for Protection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Protection").field("host_names", &self.host_names).finish_non_exhaustive()
    }
}

/// Configuration of the panel.
#[derive(Clone)]
pub struct PanelConfig {
    /// Address and port; port 0 takes any free one.
    pub address: SocketAddr,
    /// Motion needs a pressed button.
    pub hold_to_run: bool,
    /// Token and encryption; needed for addresses that other computers can reach.
    pub protection: Option<Protection>,
    /// Ends the run while the arms are still being enabled: `stop` sets it then.
    pub interrupt: Arc<AtomicBool>,
    /// Lines of the log.
    pub log_lines: LogLines,
    /// Pushes the simulated target, in the playground.
    pub push: Option<Push>,
    /// Controls of real cameras.
    pub cameras: Option<ControlDesk>,
}

impl PanelConfig {
    /// A panel without extras at this address.
    pub fn at(address: SocketAddr) -> Self {
        Self {
            address,
            hold_to_run: false,
            protection: None,
            interrupt: Arc::default(),
            log_lines: LogLines::default(),
            push: None,
            cameras: None,
        }
    }
}
