//! Our TOML file of a stereo calibration: the cameras, and the origin and quality of the calibration.
//!
//! Numbers are written with the fewest digits that read back as the same number, and the rotation as a quaternion, so that a
//! calibration is preserved bit by bit. The file states its format (`format`), the frames it relates (`cam_right_from_cam_left`),
//! and in each key the unit.

use nalgebra::Vector3;
use pb3dp_geometry::{Camera, Distortion, Pinhole, Pose, StereoRig};

use super::document::Node;
use super::error::CalibrationFileError;
use super::identity::{self, CameraIdentity};
use super::{CalibrationFormat, checks, pose, write};

/// Required value of the key `format`.
const FORMAT: &str = "pb3dp stereo calibration 1";

/// Origin and quality of a calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Judgement {
    /// When the images were taken or the calibration was made, RFC 3339.
    pub date: String,
    /// Program and version.
    pub tool: String,
    /// Description of the data it was made from.
    pub source: String,
    /// Identity of the left and the right camera.
    pub cameras: [CameraIdentity; 2],
    /// Measured numbers by name, with the unit in the name: residuals, counts. In a file these numbers and the gates are sorted
    /// by name.
    pub numbers: Vec<(String, f64)>,
    /// The covariance of the estimated parameters, if known.
    pub covariance: Option<ParameterCovariance>,
    /// Result of each gate.
    pub gates: Vec<JudgedGate>,
}

/// A covariance with the names of its rows.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterCovariance {
    /// `left.fx`, `cam_right_from_cam_left.x_m`; pixels, metres, radians.
    pub names: Vec<String>,
    /// One row per name.
    pub rows: Vec<Vec<f64>>,
}

/// Result of a gate at calibration time.
#[derive(Clone, Debug, PartialEq)]
pub struct JudgedGate {
    /// Its name, with the unit.
    pub name: String,
    /// The measured value.
    pub measured: f64,
    /// Good up to this value, inclusive.
    pub good: f64,
    /// Refused if worse than this value.
    pub refused: f64,
    /// `good`, `fair` or `refused`.
    pub grade: String,
}

impl Judgement {
    /// The gates that refuse the calibration.
    pub fn refusals(&self) -> impl Iterator<Item = &JudgedGate> {
        self.gates.iter().filter(|gate| gate.grade == "refused")
    }
}

pub(super) fn recognises(root: &Node<'_>) -> bool {
    root.find("format").is_some() && root.find("cam_right_from_cam_left").is_some()
}

pub(super) fn read(root: &Node<'_>) -> Result<(StereoRig, Judgement), CalibrationFileError> {
    let format = root.get("format")?;
    if format.text()? != FORMAT {
        return Err(format.refuse(format!("is {:?}, supported is {FORMAT:?}; use a newer pb3dp", format.text()?)));
    }
    let cameras = [camera(&root.get("left")?)?, camera(&root.get("right")?)?];
    let node = root.get("cam_right_from_cam_left")?;
    let translation = node.get("translation_m")?;
    let rotation = pose::rotation(&node.get("rotation_wxyz")?)?;
    let translation_m: Vector3<f64> = translation.matrix()?;
    // The general checks use matrices; the quaternion itself is kept unchanged.
    checks::rig(&translation, cameras, rotation.to_rotation_matrix().matrix(), translation_m)?;
    let [left, right] = cameras;
    let rig = StereoRig::new(left, right, Pose::from_parts(translation_m, rotation));
    let rig = rig.map_err(|error| translation.refuse(error))?;
    Ok((rig, judgement(root)?))
}

/// The origin and quality of the calibration in a file.
pub(super) fn judgement(root: &Node<'_>) -> Result<Judgement, CalibrationFileError> {
    let identity = |side: &str| {
        let camera = root.find(side).and_then(|node| node.find("camera"));
        camera.map_or_else(|| Ok(CameraIdentity::default()), |node| identity::read(&node))
    };
    Ok(Judgement {
        date: root.get("date")?.text()?.to_owned(),
        tool: root.get("tool")?.text()?.to_owned(),
        source: root.get("source")?.text()?.to_owned(),
        cameras: [identity("left")?, identity("right")?],
        numbers: numbers(&root.get("measured")?)?,
        covariance: root.find("covariance").map(|node| covariance(&node)).transpose()?,
        gates: gates(root)?,
    })
}

fn camera(node: &Node<'_>) -> Result<Camera, CalibrationFileError> {
    let number = |key: &str| node.get(key)?.number();
    let pinhole = Pinhole { fx: number("fx_px")?, fy: number("fy_px")?, cx: number("cx_px")?, cy: number("cy_px")? };
    let model = node.get("distortion_model")?;
    let distortion = match model.text()? {
        "none" => Distortion::None,
        // Zeros are kept: a lens estimated with coefficients keeps its model.
        "plumb_bob" => Distortion::BrownConrady5 { coefficients: pose::list(&node.get("distortion_coefficients")?)? },
        "rational_polynomial" => {
            Distortion::BrownConrady8 { coefficients: pose::list(&node.get("distortion_coefficients")?)? }
        }
        name => checks::distortion(&model, name, &node.get("distortion_coefficients")?)?,
    };
    checks::camera(node, node.get("image_size_px")?.size_pair()?, pinhole, distortion)
}

fn numbers(node: &Node<'_>) -> Result<Vec<(String, f64)>, CalibrationFileError> {
    node.entries()?.into_iter().map(|(name, value)| Ok((name, value.number()?))).collect()
}

fn covariance(node: &Node<'_>) -> Result<ParameterCovariance, CalibrationFileError> {
    let names = node.get("names")?.items()?;
    let names = names.iter().map(|name| Ok(name.text()?.to_owned())).collect::<Result<Vec<_>, _>>()?;
    let matrix = node.get("matrix")?;
    let rows = matrix.items()?.iter().map(Node::numbers).collect::<Result<Vec<_>, _>>()?;
    if rows.len() != names.len() || rows.iter().any(|row| row.len() != names.len()) {
        return Err(matrix.refuse(format!("must have {0} rows of {0} numbers, one per name", names.len())));
    }
    Ok(ParameterCovariance { names, rows })
}

fn gates(root: &Node<'_>) -> Result<Vec<JudgedGate>, CalibrationFileError> {
    let gate = |(name, node): (String, Node<'_>)| {
        let number = |key: &str| node.get(key)?.number();
        let grade = node.get("grade")?;
        if !["good", "fair", "refused"].contains(&grade.text()?) {
            return Err(grade.refuse(format!("is {:?}, it must be good, fair or refused", grade.text()?)));
        }
        let (measured, good, refused) = (number("measured")?, number("good")?, number("refused")?);
        // If larger is better, good is the larger limit.
        let is_beyond = if good > refused { measured < refused } else { measured > refused };
        if is_beyond != (grade.text()? == "refused") {
            return Err(
                grade.refuse(format!("is {:?}, but {measured} was measured and the limit is {refused}", grade.text()?))
            );
        }
        Ok(JudgedGate { name, measured, good, refused, grade: grade.text()?.to_owned() })
    };
    root.get("gates")?.entries()?.into_iter().map(gate).collect()
}

/// The text of the file.
pub(super) fn write(rig: &StereoRig, judgement: &Judgement) -> Result<String, CalibrationFileError> {
    check_finite(judgement)?;
    let mut file = write_head(FORMAT, judgement);
    for ((side, camera), identity) in [("left", rig.left()), ("right", rig.right())].into_iter().zip(&judgement.cameras)
    {
        file += &format!("\n[{side}]\nimage_size_px = [{}, {}]\n", camera.size().width, camera.size().height);
        let p = camera.pinhole();
        for (key, value) in [("fx_px", p.fx), ("fy_px", p.fy), ("cx_px", p.cx), ("cy_px", p.cy)] {
            file += &format!("{key} = {}\n", write::number(value));
        }
        let model = match camera.distortion() {
            Distortion::None => "none",
            other => write::distortion(other).0,
        };
        file += &format!("distortion_model = {}\n", text(model));
        file += &format!("distortion_coefficients = {}\n", write::list(camera.distortion().coefficients()));
        file += &write_identity(side, identity);
    }
    file += "\n# Maps coordinates in cam_left to cam_right: x right, y down, z forward; whole pixel numbers are pixel centres.\n";
    file += &format!("[cam_right_from_cam_left]\n{}", pose::write(rig.cam_right_from_cam_left()));
    Ok(file + &write_worth(judgement))
}

/// A string in TOML syntax, quoted by the TOML writer.
fn text(value: &str) -> String {
    toml::Value::from(value).to_string()
}

/// The head of a file.
pub(super) fn write_head(format: &str, judgement: &Judgement) -> String {
    let Judgement { date, tool, source, .. } = judgement;
    let head = [("format", format), ("date", date), ("tool", tool), ("source", source)];
    head.map(|(key, value)| format!("{key} = {}\n", text(value))).concat()
}

/// The table of a camera whose identity is known.
pub(super) fn write_identity(side: &str, identity: &CameraIdentity) -> String {
    if identity.is_empty() { String::new() } else { format!("\n[{side}.camera]\n{}", identity::write(identity)) }
}

/// The measured numbers, the gates and the covariance.
pub(super) fn write_worth(judgement: &Judgement) -> String {
    let Judgement { numbers, covariance, gates, .. } = judgement;
    let mut file = "\n[measured]\n".to_owned();
    for (name, value) in numbers {
        file += &format!("{} = {}\n", key(name), write::number(*value));
    }
    for gate in gates {
        let JudgedGate { name, measured, good, refused, grade } = gate;
        let [measured, good, refused] = [measured, good, refused].map(|value| write::number(*value));
        file += &format!(
            "\n[gates.{}]\nmeasured = {measured}\ngood = {good}\nrefused = {refused}\ngrade = {}\n",
            key(name),
            text(grade)
        );
    }
    if gates.is_empty() {
        file += "\n[gates]\n";
    }
    if let Some(ParameterCovariance { names, rows }) = covariance {
        let names = names.iter().map(|name| text(name)).collect::<Vec<_>>().join(", ");
        let rows = rows.iter().map(|row| format!("    {},\n", write::list(row))).collect::<String>();
        file += &format!("\n[covariance]\nnames = [{names}]\nmatrix = [\n{rows}]\n");
    }
    file
}

/// A name as a key, quoted only if necessary.
fn key(name: &str) -> String {
    let is_bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if !name.is_empty() && name.chars().all(is_bare) { name.to_owned() } else { toml::Value::from(name).to_string() }
}

/// Refuses values that our readers would refuse.
pub(super) fn check_finite(calibration: &Judgement) -> Result<(), CalibrationFileError> {
    let gates = calibration
        .gates
        .iter()
        .flat_map(|gate| [gate.measured, gate.good, gate.refused].map(|value| (&gate.name, value)));
    let measured = calibration.numbers.iter().map(|(name, value)| (name, *value));
    let refuse = |reason| Err(CalibrationFileError::NotRepresentable { format: CalibrationFormat::Judged, reason });
    if let Some((name, value)) = measured.chain(gates).find(|(_, value)| !value.is_finite()) {
        return refuse(format!("{name} is {value}"));
    }
    let rows = calibration.covariance.iter().flat_map(|covariance| covariance.names.iter().zip(&covariance.rows));
    let mut elements = rows.flat_map(|(name, row)| row.iter().map(move |value| (name, *value)));
    match elements.find(|(_, value)| !value.is_finite()) {
        None => Ok(()),
        Some((name, value)) => refuse(format!("the covariance of {name} is {value}")),
    }
}
