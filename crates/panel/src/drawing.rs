//! Where outlines, axes and epipolar lines lie in the raw images.

use nalgebra::{Point3, Vector2, Vector3};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Camera, Pose, StereoRig};

use crate::messages::{Pixel, pixels};

/// Length of the drawn axes as a share of the distance, as in the images of reports.
const AXIS_SHARE: f64 = 0.12;
/// Points of an epipolar line; lens distortion bends it.
const LINE_POINTS: u32 = 48;
/// Nearest depth of an epipolar line, in baselines: nearer points have disparities above half of most images.
const LINE_NEAREST_BASELINES: f64 = 1.5;

/// The outline transferred to the right image by the plane of the model; empty if a vertex is not visible there.
pub fn outline_right(outline_px: &[Vector2<f64>], rig: &StereoRig, pose: &Pose<CamLeft, Model>) -> Vec<Pixel> {
    let normal = pose.transform_vector(&Vector3::z());
    let origin = pose.translation_m();
    let moved = outline_px.iter().map(|pixel| {
        let ray = rig.left().unproject(pixel).ok()?;
        let depth_m = normal.dot(&origin) / normal.dot(&ray);
        let point_in_cam_right = rig.cam_right_from_cam_left().transform_point(&Point3::from(ray * depth_m));
        (depth_m > 0.0).then(|| rig.right().project(&point_in_cam_right)).flatten()
    });
    moved.collect::<Option<Vec<_>>>().map(|points| pixels(&points)).unwrap_or_default()
}

/// Origin and ends of the axes of the model in the left and the right image; `None` where one is not visible.
pub fn axes(rig: &StereoRig, pose: &Pose<CamLeft, Model>) -> [Option<[Pixel; 4]>; 2] {
    let axis_m = AXIS_SHARE * pose.translation_m().z;
    let ends = [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()];
    let points_in_cam_left = ends.map(|end| pose.transform_point(&Point3::from(end * axis_m)));
    let points_in_cam_right = points_in_cam_left.map(|point| rig.cam_right_from_cam_left().transform_point(&point));
    [projected(rig.left(), points_in_cam_left), projected(rig.right(), points_in_cam_right)]
}

fn projected(camera: &Camera, points_in_cam: [Point3<f64>; 4]) -> Option<[Pixel; 4]> {
    let found: Option<Vec<_>> = points_in_cam.iter().map(|point| camera.project(point)).collect();
    pixels(&found?).try_into().ok()
}

/// The line of a left pixel in the right image, from infinity to the nearest depth, the visible part.
pub fn epipolar(rig: &StereoRig, pixel: Vector2<f64>) -> Vec<Pixel> {
    let Ok(ray) = rig.left().unproject(&pixel) else { return Vec::new() };
    let nearest_per_m = 1.0 / (LINE_NEAREST_BASELINES * rig.baseline_m());
    let size = rig.right().size();
    let is_inside = |point: &Vector2<f64>| {
        (-0.5..=f64::from(size.width) - 0.5).contains(&point.x)
            && (-0.5..=f64::from(size.height) - 0.5).contains(&point.y)
    };
    let points = (0..=LINE_POINTS).filter_map(|step| {
        let inverse_depth = nearest_per_m * f64::from(step) / f64::from(LINE_POINTS);
        let from_left = rig.cam_right_from_cam_left();
        // The point at inverse depth q is d / q; scaled by q it stays finite at infinity.
        let scaled = from_left.transform_vector(&ray) + from_left.translation_m() * inverse_depth;
        rig.right().project(&Point3::from(scaled)).filter(is_inside)
    });
    pixels(&points.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;
    use pb3dp_setup::layers::SetupArgs;
    use pb3dp_setup::setup::read_layers;

    use super::*;

    fn rig() -> StereoRig {
        read_layers(&SetupArgs { configs: vec!["sim".into()], ..SetupArgs::default() }).unwrap().rig.stereo
    }

    #[test]
    fn outline_and_axes_lie_where_the_cameras_see_the_plane() {
        let rig = rig();
        let tilt = UnitQuaternion::from_euler_angles(0.2, -0.3, 0.1);
        let pose = Pose::<CamLeft, Model>::from_parts(Vector3::new(0.02, -0.01, 0.6), tilt);
        let corners = [[-0.03, -0.02], [0.04, -0.02], [0.03, 0.03]].map(|[x, y]| Point3::new(x, y, 0.0));
        let in_left = corners.map(|corner| rig.left().project(&pose.transform_point(&corner)).unwrap());
        let right = outline_right(&in_left, &rig, &pose);
        let in_cam_right = *rig.cam_right_from_cam_left() * pose;
        for (found, corner) in right.iter().zip(&corners) {
            let expected = rig.right().project(&in_cam_right.transform_point(corner)).unwrap();
            assert!((Vector2::from(*found) - expected).norm() < 0.02, "{found:?} {expected}");
        }
        let [Some(left), Some(_)] = axes(&rig, &pose) else { panic!("visible") };
        let origin = rig.left().project(&Point3::from(pose.translation_m())).unwrap();
        assert!((Vector2::from(left[0]) - origin).norm() < 0.02);
    }

    #[test]
    fn an_epipolar_line_passes_through_the_points_on_the_ray() {
        let rig = rig();
        let pixel = Vector2::new(400.0, 150.0);
        let line = epipolar(&rig, pixel);
        let ray = rig.left().unproject(&pixel).unwrap();
        for depth_m in [0.5, 0.8, 2.0] {
            let point = rig.cam_right_from_cam_left().transform_point(&Point3::from(ray * depth_m));
            let in_right = rig.right().project(&point).unwrap();
            let distance = |from: &Pixel, to: &Pixel| {
                let (from, to) = (Vector2::from(*from), Vector2::from(*to));
                let share = ((in_right - from).dot(&(to - from)) / (to - from).norm_squared()).clamp(0.0, 1.0);
                (from + (to - from) * share - in_right).norm()
            };
            let nearest = line.windows(2).map(|ends| distance(&ends[0], &ends[1])).fold(f64::INFINITY, f64::min);
            assert!(nearest < 0.05, "{depth_m} m: {nearest} px");
        }
        assert!(epipolar(&rig, Vector2::new(f64::NAN, 0.0)).is_empty());
    }
}
