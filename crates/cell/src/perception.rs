//! Vision input of a run: images with an estimation method, or the true pose with noise.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use nalgebra::Matrix6;
use nalgebra::Point3;
use pb3dp_estimation::estimator::FramePrior;
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::method::KnownModel;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_hal_api::{CameraError, FramePair, StereoCamera};
use pb3dp_servo::supervisor::FrameInput;
use pb3dp_setup::setup::{Leader, Setup};
use pb3dp_sim::geometric::{GeometricFrame, Hindrance, PoseSigma};

use crate::follower::Follower;

/// Source of frames.
pub enum VisionInput {
    /// A camera that delivers images.
    Images(Box<dyn StereoCamera>),
    /// The true pose with noise; no image is rendered.
    Geometric(Box<dyn PoseCamera>),
}

/// A camera without images: its frames are the true pose with noise.
pub trait PoseCamera: Send {
    /// Waits for the end of the next exposure.
    ///
    /// # Errors
    /// `Timeout` if no frame arrives in this time, `BadPair` if the poses are not finite.
    fn next_frame(&mut self, timeout: Duration) -> Result<GeometricFrame, CameraError>;

    /// Standard deviations of the pose noise.
    fn noise(&self) -> PoseSigma;
}

/// Estimates the target pose from captured frames.
pub enum Perception {
    /// An image-based method, and the target marked in the first images.
    Images(Box<Follower>, TargetSource),
    /// The true pose with noise.
    Geometric(GeometricPerception),
}

/// Converts the true pose with noise into an estimate.
pub struct GeometricPerception {
    noise: PoseSigma,
    /// Above this standard deviation the tilt has low confidence, radians.
    tilt_sigma_sure_rad: f64,
}

/// How the target is marked in the left image for initialisation.
#[derive(Clone, Debug)]
pub enum TargetSource {
    /// The outline of a simulated target, points in its own frame: what an operator would draw.
    Outline(Vec<Point3<f64>>),
    /// The region that the operator marked, independent of the target's true pose.
    Region(Region),
    /// The operator selects it while the run goes on.
    FromOperator,
    /// No target is marked.
    None,
}

/// Error for real cameras without a marked target.
pub const NOT_MARKED: &str = "no target is marked: with real cameras use --region, or set camera.region (`pb3dp cameras record` saves \
                              their images)";

/// Reason of an estimate before the operator has selected a target.
pub(crate) const NOT_SELECTED: &str = "no target is selected yet: mark one in the left image";

impl TargetSource {
    /// The region in the left image; `cam_left_from_target` is the true pose, if there is one.
    ///
    /// # Errors
    /// If a part of the outline is not in front of the camera, or there is neither a true pose nor a region.
    pub fn region(&self, setup: &Setup, cam_left_from_target: Option<&Pose<CamLeft, Target>>) -> Result<Region> {
        match (self, cam_left_from_target) {
            (Self::Region(region), _) => Ok(region.clone()),
            (Self::Outline(points_m), Some(pose)) => {
                let pixel = |point: &Point3<f64>| setup.true_rig().left().project(&pose.transform_point(point));
                let vertices_px: Option<Vec<_>> = points_m.iter().map(pixel).collect();
                let vertices_px = vertices_px.with_context(|| {
                    format!(
                        "the target is not in front of the camera at the start: at {}.start_deg the camera points elsewhere; \
                         correct it, {}.start_deg, or the base poses",
                        setup.rig.arms.vs.key, setup.rig.arms.tc.key
                    )
                })?;
                Ok(Region::Polygon { vertices_px })
            }
            (Self::Outline(_), None) | (Self::FromOperator | Self::None, _) => bail!("{NOT_MARKED}"),
        }
    }
}

impl Perception {
    /// An estimator without a target yet.
    ///
    /// # Errors
    /// A method parameter out of its range, or a leading method that does not fit `vision_input`.
    pub fn new(setup: &Setup, vision_input: &VisionInput, marking: TargetSource) -> Result<Self> {
        match (setup.leader, vision_input) {
            (Leader::Images(method), VisionInput::Images(_)) => {
                Ok(Self::Images(Box::new(Follower::of_setup(setup, method)?), marking))
            }
            (Leader::Geometric(_), VisionInput::Geometric(camera)) => Ok(Self::Geometric(GeometricPerception {
                noise: camera.noise(),
                tilt_sigma_sure_rad: setup.estimator.track.tilt_sigma_sure_deg.to_radians(),
            })),
            (leader, _) => bail!("estimator.method = {:?} does not fit this camera", leader.name()),
        }
    }

    /// The marked region until the target is initialised; `None` for a method without images.
    ///
    /// # Errors
    /// As [`TargetSource::region`].
    pub fn region(
        &self,
        setup: &Setup,
        cam_left_from_target: Option<&Pose<CamLeft, Target>>,
    ) -> Result<Option<Region>> {
        match self {
            Self::Images(_, TargetSource::FromOperator) => Ok(None),
            Self::Images(follower, marking) if !follower.is_started() => {
                marking.region(setup, cam_left_from_target).map(Some)
            }
            _ => Ok(None),
        }
    }

    /// Whether a target is initialised and not given up.
    pub fn follows(&self) -> bool {
        match self {
            Self::Images(follower, _) => follower.is_started() && !follower.tracker().needs_new_region(),
            Self::Geometric(_) => true,
        }
    }

    /// Drops the target, until the operator marks another one.
    pub fn forget(&mut self) {
        if let Self::Images(follower, marking) = self {
            follower.forget();
            *marking = TargetSource::FromOperator;
        }
    }

    /// The next target had this frame `model` in the pair in which it will be initialised.
    pub fn restore(&mut self, model: Option<KnownModel>) {
        if let Self::Images(follower, _) = self {
            follower.restore(model);
        }
    }

    /// Tracks the target in a frame, or initialises it from `region`.
    ///
    /// # Errors
    /// If the method fails permanently, or the frame is of the wrong kind.
    pub fn estimate(&mut self, view: &View, region: Option<&Region>, prior: &FramePrior) -> Result<TrackEstimate> {
        match (self, view) {
            (Self::Images(follower, TargetSource::FromOperator), View::Images(_))
                if region.is_none() && !follower.is_started() =>
            {
                Ok(TrackEstimate::without_pose(Status::Lost, NOT_SELECTED.to_owned()))
            }
            (Self::Images(follower, _), View::Images(pair)) => {
                Ok(follower.look(&pair.left, &pair.right, region, prior, &mut || true)?)
            }
            (Self::Geometric(cameras), View::Geometric(frame)) => Ok(cameras.estimate(frame)),
            _ => bail!("the frame does not fit the estimation method: this is a bug, please report it"),
        }
    }
}

impl GeometricPerception {
    fn estimate(&self, frame: &GeometricFrame) -> TrackEstimate {
        let sighting = &frame.sighting;
        let found = match (frame.hindrance, sighting.cam_left_from_model) {
            (Some(Hindrance::Blind(why)), _) => Err(why.to_owned()),
            (_, found) => found.map_err(|out_of_view| out_of_view.to_string()),
        };
        let (status, reason) = match (&found, frame.hindrance) {
            (Ok(_), Some(Hindrance::Doubtful(why))) => (Status::Ambiguous, why.to_owned()),
            (Ok(_), _) if self.noise.tilt_rad > self.tilt_sigma_sure_rad => {
                (Status::WeakTilt, "the configured noise".to_owned())
            }
            (Ok(_), _) => (Status::Ok, "the true pose with the configured noise".to_owned()),
            (Err(why), _) if sighting.is_locked => (Status::Lost, why.clone()),
            (Err(why), _) => (Status::NotObservable, why.clone()),
        };
        let found = found.ok();
        TrackEstimate {
            cam_left_from_model: found,
            covariance: found.map(|_| self.noise.covariance()),
            // The model is the true target, and each pose is measured anew.
            first_pose_covariance: found.map(|_| Matrix6::zeros()),
            pose_covariance: found.map(|_| self.noise.covariance()),
            observed: found.map(|_| [true; 6]),
            rotation_about_normal_observed: found.is_some(),
            // There is no image to draw an outline into.
            ..TrackEstimate::without_pose(status, reason)
        }
    }
}

/// Input of an estimation method.
#[derive(Clone, Debug)]
pub enum View {
    /// A stereo pair.
    Images(Arc<FramePair>),
    /// The true pose with noise.
    Geometric(Box<GeometricFrame>),
    /// Neither is at hand: a recorded estimate without its images.
    Nothing,
}

/// One frame for estimation and recording.
#[derive(Clone, Debug)]
pub struct Captured {
    /// Sequence number and times.
    pub frame: FrameInput,
    /// True target pose at exposure; none with real cameras.
    pub cam_left_from_target: Option<Pose<CamLeft, Target>>,
    /// Input of the estimation method.
    pub view: View,
}
