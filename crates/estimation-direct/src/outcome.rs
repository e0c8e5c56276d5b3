//! What a cold start comes to.

use super::disparity_plane::DisparityPlane;
use super::patches::PatchOutcome;
use super::photometric::RefinedPlane;

/// How another surface stands to the best one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rival {
    /// The plane in the rectified pair.
    pub plane: DisparityPlane,
    /// Its score over that of the best.
    pub score_ratio: f64,
    /// Share of the region's pixels that support it and not the best.
    pub own_share: f64,
    /// Of the pixels that support the one of both with fewer, the share that supports both.
    pub overlap: f64,
}

/// The plane that explains the most clear disparities within a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WidestPlane {
    /// The plane in the rectified pair.
    pub plane: DisparityPlane,
    /// Whether the disparities lie spread around the refined plane instead of on it: then the region is no plane.
    pub is_spread: bool,
}

/// What a cold start found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColdStartOutcome {
    /// The best surface of the search level.
    pub first: Surface,
    /// The surface that most of the other pixels lie on, if there is another.
    pub second: Option<Rival>,
    /// The best of the planes that explain the pixels of the first as something else, if there is one.
    pub alias: Option<Rival>,
    /// The best of the other explanations of the same pixels that are near the first on the level of the search, with its score
    /// over that of the first on the finest level.
    pub contender: Option<Rival>,
    /// Share of the region's pixels with a clear disparity.
    pub valid_share: f64,
    /// What the patches said of the plane on the finest level that they looked at.
    pub finest: PatchOutcome,
    /// The plane of the patches.
    pub patch_plane: DisparityPlane,
    /// The refined plane; `None` if it had too few points.
    pub refined: Option<RefinedPlane>,
    /// What the patches said of the refined plane, on the same level.
    pub at_refined: Option<PatchOutcome>,
    /// Where the patches around the refined plane would have it.
    pub plane_at_refined: Option<DisparityPlane>,
    /// Where less than half of the region agrees with the plane: the plane that explains the most disparities within a pixel.
    pub widest: Option<WidestPlane>,
    /// Where the plane explains little: the plane of any depth and tilt that explains the most, with its share of the
    /// region's pixels.
    pub unlimited: Option<(DisparityPlane, f64)>,
    /// Where the plane has not all of the region: the period along the rows of a texture that repeats, if that many pixels
    /// away the disparity is outside the searched range.
    pub repeats_px: Option<f64>,
}

/// What orders surfaces; `clear_share` is the share of the region's pixels with a clear disparity on the plane.
pub(super) fn surface_score(patches: &PatchOutcome, clear_share: f64) -> f64 {
    support_of(patches) * patches.mean_correlation + clear_share
}

/// Share of the region's pixels whose patch has texture and agrees.
pub(super) fn support_of(patches: &PatchOutcome) -> f64 {
    patches.textured_share * patches.support_share
}

/// A candidate with what the patches say of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// The plane in the rectified pair.
    pub plane: DisparityPlane,
    /// Share of the region's clear disparities on it, soft.
    pub share: f64,
    /// What the patches said of it on the search level.
    pub patches: PatchOutcome,
    /// What orders the surfaces: at most 2.
    pub score: f64,
    /// Index of its patches' votes.
    pub(super) mask: usize,
}
