//! The final plane of a cold start, with its covariance: what the refinement, the patches and the search each say of the surface.

use nalgebra::{Matrix3, Vector3};
use pb3dp_estimation_views::disparity_plane::DisparityPlane;

use super::patches::PatchOutcome;
use crate::outcome::{ColdStartOutcome, support_of};
use crate::surface_choice::SurfaceChoice;

/// If two planes have independent errors of equal size, each has half of the variance of their difference (the sum of both
/// variances).
pub(super) const EQUAL_ERRORS: f64 = 0.5;

/// Growth of the variance of the refined plane with the share of the region that does not support it: pixels near the edge of another
/// surface are biased alike, which blocks of pixels do not show. Chosen with figures: the NEES of rendered rectangles 30 and 100 mm in front
/// of a background is 1.5 and 1.3, without it 2.0 and 1.7; of 147 real cases that are `ok` none loses it, with a value of 2 one does.
const EDGES: f64 = 1.25;

/// Shares of a relief that count as error of the disparity in the middle and at the border of the region. Chosen with figures: patches do not
/// reach the rim of a shell, and the NEES of rendered shells of 5 and 10 mm is 0.6 and 0.7, without them and without the plane of least squares 73 and 32.
const RELIEF_OFFSET: f64 = 0.45;
const RELIEF_SLOPE: f64 = 0.15;

/// The final plane of an outcome with the covariance of `(d0, du, dv)`: a weighted mean of the refined plane and the patch
/// plane, if the refinement converged near the patch plane. On real surfaces both have independent errors of equal size, so
/// their mean is better than either. Patches cannot distinguish planes closer than their own precision, so the weight of the
/// patch plane decreases with the distance between the planes. If the patch plane is farther away, and the patches agree with
/// the refined plane clearly less than with their own, the result is half-way between the two. If no plane fits, the result is
/// the plane that explains the most disparities.
///
/// Two planes of the same pixels that differ by `gap` and have independent errors of equal size each have half of `gap gap^T`
/// as variance, and their mean has a quarter. If the images have no errors except noise (`is_exact`), the refined plane is
/// known to have the smaller variance; it is the result if the patches agree with it.
///
/// If part of the region does not agree with the plane, another surface may pull at it. The plane through the clear disparities is
/// an estimate of other errors, so half of its squared difference counts as variance too, and the variance of the refined plane is
/// increased by the share that does not agree.
///
/// If the region is one curved surface, the result is its plane of least squares; if that is uncertain, the distance to this plane counts
/// as error. A relief too small for the search is seen by the patches; the plane that they share is not that of least squares, so a part
/// of the relief counts as error.
pub(super) fn final_plane(
    outcome: &ColdStartOutcome,
    side_px: f64,
    is_exact: bool,
    choice: &SurfaceChoice,
) -> (DisparityPlane, Option<Matrix3<f64>>) {
    let Some(refined) = &outcome.refined else {
        return (outcome.widest.map_or(outcome.patch_plane, |widest| widest.plane), None);
    };
    let own = refined.plane.parameters();
    let from_own = |plane: &DisparityPlane| plane.centred_at(refined.plane.centre_px).parameters() - own;
    let errors = |offset_px: f64, slope_px: f64| {
        let slope = slope_px / (0.5 * side_px);
        Matrix3::from_diagonal(&Vector3::new(offset_px, slope, slope).map(|sigma| sigma * sigma))
    };
    let mut curved = errors(RELIEF_OFFSET * outcome.relief_px, RELIEF_SLOPE * outcome.relief_px);
    if let Some(continued) = outcome.continued {
        let moved = from_own(&continued.plane);
        if continued.is_certain {
            let covariance = refined.covariance + errors(continued.sigma_px, continued.sigma_px);
            return (refined.plane.with_parameters(&(own + moved)), Some(covariance));
        }
        curved += moved * moved.transpose();
    }
    if let Some(widest) = outcome.widest {
        let moved = from_own(&widest.plane);
        let covariance = refined.covariance + moved * moved.transpose() + curved;
        return (refined.plane.with_parameters(&(own + moved)), Some(covariance));
    }
    let theirs = match outcome.plane_at_refined {
        Some(plane) if refined.converged => plane,
        _ => outcome.patch_plane,
    };
    let gap = from_own(&theirs);
    let agreement = |patches: &PatchOutcome| patches.support_share * patches.mean_correlation;
    let lost = outcome.at_refined.map_or(0.0, |found| agreement(&outcome.finest) - agreement(&found));
    let apart_px = gap.x.abs() + 0.5 * side_px * (gap.y.abs() + gap.z.abs());
    let rows_off = refined.row_offset_px.abs() > choice.patch_rows_px;
    let (moved_by, counted) = if refined.converged {
        let is_better = lost > choice.agreement_tolerance && !rows_off;
        let is_clear = outcome.finest.mean_correlation >= choice.clear_correlation_min && !rows_off && !is_exact;
        let moved_by = towards_patches(apart_px, is_better, is_clear, choice);
        (moved_by, if rows_off || is_exact { moved_by * moved_by } else { variance_between(moved_by) })
    } else {
        (1.0, 1.0)
    };
    let beside = outcome.nearby.map_or(Matrix3::zeros(), |plane| {
        let gap = from_own(&plane);
        gap * gap.transpose() * EQUAL_ERRORS
    });
    let edges = 1.0 + EDGES * (1.0 - support_of(&outcome.finest)).max(0.0);
    let covariance = refined.covariance * edges + gap * gap.transpose() * counted + beside + curved;
    (refined.plane.with_parameters(&(own + gap * moved_by)), Some(covariance))
}

/// Weight of the patch plane if the planes are `apart_px` apart at the region's border. `is_better`: the patches agree clearly
/// better with their own plane. `is_clear`: noise moves the patches little.
fn towards_patches(apart_px: f64, is_better: bool, is_clear: bool, choice: &SurfaceChoice) -> f64 {
    match is_better && apart_px > choice.patch_precision_px {
        true => 0.5,
        false if is_clear => 0.5 * apart_px.powi(2) / (apart_px.powi(2) + choice.patch_sigma_px.powi(2)),
        false => 0.0,
    }
}

/// Variance of the weighted mean of two estimates with independent errors of equal size, divided by their squared difference.
fn variance_between(share: f64) -> f64 {
    EQUAL_ERRORS * ((1.0 - share).powi(2) + share.powi(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// If two estimates have independent errors of equal size, their mean has half the variance of each.
    #[test]
    fn the_answer_goes_at_most_half_way_to_the_patches() {
        assert_eq!((variance_between(0.0), variance_between(0.5)), (0.5, 0.25));
        let shares = [0.0, 0.02, 0.1, 0.3, 2.0]
            .map(|apart_px| towards_patches(apart_px, false, true, &SurfaceChoice::default()));
        assert!(
            shares[0] == 0.0 && shares[1] < 0.01 && (shares[2] - 0.1).abs() < 1e-12 && shares[4] < 0.5,
            "{shares:?}"
        );
        assert!(shares.windows(2).all(|pair| pair[0] < pair[1]), "{shares:?}");
        assert_eq!(
            [(0.2, true), (0.3, true), (0.3, false)].map(|(px, b)| towards_patches(
                px,
                b,
                false,
                &SurfaceChoice::default()
            )),
            [0.0, 0.5, 0.0]
        );
    }
}
