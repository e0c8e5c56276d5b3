//! Drawing on images: visualisation of inputs and results.
//!
//! Coordinates are pixels with integer pixel centres, as everywhere. Drawing is clipped at the image border; values that are not
//! finite are not drawn. Lines are anti-aliased.

pub mod animation;
pub mod mask;
mod text;

pub use animation::{Animation, AnimationError, AnimationLimits};
pub use text::{TextStyle, text, text_size};

use image::{Rgb, RgbImage, imageops};
use nalgebra::Point3;
use pb3dp_geometry::{Camera, Frame, Pose};

/// Colours that are distinct on photographs and from each other.
pub mod colors {
    use image::Rgb;

    /// The region given by the operator.
    pub const REGION: Rgb<u8> = Rgb([255, 214, 10]);
    /// An estimate.
    pub const ESTIMATE: Rgb<u8> = Rgb([50, 230, 120]);
    /// An estimate with low confidence in its tilt.
    pub const WEAK: Rgb<u8> = Rgb([255, 150, 20]);
    /// An ambiguous estimate, which may be at a different depth.
    pub const AMBIGUOUS: Rgb<u8> = Rgb([235, 110, 245]);
    /// Ground truth.
    pub const TRUTH: Rgb<u8> = Rgb([60, 170, 255]);
    /// A failure.
    pub const BAD: Rgb<u8> = Rgb([255, 60, 60]);
    /// x, y and z axis.
    pub const AXES: [Rgb<u8>; 3] = [Rgb([255, 60, 60]), Rgb([60, 220, 60]), Rgb([80, 140, 255])];
}

/// Line style.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Colour.
    pub color: Rgb<u8>,
    /// Width, pixels.
    pub width_px: f64,
}

impl Stroke {
    /// A line of 2 pixels.
    pub fn of(color: Rgb<u8>) -> Self {
        Self { color, width_px: 2.0 }
    }
}

/// Draws an open line through points.
pub fn polyline(image: &mut RgbImage, points_px: &[[f64; 2]], stroke: Stroke) {
    for pair in points_px.windows(2) {
        segment(image, pair[0], pair[1], stroke);
    }
}

/// Draws the closed outline of a polygon.
pub fn polygon(image: &mut RgbImage, corners_px: &[[f64; 2]], stroke: Stroke) {
    polyline(image, corners_px, stroke);
    if let [first, .., last] = corners_px {
        segment(image, *last, *first, stroke);
    }
}

/// Draws an upright cross with arms of `arm_px` around a point.
pub fn cross(image: &mut RgbImage, [u, v]: [f64; 2], arm_px: f64, stroke: Stroke) {
    segment(image, [u - arm_px, v], [u + arm_px, v], stroke);
    segment(image, [u, v - arm_px], [u, v + arm_px], stroke);
}

/// Draws an arrow.
pub fn arrow(image: &mut RgbImage, from: [f64; 2], to: [f64; 2], stroke: Stroke) {
    segment(image, from, to, stroke);
    let (du, dv) = (to[0] - from[0], to[1] - from[1]);
    let length = du.hypot(dv);
    if length < 1.0 {
        return;
    }
    let head = (0.25 * length).clamp(3.0, 10.0) / length;
    for side in [-0.5, 0.5] {
        let barb = [to[0] - head * (du + side * dv), to[1] - head * (dv - side * du)];
        segment(image, to, barb, stroke);
    }
}

/// Draws a triad of axes from its points: the origin and the tips of x (red), y (green), z (blue), with their letters.
pub fn axes(image: &mut RgbImage, origin_px: [f64; 2], tips_px: [[f64; 2]; 3]) {
    for ((tip, color), letter) in tips_px.into_iter().zip(colors::AXES).zip(["x", "y", "z"]) {
        arrow(image, origin_px, tip, Stroke::of(color));
        let (du, dv) = (tip[0] - origin_px[0], tip[1] - origin_px[1]);
        let length = du.hypot(dv).max(1.0);
        let at = [tip[0] + 8.0 * du / length - 4.0, tip[1] + 8.0 * dv / length - 4.0];
        text(image, at, letter, TextStyle { color, background: None, scale: 1 });
    }
}

/// Draws the axes of a frame given in a camera frame, `axis_m` metres long. Draws nothing if one of the points is behind the
/// camera.
pub fn pose_axes<Cam: Frame, F: Frame>(
    image: &mut RgbImage,
    camera: &Camera,
    cam_from_frame: &Pose<Cam, F>,
    axis_m: f64,
) {
    let pixel = |x: f64, y: f64, z: f64| {
        let pixel = camera.project(&cam_from_frame.transform_point(&Point3::new(x, y, z)))?;
        Some([pixel.x, pixel.y])
    };
    let points = (pixel(0.0, 0.0, 0.0), pixel(axis_m, 0.0, 0.0), pixel(0.0, axis_m, 0.0), pixel(0.0, 0.0, axis_m));
    if let (Some(origin), Some(x), Some(y), Some(z)) = points {
        axes(image, origin, [x, y, z]);
    }
}

/// Left and right image side by side with a line between them; the smaller one is padded with black.
pub fn side_by_side(left: &RgbImage, right: &RgbImage) -> RgbImage {
    const GAP_PX: u32 = 2;
    let (width, height) = (left.width() + GAP_PX + right.width(), left.height().max(right.height()));
    let mut both = RgbImage::new(width, height);
    imageops::replace(&mut both, left, 0, 0);
    imageops::replace(&mut both, right, i64::from(left.width() + GAP_PX), 0);
    for v in 0..height {
        for u in left.width()..left.width() + GAP_PX {
            both.put_pixel(u, v, Rgb([255, 255, 255]));
        }
    }
    both
}

/// Draws a straight line with round ends; the coverage of a pixel follows from its distance to the line.
fn segment(image: &mut RgbImage, a: [f64; 2], b: [f64; 2], stroke: Stroke) {
    let half = 0.5 * stroke.width_px;
    if ![a[0], a[1], b[0], b[1], half].iter().all(|x| x.is_finite()) {
        return;
    }
    let (width, height) = image.dimensions();
    let [left, right] = covered(a[0], b[0], half, width);
    let [top, bottom] = covered(a[1], b[1], half, height);
    let (du, dv) = (b[0] - a[0], b[1] - a[1]);
    let length_squared = du * du + dv * dv;
    for v in top..bottom {
        for u in left..right {
            let (pu, pv) = (f64::from(u) - a[0], f64::from(v) - a[1]);
            let along = if length_squared > 0.0 { ((pu * du + pv * dv) / length_squared).clamp(0.0, 1.0) } else { 0.0 };
            let distance = (pu - along * du).hypot(pv - along * dv);
            let coverage = (half + 0.5 - distance).clamp(0.0, 1.0);
            if coverage > 0.0 {
                blend(image, u, v, stroke.color, coverage);
            }
        }
    }
}

/// The pixel range of one axis that a line from `a` to `b` may touch: first, one past last.
fn covered(a: f64, b: f64, half: f64, size: u32) -> [u32; 2] {
    let clip = |x: f64| x.clamp(0.0, f64::from(size)) as u32;
    [clip((a.min(b) - half - 1.0).floor()), clip((a.max(b) + half + 2.0).ceil())]
}

fn blend(image: &mut RgbImage, u: u32, v: u32, color: Rgb<u8>, opacity: f64) {
    let opacity = opacity.clamp(0.0, 1.0);
    let pixel = image.get_pixel_mut(u, v);
    for (below, above) in pixel.0.iter_mut().zip(color.0) {
        *below = (f64::from(*below) * (1.0 - opacity) + f64::from(above) * opacity).round() as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};
    use pb3dp_geometry::frames::{CamLeft, Model};
    use pb3dp_geometry::{Distortion, ImageSize, Pinhole};

    const WHITE: Rgb<u8> = Rgb([255, 255, 255]);

    fn drawn(draw: impl FnOnce(&mut RgbImage)) -> RgbImage {
        let mut image = RgbImage::new(40, 30);
        draw(&mut image);
        image
    }

    fn ink(image: &RgbImage) -> f64 {
        image.pixels().map(|p| f64::from(p.0[0]) / 255.0).sum()
    }

    #[test]
    fn a_line_covers_its_length_times_its_width() {
        let stroke = Stroke { color: WHITE, width_px: 2.0 };
        // Length 20.4, width 2, and two half discs of radius 1 at the ends.
        let slanted = drawn(|p| polyline(p, &[[8.3, 6.1], [26.3, 15.7]], stroke));
        assert!((ink(&slanted) - (20.4 * 2.0 + std::f64::consts::PI)).abs() < 1.5, "{}", ink(&slanted));
        let row = drawn(|p| polyline(p, &[[5.0, 10.0], [15.0, 10.0]], Stroke { color: WHITE, width_px: 1.0 }));
        assert_eq!((row.get_pixel(5, 10).0[0], row.get_pixel(15, 10).0[0], row.get_pixel(10, 11).0[0]), (255, 255, 0));
    }

    #[test]
    fn nothing_outside_or_undefined_is_drawn() {
        let stroke = Stroke::of(WHITE);
        let image = drawn(|p| {
            polyline(p, &[[-50.0, -9.0], [90.0, -9.0]], stroke);
            polygon(p, &[[f64::NAN, 3.0], [1e300, f64::INFINITY]], stroke);
            cross(p, [-30.0, 400.0], 5.0, stroke);
            text(p, [1e9, -1e9], "far", TextStyle::of(WHITE));
        });
        assert_eq!(ink(&image), 0.0);
        let across = drawn(|p| polyline(p, &[[-1e6, 15.0], [1e6, 15.0]], Stroke { color: WHITE, width_px: 1.0 }));
        assert_eq!(ink(&across), 40.0);
    }

    #[test]
    fn polygons_close() {
        let corners = [[5.0, 5.0], [15.0, 5.0], [15.0, 12.0], [5.0, 12.0]];
        let outline = drawn(|p| polygon(p, &corners, Stroke { color: WHITE, width_px: 1.0 }));
        assert_eq!(outline.get_pixel(5, 9).0[0], 255, "the closing side");
    }

    #[test]
    fn the_axes_of_a_pose_end_where_the_camera_sees_them() {
        let size = ImageSize { width: 40, height: 30 };
        let pinhole = Pinhole { fx: 30.0, fy: 32.0, cx: 18.0, cy: 14.0 };
        let camera = Camera::new(size, pinhole, Distortion::None).unwrap();
        // A quarter turn about z: the model's x axis points down in the image.
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let pose = Pose::<CamLeft, Model>::from_parts(Vector3::new(0.1, -0.1, 0.5), turn);
        let image = drawn(|p| pose_axes(p, &camera, &pose, 0.2));
        // Origin at (24, 7.6); x tip at (24, 20.4): red in between, green to the left.
        assert_eq!(*image.get_pixel(24, 14), colors::AXES[0]);
        let left = image.get_pixel(18, 8).0;
        assert!(left[1] > left[0] && left[1] > left[2], "{left:?}");
        let behind = Pose::<CamLeft, Model>::from_translation(Vector3::new(0.0, 0.0, -0.5));
        assert_eq!(ink(&drawn(|p| pose_axes(p, &camera, &behind, 0.2))), 0.0);
    }

    #[test]
    fn images_stand_side_by_side() {
        let (left, right) = (RgbImage::from_pixel(5, 4, Rgb([1, 1, 1])), RgbImage::from_pixel(3, 6, Rgb([2, 2, 2])));
        let both = side_by_side(&left, &right);
        assert_eq!(both.dimensions(), (10, 6));
        assert_eq!((both.get_pixel(4, 3).0[0], both.get_pixel(7, 5).0[0], both.get_pixel(0, 5).0[0]), (1, 2, 0));
    }
}
