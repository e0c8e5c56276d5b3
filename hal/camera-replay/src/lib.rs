//! Stereo camera backend that replays recorded pairs.
//!
//! [`Recording::open`] opens sequence folders, cases (one pair), MCAP files, EuRoC folders and plain folders of images, which
//! `docs/recordings.md` describes; [`ReplayCamera`] plays them. It plays at maximum speed, or in the original timing on an
//! injected clock; once or endlessly. A pair with an image that is missing, damaged or of another size gives one error of kind `BadPair`
//! that names the file; the next call continues after it.
//!
//! Images are delivered as they were recorded, not undistorted or rectified.

mod pacing;
mod recording;

use std::path::Path;
use std::time::Duration;

use pb3dp_camera_recordings::PERIOD;
use pb3dp_geometry::{MonotonicTime, StereoRig};
use pb3dp_hal_api::{CameraError, CameraErrorKind, FramePair, StereoCamera, StereoCameraInfo};
use pb3dp_record::calibration_files::StereoCalibration;

pub use pacing::Pacing;
pub use pb3dp_camera_recordings::{
    CalibrationOptions, PairsPerSecond, RecordedPairs, RecordingOptions, SkewMillis, TimedRecordingOptions, Topics,
    calibration_of,
};
pub use recording::Recording;

/// Behaviour after the last pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repeat {
    /// The stream ends.
    Once,
    /// The recording starts again; sequence numbers and times keep increasing.
    Forever,
}

/// Replay options.
#[derive(Clone, Debug)]
pub struct ReplayOptions {
    /// Delivery timing.
    pub pacing: Pacing,
    /// Behaviour after the last pair.
    pub repeat: Repeat,
    /// Time between pairs if the recording has no times (plain folders), and between the last and the first pair of a recording
    /// with a single pair.
    pub period: Duration,
}

impl Default for ReplayOptions {
    /// As fast as possible, once, 30 pairs per second.
    fn default() -> Self {
        Self { pacing: Pacing::Unpaced, repeat: Repeat::Once, period: PERIOD }
    }
}

/// Replays recorded pairs.
#[derive(Debug)]
pub struct ReplayCamera {
    info: StereoCameraInfo,
    calibration: StereoCalibration,
    pairs: RecordedPairs,
    pacing: Pacing,
    repeat: Repeat,
    /// Number of pairs delivered, damaged or passed over, over all rounds.
    position: u64,
    /// Time of the first pair on the clock of `exposed_at`; set by the first call.
    started_at: Option<MonotonicTime>,
}

impl ReplayCamera {
    fn new(
        path: &Path,
        pairs: RecordedPairs,
        calibration: StereoCalibration,
        options: ReplayOptions,
    ) -> Result<Self, CameraError> {
        let ReplayOptions { pacing, repeat, period } = options;
        if period.is_zero() {
            let message = format!("cannot replay {}: the period is zero; it must be longer", path.display());
            return Err(CameraError::new(CameraErrorKind::Unusable, message));
        }
        let info = StereoCameraInfo {
            name: pairs.name().to_owned(),
            size: calibration.rig.left().size(),
            period: pairs.period(),
        };
        Ok(Self { info, calibration, pairs, pacing, repeat, position: 0, started_at: None })
    }

    /// The two cameras and the pose between them.
    pub fn rig(&self) -> &StereoRig {
        &self.calibration.rig
    }

    /// The calibration with its source.
    pub fn calibration(&self) -> &StereoCalibration {
        &self.calibration
    }

    /// The first pair that can be read; the position does not change.
    ///
    /// # Errors
    /// As [`RecordedPairs::images`], of the first pair.
    pub fn first_pair(&mut self) -> Result<FramePair, CameraError> {
        let mut pair = FramePair::black(self.info.size);
        let wanted = (self.info.size, self.calibration.source.as_str());
        let images = match self.pairs.images(0, Some(wanted)) {
            Err(error) if error.kind() == CameraErrorKind::BadPair => {
                (1..self.pairs.count()).find_map(|number| self.pairs.images(number, Some(wanted)).ok()).ok_or(error)
            }
            first => first,
        };
        [pair.left, pair.right] = images?;
        Ok(pair)
    }

    /// Replaces the calibration by another reading of the same files, which the images have decided.
    pub fn replace_calibration(&mut self, calibration: StereoCalibration) {
        self.calibration = calibration;
    }

    /// Number of pairs in the recording, good or bad.
    pub fn pairs(&self) -> u64 {
        self.pairs.count()
    }

    /// Passes over the pairs that are followed by another due pair, if the timing is that of a real camera.
    fn skip_missed(&mut self) {
        let (Pacing::Live(clock), Some(started_at)) = (&self.pacing, self.started_at) else { return };
        let now = clock.now();
        let has_next = |position| self.repeat == Repeat::Forever || position + 1 < self.pairs.count();
        while has_next(self.position) && started_at + self.pairs.since_start(self.position + 1) <= now {
            self.position += 1;
        }
    }

    /// Waits until the pair at `position` is due and returns its exposure time.
    fn wait(&mut self, timeout: Duration) -> Result<MonotonicTime, CameraError> {
        let since_start = self.pairs.since_start(self.position);
        match &self.pacing {
            Pacing::Unpaced => Ok(self.pairs.first_at() + since_start),
            Pacing::Original(clock) | Pacing::Live(clock) => {
                let now = clock.now();
                let due = *self.started_at.get_or_insert(now) + since_start;
                let deadline = now + timeout;
                clock.sleep_until(due.min(deadline));
                if due <= deadline {
                    return Ok(due);
                }
                let message = format!("{}: pair {} is not due within {timeout:?}", self.info.name, self.position);
                Err(CameraError::new(CameraErrorKind::Timeout, message))
            }
        }
    }

    /// Loads the images of the pair at the present position.
    fn load_into(&mut self, pair: &mut FramePair) -> Result<(), CameraError> {
        let number = self.position % self.pairs();
        let images = self.pairs.images(number, Some((self.info.size, &self.calibration.source)))?;
        for (image, buffer) in images.into_iter().zip([&mut pair.left, &mut pair.right]) {
            // Its memory stays where it is.
            if buffer.dimensions() == image.dimensions() {
                buffer.copy_from_slice(&image);
            } else {
                *buffer = image;
            }
        }
        Ok(())
    }

    /// Continues with the pair of this number, from 0.
    pub fn skip_to(&mut self, number: u64) {
        self.position = number;
    }

    /// What the user should know since the last call.
    pub fn take_notes(&mut self) -> Vec<String> {
        self.pairs.take_notes()
    }
}

impl StereoCamera for ReplayCamera {
    fn info(&self) -> &StereoCameraInfo {
        &self.info
    }

    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        if self.repeat == Repeat::Once && self.position >= self.pairs.count() {
            let message = format!("{}: all {} pairs have been played", self.info.name, self.pairs.count());
            return Err(CameraError::new(CameraErrorKind::EndOfStream, message));
        }
        self.skip_missed();
        let exposed_at = self.wait(timeout)?;
        let (sequence, skew_nanos) = (self.position, self.pairs.skew_nanos(self.position));
        let loaded = self.load_into(pair);
        // This pair is consumed, even if it is bad: the next call continues after it.
        self.position += 1;
        loaded?;
        pair.sequence = sequence;
        pair.exposed_at = exposed_at;
        pair.skew_nanos = skew_nanos;
        pair.clear_delivered();
        Ok(())
    }
}
