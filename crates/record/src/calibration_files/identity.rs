//! Identity of the cameras of a calibration or a recording.
//!
//! A recording of two cameras has a file `cameras.toml` with one table per side. Our calibration files have the same keys in
//! `[left.camera]` and `[right.camera]`. Unknown values are omitted.

use super::document::Node;
use super::error::CalibrationFileError;

/// Required value of the key `format` of a `cameras.toml`.
const FORMAT: &str = "pb3dp cameras 1";

/// Identity of a camera and its lens setting.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CameraIdentity {
    /// Serial number.
    pub serial: Option<String>,
    /// Port it is connected to, as reported by its driver.
    pub place: Option<String>,
    /// Focus, in units of the driver; unknown for a manual lens.
    pub focus: Option<i32>,
}

impl CameraIdentity {
    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// The keys of a camera that are present.
pub(super) fn read(node: &Node<'_>) -> Result<CameraIdentity, CalibrationFileError> {
    let text = |key: &str| node.find(key).map(|value| Ok(value.text()?.to_owned())).transpose();
    let focus = node.find("focus").map(|value| {
        let number = value.number()?;
        let is_whole = number.fract() == 0.0 && number.abs() <= f64::from(i32::MAX);
        if is_whole { Ok(number as i32) } else { Err(value.refuse(format!("is {number}, it must be an integer"))) }
    });
    let identity = CameraIdentity { serial: text("serial")?, place: text("place")?, focus: focus.transpose()? };
    let known = ["serial", "place", "focus"];
    match node.entries()?.into_iter().find(|(key, _)| !known.contains(&key.as_str())) {
        Some((_, other)) => Err(other.refuse(format!("unknown key; the keys are {}", known.join(", ")))),
        None => Ok(identity),
    }
}

/// The lines of a camera.
pub(super) fn write(identity: &CameraIdentity) -> String {
    let text = |key: &str, value: &Option<String>| {
        value.as_ref().map_or_else(String::new, |value| format!("{key} = {}\n", toml::Value::from(value.as_str())))
    };
    let focus = identity.focus.map_or_else(String::new, |focus| format!("focus = {focus}\n"));
    text("serial", &identity.serial) + &text("place", &identity.place) + &focus
}

/// The left and the right camera of a `cameras.toml`.
pub(super) fn read_file(root: &Node<'_>) -> Result<[CameraIdentity; 2], CalibrationFileError> {
    let format = root.get("format")?;
    if format.text()? != FORMAT {
        return Err(format.refuse(format!("is {:?}, it must be {FORMAT:?}", format.text()?)));
    }
    Ok([read(&root.get("left")?)?, read(&root.get("right")?)?])
}

/// The text of a `cameras.toml`.
pub(super) fn write_file([left, right]: &[CameraIdentity; 2]) -> String {
    let format = toml::Value::from(FORMAT);
    format!("format = {format}\n\n[left]\n{}\n[right]\n{}", write(left), write(right))
}
