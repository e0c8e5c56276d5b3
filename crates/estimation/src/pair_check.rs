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
mod matching;

#[cfg(test)]
mod tests;

use image::RgbImage;
use pb3dp_estimation_core::trig;
use pb3dp_geometry::StereoRig;

use self::matching::{Match, matches_of};

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

/// Result of the check of a pair against its calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PairVerdict {
    /// The images match the calibration, within what the patches can show.
    Consistent,
    /// The images do not match, usually because matches are behind the cameras, but are consistent once swapped.
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

/// The verdict and the numbers behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairCheck {
    /// The verdict.
    pub verdict: PairVerdict,
    /// Well-textured patches of the left image that were searched for.
    pub patches: usize,
    /// Number of patches with an unambiguous match.
    pub matches: usize,
    /// Number of matches that agree in their distance from the epipolar line, within 1.5 px.
    pub agreeing: usize,
    /// Number of agreeing matches behind the cameras, by more than 2 px of disparity.
    pub behind: usize,
    /// Number of patches that match in front of the cameras once the images are swapped. Consistent images are not tested in
    /// swapped order: 0.
    pub fitting_exchanged: usize,
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

    fn unknown() -> Self {
        Self {
            verdict: PairVerdict::Unknown,
            patches: 0,
            matches: 0,
            agreeing: 0,
            behind: 0,
            fitting_exchanged: 0,
            row_offset_px: None,
            row_spread_px: None,
        }
    }
}

/// Checks a stereo pair against its calibration.
///
/// Images with a size other than the rig's give [`PairVerdict::Unknown`]: reject them before.
pub fn check_pair(rig: &StereoRig, left: &RgbImage, right: &RgbImage) -> PairCheck {
    let fits = |camera: &pb3dp_geometry::Camera, image: &RgbImage| {
        (camera.size().width, camera.size().height) == image.dimensions()
    };
    if !fits(rig.left(), left) || !fits(rig.right(), right) || roll_deg(rig).abs() > ROLL_MAX_DEG {
        return PairCheck::unknown();
    }
    let in_this_order = |left, right| {
        matches_of(rig, left, right).map_or_else(PairCheck::unknown, |found| judge(found.patches, &found.matches))
    };
    let check = in_this_order(left, right);
    if check.verdict == PairVerdict::Consistent || left.dimensions() != right.dimensions() {
        return check;
    }
    let exchanged = in_this_order(right, left);
    let fitting_exchanged = exchanged.agreeing - exchanged.behind;
    let verdict = if exchanged.verdict == PairVerdict::Consistent { PairVerdict::Swapped } else { check.verdict };
    PairCheck { verdict, fitting_exchanged, ..check }
}

/// Roll angle between the cameras: rotation of the left camera's vertical axis in the right image.
fn roll_deg(rig: &StereoRig) -> f64 {
    let down = rig.cam_right_from_cam_left().transform_vector(&nalgebra::Vector3::y());
    trig::atan2(-down.x, down.y).to_degrees()
}

/// The verdict for a set of matches.
fn judge(patches: usize, matches: &[Match]) -> PairCheck {
    let agreeing = agreeing(matches);
    let row_offset_px = median(agreeing.iter().map(|found| found.offset_px));
    let row_spread_px =
        row_offset_px.and_then(|centre| median(agreeing.iter().map(|found| 1.4826 * (found.offset_px - centre).abs())));
    let mut check = PairCheck {
        patches,
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
        let agreeing = self.agreeing as f64;
        match self.row_offset_px {
            _ if self.patches < PATCHES_MIN => PairVerdict::Unknown,
            Some(offset_px) if is_peak(self.agreeing, self.matches) => match offset_px {
                _ if offset_px.abs() > ROW_OFFSET_MAX_PX => PairVerdict::RowsDisagree { offset_px },
                _ if self.behind as f64 >= BEHIND_SHARE_MAX * agreeing => PairVerdict::BehindCameras,
                _ => PairVerdict::Consistent,
            },
            _ if agreeing < FOUND_SHARE_MIN * self.patches as f64 => PairVerdict::Unrelated,
            _ => PairVerdict::Unknown,
        }
    }
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
