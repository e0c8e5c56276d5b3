//! The target's surface: points selected in the first view, on a plane with a relief, for every level of the pyramid.

use nalgebra::{Point3, Vector2, Vector3};
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_estimation_core::wide::LANES;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Camera, Distortion, Pose, StereoRig};

use super::images::{CameraImages, LEVELS};
use super::kernels::{LensGroup, SurfaceGroup};
use super::lanes::Lanes;
use super::relief::Relief;
use super::shape::Shape;
use crate::cells::{Cell, Cells};

/// Number of sub-cells along a cell's side: each contributes its sharpest pixel, and a cell is a group. Derived: its square
/// is [`LANES`].
const SUB_CELLS: usize = 4;
const _: () = assert!(SUB_CELLS * SUB_CELLS == LANES);
/// Correlation of the noise of two points by the distance of their columns or rows, pixels. For white noise, sampled on a pixel
/// with a cubic B-spline, (1, 4, 1) / 6: sums of products 18, 8 and 1 over 36.
const SHARED_BY_DISTANCE: [f64; 3] = [1.0, 8.0 / 18.0, 1.0 / 18.0];
/// Typical effect of this correlation for the sharpest thousand of ten thousand pixels, see [`Surface::noise_sharing`]; for
/// uniformly random points it would be 1 + 0.1 (2^2 - 1) = 1.3. How it was measured is not on record.
const SHARING_USUAL: f64 = 1.5;
/// Smallest number of points of a cell. Chosen by hand, not varied: a quarter of a full cell.
const CELL_POINTS_MIN: usize = 4;

/// Positions of a group's points in the first view.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PlaceGroup {
    /// Raw left pixel (u, v).
    pub(super) pixel: [Lanes; 2],
    /// Derivative of the ray (x by u, x by v, y by u, y by v) with respect to the pixel.
    ray_by_pixel: [Lanes; 4],
}

/// The points of one level.
#[derive(Clone, Debug, Default)]
pub(super) struct SurfaceLevel {
    pub(super) groups: Vec<SurfaceGroup>,
    pub(super) places: Vec<PlaceGroup>,
    pub(super) lens: [Vec<LensGroup>; 2],
}

impl SurfaceLevel {
    /// Number of points.
    pub(super) fn points(&self) -> usize {
        self.groups.iter().map(|group| group.mask.sum() as usize).sum()
    }
}

/// The surface in the frame `model`.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    pub(super) levels: [SurfaceLevel; LEVELS],
    /// The plane in the first left camera: inverse depth is `plane . ray`, plus the relief.
    pub(super) plane: Vector3<f64>,
    pub(super) relief: Relief,
    /// Information about plane and relief.
    pub(super) shape: Shape,
    /// The reference plane of the disparities in [`Self::shape`].
    plane_of_shape: Vector3<f64>,
    pub(super) model_from_first: Pose<Model, CamLeft>,
    /// Distance of the farthest point from the origin of `model`, metres.
    pub(super) radius_m: f64,
    /// Factor by which shared noise reduces the information of the points, relative to targets with ten pixels per point, for
    /// which the total effect was measured.
    pub(super) noise_sharing: f64,
}

/// Pose of the frame `model` in the first left camera: origin on `centre_ray` in the plane, z along the normal away from the
/// camera, x the image's x axis projected into the plane.
pub(super) fn model_frame(plane: &Vector3<f64>, centre_ray: &Vector3<f64>) -> Option<Pose<CamLeft, Model>> {
    let inverse_depth = plane.dot(centre_ray);
    let z = plane.try_normalize(1e-12)?;
    let x = (Vector3::x() - z * z.x).try_normalize(1e-6)?;
    let axes = nalgebra::Matrix3::from_columns(&[x, z.cross(&x), z]);
    let pose = Pose::from_rotation_matrix(&axes, centre_ray / inverse_depth);
    (inverse_depth > 0.0 && pose.is_finite()).then_some(pose)
}

impl Surface {
    /// Selects points inside `region` (already eroded) of the first left image.
    pub(super) fn choose(
        left: &CameraImages,
        region: &RegionMask,
        rig: &StereoRig,
        plane: Vector3<f64>,
        first_from_model: &Pose<CamLeft, Model>,
        points: usize,
        relief_sigma_px: f64,
    ) -> Self {
        let disparity_scale = 1.0 / (rig.left().pinhole().fx * rig.baseline_m());
        let (cells, mut relief) = {
            let chosen = choose_cells(left, region, 0, points);
            let relief = Relief::over(&chosen, disparity_scale);
            (chosen, relief)
        };
        let mut levels: [SurfaceLevel; LEVELS] = Default::default();
        for (level, out) in levels.iter_mut().enumerate() {
            let coarser;
            let cells = if level == 0 {
                &cells
            } else {
                coarser = choose_cells(left, region, level, points >> level);
                &coarser
            };
            out.fill(cells, rig);
        }
        let pixels = levels[0].groups.iter().zip(&levels[0].places).map(|(group, place)| {
            let lanes = (0..LANES).filter(|&i| group.mask.0[i] > 0.0);
            lanes.map(|i| place.pixel.map(|x| f64::from(x.0[i]))).collect()
        });
        let shape = Shape::over(relief.grid(pixels, rig.left()), relief_sigma_px);
        let model_from_first = first_from_model.inverse();
        let mut surface = Self {
            levels,
            plane,
            relief,
            shape,
            plane_of_shape: plane,
            model_from_first,
            radius_m: 0.0,
            noise_sharing: 1.0,
        };
        surface.rebuild();
        surface.radius_m = surface.radius();
        surface.noise_sharing = (surface.shared_noise() / SHARING_USUAL).max(1.0);
        surface
    }

    /// Removes the information about the surface; the surface itself does not change.
    pub(super) fn restart_shape(&mut self) {
        self.plane_of_shape = self.plane;
        let nodes = self.relief.nodes(self.shape.mean.len());
        self.shape.restart(&nodes);
    }

    /// Sets plane and relief to the current shape.
    pub(super) fn take_shape(&mut self) {
        let plane = self.shape.common_plane();
        self.plane = self.plane_of_shape + plane * self.relief.inverse_depth_per_px();
        let Self { relief, shape, .. } = self;
        relief.set_nodes(|node| shape.beyond(node, &plane));
        self.rebuild();
    }

    /// Replaces the plane; relief and information about the surface stay as they are.
    pub(super) fn set_plane(&mut self, plane: Vector3<f64>) {
        self.plane_of_shape += plane - self.plane;
        self.plane = plane;
        self.rebuild();
    }

    /// Computes the positions of all points from plane and relief.
    pub(super) fn rebuild(&mut self) {
        let model_from_first = self.model_from_first;
        for level in &mut self.levels {
            for (group, place) in level.groups.iter_mut().zip(&level.places) {
                for i in 0..LANES {
                    place_point(group, place, i, &self.plane, &self.relief, &model_from_first);
                }
            }
        }
    }

    /// Information loss of the points at full resolution due to shared noise.
    fn shared_noise(&self) -> f64 {
        let places = self.levels[0].groups.iter().zip(&self.levels[0].places);
        let pixels = places.flat_map(|(group, place)| {
            let lanes = (0..LANES).filter(|&i| group.mask.0[i] > 0.0);
            lanes.map(|i| [place.pixel[1].0[i].round() as i32, place.pixel[0].0[i].round() as i32])
        });
        shared_noise(pixels.collect())
    }

    fn radius(&self) -> f64 {
        let groups = &self.levels[0].groups;
        let squares = groups.iter().flat_map(|group| {
            (0..LANES)
                .filter(|&i| group.mask.0[i] > 0.0)
                .map(|i| group.point.iter().map(|x| x.0[i] * x.0[i]).sum::<f32>())
        });
        f64::from(squares.fold(0.0, f32::max)).sqrt()
    }

    /// Number of points at full resolution.
    pub(super) fn points(&self) -> usize {
        self.levels[0].points()
    }

    /// Linearises the lens of a camera at the expected positions of a level's points. A lens without distortion is linear
    /// everywhere and remains unchanged.
    pub(super) fn linearise_lens(
        &mut self,
        level: usize,
        side: usize,
        camera: &Camera,
        cam_from_model: &nalgebra::Isometry3<f64>,
    ) {
        if matches!(camera.distortion(), Distortion::None) {
            return;
        }
        let level = &mut self.levels[level];
        for (group, lens) in level.groups.iter().zip(&mut level.lens[side]) {
            for i in (0..LANES).filter(|&i| group.mask.0[i] > 0.0) {
                let point = Point3::from(group.point.map(|x| f64::from(x.0[i])));
                let in_cam = cam_from_model * point;
                if in_cam.z > 1e-3 {
                    let xy = Vector2::new(in_cam.x / in_cam.z, in_cam.y / in_cam.z);
                    set_lens(lens, i, camera, &xy);
                }
            }
        }
    }
}

/// Information loss of points (row, column) due to shared noise, as a factor: each is sampled with its neighbourhood
/// (`images.rs`), which adjacent points share.
fn shared_noise(mut pixels: Vec<[i32; 2]>) -> f64 {
    pixels.sort_unstable();
    let reach = SHARED_BY_DISTANCE.len() as i32 - 1;
    let shared = |[row, column]: [i32; 2]| -> f64 {
        let around = (-reach..=reach).flat_map(|dv| (-reach..=reach).map(move |du| (dv, du)));
        let points = around.filter(|(dv, du)| pixels.binary_search(&[row + dv, column + du]).is_ok());
        let by = |distance: i32| SHARED_BY_DISTANCE[distance.unsigned_abs() as usize];
        points.map(|(dv, du)| by(dv) * by(du)).sum()
    };
    pixels.iter().map(|&pixel| shared(pixel)).sum::<f64>() / pixels.len().max(1) as f64
}

fn set_lens(lens: &mut LensGroup, i: usize, camera: &Camera, xy: &Vector2<f64>) {
    let pinhole = camera.pinhole();
    let (distorted, by_xy) = camera.distortion().distort_with_jacobian(xy);
    let pixel = pinhole.pixel_from_normalized(&distorted);
    let numbers = [
        xy.x,
        xy.y,
        pixel.x,
        pixel.y,
        pinhole.fx * by_xy[(0, 0)],
        pinhole.fx * by_xy[(0, 1)],
        pinhole.fy * by_xy[(1, 0)],
        pinhole.fy * by_xy[(1, 1)],
    ];
    for (out, number) in lens.iter_mut().zip(numbers) {
        out.0[i] = number as f32;
    }
}

fn place_point(
    group: &mut SurfaceGroup,
    place: &PlaceGroup,
    i: usize,
    plane: &Vector3<f64>,
    relief: &Relief,
    model_from_first: &Pose<Model, CamLeft>,
) {
    let ray = Vector3::new(f64::from(group.ray[0].0[i]), f64::from(group.ray[1].0[i]), 1.0);
    let pixel = place.pixel.map(|x| f64::from(x.0[i]));
    let (offset, slope) = relief.at(pixel);
    let inverse_depth = (plane.dot(&ray) + offset).max(1e-3);
    let in_first = ray / inverse_depth;
    let point = model_from_first.transform_point(&Point3::from(in_first));
    let slide = model_from_first.transform_vector(&(in_first / -inverse_depth));
    for (axis, (point, slide)) in point.iter().zip(slide.iter()).enumerate() {
        group.point[axis].0[i] = *point as f32;
        group.slide[axis].0[i] = *slide as f32;
    }
    for (k, slope) in slope.into_iter().enumerate() {
        let ray_by =
            Vector3::new(f64::from(place.ray_by_pixel[k].0[i]), f64::from(place.ray_by_pixel[2 + k].0[i]), 0.0);
        let depth_by = plane.dot(&ray_by) + slope;
        let by = model_from_first.transform_vector(&((ray_by - in_first * depth_by) / inverse_depth));
        for (axis, by) in by.iter().enumerate() {
            group.base[3 * k + axis].0[i] = *by as f32;
        }
    }
}

/// A candidate pixel: column and row in its level, and its sharpness.
struct Candidate {
    x: usize,
    y: usize,
    sharpness: f32,
}

fn choose_cells(images: &CameraImages, region: &RegionMask, level: usize, wanted: usize) -> Cells {
    let factor = f64::from(1_u32 << level);
    let raw = |x: f64, origin: i32| f64::from(origin) + (x + 0.5) * factor - 0.5;
    let (origin_x, origin_y) = (images.window.x, images.window.y);
    let mut candidates = Vec::new();
    let (width, height) = images.size(level);
    for y in 1..height.saturating_sub(2) {
        for x in 1..width.saturating_sub(2) {
            let (u, v) = (raw(x as f64, origin_x), raw(y as f64, origin_y));
            if region.contains(u.round() as i32, v.round() as i32)
                && let Some(sharpness) = sharpness(images, level, x, y)
            {
                candidates.push(Candidate { x, y, sharpness });
            }
        }
    }
    let (Some(x0), Some(y0)) = (candidates.iter().map(|c| c.x).min(), candidates.iter().map(|c| c.y).min()) else {
        return Cells::default();
    };
    let side = (candidates.len() as f64 / wanted.max(1) as f64).sqrt().max(1.0);
    let sub = |x: usize, first: usize| ((x - first) as f64 / side) as usize;
    let columns = candidates.iter().map(|c| sub(c.x, x0)).max().unwrap_or(0) / SUB_CELLS + 1;
    let rows = candidates.iter().map(|c| sub(c.y, y0)).max().unwrap_or(0) / SUB_CELLS + 1;
    let mut best: Vec<Option<&Candidate>> = vec![None; columns * rows * SUB_CELLS * SUB_CELLS];
    for candidate in &candidates {
        let (i, j) = (sub(candidate.x, x0), sub(candidate.y, y0));
        let cell = j / SUB_CELLS * columns + i / SUB_CELLS;
        let slot = &mut best[cell * SUB_CELLS * SUB_CELLS + j % SUB_CELLS * SUB_CELLS + i % SUB_CELLS];
        if slot.is_none_or(|old| old.sharpness < candidate.sharpness) {
            *slot = Some(candidate);
        }
    }
    let cells = best.chunks(SUB_CELLS * SUB_CELLS).enumerate().map(|(index, chosen)| Cell {
        column: index % columns,
        row: index / columns,
        pixels: chosen.iter().flatten().map(|c| [raw(c.x as f64, origin_x), raw(c.y as f64, origin_y)]).collect(),
    });
    let half = 0.5 * SUB_CELLS as f64 * side;
    Cells {
        first_centre_px: [raw(x0 as f64 - 0.5 + half, origin_x), raw(y0 as f64 - 0.5 + half, origin_y)],
        side_px: SUB_CELLS as f64 * side * factor,
        columns,
        rows,
        cells: cells.filter(|cell| cell.pixels.len() >= CELL_POINTS_MIN).collect(),
    }
}

/// Squared gradient of all channels; `None` next to saturated pixels.
fn sharpness(images: &CameraImages, level: usize, x: usize, y: usize) -> Option<f32> {
    let at = |x: usize, y: usize| images.texel(level, x, y);
    let (left, right, up, down) = (at(x - 1, y), at(x + 1, y), at(x, y - 1), at(x, y + 1));
    let saturated = at(x, y)[3] + left[3] + right[3] + up[3] + down[3];
    let square = |c: usize| (right[c] - left[c]).powi(2) + (down[c] - up[c]).powi(2);
    (saturated < 0.1).then(|| square(0) + square(1) + square(2))
}

impl SurfaceLevel {
    fn fill(&mut self, cells: &Cells, rig: &StereoRig) {
        for cell in &cells.cells {
            let (mut group, mut place) = (SurfaceGroup::default(), PlaceGroup::default());
            for (i, pixel) in cell.pixels.iter().enumerate() {
                set_place(&mut group, &mut place, i, rig.left(), *pixel);
            }
            self.groups.push(group);
            self.places.push(place);
        }
        for (side, camera) in [rig.left(), rig.right()].into_iter().enumerate() {
            let mut lens: LensGroup = [Lanes::ZERO; 8];
            (0..LANES).for_each(|i| set_lens(&mut lens, i, camera, &Vector2::zeros()));
            self.lens[side] = vec![lens; self.groups.len()];
        }
    }
}

/// Stores a pixel in a lane, if it has a ray.
fn set_place(group: &mut SurfaceGroup, place: &mut PlaceGroup, i: usize, camera: &Camera, pixel: [f64; 2]) {
    let at = |du: f64, dv: f64| camera.unproject(&Vector2::new(pixel[0] + du, pixel[1] + dv)).ok();
    let rays = [at(0.0, 0.0), at(0.5, 0.0), at(-0.5, 0.0), at(0.0, 0.5), at(0.0, -0.5)];
    let [Some(ray), Some(right), Some(left), Some(down), Some(up)] = rays else { return };
    let (by_u, by_v) = (right - left, down - up);
    group.mask.0[i] = 1.0;
    (group.ray[0].0[i], group.ray[1].0[i]) = (ray.x as f32, ray.y as f32);
    (place.pixel[0].0[i], place.pixel[1].0[i]) = (pixel[0] as f32, pixel[1] as f32);
    for (out, number) in place.ray_by_pixel.iter_mut().zip([by_u.x, by_v.x, by_u.y, by_v.y]) {
        out.0[i] = number as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(step: i32) -> Vec<[i32; 2]> {
        (0..40).flat_map(|y| (0..40).map(move |x| [step * y, 7 + step * x])).collect()
    }

    #[test]
    fn points_next_to_each_other_share_their_noise() {
        let [dense, loose, far] = [1, 2, 4].map(|step| shared_noise(grid(step)));
        assert!((3.5..=4.0).contains(&dense), "{dense}: sixteen pixels are read for each, with unequal weights");
        assert!((1.1..1.3).contains(&loose), "{loose}");
        assert!((far - 1.0).abs() < 1e-12 && shared_noise(Vec::new()) == 0.0);
    }
}
