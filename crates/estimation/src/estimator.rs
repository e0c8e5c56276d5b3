//! The entry: estimators and trackers by the name of their method.

use std::fmt;
use std::str::FromStr;

use image::RgbImage;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::{EstimateWarning, PlaneEstimate, TrackEstimate};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_estimation_published::estimator::PublishedConfig;
use pb3dp_estimation_track::DirectTrackerConfig;
use pb3dp_geometry::StereoRig;

pub use pb3dp_estimation_direct::row_measurement::RowMeasurement;
pub use pb3dp_estimation_published::estimator::{PublishedEstimator, PublishedTracker};
pub use pb3dp_estimation_track::{DirectTracker, FramePrior, SurfacePoint};

/// A method of this crate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Method {
    /// RM-GA on hue votes, as published.
    Published,
    /// Semi-global search, slanted patches and photometric refinement, of any texture.
    Direct,
}

impl Method {
    /// All methods.
    pub const ALL: [Self; 2] = [Self::Published, Self::Direct];

    /// Its name in commands, configurations and results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Published => "published",
            Self::Direct => "direct",
        }
    }

    /// Whether its tracker recovers the surface of the target: [`Tracker::surface`].
    pub fn recovers_surface(self) -> bool {
        self == Self::Direct
    }

    /// The method of a name.
    ///
    /// # Errors
    /// An unknown name; the error lists the known ones.
    pub fn from_name(name: &str) -> Result<Self, EstimationError> {
        Self::ALL.into_iter().find(|method| method.name() == name).ok_or_else(|| EstimationError::UnknownMethod {
            name: name.to_owned(),
            known: Self::ALL.map(Self::name).join(", "),
        })
    }
}

impl FromStr for Method {
    type Err = EstimationError;
    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Self::from_name(name)
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Parameters of every method.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EstimatorConfig {
    /// Of the published method.
    pub published: PublishedConfig,
    /// Of the direct method.
    pub direct: DirectConfig,
    /// Of the direct method on sequences.
    pub track: DirectTrackerConfig,
}

/// An estimator of any method, for single pairs.
#[derive(Clone, Debug)]
pub enum Estimator {
    /// The published method.
    Published(Box<PublishedEstimator>),
    /// The direct method.
    Direct(Box<DirectEstimator>),
}

impl Estimator {
    /// An estimator of `method` for a calibrated pair.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(method: Method, rig: &StereoRig, config: &EstimatorConfig) -> Result<Self, EstimationError> {
        match method {
            Method::Published => Ok(Self::Published(Box::new(PublishedEstimator::new(rig, config.published.clone())?))),
            Method::Direct => Ok(Self::Direct(Box::new(DirectEstimator::new(rig, config.direct.clone())?))),
        }
    }

    /// As [`Self::new`] with the same method, in the memory of an estimator that is no longer needed where the method can
    /// use it.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn for_rig(self, rig: &StereoRig, config: &EstimatorConfig) -> Result<Self, EstimationError> {
        match self {
            Self::Direct(estimator) if *estimator.config() == config.direct => {
                Ok(Self::Direct(Box::new(estimator.for_rig(rig)?)))
            }
            other => Self::new(other.method(), rig, config),
        }
    }

    /// The method.
    pub fn method(&self) -> Method {
        match self {
            Self::Published(_) => Method::Published,
            Self::Direct(_) => Method::Direct,
        }
    }

    /// Learns from a pair of raw images what belongs to the rig or the scene and not to a region: the direct method measures
    /// by how much the rows of the right image are off. It takes some milliseconds, is for once per rig or scene, and
    /// all later estimates use what was found. `None`: the method takes rigs as they are.
    ///
    /// # Errors
    /// Images that do not fit the calibration.
    pub fn prepare(&mut self, left: &RgbImage, right: &RgbImage) -> Result<Option<RowMeasurement>, EstimationError> {
        match self {
            Self::Published(_) => Ok(None),
            Self::Direct(estimator) => estimator.measure_rows(left, right).map(Some),
        }
    }

    /// Uses what [`Self::prepare`] found on another pair of the same rig or scene.
    pub fn use_rows(&mut self, measured: &RowMeasurement) {
        match self {
            Self::Published(_) => {}
            Self::Direct(estimator) => estimator.set_rows(measured.rows),
        }
    }

    /// The plane of a region of one pair of raw images; see the methods' own `estimate`.
    ///
    /// # Errors
    /// Images that do not fit the calibration, a region that can not serve, a bad range.
    pub fn estimate(
        &mut self,
        left: &RgbImage,
        right: &RgbImage,
        region: &Region,
        range: &SearchRange,
    ) -> Result<PlaneEstimate, EstimationError> {
        self.estimate_while(left, right, region, range, &mut || true)
    }

    /// As [`Self::estimate`], with a deadline: `may_continue` is asked between the steps of the search, and once it says no,
    /// the best answer so far is judged and given, with the warning [`EstimateWarning::CutShort`]. The first step and the
    /// judgement always take place.
    ///
    /// # Errors
    /// As [`Self::estimate`].
    pub fn estimate_while(
        &mut self,
        left: &RgbImage,
        right: &RgbImage,
        region: &Region,
        range: &SearchRange,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Result<PlaneEstimate, EstimationError> {
        let mut asked = Asked::new(may_continue);
        let ask = &mut || asked.may_continue();
        let mut estimate = match self {
            Self::Published(estimator) => estimator.estimate_while(left, right, region, range, ask),
            Self::Direct(estimator) => estimator.estimate_while(left, right, region, range, ask),
        }?;
        if asked.was_refused {
            estimate.warnings.push(EstimateWarning::CutShort);
        }
        Ok(estimate)
    }
}

/// A tracker of any method, for sequences.
#[derive(Clone, Debug)]
pub enum Tracker {
    /// The published method.
    Published(Box<PublishedTracker>),
    /// The direct method.
    Direct(Box<DirectTracker>),
}

impl Tracker {
    /// A tracker of `method` for a calibrated pair.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(method: Method, rig: &StereoRig, config: &EstimatorConfig) -> Result<Self, EstimationError> {
        match method {
            Method::Published => Ok(Self::Published(Box::new(PublishedTracker::new(rig, config.published.clone())?))),
            Method::Direct => Ok(Self::Direct(Box::new(DirectTracker::new(rig, config.direct.clone(), config.track)?))),
        }
    }

    /// The method.
    pub fn method(&self) -> Method {
        match self {
            Self::Published(_) => Method::Published,
            Self::Direct(_) => Method::Direct,
        }
    }

    /// Takes a new target in the first pair of raw images; see the methods' own `start`.
    ///
    /// # Errors
    /// Images that do not fit the calibration, a region that can not serve, a bad range.
    pub fn start(
        &mut self,
        left: &RgbImage,
        right: &RgbImage,
        region: &Region,
        range: &SearchRange,
    ) -> Result<TrackEstimate, EstimationError> {
        self.start_while(left, right, region, range, &mut || true)
    }

    /// As [`Self::start`], with a deadline, see [`Estimator::estimate_while`]; the reason tells of an answer cut short.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn start_while(
        &mut self,
        left: &RgbImage,
        right: &RgbImage,
        region: &Region,
        range: &SearchRange,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Result<TrackEstimate, EstimationError> {
        let mut asked = Asked::new(may_continue);
        let ask = &mut || asked.may_continue();
        let found = match self {
            Self::Published(tracker) => tracker.start_while(left, right, region, range, ask),
            Self::Direct(tracker) => tracker.start_while(left, right, region, range, ask),
        }?;
        Ok(asked.mark(found))
    }

    /// Whether the last [`Self::start`] took no target, so that the region has to be given again. Never of the published
    /// method, which tries its region again by itself.
    pub fn wants_region(&self) -> bool {
        match self {
            Self::Published(_) => false,
            Self::Direct(tracker) => tracker.fit().is_none(),
        }
    }

    /// The target's surface in `model`, as far as it is known; empty before a target was found, and for a method that does
    /// not recover it.
    pub fn surface(&self) -> Vec<SurfacePoint> {
        match self {
            Self::Published(_) => Vec::new(),
            Self::Direct(tracker) => tracker.surface(),
        }
    }

    /// Follows the target into the next pair of raw images; see the methods' own `update`. The published method uses of
    /// `prior` the motion of the camera.
    ///
    /// # Errors
    /// Images that do not fit the calibration, or no [`Self::start`] before.
    pub fn update(
        &mut self,
        left: &RgbImage,
        right: &RgbImage,
        prior: &FramePrior,
    ) -> Result<TrackEstimate, EstimationError> {
        self.update_while(left, right, prior, &mut || true)
    }

    /// As [`Self::update`], with a deadline, see [`Estimator::estimate_while`]; the reason tells of an answer cut short.
    ///
    /// # Errors
    /// As [`Self::update`].
    pub fn update_while(
        &mut self,
        left: &RgbImage,
        right: &RgbImage,
        prior: &FramePrior,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Result<TrackEstimate, EstimationError> {
        let mut asked = Asked::new(may_continue);
        let ask = &mut || asked.may_continue();
        let found = match self {
            Self::Published(tracker) => {
                tracker.update_while(left, right, prior.cam_left_prev_from_cam_left_now.as_ref(), ask)
            }
            Self::Direct(tracker) => tracker.update_while(left, right, prior, ask),
        }?;
        Ok(asked.mark(found))
    }
}

/// Remembers whether the caller's time was over; once it is, it stays so.
struct Asked<'a> {
    may_continue: &'a mut dyn FnMut() -> bool,
    was_refused: bool,
}

impl<'a> Asked<'a> {
    fn new(may_continue: &'a mut dyn FnMut() -> bool) -> Self {
        Self { may_continue, was_refused: false }
    }

    fn may_continue(&mut self) -> bool {
        self.was_refused = self.was_refused || !(self.may_continue)();
        !self.was_refused
    }

    fn mark(&self, mut estimate: TrackEstimate) -> TrackEstimate {
        if self.was_refused {
            estimate.reason.push_str("; ");
            estimate.reason.push_str(&EstimateWarning::CutShort.to_string());
        }
        estimate
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_are_found_by_name() {
        for method in Method::ALL {
            assert_eq!(Method::from_name(method.name()), Ok(method));
            assert_eq!(method.to_string().parse(), Ok(method));
        }
        let error = Method::from_name("ViSP").expect_err("unknown");
        assert_eq!(error.to_string(), "there is no method \"ViSP\": known methods are published, direct");
    }
}
