//! Needs of a rig: in general, or of one configuration.

use std::path::{Path, PathBuf};
use std::time::Duration;

use pb3dp_arm_pa10::arm::REALTIME;
use pb3dp_arm_pa10_protocol::places::BusTarget;
use pb3dp_camera_settings::CameraName;
use pb3dp_commissioning::gateway::file::{HostPlace, read_gateway};
use pb3dp_commissioning::gateway::read_access;
use pb3dp_geometry::ImageSize;
use pb3dp_setup::layers::SetupArgs;
use pb3dp_setup::load::{ConfigError, FileKind, kind_of};
use pb3dp_setup::setup::{
    ArmLink, GatewayWay, Pace, RealCameras, Setup, is_for_cameras_only, read_cameras, read_layers,
};
use pb3dp_wiring::check_key_files;

/// Needs.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Needs {
    /// Purpose, as the end of a sentence.
    pub(super) source: String,
    /// Whether this is the computer of a gateway.
    pub(super) is_gateway: bool,
    /// Highest requested SCHED_FIFO priority.
    pub(super) priority: u8,
    /// Whether real-time scheduling is required.
    pub(super) needs_realtime: bool,
    /// Serial ports by name; `None`: all existing ports are checked.
    pub(super) serial: Option<Vec<String>>,
    /// Keys of the arms' signals that nothing notices; `None` without an arm that has signals.
    pub(super) unknown_signals: Option<Vec<String>>,
    /// What is wrong with the keys of TCP lines; `None` without such a line.
    pub(super) keys: Option<Result<(), String>>,
    /// What is wrong with the sockets of lines on this computer; `None` without such a line.
    pub(super) sockets: Option<Result<(), String>>,
    /// ARCNET interfaces.
    pub(super) arcnet: Vec<String>,
    /// Needed cameras of this computer.
    pub(super) cameras: Cameras,
    /// Statement of the calibration, if no cameras were measured for it.
    pub(super) nominal_calibration: Option<String>,
    /// Folder for recordings; `None` without recordings.
    pub(super) recordings: Option<PathBuf>,
    /// Maximum data rate of a recording, bytes per second.
    pub(super) recording_bytes_per_s: f64,
}

/// Cameras of this computer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Cameras {
    /// None: they are simulated, or this is the computer of a gateway.
    NotNeeded,
    /// Unknown; all existing cameras are checked.
    Perhaps,
    /// These, left and right.
    These([CameraName; 2]),
    /// One device with both views.
    One(CameraName),
}

impl Cameras {
    fn of(cameras: &RealCameras) -> Self {
        if cameras.stereo.layout.is_one_device() {
            return Self::One(cameras.stereo.left.name.clone());
        }
        Self::These([&cameras.stereo.left, &cameras.stereo.right].map(|side| side.name.clone()))
    }
}

/// Data rate of pairs with three bytes per pixel.
fn bytes_per_s(size: ImageSize, period: Duration) -> f64 {
    2.0 * 3.0 * f64::from(size.width) * f64::from(size.height) / period.as_secs_f64().max(1e-3)
}

/// Two images of 640 x 480 pixels, three bytes each, 30 times per second.
const DEFAULT_BYTES_PER_S: f64 = 2.0 * 640.0 * 480.0 * 3.0 * 30.0;

impl Needs {
    /// Needs of an unknown rig.
    pub(super) fn general(recordings: PathBuf) -> Self {
        Self {
            source: "a rig in general (--config checks a setup)".to_owned(),
            is_gateway: false,
            priority: REALTIME.priority.unwrap_or(1),
            needs_realtime: false,
            serial: None,
            unknown_signals: None,
            keys: None,
            sockets: None,
            arcnet: Vec::new(),
            cameras: Cameras::Perhaps,
            nominal_calibration: None,
            recordings: Some(recordings),
            recording_bytes_per_s: DEFAULT_BYTES_PER_S,
        }
    }

    /// Needs of a configuration file: a setup or a gateway.
    ///
    /// # Errors
    /// As for the configuration.
    pub(super) fn of_config(config: &SetupArgs, recordings: PathBuf) -> Result<Self, ConfigError> {
        let file = config.name();
        if file.is_file() && kind_of(file)? == Some(FileKind::Gateway) {
            return Self::of_gateway(file, recordings);
        }
        if is_for_cameras_only(config)? {
            let (cameras, _) = read_cameras(config)?;
            return Ok(Self::of_cameras(config, &cameras, recordings));
        }
        let setup = read_layers(config)?;
        Ok(Self::of_setup(config, &setup, recordings))
    }

    /// Groups of the deployment files that a user needs.
    pub(super) fn groups(&self) -> Vec<&'static str> {
        let is_wanted = |serial: &Vec<String>| !serial.is_empty();
        // Without named ports no group is required.
        let perhaps = self.needs_realtime || self.serial.is_none();
        let mut groups: Vec<_> = perhaps.then_some("realtime").into_iter().collect();
        groups.extend((self.cameras != Cameras::NotNeeded).then_some("video"));
        groups.extend(self.serial.as_ref().is_none_or(is_wanted).then_some("dialout"));
        groups
    }

    /// Needs of cameras without arms.
    fn of_cameras(config: &SetupArgs, cameras: &RealCameras, recordings: PathBuf) -> Self {
        let calibration = cameras.calibration();
        Self {
            nominal_calibration: calibration
                .map_or_else(|error| Some(format!("{error:#}")), |found| found.not_measured),
            source: format!("{config} (pb3dp cameras)"),
            serial: Some(Vec::new()),
            cameras: Cameras::of(cameras),
            recording_bytes_per_s: bytes_per_s(cameras.size(), cameras.period()),
            ..Self::general(recordings)
        }
    }

    fn of_setup(config: &SetupArgs, setup: &Setup, recordings: PathBuf) -> Self {
        let (mut serial, mut has_tcp, mut sockets) = (Vec::new(), false, None);
        for link in [&setup.rig.arms.vs.link, &setup.rig.arms.tc.link] {
            match link {
                ArmLink::Gateway(_, GatewayWay::Serial { path, .. }) => serial.push(path.clone()),
                ArmLink::Gateway(_, GatewayWay::Tcp { .. }) => has_tcp = true,
                ArmLink::Gateway(_, GatewayWay::Local(local)) => {
                    let checked = local.check_for_host().map_err(|why| why.to_string());
                    sockets = Some(sockets.unwrap_or(Ok(())).and(checked));
                }
                ArmLink::InProcess | ArmLink::Gateway(_, GatewayWay::Emulated) => {}
            }
        }
        let arms = [&setup.rig.arms.vs, &setup.rig.arms.tc];
        let has_signals = arms.iter().any(|arm| arm.link.signals().is_some());
        let unknown = arms.iter().filter_map(|arm| arm.check_signals().err()).flat_map(|unknown| unknown.keys);
        Self {
            unknown_signals: has_signals.then(|| unknown.collect()),
            source: format!("{config} (pb3dp run)"),
            needs_realtime: setup.pace == Pace::Live
                && !(setup.rig.arms.vs.link.is_toy() && setup.rig.arms.tc.link.is_toy()),
            serial: Some(serial),
            keys: has_tcp.then(|| in_one_line(check_key_files(setup))),
            sockets,
            cameras: setup.rig.real_cameras.as_ref().map_or(Cameras::NotNeeded, Cameras::of),
            nominal_calibration: setup.rig.nominal_calibration.clone(),
            recording_bytes_per_s: bytes_per_s(setup.rig.stereo.left().size(), setup.rig.frames.period),
            ..Self::general(recordings)
        }
    }

    fn of_gateway(file: &Path, recordings: PathBuf) -> Result<Self, ConfigError> {
        let gateway = read_gateway(file, None, None)?;
        let general = Self::general(recordings);
        let general = Self { serial: Some(Vec::new()), ..general };
        let general = match &gateway.host {
            HostPlace::Serial(path) => Self { serial: Some(vec![path.clone()]), ..general },
            HostPlace::Local(local) => {
                Self { sockets: Some(local.check_for_gateway().map_err(|why| why.to_string())), ..general }
            }
            HostPlace::Tcp(_) => Self { keys: Some(in_one_line(read_access(&gateway.access).map(drop))), ..general },
        };
        let unknown = gateway.gateway.signals.unknown().map(|signal| format!("arm.signals.{}", signal.key()));
        Ok(Self {
            unknown_signals: Some(unknown.collect()),
            source: format!("{} (pb3dp gateway)", file.display()),
            is_gateway: true,
            priority: gateway.realtime.priority.unwrap_or(general.priority),
            needs_realtime: true,
            arcnet: interface(&gateway.bus).into_iter().collect(),
            cameras: Cameras::NotNeeded,
            recordings: None,
            ..general
        })
    }
}

fn in_one_line(checked: anyhow::Result<()>) -> Result<(), String> {
    checked.map_err(|error| format!("{error:#}"))
}

fn interface(target: &BusTarget) -> Option<String> {
    match target {
        BusTarget::Arcnet(name) => Some(name.clone()),
        BusTarget::Socket(_) => None,
    }
}
