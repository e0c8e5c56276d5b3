//! The plane of the visible surface, from several pairs.
//!
//! The first pair defines `model`. Later pairs show the same surface from other places and with other noise; each gives a plane of its own,
//! and their mean, weighted with their information, is more certain than the first. Errors that all of them share remain.

use nalgebra::{Matrix3, Matrix6, Vector3};
use pb3dp_estimation_core::estimate::SurfaceEstimate;
use pb3dp_estimation_core::method::FramePrior;
use pb3dp_estimation_direct::estimator::SurfacePlane;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};

use super::Target;
use super::placing::frame_by_plane;
use crate::surface::model_frame;

/// Number of later pairs, and time between two, seconds. Chosen by hand, not varied: the first five seconds.
const LOOKS_MAX: u32 = 5;
const LOOK_EVERY_S: f64 = 1.0;
/// Squared distance of a pair's plane from the mean so far, in units of both covariances, with which it is another surface. Derived: chi-squared of
/// three degrees of freedom is larger once in 50 000.
const APART_MAX: f64 = 23.0;

/// What later pairs have shown of the surface: planes in the first left camera.
#[derive(Clone, Debug, Default)]
pub(super) struct SurfaceEvidence {
    information: Matrix3<f64>,
    pull: Vector3<f64>,
    /// Pairs looked at.
    looks: u32,
    /// Those that count.
    used: u32,
    /// Time since the first pair, seconds.
    age_s: f64,
}

/// Depth and tilts of a frame on a plane by the plane.
fn depth_and_tilts_by_plane(plane: &Vector3<f64>, first_from_frame: &Pose<CamLeft, Model>) -> Matrix3<f64> {
    frame_by_plane(plane, first_from_frame).fixed_rows::<3>(2).into_owned()
}

/// The inverse-depth plane through x and y of a frame.
fn plane_of(first_from_frame: &Pose<CamLeft, Model>) -> Vector3<f64> {
    let normal = first_from_frame.transform_vector(&Vector3::z());
    normal / normal.dot(&first_from_frame.translation_m())
}

/// An inverse-depth plane of the present left camera in the first one, and its derivatives.
fn in_first(plane: &Vector3<f64>, now_from_first: &Pose<CamLeft, CamLeft>) -> (Vector3<f64>, Matrix3<f64>) {
    // A point p of the plane has `plane . p = 1`.
    let turned = now_from_first.rotation_matrix().transpose();
    let rest = 1.0 - plane.dot(&now_from_first.translation_m());
    let in_first = turned * plane / rest;
    (in_first, (turned + in_first * now_from_first.translation_m().transpose()) / rest)
}

impl SurfaceEvidence {
    /// Adds a plane; false if it does not count.
    fn add(&mut self, plane: &Vector3<f64>, covariance: &Matrix3<f64>) -> bool {
        let Some(information) = covariance.try_inverse().filter(|_| plane.iter().all(|x| x.is_finite())) else {
            return false;
        };
        if let Some((mean, of_mean)) = self.mean() {
            let apart = plane - mean;
            let Some(expected) = (of_mean + covariance).try_inverse() else { return false };
            if apart.dot(&(expected * apart)) > APART_MAX {
                return false;
            }
        }
        self.information += information;
        self.pull += information * plane;
        true
    }

    /// The mean so far, and its covariance: as if one pair had all information on average, since relief and depth edges look alike in all of them.
    fn mean(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let inverse = self.information.try_inverse()?;
        Some((inverse * self.pull, inverse * f64::from(self.used + 1)))
    }
}

impl Target {
    /// Counts the time since the first pair.
    pub(crate) fn grow_older(&mut self, step_s: f64) {
        self.evidence.age_s += step_s;
    }

    /// Whether this pair, in which the target was found, is to show the surface.
    pub(crate) fn wants_surface(&self, prior: &FramePrior) -> bool {
        let SurfaceEvidence { looks, age_s, .. } = self.evidence;
        self.is_on_surface
            && looks < LOOKS_MAX
            && age_s >= LOOK_EVERY_S * f64::from(looks + 1)
            && prior.skew_s == 0.0
            && self.lost_frames == 0
            && self.fits_well()
            && !self.in_doubt()
            && !self.is_unverified
    }

    /// Adds the plane that this pair shows, in its left camera.
    pub(crate) fn take_surface(&mut self, measured: Option<&SurfacePlane>) {
        self.evidence.looks += 1;
        let first = self.views[0].cam_left_from_model;
        let (Some(measured), Some(of_motion), Some(of_first)) = (measured, self.covariance, self.first_pose_covariance)
        else {
            return;
        };
        let plane_block = |covariance: &Matrix6<f64>| covariance.fixed_view::<3, 3>(2, 2).into_owned();
        let in_planes = |covariance: &Matrix6<f64>| {
            let by_frame = depth_and_tilts_by_plane(&plane_of(&first), &first).try_inverse()?;
            Some(by_frame * plane_block(covariance) * by_frame.transpose())
        };
        if self.evidence.used == 0 {
            let Some(covariance) = in_planes(&of_first) else { return };
            self.evidence =
                SurfaceEvidence { looks: self.evidence.looks, age_s: self.evidence.age_s, ..Default::default() };
            self.evidence.add(&plane_of(&first), &covariance);
        }
        let (plane, by_sampled) =
            in_first(&measured.inverse_depth_plane, &(self.estimate.cam_left_from_model * first.inverse()));
        let Some(of_motion) = in_planes(&of_motion) else { return };
        if self.evidence.add(&plane, &(by_sampled * measured.covariance * by_sampled.transpose() + of_motion)) {
            self.evidence.used += 1;
        }
    }

    /// The plane of the visible surface beside `model`.
    pub(crate) fn surface_estimate(&self) -> Option<SurfaceEstimate> {
        let of_first = self.first_pose_covariance?;
        let first = self.views[0].cam_left_from_model;
        let known = SurfaceEstimate { surface_from_model: Pose::coincident(), covariance: of_first, version: 0 };
        let later = || {
            let (plane, covariance) = self.evidence.mean()?;
            let first_from_surface = model_frame(&plane, &(first.translation_m() / first.translation_m().z))?;
            let by_plane = frame_by_plane(&plane, &first_from_surface);
            // What the plane does not tell is known from the first pair alone.
            let mut covariance = by_plane * covariance * by_plane.transpose();
            for axis in [0, 1, 5] {
                covariance[(axis, axis)] += of_first[(axis, axis)];
            }
            let surface_from_model = (first_from_surface.inverse() * first).relabel();
            Some(SurfaceEstimate { surface_from_model, covariance, version: self.evidence.used })
        };
        let later = (self.evidence.used > 0).then(later).flatten();
        Some(later.unwrap_or(known))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, UnitQuaternion};

    use super::*;

    #[test]
    fn a_plane_of_the_present_camera_is_the_same_in_the_first() {
        let turn = UnitQuaternion::from_euler_angles(0.2, -0.1, 0.4);
        let now_from_first = Pose::from_parts(Vector3::new(0.03, -0.02, 0.05), turn);
        let plane = Vector3::new(0.4, -0.7, 2.1);
        let (first, by_plane) = in_first(&plane, &now_from_first);
        for [x, y] in [[0.1, 0.0], [-0.2, 0.1], [0.05, -0.3]] {
            let ray = Vector3::new(x, y, 1.0);
            let in_now = now_from_first.transform_point(&Point3::from(ray / first.dot(&ray)));
            assert!((plane.dot(&in_now.coords) - 1.0).abs() < 1e-12);
        }
        let step = Vector3::new(1e-6, -2e-6, 3e-6);
        let moved = in_first(&(plane + step), &now_from_first).0 - first;
        assert!((moved - by_plane * step).norm() < 1e-4 * moved.norm());
    }

    #[test]
    fn the_mean_follows_the_surer_planes_and_leaves_out_another_surface() {
        let [first, second] = [Vector3::new(0.1, 0.2, 2.0), Vector3::new(0.11, 0.19, 2.01)];
        let mut evidence = SurfaceEvidence::default();
        assert!(evidence.mean().is_none());
        assert!(evidence.add(&first, &(Matrix3::identity() * 4e-4)));
        assert!(evidence.add(&second, &(Matrix3::identity() * 1e-4)));
        evidence.used = 1;
        let (mean, covariance) = evidence.mean().unwrap();
        assert!((mean - (first * 0.2 + second * 0.8)).norm() < 1e-9);
        // 1 / (2500 + 10000) of two.
        assert!((covariance - Matrix3::identity() * 1.6e-4).norm() < 1e-9);
        assert!(!evidence.add(&(second * 1.2), &(Matrix3::identity() * 1e-4)));
        assert!((evidence.mean().unwrap().0 - mean).norm() < 1e-12);
    }
}
