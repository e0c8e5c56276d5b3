//! Arm poses: recorded at stops together with images, and requested poses to visit.
//!
//! A recording of stops is a folder with a `stops.toml` beside its images. At each stop both arms were stationary, a stereo pair
//! was taken, and the joint positions were read. A `poses.toml` contains the poses that an arm visits. `docs/calibration.md`
//! describes the use of both.

use std::path::Path;

use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Flange};

use super::document::{Document, Node};
use super::error::CalibrationFileError;
use super::{pose, write, write_file};

/// File name of a recording of stops.
pub const STOPS_FILE: &str = "stops.toml";

/// Required values of the keys `format`.
const STOPS_FORMAT: &str = "pb3dp stops 1";
const POSES_FORMAT: &str = "pb3dp poses 1";

/// Number of joints of an arm.
const JOINTS: usize = 7;

/// The recorded pose of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmStand {
    /// Measured joint angles, rad, from the base.
    pub joints_rad: [f64; JOINTS],
    /// Flange pose from these joint angles and the robot description.
    pub base_from_flange: Pose<Base, Flange>,
}

/// A stereo pair taken while both arms were stationary.
#[derive(Clone, Debug, PartialEq)]
pub struct Stop {
    /// The left image, relative to the folder of the file.
    pub left: String,
    /// The right image.
    pub right: String,
    /// The arm that carries the cameras.
    pub vs: ArmStand,
    /// The other arm; `None` if it was not recorded.
    pub tc: Option<ArmStand>,
}

/// A recording of stops.
#[derive(Clone, Debug, PartialEq)]
pub struct Stops {
    /// When the first image was taken, RFC 3339.
    pub date: String,
    /// The stops, in the order of recording.
    pub stops: Vec<Stop>,
}

/// The arm that poses belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmOfPoses {
    /// The arm that carries the cameras.
    Vs,
    /// The arm that carries the target or the board.
    Tc,
}

impl ArmOfPoses {
    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vs => "vs",
            Self::Tc => "tc",
        }
    }
}

/// Poses for an arm to visit.
#[derive(Clone, Debug, PartialEq)]
pub struct WantedPoses {
    /// The arm.
    pub arm: ArmOfPoses,
    /// Requested flange poses in the base frame, in the order of the visit.
    pub poses: Vec<Pose<Base, Flange>>,
}

/// Reads the `stops.toml` in a folder.
///
/// # Errors
/// An unreadable file, or one with other contents; the message names the key.
pub fn load_stops(folder: &Path) -> Result<Stops, CalibrationFileError> {
    let document = Document::read(&folder.join(STOPS_FILE))?;
    let root = document.root();
    format(&root, STOPS_FORMAT)?;
    pose::only(&root, &["format", "date", "stop"])?;
    let stops = root.get("stop")?.items()?.iter().map(stop).collect::<Result<Vec<_>, _>>()?;
    Ok(Stops { date: root.get("date")?.text()?.to_owned(), stops })
}

/// Writes the `stops.toml` into a folder.
///
/// # Errors
/// A file that cannot be written.
pub fn save_stops(folder: &Path, stops: &Stops) -> Result<(), CalibrationFileError> {
    let text = |value: &str| toml::Value::from(value).to_string();
    let mut file = format!("format = {}\ndate = {}\n", text(STOPS_FORMAT), text(&stops.date));
    for stop in &stops.stops {
        file += &format!("\n[[stop]]\nleft = {}\nright = {}\n", text(&stop.left), text(&stop.right));
        for (name, stand) in [("vs", Some(&stop.vs)), ("tc", stop.tc.as_ref())] {
            let Some(stand) = stand else { continue };
            file += &format!("\n[stop.{name}]\njoints_rad = {}\n", write::list(&stand.joints_rad));
            file += &format!("base_from_flange = {}\n", pose::inline(&stand.base_from_flange));
        }
    }
    write_file(&folder.join(STOPS_FILE), &file)
}

/// Reads poses for an arm to visit.
///
/// # Errors
/// An unreadable file, or one with other contents; the message names the key.
pub fn load_poses(file: &Path) -> Result<WantedPoses, CalibrationFileError> {
    let document = Document::read(file)?;
    let root = document.root();
    format(&root, POSES_FORMAT)?;
    pose::only(&root, &["format", "arm", "pose"])?;
    let arm = root.get("arm")?;
    let arm = match arm.text()? {
        "vs" => ArmOfPoses::Vs,
        "tc" => ArmOfPoses::Tc,
        other => return Err(arm.refuse(format!("is {other:?}, it must be vs or tc"))),
    };
    let wanted = |node: &Node<'_>| {
        pose::only(node, &["base_from_flange"])?;
        pose::read(&node.get("base_from_flange")?)
    };
    let poses = root.get("pose")?.items()?.iter().map(wanted).collect::<Result<Vec<_>, _>>()?;
    Ok(WantedPoses { arm, poses })
}

/// Writes poses for an arm to visit.
///
/// # Errors
/// A file that cannot be written.
pub fn save_poses(file: &Path, wanted: &WantedPoses) -> Result<(), CalibrationFileError> {
    let mut text = format!("format = {}\narm = \"{}\"\n", toml::Value::from(POSES_FORMAT), wanted.arm.name());
    for base_from_flange in &wanted.poses {
        text += &format!("\n[[pose]]\nbase_from_flange = {}\n", pose::inline(base_from_flange));
    }
    write_file(file, &text)
}

fn format(root: &Node<'_>, expected: &str) -> Result<(), CalibrationFileError> {
    let format = root.get("format")?;
    match format.text()? {
        text if text == expected => Ok(()),
        text => Err(format.refuse(format!("is {text:?}, it must be {expected:?}"))),
    }
}

fn stop(node: &Node<'_>) -> Result<Stop, CalibrationFileError> {
    pose::only(node, &["left", "right", "vs", "tc"])?;
    let image = |key: &str| {
        let name = node.get(key)?;
        // A recording is read wherever it is located, and reads no files outside its folder.
        let is_inside = !name.text()?.is_empty()
            && Path::new(name.text()?).components().all(|part| matches!(part, std::path::Component::Normal(_)));
        if is_inside { Ok(name.text()?.to_owned()) } else { Err(name.refuse("must be a file in or below this folder")) }
    };
    Ok(Stop {
        left: image("left")?,
        right: image("right")?,
        vs: stand(&node.get("vs")?)?,
        tc: node.find("tc").map(|node| stand(&node)).transpose()?,
    })
}

fn stand(node: &Node<'_>) -> Result<ArmStand, CalibrationFileError> {
    pose::only(node, &["joints_rad", "base_from_flange"])?;
    Ok(ArmStand {
        joints_rad: pose::list(&node.get("joints_rad")?)?,
        base_from_flange: pose::read(&node.get("base_from_flange")?)?,
    })
}
