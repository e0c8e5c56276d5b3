//! Matching of distinctive patches of the left image along their epipolar curves in the right image.

use image::RgbImage;
use nalgebra::{Point3, Vector2};
use pb3dp_geometry::StereoRig;

use super::plane::{Moments, Plane, SCALE, WINDOW, Window};

/// Largest width after downsampling, pixels; images are reduced by an integer factor.
const WORKING_WIDTH_MAX: f64 = 480.0;
/// Approximate number of cells of the left image; each cell has one patch.
const CELLS: f64 = 220.0;
/// Smallest texture of a patch, grey levels per sample (root of the structure tensor's smaller eigenvalue).
const TEXTURE_MIN: f64 = 2.5;
/// Largest disparity searched, on both sides of infinity, as a share of the width.
const DISPARITY_MAX_SHARE: f64 = 0.45;
/// Largest distance from the curve searched, pixels.
const OFFSET_MAX_PX: f64 = 12.0;
/// Smallest correlation of a match.
const CORRELATION_MIN: f32 = 0.85;
/// Largest ratio of `1 - correlation` between a match and its best rival.
const RIVAL_RATIO_MAX: f32 = 0.5;
/// Lower bound of `1 - correlation` of a match, so that a rival must be clearly worse.
const FLAW_MIN: f32 = 0.02;
/// Score of a position outside the image.
const OUTSIDE: f32 = -1.0;
/// Positions closer to the match than this belong to the match, samples.
const RIVAL_DISTANCE: usize = 3;

/// A patch with an unambiguous match in the right image.
#[derive(Clone, Copy, Debug)]
pub struct Match {
    /// Disparity along the curve, pixels of the right image: 0 at infinity, negative behind the cameras.
    pub disparity_px: f64,
    /// Distance from the curve, pixels of the right image; positive is down.
    pub offset_px: f64,
}

/// Result of the matching.
pub struct Search {
    /// Number of patches searched for.
    pub patches: usize,
    /// The matches found.
    pub matches: Vec<Match>,
}

/// Matches patches of the left image in the right image; `None` if the images are smaller than a few patches.
pub fn matches_of(rig: &StereoRig, left: &RgbImage, right: &RgbImage) -> Option<Search> {
    let factor = (f64::from(left.width()) / WORKING_WIDTH_MAX).ceil().max(1.0) as usize;
    let images = Images::new(left, right, factor);
    if [&images.left, &images.right].iter().any(|plane| plane.width.min(plane.height) < 4 * WINDOW) {
        return None;
    }
    let corners = textured_corners(&images.left);
    let matches = corners.iter().filter_map(|&corner| images.find(rig, corner)).collect();
    Some(Search { patches: corners.len(), matches })
}

/// Corners of the best-textured window of each cell, if its texture is sufficient.
fn textured_corners(plane: &Plane) -> Vec<[usize; 2]> {
    let cell = ((plane.width * plane.height) as f64 / CELLS).sqrt().max(WINDOW as f64) as usize;
    let texture = Texture::of(plane);
    let mut corners = Vec::new();
    for y0 in (1..plane.height - WINDOW).step_by(cell) {
        for x0 in (1..plane.width - WINDOW).step_by(cell) {
            let candidates = (y0..(y0 + cell).min(plane.height - WINDOW))
                .step_by(2)
                .flat_map(|y| (x0..(x0 + cell).min(plane.width - WINDOW)).step_by(2).map(move |x| [x, y]));
            let best = candidates.map(|[x, y]| (texture.strength(x, y), [x, y])).max_by(|a, b| a.0.total_cmp(&b.0));
            corners.extend(best.filter(|(strength, _)| *strength >= TEXTURE_MIN).map(|(_, corner)| corner));
        }
    }
    corners
}

/// Products of the gradients, summed along rows over a window's width.
struct Texture {
    width: usize,
    row_sums: Vec<[f32; 3]>,
}

impl Texture {
    fn of(plane: &Plane) -> Self {
        let (width, height) = (plane.width, plane.height);
        let mut products = vec![[0.0_f32; 3]; width];
        let mut row_sums = vec![[0.0_f32; 3]; width * height];
        for y in 1..height - 1 {
            for (x, product) in products.iter_mut().enumerate().take(width - 1).skip(1) {
                let by_x = (plane.at(x + 1, y) - plane.at(x - 1, y)) as f32 / (2.0 * SCALE as f32);
                let by_y = (plane.at(x, y + 1) - plane.at(x, y - 1)) as f32 / (2.0 * SCALE as f32);
                *product = [by_x * by_x, by_x * by_y, by_y * by_y];
            }
            for x in 0..=width - WINDOW {
                let sum = &mut row_sums[y * width + x];
                for product in &products[x..x + WINDOW] {
                    (0..3).for_each(|k| sum[k] += product[k]);
                }
            }
        }
        Self { width, row_sums }
    }

    /// Root of the smaller eigenvalue of the mean structure tensor of a window, grey levels per sample.
    fn strength(&self, x: usize, y: usize) -> f64 {
        let mut sum = [0.0_f64; 3];
        for dy in 0..WINDOW {
            (0..3).for_each(|k| sum[k] += f64::from(self.row_sums[(y + dy) * self.width + x][k]));
        }
        let [xx, xy, yy] = sum.map(|s| s / (WINDOW * WINDOW) as f64);
        let smaller = 0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        smaller.max(0.0).sqrt()
    }
}

/// A pair at the reduced size for the search, and at full size for sub-pixel refinement.
struct Images {
    factor: usize,
    left: Plane,
    right: Plane,
    right_moments: Vec<Moments>,
    full: Option<[Plane; 2]>,
}

/// The epipolar curve of a patch: positions of its centre with increasing inverse depth.
struct Curve {
    /// Positions of the centre, pixels of the right image; about one working sample apart.
    places_px: Vec<Vector2<f64>>,
    /// Index of the position of a point at infinity.
    infinity: usize,
}

impl Images {
    fn new(left: &RgbImage, right: &RgbImage, factor: usize) -> Self {
        let working_right = Plane::of(right, factor);
        let full = (factor > 1).then(|| [Plane::of(left, 1), Plane::of(right, 1)]);
        Self {
            factor,
            left: Plane::of(left, factor),
            right_moments: working_right.all_moments(),
            right: working_right,
            full,
        }
    }

    /// Full-size pixel of the centre of the window at a working corner; `corner` is the inverse.
    fn centre_px(&self, corner: f64) -> f64 {
        (corner + 0.5 * WINDOW as f64) * self.factor as f64 - 0.5
    }

    fn corner(&self, centre_px: f64) -> f64 {
        (centre_px + 0.5) / self.factor as f64 - 0.5 * WINDOW as f64
    }

    /// Searches for the window at a corner of the left plane.
    fn find(&self, rig: &StereoRig, [x, y]: [usize; 2]) -> Option<Match> {
        let window = self.left.window(x, y)?;
        let centre_px = Vector2::new(self.centre_px(x as f64), self.centre_px(y as f64));
        let curve = Curve::of(rig, &centre_px, self.left.width)?;
        let reach = (OFFSET_MAX_PX / self.factor as f64).ceil() as isize;
        let scores = self.scores(&window, &curve, reach);
        let (step, side) = distinctive(&scores, (2 * reach + 1) as usize)?;
        let corner = self.corners_at(&curve, step, reach).nth(side)?;
        let right_px = self.refined([x as isize, y as isize], corner);
        let (disparity_px, offset_px) = curve.coordinates(step, &right_px);
        Some(Match { disparity_px, offset_px })
    }

    /// The working corners at a position of the curve, and up to `reach` samples above and below it.
    fn corners_at(&self, curve: &Curve, step: usize, reach: isize) -> impl Iterator<Item = [isize; 2]> {
        let place = curve.places_px[step].map(|px| self.corner(px));
        let across = curve.across(step);
        (-reach..=reach).map(move |offset| {
            let at = place + across * offset as f64;
            // Truncation is the cheapest rounding; the added constant keeps the value positive.
            [at.x, at.y].map(|value| (value + 65536.5) as isize - 65536)
        })
    }

    /// Correlations at all positions of the curve and in the band around it; within a position, from one side to the other.
    fn scores(&self, window: &Window, curve: &Curve, reach: isize) -> Vec<f32> {
        let mut scores = Vec::with_capacity(curve.places_px.len() * (2 * reach + 1) as usize);
        for step in 0..curve.places_px.len() {
            for [x, y] in self.corners_at(curve, step, reach) {
                scores.push(if self.right.holds(x, y) {
                    let (x, y) = (x as usize, y as usize);
                    self.right.correlation(window, &self.right_moments[y * self.right.width + x], x, y)
                } else {
                    OUTSIDE
                });
            }
        }
        scores
    }

    /// Sub-pixel centre at full size of the patch in the right image that corresponds to a working corner of the left image.
    /// The search starts at a working corner of the right image.
    fn refined(&self, left_corner: [isize; 2], right_corner: [isize; 2]) -> Vector2<f64> {
        let [left, right] = self.full.as_ref().map_or([&self.left, &self.right], |[left, right]| [left, right]);
        let windows = quadrants(left_corner, self.factor)
            .map(|[x, y]| left.holds(x, y).then(|| left.window(x as usize, y as usize)).flatten());
        let around = quadrants(right_corner, self.factor);
        let score = |dx: isize, dy: isize| -> f64 {
            let pairs = windows.iter().zip(around).filter_map(|(window, at)| Some((window.as_ref()?, at)));
            pairs.map(|(window, [x, y])| f64::from(right.correlation_at(window, x + dx, y + dy))).sum()
        };
        let reach = self.factor as isize;
        let (mut best, mut at) = (f64::NEG_INFINITY, [0, 0]);
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let here = score(dx, dy);
                if here > best {
                    (best, at) = (here, [dx, dy]);
                }
            }
        }
        let [dx, dy] = at;
        let between = Vector2::new(
            summit(score(dx - 1, dy), best, score(dx + 1, dy)),
            summit(score(dx, dy - 1), best, score(dx, dy + 1)),
        );
        let coarse = Vector2::new(self.centre_px(right_corner[0] as f64), self.centre_px(right_corner[1] as f64));
        coarse + Vector2::new(dx as f64, dy as f64) + between
    }
}

/// Corners, at full size, of the four windows around the centre of the window at a working corner.
fn quadrants(corner: [isize; 2], factor: usize) -> [[isize; 2]; 4] {
    let [x, y] = corner.map(|value| value * factor as isize + (factor as isize - 2) * (WINDOW as isize / 2));
    let side = WINDOW as isize;
    [[x, y], [x + side, y], [x, y + side], [x + side, y + side]]
}

/// Position of the maximum, between -0.5 and 0.5, of the parabola through three values at -1, 0 and 1.
fn summit(before: f64, at: f64, after: f64) -> f64 {
    let bend = before - 2.0 * at + after;
    if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

/// Position and side of the best score, if it is high enough, not at the edge of the band, and without a rival elsewhere.
fn distinctive(scores: &[f32], sides: usize) -> Option<(usize, usize)> {
    let (index, &best) = scores.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    let (step, side) = (index / sides, index % sides);
    if best < CORRELATION_MIN || side == 0 || side + 1 == sides {
        return None;
    }
    let mut rival = OUTSIDE;
    for (other, line) in scores.chunks_exact(sides).enumerate() {
        let is_near = other.abs_diff(step) < RIVAL_DISTANCE;
        for (other_side, &score) in line.iter().enumerate() {
            if score > rival && !(is_near && other_side.abs_diff(side) < RIVAL_DISTANCE) {
                rival = score;
            }
        }
    }
    ((1.0 - best).max(FLAW_MIN) <= RIVAL_RATIO_MAX * (1.0 - rival)).then_some((step, side))
}

impl Curve {
    /// The curve of a left pixel, from behind the cameras through infinity to the nearest points. `None` if the pixel has no
    /// ray or the right camera does not face its direction.
    fn of(rig: &StereoRig, left_px: &Vector2<f64>, working_width: usize) -> Option<Self> {
        let right_from_left = rig.cam_right_from_cam_left();
        let ray = rig.left().unproject(left_px).ok()?;
        let far = right_from_left.transform_vector(&ray);
        let translation_m = right_from_left.translation_m();
        let width = f64::from(rig.right().size().width);
        let rho_max = DISPARITY_MAX_SHARE * width / (rig.right().pinhole().fx * translation_m.norm());
        let steps = (DISPARITY_MAX_SHARE * working_width as f64).ceil() as isize;
        // A point X = ray / rho projects like rho X, on both sides of rho = 0.
        let place = |step: isize| {
            let rho = rho_max * step as f64 / steps as f64;
            rig.right().project(&Point3::from(far + translation_m * rho))
        };
        let infinity_px = place(0)?;
        let mut places_px: Vec<_> = (-steps..0).rev().map_while(place).collect();
        let infinity = places_px.len();
        places_px.reverse();
        places_px.push(infinity_px);
        places_px.extend((1..=steps).map_while(place));
        (places_px.len() > 2).then_some(Self { places_px, infinity })
    }

    /// Unit direction of increasing inverse depth.
    fn along(&self, step: usize) -> Vector2<f64> {
        let [before, after] = [step.saturating_sub(1), (step + 1).min(self.places_px.len() - 1)];
        let direction = self.places_px[after] - self.places_px[before];
        direction.try_normalize(1e-9).unwrap_or(-Vector2::x())
    }

    /// Unit direction perpendicular to the curve, downwards.
    fn across(&self, step: usize) -> Vector2<f64> {
        let along = self.along(step);
        let across = Vector2::new(-along.y, along.x);
        if across.y < 0.0 { -across } else { across }
    }

    /// Disparity and offset of a pixel near a position of the curve.
    fn coordinates(&self, step: usize, pixel: &Vector2<f64>) -> (f64, f64) {
        let from_infinity_px = self.places_px[step] - self.places_px[self.infinity];
        let along_px = if step < self.infinity { -from_infinity_px.norm() } else { from_infinity_px.norm() };
        let beside = pixel - self.places_px[step];
        (along_px + beside.dot(&self.along(step)), beside.dot(&self.across(step)))
    }
}
