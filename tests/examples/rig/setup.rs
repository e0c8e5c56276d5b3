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

/// Bus addresses of the two cameras.
pub const BUSES: [&str; 2] = ["platform:vivid-000", "platform:vivid-001"];

/// Controls of `vivid` by their names.
pub const LOOP: &str = "Loop Video";
pub const OSD: &str = "OSD Text Mode";
pub const STAMPS: &str = "Timestamp Source";
pub const DISCONNECT: &str = "Disconnect";

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
pub fn write() -> Result<(), Box<dyn Error>> {
    Ok(fs::write(Path::new(HERE), text(control(STAMPS)?))?)
}

/// The differences from the rig, with their reasons.
fn text(stamps: u32) -> String {
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

[drift] # A pair would take this computer a second.
every_s = 60.0

[experiment] # The target rests. Whether the arms can follow the whole path is checked before, which takes this computer long.
lead_in_s = 60.0
channels = ["z"]
"#,
        left = side(0),
        right = side(1)
    )
}
