//! Regions, calibrations and priors with any numbers: infinities, not a number, absurd sizes.

use image::{GrayImage, Luma};
use nalgebra::{Matrix3, Point3, Quaternion, UnitQuaternion, Vector2, Vector3};
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, FramePrior, Method, Tracker};
use pb3dp_estimation::pair_check::check_pair;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::{Region, RegionConfig};
use pb3dp_geometry::frames::{CamLeft, CamRight};
use pb3dp_geometry::{Camera, Distortion, Frame, ImageSize, Pinhole, Pose, StereoRig};

use super::{Choices, check_plane, check_track, paint};

impl Choices<'_> {
    /// Usually `usual` or a number of its size, otherwise any number at all.
    fn number(&mut self, usual: f64) -> f64 {
        match self.byte() {
            0..192 => usual,
            192..224 => usual * 2.0 * self.share(),
            224..240 => usual * 10_f64.powi(i32::from(self.byte()) - 128),
            240..248 => self.of(&[0.0, -0.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MIN, f64::EPSILON, -1.0]),
            _ => f64::from_bits(u64::from_le_bytes(std::array::from_fn(|_| self.byte()))),
        }
    }

    fn vector(&mut self, usual: [f64; 3]) -> Vector3<f64> {
        Vector3::from(usual.map(|value| self.number(value)))
    }

    /// A pose near the usual one, or with any numbers. Rotations are not always normalised.
    fn pose<To: Frame, From: Frame>(&mut self, translation_m: [f64; 3], turn_rad: [f64; 3]) -> Pose<To, From> {
        let translation_m = self.vector(translation_m);
        let rotation = match self.byte() % 8 {
            0 => {
                let [w, i, j] = [self.number(1.0), self.number(0.0), self.number(0.0)];
                UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, self.number(0.0)))
            }
            1 => {
                let rotation = Matrix3::from_fn(|row, column| self.number(if row == column { 1.0 } else { 0.0 }));
                return Pose::from_rotation_matrix(&rotation, translation_m);
            }
            _ => UnitQuaternion::from_scaled_axis(self.vector(turn_rad)),
        };
        Pose::from_parts(translation_m, rotation)
    }
}

/// Rasterises and inspects regions of all kinds in an image.
///
/// # Panics
/// If a region panics, has pixels outside the image, or is refused without a reason.
pub fn regions_with_any_numbers_survive(bytes: &[u8]) {
    let mut choices = Choices(bytes);
    let c = &mut choices;
    let side = |c: &mut Choices<'_>| {
        let usual = 1 + u32::from(c.byte());
        c.mostly(usual, &[1, 2, 3, 8192])
    };
    let width = side(c);
    let size = ImageSize { width, height: side(c).min((1 << 17) / width) };
    let image = paint(size, c.byte(), 0, 0);
    let view = ImageView::from(&image);
    let (config, region) = (RegionConfig::default(), any_region(c, size));
    match region.rasterize(view, &config) {
        Err(error) => assert!(!error.to_string().is_empty(), "a silent error"),
        Ok(mask) => {
            assert_eq!(mask.size(), size);
            assert!(mask.area_px() >= config.area_min_px, "{} px", mask.area_px());
            mask.for_each(|x, y| assert!(x < size.width && y < size.height, "({x}, {y}) of {size:?}"));
            assert!(mask.centroid_px().is_some_and(|centroid| centroid.iter().all(|value| value.is_finite())));
            assert!(region.outline_px(&mask).iter().flatten().all(|value| value.is_finite()));
            for warning in region.inspect(view, &mask, &config) {
                assert!(!warning.to_string().is_empty(), "a silent warning");
            }
            let eroded = mask.erode(u32::from(c.byte()));
            assert!(eroded.area_px() <= mask.area_px());
        }
    }
}

fn any_region(c: &mut Choices<'_>, size: ImageSize) -> Region {
    let integer = |c: &mut Choices<'_>, length: u32| {
        let inside = (c.share() * 1.2 * f64::from(length)) as i32 - 4;
        c.mostly(inside, &[0, -1, i32::MIN, i32::MAX, 100_000, -100_001])
    };
    match c.byte() % 4 {
        0 => {
            let (x, y) = (integer(c, size.width), integer(c, size.height));
            let length = |c: &mut Choices<'_>| {
                let usual = u32::from(c.byte());
                c.mostly(usual, &[0, 1, 1 << 14, u32::MAX])
            };
            Region::Rectangle { x, y, width: length(c), height: length(c) }
        }
        1 => Region::Click { x: integer(c, size.width), y: integer(c, size.height) },
        2 => {
            let (columns, step) = (c.mostly(size.width, &[0, 1, 77]), 1 + u32::from(c.byte()));
            let is_inside = |x: u32, y: u32| (x + y * 7) % step < step.div_ceil(2);
            Region::Mask(GrayImage::from_fn(columns, size.height, |x, y| Luma([u8::from(is_inside(x, y)) * 255])))
        }
        _ => {
            let vertices_px = (0..c.byte() % 24).map(|_| {
                let at = |c: &mut Choices<'_>, length: u32| {
                    let usual = (c.share() * 1.3 - 0.15) * f64::from(length);
                    c.number(usual)
                };
                Vector2::new(at(c, size.width), at(c, size.height))
            });
            Region::Polygon { vertices_px: vertices_px.collect() }
        }
    }
}

/// Estimates with calibrations of any numbers.
///
/// # Panics
/// If the camera models or a method panic, or give a pose that is not finite.
pub fn calibrations_with_any_numbers_survive(bytes: &[u8]) {
    let mut choices = Choices(bytes);
    let c = &mut choices;
    let (Some(left), Some(right)) = (any_camera(c), any_camera(c)) else { return };
    let right_from_left: Pose<CamRight, CamLeft> = c.pose([-0.1, 0.0, 0.0], [0.0, 0.0, 0.0]);
    let rig = match StereoRig::new(left, right, right_from_left) {
        Ok(rig) => rig,
        Err(error) => return assert!(!error.to_string().is_empty(), "a silent error"),
    };
    if let Ok(rectification) = rig.rectify() {
        assert!(rectification.rig.is_rectified() && rectification.cam_left_rect_from_cam_left.is_finite());
    }
    let pattern = c.byte();
    let images = [(rig.left(), 0), (rig.right(), 9)].map(|(camera, shift)| paint(camera.size(), pattern, shift, 0));
    let [left, right] = images.each_ref().map(ImageView::from);
    assert!(!format!("{:?}", check_pair(&rig, left, right)).is_empty());
    let size = rig.left().size();
    let region = Region::Rectangle { x: 2, y: 2, width: size.width / 2, height: size.height / 2 };
    let range = SearchRange { z_min_m: c.number(0.3), z_max_m: c.number(0.9), tilt_max_rad: c.number(0.7) };
    let method = c.of(&Method::ALL);
    if let Ok(mut estimator) = Estimator::new(method, &rig, &EstimatorConfig::default()) {
        let _ = estimator.look(left, right);
        match estimator.estimate(EstimateRequest::new_target(left, right, &region, &range)) {
            Ok(estimate) => check_plane(method, &estimate),
            Err(error) => assert!(!error.to_string().is_empty(), "{method}: a silent error"),
        }
    }
}

fn any_camera(c: &mut Choices<'_>) -> Option<Camera> {
    let side = |c: &mut Choices<'_>, most: u32| {
        let usual = 24 + u32::from(c.byte() % 100);
        c.mostly(usual, &[0, 1, 2, 640, 8192]).min(most)
    };
    let width = side(c, 8192);
    let size = ImageSize { width, height: side(c, (1 << 16) / width.max(1)) };
    let focal = c.number(80.0);
    let (cx, cy) = (f64::from(size.width) / 2.0, f64::from(size.height) / 2.0);
    let pinhole = Pinhole { fx: focal, fy: c.number(focal), cx: c.number(cx), cy: c.number(cy) };
    let distortion = match c.byte() % 4 {
        0 => Distortion::None,
        2 => Distortion::BrownConrady8 {
            coefficients: [0.3, -0.1, 0.001, -0.001, 0.01, 0.5, -0.1, 0.02].map(|k| c.number(k)),
        },
        1 => Distortion::BrownConrady5 { coefficients: [-0.2, 0.05, 0.001, -0.001, 0.01].map(|k| c.number(k)) },
        _ => Distortion::Equidistant { coefficients: [0.02, -0.01, 0.004, -0.001].map(|k| c.number(k)) },
    };
    let camera = Camera::new(size, pinhole, distortion).ok()?;
    let pixel = Vector2::new(c.number(cx), c.number(cy));
    if let Ok(ray) = camera.unproject(&pixel) {
        assert!(ray.iter().all(|value| value.is_finite()), "{camera:?}: the ray of {pixel} is {ray}");
    }
    let point = Point3::from(c.vector([0.1, 0.1, 1.0]));
    if let Some(pixel) = camera.project(&point) {
        assert!(pixel.iter().all(|value| value.is_finite()), "{camera:?}: {point} is at {pixel}");
    }
    Some(camera)
}

/// Tracks an ordinary target with priors of any numbers.
///
/// # Panics
/// If a method panics, or gives a pose that is not finite.
pub fn priors_with_any_numbers_survive(bytes: &[u8]) {
    let mut choices = Choices(bytes);
    let c = &mut choices;
    let method = c.of(&Method::ALL);
    let size = ImageSize { width: 96, height: 80 };
    let pinhole = Pinhole { fx: 80.0, fy: 80.0, cx: 47.0, cy: 41.0 };
    let Ok(camera) = Camera::new(size, pinhole, Distortion::None) else { return };
    let Ok(rig) = StereoRig::new(camera, camera, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0))) else { return };
    let Ok(mut tracker) = Tracker::new(method, &rig, &EstimatorConfig::default()) else { return };
    let region = Region::Rectangle { x: 24, y: 16, width: 48, height: 48 };
    let range = SearchRange { z_min_m: 0.4, z_max_m: 2.0, tilt_max_rad: 0.7 };
    // 0.8 m away, one column per frame to the left.
    let pair = |frame: usize| (paint(size, 8, 0, frame), paint(size, 8, 10, frame));
    let (left, right) = pair(0);
    let skew_s = if c.byte() > 64 { c.number(0.01) } else { 0.0 };
    let started = tracker.estimate(EstimateRequest::new_target(&left, &right, &region, &range).with_skew(skew_s));
    started.iter().for_each(|estimate| check_track(method, estimate));
    for frame in 1..=1 + usize::from(c.byte() % 4) {
        let (left, right) = pair(frame);
        let prior = FramePrior {
            cam_left_prev_from_cam_left_now: (c.byte() > 64).then(|| c.pose([0.01, 0.0, 0.0], [0.0, 0.0, 0.0])),
            cam_left_from_model: (c.byte() > 64).then(|| c.pose([0.0, 0.0, 0.8], [0.0, 0.0, 0.0])),
            dt_s: (c.byte() > 64).then(|| c.number(0.033)),
            skew_s: if c.byte() > 64 { c.number(0.01) } else { 0.0 },
            skew_sigma_s: if c.byte() > 192 { c.number(0.001) } else { 0.0 },
        };
        match tracker.estimate(EstimateRequest::next_frame(&left, &right, &prior)) {
            Ok(estimate) => check_track(method, &estimate),
            Err(error) => assert!(!error.to_string().is_empty(), "{method}: a silent error"),
        }
    }
}
