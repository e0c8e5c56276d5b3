//! Poses in our TOML files: a quaternion and a translation, preserved bit by bit.

use nalgebra::{Quaternion, UnitQuaternion};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::Frame;

use super::document::Node;
use super::error::CalibrationFileError;
use super::write;

/// Tolerance of the quaternion norm around 1.
const NORM_TOLERANCE: f64 = 1e-9;

/// A pose from `rotation_wxyz` and `translation_m`.
pub(super) fn read<To: Frame, From: Frame>(node: &Node<'_>) -> Result<Pose<To, From>, CalibrationFileError> {
    only(node, &["rotation_wxyz", "translation_m"])?;
    Ok(Pose::from_parts(node.get("translation_m")?.matrix()?, rotation(&node.get("rotation_wxyz")?)?))
}

/// A rotation from w, x, y, z.
pub(super) fn rotation(node: &Node<'_>) -> Result<UnitQuaternion<f64>, CalibrationFileError> {
    let [w, x, y, z] = list(node)?;
    let quaternion = Quaternion::new(w, x, y, z);
    if (quaternion.norm() - 1.0).abs() > NORM_TOLERANCE {
        return Err(node.refuse(format!("is not a unit quaternion: its norm is {}, it must be 1", quaternion.norm())));
    }
    // Not normalised again: that would change the last bits with each reading.
    Ok(UnitQuaternion::new_unchecked(quaternion))
}

/// A list of exactly `N` numbers.
pub(super) fn list<const N: usize>(node: &Node<'_>) -> Result<[f64; N], CalibrationFileError> {
    let numbers = node.numbers()?;
    let count = numbers.len();
    numbers.try_into().map_err(|_| node.refuse(format!("has {count} numbers, {N} are needed")))
}

/// Refuses other keys than these.
pub(super) fn only(node: &Node<'_>, known: &[&str]) -> Result<(), CalibrationFileError> {
    match node.entries()?.into_iter().find(|(key, _)| !known.contains(&key.as_str())) {
        Some((_, other)) => Err(other.refuse(format!("unknown key; the keys are {}", known.join(", ")))),
        None => Ok(()),
    }
}

/// The two lines of a pose.
pub(super) fn write<To: Frame, From: Frame>(pose: &Pose<To, From>) -> String {
    let [rotation, translation] = parts(pose);
    format!("rotation_wxyz = {rotation}\ntranslation_m = {translation}\n")
}

/// A pose on one line.
pub(super) fn inline<To: Frame, From: Frame>(pose: &Pose<To, From>) -> String {
    let [rotation, translation] = parts(pose);
    format!("{{ rotation_wxyz = {rotation}, translation_m = {translation} }}")
}

fn parts<To: Frame, From: Frame>(pose: &Pose<To, From>) -> [String; 2] {
    let rotation = pose.rotation();
    [write::list(&[rotation.w, rotation.i, rotation.j, rotation.k]), write::list(pose.translation_m().as_slice())]
}
