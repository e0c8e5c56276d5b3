//! Matching of distinctive patches of the left image along their epipolar curves in the right image.

use image::RgbImage;
use pb3dp_geometry::StereoRig;

use super::images::{Images, OUTSIDE, Plane, SCALE, WINDOW};

/// Largest width after downsampling, pixels; images are reduced by an integer factor.
const WORKING_WIDTH_MAX: f64 = 480.0;
/// Approximate number of cells of the left image; each cell has one patch.
const CELLS: f64 = 220.0;
/// Smallest texture of a patch, grey levels per sample (root of the structure tensor's smaller eigenvalue).
const TEXTURE_MIN: f64 = 2.5;
/// Largest distance from the curve searched, pixels.
const OFFSET_MAX_PX: f64 = 12.0;
/// Smallest correlation of a match.
const CORRELATION_MIN: f32 = 0.85;
/// Largest ratio of `1 - correlation` between a match and its best rival.
const RIVAL_RATIO_MAX: f32 = 0.5;
/// Lower bound of `1 - correlation` of a match, so that a rival must be clearly worse.
const FLAW_MIN: f32 = 0.02;
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
    let matches = corners.iter().filter_map(|&corner| find(&images, rig, corner)).collect();
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

/// Searches for the window at a corner of the left plane in the right image.
fn find(images: &Images, rig: &StereoRig, [x, y]: [usize; 2]) -> Option<Match> {
    let window = images.left.window(x, y)?;
    let curve = images.curve(rig, [x, y])?;
    let reach = images.samples(OFFSET_MAX_PX);
    let scores = images.scores(&window, &curve, reach);
    let (step, side) = distinctive(&scores, (2 * reach + 1) as usize)?;
    let (disparity_px, offset_px) = images.refined([x as isize, y as isize], (&curve, step), side as isize - reach);
    Some(Match { disparity_px, offset_px })
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
