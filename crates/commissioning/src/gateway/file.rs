//! Configuration file of `pb3dp gateway`.

use pb3dp_arm_pa10_gateway::gateway::{CYCLE_RANGE, GatewayConfig, GatewayConfigError, RAMP_AFTER_MIN};
use pb3dp_arm_pa10_protocol::codec::PA10_SPEED_MAX_RAD_PER_S;
use pb3dp_arm_pa10_protocol::codec::{Axis, SequenceModulus, StatusSignals, Supervision, TorqueScale, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, AxisMotion, BRAKE_TIME_MAX, Firmware, MotionLimits};
use pb3dp_arm_pa10_protocol::places::BusTarget;
use pb3dp_arm_pa10_protocol::watchdog::{CommandWatchdog, STOP_AFTER_MAX};
use pb3dp_hal_platform::local_socket::LocalConfig;
use pb3dp_hal_platform::realtime::Realtime;
use pb3dp_hal_platform::tcp::TcpConfig;
use serde::Deserialize;
// Addresses as numbers: nothing here uses the network.
use core::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use pb3dp_setup::load::{Checker, ConfigError, ConfigFile, FileKind, whole};
use pb3dp_setup::names::{FormatName, GeometryName};
use pb3dp_setup::setup::{SignalsSection, acceleration_max_rad_per_s2};

/// Largest angles that a source states for the stops of a PA-10, to either side, degrees: those of the PA10-7CE (INRIA), and beyond them
/// S2 and E1 of the PA10-6CE (University of Florida) and W2 in RobWork. A wider range in a file is a mistake.
const STOPS_MAX_DEG: [f64; Axis::COUNT] = [180.0, 124.0, 180.0, 158.0, 270.0, 180.0, 360.0];

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
    /// A socket for hosts on this computer.
    Local(LocalConfig),
}

impl std::str::FromStr for HostPlace {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refused = || {
            format!(
                "{text:?} is not a host line: use serial:DEVICE, local:PATH or tcp:ADDRESS:PORT (numbers, no names)"
            )
        };
        match text.split_once(':') {
            Some(("serial", device)) if !device.is_empty() => Ok(Self::Serial(device.to_owned())),
            Some(("local", path)) if !path.is_empty() => Ok(Self::Local(LocalConfig { path: path.into() })),
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
    limits: LimitsSection,
    realtime: RealtimeSection,
}

/// One row per axis, from the base.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LimitsSection {
    s1: LimitRow,
    s2: LimitRow,
    s3: LimitRow,
    e1: LimitRow,
    e2: LimitRow,
    w1: LimitRow,
    w2: LimitRow,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LimitRow {
    speed_max_rad_per_s: f64,
    acceleration_max_rad_per_s2: f64,
    jerk_max_rad_per_s3: f64,
    lower_deg: f64,
    upper_deg: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmSection {
    number: i64,
    format: FormatName,
    geometry: GeometryName,
    brake_millis: f64,
    signals: SignalsSection,
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
    let folder = file.parent().unwrap_or(Path::new("."));
    let setup = config.all().and_then(|mut raw: GatewayFile| {
        raw.bus.port = bus.map_or(raw.bus.port, str::to_owned);
        // As the key file, a socket in the file is relative to it.
        let line = match raw.host.line.strip_prefix("local:") {
            Some(path) if !path.is_empty() => format!("local:{}", folder.join(path).display()),
            _ => raw.host.line,
        };
        raw.host.line = host.map_or(line, str::to_owned);
        raw.build(folder, &mut check)
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
        let signals = self.arm.signals.build("arm", check);
        if !check.is_clean() {
            return None;
        }
        let watchdog = CommandWatchdog::new(millis(self.host.ramp_after_millis), millis(self.host.stop_after_millis));
        let watchdog = watchdog.map_err(|why| refuse(check, "host.stop_after_millis", why.to_string())).ok()?;
        let limits = self.limits.build().map_err(|why| refuse(check, "limits", why)).ok()?;
        let gateway = self.gateway((watchdog, modulus), limits, signals)?;
        if let Err(why) = gateway.check() {
            refuse(check, key_of(&why), why.to_string());
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
        let cycle_millis = in_millis(*CYCLE_RANGE.start())..=in_millis(*CYCLE_RANGE.end());
        let (ramp_min_millis, stop_max_millis) = (in_millis(RAMP_AFTER_MIN), in_millis(STOP_AFTER_MAX));
        check.count("arm.number", self.arm.number, 0..=255);
        check.number("arm.brake_millis", self.arm.brake_millis, 1.0..=in_millis(BRAKE_TIME_MAX));
        check.number("bus.cycle_millis", self.bus.cycle_millis, cycle_millis);
        check.number("bus.lateness_allowed_millis", self.bus.lateness_allowed_millis, 1.0..=stop_max_millis);
        check.number("bus.controller_time_out_millis", self.bus.controller_time_out_millis, 0.0..=60_000.0);
        check.count("host.baud", self.host.baud, 1200..=12_000_000);
        check.number("host.ramp_after_millis", self.host.ramp_after_millis, ramp_min_millis..=stop_max_millis);
        check.number("host.stop_after_millis", self.host.stop_after_millis, ramp_min_millis..=stop_max_millis);
        check.count("realtime.priority", self.realtime.priority, 0..=99);
        check.count("realtime.processor", self.realtime.processor, -1..=1023);
    }

    fn gateway(
        &self,
        (watchdog, modulus): (CommandWatchdog, SequenceModulus),
        limits: MotionLimits,
        signals: StatusSignals,
    ) -> Option<GatewayConfig> {
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
            signals,
            torque_scale: TorqueScale::of_format(format),
            ..GatewayConfig::new(arm, format, firmware, limits)
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

impl LimitsSection {
    fn build(&self) -> Result<MotionLimits, String> {
        let rows = [&self.s1, &self.s2, &self.s3, &self.e1, &self.e2, &self.w1, &self.w2];
        let motions = rows.map(|row| AxisMotion {
            speed_max_rad_per_s: row.speed_max_rad_per_s,
            acceleration_max_rad_per_s2: row.acceleration_max_rad_per_s2,
            jerk_max_rad_per_s3: row.jerk_max_rad_per_s3,
            range_rad: [row.lower_deg.to_radians(), row.upper_deg.to_radians()],
        });
        let limits = MotionLimits::new(&motions).map_err(|error| error.to_string())?;
        for (axis, row) in Axis::ALL.into_iter().zip(rows) {
            row.check(axis)?;
        }
        Ok(limits)
    }
}

impl LimitRow {
    /// A limit that no arm can reach would protect nobody.
    fn check(&self, axis: Axis) -> Result<(), String> {
        let (speed, acceleration) = (self.speed_max_rad_per_s, self.acceleration_max_rad_per_s2);
        let index = axis.index();
        let speed_max = PA10_SPEED_MAX_RAD_PER_S[index];
        if speed > speed_max {
            return Err(format!(
                "{axis}: a speed of {speed} rad/s is more than the drive can do: give at most {speed_max} rad/s"
            ));
        }
        let acceleration_max = acceleration_max_rad_per_s2(index);
        if acceleration > acceleration_max {
            return Err(format!(
                "{axis}: an acceleration of {acceleration} rad/s^2 is more than any setup may ask for: give at most {acceleration_max} \
                 rad/s^2"
            ));
        }
        let stop_deg = STOPS_MAX_DEG[index];
        if self.lower_deg < -stop_deg || self.upper_deg > stop_deg {
            return Err(format!(
                "{axis}: a range of {} to {} degrees goes beyond the stops of every PA-10: give at most -{stop_deg} to {stop_deg} degrees",
                self.lower_deg, self.upper_deg
            ));
        }
        Ok(())
    }
}

/// Key of the value that a gateway refuses.
fn key_of(why: &GatewayConfigError) -> &'static str {
    match why {
        GatewayConfigError::Cycle { .. } => "bus.cycle_millis",
        GatewayConfigError::Lateness { .. } => "bus.lateness_allowed_millis",
        GatewayConfigError::BrakeTime { .. } => "arm.brake_millis",
        GatewayConfigError::Watchdog { .. } => "host.ramp_after_millis",
        GatewayConfigError::Supervision => "bus.supervise_dead_man, bus.supervise_other_axes",
        GatewayConfigError::Wired { .. } | GatewayConfigError::Absent { .. } => "arm.signals",
    }
}

fn in_millis(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

/// Milliseconds already checked to be between 0 and some minutes.
fn millis(checked: f64) -> Duration {
    Duration::from_secs_f64(checked * 1e-3)
}

/// Number of messages after which sequence numbers wrap.
fn sequence_modulus(key: &str, numbers: i64, check: &mut Checker) -> SequenceModulus {
    match numbers {
        128 => SequenceModulus::Modulo128,
        256 => SequenceModulus::Modulo256,
        _ => {
            check.refuse(format!("{key} = {numbers}: allowed are 128 and 256"));
            SequenceModulus::Modulo128
        }
    }
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
            (
                "lateness_allowed_millis = 2.0",
                "lateness_allowed_millis = 1.0",
                "bus.lateness_allowed_millis: an allowed lateness of 1ms is out of range: give at least one cycle",
            ),
            ("priority = 80", "priority = 100", "realtime.priority = 100: allowed are 0 to 99"),
            ("interpolate = true", "", "host.interpolate: missing"),
            (
                "peers = [\"127.0.0.1\", \"::1\"]",
                "peers = [\"robot-pc\"]",
                "access.peers: \"robot-pc\" is not the number of a computer",
            ),
            ("key_file = \"arm1.key\"", "", "access.key_file: missing"),
            ("[realtime]", "[realtime]\nnice = 3", "realtime.nice: unknown key"),
            ("[access]", "[access]\ntls = { certificate = \"a\", key = \"b\" }", "access.tls: this key is gone"),
            ("s2 = {", "s9 = {", "limits.s2: missing"),
            ("speed_max_rad_per_s = 1.5708, ", "", "limits.w1.speed_max_rad_per_s: missing"),
            (
                "speed_max_rad_per_s = 0.25",
                "speed_max_rad_per_s = 1.01",
                "axis 1 (S1): a speed of 1.01 rad/s is more than the drive",
            ),
            (
                "jerk_max_rad_per_s3 = 80.0",
                "jerk_max_rad_per_s3 = 0.0",
                "limits: axis 1 (S1): a limit of 0 for the jerk is out of range",
            ),
            ("lower_deg = -91.0", "lower_deg = 91.0", "axis 2 (S2): a limit of 1.58"),
            (
                "upper_deg = 91.0",
                "upper_deg = 375.0",
                "axis 2 (S2): a range of -91 to 375 degrees goes beyond the stops",
            ),
            ("lower_deg = -174.0", "lower_deg = -181.0", "axis 3 (S3): a range of -181 to 174 degrees"),
            (
                "acceleration_max_rad_per_s2 = 5.0",
                "acceleration_max_rad_per_s2 = 600.0",
                "axis 5 (E2): an acceleration of 600 rad/s^2 is more than any setup may ask for: give at most 5 rad/s^2",
            ),
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

    #[test]
    fn a_socket_in_the_file_is_relative_to_it_and_one_of_the_command_line_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("gateway.toml");
        let text = std::fs::read_to_string(configs()).unwrap();
        std::fs::write(&file, text.replace("tcp:127.0.0.1:4534", "local:run/arm1.sock")).unwrap();
        let host = |line| read_gateway(&file, None, line).unwrap().host;
        assert_eq!(host(None), HostPlace::Local(LocalConfig { path: folder.path().join("run/arm1.sock") }));
        let of_command_line = HostPlace::Local(LocalConfig { path: "run/arm2.sock".into() });
        assert_eq!(host(Some("local:run/arm2.sock")), of_command_line);
    }
}
