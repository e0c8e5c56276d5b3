//! Tracked poses against the true motion of a sequence.
//!
//! The model frame of an estimate and that of the ground truth are different frames on the same body, so poses cannot be
//! compared. The rigid motion since a reference frame can: `M(t) = T(t) T(t0)^-1`, expressed in `cam_left`, where `t0` is the
//! first frame with an estimate (frame 0 unless the tracker lost it). Four errors per frame:
//!
//! * translation: the distance between the positions to which the two motions move one reference point, the origin of the true
//!   model frame at `t0` (the point belongs to the data, so all methods are compared at the same point of the body);
//! * rotation: the angle of `R_est R_true^T`;
//! * tilt: the angle between the directions to which the two motions rotate the normal, the z axis of the estimated model frame
//!   at `t0` (the plane's normal by the definition of that frame);
//! * about the normal: the angle of the remaining rotation, about the true normal, with its sign. A method that does not observe
//!   the rotation about the normal is judged by the tilt.
//!   not observe the rotation about the normal is judged by the tilt.
//!
//! Jitter is the rms of the second differences of the error over consecutive tracked frames, divided by sqrt(6). White noise of
//! standard deviation s per component has second differences of standard deviation sqrt(6) s, so the jitter is the noise itself
//! (sqrt(3) s for a vector), while slow errors and the true motion cancel.

use nalgebra::{Unit, UnitQuaternion, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};

use super::plane::angle_rad;
use super::{Statistics, rms};

/// Errors of the motion in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionErrors {
    /// Displacement of the reference point, estimated minus true, in `cam_left`, metres.
    pub translation_m: Vector3<f64>,
    /// Rotation vector of `R_est R_true^T` in `cam_left`, radians.
    pub rotation_rad: Vector3<f64>,
    /// Angle between the estimated and the true direction of the normal, radians.
    pub tilt_rad: f64,
    /// Angle of the error's part about the normal, radians, -pi to pi.
    pub about_normal_rad: f64,
}

/// Summary of a tracked sequence.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionSummary {
    /// Number of frames.
    pub frames: usize,
    /// Frames without a pose, whatever the reason.
    pub without_pose: usize,
    /// Length of the translation error, metres.
    pub translation_m: Statistics,
    /// Angle of the rotation error, radians.
    pub rotation_rad: Statistics,
    /// Tilt error, radians.
    pub tilt_rad: Statistics,
    /// Absolute error about the normal, radians.
    pub about_normal_rad: Statistics,
    /// Jitter of the reference point, metres; `None` without three tracked frames in a row.
    pub translation_jitter_m: Option<f64>,
    /// Jitter of the rotation, radians.
    pub rotation_jitter_rad: Option<f64>,
}

/// The errors of each frame, `None` where there is no estimate. Both slices have one entry per frame; surplus entries of the
/// longer one are ignored.
pub fn compare_motion(
    estimated: &[Option<Pose<CamLeft, Model>>],
    truth: &[Pose<CamLeft, Model>],
) -> Vec<Option<MotionErrors>> {
    let mut pairs = estimated.iter().zip(truth);
    let Some((estimated_0, truth_0)) = pairs.find_map(|(e, t)| e.map(|e| (e, *t))) else {
        return vec![None; estimated.len().min(truth.len())];
    };
    let normal_0 = estimated_0.transform_vector(&Vector3::z());
    estimated.iter().zip(truth).map(|(e, t)| e.map(|e| errors(&(e, estimated_0), &(*t, truth_0), &normal_0))).collect()
}

type NowAndReference = (Pose<CamLeft, Model>, Pose<CamLeft, Model>);

fn errors(estimated: &NowAndReference, truth: &NowAndReference, normal_0: &Vector3<f64>) -> MotionErrors {
    let moved = |(now, reference): &NowAndReference| *now * reference.inverse();
    let (estimated, motion) = (moved(estimated), moved(truth));
    let point = truth.1.translation_m().into();
    let translation_m = estimated.transform_point(&point) - motion.transform_point(&point);
    let rotation = estimated.rotation() * motion.rotation().inverse();
    let normal = motion.transform_vector(normal_0);
    MotionErrors {
        translation_m,
        rotation_rad: rotation.scaled_axis(),
        tilt_rad: angle_rad(&estimated.transform_vector(normal_0), &normal),
        about_normal_rad: twist_rad(&rotation, &normal),
    }
}

/// Angle of the twist about `axis` when a rotation is split into a swing after a twist, radians, -pi to pi.
fn twist_rad(rotation: &UnitQuaternion<f64>, axis: &Vector3<f64>) -> f64 {
    let axis = Unit::new_normalize(*axis);
    let angle = 2.0 * rotation.imag().dot(&axis).atan2(rotation.w);
    // A quaternion and its negative are the same rotation: fold into -pi to pi.
    (angle + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI
}

impl MotionSummary {
    /// The summary of [`compare_motion`]'s errors; `None` if no frame has an estimate.
    pub fn of(errors: &[Option<MotionErrors>]) -> Option<Self> {
        let tracked: Vec<_> = errors.iter().flatten().collect();
        let statistics =
            |of: &dyn Fn(&MotionErrors) -> f64| Statistics::of(&tracked.iter().map(|e| of(e)).collect::<Vec<_>>());
        Some(Self {
            frames: errors.len(),
            without_pose: errors.len() - tracked.len(),
            translation_m: statistics(&|e| e.translation_m.norm())?,
            rotation_rad: statistics(&|e| e.rotation_rad.norm())?,
            tilt_rad: statistics(&|e| e.tilt_rad)?,
            about_normal_rad: statistics(&|e| e.about_normal_rad.abs())?,
            translation_jitter_m: jitter(errors, |e| e.translation_m),
            rotation_jitter_rad: jitter(errors, |e| e.rotation_rad),
        })
    }

    /// The summary as plain text for a terminal, in millimetres and degrees.
    pub fn text_table(&self) -> String {
        let row = |name: &str, s: &Statistics, scale: f64| {
            let [median, p95, rms, max] = [s.median, s.p95, s.rms, s.max].map(|x| x * scale);
            format!("{name:<24}{median:>9.3}{p95:>9.3}{rms:>9.3}{max:>9.3}\n")
        };
        let degrees = 1_f64.to_degrees();
        let jitter = |value: Option<f64>, scale: f64| value.map_or("-".into(), |x| format!("{:.3}", x * scale));
        let mut text = format!("{:<24}{:>9}{:>9}{:>9}{:>9}\n", "motion error", "median", "p95", "rms", "max");
        text += &row("translation, mm", &self.translation_m, 1e3);
        text += &row("rotation, deg", &self.rotation_rad, degrees);
        text += &row("tilt, deg", &self.tilt_rad, degrees);
        text += &row("about the normal, deg", &self.about_normal_rad, degrees);
        text += &format!(
            "jitter {} mm, {} deg; no pose in {} of {} frames\n",
            jitter(self.translation_jitter_m, 1e3),
            jitter(self.rotation_jitter_rad, degrees),
            self.without_pose,
            self.frames
        );
        text
    }
}

/// Rms of the second differences over consecutive tracked frames, over sqrt(6); `None` without three in a row.
fn jitter(errors: &[Option<MotionErrors>], of: impl Fn(&MotionErrors) -> Vector3<f64>) -> Option<f64> {
    let second_difference = |w: &[Option<MotionErrors>]| match w {
        [Some(a), Some(b), Some(c)] => Some((of(a) - 2.0 * of(b) + of(c)).norm()),
        _ => None,
    };
    let differences: Vec<_> = errors.windows(3).filter_map(second_difference).collect();
    Some(rms(&differences)? / 6_f64.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(t: [f64; 3], r: [f64; 3]) -> Pose<CamLeft, Model> {
        Pose::from_parts(Vector3::from(t), UnitQuaternion::from_scaled_axis(Vector3::from(r)))
    }

    fn truth() -> Vec<Pose<CamLeft, Model>> {
        (0..30)
            .map(|i| {
                let s = f64::from(i) / 30.0;
                pose([0.05 + 0.02 * s, -0.01 * s, 0.5 + 0.03 * s * s], [0.3 * s, 0.1 - 0.2 * s, 0.5 * s])
            })
            .collect()
    }

    /// Another model frame on the same body.
    fn other_model() -> Pose<Model, Model> {
        Pose::from_parts(Vector3::new(0.01, 0.02, -0.03), UnitQuaternion::from_euler_angles(0.4, -0.9, 2.0))
    }

    #[test]
    fn the_choice_of_the_model_frame_does_not_matter() {
        let estimated: Vec<_> = truth().iter().map(|t| Some(*t * other_model())).collect();
        let summary = MotionSummary::of(&compare_motion(&estimated, &truth())).unwrap();
        assert!(summary.translation_m.max < 1e-12 && summary.rotation_rad.max < 1e-12, "{summary:?}");
        assert!(summary.tilt_rad.max < 1e-12 && summary.translation_jitter_m.unwrap() < 1e-12);
    }

    #[test]
    fn an_error_of_the_pose_is_split_into_its_parts() {
        // After frame 0 the estimate is displaced by (3, 0, 4) mm in the camera and rotated about the reference point by 0.02 rad
        // about its own normal, then by 0.01 rad about a perpendicular axis.
        let truth = truth();
        let normal = truth[7].transform_vector(&Vector3::z());
        let across = normal.cross(&Vector3::x()).normalize();
        let twist = UnitQuaternion::from_scaled_axis(normal * 0.02);
        let swing = UnitQuaternion::from_scaled_axis(across * 0.01);
        let shifted = truth[7].translation_m() + Vector3::new(0.003, 0.0, 0.004);
        let wrong = Pose::from_parts(shifted, swing * twist * truth[7].rotation());
        let found = compare_motion(&[Some(truth[0]), Some(wrong)], &[truth[0], truth[7]]);
        let error = found[1].unwrap();
        assert!((error.translation_m - Vector3::new(0.003, 0.0, 0.004)).norm() < 1e-12);
        assert!((error.tilt_rad - 0.01).abs() < 1e-12, "{}", error.tilt_rad);
        assert!((error.about_normal_rad - 0.02).abs() < 1e-12, "{}", error.about_normal_rad);
        // cos(angle / 2) = cos(0.005) cos(0.01) for perpendicular axes.
        let angle = 2.0 * (0.005_f64.cos() * 0.01_f64.cos()).acos();
        assert!((error.rotation_rad.norm() - angle).abs() < 1e-9);
    }

    #[test]
    fn lost_frames_count_and_the_reference_is_the_first_estimate() {
        let mut estimated: Vec<_> = truth().iter().map(|t| Some(*t * other_model())).collect();
        estimated[0] = None;
        estimated[12] = None;
        let errors = compare_motion(&estimated, &truth());
        let summary = MotionSummary::of(&errors).unwrap();
        assert_eq!((summary.frames, summary.without_pose), (30, 2));
        assert!(errors[0].is_none() && summary.translation_m.max < 1e-12);
        assert_eq!(MotionSummary::of(&compare_motion(&[None, None], &truth())), None);
    }

    #[test]
    fn jitter_is_the_standard_deviation_of_white_noise() {
        // Errors of +s, -s, +s, .. along one axis have second differences of 4 s: jitter 4 s / sqrt(6).
        let truth = vec![pose([0.0, 0.1, 0.6], [0.2, 0.0, -0.1]); 21];
        let alternate = |i: usize| if i.is_multiple_of(2) { 0.0005 } else { -0.0005 };
        let estimated: Vec<_> = truth
            .iter()
            .enumerate()
            .map(|(i, t)| {
                Some(Pose::from_parts(t.translation_m() + Vector3::new(0.0, alternate(i), 0.0), t.rotation()))
            })
            .collect();
        let summary = MotionSummary::of(&compare_motion(&estimated, &truth)).unwrap();
        let expected = 4.0 * 0.0005 / 6_f64.sqrt();
        assert!((summary.translation_jitter_m.unwrap() - expected).abs() < 1e-12);
        assert!(summary.rotation_jitter_rad.unwrap() < 1e-12);
        let text = summary.text_table();
        assert!(text.contains("jitter 0.816 mm, 0.000 deg; no pose in 0 of 21 frames"), "{text}");
    }

    #[test]
    fn twist_folds_into_half_a_turn() {
        let axis = Vector3::new(1.0, 2.0, -2.0);
        for angle in [-3.0, -0.5, 0.0, 1.0, 3.1] {
            let q = UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), angle);
            for q in [q, UnitQuaternion::new_unchecked(-q.into_inner())] {
                assert!((twist_rad(&q, &axis) - angle).abs() < 1e-12, "{angle}");
            }
        }
    }
}
