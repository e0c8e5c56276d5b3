//! The direct tracker: public interface, frame by frame.

mod certainty;
mod looking;
mod starting;

use std::fmt::Write;

use nalgebra::Point3;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::{EstimationError, check_image_sizes};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior, SurfacePoint};
use pb3dp_estimation_core::region::RegionConfig;
use pb3dp_estimation_core::rig_errors::RigErrors;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_estimation_views::image_plane::PixelWindow;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};

use super::config::DirectTrackerConfig;
use super::images::CameraImages;
use super::judge::Fit;
use super::predict::Expected;
use super::repeated::{Remembered, stuck_camera};
use super::target::{Ending, Frame, Target};

/// Margin of the windows around the predicted target, pixels, if the velocity is known. Chosen by hand, not varied: a
/// larger jump needs a search; time grows with it.
const MARGIN_PX: u32 = 24;
/// The same if the velocity is unknown. Chosen by hand, not varied: twice [`MARGIN_PX`].
const MARGIN_UNSURE_PX: u32 = 2 * MARGIN_PX;
/// Time between frames if the caller does not give it, seconds: that of cameras with 30 frames per second.
const USUAL_INTERVAL_S: f64 = 1.0 / 30.0;

/// Tracks one target in six degrees of freedom.
///
/// A request with a marked target estimates its plane and relief in that pair and stores its view. Each request without one
/// estimates the pose at which a stored view explains both images of the next pair. Further unknowns are gains and offsets of
/// both images, the row offset of the right image, and the undetermined components of the surface. The tracker evaluates the
/// pose, and stores a new view if no stored one is near. A pose that does not fit is not reported: the status is `lost`, and
/// from that frame on the tracker searches the whole image for the target.
///
/// Frame `model`: origin in the plane on the ray of the region's centroid in the first left image, z along the plane's normal
/// away from the camera, x the image's x axis projected into the plane. The pose of the first frame is this definition; all
/// later poses are measured. If the region contains several surfaces, the tracker follows one of them, and the centroid is that
/// of its pixels.
///
/// The covariance is that of `xi = [rho; phi]` (metres, radians; axes of `model`) in `true = found * exp(xi)`, see
/// [`Pose::perturbed_in_from`]. It includes the uncertainty of the surface since the first frame, and is inflated if residuals
/// of neighbouring points correlate more than noise would.
///
/// If the exposures of a pair are known to differ ([`FramePrior::skew_s`]), the motion of the target in between is taken out from the second
/// frame on (docs/method.md, exposures at different times).
///
/// To track several targets, use several trackers on the same pair: they share nothing, and their costs add up.
#[derive(Clone, Debug)]
pub struct DirectTracker {
    rig: StereoRig,
    config: DirectTrackerConfig,
    kernels: Kernels,
    estimator: DirectEstimator,
    region_config: RegionConfig,
    images: [CameraImages; 2],
    /// The parts of the last images that contained the target.
    remembered: [Remembered; 2],
    target: Option<Target>,
    was_started: bool,
    /// The rig that sees the target of this frame at rest, as if both cameras exposed at once.
    rig_at_rest: StereoRig,
}

impl DirectTracker {
    /// Creates a tracker for a calibrated pair, rectified or not, with or without lens distortion; `pair` configures its cold
    /// start.
    ///
    /// # Errors
    /// A parameter out of its range, or a rig that cannot be rectified.
    pub fn new(rig: &StereoRig, pair: DirectConfig, config: DirectTrackerConfig) -> Result<Self, EstimationError> {
        Self::with_kernels(rig, pair, config, Kernels::best())
    }

    /// As [`Self::new`], with the given kernels; the estimates are identical, the speed differs.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_kernels(
        rig: &StereoRig,
        pair: DirectConfig,
        config: DirectTrackerConfig,
        kernels: Kernels,
    ) -> Result<Self, EstimationError> {
        config.validate()?;
        let region_config = pair.region;
        let estimator = DirectEstimator::with_kernels(rig, pair, kernels)?;
        let mut images: [CameraImages; 2] = Default::default();
        let mut remembered: [Remembered; 2] = Default::default();
        for (side, camera) in [rig.left(), rig.right()].into_iter().enumerate() {
            let (width, height) = (camera.size().width as usize, camera.size().height as usize);
            images[side].reserve(width, height);
            remembered[side].reserve(width * height);
        }
        Ok(Self {
            rig: *rig,
            config,
            kernels,
            estimator,
            region_config,
            images,
            remembered,
            target: None,
            was_started: false,
            rig_at_rest: *rig,
        })
    }

    /// The parameters.
    pub fn config(&self) -> &DirectTrackerConfig {
        &self.config
    }

    /// Tracks the target in the next pair without allocation: the result is written into `estimate`, whose buffers are reused.
    ///
    /// # Errors
    /// As [`EstimationMethod::estimate`].
    pub fn follow_into(
        &mut self,
        request: &mut EstimateRequest<'_>,
        estimate: &mut TrackEstimate,
    ) -> Result<(), EstimationError> {
        let EstimateRequest { left, right, ref prior, ref mut deadline, .. } = *request;
        check_image_sizes(&self.rig, left, right)?;
        let Some(mut target) = self.target.take() else {
            if !self.was_started {
                return Err(EstimationError::NotStarted);
            }
            self.report(Ending::OutOfSight, estimate);
            estimate.status = Status::NotObservable;
            estimate.reason.push_str("initialisation found no target to track: mark the target again");
            return Ok(());
        };
        let ending = self.follow(&mut target, left, right, prior, &mut || deadline.may_continue());
        if deadline.is_over() {
            // Before convergence, the equations give the covariance of a converged pose, which would be too small.
            target.covariance = None;
        }
        self.target = Some(target);
        self.report(ending, estimate);
        Ok(())
    }

    fn follow(
        &mut self,
        target: &mut Target,
        left: ImageView<'_>,
        right: ImageView<'_>,
        prior: &FramePrior,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Ending {
        target.frame += 1;
        let prior = &prior.plausible();
        target.grow_older(passed_s(prior));
        if let Some(side) = stuck_camera(&mut self.remembered, [left, right]) {
            target.away_s += passed_s(prior);
            target.motion.coast(prior);
            return Ending::Stuck(side);
        }
        let step_s = prior.dt_s.filter(|dt| *dt > 0.0 && dt.is_finite());
        let mut expected = target.motion.expect(prior);
        let motion = target.motion.between_exposures(&expected, prior);
        self.rig_at_rest = self.rig.with_motion_between_exposures(&motion);
        let (mut ending, mut unforeseen) = (Ending::OutOfSight, None);
        if target.lost_frames == 0 {
            let margin = if target.motion.is_known() { MARGIN_PX } else { MARGIN_UNSURE_PX };
            let margin = margin.max(target.margin_of_periods_px(self.rig.left().pinhole().fx));
            self.load(left, right, &expected.pose, &target.outline_in_model, margin);
            let before = target.estimate;
            let frame = Frame { rig: &self.rig, ..self.frame() };
            if let Some((rig_at_rest, pose)) = target.correct_by_second_frame(&expected, &frame, prior, may_continue) {
                self.rig_at_rest = rig_at_rest;
                expected = Expected { pose, coasted: pose };
            }
            if let Some(new_motion) = target.see_motion(&expected, &self.frame(), prior, may_continue) {
                unforeseen = Some(motion.inverse() * new_motion);
                self.rig_at_rest = self.rig.with_motion_between_exposures(&new_motion);
            }
            let frame = self.frame();
            ending = target.follow(&expected, step_s, &frame, may_continue);
            if ending != Ending::Found {
                target.estimate = before;
            }
        }
        if ending != Ending::Found {
            target.lost_frames = target.lost_frames.saturating_add(1);
            // Nothing limits how far a target moves in an unknown time.
            target.away_s += step_s.unwrap_or(f64::INFINITY);
            if may_continue() {
                let again = self.search(target, (&expected, step_s), (left, right), may_continue);
                // The misfit at the predicted pose is more informative than a failed search elsewhere.
                if matches!(again, Ending::Found | Ending::OneOfSeveral) || ending == Ending::OutOfSight {
                    ending = again;
                }
            }
        }
        if ending == Ending::Found {
            target.add_error_of_motion(prior, &self.rig, unforeseen.as_ref());
            target.add_shear_of_readout(1e-3 * self.config.rolling_shutter_millis, prior, &self.rig);
            target.accept(&self.frame(), prior);
            if target.looks_around() && may_continue() {
                self.look_around(target, (left, right), may_continue);
            }
            if target.wants_surface(prior) && may_continue() {
                self.look_at_surface(target, (left, right));
            }
        } else {
            target.motion.coast(prior);
        }
        self.remember(target, left, right);
        ending
    }

    fn frame(&self) -> Frame<'_> {
        Frame { images: &self.images, rig: &self.rig_at_rest, config: &self.config }
    }

    /// Stores the parts of both images that contained the target in its last pose.
    fn remember(&mut self, target: &Target, left: ImageView<'_>, right: ImageView<'_>) {
        let pose = target.estimate.cam_left_from_model;
        let right_pose = *self.rig_at_rest.cam_right_from_cam_left() * pose;
        let cameras = [(left, self.rig.left(), pose.isometry()), (right, self.rig.right(), right_pose.isometry())];
        for (remembered, (image, camera, cam_from_model)) in self.remembered.iter_mut().zip(cameras) {
            remembered.keep(image, &super::target::window(&target.outline_in_model, camera, cam_from_model));
        }
    }

    /// Converts a whole image.
    fn load_whole(&mut self, side: usize, image: ImageView<'_>) {
        let (width, height) = (image.width() as usize, image.height() as usize);
        self.images[side].update(image, PixelWindow { x: 0, y: 0, width, height }, self.kernels);
    }

    fn load_both(&mut self, left: ImageView<'_>, right: ImageView<'_>) {
        self.load_whole(0, left);
        self.load_whole(1, right);
    }

    /// Converts the windows around the predicted target.
    fn load(
        &mut self,
        left: ImageView<'_>,
        right: ImageView<'_>,
        pose: &Pose<CamLeft, Model>,
        outline: &[Point3<f64>],
        margin: u32,
    ) {
        let right_pose = *self.rig_at_rest.cam_right_from_cam_left() * *pose;
        let cameras = [(left, self.rig.left(), pose.isometry()), (right, self.rig.right(), right_pose.isometry())];
        for (images, (image, camera, cam_from_model)) in self.images.iter_mut().zip(cameras) {
            let window = super::target::window(outline, camera, cam_from_model).grown(margin);
            images.update(image, window, self.kernels);
        }
    }

    /// Fit of the stored view to the last frame; `None` before initialisation.
    pub fn fit(&self) -> Option<&Fit> {
        self.target.as_ref().map(|target| &target.fit)
    }

    /// Number of stored views.
    pub fn views(&self) -> usize {
        self.target.as_ref().map_or(0, |target| target.views.len())
    }

    fn report(&self, ending: Ending, out: &mut TrackEstimate) {
        (out.psi, out.fitness, out.observed, out.rotation_about_normal_observed) = (None, None, None, true);
        out.warnings.clear();
        out.reason.clear();
        out.outline_px.clear();
        (out.cam_left_from_model, out.covariance, out.first_pose_covariance, out.surface) = (None, None, None, None);
        let Some(target) = &self.target else { return };
        // Writing into a string cannot fail.
        let _ = write!(out.reason, "{ending}");
        out.status = if ending == Ending::OneOfSeveral { Status::Ambiguous } else { Status::Lost };
        if ending == Ending::Found {
            let pose = target.estimate.cam_left_from_model;
            out.cam_left_from_model = Some(pose);
            out.covariance = target.covariance;
            out.first_pose_covariance = target.first_pose_covariance;
            out.surface = target.surface_estimate();
            out.fitness = Some(target.fit.correlation[0].min(target.fit.correlation[1]));
            let doubt_m = target.doubtful_period_m();
            if let Some(period_m) = doubt_m {
                let _ = write!(
                    out.reason,
                    "the texture repeats every {:.1} mm, and neither the images nor the motion tell by how many periods the target has \
                     moved: mark the target again, with its border or a mark that is unique; except for that, ",
                    1e3 * period_m
                );
            }
            if target.is_unverified {
                out.reason.push_str(
                    "found again where it was not expected: the next pair has to confirm it; except for that, ",
                );
            }
            let covariances = [target.covariance.as_ref(), target.first_pose_covariance.as_ref()];
            (out.status, out.observed) =
                self.judge_covariance(covariances, pose.translation_m().norm(), &mut out.reason);
            out.rotation_about_normal_observed = out.observed.is_none_or(|observed| observed[5]);
            if doubt_m.is_some() || target.is_unverified {
                out.status = Status::Ambiguous;
            }
            let project = |point: &Point3<f64>| self.rig.left().project(&pose.transform_point(point));
            out.outline_px.extend(target.outline_in_model.iter().filter_map(project));
        }
    }
}

impl EstimationMethod for DirectTracker {
    type Answer = TrackEstimate;

    /// Initialises a marked target by a cold start; otherwise tracks the current target. A lost target is reported by the
    /// status. So is a target that the initialisation did not find: `not-observable` until it is marked again.
    fn answer(&mut self, request: &mut EstimateRequest<'_>) -> Result<TrackEstimate, EstimationError> {
        if request.target.is_some() {
            let prior = request.prior.plausible();
            let first = self.start(request)?;
            return Ok(self.with_errors_of_motion(first, &prior));
        }
        let mut estimate = blank();
        self.follow_into(request, &mut estimate)?;
        Ok(estimate)
    }

    fn set_rig(&mut self, rig: &StereoRig) -> Result<(), EstimationError> {
        *self = Self::with_kernels(rig, self.estimator.config().clone(), self.config, self.kernels)?;
        Ok(())
    }

    /// Keeps the target. What is known of it depends on the lenses, so those change only while there is no target.
    fn correct_rig(&mut self, rig: &StereoRig, errors: &RigErrors) -> Result<(), EstimationError> {
        self.estimator.correct_rig(rig, errors)?;
        self.rig = match self.target {
            Some(_) => {
                StereoRig::new(*self.rig.left(), *self.rig.right(), *rig.cam_right_from_cam_left()).unwrap_or(*rig)
            }
            None => *rig,
        };
        Ok(())
    }

    fn needs_new_region(&self) -> bool {
        self.target.is_none()
    }

    fn surface(&self) -> Vec<SurfacePoint> {
        self.target.as_ref().map_or_else(Vec::new, Target::surface_points)
    }
}

/// Time since the last frame, seconds.
fn passed_s(prior: &FramePrior) -> f64 {
    prior.dt_s.filter(|dt| dt.is_finite()).map_or(USUAL_INTERVAL_S, |dt| dt.max(0.0))
}

fn blank() -> TrackEstimate {
    let blank = TrackEstimate::without_pose(Status::NotObservable, String::new());
    TrackEstimate { rotation_about_normal_observed: true, ..blank }
}
