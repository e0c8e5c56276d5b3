//! `configs/rig.toml`, and the differences of this rig.

use std::error::Error;
use std::fs;
use std::path::Path;

use pb3dp_camera_settings::CameraName;
use pb3dp_camera_v4l2::controls;
use pb3dp_camera_v4l2::linux::Linux;
use pb3dp_camera_v4l2::names;

/// The configuration file of the program, next to that of the rig.
pub const HERE: &str = "/configs/here.toml";

/// Bus addresses of the cameras.
const BUSES: [&str; 2] = ["platform:vivid-000", "platform:vivid-001"];

/// Controls of `vivid` by their names.
pub const LOOP: &str = "Loop Video";
pub const OSD: &str = "OSD Text Mode";
pub const STAMPS: &str = "Timestamp Source";
pub const DISCONNECT: &str = "Disconnect";

/// The devices that deliver the two views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Devices {
    /// One per view.
    Two,
    /// One with both views side by side.
    One,
}

impl Devices {
    /// Those of a suite.
    pub fn of_suite(name: &str) -> Option<Self> {
        match name {
            "rig" => Some(Self::Two),
            "rig-one-device" => Some(Self::One),
            _ => None,
        }
    }

    /// Their bus addresses.
    pub fn buses(self) -> &'static [&'static str] {
        match self {
            Self::Two => &BUSES,
            Self::One => &BUSES[..1],
        }
    }
}

pub fn name(number: usize) -> CameraName {
    CameraName::Bus { bus: BUSES[number].to_owned(), index: None }
}

/// Identifier of a control.
pub fn control(name: &str) -> Result<u32, Box<dyn Error>> {
    let (_, node) = names::open(&Linux, &self::name(0))?;
    let controls = controls::controls(node.as_ref())?;
    let found = controls.iter().find(|control| control.entry.name == name);
    Ok(found.ok_or_else(|| format!("vivid has no control `{name}`"))?.entry.id)
}

/// Writes the configuration file of the program.
pub fn write(devices: Devices) -> Result<(), Box<dyn Error>> {
    let stamps = control(STAMPS)?;
    let camera = match devices {
        Devices::Two => two_devices(stamps),
        Devices::One => one_device(stamps),
    };
    Ok(fs::write(Path::new(HERE), camera + EXPERIMENT)?)
}

/// The differences that do not concern the cameras, with their reasons.
const EXPERIMENT: &str = r#"
[drift] # A pair would take this computer a second.
every_s = 60.0

[experiment] # The target rests. Whether the arms can follow the whole path is checked before, which takes this computer long.
lead_in_s = 60.0
channels = ["z"]
"#;

/// The differences of the cameras, with their reasons.
fn two_devices(stamps: u32) -> String {
    // They have neither exposure nor white balance. `vivid` stamps the end of an image that is still to come unless this is disabled.
    let side = |number: usize| {
        format!(
            "device = \"{}\"\nexposure_millis = \"keep\"\nstated_exposure_millis = 0.0\ngain = \"keep\"\n\
             white_balance_kelvin = \"keep\"\ninput = 2\nfurther_controls = [{{ id = {stamps}, value = 1 }}]",
            name(number)
        )
    };
    format!(
        r#"base = "rig.toml"

[camera] # PAL: even and odd lines come from one image here. There is no common trigger: up to half a period is between the cameras.
interlaced = true
frame_rate_hz = 25.0
synchronisation = "free-running"
skew_max_millis = 30.0

[camera.left]
{left}

[camera.right]
{right}

[supervisor.policies]
camera_skew.skew_millis = 30.0
"#,
        left = side(0),
        right = side(1)
    )
}

/// As above, for one device: format, size and skew stay those of the rig. Images 33.3 ms apart would have uneven times: this kernel stamps
/// them in steps of 4 ms.
fn one_device(stamps: u32) -> String {
    format!(
        r#"base = "rig.toml"
without = ["camera.right.device"]

[camera]
layout = "side-by-side"
frame_rate_hz = 25.0

[camera.left]
device = "{name}"
exposure_millis = "keep"
stated_exposure_millis = 0.0
gain = "keep"
white_balance_kelvin = "keep"
further_controls = [{{ id = {stamps}, value = 1 }}]

[camera.right] # It has the settings of the left view.
exposure_millis = "keep"
gain = "keep"
white_balance_kelvin = "keep"
"#,
        name = name(0)
    )
}
