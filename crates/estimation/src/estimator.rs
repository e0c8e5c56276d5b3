//! Entry point: estimators and trackers, selected by the name of their method.

use std::fmt;
use std::str::FromStr;

use nalgebra::{Matrix6, Vector3, Vector6};

use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::{EstimateWarning, PlaneEstimate, TrackEstimate};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::rig_errors::RigErrors;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_estimation_published::estimator::PublishedConfig;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};

use crate::calibration_term::{CalibrationTerm, FirstPair};
use crate::rig_watch::{KnownTarget, MotionSigmas, RigWatch};
use crate::skew_watch::SkewWatch;

use pb3dp_estimation_core::method::{Answer, EstimationMethod};
pub use pb3dp_estimation_core::method::{EstimateRequest, FramePrior, SurfacePoint, VisiblePoint};
use pb3dp_estimation_published::estimator::{PublishedEstimator, PublishedTracker};
use pb3dp_estimation_track::DirectTracker;
pub use pb3dp_estimation_track::DirectTrackerConfig;

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

/// Estimator for single pairs, with any method. Every pair is compared with the calibration, see [`RigWatch`].
#[derive(Debug)]
pub struct Estimator {
    method: Method,
    inner: PairMethod,
    watch: RigWatch,
    /// The rig that `inner` has.
    rig: StereoRig,
}

impl Estimator {
    /// Creates an estimator with `method` for a calibrated stereo rig.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(method: Method, rig: &StereoRig, config: &EstimatorConfig) -> Result<Self, EstimationError> {
        Ok(Self { method, inner: method.for_pairs(rig, config)?, watch: RigWatch::new(rig)?, rig: *rig })
    }

    /// The method.
    pub fn method(&self) -> Method {
        self.method
    }

    /// Estimates the plane of a region in one pair of raw images.
    ///
    /// # Errors
    /// See [`EstimationMethod::estimate`].
    pub fn estimate(&mut self, mut request: EstimateRequest<'_>) -> Result<PlaneEstimate, EstimationError> {
        if !self.watch.has_sampled_whole() {
            self.look(request.left, request.right)?;
        }
        let mut estimate = self.inner.answer(&mut request)?;
        let is_another = self.watch.errors().is_none() && self.look_at_target(&request, &estimate)?;
        if is_another && request.deadline.may_continue() {
            estimate = self.inner.answer(&mut request)?;
        }
        if request.deadline.is_over() {
            estimate.mark_cut_short();
        }
        if let Some(objection) = self.watch.objection() {
            (estimate.status, estimate.reason) = (Status::Miscalibrated, objection);
        }
        estimate.warnings.extend(self.watch.warning());
        if self.watch.errors().is_none() && estimate.pose.is_some() {
            estimate.warnings.push(EstimateWarning::RigUnchecked);
        }
        Ok(estimate)
    }

    /// Compares the rows of the target with the calibration; whether that changes what the method knows of the rig.
    fn look_at_target(
        &mut self,
        request: &EstimateRequest<'_>,
        estimate: &PlaneEstimate,
    ) -> Result<bool, EstimationError> {
        let Some((pose, target)) = estimate.pose.zip(request.target) else { return Ok(false) };
        let target = KnownTarget {
            region: target.region,
            inverse_depth_plane: pose.inverse_depth_plane,
            row_offset_px: estimate.row_offset_px.unwrap_or(0.0),
            cam_left_later_from_cam_left: Pose::coincident(),
            motion_sigmas: MotionSigmas::default(),
        };
        self.watch.look_at_target((request.left, request.right), &target);
        let is_changed = correct(&mut *self.inner, &self.watch, (self.method, true), &mut self.rig)?;
        Ok(is_changed && self.watch.errors().is_some())
    }

    /// The visible surface of a region, see [`EstimationMethod::visible_surface`].
    ///
    /// # Errors
    /// See [`EstimationMethod::visible_surface`].
    pub fn visible_surface(&mut self, request: &EstimateRequest<'_>) -> Result<Vec<VisiblePoint>, EstimationError> {
        if self.watch.errors().is_none() {
            self.look(request.left, request.right)?;
        }
        self.inner.visible_surface(request)
    }

    /// Switches to another rig, see [`EstimationMethod::set_rig`].
    ///
    /// # Errors
    /// A rig that the method does not support.
    pub fn set_rig(&mut self, rig: &StereoRig) -> Result<(), EstimationError> {
        self.watch = RigWatch::new(rig)?;
        self.rig = *rig;
        self.inner.set_rig(rig)
    }

    /// Compares a pair with the calibration, for this and later estimates. [`Self::estimate`] does it only until one look has found enough
    /// points; it takes some milliseconds.
    ///
    /// # Errors
    /// Images that do not match the calibration.
    pub fn look<'a>(
        &mut self,
        left: impl Into<ImageView<'a>>,
        right: impl Into<ImageView<'a>>,
    ) -> Result<RigErrors, EstimationError> {
        self.watch.allow_time();
        let measured = self.watch.look(left, right)?;
        correct(&mut *self.inner, &self.watch, (self.method, true), &mut self.rig)?;
        Ok(measured)
    }

    /// What the pairs so far have shown of the rig.
    pub fn watch(&self) -> &RigWatch {
        &self.watch
    }

    /// Continues with what other pairs of the same rig have shown.
    pub fn use_watch(&mut self, watch: RigWatch) {
        self.watch = watch;
    }
}

/// Hands a method what is known of the rig, if it can use that; whether it does.
fn correct<A: Answer>(
    inner: &mut dyn EstimationMethod<Answer = A>,
    watch: &RigWatch,
    (method, may_restart): (Method, bool),
    rig: &mut StereoRig,
) -> Result<bool, EstimationError> {
    let is_wanted = match method {
        Method::Direct => true,
        Method::Published => may_restart && watch.has_moved() && rig != watch.rig(),
    };
    if is_wanted {
        inner.correct_rig(watch.rig(), watch.believed())?;
        *rig = *watch.rig();
    }
    Ok(is_wanted)
}

/// Tracker for sequences, with any method. The pairs are compared with the calibration from time to time, and after a jump of the pose or a
/// loss, see [`RigWatch`].
#[derive(Debug)]
pub struct Tracker {
    method: Method,
    inner: SequenceMethod,
    watch: RigWatch,
    /// The rig that `inner` has.
    rig: StereoRig,
    /// Pairs since the last look at the rig.
    pairs: u32,
    was_sure: bool,
    steps: Steps,
    /// For pairs whose skew nobody has stated.
    skew: Option<Box<SkewWatch>>,
    /// Whether the skew of all pairs is stated, also if it is zero.
    is_skew_stated: bool,
    /// The skew of the pairs that `watch` has seen, seconds.
    watched_skew_s: f64,
    /// Whether a warning has said that the images do not show the rig, since the target was marked.
    is_warned_unchecked: bool,
    /// The errors of the calibration, if they are known.
    calibration: Option<Box<CalibrationTerm>>,
    /// The first pair of the target, and their share in its pose.
    first_pair: Option<(FirstPair, Option<Matrix6<f64>>)>,
    /// Whether the frame `model` of the target was defined before; the covariance of the first pose has the share of the calibration then.
    is_restored: bool,
}

/// Rows show errors of the rig only if both cameras expose at once, to this time, seconds: at 100 mm/s and 0.5 m rows differ by 0.15 px.
const SKEW_FOR_ROWS_S: f64 = 1e-3;
/// Time between pairs if the caller does not give it, seconds: that of cameras with 30 pairs per second.
const USUAL_INTERVAL_S: f64 = 1.0 / 30.0;
/// Pairs between two looks at the rig. Chosen by hand, not varied: a look takes as long as some pairs.
const LOOK_EVERY: u32 = 10;
/// A pose has jumped if its step from the last one differs by more than this from the step before: radians, share of the distance, and
/// standard deviations of the pose. Chosen by hand, not varied: a jump costs a look at the rig, and a hand that accelerates makes smaller ones.
const JUMP_RAD: f64 = 0.009;
const JUMP_SHARE: f64 = 0.005;
const JUMP_SIGMAS: f64 = 5.0;

/// The last pose, and the step that led to it.
#[derive(Clone, Copy, Debug, Default)]
struct Steps {
    last: Option<Pose<CamLeft, Model>>,
    /// The step, `[rho; phi]` in axes of `model`, and its duration, seconds.
    step: Option<(Vector6<f64>, f64)>,
    /// Velocity in the middle of the step per second, and its change per second.
    motion: Option<[Vector6<f64>; 2]>,
}

impl Steps {
    /// Takes the next estimate; whether its pose has jumped.
    fn has_jumped(&mut self, estimate: &TrackEstimate, dt_s: f64) -> bool {
        let pose = estimate.cam_left_from_model;
        let step = pose.zip(self.last).map(|(now, last)| ((last.inverse() * now).log(), dt_s));
        let change = step.zip(self.step).map(|((now, dt_s), (before, before_s))| now - before * (dt_s / before_s));
        self.motion = step.zip(self.step).map(|((now, dt_s), (before, before_s))| {
            [now / dt_s, (now / dt_s - before / before_s) / (0.5 * (dt_s + before_s))]
        });
        (self.last, self.step) = (pose, step);
        let Some((change, pose)) = change.zip(pose) else { return false };
        let variances = estimate.covariance.map_or(Vector6::zeros(), |covariance| covariance.diagonal());
        let is_beyond = |first: usize, limit: f64| {
            let sigma = variances.fixed_rows::<3>(first).sum().max(0.0).sqrt();
            change.fixed_rows::<3>(first).norm() > limit.max(JUMP_SIGMAS * sigma)
        };
        is_beyond(0, JUMP_SHARE * pose.translation_m().norm()) || is_beyond(3, JUMP_RAD)
    }

    /// The motion in a time after the last pose, and the part of it that its acceleration makes.
    fn after(&self, duration_s: f64) -> Option<[Vector6<f64>; 2]> {
        let ([velocity, acceleration], (_, dt_s)) = self.motion.zip(self.step)?;
        let unforeseen = acceleration * (0.5 * (dt_s + duration_s) * duration_s);
        Some([velocity * duration_s + unforeseen, unforeseen])
    }
}

impl Tracker {
    /// Creates a tracker with `method` for a calibrated stereo rig.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(method: Method, rig: &StereoRig, config: &EstimatorConfig) -> Result<Self, EstimationError> {
        let watch = RigWatch::new(rig)?;
        Ok(Self {
            method,
            inner: method.for_sequences(rig, config)?,
            watch,
            rig: *rig,
            pairs: 0,
            was_sure: false,
            steps: Steps::default(),
            skew: None,
            is_skew_stated: false,
            watched_skew_s: 0.0,
            is_warned_unchecked: false,
            calibration: None,
            first_pair: None,
            is_restored: false,
        })
    }

    /// With the errors of the calibration, whose share the estimates then state.
    #[must_use]
    pub fn with_calibration(self, term: Option<CalibrationTerm>) -> Self {
        Self { calibration: term.map(Box::new), ..self }
    }

    /// The method.
    pub fn method(&self) -> Method {
        self.method
    }

    /// Estimates the skew of the pairs that follow from the motion of the target, see [`SkewWatch`], takes out what it finds, and warns if it
    /// cannot. For pairs whose skew nobody has stated; those that state one are left alone. Only the method `direct` can use a skew.
    ///
    /// # Errors
    /// A rig that cannot be rectified.
    pub fn watch_skew(&mut self, is_wanted: bool) -> Result<(), EstimationError> {
        self.skew = match is_wanted && self.method == Method::Direct {
            true => Some(Box::new(SkewWatch::new(self.watch.calibrated())?)),
            false => None,
        };
        Ok(())
    }

    /// Compares the skew that is stated for all pairs with the motion of the target, and warns if it contradicts.
    ///
    /// # Errors
    /// A rig that cannot be rectified.
    pub fn check_skew(&mut self) -> Result<(), EstimationError> {
        self.is_skew_stated = true;
        self.watch_skew(true)
    }

    /// What the pairs so far have shown of their skew.
    pub fn skew(&self) -> Option<&SkewWatch> {
        self.skew.as_deref()
    }

    /// Initialises a marked target, or tracks the current target in the next pair of raw images.
    ///
    /// # Errors
    /// See [`EstimationMethod::estimate`].
    pub fn estimate(&mut self, mut request: EstimateRequest<'_>) -> Result<TrackEstimate, EstimationError> {
        let (left, right, is_new) = (request.left, request.right, request.target.is_some());
        request.prior = request.prior.plausible();
        let (is_stated, dt_s) =
            (self.is_skew_stated || request.prior.skew_s != 0.0, request.prior.dt_s.unwrap_or(USUAL_INTERVAL_S));
        if let Some(found) = self.skew.as_ref().filter(|_| !is_stated).and_then(|skew| skew.found()) {
            (request.prior.skew_s, request.prior.skew_sigma_s) = (found.skew_s, found.sigma_s);
        }
        self.pairs += 1;
        if (request.prior.skew_s - self.watched_skew_s).abs() >= SKEW_FOR_ROWS_S {
            self.forget_rig(request.prior.skew_s)?;
        }
        let shows_rig = self.shows_rig();
        let is_due = is_new || self.pairs >= LOOK_EVERY || self.watch.is_in_doubt();
        if shows_rig && is_due {
            self.look(left, right, is_new)?;
        }
        let mut estimate = self.inner.answer(&mut request)?;
        if is_new {
            let known = request.target.and_then(|target| target.model);
            self.is_restored =
                known.is_some_and(|known| estimate.cam_left_from_model == Some(known.cam_left_from_model));
            (self.steps, self.is_warned_unchecked) = (Steps::default(), false);
        }
        let has_jumped = self.steps.has_jumped(&estimate, dt_s);
        if is_due && (!shows_rig || self.watch.errors().is_none()) {
            self.look_at_target(&mut request, &mut estimate)?;
        }
        if request.deadline.is_over() {
            estimate.mark_cut_short();
        }
        let is_sure = estimate.status.depth_is_sure();
        if shows_rig && ((self.was_sure && !is_sure) || has_jumped) && self.pairs > 0 {
            // Have the cameras moved?
            self.look(left, right, false)?;
        }
        self.was_sure = is_sure;
        if let Some(skew) = self.skew.as_mut().filter(|_| is_stated == self.is_skew_stated) {
            skew.take((left, right), (dt_s, request.prior.skew_s), &estimate);
            let news = if self.is_skew_stated { skew.contradiction(request.prior.skew_s) } else { skew.news() };
            estimate.warnings.extend(news);
        }
        if is_new {
            estimate.warnings.extend(self.watch.warning());
        }
        if let Some(objection) = self.watch.objection() {
            (estimate.status, estimate.reason) = (Status::Miscalibrated, objection);
        }
        self.sum_up(&mut estimate, is_new);
        Ok(estimate)
    }

    /// Completes the covariances of an estimate: the share of the calibration, and the sum. The errors of the calibration in the first pose and
    /// in the present one are nearly the same, so the sum has the share in the present pose instead of both.
    fn sum_up(&mut self, estimate: &mut TrackEstimate, is_new: bool) {
        if is_new {
            self.first_pair = None;
        }
        estimate.pose_covariance = match (estimate.covariance, estimate.first_pose_covariance) {
            (Some(of_motion), Some(of_first)) => {
                Some(if is_new && !self.is_restored { of_first } else { of_first + of_motion })
            }
            _ => None,
        };
        let (Some(term), Some(pose)) = (&self.calibration, estimate.cam_left_from_model) else { return };
        if self.first_pair.is_none() {
            let first_pair = FirstPair::of_outline(self.watch.calibrated(), &pose, &estimate.outline_px);
            self.first_pair = first_pair.map(|first_pair| {
                let share = term.share_of_first(&first_pair);
                (first_pair, share)
            });
        }
        let Some((first_pair, share_of_first)) = &self.first_pair else { return };
        estimate.calibration = term.share(first_pair, &pose);
        let add = |to: &mut Option<Matrix6<f64>>, share: Option<Matrix6<f64>>| {
            *to = to.zip(share).map(|(to, share)| to + share)
        };
        add(&mut estimate.pose_covariance, estimate.calibration.map(|share| share.pose));
        if self.is_restored {
            return;
        }
        add(&mut estimate.first_pose_covariance, *share_of_first);
        if let (Some(surface), Some(share)) = (&mut estimate.surface, share_of_first) {
            surface.covariance += share;
        }
    }

    /// Whether the rows of the whole image show the rig: both cameras expose at once.
    fn shows_rig(&self) -> bool {
        self.watched_skew_s.abs() < SKEW_FOR_ROWS_S
    }

    /// Forgets what rows have shown that were not of the moments that they were taken for.
    fn forget_rig(&mut self, skew_s: f64) -> Result<(), EstimationError> {
        self.watched_skew_s = skew_s;
        let calibrated = *self.watch.calibrated();
        self.watch = RigWatch::new(&calibrated)?;
        correct(&mut *self.inner, &self.watch, (self.method, false), &mut self.rig).map(drop)
    }

    /// Compares the rows of the target, whose motion between the exposures is known, with the calibration. A new target is estimated again if
    /// they show another rig. Warns if they show nothing.
    fn look_at_target(
        &mut self,
        request: &mut EstimateRequest<'_>,
        estimate: &mut TrackEstimate,
    ) -> Result<(), EstimationError> {
        let Some(pose) = estimate.cam_left_from_model else { return Ok(()) };
        let [motion, unforeseen] = match (self.shows_rig(), self.steps.after(request.prior.skew_s)) {
            (true, _) => [Vector6::zeros(); 2],
            (false, Some(motion)) => motion,
            (false, None) => return Ok(()),
        };
        let in_cam_left = |part: usize| pose.transform_vector(&unforeseen.fixed_rows::<3>(part).into_owned());
        let ([x, y, z], [roll, pitch, yaw]) = (in_cam_left(0).into(), in_cam_left(3).into());
        let unforeseen = Vector6::new(x, y, z, roll, pitch, yaw);
        let normal = pose.transform_vector(&Vector3::z());
        let target = KnownTarget {
            region: &Region::Polygon { vertices_px: estimate.outline_px.clone() },
            inverse_depth_plane: normal / normal.dot(&pose.translation_m()),
            row_offset_px: 0.0,
            cam_left_later_from_cam_left: pose * Pose::exp(&motion) * pose.inverse(),
            motion_sigmas: MotionSigmas::of(&unforeseen, pose.translation_m().z),
        };
        let (knew, is_new) = (self.watch.has_moved(), request.target.is_some());
        self.pairs = 0;
        self.watch.look_at_target((request.left, request.right), &target);
        let is_another = is_new && self.watch.has_moved() && !knew && request.deadline.may_continue();
        if is_another {
            let calibrated = *self.watch.calibrated();
            self.inner.set_rig(&calibrated)?;
        }
        correct(&mut *self.inner, &self.watch, (self.method, is_new), &mut self.rig)?;
        if is_another {
            *estimate = self.inner.answer(request)?;
            self.steps = Steps { last: estimate.cam_left_from_model, ..Steps::default() };
        }
        if self.watch.errors().is_none() && !self.is_warned_unchecked {
            self.is_warned_unchecked = true;
            estimate.warnings.push(EstimateWarning::RigUnchecked);
        }
        Ok(())
    }

    fn look(&mut self, left: ImageView<'_>, right: ImageView<'_>, is_new: bool) -> Result<(), EstimationError> {
        self.pairs = 0;
        if is_new {
            self.watch.allow_time();
        }
        self.watch.look(left, right)?;
        correct(&mut *self.inner, &self.watch, (self.method, is_new), &mut self.rig).map(drop)
    }

    /// What the pairs so far have shown of the rig.
    pub fn watch(&self) -> &RigWatch {
        &self.watch
    }

    /// Whether the last marked target was rejected and has to be marked again. Always false for the published method, which
    /// retries its region by itself.
    pub fn needs_new_region(&self) -> bool {
        self.inner.needs_new_region()
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
