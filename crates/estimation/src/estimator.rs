//! The entry: estimators and trackers by the name of their method.

use std::fmt;
use std::str::FromStr;

use image::RgbImage;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::{PlaneEstimate, TrackEstimate};
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_estimation_published::estimator::PublishedConfig;
use pb3dp_estimation_track::DirectTrackerConfig;
use pb3dp_geometry::StereoRig;

pub use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior, MarkedTarget, SurfacePoint};
pub use pb3dp_estimation_core::row_offset::RowMeasurement;
pub use pb3dp_estimation_published::estimator::{PublishedEstimator, PublishedTracker};
pub use pb3dp_estimation_track::DirectTracker;

/// A method of this crate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Method {
    /// RM-GA on hue votes, as published.
    Published,
    /// Semi-global search, slanted patches and photometric refinement, of any texture.
    Direct,
}

impl Method {
    /// All methods: who is not here is not found by name.
    pub const ALL: [Self; 2] = [Self::Published, Self::Direct];

    /// Its name in commands, configurations and results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Published => "published",
            Self::Direct => "direct",
        }
    }

    /// What it is for, in a line.
    pub fn summary(self) -> &'static str {
        match self {
            Self::Published => "RM-GA on hue votes, the method of the paper",
            Self::Direct => "photometric, of any texture, with covariances; tracks in six degrees of freedom",
        }
    }

    /// Whether its tracker recovers the surface of the target, see [`EstimationMethod::surface`].
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

type PairMethod = Box<dyn EstimationMethod<Answer = PlaneEstimate>>;
type SequenceMethod = Box<dyn EstimationMethod<Answer = TrackEstimate>>;

impl Method {
    /// What answers for single pairs.
    fn for_pairs(self, rig: &StereoRig, config: &EstimatorConfig) -> Result<PairMethod, EstimationError> {
        Ok(match self {
            Self::Published => Box::new(PublishedEstimator::new(rig, config.published.clone())?),
            Self::Direct => Box::new(DirectEstimator::new(rig, config.direct.clone())?),
        })
    }

    /// What answers for sequences.
    fn for_sequences(self, rig: &StereoRig, config: &EstimatorConfig) -> Result<SequenceMethod, EstimationError> {
        Ok(match self {
            Self::Published => Box::new(PublishedTracker::new(rig, config.published.clone())?),
            Self::Direct => Box::new(DirectTracker::new(rig, config.direct.clone(), config.track)?),
        })
    }
}

/// An estimator of any method, for single pairs.
#[derive(Debug)]
pub struct Estimator {
    method: Method,
    inner: PairMethod,
}

impl Estimator {
    /// An estimator of `method` for a calibrated pair.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(method: Method, rig: &StereoRig, config: &EstimatorConfig) -> Result<Self, EstimationError> {
        Ok(Self { method, inner: method.for_pairs(rig, config)? })
    }

    /// The method.
    pub fn method(&self) -> Method {
        self.method
    }

    /// The plane of a region of one pair of raw images.
    ///
    /// # Errors
    /// See [`EstimationMethod::estimate`].
    pub fn estimate(&mut self, request: EstimateRequest<'_>) -> Result<PlaneEstimate, EstimationError> {
        self.inner.estimate(request)
    }

    /// Goes on with another rig, see [`EstimationMethod::set_rig`].
    ///
    /// # Errors
    /// A rig that the method cannot use.
    pub fn set_rig(&mut self, rig: &StereoRig) -> Result<(), EstimationError> {
        self.inner.set_rig(rig)
    }

    /// Learns what belongs to the rig or the scene, see [`EstimationMethod::prepare`].
    ///
    /// # Errors
    /// Images that do not fit the calibration.
    pub fn prepare(&mut self, left: &RgbImage, right: &RgbImage) -> Result<Option<RowMeasurement>, EstimationError> {
        self.inner.prepare(left, right)
    }

    /// Uses what [`Self::prepare`] found on another pair of the same rig or scene.
    pub fn use_rows(&mut self, measured: &RowMeasurement) {
        self.inner.use_rows(measured);
    }
}

/// A tracker of any method, for sequences.
#[derive(Debug)]
pub struct Tracker {
    method: Method,
    inner: SequenceMethod,
}

impl Tracker {
    /// A tracker of `method` for a calibrated pair.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(method: Method, rig: &StereoRig, config: &EstimatorConfig) -> Result<Self, EstimationError> {
        Ok(Self { method, inner: method.for_sequences(rig, config)? })
    }

    /// The method.
    pub fn method(&self) -> Method {
        self.method
    }

    /// Takes a marked target, or follows the last one into the next pair of raw images.
    ///
    /// # Errors
    /// See [`EstimationMethod::estimate`].
    pub fn estimate(&mut self, request: EstimateRequest<'_>) -> Result<TrackEstimate, EstimationError> {
        self.inner.estimate(request)
    }

    /// Whether the last marked target was not taken, so that it has to be marked again. Never of the published method, which tries
    /// its region again by itself.
    pub fn wants_region(&self) -> bool {
        self.inner.wants_region()
    }

    /// The target's surface in `model`, as far as it is known, see [`EstimationMethod::surface`].
    pub fn surface(&self) -> Vec<SurfacePoint> {
        self.inner.surface()
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
