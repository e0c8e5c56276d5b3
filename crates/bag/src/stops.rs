//! Stops of an arm in a recording: pairs for a calibration of the cameras on the arm.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use pb3dp_geometry::frames::Frame;
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_record::stops::ArmStand;

use crate::BagError;
use crate::pairs::decoded;
use crate::reader::Bag;
use crate::run_messages::{SetupFile, SetupFiles, Stand, Stop};
use crate::topics::ours;

/// A stop, as it was recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedStop {
    /// Stamp of its left image.
    pub at: MonotonicTime,
    /// The arm that carries the cameras.
    pub vs: ArmStand,
    /// The other arm, if it was recorded.
    pub tc: Option<ArmStand>,
}

/// Whether a recording has stops.
pub fn has_stops(bag: &Bag) -> bool {
    bag.topics().iter().any(|topic| topic.name == ours::STOPS)
}

/// All stops of a recording.
///
/// # Errors
/// A damaged recording, and numbers that are no joints or no pose.
pub fn stops(bag: &Bag) -> Result<Vec<RecordedStop>, BagError> {
    let mut stops = Vec::new();
    for message in bag.messages_on(&[ours::STOPS])? {
        let Stop { stamp, vs, tc } = decoded(&message?)?;
        let refuse = |what: &str| {
            let (file, why) = (bag.path().to_path_buf(), format!("stop {}: {what}", stops.len()));
            BagError::Damaged { file, messages: stops.len() as u64, why }
        };
        let vs = stand(&vs).ok_or_else(|| refuse("vs: no pose of an arm with seven joints"))?;
        let tc = tc.first().map(|tc| stand(tc).ok_or_else(|| refuse("tc: no pose of an arm with seven joints")));
        let tc = tc.transpose()?;
        stops.push(RecordedStop { at: stamp.monotonic(), vs, tc });
    }
    Ok(stops)
}

/// The files in a recording that its settings name, and the identities of its cameras.
///
/// # Errors
/// A damaged recording.
pub fn files(bag: &Bag) -> Result<Vec<SetupFile>, BagError> {
    let found = bag.messages_on(&[ours::FILES])?.next().transpose()?;
    Ok(found.map(|message| decoded::<SetupFiles>(&message)).transpose()?.map_or_else(Vec::new, |files| files.files))
}

/// The message of an arm's stand.
pub fn of_stand(stand: &ArmStand) -> Stand {
    Stand { joints_rad: stand.joints_rad.to_vec(), base_from_flange: of_pose(&stand.base_from_flange) }
}

fn stand(Stand { joints_rad, base_from_flange }: &Stand) -> Option<ArmStand> {
    let joints_rad: [f64; 7] = joints_rad.as_slice().try_into().ok()?;
    let is_finite = joints_rad.iter().all(|angle| angle.is_finite());
    is_finite.then_some(ArmStand { joints_rad, base_from_flange: pose(*base_from_flange)? })
}

/// Translation, m, and quaternion x, y, z, w.
pub fn of_pose<A: Frame, B: Frame>(pose: &Pose<A, B>) -> [f64; 7] {
    let (t, r) = (pose.translation_m(), pose.rotation());
    [t.x, t.y, t.z, r.i, r.j, r.k, r.w]
}

/// The pose, unless the numbers are none. The quaternion is not normalised, which would change its last bits.
pub fn pose<A: Frame, B: Frame>([x, y, z, i, j, k, w]: [f64; 7]) -> Option<Pose<A, B>> {
    let length = [i, j, k, w].iter().map(|q| q * q).sum::<f64>().sqrt();
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
    let pose = Pose::from_isometry(Isometry3::from_parts(Translation3::new(x, y, z), rotation));
    // Recorded poses are finite and normalised, up to rounding.
    (pose.is_finite() && (length - 1.0).abs() < 1e-6).then_some(pose)
}
