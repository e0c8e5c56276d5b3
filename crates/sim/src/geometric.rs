//! A simulated tracker without images: the true pose of a target visible to both cameras, plus noise of a stated covariance.
//!
//! For simulation runs that do not study image processing: no image is rendered or processed. The noise of an image tracker and
//! the visibility limits are simulated; errors caused by the image content (relief, texture, light, occlusion) are not.

use std::fmt;
use std::ops::RangeInclusive;

use nalgebra::{Matrix6, Point3, UnitQuaternion, Vector2, Vector3, Vector6};
use pb3dp_geometry::frames::{CamLeft, Model, Target};
use pb3dp_geometry::{Camera, MonotonicTime, Pose, StereoRig};

use crate::noise::{hash, unit};

/// Standard deviations of a pose, along and about the axes of `model`, all independent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseSigma {
    /// Of the position along x, and along y, metres, 0 to 0.1.
    pub lateral_m: f64,
    /// Of the position along the normal, metres, 0 to 0.1.
    pub depth_m: f64,
    /// Of the rotation about x, and about y, radians, 0 to 0.5.
    pub tilt_rad: f64,
    /// Of the rotation about the normal, radians, 0 to 0.5.
    pub about_normal_rad: f64,
}

impl PoseSigma {
    /// Standard deviations of xi = [rho; phi], metres and radians, with true = found * exp(xi).
    fn of_xi(&self) -> Vector6<f64> {
        let Self { lateral_m, depth_m, tilt_rad, about_normal_rad } = *self;
        Vector6::new(lateral_m, lateral_m, depth_m, tilt_rad, tilt_rad, about_normal_rad)
    }

    /// Covariance of xi = [rho; phi] (m, rad; axes of `model`), with true = found * exp(xi).
    pub fn covariance(&self) -> Matrix6<f64> {
        Matrix6::from_diagonal(&self.of_xi().map(|sigma| sigma * sigma))
    }

    /// A sample of xi; deterministic in `words`.
    fn sample(&self, words: &[u32]) -> Vector6<f64> {
        let base = hash(words);
        Vector6::from_fn(|row, _| normal(hash(&[base, row as u32]))).component_mul(&self.of_xi())
    }

    /// Allowed values of `lateral_m` and `depth_m`.
    pub const POSITION_M: RangeInclusive<f64> = 0.0..=0.1;
    /// Allowed values of `tilt_rad` and `about_normal_rad`.
    pub const ANGLE_RAD: RangeInclusive<f64> = 0.0..=0.5;

    fn check(&self, keys: [&'static str; 4]) -> Result<(), GeometricError> {
        in_range(keys[0], self.lateral_m, Self::POSITION_M)?;
        in_range(keys[1], self.depth_m, Self::POSITION_M)?;
        in_range(keys[2], self.tilt_rad, Self::ANGLE_RAD)?;
        in_range(keys[3], self.about_normal_rad, Self::ANGLE_RAD)
    }
}

/// Sum of twelve uniform numbers: mean 0, variance 1, within 6; additions only, so the result is the same on every machine.
fn normal(seed: u32) -> f64 {
    (0..12).map(|k| unit(hash(&[seed, k]))).sum::<f64>() - 6.0
}

/// Error model and visibility limits of the tracker without images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeometricConfig {
    /// White noise of each frame.
    pub noise: PoseSigma,
    /// Constant error of an initialisation: error of the model frame on the target.
    pub lock: PoseSigma,
    /// Minimum share of the target outline visible in both images, 0 to 1.
    pub in_view_share_min: f64,
    /// Maximum angle between the target normal and the ray to its centre, radians, 0.1 to 1.5.
    pub turned_max_rad: f64,
    /// Minimum depth of its centre, metres, above 0.
    pub z_min_m: f64,
    /// Maximum depth of its centre, metres.
    pub z_max_m: f64,
    /// Seed of the noise.
    pub seed: u32,
}

/// A parameter is out of its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("parameter {key} of the geometric tracker is {value}; set it between {min} and {max}")]
pub struct GeometricError {
    /// Name of the parameter.
    pub key: &'static str,
    /// Its value.
    pub value: f64,
    /// Smallest allowed.
    pub min: f64,
    /// Largest allowed.
    pub max: f64,
}

fn in_range(key: &'static str, value: f64, allowed: RangeInclusive<f64>) -> Result<(), GeometricError> {
    if allowed.contains(&value) {
        return Ok(());
    }
    let (min, max) = allowed.into_inner();
    Err(GeometricError { key, value, min, max })
}

impl GeometricConfig {
    /// Allowed values of `in_view_share_min`.
    pub const IN_VIEW_SHARE_MIN: RangeInclusive<f64> = 0.0..=1.0;
    /// Allowed values of `turned_max_rad`.
    pub const TURNED_MAX_RAD: RangeInclusive<f64> = 0.1..=1.5;

    fn validate(&self) -> Result<(), GeometricError> {
        self.noise.check(["noise.lateral_m", "noise.depth_m", "noise.tilt_rad", "noise.about_normal_rad"])?;
        self.lock.check(["lock.lateral_m", "lock.depth_m", "lock.tilt_rad", "lock.about_normal_rad"])?;
        in_range("in_view_share_min", self.in_view_share_min, Self::IN_VIEW_SHARE_MIN)?;
        in_range("turned_max_rad", self.turned_max_rad, Self::TURNED_MAX_RAD)?;
        in_range("z_min_m", self.z_min_m, 1e-3..=1e3)?;
        in_range("z_max_m", self.z_max_m, self.z_min_m..=1e3)
    }
}

/// Why there is no pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OutOfView {
    /// Too near or too far.
    Depth {
        /// Depth of the target's centre, metres.
        z_m: f64,
        /// Smallest allowed.
        min_m: f64,
        /// Largest allowed.
        max_m: f64,
    },
    /// Seen at too flat an angle, or from behind.
    TurnedAway {
        /// Angle between the normal and the ray, radians.
        angle_rad: f64,
        /// Largest allowed.
        max_rad: f64,
    },
    /// Too little of the target is visible in both images.
    OutOfImage {
        /// Share of the outline visible in both images.
        share: f64,
        /// Smallest allowed.
        min: f64,
    },
}

impl fmt::Display for OutOfView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Depth { z_m, min_m, max_m } => {
                write!(f, "the target is {:.0} mm away, allowed is {:.0} to {:.0}", z_m * 1e3, min_m * 1e3, max_m * 1e3)
            }
            Self::TurnedAway { angle_rad, max_rad } => {
                let (angle, most) = (angle_rad.to_degrees(), max_rad.to_degrees());
                write!(f, "the target is turned away by {angle:.0} degrees, at most {most:.0} degrees are allowed")
            }
            Self::OutOfImage { share, min } => {
                let (share, least) = (100.0 * share, 100.0 * min);
                write!(
                    f,
                    "{share:.0} % of the target's outline is visible in both images, at least {least:.0} % is needed"
                )
            }
        }
    }
}

/// The result of the tracker for one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Pose of the model in the left camera, or why there is none.
    pub cam_left_from_model: Result<Pose<CamLeft, Model>, OutOfView>,
    /// Whether a target was initialised before or in this frame.
    pub is_locked: bool,
}

/// One frame of a camera without images.
#[derive(Clone, Copy, Debug)]
pub struct GeometricFrame {
    /// Number of the exposure.
    pub sequence: u64,
    /// Middle of the exposure.
    pub exposed_at: MonotonicTime,
    /// Middle of the right exposure minus middle of the left exposure, nanoseconds.
    pub skew_nanos: i64,
    /// Whether the pixels would differ from those of the previous frame.
    pub is_new: bool,
    /// Result of the tracker, without the hindrance.
    pub sighting: Sighting,
    /// Effect of a camera fault on the result.
    pub hindrance: Option<Hindrance>,
    /// Ground truth.
    pub cam_left_from_target: Pose<CamLeft, Target>,
}

/// The effect of a camera fault on an image tracker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hindrance {
    /// The tracker finds no pose, for this reason.
    Blind(&'static str),
    /// The tracker reports low confidence, for this reason.
    Doubtful(&'static str),
}

/// A tracker without images.
///
/// Its model frame follows an image tracker: origin at the target centre on its front plane, z along the plane normal away from
/// the camera, x the image x axis projected into the plane in the frame of initialisation. The frame is then displaced by the
/// initialisation error and fixed to the target.
#[derive(Clone, Debug)]
pub struct GeometricTracker {
    config: GeometricConfig,
    rig: StereoRig,
    outline_m: Vec<Point3<f64>>,
    /// Assumed pose of the model frame on the target.
    target_from_model: Option<Pose<Target, Model>>,
}

impl GeometricTracker {
    /// A tracker without a target. `outline_m` are points of the target in its own frame, as in
    /// [`TargetModel`](crate::targets::TargetModel).
    ///
    /// # Errors
    /// A number out of its range.
    pub fn new(config: GeometricConfig, rig: StereoRig, outline_m: Vec<Point3<f64>>) -> Result<Self, GeometricError> {
        config.validate()?;
        Ok(Self { config, rig, outline_m, target_from_model: None })
    }

    /// The parameters.
    pub fn config(&self) -> &GeometricConfig {
        &self.config
    }

    /// Observes the target at its true pose `cam_left_from_target`, in the frame with this number. The tracker is initialised in
    /// the first frame in which the target is visible.
    pub fn look(&mut self, cam_left_from_target: &Pose<CamLeft, Target>, frame: u64) -> Sighting {
        if let Err(reason) = self.in_view(cam_left_from_target) {
            return Sighting { cam_left_from_model: Err(reason), is_locked: self.target_from_model.is_some() };
        }
        let words = [self.config.seed, frame as u32, (frame >> 32) as u32];
        let target_from_model = *self.target_from_model.get_or_insert_with(|| {
            let off = self.config.lock.sample(&[words[0], words[1], words[2], 1]);
            facing(cam_left_from_target).perturbed_in_from(&-off)
        });
        let noise = self.config.noise.sample(&[words[0], words[1], words[2], 0]);
        // true = found * exp(xi), so found = true * exp(-xi).
        let found = (*cam_left_from_target * target_from_model).perturbed_in_from(&-noise);
        Sighting { cam_left_from_model: Ok(found), is_locked: true }
    }

    /// The pose that a tracker computes if the right image is displaced relative to the calibration: shifted (pixels to the
    /// right), rotated (radians) and scaled about its centre, all by small amounts. To first order: a wrong depth, and tilts that
    /// grow with depth over baseline. `None` if the pose would be behind the cameras.
    pub fn misjudged(
        &self,
        cam_left_from_model: &Pose<CamLeft, Model>,
        columns_px: f64,
        roll_rad: f64,
        scale: f64,
    ) -> Option<Pose<CamLeft, Model>> {
        let origin_m = cam_left_from_model.translation_m();
        let baseline_m = self.rig.cam_right_from_cam_left().translation_m().norm();
        let disparity_px = self.rig.left().pinhole().fx * baseline_m / origin_m.z;
        let farther = disparity_px / (disparity_px - columns_px);
        let lever = origin_m.z / baseline_m;
        let turned = UnitQuaternion::from_scaled_axis(Vector3::new(roll_rad, scale - 1.0, 0.0) * lever);
        let found = Pose::from_parts(origin_m * farther, turned * cam_left_from_model.rotation());
        (farther > 0.0 && found.is_finite()).then_some(found)
    }

    /// The calibration.
    pub fn rig(&self) -> &StereoRig {
        &self.rig
    }

    /// The outline in the left image, without points behind the camera, pixels.
    pub fn outline_px(&self, cam_left_from_target: &Pose<CamLeft, Target>) -> Vec<Vector2<f64>> {
        let pixel = |point: &Point3<f64>| self.rig.left().project(&cam_left_from_target.transform_point(point));
        self.outline_m.iter().filter_map(pixel).collect()
    }

    fn in_view(&self, cam_left_from_target: &Pose<CamLeft, Target>) -> Result<(), OutOfView> {
        let GeometricConfig { in_view_share_min, turned_max_rad, z_min_m, z_max_m, .. } = self.config;
        let centre = cam_left_from_target.translation_m();
        if !(z_min_m..=z_max_m).contains(&centre.z) {
            return Err(OutOfView::Depth { z_m: centre.z, min_m: z_min_m, max_m: z_max_m });
        }
        let angle_rad = cam_left_from_target.transform_vector(&Vector3::z()).angle(&centre);
        if angle_rad > turned_max_rad {
            return Err(OutOfView::TurnedAway { angle_rad, max_rad: turned_max_rad });
        }
        let share = self.share_in_view(cam_left_from_target, in_view_share_min);
        if share < in_view_share_min {
            return Err(OutOfView::OutOfImage { share, min: in_view_share_min });
        }
        Ok(())
    }

    /// Share of the outline points visible in both images; the search ends once `enough` is reached.
    fn share_in_view(&self, cam_left_from_target: &Pose<CamLeft, Target>, enough: f64) -> f64 {
        let is_visible = |point: &&Point3<f64>| {
            let in_left = cam_left_from_target.transform_point(point);
            let in_right = self.rig.cam_right_from_cam_left().transform_point(&in_left);
            shows(self.rig.left(), &in_left) && shows(self.rig.right(), &in_right)
        };
        let share_of = |count: usize| count as f64 / self.outline_m.len().max(1) as f64;
        let mut counted = 0;
        for _ in self.outline_m.iter().filter(is_visible) {
            counted += 1;
            if share_of(counted) >= enough {
                break;
            }
        }
        share_of(counted)
    }
}

/// Whether a point lies inside an image, ignoring occlusion.
fn shows(camera: &Camera, point_in_cam: &Point3<f64>) -> bool {
    let size = camera.size();
    let inside = |coordinate: f64, count: u32| (-0.5..=f64::from(count) - 0.5).contains(&coordinate);
    camera.project(point_in_cam).is_some_and(|pixel| inside(pixel.x, size.width) && inside(pixel.y, size.height))
}

/// The model frame of an error-free initialisation.
fn facing(cam_left_from_target: &Pose<CamLeft, Target>) -> Pose<Target, Model> {
    let across = cam_left_from_target.inverse().transform_vector(&Vector3::x());
    // Rotation about the normal: the image x axis projected into the plane. The view is less than 90 degrees from frontal.
    Pose::from_parts(Vector3::zeros(), UnitQuaternion::from_scaled_axis(Vector3::z() * across.y.atan2(across.x)))
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;
    use pb3dp_geometry::{Distortion, ImageSize, Pinhole};

    use super::*;

    const CONFIG: GeometricConfig = GeometricConfig {
        noise: PoseSigma { lateral_m: 2e-4, depth_m: 7e-4, tilt_rad: 3e-3, about_normal_rad: 1e-3 },
        lock: PoseSigma { lateral_m: 0.0, depth_m: 0.0, tilt_rad: 0.0, about_normal_rad: 0.0 },
        in_view_share_min: 0.6,
        turned_max_rad: 1.2,
        z_min_m: 0.3,
        z_max_m: 0.7,
        seed: 5,
    };

    fn tracker(config: GeometricConfig) -> GeometricTracker {
        let pinhole = Pinhole { fx: 740.0, fy: 735.0, cx: 330.0, cy: 236.0 };
        let left = Camera::new(ImageSize { width: 640, height: 480 }, pinhole, Distortion::None).unwrap();
        let right = Camera::new(left.size(), Pinhole { fx: 702.0, ..pinhole }, Distortion::None).unwrap();
        let right_from_left =
            Pose::from_parts(Vector3::new(-0.1, 0.004, -0.006), UnitQuaternion::from_euler_angles(0.01, -0.03, 0.02));
        let outline = [(-0.05, -0.04), (0.06, -0.04), (0.06, 0.03), (-0.05, 0.03)];
        let outline_m = outline.map(|(x, y)| Point3::new(x, y, 0.0)).to_vec();
        GeometricTracker::new(config, StereoRig::new(left, right, right_from_left).unwrap(), outline_m).unwrap()
    }

    fn pose(t: [f64; 3], r: [f64; 3]) -> Pose<CamLeft, Target> {
        Pose::from_parts(Vector3::from(t), UnitQuaternion::from_scaled_axis(Vector3::from(r)))
    }

    /// Mean of the errors xi over many frames, and of their squares, with true = found * exp(xi).
    fn errors(tracker: &mut GeometricTracker) -> (Vector6<f64>, Vector6<f64>) {
        let truth = pose([0.03, -0.02, 0.52], [0.2, -0.3, 0.7]);
        let model = facing(&truth);
        let (mut sum, mut squares) = (Vector6::zeros(), Vector6::zeros());
        let frames = 20_000;
        for frame in 0..frames {
            let found = tracker.look(&truth, frame).cam_left_from_model.unwrap();
            let xi = (found.inverse() * truth * model).log();
            sum += xi;
            squares += xi.component_mul(&xi);
        }
        (sum / frames as f64, squares / frames as f64)
    }

    #[test]
    fn the_noise_has_the_covariance_that_is_stated() {
        let (mean, squares) = errors(&mut tracker(CONFIG));
        let stated = CONFIG.noise.covariance().diagonal();
        for row in 0..6 {
            // Of 20 000 samples: the mean within 4 standard errors, the variance within 5 %.
            assert!(mean[row].abs() < 4.0 * stated[row].sqrt() / 20_000_f64.sqrt(), "row {row}: {mean}");
            assert!((squares[row] / stated[row] - 1.0).abs() < 0.05, "row {row}: {squares} and {stated}");
        }
    }

    #[test]
    fn what_a_lock_gets_wrong_stays_as_long_as_it_lasts() {
        let lock = PoseSigma { lateral_m: 2e-3, depth_m: 3e-3, tilt_rad: 0.02, about_normal_rad: 0.01 };
        let quiet = GeometricConfig { noise: PoseSigma::default(), lock, ..CONFIG };
        let mut off = Vec::new();
        for seed in 0..2000 {
            let mut tracker = tracker(GeometricConfig { seed, ..quiet });
            let first = pose([0.03, -0.02, 0.52], [0.2, -0.3, 0.7]);
            let found = tracker.look(&first, 40).cam_left_from_model.unwrap();
            let target_from_model = first.inverse() * found;
            let later = pose([-0.04, 0.01, 0.47], [-0.3, 0.1, 1.9]);
            let again = later.inverse() * tracker.look(&later, 41).cam_left_from_model.unwrap();
            assert!((again.inverse() * target_from_model).log().norm() < 1e-12, "fixed to the target");
            off.push((found.inverse() * first * facing(&first)).log());
        }
        let expected = lock.covariance().diagonal();
        for row in 0..6 {
            let variance = off.iter().map(|xi| xi[row] * xi[row]).sum::<f64>() / off.len() as f64;
            assert!((variance / expected[row] - 1.0).abs() < 0.15, "row {row}: {variance} and {}", expected[row]);
        }
    }

    #[test]
    fn the_model_frame_is_the_one_that_the_image_shows() {
        let truth = pose([0.03, -0.02, 0.52], [0.2, -0.3, 0.7]);
        let model = truth * facing(&truth);
        let z = truth.transform_vector(&Vector3::z());
        let x = (Vector3::x() - z * z.x).normalize();
        let expected = Matrix3::from_columns(&[x, z.cross(&x), z]);
        assert!((model.rotation_matrix() - expected).norm() < 1e-12);
    }

    #[test]
    fn what_is_out_of_view_has_no_pose_and_the_reason() {
        let mut tracker = tracker(CONFIG);
        let before = tracker.look(&pose([0.0, 0.0, 0.9], [0.0; 3]), 0);
        assert_eq!(before.cam_left_from_model, Err(OutOfView::Depth { z_m: 0.9, min_m: 0.3, max_m: 0.7 }));
        assert!(!before.is_locked);
        assert!(tracker.look(&pose([0.05, 0.0, 0.5], [0.0; 3]), 1).is_locked);
        for (truth, part) in [
            (pose([0.05, 0.0, 0.2], [0.0; 3]), "200 mm away"),
            (pose([0.05, 0.0, -0.5], [0.0; 3]), "-500 mm away"),
            (pose([0.0, 0.0, 0.5], [1.3, 0.0, 0.0]), "turned away by 74 degrees"),
            (pose([0.0, 0.0, 0.5], [std::f64::consts::PI, 0.0, 0.0]), "turned away by 180 degrees"),
            // The left image shows the whole target, the right image its right half.
            (pose([-0.17, 0.0, 0.5], [0.0; 3]), "50 % of the target's outline"),
            (pose([0.3, 0.0, 0.5], [0.0; 3]), "0 % of the target's outline"),
        ] {
            let sighting = tracker.look(&truth, 2);
            let reason = sighting.cam_left_from_model.unwrap_err().to_string();
            assert!(reason.contains(part) && sighting.is_locked, "{reason}");
        }
        assert!(tracker.look(&pose([0.05, 0.0, 0.5], [0.0; 3]), 3).cam_left_from_model.is_ok(), "found again");
    }

    #[test]
    fn the_seed_decides_and_numbers_out_of_range_are_named() {
        let truth = pose([0.03, -0.02, 0.52], [0.2, -0.3, 0.7]);
        let look = |seed, frame| tracker(GeometricConfig { seed, ..CONFIG }).look(&truth, frame);
        assert_eq!(look(5, 7), look(5, 7));
        assert_ne!(look(5, 7), look(6, 7));
        assert_ne!(look(5, 7), look(5, 8));
        assert_ne!(look(5, 7), look(5, 7 + (1 << 32)));
        let mut config = CONFIG;
        config.lock.tilt_rad = 0.7;
        let error = config.validate().unwrap_err().to_string();
        assert_eq!(error, "parameter lock.tilt_rad of the geometric tracker is 0.7; set it between 0 and 0.5");
    }
}
