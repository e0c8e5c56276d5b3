//! One pose of one configuration: the scene, the truth, and the marked region.

use nalgebra::{UnitQuaternion, Vector2, Vector3};
use pb3dp_estimation_core::estimate::PlaneEstimate;
use pb3dp_estimation_core::region::Region;
use pb3dp_geometry::frames::{CamLeft, Target, World};
use pb3dp_geometry::{Camera, Frame, Pose};
use pb3dp_sim::raster::{GroundTruth, StereoRenderer};
use pb3dp_sim::scene::ScenePoses;
use pb3dp_sim::targets::part::SceneObject;

use super::cell::{Cell, RegionKind};
use super::random::Random;

/// Distance of the occluder in front of the target, metres.
const OCCLUDER_GAP_M: f64 = 0.06;

/// A pose with its truth.
pub struct Trial {
    /// The scene.
    pub poses: ScenePoses,
    /// The view of the left camera.
    pub ground_truth: GroundTruth,
    /// The true inverse-depth plane: the target's own plane, or for a relief the least-squares plane of the inverse
    /// depths of its visible pixels.
    pub plane: Vector3<f64>,
    /// The plane of the occluder, if it covers more of the marked region than the target: also a right answer.
    pub larger_plane: Option<Vector3<f64>>,
    /// The region that the operator marks.
    pub region: Region,
    /// The marked polygon, pixels.
    pub outline_px: Vec<Vector2<f64>>,
}

impl Trial {
    /// The reference plane of an answer: the nearest of the right planes on a ray.
    pub fn truth_for(&self, answer: &PlaneEstimate, ray: &Vector3<f64>) -> Vector3<f64> {
        let (Some(larger), Some(answer)) = (self.larger_plane, answer.pose) else { return self.plane };
        let off = |plane: &Vector3<f64>| (answer.inverse_depth_plane - plane).dot(ray).abs();
        if off(&larger) < off(&self.plane) { larger } else { self.plane }
    }
}

/// The pose number `index` of a configuration. `None` if the target is not wholly in front of the camera.
pub fn trial(cell: &Cell, seed: u32, index: usize, renderer: &mut StereoRenderer) -> Option<Trial> {
    let mut random = Random::of(seed, &cell.name, index);
    let cam_left_from_target = random_pose(cell, &mut random);
    let mut poses = ScenePoses {
        world_from_cam_left: Pose::coincident(),
        world_from_target: Pose::<World, CamLeft>::coincident() * cam_left_from_target,
    };
    if cell.setup.occluded_share > 0.0 {
        poses = hide(cell.setup.occluded_share, &cam_left_from_target, &mut random, renderer);
    }
    let ground_truth = renderer.ground_truth(&poses);
    let plane = if cell.setup.is_planar() {
        plane_of(&cam_left_from_target)
    } else {
        fitted_plane(&ground_truth, renderer.rig().left())?
    };
    let outline_px = match cell.setup.region {
        RegionKind::Rectangle => rectangle_around(&renderer.target_outline_px(&poses)?),
        RegionKind::Outline | RegionKind::Interior => renderer.target_outline_px(&poses)?,
    };
    let larger_plane =
        occluder_is_larger(&ground_truth, &outline_px).then(|| plane_of(&poses.world_from_cam_left.inverse()));
    let region = Region::Polygon { vertices_px: outline_px.clone() };
    Some(Trial { poses, ground_truth, plane, larger_plane, region, outline_px })
}

fn random_pose(cell: &Cell, random: &mut Random) -> Pose<CamLeft, Target> {
    let z_m = random.between(cell.poses.z_min_m, cell.poses.z_max_m);
    let [x_m, y_m] = [(); 2].map(|()| random.between(-0.01, 0.01));
    let [theta_x, theta_y] = cell.poses.tilt_rad(random);
    let roll = random.between(-std::f64::consts::PI, std::f64::consts::PI);
    let about = |axis: Vector3<f64>, angle: f64| UnitQuaternion::from_scaled_axis(axis * angle);
    let rotation = about(Vector3::y(), theta_y) * about(Vector3::x(), theta_x) * about(Vector3::z(), roll);
    // In the middle between the cameras, so that both see the whole target.
    Pose::from_parts(Vector3::new(0.5 * cell.setup.baseline_m() + x_m, y_m, z_m), rotation)
}

/// The inverse-depth plane of z = 0 in a frame, such as the front plane of the target.
pub fn plane_of<F: Frame>(cam_left_from_it: &Pose<CamLeft, F>) -> Vector3<f64> {
    let normal = cam_left_from_it.transform_vector(&Vector3::z());
    normal / normal.dot(&cam_left_from_it.translation_m())
}

/// Whether the bounding box of an outline shows more of the occluder than of the target.
fn occluder_is_larger(ground_truth: &GroundTruth, outline_px: &[Vector2<f64>]) -> bool {
    let corners_px = rectangle_around(outline_px);
    let (low, high) = (corners_px[0], corners_px[2]);
    let width = ground_truth.size.width as usize;
    let count = |wanted: SceneObject| {
        let shown = ground_truth.object.iter().enumerate().filter(|(_, object)| **object == wanted);
        let pixels = shown.map(|(index, _)| ((index % width) as f64, (index / width) as f64));
        pixels.filter(|(u, v)| (low.x..=high.x).contains(u) && (low.y..=high.y).contains(v)).count()
    };
    count(SceneObject::Room) > count(SceneObject::Target)
}

/// Poses in `world`, the frame of the occluder, so that it hides a share of the target's pixels: its edge crosses the
/// target in a random direction.
fn hide(
    share: f64,
    cam_left_from_target: &Pose<CamLeft, Target>,
    random: &mut Random,
    renderer: &mut StereoRenderer,
) -> ScenePoses {
    let poses = |cam_left_from_world: Pose<CamLeft, World>| ScenePoses {
        world_from_cam_left: cam_left_from_world.inverse(),
        world_from_target: cam_left_from_world.inverse() * *cam_left_from_target,
    };
    let behind_the_camera = Pose::from_translation(Vector3::new(0.0, 0.0, -2.0));
    let ground_truth = renderer.ground_truth(&poses(behind_the_camera));
    let angle = random.between(0.0, std::f64::consts::TAU);
    let (sin, cos) = angle.sin_cos();
    let mut places: Vec<(f64, Vector2<f64>)> =
        target_pixels(&ground_truth).map(|(pixel, _)| (pixel.x * cos + pixel.y * sin, pixel)).collect();
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    let edge = ((1.0 - share) * places.len() as f64) as usize;
    let Some((_, pixel)) = places.get(edge) else { return poses(behind_the_camera) };
    let Ok(ray) = renderer.rig().left().unproject(pixel) else { return poses(behind_the_camera) };
    let nearest = target_pixels(&ground_truth).map(|(_, depth_m)| depth_m).fold(f64::INFINITY, f64::min);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * angle);
    poses(Pose::from_parts(ray * (nearest - OCCLUDER_GAP_M), turn))
}

/// Pixels that show the target, with their depth in metres.
pub fn target_pixels(ground_truth: &GroundTruth) -> impl Iterator<Item = (Vector2<f64>, f64)> + '_ {
    ground_truth.pixels(&[SceneObject::Target]).map(|(pixel, depth_m)| (pixel.map(f64::from).into(), depth_m))
}

/// The least-squares plane of the inverse depths of the target's visible pixels; `None` if they do not span a plane.
pub fn fitted_plane(ground_truth: &GroundTruth, camera: &Camera) -> Option<Vector3<f64>> {
    GroundTruth::plane(camera, ground_truth.pixels(&[SceneObject::Target]))
}

/// The bounding box of an outline.
pub fn rectangle_around(outline_px: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let low = outline_px.iter().fold(Vector2::repeat(f64::INFINITY), |low, p| low.inf(p));
    let high = outline_px.iter().fold(Vector2::repeat(f64::NEG_INFINITY), |high, p| high.sup(p));
    vec![low, Vector2::new(high.x, low.y), high, Vector2::new(low.x, high.y)]
}

/// Error of a plane: depth along the centroid's ray, and the deviation of the normal along two axes across the ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneErrors {
    /// Estimated minus true depth, metres.
    pub z_m: f64,
    /// The deviation of the normal, radians, along the axes of [`across`].
    pub tilt_rad: Vector2<f64>,
}

/// Two axes across a unit normal: the first lies in the plane of x and the normal.
pub fn across(normal: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = (Vector3::x() - normal * normal.x).normalize();
    [first, normal.cross(&first)]
}

/// The errors of an inverse-depth plane on a ray. `None` if the plane is not in front of the camera there.
pub fn plane_errors(found: &Vector3<f64>, truth: &Vector3<f64>, ray: &Vector3<f64>) -> Option<PlaneErrors> {
    let (found_inverse, true_inverse) = (found.dot(ray), truth.dot(ray));
    if found_inverse <= 0.0 || true_inverse <= 0.0 {
        return None;
    }
    let (normal, true_normal) = (found.normalize(), truth.normalize());
    let deviation = true_normal.cross(&normal);
    let angle = deviation.norm().atan2(true_normal.dot(&normal));
    let direction = (normal - true_normal * true_normal.dot(&normal)).try_normalize(1e-12);
    let tilt_rad = direction.map_or(Vector2::zeros(), |direction| {
        let [a, b] = across(&true_normal);
        Vector2::new(direction.dot(&a), direction.dot(&b)) * angle
    });
    Some(PlaneErrors { z_m: 1.0 / found_inverse - 1.0 / true_inverse, tilt_rad })
}

#[cfg(test)]
mod tests {
    use pb3dp_estimation_core::plane_hypothesis::PlaneHypothesis;

    use super::*;

    /// A rectangle with background and occluder: the surface that fills more of it gives the reference plane.
    #[test]
    fn what_hides_more_than_is_left_of_the_target_has_a_plane() {
        use super::super::scenes::{SceneStore, rigs, sensor};
        let cells = super::super::cells::all();
        let cell = cells.iter().find(|cell| cell.name == "rectangle/100mm-behind-20%-hidden").unwrap();
        let (scene, rig) = (SceneStore::default().scene(&cell.setup).unwrap(), rigs(&cell.setup).unwrap().real);
        let mut renderer = StereoRenderer::new(scene, rig, &sensor(&cell.setup), 1).unwrap();
        let mut others = 0;
        for index in 65..75 {
            let trial = trial(cell, 1, index, &mut renderer).unwrap();
            let ground_truth = renderer.ground_truth(&trial.poses);
            let [width, height] = [ground_truth.size.width, ground_truth.size.height].map(|size| size as usize);
            for v in (0..height).step_by(20) {
                for u in (0..width).step_by(20) {
                    let (at, ray) = (v * width + u, rig.left().unproject(&Vector2::new(u as f64, v as f64)).unwrap());
                    let plane = match ground_truth.object[at] {
                        SceneObject::Target => Some(trial.plane),
                        SceneObject::Room => trial.larger_plane,
                        _ => None,
                    };
                    let Some(plane) = plane else { continue };
                    assert!(
                        (plane.dot(&ray) * f64::from(ground_truth.depth_m[at]) - 1.0).abs() < 1e-4,
                        "{index}: {u}, {v}"
                    );
                }
            }
            others += usize::from(trial.larger_plane.is_some());
        }
        assert!((1..10).contains(&others), "in {others} of 10 rectangles");
    }

    #[test]
    fn errors_are_depth_on_the_ray_and_angle_between_normals() {
        let ray = Vector3::new(0.1, -0.05, 1.0);
        let truth = PlaneHypothesis { z_m: 0.5, theta_x_rad: 0.2, theta_y_rad: -0.3 };
        let found = PlaneHypothesis { z_m: 0.503, theta_x_rad: 0.24, theta_y_rad: -0.27 };
        let plane = |psi: &PlaneHypothesis| psi.inverse_depth_plane(&ray).unwrap();
        let errors = plane_errors(&plane(&found), &plane(&truth), &ray).unwrap();
        assert!((errors.z_m - 0.003).abs() < 1e-12, "{errors:?}");
        let angle = found.normal().dot(&truth.normal()).acos();
        assert!((errors.tilt_rad.norm() - angle).abs() < 1e-9, "{errors:?} {angle}");
        let [a, b] = across(&truth.normal());
        let along = |axis: Vector3<f64>| (found.normal() - truth.normal()).dot(&axis);
        assert!((errors.tilt_rad - Vector2::new(along(a), along(b))).norm() < 1e-4);
        assert_eq!(plane_errors(&-plane(&found), &plane(&truth), &ray), None);
    }
}
