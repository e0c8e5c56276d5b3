//! An estimated plane against the ground truth of its case.

use nalgebra::Vector3;
use pb3dp_geometry::StereoRig;

use crate::dataset::{Case, Hardness, PlaneTruth};
use crate::images::DisparityMap;
use crate::metrics::median;
use crate::overlay::mask::polygon_pixels;

/// A plane in `cam_left`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneEstimate {
    /// Depth of the plane on the ray of the region's centroid, metres.
    pub z_m: f64,
    /// Unit normal in `cam_left` that faces the camera.
    pub normal_in_cam_left: Vector3<f64>,
}

/// Error of a plane estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneError {
    /// Estimated minus true depth, metres.
    pub z_m: f64,
    /// Depth error divided by the true depth (0.01 is one percent).
    pub z_ratio: f64,
    /// Angle between the normals, radians, 0 to pi.
    pub normal_rad: f64,
    /// The depth error as an error of disparity at the centroid, pixels: `-z_m / m_per_px_disparity`. `None` if the ground truth
    /// does not contain that ratio.
    pub disparity_px: Option<f64>,
}

impl PlaneError {
    /// Whether the usual criterion is met: depth within 1 % and normal within 5 degrees.
    pub fn is_good(&self) -> bool {
        self.z_ratio.abs() < 0.01 && self.normal_rad < 5_f64.to_radians()
    }
}

/// The error of an estimate against the ground truth.
pub fn compare_plane(estimate: &PlaneEstimate, truth: &PlaneTruth) -> PlaneError {
    let z_m = estimate.z_m - truth.z_m;
    PlaneError {
        z_m,
        z_ratio: z_m / truth.z_m,
        normal_rad: angle_rad(&estimate.normal_in_cam_left, &truth.normal_in_cam_left),
        disparity_px: truth.m_per_px_disparity.map(|m_per_px| -z_m / m_per_px),
    }
}

/// Angle between two vectors, radians; exact for small angles, unlike the arc cosine.
pub(crate) fn angle_rad(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b))
}

/// The group in which the errors of a case are reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Group {
    /// Planar, textured, none of the groups below.
    Textured,
    /// Planar, 28 to 40 pixels across.
    Small,
    /// Planar, weak texture.
    LowTexture,
    /// Planar, 15 to 35 % of the region on another surface.
    Occluded,
    /// Not a plane: only depth and disparity are meaningful.
    NonPlanar,
    /// Chessboards and boards with markers, planar with a repeating pattern.
    Boards,
}

impl Group {
    /// All groups in the order of the report.
    pub const ALL: [Self; 6] =
        [Self::Textured, Self::Small, Self::LowTexture, Self::Occluded, Self::NonPlanar, Self::Boards];

    /// The group of a case, from its keys `planar`, `hard` and `region_kind`.
    pub fn of(case: &Case) -> Self {
        match (case.planar, case.hard) {
            (false, _) => Self::NonPlanar,
            (true, Some(Hardness::Small)) => Self::Small,
            (true, Some(Hardness::LowTexture)) => Self::LowTexture,
            (true, Some(Hardness::Occluded)) => Self::Occluded,
            (true, None) if case.is_board() => Self::Boards,
            (true, None) => Self::Textured,
        }
    }

    /// The name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Textured => "textured",
            Self::Small => "small",
            Self::LowTexture => "lowtex",
            Self::Occluded => "occl",
            Self::NonPlanar => "non-planar",
            Self::Boards => "boards",
        }
    }
}

/// The result of one case, for the summary.
#[derive(Clone, Debug, PartialEq)]
pub struct EvaluatedCase {
    /// Its group.
    pub group: Group,
    /// Its status.
    pub status: &'static str,
    /// Its error; `None` if the method gave no pose that may be used.
    pub error: Option<PlaneError>,
    /// Agreement with the disparity map, if there is one.
    pub disparity: Option<DisparityAgreement>,
    /// Single-thread CPU time from images in memory to pose, milliseconds; not finite if the method was not run.
    pub cpu_millis: f64,
}

/// Agreement of a plane with the known disparities inside a region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisparityAgreement {
    /// Median of the absolute difference, pixels.
    pub median_abs_px: f64,
    /// Share of the pixels with a difference of less than 1 pixel, 0 to 1.
    pub share_within_1px: f64,
    /// Number of pixels with known disparity.
    pub pixels: usize,
}

impl DisparityAgreement {
    /// Compares the plane through depth `estimate.z_m` on the ray of `centroid_px` with the disparity map, pixel by pixel
    /// inside the polygon. `None` if the rig is not rectified or no pixel of the region has a known disparity.
    pub fn of(
        estimate: &PlaneEstimate,
        centroid_px: [f64; 2],
        rig: &StereoRig,
        polygon_px: &[[f64; 2]],
        truth: &DisparityMap,
    ) -> Option<Self> {
        let plane = disparity_plane(estimate, centroid_px, rig)?;
        let size = truth.size();
        let mut differences = Vec::new();
        polygon_pixels(polygon_px, size, |u, v| {
            if let Some(known) = truth.at(u, v) {
                differences.push((plane[0] * f64::from(u) + plane[1] * f64::from(v) + plane[2] - known).abs());
            }
        });
        let within = differences.iter().filter(|d| **d < 1.0).count();
        Some(Self {
            median_abs_px: median(&differences)?,
            share_within_1px: within as f64 / differences.len() as f64,
            pixels: differences.len(),
        })
    }
}

/// `(a, b, c)` of the disparity `u_left - u_right = a u + b v + c` that a plane has in a rectified pair; `None` if the
/// rig is not rectified or the plane passes through the camera.
///
/// With n . X = -h and X = Z K^-1 (u, v, 1): 1/Z = -(n . K^-1 (u, v, 1)) / h, and disparity = f B / Z + cx_l - cx_r.
pub fn disparity_plane(estimate: &PlaneEstimate, centroid_px: [f64; 2], rig: &StereoRig) -> Option<[f64; 3]> {
    if !rig.is_rectified() {
        return None;
    }
    let (left, right) = (rig.left().pinhole(), rig.right().pinhole());
    let ray = Vector3::new((centroid_px[0] - left.cx) / left.fx, (centroid_px[1] - left.cy) / left.fy, 1.0);
    let n = estimate.normal_in_cam_left;
    let h_m = -n.dot(&ray) * estimate.z_m;
    if h_m.abs() < 1e-9 {
        return None;
    }
    let scale = -left.fx * rig.baseline_m() / h_m;
    let (a, b) = (scale * n.x / left.fx, scale * n.y / left.fy);
    let c = scale * (n.z - n.x * left.cx / left.fx - n.y * left.cy / left.fy) + left.cx - right.cx;
    Some([a, b, c])
}

#[cfg(test)]
mod tests {
    use super::*;
    use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose};

    fn truth() -> PlaneTruth {
        PlaneTruth {
            m_per_px_disparity: Some(0.002),
            ..PlaneTruth::exact(Vector3::new(0.0, 0.0, 0.5), Vector3::new(0.36, -0.48, 0.8))
        }
    }

    #[test]
    fn errors_have_sign_ratio_angle_and_disparity() {
        // The normal is rotated by atan(0.1) in the plane of n and a perpendicular vector.
        let n = truth().normal_in_cam_left;
        let across = n.cross(&Vector3::x()).normalize();
        let estimate = PlaneEstimate { z_m: 0.497, normal_in_cam_left: (n + 0.1 * across).normalize() };
        let error = compare_plane(&estimate, &truth());
        assert!((error.z_m + 0.003).abs() < 1e-12);
        assert!((error.z_ratio + 0.006).abs() < 1e-12);
        assert!((error.normal_rad - 0.099_668_652_491_162).abs() < 1e-12, "{}", error.normal_rad);
        assert!((error.disparity_px.unwrap() - 1.5).abs() < 1e-9);
        assert!(!error.is_good(), "5.7 degrees exceed the limit");
        let exact = compare_plane(&PlaneEstimate { z_m: 0.5, normal_in_cam_left: n }, &truth());
        assert_eq!((exact.z_m, exact.normal_rad), (0.0, 0.0));
        assert!(exact.is_good());
    }

    #[test]
    fn truth_from_a_point_and_any_normal_faces_the_camera() {
        let truth = truth();
        assert!((truth.normal_in_cam_left - Vector3::new(-0.36, 0.48, -0.8)).norm() < 1e-12);
        assert!((truth.h_m.unwrap() - 0.4).abs() < 1e-12);
    }

    #[test]
    fn disparity_of_a_plane_is_that_of_its_points() {
        let size = ImageSize { width: 64, height: 48 };
        let camera = |cx| Camera::new(size, Pinhole { fx: 80.0, fy: 81.0, cx, cy: 22.5 }, Distortion::None).unwrap();
        let right_from_left = Pose::from_translation(Vector3::new(-0.07, 0.0, 0.0));
        let rig = StereoRig::new(camera(30.0), camera(33.0), right_from_left).unwrap();
        let normal = Vector3::new(0.2, -0.3, -0.9).normalize();
        let estimate = PlaneEstimate { z_m: 0.6, normal_in_cam_left: normal };
        let plane = disparity_plane(&estimate, [20.0, 30.0], &rig).unwrap();
        let p0 = Vector3::new(-10.0 / 80.0 * 0.6, 7.5 / 81.0 * 0.6, 0.6);
        for (u, v) in [(5.0, 7.0), (50.0, 40.0), (20.0, 30.0)] {
            let ray = rig.left().unproject(&nalgebra::Vector2::new(u, v)).unwrap();
            let point = ray * (normal.dot(&p0) / normal.dot(&ray));
            let in_right = right_from_left.transform_point(&point.into());
            let expected = u - rig.right().project(&in_right).unwrap().x;
            let found = plane[0] * u + plane[1] * v + plane[2];
            assert!((found - expected).abs() < 1e-9, "{found} is not {expected}");
        }
        check_agreement(&estimate, &rig, &plane);
    }

    fn check_agreement(estimate: &PlaneEstimate, rig: &StereoRig, plane: &[f64; 3]) {
        // The map is the plane itself, with an error of 2 px in the left 8 of 16 columns, and unknown in the last row of the
        // region.
        let size = rig.left().size();
        let scaled = (0..size.width * size.height).map(|i| {
            let (u, v) = (i % size.width, i / size.width);
            let off = if u < 18 { 2.0 } else { 0.0 };
            let d = plane[0] * f64::from(u) + plane[1] * f64::from(v) + plane[2] + off;
            if v == 19 { 0 } else { (d * 64.0).round() as u16 }
        });
        let map = DisparityMap::from_scaled(size, scaled.collect()).unwrap();
        let polygon = [[10.0, 10.0], [25.0, 10.0], [25.0, 19.0], [10.0, 19.0]];
        let found = DisparityAgreement::of(estimate, [20.0, 30.0], rig, &polygon, &map).unwrap();
        assert_eq!(found.pixels, 16 * 9);
        assert!((found.share_within_1px - 0.5).abs() < 1e-12);
    }
}
