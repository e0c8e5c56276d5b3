//! Where the other end of a link is, and what is spoken there: settings of links. Nothing here opens anything.

use std::path::PathBuf;
use std::time::Duration;

use crate::codec::{StatusSignals, WireFormat};
use crate::gateway_protocol::{ArmId, Geometry, HostLimits};

/// Where a bus is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BusTarget {
    /// The ARCNET interface of this name: `arc0`.
    Arcnet(String),
    /// A socket in the place of a bus, at which an emulated controller listens.
    Socket(PathBuf),
}

/// Why a text names no bus.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no bus: write arcnet:INTERFACE or socket:PATH")]
pub struct NoBus(String);

impl std::str::FromStr for BusTarget {
    type Err = NoBus;

    /// `arcnet:INTERFACE` or `socket:PATH`.
    fn from_str(text: &str) -> Result<Self, NoBus> {
        match text.split_once(':') {
            Some(("arcnet", interface)) if !interface.is_empty() => Ok(Self::Arcnet(interface.to_owned())),
            Some(("socket", path)) if !path.is_empty() => Ok(Self::Socket(PathBuf::from(path))),
            _ => Err(NoBus(text.to_owned())),
        }
    }
}

impl std::fmt::Display for BusTarget {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Arcnet(interface) => write!(f, "ARCNET interface {interface}"),
            Self::Socket(path) => write!(f, "socket {}", path.display()),
        }
    }
}

/// Settings of the link to a gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GatewayLinkConfig {
    /// The arm at the other end.
    pub arm: ArmId,
    /// The wire format of the arm. A gateway that knows another one is refused.
    pub format: WireFormat,
    /// The geometry of the arm. A gateway with another geometry is refused.
    pub geometry: Geometry,
    /// Time between two commands.
    pub cycle: Duration,
    /// Motion limits of the host. A gateway that allows more is refused.
    pub limits: HostLimits,
    /// How the host notices the signals of the arm. A gateway without a stated wired input is refused.
    pub signals: StatusSignals,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bus_needs_its_kind_and_its_name() {
        assert_eq!("arcnet:arc0".parse(), Ok(BusTarget::Arcnet("arc0".into())));
        assert_eq!("socket:/run/bus".parse(), Ok(BusTarget::Socket("/run/bus".into())));
        for wrong in ["", "arc0", "arcnet:", "socket:", "serial:ttyS0"] {
            assert_eq!(wrong.parse::<BusTarget>(), Err(NoBus(wrong.into())));
        }
    }
}
