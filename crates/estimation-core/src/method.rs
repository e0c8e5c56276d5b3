//! What an estimation method is asked, and what every one of them can be asked for.

use std::fmt::Debug;

use image::RgbImage;
use nalgebra::{Point3, Vector3};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};

use crate::error::EstimationError;
use crate::estimate::{EstimateWarning, PlaneEstimate, TrackEstimate};
use crate::plane_hypothesis::SearchRange;
use crate::region::Region;
use crate::row_offset::RowMeasurement;

/// One pair of raw images, and what is to be found in it.
#[derive(Debug)]
#[non_exhaustive]
pub struct EstimateRequest<'a> {
    /// Raw image of the left camera.
    pub left: &'a RgbImage,
    /// Raw image of the right camera, of the same moment.
    pub right: &'a RgbImage,
    /// A new target; `None`: the one of the request before.
    pub target: Option<MarkedTarget<'a>>,
    /// What is known before about a target that is followed.
    pub prior: FramePrior,
    /// How long the answer may take.
    pub deadline: Deadline<'a>,
}

/// A target that somebody has pointed at.
#[derive(Clone, Copy, Debug)]
pub struct MarkedTarget<'a> {
    /// Its pixels in the left image.
    pub region: &'a Region,
    /// Depths and tilts to search.
    pub range: &'a SearchRange,
}

/// What the caller knows about a frame before it is looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FramePrior {
    /// Motion of the left camera between the last exposure and this one, from the arm: only the target's own motion is then
    /// left to find.
    pub cam_left_prev_from_cam_left_now: Option<Pose<CamLeft, CamLeft>>,
    /// The expected pose, from a filter of the caller; it takes the place of the method's own prediction. Methods that do not
    /// predict leave it aside.
    pub cam_left_from_model: Option<Pose<CamLeft, Model>>,
    /// Time between the last exposure and this one, seconds; `None`: as between the two before.
    pub dt_s: Option<f64>,
}

impl FramePrior {
    /// Nothing is known but, perhaps, the motion of the camera.
    pub fn of_motion(cam_left_prev_from_cam_left_now: Option<&Pose<CamLeft, CamLeft>>) -> Self {
        Self { cam_left_prev_from_cam_left_now: cam_left_prev_from_cam_left_now.copied(), ..Self::default() }
    }
}

/// Until when a method may work: it asks between its steps, and once the caller says no, the best answer so far is judged and given.
/// The first step and the judgement always take place.
#[derive(Default)]
pub struct Deadline<'a> {
    caller: Option<&'a mut dyn FnMut() -> bool>,
    is_over: bool,
}

impl Deadline<'_> {
    /// Whether there is time for one more step; once there is none, it stays so.
    pub fn may_continue(&mut self) -> bool {
        self.is_over = self.is_over || self.caller.as_mut().is_some_and(|may_continue| !may_continue());
        !self.is_over
    }

    /// Whether a method was told to come to an end.
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
    /// A new target, with all the time that it takes.
    pub fn of_target(left: &'a RgbImage, right: &'a RgbImage, region: &'a Region, range: &'a SearchRange) -> Self {
        let target = Some(MarkedTarget { region, range });
        Self { left, right, target, prior: FramePrior::default(), deadline: Deadline::default() }
    }

    /// The next frame of the target that is followed, with all the time that it takes.
    pub fn of_next(left: &'a RgbImage, right: &'a RgbImage, prior: &FramePrior) -> Self {
        Self { left, right, target: None, prior: *prior, deadline: Deadline::default() }
    }

    /// The same for as long as the caller says that it may go on.
    pub fn until(self, may_continue: &'a mut dyn FnMut() -> bool) -> Self {
        Self { deadline: Deadline { caller: Some(may_continue), is_over: false }, ..self }
    }

    /// The target, for a method that does not follow one.
    ///
    /// # Errors
    /// If none is marked.
    pub fn marked(&self) -> Result<MarkedTarget<'a>, EstimationError> {
        self.target.ok_or(EstimationError::NotStarted)
    }
}

/// A method, for single pairs ([`PlaneEstimate`]) or for sequences ([`TrackEstimate`]).
pub trait EstimationMethod: Debug + Send {
    /// What it answers.
    type Answer: Answer;

    /// As [`Self::estimate`], without the word about a deadline.
    ///
    /// # Errors
    /// As [`Self::estimate`].
    fn answer(&mut self, request: &mut EstimateRequest<'_>) -> Result<Self::Answer, EstimationError>;

    /// Where the target is. That it cannot be known is no error but a status.
    ///
    /// The same requests give the same answers, after whatever other requests for other targets.
    ///
    /// # Errors
    /// Images that do not fit the calibration, a region that cannot serve, a bad range, or no target yet.
    fn estimate(&mut self, mut request: EstimateRequest<'_>) -> Result<Self::Answer, EstimationError> {
        let mut answer = self.answer(&mut request)?;
        if request.deadline.is_over() {
            answer.mark_cut_short();
        }
        Ok(answer)
    }

    /// Goes on with another calibrated pair of cameras; what was learned about the last one is forgotten.
    ///
    /// # Errors
    /// A rig that the method cannot use.
    fn set_rig(&mut self, rig: &StereoRig) -> Result<(), EstimationError>;

    /// Learns from a pair of raw images what belongs to the rig or the scene and not to a target, once per rig or scene; all later
    /// answers use it. `None`: the method takes rigs as they are.
    ///
    /// # Errors
    /// Images that do not fit the calibration.
    fn prepare(&mut self, left: &RgbImage, right: &RgbImage) -> Result<Option<RowMeasurement>, EstimationError> {
        let _ = (left, right);
        Ok(None)
    }

    /// Uses what [`Self::prepare`] found on another pair of the same rig or scene.
    fn use_rows(&mut self, measured: &RowMeasurement) {
        let _ = measured;
    }

    /// Whether the last marked target was not taken, so that it has to be marked again.
    fn wants_region(&self) -> bool {
        false
    }

    /// The target's surface in `model`, as far as it is known; empty before a target was found, and for a method that does not
    /// recover it.
    fn surface(&self) -> Vec<SurfacePoint> {
        Vec::new()
    }
}

/// An answer that can say that it was cut short.
pub trait Answer {
    /// Says so.
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

/// A point of a target's surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position in `model`, metres.
    pub position_in_model_m: Point3<f64>,
    /// Unit normal in `model`, towards the camera of the first frame.
    pub normal_in_model: Vector3<f64>,
    /// Red, green, blue of the first left image, 0 to 255.
    pub rgb: [u8; 3],
}
