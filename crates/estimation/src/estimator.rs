//! Entry point: estimators and trackers, selected by the name of their method.

use std::fmt;
use std::str::FromStr;

use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::{PlaneEstimate, TrackEstimate};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_estimation_published::estimator::PublishedConfig;
use pb3dp_estimation_track::DirectTrackerConfig;
use pb3dp_geometry::StereoRig;

pub use pb3dp_estimation_core::method::{
    EstimateRequest, EstimationMethod, FramePrior, MarkedTarget, SurfacePoint, VisiblePoint,
};
pub use pb3dp_estimation_core::row_offset::RowMeasurement;
pub use pb3dp_estimation_published::estimator::{PublishedEstimator, PublishedTracker};
pub use pb3dp_estimation_track::DirectTracker;

/// The estimation methods of this project.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Method {
    /// The published method: RM-GA on hue votes.
    Published,
    /// The direct method: semi-global search, slanted patches and photometric refinement; works on any texture.
    Direct,
}

impl Method {
    /// All methods. [`Self::from_name`] finds only the methods in this list.
    pub const ALL: [Self; 2] = [Self::Published, Self::Direct];

    /// Name of the method in commands, configurations and results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Published => "published",
            Self::Direct => "direct",
        }
    }

    /// One-line description.
    pub fn summary(self) -> &'static str {
        match self {
            Self::Published => "RM-GA on hue votes, the method of the paper",
            Self::Direct => "photometric, works on any texture, gives covariances; tracks in six degrees of freedom",
        }
    }

    /// Whether the tracker of this method recovers the surface of the target, see [`EstimationMethod::surface`].
    pub fn recovers_surface(self) -> bool {
        self == Self::Direct
    }

    /// Finds a method by its name.
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

/// Parameters of all methods.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EstimatorConfig {
    /// Parameters of the published method.
    pub published: PublishedConfig,
    /// Parameters of the direct method.
    pub direct: DirectConfig,
    /// Parameters of the direct tracker.
    pub track: DirectTrackerConfig,
}

type PairMethod = Box<dyn EstimationMethod<Answer = PlaneEstimate>>;
type SequenceMethod = Box<dyn EstimationMethod<Answer = TrackEstimate>>;

impl Method {
    /// Creates the estimator for single pairs.
    fn for_pairs(self, rig: &StereoRig, config: &EstimatorConfig) -> Result<PairMethod, EstimationError> {
        Ok(match self {
            Self::Published => Box::new(PublishedEstimator::new(rig, config.published.clone())?),
            Self::Direct => Box::new(DirectEstimator::new(rig, config.direct.clone())?),
        })
    }

    /// Creates the tracker for sequences.
    fn for_sequences(self, rig: &StereoRig, config: &EstimatorConfig) -> Result<SequenceMethod, EstimationError> {
        Ok(match self {
            Self::Published => Box::new(PublishedTracker::new(rig, config.published.clone())?),
            Self::Direct => Box::new(DirectTracker::new(rig, config.direct.clone(), config.track)?),
        })
    }
}

/// Estimator for single pairs, with any method.
#[derive(Debug)]
pub struct Estimator {
    method: Method,
    inner: PairMethod,
}

impl Estimator {
    /// Creates an estimator with `method` for a calibrated stereo rig.
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

    /// Estimates the plane of a region in one pair of raw images.
    ///
    /// # Errors
    /// See [`EstimationMethod::estimate`].
    pub fn estimate(&mut self, request: EstimateRequest<'_>) -> Result<PlaneEstimate, EstimationError> {
        self.inner.estimate(request)
    }

    /// The visible surface of a region, see [`EstimationMethod::visible_surface`].
    ///
    /// # Errors
    /// See [`EstimationMethod::visible_surface`].
    pub fn visible_surface(&mut self, request: &EstimateRequest<'_>) -> Result<Vec<VisiblePoint>, EstimationError> {
        self.inner.visible_surface(request)
    }

    /// Switches to another rig, see [`EstimationMethod::set_rig`].
    ///
    /// # Errors
    /// A rig that the method does not support.
    pub fn set_rig(&mut self, rig: &StereoRig) -> Result<(), EstimationError> {
        self.inner.set_rig(rig)
    }

    /// Measures properties of the rig or the scene, see [`EstimationMethod::prepare`].
    ///
    /// # Errors
    /// Images that do not match the calibration.
    pub fn prepare<'a>(
        &mut self,
        left: impl Into<ImageView<'a>>,
        right: impl Into<ImageView<'a>>,
    ) -> Result<Option<RowMeasurement>, EstimationError> {
        self.inner.prepare(left.into(), right.into())
    }

    /// Uses a result of [`Self::prepare`] from another pair of the same rig or scene.
    pub fn use_rows(&mut self, measured: &RowMeasurement) {
        self.inner.use_rows(measured);
    }
}

/// Tracker for sequences, with any method.
#[derive(Debug)]
pub struct Tracker {
    method: Method,
    inner: SequenceMethod,
}

impl Tracker {
    /// Creates a tracker with `method` for a calibrated stereo rig.
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

    /// Initialises a marked target, or tracks the current target in the next pair of raw images.
    ///
    /// # Errors
    /// See [`EstimationMethod::estimate`].
    pub fn estimate(&mut self, request: EstimateRequest<'_>) -> Result<TrackEstimate, EstimationError> {
        self.inner.estimate(request)
    }

    /// Whether the last marked target was rejected and has to be marked again. Always false for the published method, which
    /// retries its region by itself.
    pub fn wants_region(&self) -> bool {
        self.inner.wants_region()
    }

    /// The recovered surface of the target in `model`, see [`EstimationMethod::surface`].
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
