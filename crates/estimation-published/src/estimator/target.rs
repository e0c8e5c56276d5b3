//! State of the tracked target between two frames.

use nalgebra::{Point3, Quaternion, UnitQuaternion, Vector2, Vector3};
use pb3dp_estimation_core::plane_hypothesis::PlaneHypothesis;
use pb3dp_estimation_core::trig;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pinhole, Pose};

use super::backprojection::Backprojection;
use super::outline_fit::OutlineEdge;
use crate::search::rmga::{Population, RmGa};

/// Largest distance of outline vertices from the image's origin, pixels: farther away the target is outside the image.
const VERTEX_MAX_PX: f64 = 20_000.0;

/// The target in the last frame.
#[derive(Clone, Debug)]
pub(super) struct Target {
    pub rmga: RmGa,
    pub population: Population,
    pub cam_left_from_model: Pose<CamLeft, Model>,
    /// Rotation `cam_left_from_model` of the first frame, updated with the known motion of the camera.
    pub reference_rotation: UnitQuaternion<f64>,
    /// The first frame's outline on the plane, metres.
    pub outline_in_model_m: Vec<Vector2<f64>>,
    pub outline_edge: OutlineEdge,
    /// Rotation of the outline on the plane since the first frame, radians: of the region, not of the pose.
    pub outline_roll_rad: f64,
    pub appearance: Appearance,
    /// Below this fitness the target is lost.
    pub fitness_floor: f64,
    /// Number of frames since the target was last found.
    pub lost_frames: u32,
    /// Whether the whole search range has been surveyed since the target was last found, without finding a rival.
    pub is_assured: bool,
    /// Whether this was ever the case: until then the size of the outline may correspond to a rival's depth.
    pub was_assured: bool,
}

/// Appearance that distinguishes the target from its surroundings.
#[derive(Clone, Debug)]
pub(super) struct Appearance {
    pub colours: Backprojection,
    /// Centroid of the target's weights on the plane, metres.
    pub mass_centre_in_model_m: Vector2<f64>,
    /// Sum of the weights divided by the area of the region, first frame.
    pub mass_per_area: f64,
}

/// A region propagated to a new frame.
pub(super) struct Carried {
    pub outline_px: Vec<Vector2<f64>>,
    /// Position of the model's origin in the undistorted left image.
    pub origin_px: Vector2<f64>,
    /// Expected position of the centroid of the target's weights.
    pub mass_centre_px: Vector2<f64>,
}

impl Carried {
    pub(super) fn shift(&mut self, shift_px: &Vector2<f64>) {
        self.outline_px.iter_mut().for_each(|vertex| *vertex += shift_px);
        self.origin_px += shift_px;
        self.mass_centre_px += shift_px;
    }
}

impl Target {
    /// Projects the region into the image with the last pose; `None` if part of it is not in front of the camera.
    pub(super) fn region_in(&self, pinhole: &Pinhole) -> Option<Carried> {
        let turn = trig::rotation(self.outline_roll_rad);
        let turned = |point: &Vector2<f64>| pixel_of(&self.cam_left_from_model, pinhole, &(turn * point));
        Some(Carried {
            outline_px: self.outline_in_model_m.iter().map(turned).collect::<Option<_>>()?,
            origin_px: turned(&Vector2::zeros())?,
            mass_centre_px: turned(&self.appearance.mass_centre_in_model_m)?,
        })
    }

    /// Converts the last pose to the camera frame of the new frame, for a stationary target.
    pub(super) fn move_camera(&mut self, cam_left_prev_from_cam_left_now: &Pose<CamLeft, CamLeft>) {
        let cam_left_now_from_cam_left_prev = cam_left_prev_from_cam_left_now.inverse();
        self.cam_left_from_model = cam_left_now_from_cam_left_prev * self.cam_left_from_model;
        self.reference_rotation = cam_left_now_from_cam_left_prev.rotation() * self.reference_rotation;
        self.reference_rotation.renormalize();
    }

    /// The same for every individual; individuals that the motion moves behind the camera do not change.
    pub(super) fn move_population(
        &mut self,
        cam_left_prev_from_cam_left_now: &Pose<CamLeft, CamLeft>,
        old_centre_ray: &Vector3<f64>,
        new_centre_ray: &Vector3<f64>,
    ) {
        let rotation = cam_left_prev_from_cam_left_now.rotation_matrix();
        let translation_m = cam_left_prev_from_cam_left_now.translation_m();
        let moved = |psi: &PlaneHypothesis| {
            // A plane q . X = 1 in the new camera: X = R X' + t gives (RT q) . X' = 1 - q . t.
            let q = psi.inverse_depth_plane(old_centre_ray)?;
            let rest = 1.0 - q.dot(&translation_m);
            let q_now = rotation.transpose() * q / rest;
            (rest > 0.0).then(|| PlaneHypothesis::from_inverse_depth_plane(&q_now, new_centre_ray)).flatten()
        };
        self.population.shift(self.rmga.codec(), |psi| moved(&psi).unwrap_or(psi));
    }
}

/// Undistorted left pixel of a point of the model's plane, metres; `None` if it is not in front of the camera or far outside
/// the image.
pub(super) fn pixel_of(
    cam_left_from_model: &Pose<CamLeft, Model>,
    pinhole: &Pinhole,
    point_in_model_m: &Vector2<f64>,
) -> Option<Vector2<f64>> {
    let point_in_model = Point3::new(point_in_model_m.x, point_in_model_m.y, 0.0);
    let point_in_cam_left = cam_left_from_model.transform_point(&point_in_model);
    let pixel = pinhole.pixel_from_normalized(&(point_in_cam_left.coords.xy() / point_in_cam_left.z));
    (point_in_cam_left.z > 0.0 && pixel.iter().all(|c| c.abs() < VERTEX_MAX_PX)).then_some(pixel)
}

/// The reference rotation, rotated by the smallest rotation that aligns its z axis with `normal_away`. Of all rotations with
/// that normal it is the smallest change, so it implies nothing about the rotation about the normal.
pub(super) fn with_normal(reference: &UnitQuaternion<f64>, normal_away: &Vector3<f64>) -> UnitQuaternion<f64> {
    let z = reference * Vector3::z();
    // The quaternion (1 + cos a, sin a axis) is 2 cos(a / 2) times that of the rotation by a; no angle is needed.
    let doubled = Quaternion::from_parts(1.0 + z.dot(normal_away), z.cross(normal_away));
    // For an inverted normal the axis is undefined; no search range contains it.
    let turn = UnitQuaternion::try_new(doubled, 1e-6).unwrap_or_default();
    let mut turned = turn * reference;
    turned.renormalize();
    turned
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_normal_turns_the_frame_least_and_the_old_one_not_at_all() {
        let reference = UnitQuaternion::from_euler_angles(-0.1, -0.25, 0.3);
        let same = with_normal(&reference, &(reference * Vector3::z()));
        assert!(same.angle_to(&reference) < 1e-9);
        let normal = Vector3::new(0.2, 0.3, 0.9).normalize();
        let turned = with_normal(&reference, &normal);
        assert!((turned * Vector3::z() - normal).norm() < 1e-12);
        let between_normals = (reference * Vector3::z()).angle(&normal);
        assert!((turned.angle_to(&reference) - between_normals).abs() < 1e-9, "the smallest rotation");
    }
}
