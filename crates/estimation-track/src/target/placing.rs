//! Where the frame `model` is on the target, in the first pair.

use nalgebra::{Matrix6x3, Vector3};
use pb3dp_estimation_core::method::KnownModel;
use pb3dp_estimation_direct::estimator::SurfacePlane;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};

use super::{Frame, Target};
use crate::predict::Motion;
use crate::surface::model_frame;

/// Largest difference of the distances of two planes of one surface. Chosen by hand, not varied: 25 mm at half a metre.
const SAME_SURFACE_SHARE: f64 = 0.05;

/// Derivatives `[rho; phi]` of a frame on an inverse-depth plane, with its origin on a fixed ray, by the plane. A turn about its normal is none.
pub(super) fn frame_by_plane(plane: &Vector3<f64>, cam_left_from_model: &Pose<CamLeft, Model>) -> Matrix6x3<f64> {
    let origin = cam_left_from_model.translation_m();
    let turn = cam_left_from_model.rotation().to_rotation_matrix().transpose();
    // The origin moves along its ray by -dq . origin of its distance, and z of the frame by dq / |q| across itself.
    let shift = -(turn * origin) * origin.transpose();
    let across = turn.matrix() / plane.norm();
    let mut by_plane = Matrix6x3::zeros();
    by_plane.fixed_view_mut::<3, 3>(0, 0).copy_from(&shift);
    by_plane.row_mut(3).copy_from(&-across.row(1));
    by_plane.row_mut(4).copy_from(&across.row(0));
    by_plane
}

impl Target {
    /// Moves the frame `model` onto the plane of the refined surface, in the first pair. For a plane that was only a start value:
    /// the refined one is more accurate, and the covariance is that of the refined one.
    pub(crate) fn settle_on_plane(&mut self, frame: &Frame<'_>) {
        let plane = self.surface.plane;
        if self.place_frame(&plane).is_some() {
            self.settle_in_place(frame);
        }
    }

    /// Moves the frame `model` of a curved target onto the plane of its visible surface, in the first pair. The covariance contains that of this
    /// plane then. A surface elsewhere is another one than that of the target.
    pub(crate) fn settle_on_surface(&mut self, frame: &Frame<'_>, surface: &SurfacePlane) {
        let SurfacePlane { inverse_depth_plane: plane, covariance: of_plane } = surface;
        let apart = 1.0 - plane.dot(&self.estimate.cam_left_from_model.translation_m());
        if apart.abs() > SAME_SURFACE_SHARE || self.place_frame(plane).is_none() {
            return;
        }
        self.settle_in_place(frame);
        self.is_on_surface = true;
        let by_plane = frame_by_plane(plane, &self.estimate.cam_left_from_model);
        if let Some(covariance) = &mut self.covariance {
            *covariance += by_plane * of_plane * by_plane.transpose();
        }
    }

    /// Moves the frame `model` onto a plane in the first pair, and expresses everything but the estimate in it. Maps the old frame to the
    /// new one.
    pub(super) fn place_frame(&mut self, plane: &Vector3<f64>) -> Option<Pose<Model, Model>> {
        let before = self.views[0].cam_left_from_model.translation_m();
        Some(self.place_model(model_frame(plane, &(before / before.z))?))
    }

    /// The same for a frame that is known.
    fn place_model(&mut self, pose: Pose<CamLeft, Model>) -> Pose<Model, Model> {
        let after_from_before = pose.inverse() * self.views[0].cam_left_from_model;
        self.surface.model_from_first = pose.inverse();
        self.surface.rebuild();
        self.outline_in_model.iter_mut().for_each(|point| *point = after_from_before.transform_point(point));
        self.views[0].cam_left_from_model = pose;
        self.motion = Motion::resting(pose);
        after_from_before
    }

    /// Moves the frame `model` to where it was when the target was followed before, in the first pair. What this pair shows of the surface stands
    /// beside it. Returns whether it did: a model elsewhere is that of another target.
    pub(crate) fn restore_model(
        &mut self,
        frame: &Frame<'_>,
        known: &KnownModel,
        surface: Option<&SurfacePlane>,
    ) -> bool {
        let normal = self.estimate.cam_left_from_model.transform_vector(&Vector3::z());
        let apart = normal
            .dot(&(known.cam_left_from_model.translation_m() - self.estimate.cam_left_from_model.translation_m()));
        if apart.abs() > SAME_SURFACE_SHARE * self.estimate.cam_left_from_model.translation_m().norm() {
            return false;
        }
        self.place_model(known.cam_left_from_model);
        self.settle_in_place(frame);
        self.first_pose_covariance = Some(known.first_pose_covariance);
        if surface.is_some() {
            self.take_surface(surface);
        }
        true
    }

    /// Evaluates the first pair with the frame `model` where it is.
    fn settle_in_place(&mut self, frame: &Frame<'_>) {
        self.estimate.cam_left_from_model = self.motion.cam_left_from_model;
        if let Some(equations) = self.examine(frame, false) {
            self.judge();
            self.conclude(&equations, false);
        }
    }
}
