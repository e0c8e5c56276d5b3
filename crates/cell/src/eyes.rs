//! What a run sees with: images and a method that looks at them, or the truth with noise.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use nalgebra::Point3;
use pb3dp_estimation::estimator::{FramePrior, Tracker};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_hal_api::{CameraError, FramePair, StereoCamera};
use pb3dp_setup::setup::{Leader, Setup};
use pb3dp_sim::geometric::{GeometricFrame, Hindrance, PoseSigma};

use crate::follower::Follower;

/// Where frames come from.
pub enum Sight {
    /// A camera that delivers images.
    Images(Box<dyn StereoCamera>),
    /// The truth with noise: no image is rendered.
    Geometric(Box<dyn PoseCamera>),
}

/// A camera without images: its frames are the true pose with noise.
pub trait PoseCamera: Send {
    /// Waits for the end of the next exposure.
    ///
    /// # Errors
    /// `Timeout` if there is none in this time, `BadPair` if the poses are not finite.
    fn next_frame(&mut self, timeout: Duration) -> Result<GeometricFrame, CameraError>;

    /// The noise of its poses.
    fn noise(&self) -> PoseSigma;
}

/// Who estimates the pose from what was captured.
pub enum Eyes {
    /// A method that looks at images, and what is marked in the first ones.
    Images(Box<Follower>, Marking),
    /// The truth with noise.
    Geometric(GeometricEyes),
}

/// What passes the truth with noise on as an estimate.
pub struct GeometricEyes {
    noise: PoseSigma,
    /// Above this standard deviation a tilt is not sure, radians.
    tilt_sigma_sure_rad: f64,
}

/// What is marked in the left image in which the target is taken.
#[derive(Clone, Debug)]
pub enum Marking {
    /// The outline of a simulated target, points in its own frame: what an operator would draw.
    Outline(Vec<Point3<f64>>),
    /// What the operator has marked, wherever the target truly is.
    Region(Region),
    /// Nobody has marked anything.
    Nobody,
}

/// What is said where real cameras look at nothing.
pub const NOT_MARKED: &str = "nobody has marked the target: with real cameras give --region, or set camera.region (`pb3dp cameras record` \
                              keeps what they see)";

impl Marking {
    /// The region in the left image; `cam_left_from_target` is the truth, if there is one.
    ///
    /// # Errors
    /// If a part of the outline is not before the camera, or there is no truth and no region.
    pub fn region(&self, setup: &Setup, cam_left_from_target: Option<&Pose<CamLeft, Target>>) -> Result<Region> {
        match (self, cam_left_from_target) {
            (Self::Region(region), _) => Ok(region.clone()),
            (Self::Outline(points_m), Some(pose)) => {
                let pixel = |point: &Point3<f64>| setup.true_rig().left().project(&pose.transform_point(point));
                let vertices_px: Option<Vec<_>> = points_m.iter().map(pixel).collect();
                let vertices_px = vertices_px.with_context(|| {
                    format!(
                        "the target is not in front of the camera at the beginning: where {}.start_deg puts the hand it looks elsewhere; \
                         correct that, {}.start_deg, or the places of the bases",
                        setup.rig.vs.key, setup.rig.tc.key
                    )
                })?;
                Ok(Region::Polygon { vertices_px })
            }
            (Self::Outline(_), None) | (Self::Nobody, _) => bail!("{NOT_MARKED}"),
        }
    }
}

impl Eyes {
    /// Eyes that have seen nothing yet.
    ///
    /// # Errors
    /// A parameter of the method out of its range, or a leader that does not go with `sight`.
    pub fn new(setup: &Setup, sight: &Sight, marking: Marking) -> Result<Self> {
        match (setup.leader, sight) {
            (Leader::Images(method), Sight::Images(_)) => {
                let tracker = Tracker::new(method, &setup.rig.stereo, &setup.estimator)?;
                Ok(Self::Images(Box::new(Follower::new(tracker, setup.range)), marking))
            }
            (Leader::Geometric(_), Sight::Geometric(camera)) => Ok(Self::Geometric(GeometricEyes {
                noise: camera.noise(),
                tilt_sigma_sure_rad: setup.estimator.track.tilt_sigma_sure_deg.to_radians(),
            })),
            (leader, _) => bail!("estimator.method = {:?} does not go with this camera", leader.name()),
        }
    }

    /// What is marked, as long as the target was not taken; nothing where nobody looks at images.
    ///
    /// # Errors
    /// As [`Marking::region`].
    pub fn region(
        &self,
        setup: &Setup,
        cam_left_from_target: Option<&Pose<CamLeft, Target>>,
    ) -> Result<Option<Region>> {
        match self {
            Self::Images(follower, marking) if !follower.is_started() => {
                marking.region(setup, cam_left_from_target).map(Some)
            }
            _ => Ok(None),
        }
    }

    /// Follows the target in a frame, or takes the one in `region`.
    ///
    /// # Errors
    /// If the method fails for good, or the frame is of another kind.
    pub fn estimate(&mut self, view: &View, region: Option<&Region>, prior: &FramePrior) -> Result<TrackEstimate> {
        match (self, view) {
            (Self::Images(follower, _), View::Images(pair)) => {
                Ok(follower.look(&pair.left, &pair.right, region, prior, &mut || true)?)
            }
            (Self::Geometric(eyes), View::Geometric(frame)) => Ok(eyes.estimate(frame)),
            _ => bail!("a frame of another kind of camera was captured: a mistake of the program, report it"),
        }
    }
}

impl GeometricEyes {
    fn estimate(&self, frame: &GeometricFrame) -> TrackEstimate {
        let sighting = &frame.sighting;
        let found = match (frame.hindrance, sighting.cam_left_from_model) {
            (Some(Hindrance::Blind(why)), _) => Err(why.to_owned()),
            (_, found) => found.map_err(|out_of_view| out_of_view.to_string()),
        };
        let (status, reason) = match (&found, frame.hindrance) {
            (Ok(_), Some(Hindrance::Doubtful(why))) => (Status::Ambiguous, why.to_owned()),
            (Ok(_), _) if self.noise.tilt_rad > self.tilt_sigma_sure_rad => {
                (Status::WeakTilt, "of the configured noise".to_owned())
            }
            (Ok(_), _) => (Status::Ok, "the true pose with the configured noise".to_owned()),
            (Err(why), _) if sighting.is_locked => (Status::Lost, why.clone()),
            (Err(why), _) => (Status::NotObservable, why.clone()),
        };
        let found = found.ok();
        TrackEstimate {
            status,
            reason,
            warnings: Vec::new(),
            cam_left_from_model: found,
            covariance: found.map(|_| self.noise.covariance()),
            psi: None,
            fitness: None,
            // There is no image into which it could be drawn.
            outline_px: Vec::new(),
            rotation_about_normal_observed: found.is_some(),
        }
    }
}

/// What is to be looked at.
#[derive(Clone, Debug)]
pub enum View {
    /// Two images.
    Images(Arc<FramePair>),
    /// The truth with noise.
    Geometric(Box<GeometricFrame>),
}
