//! Search for a lost target: in the whole left image at an eighth of the resolution, a small one at a quarter, then along the
//! disparities of each candidate.

use std::ops::Range;

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::wide;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Camera, Pose, StereoRig, so3};

use super::images::{CameraImages, LEVELS, Texel, TexelPlane, texel_at};
use super::kernels::{CHANNELS, SurfaceGroup, ViewGroup};
use super::lanes::{LANES, Lanes, each_lane};
use super::surface::Surface;
use super::view::View;
use crate::kernels::{Correlation, MomentSums};

/// Largest number of points of a template, and of those at which depths are tested. Chosen by hand, not varied: the time of a search
/// grows with it.
const POINTS_MAX: usize = 64;
/// Smallest number of points of a template. Chosen by hand, not varied: with less, a template fits anywhere; with more,
/// small targets are found only near their expected position.
const POINTS_MIN: usize = 12;
/// Number of points at which a coarser level is preferred. Chosen by hand, not varied: half of [`POINTS_MAX`].
pub(super) const POINTS_PREFERRED: usize = 32;
/// The finest level that is searched. Chosen: time grows fourfold with each level. A square of 20 px still has 12 points there.
const FINEST: usize = LEVELS - 2;
/// Number of positions kept from each search. Chosen by hand, not varied: with more, alignments take time.
pub(super) const PLACES: usize = 3;
/// Number of positions that are compared again at the next finer level, if the search was not at the coarsest: few points fit in
/// many places. Chosen by hand, not varied: the comparison takes little time beside the search.
const PLACES_COMPARED: usize = 16;
/// Distance within which the next finer level is compared, its pixels. Derived: a pixel of the searched level has two of them in a
/// row, and rounding moves the template's points by up to one.
const COMPARED_WITHIN_PX: usize = 3;
/// Range of tested depths, as a factor on the template's depth. Chosen by hand, not varied: more than
/// `direct.tracker.view_scale` (1.4), by which a target may differ from its nearest view.
const DEPTH_REACH: f64 = 1.6;
/// Largest number of tested depths. Chosen by hand, not varied: enough for steps of 2 px and disparities of 328 px;
/// farther, the steps are wider.
const DEPTHS_MAX: usize = 160;
/// Smallest correlation of a position or a depth that is examined. Chosen by hand, not varied: it only saves time.
const CORRELATION_MIN: f64 = 0.2;
/// Smallest share of a template inside the image. Chosen by hand, not varied: with less, templates at the border of the
/// image fit by chance.
const VISIBLE_MIN: f64 = 0.7;

/// A position in the left image at which a template fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    pub(super) cam_left_from_model: Pose<CamLeft, Model>,
    pub(super) correlation: f64,
}

/// A template point: its offset from the template's centre, whole pixels of the searched level, and its channels without their mean.
#[derive(Clone, Copy, Debug, Default)]
struct TemplatePoint {
    offset_px: [i32; 2],
    /// Once for each pixel of a block; every fourth is zero.
    value: Lanes,
}

/// Buffers of the search.
#[derive(Clone, Debug)]
pub(super) struct Searcher {
    kernels: Kernels,
    template: Vec<TemplatePoint>,
    scores: Vec<f32>,
}

impl Surface {
    /// The coarsest level with enough points for a template; `None` if the target is too small.
    fn searched_level(&self) -> Option<usize> {
        let has = |level: usize, points| self.levels[level].points() >= points;
        let is_preferred = |&level: &usize| has(level, POINTS_PREFERRED);
        (FINEST + 1..LEVELS).rev().find(is_preferred).or_else(|| has(FINEST, POINTS_MIN).then_some(FINEST))
    }
}

impl Searcher {
    /// Allocates buffers for images of this size.
    pub(super) fn new(width: u32, height: u32, kernels: Kernels) -> Self {
        let side = 1_usize << FINEST;
        Self {
            kernels,
            template: Vec::with_capacity(POINTS_MAX),
            scores: Vec::with_capacity((width as usize / side + 1) * (height as usize / side + 1)),
        }
    }

    /// The best positions of the target in the left image, with the rotation and the depth of `hypothesis`.
    pub(super) fn places(
        &mut self,
        surface: &Surface,
        view: &View,
        hypothesis: &Pose<CamLeft, Model>,
        left: &CameraImages,
        camera: &Camera,
    ) -> [Option<Place>; PLACES] {
        let mut places = [None; PLACES];
        let Some(level) = surface.searched_level() else { return places };
        if !self.make_template(level, surface, view, hypothesis, camera) {
            return places;
        }
        let plane = &left.levels[level];
        self.scores.clear();
        self.scores.resize(plane.width * plane.height, -1.0);
        for (y, scores) in self.scores.chunks_exact_mut(plane.width.max(1)).enumerate() {
            score_row(self.kernels, &self.template, plane, [0, y], scores);
        }
        let is_coarsest = level == LEVELS - 1;
        let mut best = [None; PLACES_COMPARED];
        let wanted = if is_coarsest { PLACES } else { PLACES_COMPARED };
        for best in best.iter_mut().take(wanted) {
            *best = take_best(&mut self.scores, plane);
        }
        let mut level = level;
        if !is_coarsest && self.make_template(level - 1, surface, view, hypothesis, camera) {
            level -= 1;
            let plane = &left.levels[level];
            for peak in best.iter_mut().flatten() {
                let [columns, rows] = around(peak.px.map(|x| 2 * x), COMPARED_WITHIN_PX, plane);
                *peak = self.best_in(plane, columns, rows).unwrap_or(*peak);
            }
            let correlation = |peak: &Option<Peak>| peak.map_or(f32::NEG_INFINITY, |peak| peak.correlation);
            best.sort_unstable_by(|a, b| correlation(b).total_cmp(&correlation(a)));
        }
        for (place, peak) in places.iter_mut().zip(best.into_iter().flatten()) {
            *place = place_at(peak, level, hypothesis, left, camera);
        }
        places
    }

    /// The best position of the target in the left image within `reach_px` (columns and rows) of a pose, with its rotation and depth.
    pub(super) fn place_near(
        &mut self,
        surface: &Surface,
        view: &View,
        pose: &Pose<CamLeft, Model>,
        reach_px: f64,
        (left, camera): (&CameraImages, &Camera),
    ) -> Option<Place> {
        let level = surface.searched_level()?;
        let plane = &left.levels[level];
        let side = f64::from(1_u32 << level);
        let px = camera.project(&Point3::from(pose.translation_m()))?;
        let origin = Vector2::new(f64::from(left.window.x), f64::from(left.window.y));
        let at = ((px - origin).add_scalar(0.5) / side).map(|x| (x - 0.5).round());
        let is_inside = at.x >= 0.0 && at.y >= 0.0 && at.x < plane.width as f64 && at.y < plane.height as f64;
        if !is_inside || !self.make_template(level, surface, view, pose, camera) {
            return None;
        }
        let [columns, rows] = around([at.x as usize, at.y as usize], (reach_px / side).ceil() as usize, plane);
        let peak = self.best_in(plane, columns, rows)?;
        place_at(peak, level, pose, left, camera)
    }

    /// The best position in some columns and rows of a level.
    fn best_in(&mut self, plane: &TexelPlane, columns: Range<usize>, rows: Range<usize>) -> Option<Peak> {
        let mut best: Option<Peak> = None;
        for row in rows {
            self.scores.clear();
            self.scores.resize(columns.len(), -1.0);
            score_row(self.kernels, &self.template, plane, [columns.start, row], &mut self.scores);
            for (column, &correlation) in columns.clone().zip(&self.scores) {
                if best.is_none_or(|best| correlation > best.correlation) {
                    best = Some(Peak { px: [column, row], correlation });
                }
            }
        }
        best
    }

    fn make_template(
        &mut self,
        level: usize,
        surface: &Surface,
        view: &View,
        hypothesis: &Pose<CamLeft, Model>,
        camera: &Camera,
    ) -> bool {
        let (groups, view) = (&surface.levels[level].groups, &view.levels[level]);
        self.template.clear();
        let pinhole = camera.pinhole();
        let frontal = moved_to_ray(hypothesis, &Vector3::z());
        let count: f32 = view.iter().map(|view| view.valid.sum()).sum();
        let keep_every = (count as usize).div_ceil(POINTS_MAX).max(1);
        let side = f64::from(1_u32 << level);
        let mut index = 0;
        for (group, view) in groups.iter().zip(view) {
            for i in (0..LANES).filter(|&i| view.valid.0[i] * group.mask.0[i] > 0.0) {
                index += 1;
                if index % keep_every != 0 {
                    continue;
                }
                let point = frontal.transform_point(&Point3::from(group.point.map(|x| f64::from(x.0[i]))));
                if point.z < 1e-3 {
                    continue;
                }
                let offset = [pinhole.fx * point.x / point.z / side, pinhole.fy * point.y / point.z / side];
                let [y, a, b] = view.value.map(|v| v.0[i]);
                let value = repeated_in_block([y, a, b, 0.0]);
                if self.template.len() < POINTS_MAX {
                    // Farther than any pixel, and far from the end of integers.
                    let offset_px = offset.map(|x| x.round().clamp(-1e6, 1e6) as i32);
                    self.template.push(TemplatePoint { offset_px, value });
                }
            }
        }
        centre(&mut self.template);
        self.template.len() >= POINTS_MIN
    }
}

/// The hypothesis moved to another ray (third component 1), with the same viewing direction and depth.
fn moved_to_ray(hypothesis: &Pose<CamLeft, Model>, ray: &Vector3<f64>) -> Pose<CamLeft, Model> {
    let from = hypothesis.translation_m();
    let turn = UnitQuaternion::rotation_between(&from, ray).unwrap_or_default();
    Pose::from_parts(ray * from.z, turn * hypothesis.rotation())
}

/// Takes the means out of the channels.
fn centre(template: &mut [TemplatePoint]) {
    let count = template.len().max(1) as f32;
    for c in 0..CHANNELS {
        let mean = template.iter().map(|point| point.value.0[c]).sum::<f32>() / count;
        template.iter_mut().for_each(|point| point.value.0.iter_mut().skip(c).step_by(4).for_each(|v| *v -= mean));
    }
}

/// A position in a level with its correlation.
#[derive(Clone, Copy, Debug)]
struct Peak {
    px: [usize; 2],
    correlation: f32,
}

/// The position with the highest score, which is removed together with its neighbours.
fn take_best(scores: &mut [f32], plane: &TexelPlane) -> Option<Peak> {
    let (width, height) = (plane.width, plane.height);
    let best = (0..width * height).max_by(|&a, &b| scores[a].total_cmp(&scores[b]))?;
    let peak = Peak { px: [best % width, best / width], correlation: scores[best] };
    let [columns, rows] = around(peak.px, 2, plane);
    for row in rows {
        scores[row * width..][columns.clone()].fill(-1.0);
    }
    (f64::from(peak.correlation) > CORRELATION_MIN).then_some(peak)
}

/// Columns and rows of a level at most this far from a pixel.
fn around(px: [usize; 2], reach: usize, plane: &TexelPlane) -> [Range<usize>; 2] {
    let range = |at: usize, length: usize| at.saturating_sub(reach)..(at + reach + 1).min(length);
    [range(px[0], plane.width), range(px[1], plane.height)]
}

fn place_at(
    peak: Peak,
    level: usize,
    hypothesis: &Pose<CamLeft, Model>,
    left: &CameraImages,
    camera: &Camera,
) -> Option<Place> {
    let side = f64::from(1_u32 << level);
    let raw = |x: usize, origin: i32| f64::from(origin) + (x as f64 + 0.5) * side - 0.5;
    let ray = camera.unproject(&Vector2::new(raw(peak.px[0], left.window.x), raw(peak.px[1], left.window.y))).ok()?;
    let cam_left_from_model = moved_to_ray(hypothesis, &ray);
    Some(Place { cam_left_from_model, correlation: f64::from(peak.correlation) })
}

wide! {
    /// Correlation of the template at the pixels of a row from `start` (column, row) on, over all channels.
    fn score_row(template: &[TemplatePoint], plane: &TexelPlane, start: [usize; 2], scores: &mut [f32]) = score_row_kernel;
}

/// Pixels that are compared at the same time: their texels fill the lanes.
const BLOCK: usize = LANES / 4;

fn repeated_in_block(texel: Texel) -> Lanes {
    Lanes(std::array::from_fn(|i| texel[i % 4]))
}

#[inline(always)]
fn score_row_kernel(template: &[TemplatePoint], plane: &TexelPlane, [first, y]: [usize; 2], scores: &mut [f32]) {
    let offsets = |axis: usize| template.iter().map(move |point| point.offset_px[axis]);
    let [(left, right), (up, down)] = [0, 1].map(|axis| {
        let (low, high) = (offsets(axis).min().unwrap_or(0), offsets(axis).max().unwrap_or(0));
        (low.min(0).unsigned_abs() as usize, high.max(0) as usize)
    });
    let is_inside = y >= up && y + down < plane.height;
    let mut x = 0;
    while x < scores.len() {
        let column = first + x;
        let has_block = is_inside && column >= left && column + right + BLOCK <= plane.width;
        if has_block && x + BLOCK <= scores.len() {
            scores[x..x + BLOCK].copy_from_slice(&score_block(template, plane, [column, y]));
            x += BLOCK;
        } else {
            scores[x] = score_at_border(template, plane, [column, y]);
            x += 1;
        }
    }
}

/// Correlations at adjacent pixels at which the whole template is inside the image.
#[inline(always)]
fn score_block(template: &[TemplatePoint], plane: &TexelPlane, [x, y]: [usize; 2]) -> [f32; BLOCK] {
    let (mut sums, mut squares, mut products) = (Lanes::ZERO, Lanes::ZERO, Lanes::ZERO);
    let mut own_squared = Lanes::ZERO;
    for TemplatePoint { offset_px: [dx, dy], value } in template {
        let (column, row) = (x as i32 + dx, y as i32 + dy);
        let texels = plane.texels[row as usize * plane.width + column as usize..][..BLOCK].as_flattened();
        let texels = each_lane!(i => texels[i]);
        sums += texels;
        squares = squares.plus(texels, texels);
        products = products.plus(texels, *value);
        own_squared = own_squared.plus(*value, *value);
    }
    let own_squared = own_squared.0[0] + own_squared.0[1] + own_squared.0[2];
    let (sums, squares, products) = (sums.0, squares.0, products.0);
    let inverse_count = 1.0 / template.len() as f32;
    std::array::from_fn(|pixel| {
        // The fourth lane counts saturated pixels.
        let (mut squared, mut product) = (0.0, 0.0);
        for i in 4 * pixel..4 * pixel + CHANNELS {
            squared += squares[i] - sums[i] * sums[i] * inverse_count;
            product += products[i];
        }
        correlation(own_squared, squared, product)
    })
}

/// Correlation at a pixel at which a part of the template may be outside the image; -1 if too much of it is.
#[inline(always)]
fn score_at_border(template: &[TemplatePoint], plane: &TexelPlane, [x, y]: [usize; 2]) -> f32 {
    let mut count = 0.0_f32;
    let mut sums = MomentSums::<[f32; CHANNELS]>::default();
    for TemplatePoint { offset_px: [dx, dy], value } in template {
        let (column, row) = (x as i32 + dx, y as i32 + dy);
        if column < 0 || row < 0 || column >= plane.width as i32 || row >= plane.height as i32 {
            continue;
        }
        let texel = &plane.texels[row as usize * plane.width + column as usize];
        let value = &value.0;
        count += 1.0;
        for c in 0..CHANNELS {
            sums.view[c] += value[c];
            sums.image[c] += texel[c];
            sums.view_squared[c] += value[c] * value[c];
            sums.image_squared[c] += texel[c] * texel[c];
            sums.product[c] += value[c] * texel[c];
        }
    }
    if count < template.len() as f32 * VISIBLE_MIN as f32 {
        return -1.0;
    }
    let (mut own, mut image, mut product) = (0.0, 0.0, 0.0);
    for c in 0..CHANNELS {
        let (a, b) = (sums.view[c], sums.image[c]);
        own += sums.view_squared[c] - a * a / count;
        image += sums.image_squared[c] - b * b / count;
        product += sums.product[c] - a * b / count;
    }
    correlation(own, image, product)
}

#[inline(always)]
fn correlation(squared: f32, other_squared: f32, product: f32) -> f32 {
    if squared > 1.0 && other_squared > 1.0 { product / (squared * other_squared).sqrt() } else { -1.0 }
}

/// Moves a pose along its ray to the distance at which the right image fits the view best.
pub(super) fn depth_by_stereo(
    groups: &[SurfaceGroup],
    view: &[ViewGroup],
    level: usize,
    pose: &Pose<CamLeft, Model>,
    right: &CameraImages,
    rig: &StereoRig,
) -> Option<Pose<CamLeft, Model>> {
    let z = pose.translation_m().z;
    let focal_baseline = rig.left().pinhole().fx * rig.baseline_m();
    let (near, far) = (focal_baseline / (z / DEPTH_REACH), focal_baseline / (z * DEPTH_REACH));
    let step_px = 0.5 * f64::from(1_u32 << level);
    let count = (((near - far) / step_px).ceil() as usize).clamp(2, DEPTHS_MAX);
    let right_from_left = rig.cam_right_from_cam_left();
    // Along the ray only the translation changes.
    let points = DepthPoints::of(groups, view, &(*right_from_left * *pose).isometry().rotation);
    let mut best: Option<(f64, Pose<CamLeft, Model>)> = None;
    for k in 0..count {
        let disparity = far + (near - far) * k as f64 / (count - 1) as f64;
        let moved = Pose::from_parts(pose.translation_m() * (focal_baseline / disparity / z), pose.rotation());
        let correlation = points.correlation(&(*right_from_left * moved).translation_m(), level, right, rig.right());
        if best.is_none_or(|(value, _)| correlation > value) {
            best = Some((correlation, moved));
        }
    }
    best.and_then(|(correlation, moved)| (correlation > CORRELATION_MIN).then_some(moved))
}

/// Points of a surface, evenly chosen, with the channels of a view.
struct DepthPoints {
    /// Relative to the origin of `model`, along the axes of the camera, metres; and the channels.
    points: [(Vector3<f64>, [f32; CHANNELS]); POINTS_MAX],
    count: usize,
}

impl DepthPoints {
    fn of(groups: &[SurfaceGroup], view: &[ViewGroup], cam_from_model: &UnitQuaternion<f64>) -> Self {
        let count: f32 = groups.iter().zip(view).map(|(group, view)| (group.mask * view.valid).sum()).sum();
        let lanes = groups.iter().zip(view).flat_map(|pair| (0..LANES).map(move |i| (pair, i)));
        let visible = lanes.filter(|&((group, view), i)| view.valid.0[i] * group.mask.0[i] > 0.0);
        let chosen = visible.step_by((count as usize).div_ceil(POINTS_MAX).max(1));
        let mut all = Self { points: [(Vector3::zeros(), [0.0; CHANNELS]); POINTS_MAX], count: 0 };
        for (out, ((group, view), i)) in all.points.iter_mut().zip(chosen) {
            let point = Vector3::from(group.point.map(|x| f64::from(x.0[i])));
            *out = (cam_from_model * point, view.value.map(|v| v.0[i]));
            all.count += 1;
        }
        all
    }

    /// Correlation with an image, the origin of `model` being at `origin_m`.
    fn correlation(&self, origin_m: &Vector3<f64>, level: usize, image: &CameraImages, camera: &Camera) -> f64 {
        let mut correlation = Correlation::default();
        for (point, channels) in &self.points[..self.count] {
            let Some(pixel) = camera.project(&Point3::from(point + origin_m)) else { continue };
            if let Some([y, a, b, _]) = texel_at(image, level, [pixel.x as f32, pixel.y as f32]) {
                correlation.add(1.0, *channels, [y, a, b]);
            }
        }
        if correlation.count() < VISIBLE_MIN * self.count as f64 { -1.0 } else { correlation.value() }
    }
}

/// Tested rotations about the line of sight, radians (20 and 40 degrees). Chosen by hand, not varied: the time to try all
/// grows with their number.
const ROLLS: [f64; 5] = [0.0, 0.35, -0.35, 0.7, -0.7];

/// The `index`-th hypothesis of the viewing direction: that of the last pose, and that of each view, each also rolled.
pub(super) fn hypothesis(index: usize, last: &Pose<CamLeft, Model>, views: &[View]) -> (usize, Pose<CamLeft, Model>) {
    let sources = views.len() + 1;
    let (source, roll) = (index % sources, ROLLS[index / sources % ROLLS.len()]);
    let base = if source == 0 { *last } else { views[source - 1].cam_left_from_model };
    let axis = base.translation_m().try_normalize(1e-9).unwrap_or_else(Vector3::z);
    let pose = Pose::from_parts(base.translation_m(), so3::exp(&(axis * roll)) * base.rotation());
    (source, pose)
}

/// The pose with its tilt mirrored at the line of sight.
pub(super) fn mirrored(pose: &Pose<CamLeft, Model>) -> Pose<CamLeft, Model> {
    let normal = pose.rotation() * Vector3::z();
    let sight = pose.translation_m().try_normalize(1e-9).unwrap_or_else(Vector3::z);
    let opposite = sight * (2.0 * normal.dot(&sight)) - normal;
    let turn = UnitQuaternion::rotation_between(&normal, &opposite).unwrap_or_default();
    Pose::from_parts(pose.translation_m(), turn * pose.rotation())
}

/// Number of different hypotheses.
pub(super) fn hypotheses(views: usize) -> usize {
    (views + 1) * ROLLS.len()
}

#[cfg(test)]
mod tests {
    use pb3dp_estimation_core::rng::SplitMix64;

    use super::*;

    /// Inside the image, blocks of pixels give what the border gives pixel by pixel.
    #[test]
    fn a_block_is_compared_as_its_pixels_are() {
        let mut random = SplitMix64::new(11);
        let mut number = |most: f64| random.unit() * most;
        let (width, height) = (40, 30);
        let texels = (0..width * height).map(|_| std::array::from_fn(|_| number(200.0) as f32)).collect();
        let plane = TexelPlane { width, height, texels };
        let mut template: Vec<TemplatePoint> = (0..30)
            .map(|_| TemplatePoint {
                offset_px: [number(15.0) as i32 - 9, number(11.0) as i32 - 3],
                value: repeated_in_block([number(90.0) as f32, number(60.0) as f32, number(20.0) as f32, 0.0]),
            })
            .collect();
        centre(&mut template);
        let mut blocks = 0;
        for y in 0..height {
            let mut scores = vec![0.0; width - 3];
            score_row_kernel(&template, &plane, [3, y], &mut scores);
            for (x, score) in scores.iter().enumerate() {
                let alone = score_at_border(&template, &plane, [x + 3, y]);
                assert!((score - alone).abs() < 1e-4, "({x}, {y}): {score} and {alone}");
                blocks += u32::from(*score != alone);
            }
        }
        assert!(blocks > 0, "some pixels were compared in blocks");
    }

    #[test]
    fn a_mirrored_tilt_is_as_large_on_the_other_side() {
        let pose: Pose<CamLeft, Model> =
            Pose::from_parts(Vector3::new(0.1, -0.05, 0.5), so3::exp(&Vector3::new(0.3, -0.2, 0.6)));
        let other = mirrored(&pose);
        let sight = pose.translation_m().normalize();
        let [own, opposite] = [&pose, &other].map(|pose| pose.rotation() * Vector3::z());
        assert!((own.dot(&sight) - opposite.dot(&sight)).abs() < 1e-12);
        assert!((own + opposite).cross(&sight).norm() < 1e-12 && own.angle(&opposite) > 0.3);
        assert!((mirrored(&other).inverse() * pose).log().norm() < 1e-9, "twice is nothing");
    }
}
