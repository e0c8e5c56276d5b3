//! Links to an arm: the key `backend` of an arm, and its table `gateway`.

use pb3dp_arm_pa10_protocol::codec::{Signal, SignalSource, StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Geometry, HostLimits, LimitOutOfRange, check_line};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_arm_pa10_protocol::watchdog::CommandWatchdog;
use pb3dp_hal_platform::local_socket::LocalConfig;
use pb3dp_hal_platform::tcp::TcpConfig;
use pb3dp_kinematics::EffectiveLimits;
use serde::Deserialize;
use std::path::PathBuf;
use std::time::Duration;

use super::super::arm_backend::ArmBackend;
use super::super::load::{Checker, whole};
use super::super::names::{FormatName, GeometryName};

/// Longest host cycle that a gateway accepts, milliseconds.
pub(super) const GATEWAY_CYCLE_MAX_MILLIS: f64 = 10.0;

/// Link to an arm.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(clippy::large_enum_variant, reason = "a setup has two")]
pub enum ArmLink {
    /// None: the joints are simulated in the process.
    InProcess,
    /// Through a gateway.
    Gateway(GatewayLinkConfig, GatewayWay),
}

impl ArmLink {
    /// The link of an arm with these limits, which host and gateway compare.
    ///
    /// # Errors
    /// If the protocol cannot state a limit.
    pub fn limited(self, limits: &EffectiveLimits) -> Result<Self, LimitOutOfRange> {
        Ok(match self {
            Self::Gateway(link, way) => {
                Self::Gateway(GatewayLinkConfig { limits: HostLimits::of_setup(limits)?, ..link }, way)
            }
            other => other,
        })
    }

    /// Whether nothing outside this program moves: the arm is simulated or emulated.
    pub fn is_toy(&self) -> bool {
        matches!(self, Self::InProcess | Self::Gateway(_, GatewayWay::Emulated))
    }
}

/// Connection to a gateway.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GatewayWay {
    /// Gateway and servo controller are emulated byte by byte in this program, behind a pseudo-terminal.
    Emulated,
    /// A serial port.
    Serial {
        /// `/dev/ttyUSB0`; better a name in `/dev/serial/by-id`, which stays with the adapter.
        path: String,
        /// Bits per second.
        baud: u32,
    },
    /// A TCP connection, with the file of the key that the gateway shares.
    Tcp {
        /// Address of the gateway.
        tcp: TcpConfig,
        /// File of the key.
        key_file: PathBuf,
    },
    /// A socket of a gateway on this computer.
    Local(LocalConfig),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GatewaySection {
    arm: i64,
    /// In setups of earlier versions.
    #[serde(rename = "dialect")]
    _dialect: Option<DialectName>,
    wire_format: FormatName,
    geometry: GeometryName,
    port: Option<String>,
    baud: Option<i64>,
    address: Option<String>,
    key_file: Option<String>,
    socket: Option<String>,
    signals: Option<SignalsSection>,
}

/// How the signals of an arm are noticed: the table `signals` of its link, and of a gateway's arm.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignalsSection {
    emergency_stop: String,
    limit_switch: String,
    dead_man: String,
    power: String,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum DialectName {
    GatewayV1,
}

impl ArmBackend {
    fn name(self) -> &'static str {
        match self {
            Self::Mock => "mock",
            Self::Emulated => "emulated",
            Self::Serial => "serial",
            Self::Tcp => "tcp",
            Self::Local => "local",
        }
    }

    /// Shortest time for which an arm continues with its last command, milliseconds: behind a link until its driver has faded the
    /// command.
    pub(super) fn goes_on_millis(self, control_period_millis: f64) -> f64 {
        match self {
            Self::Mock => control_period_millis,
            Self::Emulated | Self::Serial | Self::Tcp | Self::Local => {
                CommandWatchdog::default().stop_after().as_secs_f64() * 1e3
            }
        }
    }

    /// The link of the arm; `None` if something is refused. `key` is the table of the arm.
    pub(super) fn link(
        self,
        gateway: Option<&GatewaySection>,
        (key, control_period_millis): (&str, f64),
        check: &mut Checker,
    ) -> Option<ArmLink> {
        match (self, gateway) {
            (Self::Mock, None) => return Some(ArmLink::InProcess),
            (Self::Mock, Some(_)) => check
                .refuse(format!("{key}.gateway: an arm with backend = \"{}\" has none; remove the table", self.name())),
            (_, None) => check.refuse(format!("{key}.gateway: missing; docs/hil.md explains it")),
            (way, Some(gateway)) => return gateway.build(way, (key, control_period_millis), check),
        }
        None
    }
}

impl ArmLink {
    /// The arm number on the link, if there is one.
    pub fn number(&self) -> Option<ArmId> {
        match self {
            Self::InProcess => None,
            Self::Gateway(link, _) => Some(link.arm),
        }
    }

    /// How the signals of the arm are noticed, if it has a link.
    pub fn signals(&self) -> Option<StatusSignals> {
        match self {
            Self::InProcess => None,
            Self::Gateway(link, _) => Some(link.signals),
        }
    }

    /// Forgets how the signals of the arm are noticed, to find it out.
    pub fn forget_signals(&mut self) {
        match self {
            Self::InProcess => {}
            Self::Gateway(link, _) => link.signals = StatusSignals::UNKNOWN,
        }
    }

    /// The wire format of the arm, if it has a link.
    pub fn format(&self) -> Option<WireFormat> {
        match self {
            Self::InProcess => None,
            Self::Gateway(link, _) => Some(link.format),
        }
    }

    /// The stated geometry of the arm, if it has a link.
    pub(super) fn geometry(&self) -> Option<Geometry> {
        match self {
            Self::InProcess => None,
            Self::Gateway(link, _) => Some(link.geometry),
        }
    }
}

impl SignalsSection {
    /// The signals of a table. Without one those of the sources, which exist for format B only.
    fn of(section: Option<&Self>, (key, format): (&str, FormatName), check: &mut Checker) -> StatusSignals {
        match (section, format) {
            (Some(section), _) => section.build(key, check),
            (None, FormatName::A) => StatusSignals::UNKNOWN,
            (None, FormatName::B) => StatusSignals::ORCA,
        }
    }

    /// The signals; `key` is the table around this one.
    pub fn build(&self, key: &str, check: &mut Checker) -> StatusSignals {
        let texts = [&self.emergency_stop, &self.limit_switch, &self.dead_man, &self.power];
        Signal::ALL.into_iter().zip(texts).fold(StatusSignals::UNKNOWN, |signals, (signal, text)| {
            let key = format!("{key}.signals.{}", signal.key());
            match text.parse() {
                Ok(SignalSource::Absent) if !signal.may_be_absent() => {
                    check.refuse(format!(
                        "{key} = \"absent\": every arm has this signal; `pb3dp arm signals` finds its bits"
                    ));
                    signals
                }
                Ok(source) => signals.with(signal, source),
                Err(why) => {
                    check.refuse(format!("{key}: {why}"));
                    signals
                }
            }
        })
    }
}

fn tcp_place(key: &str, text: &str, check: &mut Checker) -> Option<TcpConfig> {
    let address = text.parse();
    if address.is_err() {
        check.refuse(format!(
            "{key} = {text:?}: allowed are the number of a computer and a port, for instance \"192.168.0.20:4534\" or \"[::1]:4534\"; \
             names are not looked up, and \"localhost\" is \"127.0.0.1\""
        ));
    }
    address.ok().map(|address| TcpConfig { address })
}

impl ArmLink {
    /// Address of the other end, which only one arm can use, as its key and value.
    pub(super) fn place(&self) -> Option<(&'static str, String)> {
        match self {
            Self::Gateway(_, GatewayWay::Serial { path, .. }) => Some(("gateway.port", path.clone())),
            Self::Gateway(_, GatewayWay::Tcp { tcp, .. }) => Some(("gateway.address", tcp.address.to_string())),
            Self::Gateway(_, GatewayWay::Local(local)) => Some(("gateway.socket", local.path.display().to_string())),
            Self::InProcess | Self::Gateway(_, GatewayWay::Emulated) => None,
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
            format: self.wire_format.into(),
            geometry: self.geometry.into(),
            cycle,
            // Replaced by the effective limits of the arm: `ArmLink::limited`.
            limits: HostLimits::WIDEST,
            signals: match (backend, &self.signals) {
                // The emulation has these bits in both formats.
                (ArmBackend::Emulated, None) => StatusSignals::ORCA,
                (_, signals) => {
                    SignalsSection::of(signals.as_ref(), (&format!("{key}.gateway"), self.wire_format), check)
                }
            },
        };
        let tcp = self.address.as_ref().zip(self.key_file.as_ref());
        let way = match (backend, &self.port, self.baud, tcp, &self.socket) {
            (ArmBackend::Emulated, None, None, None, None) => GatewayWay::Emulated,
            (ArmBackend::Serial, Some(path), Some(baud), None, None) => {
                check.count(&format!("{key}.gateway.baud"), baud, 9600..=12_000_000);
                if let (1.., Err(why)) = (baud, check_line(whole(baud), cycle)) {
                    check.refuse(format!("{key}.gateway.baud: {why}"));
                }
                GatewayWay::Serial { path: path.clone(), baud: whole(baud) }
            }
            (ArmBackend::Local, None, None, None, Some(socket)) => {
                // Such a text is no absolute path, so it stands below the folder of its file here.
                if let Some((_, path)) = socket.split_once("/local:") {
                    let stated = format!("local:{path}");
                    check.refuse(format!("{key}.gateway.socket = {stated:?}: write the path alone, {path:?}"));
                }
                GatewayWay::Local(LocalConfig { path: socket.into() })
            }
            (ArmBackend::Tcp, None, None, Some((address, key_file)), None) => GatewayWay::Tcp {
                tcp: tcp_place(&format!("{key}.gateway.address"), address, check)?,
                key_file: key_file.into(),
            },
            _ => {
                check.refuse(format!("{key}.gateway: {}", self.wrong_place(backend)));
                return None;
            }
        };
        Some(ArmLink::Gateway(link, way))
    }

    /// Which keys of the link this backend needs, and which to add or to remove.
    fn wrong_place(&self, backend: ArmBackend) -> String {
        let (needed, needs): (&[&str], &str) = match backend {
            ArmBackend::Serial => (&["port", "baud"], "port and baud"),
            ArmBackend::Tcp => (&["address", "key_file"], "address and key_file"),
            ArmBackend::Local => (&["socket"], "socket"),
            ArmBackend::Mock | ArmBackend::Emulated => (&[], "no port, baud, address, key_file or socket"),
        };
        let stated = [
            ("port", self.port.is_some()),
            ("baud", self.baud.is_some()),
            ("address", self.address.is_some()),
            ("key_file", self.key_file.is_some()),
            ("socket", self.socket.is_some()),
        ];
        let named = |is_wrong: &dyn Fn(&str, bool) -> bool| -> Vec<&str> {
            stated.iter().filter(|(key, is_stated)| is_wrong(key, *is_stated)).map(|(key, _)| *key).collect()
        };
        let missing = named(&|key, is_stated| needed.contains(&key) && !is_stated);
        let needless = named(&|key, is_stated| !needed.contains(&key) && is_stated);
        let advice: Vec<String> = [("add", missing), ("remove", needless)]
            .into_iter()
            .filter(|(_, keys)| !keys.is_empty())
            .map(|(verb, keys)| format!("{verb} {}", keys.join(" and ")))
            .collect();
        format!("backend = \"{}\" needs {needs}: {}", backend.name(), advice.join(", "))
    }
}
