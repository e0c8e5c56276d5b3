//! Where arms stood while images were taken, and where they are wanted.
//!
//! A recording of stops is a folder with a `stops.toml` beside its images: at each stop both arms rested, a stereo pair
//! was taken, and the joints were read. A `poses.toml` holds the poses that an arm is to visit. What both are for is in
//! `docs/calibration.md`.

use std::path::Path;

use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Flange};

use super::document::{Document, Node};
use super::error::CalibrationFileError;
use super::{pose, write, write_file};

/// Name of the file in a recording of stops.
pub const STOPS_FILE: &str = "stops.toml";

/// What the keys `format` say.
const STOPS_FORMAT: &str = "pb3dp stops 1";
const POSES_FORMAT: &str = "pb3dp poses 1";

/// Joints of an arm.
const JOINTS: usize = 7;

/// How an arm stood.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmStand {
    /// Joint angles as measured, rad, from the base.
    pub joints_rad: [f64; JOINTS],
    /// Where its flange was by these joints and its robot description.
    pub base_from_flange: Pose<Base, Flange>,
}

/// A stereo pair, taken while everything rested.
#[derive(Clone, Debug, PartialEq)]
pub struct Stop {
    /// The left image, relative to the folder of the file.
    pub left: String,
    /// The right image.
    pub right: String,
    /// The arm that carries the cameras.
    pub vs: ArmStand,
    /// The other arm; `None` if it was left out.
    pub tc: Option<ArmStand>,
}

/// A recording of stops.
#[derive(Clone, Debug, PartialEq)]
pub struct Stops {
    /// When the first image was taken, RFC 3339.
    pub date: String,
    /// In the order in which they were taken.
    pub stops: Vec<Stop>,
}

/// Which arm is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmOfPoses {
    /// The one that carries the cameras.
    Vs,
    /// The one that carries the target, or the board.
    Tc,
}

impl ArmOfPoses {
    /// As in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vs => "vs",
            Self::Tc => "tc",
        }
    }
}

/// Poses that an arm is to visit.
#[derive(Clone, Debug, PartialEq)]
pub struct WantedPoses {
    /// The arm.
    pub arm: ArmOfPoses,
    /// Where its flange is wanted, in the frame of its base, in the order of the way.
    pub poses: Vec<Pose<Base, Flange>>,
}

/// Reads the `stops.toml` in a folder.
///
/// # Errors
/// An unreadable file, or one that says something else, by key.
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

/// Reads poses that an arm is to visit.
///
/// # Errors
/// An unreadable file, or one that says something else, by key.
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

/// Writes poses that an arm is to visit.
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
        text => Err(format.refuse(format!("is {text:?}, {expected:?} is known here"))),
    }
}

fn stop(node: &Node<'_>) -> Result<Stop, CalibrationFileError> {
    pose::only(node, &["left", "right", "vs", "tc"])?;
    let image = |key: &str| {
        let name = node.get(key)?;
        // A recording is read wherever it is, and reads nothing that is not its own.
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
