//! First poses of objects that are no planes, in regions that an operator might draw: whole objects, parts of them, and rectangles that also show
//! what is behind.
//!
//! The truth is the plane of least squares through the true visible surface inside the region ([`plane_in`](pb3dp_sim::raster::GroundTruth::plane_in)).
//! The target then moves for five seconds, and the frame `surface` beside `model` is compared with the same truth.

use image::RgbImage;
use nalgebra::{Matrix6, UnitQuaternion, Vector2, Vector3};
use pb3dp_benchmarks::table::Column;
use pb3dp_estimation::estimator::{EstimateRequest, Method, Tracker};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::method::FramePrior;
use pb3dp_estimation_core::region::{Region, RegionConfig};
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model, Target, World};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{Scene, SceneConfig, ScenePoses};
use pb3dp_sim::targets::part::SceneObject;
use pb3dp_sim::targets::{BackdropConfig, TargetConfig};
use serde_json::{Value, json};

use super::cell::Setup;
use super::measure::config;
use super::random::Random;
use super::scenes::{rigs, sensor};
use super::sequences::{SEARCH, combined};
use super::trial::rectangle_around;

/// Regions of each object, and starts of each region.
const REGIONS: usize = 8;
pub const STARTS: usize = 5;

/// The objects by name.
pub const OBJECTS: [(&str, TargetConfig); 5] = [
    ("first-pose/crab-5", TargetConfig::crab(0.005)),
    ("first-pose/crab-10", TargetConfig::crab(0.010)),
    ("first-pose/crab-25", TargetConfig::crab(0.025)),
    ("first-pose/potato", TargetConfig::potato()),
    ("first-pose/box", TargetConfig::grey_box()),
];

/// Share of a region that must show the target: with less, it is another question which surface is meant.
const TARGET_SHARE_MIN: f64 = 0.5;

/// Rate of the pairs after the first one, and how long they go on, seconds: for five looks at the surface.
const RATE_HZ: f64 = 15.0;
pub const MOVED_S: f64 = 5.3;
/// Share of the motion of the sequences: 25 mm and 10 degrees along and about each axis.
const MOTION: f64 = 0.5;
/// Errors of a good surface: tilt, radians, and depth relative to it.
const GOOD_TILT_RAD: f64 = 1.0 / 57.295_779_513;
const GOOD_DEPTH: f64 = 0.003;

/// Truth minus answer, and its standard deviations: depth (metres) and tilts about x and y (radians), in axes of the answer.
#[derive(Clone, Copy, Debug)]
struct Off {
    errors: [f64; 3],
    sigmas: [f64; 3],
    z_m: f64,
}

impl Off {
    fn is_good(&self) -> bool {
        let [depth, about_x, about_y] = self.errors;
        about_x.hypot(about_y) <= GOOD_TILT_RAD && depth.abs() <= GOOD_DEPTH * self.z_m
    }
}

/// A first pose, and the surface after the motion, if the target was followed so long.
#[derive(Clone, Copy, Debug)]
struct Judged {
    status: Status,
    first: Off,
    later: Option<Off>,
}

/// The columns of the table.
pub const COLUMNS: [Column<'_>; 9] = [
    ("object", "{first_poses}"),
    ("starts, found, ok", "{starts}, {found}, {ok}"),
    ("depth mm med / p95", "{depth_mm.median:2} / {depth_mm.p95:2}"),
    ("stated / rms", "{depth_mm.stated_over_rms:2}"),
    ("tilt deg med / p95", "{tilt_deg.median:2} / {tilt_deg.p95:2}"),
    ("stated / rms", "{tilt_deg.stated_over_rms:2}"),
    ("in 2 sigmas %: depth, tilt", "{depth_mm.in_two_sigmas*100:0}, {tilt_deg.in_two_sigmas*100:0}"),
    ("within 1.0 deg and 0.3 %: first, after 5 s", "{good_first*100:0} %, {good_surface*100:0} % of {followed:0}"),
    ("then in 2 sigmas %: depth, tilt", "{surface_in_two_sigmas.0*100:0}, {surface_in_two_sigmas.1*100:0}"),
];

/// The row of an object: number of starts, of poses, and of those with the status `ok`; errors of depth and of the tilt about one axis, with the
/// median of the stated deviation and the share of the errors within two of them.
fn row(name: &str, starts: usize, judged: &[Judged]) -> Value {
    let figures = |indices: &[usize], scale: f64| {
        let of = |pick: fn(&Off) -> &[f64; 3]| -> Vec<f64> {
            judged
                .iter()
                .flat_map(|one| indices.iter().map(move |index| pick(&one.first)[*index].abs() * scale))
                .collect()
        };
        let (errors, sigmas) = (of(|one| &one.errors), of(|one| &one.sigmas));
        let count = errors.len().max(1) as f64;
        let within =
            errors.iter().zip(&sigmas).filter(|(error, sigma)| **error <= 2.0 * **sigma).count() as f64 / count;
        let rms = (errors.iter().map(|error| error * error).sum::<f64>() / count).sqrt();
        let sigma = quantile(&sigmas, 0.5);
        json!({
            "median": quantile(&errors, 0.5), "p95": quantile(&errors, 0.95), "rms": rms, "sigma_median": sigma,
            "stated_over_rms": sigma / rms, "in_two_sigmas": within, "beyond_two_sigmas_percent": 100.0 * (1.0 - within),
        })
    };
    let [followed, good_first, good_surface, then_z, then_tilt] = later_figures(judged);
    json!({
        "first_poses": name, "method": "direct", "starts": starts, "found": judged.len(),
        "ok": judged.iter().filter(|one| one.status == Status::Ok).count(),
        "depth_mm": figures(&[0], 1e3), "tilt_deg": figures(&[1, 2], 1f64.to_degrees()),
        "followed": followed, "good_first": good_first, "good_surface": good_surface,
        "surface_in_two_sigmas": [then_z, then_tilt],
    })
}

/// Of the targets that were followed for five seconds: their number, the shares with a tilt error of up to 1.0 degree and a depth error of up to
/// 0.3 % of the first pose and of the surface then, and the shares of its errors within two standard deviations (depth, tilts).
fn later_figures(judged: &[Judged]) -> [f64; 5] {
    let followed: Vec<(&Off, &Off)> = judged.iter().filter_map(|one| Some((&one.first, one.later.as_ref()?))).collect();
    let count = followed.len() as f64;
    let share = |number: usize, of: f64| number as f64 / of.max(1.0);
    let good = |pick: fn(&(&Off, &Off)) -> bool| share(followed.iter().filter(|pair| pick(pair)).count(), count);
    let within = |indices: &[usize]| {
        let within = |off: &Off, index: usize| off.errors[index].abs() <= 2.0 * off.sigmas[index];
        let number = followed.iter().flat_map(|(_, then)| indices.iter().filter(|index| within(then, **index)));
        share(number.count(), count * indices.len() as f64)
    };
    [count, good(|(first, _)| first.is_good()), good(|(_, then)| then.is_good()), within(&[0]), within(&[1, 2])]
}

fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get((share * (values.len().max(1) - 1) as f64).round() as usize).copied().unwrap_or(f64::NAN)
}

/// The first poses of an object, in 8 regions from `starts` views each; if it moves for `moved_s`, also the surface then.
///
/// # Errors
/// If a part rejects the setup.
pub fn measure(
    name: &str,
    target: TargetConfig,
    seed: u32,
    starts: usize,
    moved_s: Option<f64>,
) -> anyhow::Result<Value> {
    let setup = Setup::default();
    let rig = rigs(&setup)?.stated;
    let (mut judged, mut count) = (Vec::new(), 0);
    let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    for part in 0..2 {
        let backdrop = Some(BackdropConfig { size_m: [0.6, 0.45], gap_m: 0.03 });
        let scene = Scene::build(&SceneConfig { backdrop, seed: seed + part as u32, ..SceneConfig::new(target) })?;
        let mut renderer = StereoRenderer::new(scene, rig, &sensor(&setup), seed)?;
        for (region, start) in
            (part..REGIONS).step_by(2).flat_map(|region| (0..starts).map(move |start| (region, start)))
        {
            let number = region * STARTS + start;
            let world_from_cam_left = Pose::<World, CamLeft>::coincident();
            let world_from_target = world_from_cam_left * pose(&mut Random::of(seed, name, number));
            let poses = ScenePoses { world_from_cam_left, world_from_target };
            let Some(outline_px) = renderer.target_outline_px(&poses) else { continue };
            let marked = region_of(region, &outline_px, &mut Random::of(seed, name, REGIONS * STARTS + region));
            renderer.render_pair(&poses, number as u64, &mut left, &mut right);
            let mask = marked.rasterize(&left, &RegionConfig::default())?;
            let is_inside = |[u, v]: [u32; 2]| mask.contains(u as i32, v as i32);
            let truth = renderer.ground_truth(&poses);
            let shown = truth.pixels(&[SceneObject::Target]).filter(|(pixel, _)| is_inside(*pixel)).count();
            let Some(plane) = truth.plane_in(rig.left(), is_inside) else { continue };
            if (shown as f64) < TARGET_SHARE_MIN * mask.area_px() as f64 {
                continue;
            }
            count += 1;
            let mut tracker = Tracker::new(Method::Direct, &rig, &config())?;
            let answer = tracker.estimate(EstimateRequest::new_target(&left, &right, &marked, &SEARCH))?;
            let Some(first) = judge(&answer, &plane) else { continue };
            let last = match moved_s {
                Some(moved_s) => follow(&mut tracker, &mut renderer, &poses, [&mut left, &mut right], moved_s)?,
                None => None,
            };
            let later = last.and_then(|last| judge_surface(&answer, &last, &plane));
            judged.push(Judged { status: answer.status, first, later });
        }
    }
    Ok(row(name, count, &judged))
}

/// The last answer after an ordinary motion, if it has a pose.
fn follow(
    tracker: &mut Tracker,
    renderer: &mut StereoRenderer,
    first: &ScenePoses,
    [left, right]: [&mut RgbImage; 2],
    moved_s: f64,
) -> anyhow::Result<Option<TrackEstimate>> {
    let mut last = None;
    for frame in 1..=(moved_s * RATE_HZ) as u32 {
        let (shift, turn_deg) = combined(f64::from(frame) / RATE_HZ);
        let turn = UnitQuaternion::from_scaled_axis(turn_deg.map(f64::to_radians) * MOTION);
        let before = first.world_from_target;
        let world_from_target = Pose::from_parts(before.translation_m() + shift * MOTION, turn * before.rotation());
        renderer.render_pair(&ScenePoses { world_from_target, ..*first }, u64::from(frame), left, right);
        let prior = FramePrior { dt_s: Some(1.0 / RATE_HZ), ..FramePrior::default() };
        last = Some(tracker.estimate(EstimateRequest::next_frame(&*left, &*right, &prior))?);
    }
    Ok(last.filter(|last| last.cam_left_from_model.is_some()))
}

/// The surface of a later answer against the plane in the first pair.
fn judge_surface(first: &TrackEstimate, last: &TrackEstimate, plane: &Vector3<f64>) -> Option<Off> {
    let surface = last.surface?;
    let first_from_surface = first.cam_left_from_model? * surface.surface_from_model.inverse();
    Some(off(&first_from_surface.relabel(), &surface.covariance, plane))
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

fn judge(answer: &TrackEstimate, plane: &Vector3<f64>) -> Option<Off> {
    let (pose, covariance) = answer.cam_left_from_model.zip(answer.covariance)?;
    Some(off(&pose, &covariance, plane))
}

/// `plane`: the true inverse-depth plane.
fn off(pose: &Pose<CamLeft, Model>, covariance: &Matrix6<f64>, plane: &Vector3<f64>) -> Off {
    let z_m = pose.translation_m().z;
    // A small turn of the plane about x moves its normal against y, one about y along x.
    let normal = pose.inverse().transform_vector(&plane.normalize());
    let turn = pose.rotation().to_rotation_matrix();
    let places = turn.matrix() * covariance.fixed_view::<3, 3>(0, 0) * turn.matrix().transpose();
    Off {
        errors: [z_m / plane.dot(&pose.translation_m()) - z_m, -normal.y, normal.x],
        sigmas: [places[(2, 2)], covariance[(3, 3)], covariance[(4, 4)]].map(f64::sqrt),
        z_m,
    }
}

#[cfg(test)]
mod tests {
    use pb3dp_benchmarks::table::number;

    use super::*;

    #[test]
    fn figures_are_those_of_the_errors() {
        let off =
            |error: f64, tilt: f64| Off { errors: [1e-3 * error, 0.01, tilt], sigmas: [1e-3, 0.01, 0.01], z_m: 0.5 };
        let one = |error: f64| Judged { status: Status::Ok, first: off(error, 0.03), later: Some(off(error, 0.001)) };
        let found = row("x", 5, &[one(1.0), one(-3.0), one(2.0)]);
        let close = |path: &str, expected: f64| {
            let figure = number(&found, path).unwrap();
            assert!((figure - expected).abs() < 1e-9, "{path}: {figure} {expected}");
        };
        for (path, expected) in [("starts", 5.0), ("found", 3.0), ("ok", 3.0), ("followed", 3.0)] {
            close(path, expected);
        }
        for (path, expected) in [("median", 2.0), ("p95", 3.0), ("sigma_median", 1.0), ("rms", (14.0_f64 / 3.0).sqrt())]
        {
            close(&format!("depth_mm.{path}"), expected);
        }
        close("depth_mm.in_two_sigmas", 2.0 / 3.0);
        close("tilt_deg.beyond_two_sigmas_percent", 50.0);
        // A tilt of 1.8 degrees is no good one, and a depth is good up to 1.5 mm.
        close("good_first", 0.0);
        close("good_surface", 1.0 / 3.0);
        close("surface_in_two_sigmas.0", 2.0 / 3.0);
        close("surface_in_two_sigmas.1", 1.0);
        assert!(!pb3dp_benchmarks::table::row(&COLUMNS, &found).contains('?'));
    }

    /// On a shell of 25 mm the largest surface that can be followed is sometimes a sixth of the region, or the backdrop. Before, one of these was
    /// `ok` and 52 mm away.
    #[test]
    fn a_small_part_of_a_region_is_not_taken_for_it() {
        let found = measure("first-pose/crab-25", TargetConfig::crab(0.025), 2, 3, None).unwrap();
        let figure = |path: &str| number(&found, path).unwrap();
        assert!(figure("found") >= 8.0 && figure("ok") >= 5.0, "{found}");
        assert!(figure("depth_mm.p95") < 8.0 && figure("depth_mm.rms") < 3.0, "{found}");
    }

    /// The model stays, and the plane beside it becomes better. Before, the rim of a crab was tilted by up to 30 degrees against the plane of a potato's pixels with texture, at a stated 0.1.
    #[test]
    fn the_stated_deviation_of_a_curved_surface_holds() {
        let found = measure("first-pose/potato", TargetConfig::potato(), 3, 2, Some(2.3)).unwrap();
        let figure = |path: &str| number(&found, path).unwrap();
        // As many as before, of which 3 were `ok`.
        assert!(figure("found") >= 11.0 && figure("ok") >= 9.0, "{found}");
        assert!(figure("followed") >= 10.0 && figure("good_surface") > figure("good_first"), "{found}");
        assert!(figure("good_surface") >= 0.6 && figure("depth_mm.rms") < 0.6, "{found}");
        assert!(figure("tilt_deg.rms") < 1.5 && figure("tilt_deg.in_two_sigmas") >= 0.8, "{found}");
        assert!(figure("tilt_deg.stated_over_rms") < 2.0, "{found}");
    }
}
