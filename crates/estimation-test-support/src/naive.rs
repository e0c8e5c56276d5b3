//! The published fitness, implemented point by point: the reference for correctness and for speed.
//!
//! Double precision, hue by the textbook formula at every sample, a branch for every case. No code of the estimators is used, so
//! agreement is meaningful; its run time is the baseline for their kernels.
#![allow(clippy::expect_used, reason = "support code of tests, with inputs that are valid")]

use image::RgbImage;
use nalgebra::{Matrix3, Vector2, Vector3};
use pb3dp_geometry::StereoRig;

/// The value 20 of the paper.
const TOLERANCE_DEG: f64 = 20.0;

/// A model point: left pixel and hue in degrees.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    pub u: f64,
    pub v: f64,
    pub hue_deg: f64,
}

/// Hue of the HSV hexagon in degrees, 0 to 360; `None` below the gates.
pub fn hue_deg([r, g, b]: [u8; 3], saturation_min: f64, value_min: f64) -> Option<f64> {
    let (r, g, b) = (f64::from(r), f64::from(g), f64::from(b));
    let max = r.max(g).max(b);
    let min = r.min(g).min(b);
    if max == min || max / 255.0 < value_min || (max - min) / max < saturation_min {
        return None;
    }
    let hue = if max == r {
        60.0 * (g - b) / (max - min)
    } else if max == g {
        60.0 * (2.0 + (b - r) / (max - min))
    } else {
        60.0 * (4.0 + (r - g) / (max - min))
    };
    Some(if hue < 0.0 { hue + 360.0 } else { hue })
}

/// One frame.
pub struct Naive<'a> {
    pub rig: &'a StereoRig,
    pub right: &'a RgbImage,
    pub centre_px: Vector2<f64>,
    pub inner: Vec<Point>,
    pub outer: Vec<Point>,
    pub saturation_min: f64,
    pub value_min: f64,
}

/// A plane and the rig, in the form needed by the projection.
struct Plane {
    normal: Vector3<f64>,
    distance_m: f64,
    rotation: Matrix3<f64>,
    translation_m: Vector3<f64>,
}

impl Naive<'_> {
    /// `F_R` of eq. (10).
    pub fn fitness(&self, z_m: f64, theta_x_rad: f64, theta_y_rad: f64) -> f64 {
        let plane = self.plane(z_m, theta_x_rad, theta_y_rad);
        let mut sum = 0.0;
        for point in &self.inner {
            sum += if self.matches(&plane, point) { 2.0 } else { -1.0 };
        }
        for point in &self.outer {
            sum += if self.matches(&plane, point) { 0.1 } else { -2.0 };
        }
        sum / (2.0 * self.inner.len() as f64 + 0.1 * self.outer.len() as f64)
    }

    /// Minimum and maximum number of matches of inner and of outer points, if every pixel address may deviate by `slack_px` and
    /// hue differences of up to 20.02 degrees may count as 20.
    #[allow(dead_code, reason = "the speed example needs the fitness alone")]
    pub fn match_bounds(&self, z_m: f64, theta_x_rad: f64, theta_y_rad: f64, slack_px: f64) -> [(u32, u32); 2] {
        let plane = self.plane(z_m, theta_x_rad, theta_y_rad);
        [&self.inner, &self.outer].map(|points| {
            points.iter().fold((0, 0), |(least, most), point| {
                let at = self.project(&plane, point).expect("in front");
                let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)];
                let hits = |tolerance_deg| {
                    let near = |(du, dv): &(f64, f64)| at + Vector2::new(du * slack_px, dv * slack_px);
                    corners.iter().filter(|corner| self.sees(point, &near(corner), tolerance_deg)).count()
                };
                (least + u32::from(hits(TOLERANCE_DEG) == 4), most + u32::from(hits(TOLERANCE_DEG + 0.02) > 0))
            })
        })
    }

    fn plane(&self, z_m: f64, theta_x_rad: f64, theta_y_rad: f64) -> Plane {
        let normal = Vector3::new(
            theta_y_rad.sin() * theta_x_rad.cos(),
            -theta_x_rad.sin(),
            theta_y_rad.cos() * theta_x_rad.cos(),
        );
        Plane {
            normal,
            distance_m: z_m * normal.dot(&self.left_ray(self.centre_px.x, self.centre_px.y)),
            rotation: self.rig.cam_right_from_cam_left().rotation_matrix(),
            translation_m: self.rig.cam_right_from_cam_left().translation_m(),
        }
    }

    fn left_ray(&self, u: f64, v: f64) -> Vector3<f64> {
        let k = self.rig.left().pinhole();
        Vector3::new((u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0)
    }

    /// Inverse projection onto the plane and re-projection; `None` behind a camera.
    fn project(&self, plane: &Plane, point: &Point) -> Option<Vector2<f64>> {
        let ray = self.left_ray(point.u, point.v);
        let depth_m = plane.distance_m / plane.normal.dot(&ray);
        if depth_m <= 0.0 {
            return None;
        }
        let in_right = plane.rotation * (ray * depth_m) + plane.translation_m;
        if in_right.z <= 0.0 {
            return None;
        }
        let k = self.rig.right().pinhole();
        Some(Vector2::new(k.fx * in_right.x / in_right.z + k.cx, k.fy * in_right.y / in_right.z + k.cy))
    }

    fn matches(&self, plane: &Plane, point: &Point) -> bool {
        match self.project(plane, point) {
            Some(at) => self.sees(point, &at, TOLERANCE_DEG),
            None => false,
        }
    }

    fn sees(&self, point: &Point, at: &Vector2<f64>, tolerance_deg: f64) -> bool {
        let (u, v) = (at.x + 0.5, at.y + 0.5);
        if u < 0.0 || v < 0.0 || u >= f64::from(self.right.width()) || v >= f64::from(self.right.height()) {
            return false;
        }
        let pixel = self.right.get_pixel(u as u32, v as u32).0;
        match hue_deg(pixel, self.saturation_min, self.value_min) {
            Some(hue) => {
                let difference = (hue - point.hue_deg).abs();
                difference.min(360.0 - difference) <= tolerance_deg
            }
            None => false,
        }
    }
}
