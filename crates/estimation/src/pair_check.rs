//! Consistency check of a stereo pair against its calibration.
//!
//! Image sizes alone cannot reveal swapped images or a calibration of another rig, and a search on such input ends in a
//! confusing status. This check therefore searches for well-textured patches of the left image in the right image, along the
//! epipolar curve that the calibration predicts (distortion included) and in a band around it. The curve continues through
//! infinity to points behind the cameras: no scene is there, but swapped images match there. The check evaluates the inverse
//! depth and not the sign of `u_left - u_right`, which has no meaning if the principal columns differ.
//!
//! Two errors cannot be detected. A wrong focal length or baseline only moves matches along their curves. Swapped images remain
//! undetected if the principal columns differ by more than half of the scene's disparities, because the swapped images then
//! match in front of the cameras as well.
//!
//! Only distinctive matches count, and only those that agree in their distance from the curve. Repeated or missing texture
//! therefore leads to [`PairVerdict::Unknown`] and not to a warning.

mod images;

#[cfg(test)]
mod tests;

use image::{RgbImage, imageops};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::trig;
use pb3dp_geometry::StereoRig;

use self::images::{Images, OUTSIDE, Plane, SCALE, WINDOW};

/// Smallest number of well-textured patches for a verdict.
const PATCHES_MIN: usize = 30;
/// Smallest number of agreeing matches for a verdict.
const AGREEING_MIN: usize = 16;
/// Half width of the band of distances from the curve within which matches agree, pixels.
const AGREEMENT_PX: f64 = 1.5;
/// Smallest share of agreeing matches that is not chance; uniformly distributed matches give 0.12.
const AGREEING_SHARE_MIN: f64 = 0.5;
/// Largest median distance from the curve of a consistent pair, pixels.
const ROW_OFFSET_MAX_PX: f64 = 1.5;
/// A match is behind the cameras from this disparity on, pixels; distant points and small calibration errors stay below.
const BEHIND_MIN_PX: f64 = 2.0;
/// If at least this share of the agreeing matches is behind the cameras, the calibration is wrong: no scene is there.
const BEHIND_SHARE_MAX: f64 = 0.25;
/// Images are unrelated if fewer than this share of the patches has an agreeing match.
const FOUND_SHARE_MIN: f64 = 0.1;
/// Largest roll between the cameras, degrees: patches are compared without rotating them.
const ROLL_MAX_DEG: f64 = 5.0;

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
/// Smallest correlation of a patch whose texture repeats; chance gives less between images of two scenes.
const REPEATED_MIN: f32 = 0.95;
/// Largest ratio of `1 - correlation` between a match and its best rival.
const RIVAL_RATIO_MAX: f32 = 0.5;
/// Lower bound of `1 - correlation` of a match, so that a rival must be clearly worse.
const FLAW_MIN: f32 = 0.02;
/// Positions closer to the match than this belong to the match, samples.
const RIVAL_DISTANCE: usize = 3;

/// Result of the check of a pair against its calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PairVerdict {
    /// The images match the calibration, within what the patches can show.
    Consistent,
    /// The images are consistent once swapped, and contradict their order: patches match behind the cameras, or almost none match.
    Swapped,
    /// Patches match behind the cameras, and swapping the images does not help.
    BehindCameras,
    /// The matches have an offset from their epipolar lines.
    RowsDisagree {
        /// Median offset, pixels of the right image; positive is down.
        offset_px: f64,
    },
    /// Almost no patch is found where the calibration allows: another scene, another time, or other cameras.
    Unrelated,
    /// Too little distinctive texture for a verdict, or a roll of more than 5 degrees between the cameras.
    Unknown,
}

/// Left and right images that are exchanged, or that are both mirrored or turned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "left and right look exchanged: {}, and once exchanged {fitting_exchanged} match in front{}",
    self.evidence(),
    self.alternatives()
)]
pub struct Exchanged {
    /// As in [`PairCheck`].
    pub patches: usize,
    /// As in [`PairCheck`].
    pub agreeing: usize,
    /// As in [`PairCheck`].
    pub behind: usize,
    /// As in [`PairCheck`].
    pub fitting_exchanged: usize,
    /// As in [`PairCheck`].
    pub fits_mirrored: bool,
    /// As in [`PairCheck`].
    pub fits_turned: bool,
}

impl Exchanged {
    fn evidence(&self) -> String {
        let Self { patches, agreeing, behind, .. } = self;
        match is_behind(*behind, *agreeing) {
            true => format!("{behind} of {agreeing} patches match only behind the cameras"),
            false => format!("only {agreeing} of {patches} patches match in this order"),
        }
    }

    fn alternatives(&self) -> String {
        let which = match (self.fits_mirrored, self.fits_turned) {
            (true, true) => "mirrored, or turned by 180 degrees",
            (true, false) => "mirrored",
            (false, true) => "turned by 180 degrees",
            (false, false) => return String::new(),
        };
        format!(
            "; they also fit if both are {which}: check that the driver does not mirror or turn them before you exchange them"
        )
    }
}

/// The verdict and the numbers behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairCheck {
    /// The verdict.
    pub verdict: PairVerdict,
    /// Well-textured patches of the left image that were searched for.
    pub patches: usize,
    /// Number of patches that match at several places: their texture repeats, and they decide nothing.
    pub repeated: usize,
    /// Number of patches with an unambiguous match.
    pub matches: usize,
    /// Number of matches that agree in their distance from the epipolar line, within 1.5 px.
    pub agreeing: usize,
    /// Number of agreeing matches behind the cameras, by more than 2 px of disparity.
    pub behind: usize,
    /// Number of patches that match in front of the cameras once the images are swapped. Consistent images are not tested in
    /// swapped order: 0.
    pub fitting_exchanged: usize,
    /// Whether exchanged images also fit in their order if both are mirrored: their columns in reverse.
    pub fits_mirrored: bool,
    /// Whether exchanged images also fit in their order if both are turned by 180 degrees.
    pub fits_turned: bool,
    /// Median distance of the agreeing matches from their epipolar lines, pixels of the right image; positive is down.
    pub row_offset_px: Option<f64>,
    /// Spread of these distances: 1.4826 times their median absolute deviation, pixels.
    pub row_spread_px: Option<f64>,
}

impl PairCheck {
    /// Share of the agreeing matches in front of the cameras; `None` without matches.
    pub fn share_in_front(&self) -> Option<f64> {
        (self.agreeing > 0).then(|| 1.0 - self.behind as f64 / self.agreeing as f64)
    }

    /// The pair may be used; returns why the calibration may not belong to it, if the match is doubtful.
    ///
    /// # Errors
    /// Left and right are exchanged: all estimates from them would be wrong.
    pub fn accepted(&self) -> Result<Option<String>, Exchanged> {
        let Self { patches, agreeing, behind, fitting_exchanged, fits_mirrored, fits_turned, .. } = *self;
        match self.verdict {
            PairVerdict::Swapped => {
                Err(Exchanged { patches, agreeing, behind, fitting_exchanged, fits_mirrored, fits_turned })
            }
            _ => Ok(self.doubt()),
        }
    }

    /// Why the calibration may not belong to the images.
    fn doubt(&self) -> Option<String> {
        let Self { patches, matches, agreeing, behind, .. } = self;
        Some(match self.verdict {
            PairVerdict::Consistent | PairVerdict::Unknown | PairVerdict::Swapped => return None,
            PairVerdict::BehindCameras => format!(
                "{behind} of {agreeing} patches match only behind the cameras, and swapping the images would not help: the \
                 calibration does not belong to them; give the right file or calibrate again"
            ),
            PairVerdict::RowsDisagree { offset_px } => format!(
                "{agreeing} of {matches} matching patches lie {:.1} px {} the row or line that the calibration predicts (spread \
                 {:.1} px): the cameras may have moved since they were calibrated, or the file may belong to other cameras; calibrate again, or give the \
                 right file",
                offset_px.abs(),
                if offset_px > 0.0 { "below" } else { "above" },
                self.row_spread_px.unwrap_or_default()
            ),
            PairVerdict::Unrelated => format!(
                "only {agreeing} of {patches} textured patches of the left image are found in the right one where the \
                 calibration predicts them: the images do not show the same scene at the same moment, or the calibration does \
                 not belong to them; check the files, or calibrate again"
            ),
        })
    }

    fn unknown() -> Self {
        Self {
            verdict: PairVerdict::Unknown,
            patches: 0,
            repeated: 0,
            matches: 0,
            agreeing: 0,
            behind: 0,
            fitting_exchanged: 0,
            fits_mirrored: false,
            fits_turned: false,
            row_offset_px: None,
            row_spread_px: None,
        }
    }
}

/// Checks a stereo pair against its calibration.
///
/// Images with a size other than the rig's give [`PairVerdict::Unknown`]: reject them before.
pub fn check_pair<'a>(rig: &StereoRig, left: impl Into<ImageView<'a>>, right: impl Into<ImageView<'a>>) -> PairCheck {
    check_views(rig, left.into(), right.into())
}

fn check_views(rig: &StereoRig, left: ImageView<'_>, right: ImageView<'_>) -> PairCheck {
    let fits = |camera: &pb3dp_geometry::Camera, image: ImageView<'_>| {
        (camera.size().width, camera.size().height) == image.dimensions()
    };
    if !fits(rig.left(), left) || !fits(rig.right(), right) || roll_deg(rig).abs() > ROLL_MAX_DEG {
        return PairCheck::unknown();
    }
    let check = in_order(rig, left, right);
    if check.verdict == PairVerdict::Consistent || left.dimensions() != right.dimensions() {
        return check;
    }
    let exchanged = in_order(rig, right, left);
    let fitting_exchanged = exchanged.agreeing - exchanged.behind;
    if exchanged.verdict != PairVerdict::Consistent || !check.contradicts_the_order() {
        return PairCheck { fitting_exchanged, ..check };
    }
    // Mirrored and turned images also have their disparities in reverse.
    let fits = |turned: fn(ImageView<'_>) -> RgbImage| {
        let [left, right] = [turned(left), turned(right)];
        in_order(rig, (&left).into(), (&right).into()).verdict == PairVerdict::Consistent
    };
    let (fits_mirrored, fits_turned) = (fits(mirrored), fits(|image| imageops::rotate180(&copied(image))));
    PairCheck { verdict: PairVerdict::Swapped, fitting_exchanged, fits_mirrored, fits_turned, ..check }
}

fn in_order(rig: &StereoRig, left: ImageView<'_>, right: ImageView<'_>) -> PairCheck {
    matches_of(rig, left, right).map_or_else(PairCheck::unknown, |found| judge(&found))
}

fn copied(image: ImageView<'_>) -> RgbImage {
    let mut copy = RgbImage::new(image.width(), image.height());
    let row = 3 * image.width() as usize;
    for (y, out) in copy.chunks_exact_mut(row.max(1)).enumerate() {
        image.copy_row(0, y, out);
    }
    copy
}

fn mirrored(image: ImageView<'_>) -> RgbImage {
    imageops::flip_horizontal(&copied(image))
}

/// Roll angle between the cameras: rotation of the left camera's vertical axis in the right image.
fn roll_deg(rig: &StereoRig) -> f64 {
    let down = rig.cam_right_from_cam_left().transform_vector(&nalgebra::Vector3::y());
    trig::atan2(-down.x, down.y).to_degrees()
}

/// The verdict for a set of matches.
fn judge(Search { patches, repeated, matches }: &Search) -> PairCheck {
    let agreeing = agreeing(matches);
    let row_offset_px = median(agreeing.iter().map(|found| found.offset_px));
    let row_spread_px =
        row_offset_px.and_then(|centre| median(agreeing.iter().map(|found| 1.4826 * (found.offset_px - centre).abs())));
    let mut check = PairCheck {
        patches: *patches,
        repeated: *repeated,
        matches: matches.len(),
        agreeing: agreeing.len(),
        behind: agreeing.iter().filter(|found| found.disparity_px < -BEHIND_MIN_PX).count(),
        row_offset_px,
        row_spread_px,
        ..PairCheck::unknown()
    };
    check.verdict = check.judged();
    check
}

impl PairCheck {
    /// The verdict that follows from the numbers, without the swapped images.
    fn judged(&self) -> PairVerdict {
        let (agreeing, deciding) = (self.agreeing as f64, self.patches - self.repeated);
        match self.row_offset_px {
            _ if deciding < PATCHES_MIN => PairVerdict::Unknown,
            Some(offset_px) if is_peak(self.agreeing, self.matches) => match offset_px {
                _ if offset_px.abs() > ROW_OFFSET_MAX_PX => PairVerdict::RowsDisagree { offset_px },
                _ if is_behind(self.behind, self.agreeing) => PairVerdict::BehindCameras,
                _ => PairVerdict::Consistent,
            },
            _ if agreeing < FOUND_SHARE_MIN * deciding as f64 => PairVerdict::Unrelated,
            _ => PairVerdict::Unknown,
        }
    }

    /// Whether the images cannot be in the right order. Rows that disagree do not show this: a wrong calibration has them as well.
    fn contradicts_the_order(&self) -> bool {
        self.verdict == PairVerdict::Unrelated || is_behind(self.behind, self.agreeing)
    }
}

/// Whether so many of the agreeing matches are behind the cameras that these cannot have taken the images.
fn is_behind(behind: usize, agreeing: usize) -> bool {
    behind > 0 && behind as f64 >= BEHIND_SHARE_MAX * agreeing as f64
}

/// Whether more matches agree than by chance.
fn is_peak(count: usize, matches: usize) -> bool {
    count >= AGREEING_MIN && count as f64 >= AGREEING_SHARE_MIN * matches as f64
}

/// The matches in the most populated band of distances from the curve.
fn agreeing(matches: &[Match]) -> Vec<Match> {
    let mut sorted = matches.to_vec();
    sorted.sort_by(|a, b| a.offset_px.total_cmp(&b.offset_px));
    let (mut best, mut end) = (0..0, 0);
    for start in 0..sorted.len() {
        while end < sorted.len() && sorted[end].offset_px - sorted[start].offset_px <= 2.0 * AGREEMENT_PX {
            end += 1;
        }
        if end - start > best.len() {
            best = start..end;
        }
    }
    sorted[best].to_vec()
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// A patch that was found in the right image.
enum Found {
    /// At one place.
    Once(Match),
    /// At several places.
    Repeated,
}

/// A patch with an unambiguous match in the right image.
#[derive(Clone, Copy, Debug)]
struct Match {
    /// Disparity along the curve, pixels of the right image: 0 at infinity, negative behind the cameras.
    disparity_px: f64,
    /// Distance from the curve, pixels of the right image; positive is down.
    offset_px: f64,
}

/// Result of the matching.
struct Search {
    /// Number of patches searched for.
    patches: usize,
    /// Number of these that match at several places.
    repeated: usize,
    /// The matches found.
    matches: Vec<Match>,
}

/// Matches patches of the left image in the right image; `None` if the images are smaller than a few patches.
fn matches_of(rig: &StereoRig, left: ImageView<'_>, right: ImageView<'_>) -> Option<Search> {
    let factor = (f64::from(left.width()) / WORKING_WIDTH_MAX).ceil().max(1.0) as usize;
    let images = Images::new(left, right, factor);
    if [&images.left, &images.right].iter().any(|plane| plane.width.min(plane.height) < 4 * WINDOW) {
        return None;
    }
    let corners = textured_corners(&images.left);
    let mut search = Search { patches: corners.len(), repeated: 0, matches: Vec::new() };
    for corner in corners {
        match find(&images, rig, corner) {
            Some(Found::Once(found)) => search.matches.push(found),
            Some(Found::Repeated) => search.repeated += 1,
            None => {}
        }
    }
    Some(search)
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
fn find(images: &Images, rig: &StereoRig, [x, y]: [usize; 2]) -> Option<Found> {
    let window = images.left.window(x, y)?;
    let curve = images.curve(rig, [x, y])?;
    let reach = images.samples(OFFSET_MAX_PX);
    let scores = images.scores(&window, &curve, reach);
    let Best { step, side, is_distinctive } = best(&scores, (2 * reach + 1) as usize)?;
    if !is_distinctive {
        return Some(Found::Repeated);
    }
    let (disparity_px, offset_px) = images.refined([x as isize, y as isize], (&curve, step), side as isize - reach);
    Some(Found::Once(Match { disparity_px, offset_px }))
}

/// The best score of a patch.
struct Best {
    /// Its position along the curve.
    step: usize,
    /// Its side of the curve.
    side: usize,
    /// It has no rival elsewhere.
    is_distinctive: bool,
}

/// The best score, if it is high enough: without a rival elsewhere and not at the edge of the band, or of a texture that repeats.
fn best(scores: &[f32], sides: usize) -> Option<Best> {
    let (index, &best) = scores.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    let (step, side) = (index / sides, index % sides);
    if best < CORRELATION_MIN {
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
    let is_distinctive = (1.0 - best).max(FLAW_MIN) <= RIVAL_RATIO_MAX * (1.0 - rival);
    // At the edge of the band the true place may lie beyond it.
    let is_at_edge = side == 0 || side + 1 == sides;
    let counts = if is_distinctive { !is_at_edge } else { best >= REPEATED_MIN };
    counts.then_some(Best { step, side, is_distinctive })
}
