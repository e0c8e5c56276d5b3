//! Regions that show two surfaces: the larger one is the target, even if the smaller one has more texture.

use image::{Rgb, RgbImage};
use nalgebra::{Vector2, Vector3};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_estimation_test_support::scene;
use pb3dp_geometry::ImageSize;

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };
/// Disparities `[a, b, c]` of the wall: `a u + b v + c`.
const WALL: [f64; 3] = [0.021, -0.034, 131.0];
/// Disparity of the bars before it.
const BARS_PX: f64 = 139.0;
const REGION: Region = Region::Rectangle { x: 310, y: 205, width: 80, height: 70 };

/// Whether a bar covers a left pixel: 14 of 40 columns, in the lower four fifths of the region.
fn is_bar(u: f64, v: f64) -> bool {
    v > 220.0 && (u - 318.0).rem_euclid(40.0) < 14.0
}

/// Grey waves of 5 to 14 px in all directions.
struct Waves(Vec<[f64; 3]>);

impl Waves {
    fn new(seed: u64) -> Self {
        let mut random = SplitMix64::new(seed);
        let wave = |_| {
            let (turn, per_px) =
                (std::f64::consts::TAU * random.unit(), std::f64::consts::TAU / (5.0 + 9.0 * random.unit()));
            [per_px * turn.cos(), per_px * turn.sin(), std::f64::consts::TAU * random.unit()]
        };
        Self((0..24).map(wave).collect())
    }

    /// Root mean square 1.
    fn at(&self, u: f64, v: f64) -> f64 {
        let sum: f64 = self.0.iter().map(|[x, y, phase]| (x * u + y * v + phase).sin()).sum();
        sum / (0.5 * self.0.len() as f64).sqrt()
    }
}

/// Both images: a wall with faint texture (3 grey levels) behind bars with strong texture (25).
fn pair() -> [RgbImage; 2] {
    let (wall, bars) = (Waves::new(3), Waves::new(4));
    let grey = |on_bar: Option<f64>, on_wall: f64, v: f64| match on_bar {
        Some(u) => 120.0 + 25.0 * bars.at(u, v),
        None => 150.0 + 3.0 * wall.at(on_wall, v),
    };
    let photo = |seed: u64, brightness: &dyn Fn(f64, f64) -> f64| {
        let mut random = SplitMix64::new(seed);
        RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| {
            let value = brightness(f64::from(u), f64::from(v));
            Rgb([0; 3].map(|_: u8| (value + random.normal()).round().clamp(0.0, 255.0) as u8))
        })
    };
    let [a, b, c] = WALL;
    let left = photo(1, &|u, v| grey(is_bar(u, v).then_some(u), u, v));
    let right = photo(2, &|u, v| {
        let on_wall = (u + b * v + c) / (1.0 - a);
        grey(is_bar(u + BARS_PX, v).then_some(u + BARS_PX), on_wall, v)
    });
    [left, right]
}

#[test]
fn the_larger_surface_is_the_target_even_if_its_texture_is_faint() {
    let rig = scene::rectified_rig(SIZE);
    let [left, right] = pair();
    let range = SearchRange::new(0.45, 0.8, 60f64.to_radians()).unwrap();
    let mut estimator = DirectEstimator::new(&rig, DirectConfig::default()).unwrap();
    let found = estimator.estimate(EstimateRequest::new_target(&left, &right, &REGION, &range)).unwrap();
    let pose = found.pose.unwrap();
    // From the disparities, by hand: z = f b / (d + c_right - c_left), and the same for the normal.
    let (camera, other) = (rig.left().pinhole(), rig.right().pinhole());
    let [a, b, c] = WALL;
    let middle = Vector2::new(349.5, 239.5);
    let disparity_px = a * middle.x + b * middle.y + c + other.cx - camera.cx;
    let ray = Vector3::new((middle.x - camera.cx) / camera.fx, (middle.y - camera.cy) / camera.fy, 1.0);
    let z_m = camera.fx * 0.1 / disparity_px;
    let at_principal_px = a * camera.cx + b * camera.cy + c + other.cx - camera.cx;
    let normal = -Vector3::new(a * camera.fx, b * camera.fy, at_principal_px).normalize();
    let found_z_m = pose.depth_on_ray(&ray).unwrap();
    assert!((found_z_m - z_m).abs() < 2e-3, "{found_z_m} instead of {z_m}: {}", found.reason);
    let turn_deg = pose.normal_in_cam_left.angle(&normal).to_degrees();
    assert!(turn_deg < 5.0, "{turn_deg} degrees: {}", found.reason);
    assert_ne!(found.status, Status::NotObservable, "{}", found.reason);
    let second = found.second_plane.expect("the bars");
    let bars_z_m = camera.fx * 0.1 / (BARS_PX + other.cx - camera.cx);
    assert!((second.pose.z_m - bars_z_m).abs() < 5e-3 && (0.1..0.45).contains(&second.share), "{second:?}");
}
