//! First poses of objects that are no planes, in regions that an operator might draw: whole objects, parts of them, and rectangles that also show
//! what is behind.
//!
//! The truth is the plane of least squares through the true visible surface inside the region ([`plane_in`](pb3dp_sim::raster::GroundTruth::plane_in)).

use image::RgbImage;
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use pb3dp_estimation::estimator::{EstimateRequest, Method, Tracker};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::region::{Region, RegionConfig};
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Target, World};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{Scene, SceneConfig, ScenePoses};
use pb3dp_sim::targets::{BackdropConfig, TargetConfig};

use super::cell::Setup;
use super::measure::config;
use super::random::Random;
use super::scenes::{rigs, sensor};
use super::sequences::SEARCH;
use super::trial::rectangle_around;

/// Regions of each object, and starts of each region.
const REGIONS: usize = 8;
const STARTS: usize = 5;

/// The objects by name.
pub const OBJECTS: [(&str, TargetConfig); 5] = [
    ("first-pose/crab-5", TargetConfig::crab(0.005)),
    ("first-pose/crab-10", TargetConfig::crab(0.010)),
    ("first-pose/crab-25", TargetConfig::crab(0.025)),
    ("first-pose/potato", TargetConfig::potato()),
    ("first-pose/box", TargetConfig::grey_box()),
];

/// A first pose beside the truth: depth (metres) and tilts about x and y (radians), in axes of the model.
#[derive(Clone, Copy, Debug)]
pub struct FirstPose {
    /// Which region it is of, and which start.
    pub number: [usize; 2],
    /// The answer.
    pub status: Status,
    /// Truth minus answer.
    pub errors: [f64; 3],
    /// Their standard deviations.
    pub sigmas: [f64; 3],
}

/// All first poses of an object; those without a pose or a covariance are counted.
///
/// # Errors
/// If a part rejects the setup.
pub fn measure(name: &str, target: TargetConfig, seed: u32, starts: usize) -> anyhow::Result<(Vec<FirstPose>, usize)> {
    let setup = Setup::default();
    let rig = rigs(&setup)?.told;
    let (mut found, mut unanswered) = (Vec::new(), 0);
    let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    for scene_number in 0..2 {
        let backdrop = Some(BackdropConfig { size_m: [0.6, 0.45], gap_m: 0.03 });
        let config_of_scene = SceneConfig { backdrop, seed: seed + scene_number, ..SceneConfig::new(target) };
        let mut renderer = StereoRenderer::new(Scene::build(&config_of_scene)?, rig, &sensor(&setup), seed)?;
        for region in (0..REGIONS).filter(|region| region % 2 == scene_number as usize) {
            for start in 0..starts.min(STARTS) {
                let mut random = Random::of(seed, name, region * STARTS + start);
                let cam_left_from_target = pose(&mut random);
                let world_from_cam_left = Pose::<World, CamLeft>::coincident();
                let poses = ScenePoses { world_from_cam_left, world_from_target: world_from_cam_left * cam_left_from_target };
                let Some(outline_px) = renderer.target_outline_px(&poses) else { continue };
                let marked = region_of(region, &outline_px, &mut Random::of(seed, name, 1000 + region));
                renderer.render_pair(&poses, (region * STARTS + start) as u64, &mut left, &mut right);
                let mut tracker = Tracker::new(Method::Direct, &rig, &config())?;
                let answer = tracker.estimate(EstimateRequest::of_target(&left, &right, &marked, &SEARCH))?;
                let mask = marked.rasterize(&left, &RegionConfig::default())?;
                let seen = renderer.ground_truth(&poses);
                let plane = seen.plane_in(rig.left(), |[u, v]| mask.contains(u as i32, v as i32));
                match plane.and_then(|plane| judged(&answer, &plane, [region, start])) {
                    Some(pose) => found.push(pose),
                    None => unanswered += 1,
                }
            }
        }
    }
    Ok((found, unanswered))
}

/// A view from 420 to 600 mm, with tilts of up to 25 degrees.
fn pose(random: &mut Random) -> Pose<CamLeft, Target> {
    let z_m = random.between(0.42, 0.60);
    let [x_m, y_m] = [(); 2].map(|()| random.between(-0.01, 0.01));
    let [tilt_x, tilt_y] = [(); 2].map(|()| random.between(-0.43, 0.43));
    let turn = random.between(-0.6, 0.6);
    let about = |axis: Vector3<f64>, angle: f64| UnitQuaternion::from_scaled_axis(axis * angle);
    let rotation = about(Vector3::y(), tilt_y) * about(Vector3::x(), tilt_x) * about(Vector3::z(), turn);
    Pose::from_parts(Vector3::new(0.05 + x_m, y_m, z_m), rotation)
}

/// The outline, its box, or a part of the box of 0.4 to 0.9 of its sides.
fn region_of(number: usize, outline_px: &[Vector2<f64>], random: &mut Random) -> Region {
    let corners = rectangle_around(outline_px);
    let (low, size) = (corners[0], corners[2] - corners[0]);
    let vertices_px = match number {
        0 => outline_px.to_vec(),
        1 => corners,
        _ => {
            let part = Vector2::new(random.between(0.4, 0.9), random.between(0.4, 0.9));
            let rest = Vector2::repeat(1.0) - part;
            let at = low + size.component_mul(&rest.map(|rest| random.between(0.15 * rest, 0.85 * rest)));
            let far = at + size.component_mul(&part);
            vec![at, Vector2::new(far.x, at.y), far, Vector2::new(at.x, far.y)]
        }
    };
    Region::Polygon { vertices_px }
}

/// `plane`: the true inverse-depth plane.
fn judged(answer: &TrackEstimate, plane: &Vector3<f64>, number: [usize; 2]) -> Option<FirstPose> {
    let (pose, covariance) = answer.cam_left_from_model.zip(answer.covariance)?;
    let z_m = pose.translation_m().z;
    // A small turn of the plane about x moves its normal against y, one about y along x.
    let normal = pose.inverse().transform_vector(&plane.normalize());
    let turn = pose.rotation().to_rotation_matrix();
    let places = turn.matrix() * covariance.fixed_view::<3, 3>(0, 0) * turn.matrix().transpose();
    Some(FirstPose {
        number,
        status: answer.status,
        errors: [z_m / plane.dot(&pose.translation_m()) - z_m, -normal.y, normal.x],
        sigmas: [places[(2, 2)], covariance[(3, 3)], covariance[(4, 4)]].map(f64::sqrt),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dump() {
        let pick = std::env::var("OBJ").unwrap_or_default();
        for (name, target) in OBJECTS.into_iter().filter(|(name, _)| name.contains(&pick)) {
            let (found, none) = measure(name, target, 1, 5).unwrap();
            for one in &found {
                let d = |x: f64| x.to_degrees();
                println!("POSE {name} {} {} {} {:.3} {:.3} {:.3} {:.3} {:.3} {:.3}", one.number[0], one.number[1], one.status, 1e3 * one.errors[0], d(one.errors[1]), d(one.errors[2]), 1e3 * one.sigmas[0], d(one.sigmas[1]), d(one.sigmas[2]));
            }
            println!("NONE {name} {none}");
        }
    }
}
