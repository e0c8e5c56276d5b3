//! Invalid pairs, calibrations and regions from arbitrary bytes, and the properties that must hold for them.
//!
//! Used by the property test `robustness.rs` and by the fuzz targets in `tests/fuzz`.

pub mod camera_memory;
mod image_abuse;
mod number_abuse;

use image::{Rgb, RgbImage};
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, FramePrior, Method, Tracker};
use pb3dp_estimation_core::estimate::{PlaneEstimate, TrackEstimate};
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_geometry::frames::{CamLeft, CamRight};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};

pub use image_abuse::images_in_any_form_survive;
pub use number_abuse::{
    calibrations_with_any_numbers_survive, priors_with_any_numbers_survive, regions_with_any_numbers_survive,
};

/// Bytes as a source of choices; zeros once all bytes are used.
struct Choices<'a>(&'a [u8]);

impl Choices<'_> {
    fn byte(&mut self) -> u8 {
        let Some((&first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        first
    }

    fn of<T: Copy>(&mut self, list: &[T]) -> T {
        list[usize::from(self.byte()) % list.len()]
    }

    /// Usually `usual`, otherwise one element of the list.
    fn mostly<T: Copy>(&mut self, usual: T, list: &[T]) -> T {
        let byte = usize::from(self.byte());
        if byte < 216 { usual } else { list[(byte - 216) % list.len()] }
    }

    /// A value between 0 and 1.
    fn share(&mut self) -> f64 {
        f64::from(self.byte()) / 255.0
    }
}

/// One invalid input.
pub struct Abuse {
    pub rig: StereoRig,
    pub pairs: Vec<(RgbImage, RgbImage)>,
    pub region: Region,
    pub range: SearchRange,
    /// Known motion of the camera before each pair.
    pub motion: Option<Pose<CamLeft, CamLeft>>,
}

/// Bytes up to the number of frames that give square images of `100 + side` pixels and an ordinary rig.
pub fn ordinary_prefix(side_choice: u8) -> Vec<u8> {
    let mut bytes = vec![76, side_choice, 76, side_choice];
    bytes.extend([0; 9]);
    bytes
}

impl Abuse {
    /// The abuse for some bytes; `None` if the calibration type rejects the calibration.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let mut choices = Choices(bytes);
        let c = &mut choices;
        let size = ImageSize { width: side(c), height: side(c) };
        let rig = rig(c, size)?;
        let frames = 1 + usize::from(c.byte() % 3);
        let patterns: Vec<u8> = (0..4).map(|_| c.byte()).collect();
        let pairs = (0..frames)
            .map(|frame| {
                let shift = i32::from(c.byte() % 24);
                // Later frames may show a different pattern.
                let pattern = if c.byte() < 200 { patterns[0] } else { patterns[1 + frame % 3] };
                (paint(size, pattern, 0, frame), paint(size, pattern, shift, frame))
            })
            .collect();
        let motion = (c.byte() > 128).then(|| {
            let turn = Vector3::new(c.share() - 0.5, c.share() - 0.5, c.share() - 0.5) * c.of(&[0.01, 0.3, 6.0]);
            Pose::from_parts(turn * c.of(&[0.1, 10.0]), UnitQuaternion::from_scaled_axis(turn))
        });
        Some(Self { rig, pairs, region: region(c, size), range: range(c), motion })
    }
}

fn side(c: &mut Choices<'_>) -> u32 {
    let usual = 24 + u32::from(c.byte() % 100);
    c.mostly(usual, &[1, 2, 3, 5, 7, 16, 128])
}

fn rig(c: &mut Choices<'_>, size: ImageSize) -> Option<StereoRig> {
    let camera = |c: &mut Choices<'_>| {
        // Up to the ends of the ranges that `Camera::new` accepts, so that methods see them.
        let focal = |c: &mut Choices<'_>| c.mostly(80.0, &[100.0, 0.01, 0.5, 1e7]);
        let centre = |c: &mut Choices<'_>, length: u32| f64::from(length) * c.mostly(0.5, &[0.45, 0.0, -7.0, 7e4]);
        let fx = focal(c);
        let fy = if c.byte() < 200 { fx } else { focal(c) };
        let pinhole = Pinhole { fx, fy, cx: centre(c, size.width), cy: centre(c, size.height) };
        let distortion = match c.mostly(0, &[1, 2, 3]) {
            0 => Distortion::None,
            1 => Distortion::BrownConrady5 { coefficients: [-0.2, 0.05, 0.001, -0.001, 0.0] },
            2 => Distortion::BrownConrady5 { coefficients: [9.0, -1e4, 0.3, 1.0, 1e6] },
            _ => Distortion::Equidistant { coefficients: [0.1, -0.2, 3.0, 0.0] },
        };
        Camera::new(size, pinhole, distortion).ok()
    };
    let left = camera(c)?;
    let right = if c.byte() < 160 { left } else { camera(c)? };
    let baseline_m = c.mostly(0.1, &[2e-4, 9.0]);
    let turn = if c.byte() < 160 {
        Vector3::zeros()
    } else {
        Vector3::new(c.share(), c.share(), c.share()) - Vector3::repeat(0.5)
    };
    let away = if c.byte() < 200 { Vector3::zeros() } else { Vector3::new(0.0, 0.3, -0.5) * baseline_m };
    let pose: Pose<CamRight, CamLeft> =
        Pose::from_parts(Vector3::new(-baseline_m, 0.0, 0.0) + away, UnitQuaternion::from_scaled_axis(turn));
    StereoRig::new(left, right, pose).ok()
}

fn range(c: &mut Choices<'_>) -> SearchRange {
    let z_min_m = c.mostly(0.3, &[1e-9, 1e3, 0.0, -1.0, f64::NAN]);
    let z_max_m = c.mostly(0.9, &[0.3, 1e6, f64::INFINITY]);
    SearchRange { z_min_m, z_max_m, tilt_max_rad: c.mostly(0.7, &[0.0, 1e-6, 1.5, 9.0]) }
}

fn region(c: &mut Choices<'_>, size: ImageSize) -> Region {
    let (width, height) = (f64::from(size.width), f64::from(size.height));
    match c.byte() % 6 {
        0 => Region::Rectangle { x: 0, y: 0, width: size.width, height: size.height },
        1 => Region::Rectangle {
            x: c.of(&[0, 3, -5, i32::MAX, i32::MIN]),
            y: c.of(&[0, 2, -5, i32::MIN]),
            width: c.of(&[20, 40, 0, u32::MAX]),
            height: c.of(&[20, 30, 1]),
        },
        2 => Region::Click { x: i32::from(c.byte()) - 20, y: i32::from(c.byte()) - 20 },
        3 => Region::Mask(image::GrayImage::from_fn(size.width, size.height, |x, y| {
            image::Luma([u8::from((x * 7 + y * 3) % 5 != 0) * 255])
        })),
        _ => {
            let count = usize::from(c.byte() % 7);
            let coordinate = |c: &mut Choices<'_>, length: f64| (c.share() * 1.3 - 0.15) * length;
            let vertices_px = (0..count).map(|_| Vector2::new(coordinate(c, width), coordinate(c, height))).collect();
            Region::Polygon { vertices_px }
        }
    }
}

/// An image with its columns shifted by `shift`.
fn paint(size: ImageSize, pattern: u8, shift: i32, frame: usize) -> RgbImage {
    let hash = |x: i32, y: i32| {
        let mixed = (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77) ^ u32::from(pattern);
        (mixed ^ (mixed >> 15)).wrapping_mul(0x2C1B_3C6D) >> 8
    };
    RgbImage::from_fn(size.width, size.height, |x, y| {
        let (x, y) = (x as i32 + shift + frame as i32, y as i32);
        let noise = hash(x, y);
        Rgb(match pattern % 9 {
            0 => [0; 3],
            1 => [255; 3],
            2 => [noise as u8, (noise >> 8) as u8, (noise >> 16) as u8],
            3 => [(x * 3) as u8; 3],
            4 => [if (x / 3 + y / 3) % 2 == 0 { 255 } else { 0 }; 3],
            5 => [128, (128 + noise % 3) as u8, 127],
            6 => [
                ((f64::from(x) * 0.4).sin() * 90.0 + 120.0) as u8,
                ((f64::from(y) * 0.3).cos() * 90.0 + 110.0) as u8,
                60,
            ],
            7 => [if x > 20 { 250 } else { 5 }, 30, 200],
            _ => [hash(x / 4, y / 4) as u8; 3],
        })
    })
}

/// Runs every method on the abuse for some bytes.
///
/// # Panics
/// If a method panics, gives a pose that is not finite, or gives no reason.
pub fn every_method_survives(bytes: &[u8]) {
    let Some(abuse) = Abuse::from_bytes(bytes) else { return };
    for method in Method::ALL {
        estimate(method, &abuse);
        track(method, &abuse);
    }
}

fn estimate(method: Method, abuse: &Abuse) {
    let Ok(mut estimator) = Estimator::new(method, &abuse.rig, &EstimatorConfig::default()) else { return };
    for (left, right) in &abuse.pairs {
        match estimator.estimate(EstimateRequest::new_target(left, right, &abuse.region, &abuse.range)) {
            Ok(estimate) => check_plane(method, &estimate),
            Err(error) => assert!(!error.to_string().is_empty(), "{method}: a silent error"),
        }
    }
}

fn check_plane(method: Method, estimate: &PlaneEstimate) {
    assert!(!estimate.reason.is_empty(), "{method}: {} without a reason", estimate.status);
    assert!(estimate.pose.is_some() || !estimate.status.depth_is_sure(), "{method}: pose is missing");
    if let Some(pose) = &estimate.pose {
        let n = pose.normal_in_cam_left;
        assert!(pose.z_m.is_finite() && pose.z_m > 0.0, "{method}: z = {}", pose.z_m);
        assert!((n.norm() - 1.0).abs() < 1e-6, "{method}: normal {n}");
        assert!(pose.inverse_depth_plane.iter().all(|x| x.is_finite()), "{method}: {pose:?}");
    }
    let numbers = [estimate.fitness, estimate.z_sigma_m, estimate.normal_sigma_rad];
    assert!(numbers.iter().flatten().all(|x| x.is_finite()), "{method}: {numbers:?}");
}

fn track(method: Method, abuse: &Abuse) {
    let Ok(mut tracker) = Tracker::new(method, &abuse.rig, &EstimatorConfig::default()) else { return };
    for (index, (left, right)) in abuse.pairs.iter().enumerate() {
        let outcome = match index {
            0 => tracker.estimate(EstimateRequest::new_target(left, right, &abuse.region, &abuse.range)),
            _ => tracker.estimate(EstimateRequest::next_frame(
                left,
                right,
                &FramePrior::of_motion(abuse.motion.as_ref()),
            )),
        };
        match outcome {
            Ok(estimate) => check_track(method, &estimate),
            Err(error) => assert!(!error.to_string().is_empty(), "{method}: a silent error"),
        }
    }
}

fn check_track(method: Method, estimate: &TrackEstimate) {
    assert!(!estimate.reason.is_empty(), "{method}: {} without a reason", estimate.status);
    assert!(estimate.cam_left_from_model.is_some() || !estimate.status.depth_is_sure(), "{method}: pose is missing");
    assert!(estimate.cam_left_from_model.is_none_or(|pose| pose.is_finite()), "{method}: {estimate:?}");
    assert!(estimate.covariance.is_none_or(|m| m.iter().all(|x| x.is_finite())), "{method}: {estimate:?}");
    assert!(estimate.fitness.is_none_or(f64::is_finite), "{method}: {estimate:?}");
}
