//! Whether the images of a rig still agree with its calibration, pair by pair.
//!
//! A rig that was knocked, bent by heat, or calibrated with other cameras shows the same point on different rows of the rectified images.
//! [`RigWatch`] measures that, corrects what the rows determine, and objects if the correction is larger than that of a rig which was once
//! calibrated properly: then what no row shows (yaw, baseline) has probably changed as much.

use pb3dp_estimation_core::Argument;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::EstimateWarning;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::rig_errors::{MOVED_FROM, ROLL, RigErrors, SCALE};
use pb3dp_estimation_direct::row_measurement::is_enough;
pub use pb3dp_estimation_direct::row_measurement::{KnownTarget, MATCHES_MIN, MotionSigmas, RowMeter};
use pb3dp_geometry::{Distortion, Rectification, StereoRig};

/// Row offset anywhere in the image above which a calibration is not used: 1.5 px, or 2 mrad if that is more. Chosen with figures: real rigs
/// stay below 0.6 px; a yaw of 2 mrad, which no row shows, is an error of 1 % of the depth at a distance of five baselines.
const OFFSET_MAX_PX: f64 = 1.5;
const OFFSET_MAX_RAD: f64 = 2e-3;
/// Row offset above which a warning names the correction, and above which a change between two looks is a knock, as a share of the limit.
/// Chosen by hand, not varied.
const REPORTED_SHARE: f64 = 0.5;
/// Squared distance in standard deviations from which two looks differ (chi-squared with five degrees of freedom: once in 100 000 looks).
const CHANGED_FROM: f64 = 30.0;
/// Looks that must agree until a change is the cameras' and not that of some pairs. Chosen by hand, not varied: images that were not taken at
/// the same moment by a moving hand differ from pair to pair.
const CHANGED_LOOKS: u32 = 5;
/// Weight of a new look once several were averaged. Chosen by hand, not varied: the cameras warm up in minutes.
const RATE: f64 = 0.2;
/// Looks without a result that search anew near other rigs, which takes up to 0.1 s; later ones take the quarter. Chosen by hand, not varied: a
/// live loop has 33 ms per pair.
const WIDE_LOOKS: u32 = 2;
/// Rotation of the cameras against each other from which rectified images differ from raw ones: 2 px at a focal length of 740 px.
const TURNED_FROM_RAD: f64 = 3e-3;
/// A point of the field is judged if its offset is larger than the limit by this many standard deviations.
const SURE_SIGMAS: f64 = 2.0;

/// Measures a rig and keeps its correction.
#[derive(Clone, Debug)]
pub struct RigWatch {
    calibrated: StereoRig,
    rectification: Rectification,
    meter: RowMeter,
    looks: u32,
    /// Looks that still search anew near other rigs if nothing was found so far.
    wide_looks: u32,
    /// Mean of the measurements, as of a rig that may have moved.
    measured: RigErrors,
    /// What is believed of the rig, and the rig with it.
    errors: RigErrors,
    corrected: StereoRig,
    has_moved: bool,
    /// Whether a whole image has shown the rig, and not a target alone.
    has_sampled_whole: bool,
    /// What the newest looks show instead of `measured`, and their number.
    other: Option<(RigErrors, u32)>,
    /// Looks that agree with `measured`, without a break.
    agreeing: u32,
    /// Whether the cameras have moved since `measured`.
    is_knocked: bool,
    /// Whether the first images that contradict the calibration look rectified; `None` before.
    are_rectified: Option<bool>,
}

impl RigWatch {
    /// Nothing measured yet.
    ///
    /// # Errors
    /// A rig that cannot be rectified.
    pub fn new(rig: &StereoRig) -> Result<Self, EstimationError> {
        let rectification = rig.rectify()?;
        let nothing = RigErrors::of_rig(&rectification);
        Ok(Self {
            calibrated: *rig,
            rectification,
            meter: RowMeter::new(rig, Kernels::best())?,
            looks: 0,
            wide_looks: WIDE_LOOKS,
            measured: nothing,
            errors: nothing.unseen(),
            corrected: *rig,
            has_moved: false,
            has_sampled_whole: false,
            other: None,
            agreeing: 0,
            is_knocked: false,
            are_rectified: None,
        })
    }

    /// Gives the next looks the time to search anew near other rigs, as the first ones have: for a new target or a single pair.
    pub fn allow_time(&mut self) {
        self.wide_looks = WIDE_LOOKS;
    }

    /// Measures a pair of raw images.
    ///
    /// # Errors
    /// Images that do not match the calibration in size.
    pub fn look<'a>(
        &mut self,
        left: impl Into<ImageView<'a>>,
        right: impl Into<ImageView<'a>>,
    ) -> Result<RigErrors, EstimationError> {
        let (left, right) = (left.into(), right.into());
        let is_wide = self.looks == 0 && self.wide_looks > 0;
        self.wide_looks = self.wide_looks.saturating_sub(1);
        let measured = self.meter.measure(left, right, (!is_wide).then_some(&self.measured))?;
        if is_enough(&measured) {
            self.has_sampled_whole = true;
            self.take(&measured);
        }
        if self.are_rectified.is_none() && (self.looks == 0 || self.contradicts()) {
            self.are_rectified = self.look_rectified(left, right, &measured)?;
        }
        Ok(measured)
    }

    /// Measures the rig on a target whose place is known: for pairs whose other points do not show it.
    pub fn look_at_target(&mut self, images: (ImageView<'_>, ImageView<'_>), target: &KnownTarget<'_>) {
        let measured = self.meter.measure_target(images, target);
        let (believed, moved) = measured.believed();
        let variance = |errors: &RigErrors| errors.covariance[(ROLL, ROLL)];
        let tells = moved > RigErrors::default().believed().1 || variance(&believed) < variance(&measured.unseen());
        if measured.matches > 0 && tells {
            self.take(&measured);
        }
    }

    /// Whether the images agree with the rectified cameras of the rig, and better than with the rig: the driver has rectified them already.
    /// `None` if they do not show it.
    fn look_rectified(
        &self,
        left: ImageView<'_>,
        right: ImageView<'_>,
        measured: &RigErrors,
    ) -> Result<Option<bool>, EstimationError> {
        let rig = &self.rectification.rig;
        let sizes = [rig.left().size(), rig.right().size()];
        if !differs_beyond_focal_lengths(&self.calibrated)
            || sizes != [self.calibrated.left().size(), self.calibrated.right().size()]
        {
            return Ok(Some(false));
        }
        let meter = RowMeter::new(rig, Kernels::best())?;
        let rectified = meter.measure(left, right, None)?;
        let agree = meter.largest_px(&rectified) <= self.limit_rad() * meter.focal_px();
        Ok(match (rectified.matches, measured.matches) {
            (0..MATCHES_MIN, _) => None,
            // One measurement may lack a few points only.
            (found, 0..MATCHES_MIN) => Some(agree && found >= 2 * MATCHES_MIN),
            (found, before) => Some(agree && found > before),
        })
    }

    fn take(&mut self, new: &RigErrors) {
        if self.looks > 0 && self.differ(&self.measured, new) {
            self.agreeing = 0;
            let count = self.other.map_or(0, |(other, count)| if self.differ(&other, new) { 0 } else { count });
            self.other = Some((*new, count + 1));
            if count + 1 < CHANGED_LOOKS {
                return;
            }
            if new.believed().1 > MOVED_FROM {
                self.is_knocked = true;
                return;
            }
            // These images fit the calibration, so those before did not show this rig.
            self.looks = 0;
        }
        self.other = None;
        self.agreeing += 1;
        self.is_knocked &= self.agreeing < CHANGED_LOOKS;
        self.looks += 1;
        let rate = RATE.max(1.0 / f64::from(self.looks));
        let known = self.measured;
        self.measured = RigErrors {
            errors: known.errors + (new.errors - known.errors) * rate,
            covariance: known.covariance + (new.covariance - known.covariance) * rate,
            ..*new
        };
        let (errors, moved) = self.measured.believed();
        (self.errors, self.has_moved) = (errors, moved > MOVED_FROM);
        self.corrected = self.errors.corrected(&self.calibrated, &self.rectification).unwrap_or(self.calibrated);
    }

    /// Whether two looks cannot have seen the same rig.
    fn differ(&self, before: &RigErrors, after: &RigErrors) -> bool {
        let change = change(before, after);
        change.significance() > CHANGED_FROM && self.share_of_limit(&change, SURE_SIGMAS) > REPORTED_SHARE
    }

    /// Whether the next pair should be looked at as well.
    pub fn is_in_doubt(&self) -> bool {
        self.other.is_some() || self.objection().is_some()
    }

    /// The rig as it was calibrated.
    pub fn calibrated(&self) -> &StereoRig {
        &self.calibrated
    }

    /// Whether the rig is another one than that which was calibrated, beyond doubt.
    pub fn has_moved(&self) -> bool {
        self.has_moved
    }

    /// Whether a whole image has shown the rig, and not a target alone.
    pub fn has_sampled_whole(&self) -> bool {
        self.has_sampled_whole
    }

    /// The rig as its images show it.
    pub fn rig(&self) -> &StereoRig {
        &self.corrected
    }

    /// The errors that were corrected in [`Self::rig`], with the covariance that remains. `None` before the first look that found enough
    /// points.
    pub fn errors(&self) -> Option<&RigErrors> {
        (self.looks > 0).then_some(&self.errors)
    }

    /// What is believed of the rig: [`Self::errors`], and before the first look what is known of any rig.
    pub fn believed(&self) -> &RigErrors {
        &self.errors
    }

    /// What was corrected, if it is worth a warning.
    pub fn warning(&self) -> Option<EstimateWarning> {
        let is_reported = self.share_of_limit(&self.errors, SURE_SIGMAS) > REPORTED_SHARE;
        (is_reported && self.objection().is_none()).then(|| EstimateWarning::RowsOff {
            offset_max_px: self.meter.largest_px(&self.errors),
            errors: text(&self.meter, &self.errors),
        })
    }

    /// Why no estimate with this calibration may be used.
    pub fn objection(&self) -> Option<String> {
        if let Some((other, _)) = &self.other {
            let (px, text) = (self.meter.largest_px(&change(&self.measured, other)), text(&self.meter, other));
            return Some(match self.is_knocked {
                true => format!(
                    "the cameras have moved against each other: rows of the images are up to {px:.1} px from where they were ({text}): \
                     fasten the cameras and calibrate again"
                ),
                false => format!(
                    "rows of the images are up to {px:.1} px from where they were ({text}): the cameras have moved against each other, or \
                     both images were not taken at the same moment"
                ),
            });
        }
        if self.is_knocked {
            return Some("the rows of the images have changed for a while: the cameras may be loose".to_owned());
        }
        let why = match self.are_rectified {
            Some(true) => format!(
                "they look rectified already, as they agree without its distortion and rotation: state that with {}, or give raw images; if \
                 they are raw, the cameras have moved: calibrate again",
                Argument::Rectified
            ),
            _ => "it belongs to other cameras or images, or the cameras have moved since: give the right file, or calibrate again"
                .to_owned(),
        };
        if self.looks == 0 && self.are_rectified == Some(true) {
            return Some(format!("the images do not agree with the calibration: no points are near their rows: {why}"));
        }
        self.contradicts().then(|| {
            format!(
                "the images do not agree with the calibration: points are up to {:.1} px off their rows ({}, limit {:.1} px): {why}",
                self.meter.largest_px(&self.errors),
                text(&self.meter, &self.errors),
                self.limit_rad() * self.meter.focal_px()
            )
        })
    }

    /// Whether the images contradict the calibration.
    fn contradicts(&self) -> bool {
        self.has_moved && self.share_of_limit(&self.errors, SURE_SIGMAS) > 1.0
    }

    fn limit_rad(&self) -> f64 {
        OFFSET_MAX_RAD.max(OFFSET_MAX_PX / self.meter.focal_px())
    }

    /// The largest row offset, less a number of standard deviations, as a share of the limit.
    fn share_of_limit(&self, errors: &RigErrors, sigmas: f64) -> f64 {
        let sure = self.meter.offsets(errors).map(|(offset, sigma)| offset.abs() - sigmas * sigma);
        sure.into_iter().fold(0.0, f64::max) / self.limit_rad()
    }
}

/// Whether rectification does more to the images of a rig than to scale them: images that agree without lens distortion and rotation were
/// rectified, those that agree with another focal length were not.
fn differs_beyond_focal_lengths(rig: &StereoRig) -> bool {
    let is_turned = rig.cam_right_from_cam_left().rotation_angle_rad() > TURNED_FROM_RAD;
    is_turned || [rig.left(), rig.right()].iter().any(|camera| *camera.distortion() != Distortion::None)
}

/// What has changed from one measurement to the next.
fn change(before: &RigErrors, after: &RigErrors) -> RigErrors {
    RigErrors { errors: after.errors - before.errors, covariance: before.covariance + after.covariance, ..*after }
}

/// Errors as text. An offset of all rows is a pitch of one camera or a shift of its sensor, which look alike.
fn text(meter: &RowMeter, known: &RigErrors) -> String {
    let sigma = |index: usize| known.covariance[(index, index)].max(0.0).sqrt();
    let (centre, centre_sigma) = meter.centre(known);
    format!(
        "all rows {:+.1} ± {:.1} px, roll {:+.2} ± {:.2}°, focal lengths {:+.2} ± {:.2} % apart",
        centre * meter.focal_px(),
        centre_sigma * meter.focal_px(),
        known.errors[ROLL].to_degrees(),
        sigma(ROLL).to_degrees(),
        100.0 * known.errors[SCALE],
        100.0 * sigma(SCALE)
    )
}
