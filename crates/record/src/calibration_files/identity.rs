//! Which cameras a calibration or a recording is of.
//!
//! A recording of two cameras has a file `cameras.toml` with one table per side, and a calibration of ours the same keys in
//! `[left.camera]` and `[right.camera]`. What is not known is left out.

use super::document::Node;
use super::error::CalibrationFileError;

/// What the key `format` of a `cameras.toml` says.
const FORMAT: &str = "pb3dp cameras 1";

/// What a camera is known by, and how its lens was set.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CameraIdentity {
    /// Its serial number.
    pub serial: Option<String>,
    /// Where it is plugged in, as its driver tells it.
    pub place: Option<String>,
    /// Its focus, in units of the driver's own; not known of a lens that is set by hand.
    pub focus: Option<i32>,
}

impl CameraIdentity {
    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// The keys of a camera, as far as they are there.
pub(super) fn read(node: &Node<'_>) -> Result<CameraIdentity, CalibrationFileError> {
    let text = |key: &str| node.find(key).map(|value| Ok(value.text()?.to_owned())).transpose();
    let focus = node.find("focus").map(|value| {
        let number = value.number()?;
        let is_whole = number.fract() == 0.0 && number.abs() <= f64::from(i32::MAX);
        if is_whole { Ok(number as i32) } else { Err(value.refuse(format!("is {number}, it must be a whole number"))) }
    });
    let identity = CameraIdentity { serial: text("serial")?, place: text("place")?, focus: focus.transpose()? };
    let known = ["serial", "place", "focus"];
    match node.entries()?.into_iter().find(|(key, _)| !known.contains(&key.as_str())) {
        Some((_, other)) => Err(other.refuse(format!("is not known here: {}", known.join(", ")))),
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
        return Err(format.refuse(format!("is {:?}, {FORMAT:?} is known here", format.text()?)));
    }
    Ok([read(&root.get("left")?)?, read(&root.get("right")?)?])
}

/// The text of a `cameras.toml`.
pub(super) fn write_file([left, right]: &[CameraIdentity; 2]) -> String {
    let format = toml::Value::from(FORMAT);
    format!("format = {format}\n\n[left]\n{}\n[right]\n{}", write(left), write(right))
}
