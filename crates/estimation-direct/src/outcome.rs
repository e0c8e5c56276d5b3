//! Outcome of a cold start.

use pb3dp_estimation_views::disparity_plane::DisparityPlane;

use super::patches::PatchOutcome;
use super::photometric::RefinedPlane;
use super::search::PixelShares;

/// Another surface, compared with the best one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rival {
    /// The plane in the rectified pair.
    pub plane: DisparityPlane,
    /// Its score divided by the score of the best surface.
    pub score_ratio: f64,
    /// Share of the region's pixels on this surface; of an alias, that of the pixels that support it and not the best surface.
    pub own_share: f64,
    /// Pixels that support both surfaces, as a share of those that support the smaller one.
    pub overlap: f64,
}

/// The plane that explains the most clear disparities within one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WidestPlane {
    /// The plane in the rectified pair.
    pub plane: DisparityPlane,
    /// Whether the disparities scatter around the refined plane instead of lying on it: the region is then not planar.
    pub is_spread: bool,
}

/// The plane of least squares through a curved surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContinuedPlane {
    /// The plane in the rectified pair.
    pub plane: DisparityPlane,
    /// Standard deviation of its disparity in the middle of the region, and of its change over half of the region, pixels.
    pub sigma_px: f64,
    /// Whether the region certainly shows one surface.
    pub is_certain: bool,
}

/// The plane of any depth and tilt that explains the most clear disparities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnlimitedPlane {
    /// The plane in the rectified pair.
    pub plane: DisparityPlane,
    /// Share of the region's pixels that it explains.
    pub share: f64,
}

/// Outcome of a cold start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColdStartOutcome {
    /// The best surface of the search level.
    pub first: Surface,
    /// The surface that contains most of the other pixels, if there is one.
    pub second: Option<Rival>,
    /// The best alternative plane for the pixels of the first surface, if there is one.
    pub alias: Option<Rival>,
    /// The best alternative explanation of the same pixels that is close to the first surface on the search level. Its score is
    /// relative to that of the first surface on the finest level.
    pub contender: Option<Rival>,
    /// Share of the region's pixels with a clear disparity.
    pub valid_share: f64,
    /// What single pixels say of the refined plane.
    pub pixels: PixelShares,
    /// Patch result for the plane on the finest evaluated level.
    pub finest: PatchOutcome,
    /// The plane estimated by the patches.
    pub patch_plane: DisparityPlane,
    /// The refined plane; `None` if there were too few points.
    pub refined: Option<RefinedPlane>,
    /// Patch result for the refined plane, on the same level.
    pub at_refined: Option<PatchOutcome>,
    /// The plane estimated by the patches when evaluated at the refined plane.
    pub plane_at_refined: Option<DisparityPlane>,
    /// The plane of least squares through the clear disparities near the refined plane, if part of the region does not agree with
    /// that plane.
    pub nearby: Option<DisparityPlane>,
    /// The plane that explains the most disparities within one pixel, if less than half of the region agrees with the refined
    /// plane.
    pub widest: Option<WidestPlane>,
    /// The plane of least squares through the surface that continues the refined plane, if that surface is curved.
    pub continued: Option<ContinuedPlane>,
    /// Root mean square of the relief that neighbouring patches share, pixels; 0 if they show none.
    pub relief_px: f64,
    /// The plane of any depth and tilt that explains the most; set if the plane explains little.
    pub unlimited: Option<UnlimitedPlane>,
    /// The period along the rows of a repeating texture, if a disparity shifted by it is outside the searched range; set if the
    /// plane does not cover the whole region.
    pub repeats_px: Option<f64>,
}

/// Score by which surfaces are sorted; `clear_share` is the share of the region's pixels with a clear disparity on the plane.
pub(super) fn surface_score(patches: &PatchOutcome, clear_share: f64) -> f64 {
    support_of(patches) * patches.mean_correlation + clear_share
}

/// Share of the region's pixels whose patch has texture and agrees.
pub(super) fn support_of(patches: &PatchOutcome) -> f64 {
    patches.textured_share * patches.support_share
}

impl ColdStartOutcome {
    /// Share of the region's pixels on the best surface.
    pub(super) fn first_share(&self) -> f64 {
        self.first.area_share.unwrap_or(support_of(&self.first.patches))
    }
}

/// A candidate plane with its patch result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// The plane in the rectified pair.
    pub plane: DisparityPlane,
    /// Soft share of the region's clear disparities on the plane.
    pub share: f64,
    /// Patch result on the search level.
    pub patches: PatchOutcome,
    /// Score by which surfaces are sorted, at most 2.
    pub score: f64,
    /// Share of the region's pixels whose disparity is on the plane, those in the middle count more; only for the best surface and others
    /// that are no alias of it, if there are any.
    pub area_share: Option<f64>,
    /// Index of the support mask of its patches.
    pub(super) mask: usize,
}
