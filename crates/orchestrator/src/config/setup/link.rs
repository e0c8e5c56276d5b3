//! How an arm is reached: the key `backend` of an arm, and its table `gateway`.

use std::time::Duration;

use pb3dp_arm_pa10::gateway_protocol::{ArmId, Dialect};
use pb3dp_arm_pa10::io::mock_server::SocketAddr;
use pb3dp_arm_pa10::io::serial::SerialConfig;
use pb3dp_arm_pa10::io::tcp::TcpConfig;
use pb3dp_arm_pa10::link::GatewayLinkConfig;
use serde::Deserialize;

use super::super::load::{Checker, whole};
use super::super::names::{FormatName, GeometryName};

/// The slowest cycle of a host that a gateway accepts, milliseconds.
pub(super) const GATEWAY_CYCLE_MAX_MILLIS: f64 = 10.0;

/// How an arm is reached.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ArmLink {
    /// Not at all: its joints are simulated where its commands come from.
    InProcess,
    /// Through a gateway.
    Gateway(GatewayLinkConfig, GatewayWay),
}

/// The way to a gateway.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GatewayWay {
    /// Gateway and servo controller are emulated byte by byte, in this program, behind a pseudo-terminal.
    Emulated,
    /// A serial port.
    Serial(SerialConfig),
    /// A TCP connection.
    Tcp(TcpConfig),
}

/// Which arm backend is wired in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum ArmBackend {
    Mock,
    Emulated,
    Serial,
    Tcp,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GatewaySection {
    arm: i64,
    dialect: DialectName,
    wire_format: FormatName,
    geometry: GeometryName,
    port: Option<String>,
    baud: Option<i64>,
    address: Option<SocketAddr>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum DialectName {
    Transparent,
    GatewayV1,
}

impl ArmBackend {
    /// How the arm is reached; `None` if something is refused. `key` is that of the arm.
    pub(super) fn link(
        self,
        gateway: Option<&GatewaySection>,
        (key, control_period_millis): (&str, f64),
        check: &mut Checker,
    ) -> Option<ArmLink> {
        match (self, gateway) {
            (Self::Mock, None) => Some(ArmLink::InProcess),
            (Self::Mock, Some(_)) => {
                check.refuse(format!("{key}.gateway: an arm with backend = \"mock\" has none; remove the table"));
                None
            }
            (_, None) => {
                check.refuse(format!("{key}.gateway: the table is missing; docs/hil.md explains it"));
                None
            }
            (way, Some(gateway)) => gateway.build(way, (key, control_period_millis), check),
        }
    }
}

impl GatewaySection {
    fn build(
        &self,
        backend: ArmBackend,
        (key, control_period_millis): (&str, f64),
        check: &mut Checker,
    ) -> Option<ArmLink> {
        check.count(&format!("{key}.gateway.arm"), self.arm, 0..=255);
        let cycle = Duration::from_secs_f64(control_period_millis * 1e-3);
        let link = GatewayLinkConfig {
            arm: ArmId(whole(self.arm)),
            dialect: match self.dialect {
                DialectName::Transparent => Dialect::Transparent,
                DialectName::GatewayV1 => Dialect::GatewayV1,
            },
            format: self.wire_format.into(),
            geometry: self.geometry.into(),
            cycle,
        };
        let way = match (backend, &self.port, self.baud, self.address) {
            (ArmBackend::Emulated, None, None, None) => GatewayWay::Emulated,
            (ArmBackend::Serial, Some(path), Some(baud), None) => {
                check.count(&format!("{key}.gateway.baud"), baud, 9600..=12_000_000);
                let (dialect, format) = (link.dialect, link.format);
                GatewayWay::Serial(SerialConfig { path: path.clone(), baud: whole(baud), dialect, format, cycle })
            }
            (ArmBackend::Tcp, None, None, Some(address)) => GatewayWay::Tcp(TcpConfig { address }),
            _ => {
                check.refuse(format!(
                    "{key}.gateway: backend = \"serial\" needs port and baud, \"tcp\" needs address, \"emulated\" none of them"
                ));
                return None;
            }
        };
        Some(ArmLink::Gateway(link, way))
    }
}
