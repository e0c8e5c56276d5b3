//! Segments of a recording: its pairs with one calibration.

use pb3dp_geometry::MonotonicTime;

use crate::messages::CameraInfo;

/// Middle of the left exposure, and middle of the right one minus it, nanoseconds.
pub type PairTimes = (MonotonicTime, i64);

/// A `camera_info` with other numbers than the one before it on its topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CalibrationChange {
    /// The topic.
    pub topic: String,
    /// Its time: images from then on have the new calibration.
    pub at: MonotonicTime,
}

/// The pairs of a recording with one calibration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Segment {
    /// Number of its first pair in the recording.
    pub first: u64,
    /// Times of this pair.
    pub times: PairTimes,
    /// What changed with it; in the first segment, what changed before it.
    pub change: Option<CalibrationChange>,
}

/// The `camera_info` of a camera so far.
pub(crate) struct CameraInfos {
    /// None: the calibration is not that of a `camera_info`.
    pub(crate) topic: Option<String>,
    newest: Option<CameraInfo>,
    changes: Vec<MonotonicTime>,
}

impl CameraInfos {
    pub(crate) fn of(topic: Option<String>) -> Self {
        Self { topic, newest: None, changes: Vec::new() }
    }

    /// Notes a change.
    pub(crate) fn take(&mut self, info: CameraInfo, at: MonotonicTime) {
        if self.newest.as_ref().is_some_and(|newest| !has_same_numbers(newest, &info)) {
            self.changes.push(at);
        }
        self.newest = Some(info);
    }

    /// The first change that holds for an image of this time, and did not for the one before.
    pub(crate) fn change_between(
        &self,
        before: Option<MonotonicTime>,
        now: MonotonicTime,
    ) -> Option<CalibrationChange> {
        let is_between = |at: &&MonotonicTime| **at <= now && before.is_none_or(|before| **at > before);
        let at = *self.changes.iter().find(is_between)?;
        Some(CalibrationChange { topic: self.topic.clone()?, at })
    }
}

/// Whether all but the headers agree; what is no number agrees with itself.
fn has_same_numbers(a: &CameraInfo, b: &CameraInfo) -> bool {
    let same =
        |a: &[f64], b: &[f64]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a == b || (a.is_nan() && b.is_nan()));
    let window = |info: &CameraInfo| (info.width, info.height, info.binning_x.max(1), info.binning_y.max(1));
    (window(a), &a.roi, &a.distortion_model) == (window(b), &b.roi, &b.distortion_model)
        && [(&a.d[..], &b.d[..]), (&a.k, &b.k), (&a.r, &b.r), (&a.p, &b.p)].into_iter().all(|(a, b)| same(a, b))
}
