//! Pictures that show what was estimated: the region and the pose's axes left, the re-projected model right.

use image::RgbImage;
use nalgebra::{Point3, Unit, UnitQuaternion, Vector2, Vector3};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};
use pb3dp_record::overlay::{self, Stroke, TextStyle, colors};

/// What is drawn of one target into a stereo pair.
#[derive(Clone, Debug)]
pub struct Annotation {
    /// Outline of the region in the raw left picture, pixels.
    pub outline_px: Vec<[f64; 2]>,
    /// The estimated plane, if there is one: pose of a frame in it, z along its normal away from the camera.
    pub cam_left_from_model: Option<Pose<CamLeft, Model>>,
    /// One line of text: status and figures.
    pub label: String,
    /// Whether the label tells of a failure.
    pub is_bad: bool,
}

/// Corners for drawing.
pub fn polygon_px(corners_px: &[Vector2<f64>]) -> Vec<[f64; 2]> {
    corners_px.iter().map(|p| [p.x, p.y]).collect()
}

/// Distance between the labels of two targets, pixels.
const LABEL_STEP_PX: f64 = 24.0;

/// Left and right picture side by side with all targets drawn in.
pub fn annotate(left: &RgbImage, right: &RgbImage, rig: &StereoRig, targets: &[Annotation]) -> RgbImage {
    let (mut left, mut right) = (left.clone(), right.clone());
    for what in targets {
        overlay::polygon(&mut left, &what.outline_px, Stroke::of(colors::REGION));
        if let Some(pose) = &what.cam_left_from_model {
            let outline_right = reprojected(&what.outline_px, rig, pose);
            if let Some(outline_right) = outline_right {
                overlay::polygon(&mut right, &outline_right, Stroke::of(colors::ESTIMATE));
            }
            let axis_m = 0.12 * pose.translation_m().z;
            overlay::pose_axes(&mut left, rig.left(), pose, axis_m);
            let cam_right_from_model = *rig.cam_right_from_cam_left() * *pose;
            overlay::pose_axes(&mut right, rig.right(), &cam_right_from_model, axis_m);
        }
    }
    // Labels last, over everything else.
    for (row, what) in (0_u32..).zip(targets) {
        let color = if what.is_bad { colors::BAD } else { colors::ESTIMATE };
        let style = TextStyle { scale: 2, ..TextStyle::of(color) };
        overlay::text(&mut left, [6.0, 6.0 + LABEL_STEP_PX * f64::from(row)], &what.label, style);
    }
    overlay::side_by_side(&left, &right)
}

/// The outline carried to the right picture by the plane of `pose`; `None` if a vertex is not seen there.
fn reprojected(outline_px: &[[f64; 2]], rig: &StereoRig, pose: &Pose<CamLeft, Model>) -> Option<Vec<[f64; 2]>> {
    let normal = pose.transform_vector(&Vector3::z());
    let origin = pose.translation_m();
    outline_px
        .iter()
        .map(|&[u, v]| {
            let ray = rig.left().unproject(&Vector2::new(u, v)).ok()?;
            let depth_m = normal.dot(&origin) / normal.dot(&ray);
            let point_in_cam_left = Point3::from(ray * depth_m);
            let point_in_cam_right = rig.cam_right_from_cam_left().transform_point(&point_in_cam_left);
            let pixel = (depth_m > 0.0).then(|| rig.right().project(&point_in_cam_right)).flatten()?;
            Some([pixel.x, pixel.y])
        })
        .collect()
}

/// The frame on a plane whose origin lies at `origin_in_cam_left` (metres), z along the normal away from the camera, x as
/// near to the camera's x axis as the plane allows.
pub fn model_frame_on_plane(
    origin_in_cam_left: Vector3<f64>,
    normal_in_cam_left: &Vector3<f64>,
) -> Option<Pose<CamLeft, Model>> {
    let z = Unit::try_new(-normal_in_cam_left, 1e-9)?;
    let x = Unit::try_new(Vector3::x() - z.into_inner() * z.x, 1e-9)?;
    let y = z.cross(&x);
    let rotation = nalgebra::Matrix3::from_columns(&[x.into_inner(), y, z.into_inner()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(rotation));
    Some(Pose::from_parts(origin_in_cam_left, rotation))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frame_lies_in_the_plane_and_looks_away() {
        let normal = Vector3::new(0.3, -0.2, -0.9).normalize();
        let pose = model_frame_on_plane(Vector3::new(0.1, 0.2, 0.6), &normal).unwrap();
        assert!((pose.transform_vector(&Vector3::z()) + normal).norm() < 1e-12);
        let x = pose.transform_vector(&Vector3::x());
        assert!(x.dot(&normal).abs() < 1e-12 && x.x > 0.9);
        assert!((pose.rotation_matrix().determinant() - 1.0).abs() < 1e-12);
        assert!(model_frame_on_plane(Vector3::zeros(), &Vector3::x()).is_none(), "seen edge-on: no frame");
    }
}
