//! A target that moves between the two exposures of a pair.
//!
//! The right camera exposes later by the skew `s`. A rig whose right camera is displaced by the target's motion in this time sees the target
//! at rest, so everything else remains as it is. The motion is that of the frames before; the first pair has none, and its surface is
//! corrected in the second frame.

use nalgebra::{Matrix3, Point3, Vector3};
use pb3dp_estimation_core::method::FramePrior;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};

use super::{Frame, ROW_INFORMATION_START, StartLevel, Target};
use crate::predict::{Expected, share_of};

/// Variance of a velocity that is extrapolated from three poses, per variance of a pose and square of an interval: the velocity 1.5
/// intervals after the middle of the last one is 2.5, -4 and 1.5 times the poses, and the sum of the squares is this.
const EXTRAPOLATED: f64 = 2.5 * 2.5 + 4.0 * 4.0 + 1.5 * 1.5;
/// The same half an interval after it, where the pose of the pair itself is known.
const EXTRAPOLATED_NOISE: f64 = 1.5 * 1.5 + 2.0 * 2.0 + 0.5 * 0.5;
/// Share of an unforeseen change of the motion that is still unknown when it was seen. Chosen with figures: swings of 200 mm/s with 20 ms.
const UNKNOWN_SHARE: f64 = 0.5;
/// Distance of the rays that determine a corrected plane.
const RAY_STEP: f64 = 0.1;

impl Target {
    /// The rig that sees the target at rest in the second frame, and its pose there: that frame shows the motion in the first pair, and the
    /// surface is corrected for it. `None` if the first pair was taken at once, or the frame does not show the target.
    pub(crate) fn correct_by_second_frame(
        &mut self,
        expected: &Expected,
        frame: &Frame<'_>,
        prior: &FramePrior,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<(StereoRig, Pose<CamLeft, Model>)> {
        let first_skew_s = self.first_skew_s.take()?;
        let step_s = prior.dt_s?;
        self.attempt(&expected.pose, StartLevel::Resembling, frame, may_continue)?;
        if self.fit.misfit(&self.limits(frame.config)).is_some() {
            return None;
        }
        let found = self.estimate.cam_left_from_model;
        let moved = found * self.motion.cam_left_from_model.inverse();
        let after_from_before = self.correct_first_pair(&share_of(&moved, first_skew_s / step_s), frame.rig)?;
        self.correct_first_covariance(first_skew_s / step_s, frame.rig);
        let rig = frame.rig.with_motion_between_exposures(&share_of(&moved, prior.skew_s / step_s));
        Some((rig, found * after_from_before.inverse()))
    }

    /// Corrects the surface for the motion between the exposures of the first pair, which was taken as one moment. Maps the frame `model`
    /// before to that after it.
    fn correct_first_pair(
        &mut self,
        later_from_now: &Pose<CamLeft, CamLeft>,
        rig: &StereoRig,
    ) -> Option<Pose<Model, Model>> {
        let first = self.motion.cam_left_from_model;
        let (origin, normal) = (first.translation_m(), first.transform_vector(&Vector3::z()));
        let rays = [Vector3::zeros(), Vector3::x(), Vector3::y()].map(|step| origin / origin.z + step * RAY_STEP);
        let inverse_rays = Matrix3::from_rows(&rays.map(|ray| ray.transpose())).try_inverse()?;
        let centre = rig.right_centre_in_cam_left();
        let corrected = |plane: Vector3<f64>| {
            let mut inverse_depths = Vector3::zeros();
            for (ray, out) in rays.iter().zip(inverse_depths.iter_mut()) {
                *out = true_inverse_depth(plane.dot(ray), ray, later_from_now, &centre)?;
            }
            Some(inverse_rays * inverse_depths)
        };
        // On a curved target the frame is not on the plane that the relief is measured from.
        let [surface, frame] = [corrected(self.surface.plane)?, corrected(normal / normal.dot(&origin))?];
        self.surface.set_plane(surface);
        // The motion across the rows looked like a misalignment of the rows.
        self.knowledge.row_offset_px = 0.0;
        self.knowledge.row_information = ROW_INFORMATION_START;
        self.place_frame(&frame)
    }

    /// The covariance of the first pose, once the second frame has shown the motion: with the error of that motion, the difference of two
    /// poses, of which `share` lies between the exposures.
    fn correct_first_covariance(&mut self, share: f64, rig: &StereoRig) {
        let Some(mut covariance) = self.first_pose_covariance_at_rest else { return };
        let pose = self.motion.cam_left_from_model;
        let baseline = rig.right_centre_in_cam_left();
        let along = pose.inverse().transform_vector(&baseline.normalize());
        let per_variance = 2.0 * (share * pose.translation_m().z / baseline.norm()).powi(2);
        let place = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        covariance[(2, 2)] += per_variance * along.dot(&(place * along));
        for axis in [3, 4] {
            covariance[(axis, axis)] *= 1.0 + per_variance;
        }
        self.first_pose_covariance = Some(covariance);
    }

    /// The motion between the exposures as the pair itself shows it, which is aligned for this with the motion that was foreseen. `None` if both
    /// were taken at once, the target is not found so, or its motion is not known.
    pub(crate) fn see_motion(
        &mut self,
        expected: &Expected,
        frame: &Frame<'_>,
        prior: &FramePrior,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<Pose<CamLeft, CamLeft>> {
        if prior.skew_s == 0.0 {
            return None;
        }
        let before = self.estimate;
        self.view = self.nearest_view(&expected.pose, frame.config).0;
        let is_found = self.attempt(&expected.pose, StartLevel::Resembling, frame, may_continue).is_some()
            && self.fit.misfit(&self.limits(frame.config)).is_none();
        let found = std::mem::replace(&mut self.estimate, before).cam_left_from_model;
        self.motion.between_tracked_exposures(&found, prior).filter(|_| is_found)
    }

    /// Adds the error of the motion between the exposures to the covariance: depth follows from the difference of both images. `unforeseen`: what
    /// this frame has changed of the motion that was foreseen, of which a share remains unknown.
    pub(crate) fn add_error_of_motion(
        &mut self,
        prior: &FramePrior,
        rig: &StereoRig,
        unforeseen: Option<&Pose<CamLeft, CamLeft>>,
    ) {
        let (Some(covariance), Some(step_s)) = (&mut self.covariance, prior.dt_s) else { return };
        let pose = &self.estimate.cam_left_from_model;
        let baseline = rig.right_centre_in_cam_left();
        let along = pose.inverse().transform_vector(&baseline.normalize());
        let place = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let origin = pose.translation_m();
        let extrapolated = if unforeseen.is_some() { EXTRAPOLATED_NOISE } else { EXTRAPOLATED };
        let unforeseen = unforeseen.copied().unwrap_or_else(Pose::coincident);
        let shifted = unforeseen.transform_point(&origin.into()).coords - origin;
        let variance = extrapolated * (prior.skew_s / step_s).clamp(-1.0, 1.0).powi(2) * along.dot(&(place * along))
            + (UNKNOWN_SHARE * shifted.dot(&baseline.normalize())).powi(2);
        let depth = origin.z / baseline.norm();
        let before = &self.motion.cam_left_from_model;
        let share = prior.skew_sigma_s / step_s;
        let variance = variance + (share * (origin - before.translation_m()).dot(&baseline.normalize())).powi(2);
        let turned = (before.inverse() * *pose).rotation_angle_rad();
        let turn_variance =
            (UNKNOWN_SHARE * depth * unforeseen.rotation_angle_rad()).powi(2) + (share * depth * turned).powi(2);
        let ray = pose.inverse().transform_vector(&pose.translation_m().normalize());
        let mut shift = covariance.fixed_view_mut::<3, 3>(0, 0);
        shift += ray * ray.transpose() * (depth * depth * variance);
        for axis in [3, 4] {
            covariance[(axis, axis)] += turn_variance;
        }
    }
}

impl Target {
    /// Adds the shear of a target that moves while both cameras read their rows one after the other to the covariance. In the time between two
    /// of its rows, an angle `a` apart, it moves by `speed readout a focal / rows`: rotated and sheared by this share of `a z`.
    pub(crate) fn add_shear_of_readout(&mut self, readout_s: f64, prior: &FramePrior, rig: &StereoRig) {
        let (Some(covariance), Some(step_s)) = (&mut self.covariance, prior.dt_s) else { return };
        let (now, before) = (&self.estimate.cam_left_from_model, &self.motion.cam_left_from_model);
        let speed_m_per_s = (now.translation_m() - before.translation_m()).norm() / step_s;
        let left = rig.left();
        let per_angle_s = readout_s * left.pinhole().fy / f64::from(left.size().height);
        let turn_rad = speed_m_per_s * per_angle_s / now.translation_m().z;
        if readout_s == 0.0 || !turn_rad.is_finite() {
            return;
        }
        let mut turns = covariance.fixed_view_mut::<3, 3>(3, 3);
        turns += Matrix3::identity() * turn_rad.powi(2);
    }
}

/// Inverse depth on a ray of the left camera of a point that was triangulated as if it had not moved.
fn true_inverse_depth(
    inverse_depth: f64,
    ray: &Vector3<f64>,
    later_from_now: &Pose<CamLeft, CamLeft>,
    right_centre: &Vector3<f64>,
) -> Option<f64> {
    let mut depth = 1.0 / inverse_depth;
    let direction = (ray * depth - right_centre).try_normalize(1e-9)?;
    let across = ray - direction * direction.dot(ray);
    for _ in 0..2 {
        let now = ray * depth;
        let shift = later_from_now.transform_point(&Point3::from(now)).coords - now;
        depth = across.dot(&(right_centre - shift)) / across.norm_squared();
    }
    (depth > 0.0 && depth.is_finite()).then_some(1.0 / depth)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;

    use super::*;

    #[test]
    fn a_point_that_moved_between_the_exposures_gets_its_true_depth() {
        let right_centre = Vector3::new(0.098, 0.004, -0.003);
        let later_from_now = Pose::exp(&Vector6::new(4e-4, -2e-4, 3e-4, 1e-3, -2e-3, 1.5e-3));
        let ray = Vector3::new(0.12, -0.07, 1.0);
        let depth_m = 0.46;
        let direction = later_from_now.transform_point(&Point3::from(ray * depth_m)).coords - right_centre;
        // Triangulated: the depth on the left ray that is nearest to the right one, in the plane of the left ray and the baseline.
        let normal = ray.cross(&right_centre).normalize();
        let in_plane = direction - normal * normal.dot(&direction);
        let lines = nalgebra::Matrix3x2::from_columns(&[ray, -in_plane]);
        let found = lines.svd(true, true).solve(&right_centre, 1e-12).unwrap();
        assert!((found.x - depth_m).abs() > 1e-3, "the motion matters: {found}");
        let corrected = true_inverse_depth(1.0 / found.x, &ray, &later_from_now, &right_centre).unwrap();
        assert!((1.0 / corrected - depth_m).abs() < 1e-6, "{}", 1.0 / corrected);
    }
}
