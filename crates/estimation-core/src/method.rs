//! The request to an estimation method, and the trait that all methods implement.

use std::fmt::Debug;

use nalgebra::{Matrix6, Point3, UnitQuaternion, Vector2, Vector3};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};

use crate::error::EstimationError;
use crate::estimate::{EstimateWarning, PlaneEstimate, TrackEstimate};
use crate::image_view::ImageView;
use crate::plane_hypothesis::SearchRange;
use crate::region::Region;
use crate::rig_errors::RigErrors;

/// One pair of raw images, and the target to estimate in it.
#[derive(Debug)]
#[non_exhaustive]
pub struct EstimateRequest<'a> {
    /// Raw image of the left camera.
    pub left: ImageView<'a>,
    /// Raw image of the right camera, exposed at the same time, or later by [`FramePrior::skew_s`].
    pub right: ImageView<'a>,
    /// A new target; `None` keeps the target of the previous request.
    pub target: Option<MarkedTarget<'a>>,
    /// Prior knowledge about a tracked target.
    pub prior: FramePrior,
    /// Time limit of the estimate.
    pub deadline: Deadline<'a>,
}

/// A target that the operator has marked.
#[derive(Clone, Copy, Debug)]
pub struct MarkedTarget<'a> {
    /// Pixels of the target in the left image.
    pub region: &'a Region,
    /// Depths and tilts to search.
    pub range: &'a SearchRange,
    /// The frame `model` that the target had before; without it, this pair defines it. Methods that only follow planes ignore it.
    pub model: Option<&'a KnownModel>,
}

/// The frame `model` of a target that was followed before, in the pair in which it is marked again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownModel {
    /// Its pose in this pair.
    pub cam_left_from_model: Pose<CamLeft, Model>,
    /// Covariance of the pose that defined it, against the visible surface.
    pub first_pose_covariance: Matrix6<f64>,
}

/// Prior knowledge of the caller about a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FramePrior {
    /// Motion of the left camera between the previous exposure and this one, from the arm. With it the tracker only has to
    /// estimate the target's own motion.
    pub cam_left_prev_from_cam_left_now: Option<Pose<CamLeft, CamLeft>>,
    /// Predicted pose from a filter of the caller; it replaces the method's own prediction. Methods without prediction ignore
    /// it.
    pub cam_left_from_model: Option<Pose<CamLeft, Model>>,
    /// Time between the previous exposure and this one, seconds; `None`: the same as the previous interval.
    pub dt_s: Option<f64>,
    /// Middle of the right exposure minus middle of the left one, seconds; 0: both at once. A tracker with a model of the motion takes the
    /// target's motion in this time into account, if [`Self::dt_s`] is known too.
    pub skew_s: f64,
    /// Standard deviation of [`Self::skew_s`], seconds: of one that was estimated. The motion of the target in this time is in the covariance.
    pub skew_sigma_s: f64,
}

impl FramePrior {
    /// A prior with the camera motion only, if it is known.
    pub fn of_motion(cam_left_prev_from_cam_left_now: Option<&Pose<CamLeft, CamLeft>>) -> Self {
        Self { cam_left_prev_from_cam_left_now: cam_left_prev_from_cam_left_now.copied(), ..Self::default() }
    }

    /// A prior with the skew only.
    pub fn of_skew(skew_s: f64) -> Self {
        Self { skew_s, ..Self::default() }
    }

    /// Without what cannot be true: numbers that are not finite, a rotation that is none, a skew above [`SKEW_MAX_S`], a camera that moved by more than [`CAMERA_STEP_MAX_M`] or
    /// [`CAMERA_TURN_MAX_RAD`], a target behind the camera or farther than [`TARGET_MAX_M`]. A wrong prior then costs accuracy of a
    /// prediction, not the target.
    #[must_use]
    pub fn plausible(&self) -> Self {
        // A caller may have made it without a check.
        let is_rotation = |rotation: &UnitQuaternion<f64>| (rotation.norm() - 1.0).abs() < 1e-6;
        let is_step = |motion: &Pose<CamLeft, CamLeft>| is_rotation(&motion.rotation()) && is_plausible_step(motion);
        let is_target = |pose: &Pose<CamLeft, Model>| {
            let at_m = pose.translation_m();
            pose.is_finite() && is_rotation(&pose.rotation()) && at_m.z > 0.0 && at_m.norm() <= TARGET_MAX_M
        };
        Self {
            cam_left_prev_from_cam_left_now: self.cam_left_prev_from_cam_left_now.filter(is_step),
            cam_left_from_model: self.cam_left_from_model.filter(is_target),
            dt_s: self.dt_s.filter(|dt_s| dt_s.is_finite() && *dt_s > 0.0),
            skew_s: if self.skew_s.abs() <= SKEW_MAX_S { self.skew_s } else { 0.0 },
            skew_sigma_s: if self.skew_sigma_s >= 0.0 { self.skew_sigma_s.min(SKEW_MAX_S) } else { 0.0 },
        }
    }
}

/// Whether a motion is finite and no larger than [`CAMERA_STEP_MAX_M`] and [`CAMERA_TURN_MAX_RAD`].
pub fn is_plausible_step(motion: &Pose<CamLeft, CamLeft>) -> bool {
    motion.is_finite()
        && motion.translation_m().norm() <= CAMERA_STEP_MAX_M
        && motion.rotation_angle_rad() <= CAMERA_TURN_MAX_RAD
}

/// Largest plausible time between the exposures of a pair: three periods of 30 per second.
pub const SKEW_MAX_S: f64 = 0.1;
/// Largest plausible motion of the camera between two exposures. A hand moves by centimetres; after a gap of seconds nothing is predicted
/// well.
pub const CAMERA_STEP_MAX_M: f64 = 1.0;
/// Largest plausible turn of the camera between two exposures.
pub const CAMERA_TURN_MAX_RAD: f64 = 1.5;
/// Largest plausible distance of a target.
pub const TARGET_MAX_M: f64 = 100.0;

/// Time limit of a method. The method checks it between its steps; once it has passed, the method evaluates and returns the
/// best estimate so far. The first step and the final evaluation always run.
#[derive(Default)]
pub struct Deadline<'a> {
    caller: Option<&'a mut dyn FnMut() -> bool>,
    is_over: bool,
}

impl Deadline<'_> {
    /// Whether there is time for one more step. Once false, it stays false.
    pub fn may_continue(&mut self) -> bool {
        self.is_over = self.is_over || self.caller.as_mut().is_some_and(|may_continue| !may_continue());
        !self.is_over
    }

    /// Whether the deadline has stopped the method.
    pub fn is_over(&self) -> bool {
        self.is_over
    }
}

impl Debug for Deadline<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Deadline").field("is_over", &self.is_over).finish_non_exhaustive()
    }
}

impl<'a> EstimateRequest<'a> {
    /// Request for a new target, without a time limit.
    pub fn new_target(
        left: impl Into<ImageView<'a>>,
        right: impl Into<ImageView<'a>>,
        region: &'a Region,
        range: &'a SearchRange,
    ) -> Self {
        let target = Some(MarkedTarget { region, range, model: None });
        let (left, right) = (left.into(), right.into());
        Self { left, right, target, prior: FramePrior::default(), deadline: Deadline::default() }
    }

    /// Request for the next frame of the tracked target, without a time limit.
    pub fn next_frame(left: impl Into<ImageView<'a>>, right: impl Into<ImageView<'a>>, prior: &FramePrior) -> Self {
        let (left, right) = (left.into(), right.into());
        Self { left, right, target: None, prior: *prior, deadline: Deadline::default() }
    }

    /// Adds the frame `model` that a new target had before, if it had one.
    #[must_use]
    pub fn with_model(mut self, model: Option<&'a KnownModel>) -> Self {
        self.target = self.target.map(|target| MarkedTarget { model, ..target });
        self
    }

    /// Adds the skew of the pair, see [`FramePrior::skew_s`]: that of a new target's first pair.
    #[must_use]
    pub fn with_skew(mut self, skew_s: f64) -> Self {
        self.prior.skew_s = skew_s;
        self
    }

    /// Adds a deadline: the method continues while `may_continue` returns true.
    pub fn until(self, may_continue: &'a mut dyn FnMut() -> bool) -> Self {
        Self { deadline: Deadline { caller: Some(may_continue), is_over: false }, ..self }
    }

    /// The marked target, for a method that does not track.
    ///
    /// # Errors
    /// If no target is marked.
    pub fn marked(&self) -> Result<MarkedTarget<'a>, EstimationError> {
        self.target.ok_or(EstimationError::NotStarted)
    }
}

/// An estimation method, for single pairs ([`PlaneEstimate`]) or for sequences ([`TrackEstimate`]).
pub trait EstimationMethod: Debug + Send {
    /// Type of the estimate.
    type Answer: Answer;

    /// Same as [`Self::estimate`], without the warning about a deadline.
    ///
    /// # Errors
    /// As [`Self::estimate`].
    fn answer(&mut self, request: &mut EstimateRequest<'_>) -> Result<Self::Answer, EstimationError>;

    /// Estimates the pose of the target. A pose that cannot be determined is reported by the status, not by an error.
    ///
    /// The result is deterministic: it depends on the requests for this target only, not on earlier targets.
    ///
    /// # Errors
    /// Images that do not match the calibration, an unsuitable region, an invalid range, or no target yet.
    fn estimate(&mut self, mut request: EstimateRequest<'_>) -> Result<Self::Answer, EstimationError> {
        let mut answer = self.answer(&mut request)?;
        if request.deadline.is_over() {
            answer.mark_cut_short();
        }
        Ok(answer)
    }

    /// Switches to another stereo rig; everything learned about the previous rig is discarded.
    ///
    /// # Errors
    /// A rig that the method does not support.
    fn set_rig(&mut self, rig: &StereoRig) -> Result<(), EstimationError>;

    /// Continues with a rig whose small errors were corrected; `errors` are those, with the covariance that remains. A method that does not
    /// use them starts anew.
    ///
    /// # Errors
    /// A rig that the method does not support.
    fn correct_rig(&mut self, rig: &StereoRig, errors: &RigErrors) -> Result<(), EstimationError> {
        let _ = errors;
        self.set_rig(rig)
    }

    /// Whether the last marked target was rejected and has to be marked again.
    fn needs_new_region(&self) -> bool {
        false
    }

    /// The recovered surface of the target in `model`. Empty before a target was found, and for methods that do not recover the
    /// surface.
    fn surface(&self) -> Vec<SurfacePoint> {
        Vec::new()
    }

    /// The visible surface of a marked region in one pair, pixel by pixel, for objects that are no plane. Takes some milliseconds more than
    /// an estimate. Empty for methods that find planes only.
    ///
    /// # Errors
    /// As [`Self::estimate`]; too few pixels of the region have a match in the right image.
    fn visible_surface(&mut self, request: &EstimateRequest<'_>) -> Result<Vec<VisiblePoint>, EstimationError> {
        let _ = request;
        Ok(Vec::new())
    }
}

/// An estimate that can be marked as stopped by the deadline.
pub trait Answer {
    /// Marks the estimate as stopped by the deadline.
    fn mark_cut_short(&mut self);
}

impl Answer for PlaneEstimate {
    fn mark_cut_short(&mut self) {
        self.warnings.push(EstimateWarning::CutShort);
    }
}

impl Answer for TrackEstimate {
    fn mark_cut_short(&mut self) {
        self.reason.push_str("; ");
        self.reason.push_str(&EstimateWarning::CutShort.to_string());
    }
}

/// A point on the target's surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position in `model`, metres.
    pub position_in_model_m: Point3<f64>,
    /// Unit normal in `model`, towards the camera of the first frame.
    pub normal_in_model: Vector3<f64>,
    /// Standard deviation along the ray of the first left image, metres. Errors of neighbours are not independent.
    pub sigma_m: f64,
    /// Red, green, blue in the first left image, 0 to 255.
    pub rgb: [u8; 3],
}

/// A point of the visible surface of a region, from one pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisiblePoint {
    /// Where the left image shows it, pixels of the raw image.
    pub pixel_px: Vector2<f64>,
    /// Position in `cam_left`, metres.
    pub position_in_cam_left_m: Point3<f64>,
    /// Standard deviation along the ray of the pixel, metres. Errors of neighbours are not independent.
    pub sigma_m: f64,
    /// Whether the pixel has a match in the right image; otherwise its neighbours do.
    pub is_measured: bool,
    /// Red, green, blue in the left image, 0 to 255.
    pub rgb: [u8; 3],
}
