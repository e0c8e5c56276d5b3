//! The visible surface of a region that is no plane: a ball in front of a tilted wall, seen by raw cameras.

use image::{Rgb, RgbImage};
use nalgebra::{Point3, Vector3};
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method, VisiblePoint};
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_geometry::{Camera, StereoRig};

use crate::common;

const CENTRE_M: Vector3<f64> = Vector3::new(0.012, -0.018, 0.5);
const RADIUS_M: f64 = 0.055;
/// The wall: points p with `WALL . p = 1`.
const WALL: Vector3<f64> = Vector3::new(0.25, -0.15, 1.75);

/// Where a ray from a point meets the scene.
fn hit(from: &Point3<f64>, ray: &Vector3<f64>) -> Point3<f64> {
    let to_centre = from.coords - CENTRE_M;
    let (a, b) = (ray.norm_squared(), ray.dot(&to_centre));
    let inside = b * b - a * (to_centre.norm_squared() - RADIUS_M * RADIUS_M);
    if inside > 0.0 {
        return from + ray * ((-b - inside.sqrt()) / a);
    }
    from + ray * ((1.0 - WALL.dot(&from.coords)) / WALL.dot(ray))
}

/// A texture in space: waves of 3 to 12 mm in all directions.
struct Waves(Vec<(Vector3<f64>, f64, usize)>);

impl Waves {
    fn new(seed: u64) -> Self {
        let mut random = SplitMix64::new(seed);
        let wave = |k: usize| {
            let direction = Vector3::from_fn(|_, _| random.normal()).normalize();
            let period_m = 0.003 + 0.009 * random.unit();
            (direction * (std::f64::consts::TAU / period_m), std::f64::consts::TAU * random.unit(), k % 3)
        };
        Self((0..36).map(wave).collect())
    }

    fn at(&self, point: &Point3<f64>) -> [f64; 3] {
        let mut colour = [120.0; 3];
        for (wave, phase, channel) in &self.0 {
            let value = 9.0 * (wave.dot(&point.coords) + phase).sin();
            colour.iter_mut().enumerate().for_each(|(c, sum)| *sum += if c == *channel { 2.0 * value } else { value });
        }
        colour
    }
}

/// What a camera sees from a point, with noise of two grey levels; `turned` maps its rays to `cam_left`.
fn photo(camera: &Camera, from: Point3<f64>, turned: impl Fn(&Vector3<f64>) -> Vector3<f64>, seed: u64) -> RgbImage {
    let (waves, mut random) = (Waves::new(7), SplitMix64::new(seed));
    RgbImage::from_fn(camera.size().width, camera.size().height, |u, v| {
        let ray = camera.unproject(&nalgebra::Vector2::new(f64::from(u), f64::from(v)));
        let colour = ray.map_or([0.0; 3], |ray| waves.at(&hit(&from, &turned(&ray))));
        Rgb(colour.map(|value| (value + 2.0 * random.normal()).round().clamp(0.0, 255.0) as u8))
    })
}

fn photos(rig: &StereoRig) -> (RgbImage, RgbImage) {
    let left_from_right = rig.cam_right_from_cam_left().inverse();
    let right_m = left_from_right.transform_point(&Point3::origin());
    (
        photo(rig.left(), Point3::origin(), |ray| *ray, 1),
        photo(rig.right(), right_m, |ray| left_from_right.transform_vector(ray), 2),
    )
}

fn surface(rig: &StereoRig, region: &Region, method: Method) -> Vec<VisiblePoint> {
    let (left, right) = photos(rig);
    let mut estimator = Estimator::new(method, rig, &EstimatorConfig::default()).unwrap();
    let range = SearchRange::new(0.35, 0.75, 0.785).unwrap();
    estimator.visible_surface(&EstimateRequest::new_target(&left, &right, region, &range)).unwrap()
}

/// The disc that the ball covers and as much wall around it.
fn region(rig: &StereoRig) -> Region {
    let centre = rig.left().project(&Point3::from(CENTRE_M)).unwrap();
    let radius_px = 1.4 * RADIUS_M / CENTRE_M.z * rig.left().pinhole().fx;
    let corner = |k: usize| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / 24.0).sin_cos();
        centre + radius_px * nalgebra::Vector2::new(cos, sin)
    };
    Region::Polygon { vertices_px: (0..24).map(corner).collect() }
}

#[test]
fn ball_and_wall_have_their_depths_with_honest_standard_deviations() {
    for rig in [common::general_rig(), common::distorted_rig()] {
        let region = region(&rig);
        let points = surface(&rig, &region, Method::Direct);
        let mask = region.rasterize(&photos(&rig).0, &EstimatorConfig::default().published.region).unwrap();
        assert!(points.len() as f64 > 0.9 * mask.area_px() as f64, "{} of {} px", points.len(), mask.area_px());
        let (mut errors_px, mut in_two_sigmas, mut on_ball) = (Vec::new(), 0, 0);
        for point in &points {
            let ray = rig.left().unproject(&point.pixel_px).unwrap();
            let truth = hit(&Point3::origin(), &ray);
            let error_m = (point.position_in_cam_left_m - truth).norm();
            // The point lies on the ray of its pixel.
            let along = point.position_in_cam_left_m.coords.cross(&ray).norm() / ray.norm();
            assert!(along < 1e-4, "{along} m beside its ray");
            let per_m = rig.left().pinhole().fx * rig.baseline_m() / (truth.z * truth.coords.norm());
            errors_px.push(error_m * per_m);
            in_two_sigmas += usize::from(error_m <= 2.0 * point.sigma_m);
            on_ball += usize::from((truth.coords - CENTRE_M).norm() < 1.01 * RADIUS_M);
        }
        errors_px.sort_by(f64::total_cmp);
        let share = |count: usize| count as f64 / points.len() as f64;
        let within_1px = share(errors_px.partition_point(|error| *error < 1.0));
        let (median_px, covered) = (errors_px[errors_px.len() / 2], share(in_two_sigmas));
        println!(
            "median {median_px:.3} px, within 1 px {within_1px:.3}, in two sigmas {covered:.3}, ball {:.3}",
            share(on_ball)
        );
        assert!((0.4..0.6).contains(&share(on_ball)), "the region shows both: {}", share(on_ball));
        assert!(median_px < 0.2 && within_1px > 0.9 && covered > 0.9, "{median_px} px, {within_1px}, {covered}");
    }
}

#[test]
fn a_method_for_planes_has_no_visible_surface() {
    let rig = common::general_rig();
    assert!(surface(&rig, &region(&rig), Method::Published).is_empty());
}

#[test]
fn a_depth_range_without_the_scene_gives_no_surface() {
    let rig = common::general_rig();
    let (left, right) = photos(&rig);
    let mut estimator = Estimator::new(Method::Direct, &rig, &EstimatorConfig::default()).unwrap();
    let (region, beyond) = (region(&rig), SearchRange::new(1.2, 3.0, 0.785).unwrap());
    for (right, range) in [(&right, beyond), (&left, SearchRange::new(0.35, 0.75, 0.785).unwrap())] {
        let refused = estimator.visible_surface(&EstimateRequest::new_target(&left, right, &region, &range));
        assert!(matches!(refused, Err(EstimationError::NoSurface { .. })), "{refused:?}");
    }
}
