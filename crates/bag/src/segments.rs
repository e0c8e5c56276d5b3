//! Segments of a recording: its pairs with one calibration.

use pb3dp_geometry::MonotonicTime;

use crate::BagError;
use crate::messages::CameraInfo;
use crate::pairs::{BagPairs, PairTimes, StereoBag, decoded, of_both, stamp};
use crate::reader::RawMessage;
use crate::topics::Topic;

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
    pub(crate) fn take(&mut self, message: &RawMessage) -> Result<(), BagError> {
        let info: CameraInfo = decoded(message)?;
        if self.newest.as_ref().is_some_and(|newest| !has_same_numbers(newest, &info)) {
            self.changes.push(stamp(message)?);
        }
        self.newest = Some(info);
        Ok(())
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

impl StereoBag {
    /// The segments of the recording: one, unless its `camera_info` changes. Empty without a pair.
    ///
    /// # Errors
    /// If the recording is damaged.
    pub fn segments(&self) -> Result<Vec<Segment>, BagError> {
        let mut pairs = self.pairs();
        let times = pairs.skip_all()?;
        Ok(pairs.segments(&times))
    }

    /// The `camera_info` of both cameras at the first pair of a segment, counted from 1 on.
    pub(crate) fn infos_of_segment(&self, number: usize) -> Result<[CameraInfo; 2], BagError> {
        let segments = self.segments()?;
        let file = || self.bag().path().to_path_buf();
        let Some(segment) = segments.get(number.wrapping_sub(1)) else {
            return Err(BagError::NoSegment { file: file(), asked: number, segments: segments.len() });
        };
        let names = self.topics().each_ref().map(Topic::camera_info);
        let until = of_both(segment.times);
        let mut found: [Option<(MonotonicTime, CameraInfo)>; 2] = [None, None];
        for message in self.bag().messages_on(&names.each_ref().map(String::as_str))? {
            let message = message?;
            let Some(side) = names.iter().position(|name| *name == message.channel.topic) else { continue };
            // A damaged one is none.
            let (Ok(at), Ok(info)) = (stamp(&message), decoded(&message)) else { continue };
            if at <= until[side] && found[side].as_ref().is_none_or(|(newest, _)| *newest <= at) {
                found[side] = Some((at, info));
            }
        }
        let missing = || BagError::NoCalibration { file: file(), why: format!("none before segment {number}") };
        let [left, right] = found.map(|found| found.map(|(_, info)| info).ok_or_else(missing));
        Ok([left?, right?])
    }
}

impl BagPairs {
    /// The segments of all pairs, which have these times.
    pub fn segments(&self, times: &[PairTimes]) -> Vec<Segment> {
        let before = std::iter::once(None).chain(times.iter().copied().map(Some));
        let begin = |((first, times), before): ((u64, &PairTimes), Option<PairTimes>)| {
            let change = self.change_between(before, *times);
            (first == 0 || change.is_some()).then_some(Segment { first, times: *times, change })
        };
        (0..).zip(times).zip(before).filter_map(begin).collect()
    }
}
