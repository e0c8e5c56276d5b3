//! `configs/rig.toml`, and what this rig differs in.

use std::error::Error;
use std::fs;
use std::path::Path;

use pb3dp_camera_settings::CameraName;
use pb3dp_camera_v4l2::controls;
use pb3dp_camera_v4l2::linux::Linux;
use pb3dp_camera_v4l2::names;

use crate::report::ensure;

/// The file as it is, and beside it the one that the program gets.
const ORIGINAL: &str = "/configs/rig.toml";
pub const HERE: &str = "/configs/here.toml";

/// Where the two cameras are.
pub const BUSES: [&str; 2] = ["platform:vivid-000", "platform:vivid-001"];

/// Controls of `vivid` by their names.
pub const LOOP: &str = "Loop Video";
pub const OSD: &str = "OSD Text Mode";
pub const STAMPS: &str = "Timestamp Source";
pub const DISCONNECT: &str = "Disconnect";

pub fn name(number: usize) -> CameraName {
    CameraName::Bus { bus: BUSES[number].to_owned(), index: None }
}

/// The number of a control.
pub fn control(name: &str) -> Result<u32, Box<dyn Error>> {
    let (_, node) = names::open(&Linux, &self::name(0))?;
    let controls = controls::controls(node.as_ref())?;
    let found = controls.iter().find(|control| control.entry.name == name);
    Ok(found.ok_or_else(|| format!("vivid has no control `{name}`"))?.entry.id)
}

/// Writes the file that the program gets. A wish that the original does not have is refused.
pub fn write() -> Result<(), Box<dyn Error>> {
    let mut text = fs::read_to_string(ORIGINAL)?;
    for (from, to) in changes(control(STAMPS)?) {
        ensure(text.contains(from), || format!("{ORIGINAL} has no `{from}`"))?;
        text = text.replace(from, &to);
    }
    Ok(fs::write(Path::new(HERE), text)?)
}

/// What is replaced by what, and why.
fn changes(stamps: u32) -> Vec<(&'static str, String)> {
    // They have neither exposure nor white balance. `vivid` stamps the end of a picture that is still to come unless it is told not to.
    let eye = format!(
        "exposure_millis = \"keep\"\nstated_exposure_millis = 0.0\ninput = 2\nfurther_controls = [{{ id = {stamps}, value = 1 }}]"
    );
    vec![
        ("bus:usb-0000:00:14.0-1", name(0).to_string()),
        ("bus:usb-0000:00:14.0-2", name(1).to_string()),
        ("exposure_millis = 4.0", eye),
        ("gain = 32", "gain = \"keep\"".to_owned()),
        ("white_balance_kelvin = 4600", "white_balance_kelvin = \"keep\"".to_owned()),
        // PAL. Even and odd lines come from one picture here.
        ("frame_rate_hz = 30.0", "interlaced = true\nframe_rate_hz = 25.0".to_owned()),
        // The target rests. Whether the arms can follow the whole way is looked at before, which takes this computer long.
        ("lead_in_s = 3.0", "lead_in_s = 60.0".to_owned()),
        ("channels = [\"x\", \"y\", \"z\", \"rx\", \"ry\", \"rz\"]", "channels = [\"z\"]".to_owned()),
        // A pair would take this computer a second.
        ("every_s = 2.0", "every_s = 60.0".to_owned()),
        // They have no common trigger: up to half a period is between them.
        ("\"hardware-trigger\"", "\"free-running\"".to_owned()),
        ("skew_max_millis = 5.0", "skew_max_millis = 30.0".to_owned()),
        ("camera_skew = { skew_millis = 5.0", "camera_skew = { skew_millis = 30.0".to_owned()),
    ]
}
