//! Configuration file of `pb3dp gateway`.

use pb3dp_arm_pa10_gateway::gateway::GatewayConfig;
use pb3dp_arm_pa10_protocol::codec::{SequenceModulus, Supervision, TorqueScale, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Firmware};
use pb3dp_arm_pa10_protocol::places::BusTarget;
use pb3dp_arm_pa10_protocol::watchdog::CommandWatchdog;
use pb3dp_hal_platform::realtime::Realtime;
use pb3dp_hal_platform::tcp::TcpConfig;
use serde::Deserialize;
// Addresses as numbers: nothing here uses the network.
use core::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use pb3dp_setup::load::{Checker, ConfigError, ConfigFile, FileKind, whole};
use pb3dp_setup::names::{FormatName, GeometryName, sequence_modulus};

/// A gateway configuration with all values checked.
#[derive(Clone, Debug)]
pub struct GatewaySetup {
    /// Configuration of the gateway core.
    pub gateway: GatewayConfig,
    /// Real-time settings of the cycle thread.
    pub realtime: Realtime,
    /// Bus of the controller.
    pub bus: BusTarget,
    /// Host line.
    pub host: HostPlace,
    /// Rate of a serial line, bits per second.
    pub baud: u32,
    /// Who may connect by TCP.
    pub access: AccessPlace,
}

/// Who may connect by TCP, and where the key is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccessPlace {
    /// File of the key that the gateway shares with its hosts.
    pub key_file: PathBuf,
    /// Addresses of the hosts.
    pub peers: Vec<IpAddr>,
}

/// Host line of a gateway.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HostPlace {
    /// A serial port.
    Serial(String),
    /// An address to listen at.
    Tcp(TcpConfig),
}

impl std::str::FromStr for HostPlace {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refused =
            || format!("{text:?} is not a host line: use serial:DEVICE or tcp:ADDRESS:PORT (numbers, no names)");
        match text.split_once(':') {
            Some(("serial", device)) if !device.is_empty() => Ok(Self::Serial(device.to_owned())),
            Some(("tcp", address)) => {
                address.parse().map(|address| Self::Tcp(TcpConfig { address })).map_err(|_| refused())
            }
            _ => Err(refused()),
        }
    }
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct GatewayFile {
    arm: ArmSection,
    bus: BusSection,
    host: HostSection,
    access: AccessSection,
    realtime: RealtimeSection,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmSection {
    number: i64,
    format: FormatName,
    geometry: GeometryName,
    brake_millis: f64,
    emergency_stop_bits: i64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct BusSection {
    port: String,
    cycle_millis: f64,
    lateness_allowed_millis: f64,
    sequence_numbers: i64,
    controller_time_out_millis: f64,
    supervise_other_axes: bool,
    supervise_dead_man: bool,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct HostSection {
    line: String,
    baud: i64,
    ramp_after_millis: f64,
    stop_after_millis: f64,
    interpolate: bool,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct AccessSection {
    key_file: PathBuf,
    peers: Vec<String>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RealtimeSection {
    priority: i64,
    lock_memory: bool,
    processor: i64,
}

/// Reads and checks the configuration file of a gateway. `bus` and `host` override its values.
///
/// # Errors
/// An unreadable file, unknown or missing keys, values out of range; the error names file, key and allowed range.
pub fn read_gateway(file: &Path, bus: Option<&str>, host: Option<&str>) -> Result<GatewaySetup, ConfigError> {
    let config = ConfigFile::read(file, FileKind::Gateway)?;
    let mut check = Checker::default();
    let setup = config.all().and_then(|mut raw: GatewayFile| {
        raw.bus.port = bus.map_or(raw.bus.port, str::to_owned);
        raw.host.line = host.map_or(raw.host.line, str::to_owned);
        raw.build(file.parent().unwrap_or(Path::new(".")), &mut check)
    });
    config.finish(check)?;
    // Every path on which `build` returns nothing has added a refusal.
    setup.ok_or_else(|| ConfigError::Values { file: file.to_path_buf(), lines: "  the file is not complete".into() })
}

impl GatewayFile {
    fn build(&self, folder: &Path, check: &mut Checker) -> Option<GatewaySetup> {
        self.check_ranges(check);
        let modulus = sequence_modulus("bus.sequence_numbers", self.bus.sequence_numbers, check);
        let refuse = |check: &mut Checker, key: &str, why: String| check.refuse(format!("{key}: {why}"));
        let bus = self.bus.port.parse::<BusTarget>().map_err(|why| refuse(check, "bus.port", why.to_string())).ok();
        let host = self.host.line.parse::<HostPlace>().map_err(|why| refuse(check, "host.line", why)).ok();
        let access = self.access.build(folder, check);
        if !check.is_clean() {
            return None;
        }
        let watchdog = CommandWatchdog::new(millis(self.host.ramp_after_millis), millis(self.host.stop_after_millis));
        let watchdog = watchdog.map_err(|why| refuse(check, "host.stop_after_millis", why.to_string())).ok()?;
        let gateway = self.gateway(watchdog, modulus)?;
        if let Err(why) = gateway.check() {
            refuse(check, "the gateway", why.to_string());
        }
        let RealtimeSection { priority, lock_memory, processor } = self.realtime;
        let realtime = Realtime {
            priority: (priority > 0).then(|| whole(priority)),
            locks_memory: lock_memory,
            cpu: usize::try_from(processor).ok(),
        };
        Some(GatewaySetup { gateway, realtime, bus: bus?, host: host?, baud: whole(self.host.baud), access })
    }

    fn check_ranges(&self, check: &mut Checker) {
        check.count("arm.number", self.arm.number, 0..=255);
        check.number("arm.brake_millis", self.arm.brake_millis, 1.0..=5000.0);
        check.count("arm.emergency_stop_bits", self.arm.emergency_stop_bits, 0..=0xFFFF);
        check.number("bus.cycle_millis", self.bus.cycle_millis, 1.0..=10.0);
        check.number("bus.lateness_allowed_millis", self.bus.lateness_allowed_millis, 1.0..=200.0);
        check.number("bus.controller_time_out_millis", self.bus.controller_time_out_millis, 0.0..=60_000.0);
        check.count("host.baud", self.host.baud, 1200..=12_000_000);
        check.number("host.ramp_after_millis", self.host.ramp_after_millis, 20.0..=200.0);
        check.number("host.stop_after_millis", self.host.stop_after_millis, 20.0..=200.0);
        check.count("realtime.priority", self.realtime.priority, 0..=99);
        check.count("realtime.processor", self.realtime.processor, -1..=1023);
    }

    fn gateway(&self, watchdog: CommandWatchdog, modulus: SequenceModulus) -> Option<GatewayConfig> {
        let format = WireFormat::from(self.arm.format);
        let time_out = self.bus.controller_time_out_millis;
        let arm = ArmId(whole(self.arm.number));
        let supervision =
            Supervision { other_axes: self.bus.supervise_other_axes, dead_man: self.bus.supervise_dead_man };
        // Fits into 24 characters if the version has at most 10.
        let firmware = Firmware::new(concat!("pb3dp gateway ", env!("CARGO_PKG_VERSION")))?;
        Some(GatewayConfig {
            modulus,
            geometry: self.arm.geometry.into(),
            cycle: millis(self.bus.cycle_millis),
            lateness_allowed: millis(self.bus.lateness_allowed_millis),
            watchdog,
            controller_watchdog: (time_out > 0.0).then(|| millis(time_out)),
            brake_time: millis(self.arm.brake_millis),
            interpolates: self.host.interpolate,
            supervision,
            emergency_stop_bits: whole(self.arm.emergency_stop_bits),
            torque_scale: TorqueScale::of_format(format),
            ..GatewayConfig::new(arm, format, firmware)
        })
    }
}

impl AccessSection {
    fn build(&self, folder: &Path, check: &mut Checker) -> AccessPlace {
        let mut peers = Vec::new();
        for peer in &self.peers {
            match peer.parse::<IpAddr>() {
                Ok(address) => peers.push(address.to_canonical()),
                Err(_) => check.refuse(format!(
                    "access.peers: {peer:?} is not the number of a computer, for instance \"192.168.0.20\" or \"::1\"; names are not \
                     looked up"
                )),
            }
        }
        AccessPlace { key_file: folder.join(&self.key_file), peers }
    }
}

/// Milliseconds already checked to be between 0 and some minutes.
fn millis(checked: f64) -> Duration {
    Duration::from_secs_f64(checked * 1e-3)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn configs() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/gateway.toml")
    }

    #[test]
    fn the_file_that_is_shipped_is_as_the_protocol_wants_it() {
        let setup = read_gateway(&configs(), None, Some("serial:/dev/ttyUSB3")).unwrap();
        assert_eq!(setup.bus, BusTarget::Arcnet("arc0".into()));
        assert_eq!(setup.host, HostPlace::Serial("/dev/ttyUSB3".into()));
        let GatewayConfig { cycle, lateness_allowed, watchdog, brake_time, .. } = setup.gateway;
        assert_eq!((cycle, lateness_allowed, brake_time), (millis(2.0), millis(2.0), millis(200.0)));
        assert_eq!(watchdog, CommandWatchdog::default());
        assert_eq!(setup.realtime, Realtime { priority: Some(80), locks_memory: true, cpu: None });
        assert!(setup.gateway.firmware.as_str().starts_with("pb3dp gateway 0"));
    }

    #[test]
    fn what_can_not_be_is_refused_by_key() {
        let text = std::fs::read_to_string(configs()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("g.toml");
        for (from, to, expected) in [
            ("number = 1", "number = 256", "arm.number = 256: allowed are 0 to 255"),
            ("format = \"B\"", "format = \"C\"", "arm.format"),
            ("arcnet:arc0", "can0", "bus.port: \"can0\" is no bus: write arcnet:INTERFACE or socket:PATH"),
            ("tcp:127.0.0.1:4534", "tcp:localhost:4534", "numbers, no names"),
            ("sequence_numbers = 128", "sequence_numbers = 100", "bus.sequence_numbers = 100: allowed are 128 and 256"),
            ("stop_after_millis = 50.0", "stop_after_millis = 201.0", "host.stop_after_millis = 201"),
            ("stop_after_millis = 50.0", "stop_after_millis = 20.0", "host.stop_after_millis: a watchdog that slows"),
            ("lateness_allowed_millis = 2.0", "lateness_allowed_millis = 1.0", "at least one cycle"),
            ("priority = 80", "priority = 100", "realtime.priority = 100: allowed are 0 to 99"),
            ("interpolate = true", "", "host.interpolate: missing"),
            (
                "peers = [\"127.0.0.1\", \"::1\"]",
                "peers = [\"robot-pc\"]",
                "access.peers: \"robot-pc\" is not the number of a computer",
            ),
            ("key_file = \"arm1.key\"", "", "access.key_file: missing"),
            ("[realtime]", "[realtime]\nnice = 3", "realtime.nice: unknown key"),
        ] {
            assert!(text.contains(from), "{from}");
            std::fs::write(&file, text.replace(from, to)).unwrap();
            let error = read_gateway(&file, None, None).unwrap_err().to_string();
            assert!(error.contains(expected), "{expected} not in {error}");
        }
        std::fs::write(&file, text.replace("format = \"B\"", "format = \"A\"").replace("man = false", "man = true"))
            .unwrap();
        let error = read_gateway(&file, None, None).unwrap_err().to_string();
        assert!(error.contains("supervision by the controller exists in format B only"), "{error}");
    }
}
