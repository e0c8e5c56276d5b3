//! Status of an estimate of the direct method, and its reason.

use pb3dp_estimation_core::Argument;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::status::{Status, Verdict};
use pb3dp_estimation_views::disparity_plane::DisparityPlane;
use pb3dp_geometry::ranges;

use crate::outcome::{ColdStartOutcome, Rival, support_of};
use crate::surface_choice::SurfaceChoice;

/// Limits between the statuses. Chosen by hand on real pairs, some of which are held out (ADR 7).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectVerdictConfig {
    /// Smallest share (0 to 1) of the region's pixels whose patch has texture and agrees with the plane, or whose own disparity
    /// does; below: `not-observable`. Default 0.15.
    pub support_min: f64,
    /// Below this share the estimate is at best `ambiguous`, and without texture `not-observable`. 0 to 1. Default 0.3.
    pub support_sure_min: f64,
    /// An alternative explanation of the same pixels, inside or outside the range, with at least this share of the best score
    /// makes the estimate `ambiguous`, on the search level or on the finest level. 0 to 1. Default 0.85.
    pub alias_score_max: f64,
    /// A second surface with at least this share (0 to 1) of the first surface's area makes the estimate `ambiguous`; pixels in the
    /// middle count more. Default 0.7. Chosen with figures, before surfaces that continue were left out: of 425 windows across depth edges
    /// 277 are `ok`, 8 of them wrong; with 0.65 274 and 8, with 0.75 283 and 9.
    pub second_share_max: f64,
    /// Largest standard deviation of the normal, degrees; above: `weak-tilt`. 0 to 90. Default 5.
    pub normal_sigma_max_deg: f64,
}

impl Default for DirectVerdictConfig {
    fn default() -> Self {
        Self {
            support_min: 0.15,
            support_sure_min: 0.3,
            alias_score_max: 0.85,
            second_share_max: 0.7,
            normal_sigma_max_deg: 5.0,
        }
    }
}

impl DirectVerdictConfig {
    ranges! {
        pub fn validate "direct.status.";
        support_min, SUPPORT_MIN: f64 = 0.0..=1.0;
        support_sure_min, SUPPORT_SURE_MIN: f64 = 0.0..=1.0;
        alias_score_max, ALIAS_SCORE_MAX: f64 = 0.0..=1.0;
        second_share_max, SECOND_SHARE_MAX: f64 = 0.0..=1.0;
        normal_sigma_max_deg, NORMAL_SIGMA_MAX_DEG: f64 = 0.0..=90.0;
    }
}

/// A plane with a larger tilt than allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Steeper {
    /// The larger of its two tilts, degrees.
    pub tilt_deg: f64,
    /// Share of the region's pixels that lie on it.
    pub share: f64,
}

/// The searched range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Searched {
    /// Depths and tilts.
    pub range: SearchRange,
    /// A plane within the depths that explains more, but exceeds the tilt limit.
    pub steeper: Option<Steeper>,
}

/// Reason if the search found no candidate.
pub(super) fn nothing_found(range: &SearchRange) -> String {
    format!(
        "the region is not visible in the right image at {:.0} to {:.0} mm: check the depth range ({}), the region and the calibration",
        1e3 * range.z_min_m,
        1e3 * range.z_max_m,
        Argument::DepthRange
    )
}

/// Reason if a plane outside the depth range, at `z_m` if it is in front of the camera, explains the region as well as the
/// estimate or better.
pub(super) fn lies_beyond(z_m: Option<f64>, score_ratio: f64) -> String {
    let place = z_m.map_or("far away".to_owned(), |z_m| format!("at about {:.0} mm", 1e3 * z_m));
    format!(
        "a plane {place}, outside the depth range, explains the region with {:.0} % of the score: the target may be there; widen the range ({})",
        100.0 * score_ratio,
        Argument::DepthRange
    )
}

/// Reason if the right image shows the same as the region at other depths, which may be outside the depth range: that of the answer first, `None`
/// for one behind the camera.
pub(super) fn same_elsewhere(depths_m: &[Option<f64>], score_ratio: f64) -> String {
    let words = |z_m: &Option<f64>| z_m.map_or("far away".to_owned(), |z_m| format!("{:.0} mm", 1e3 * z_m));
    format!(
        "the region looks the same at {} ({:.0} % of the score): identical parts or a pattern that repeats; mark something that is unique as well",
        depths_m.iter().map(words).collect::<Vec<_>>().join(" and "),
        100.0 * score_ratio
    )
}

/// Reason if the region may be nearer than `z_m`, where the right image does not show it.
pub(super) fn may_be_unseen(z_m: f64, correlation: f64, limit: f64) -> String {
    format!(
        "nearer than {:.0} mm the middle of the region is outside the right image, and the matching patches correlate by only {correlation:.2} (limit {limit}): mark an area that both cameras see, or narrow the range ({})",
        1e3 * z_m,
        Argument::DepthRange
    )
}

/// Reason if both images are identical.
pub(super) const SAME_IMAGE: &str =
    "left and right are the same image and give no depth: check the file names or the cameras";

/// Reason if the region shows little else than borders of blocks.
pub(super) const ONLY_BLOCKS: &str = "the region shows hardly more than the blocks of the image's compression, which stay in place whatever the \
     target does: compress less, or mark a part with more contrast";

/// Advice if an alias of the target may have been found.
fn may_be_outside() -> String {
    format!("the target may be outside the depth range; widen it ({})", Argument::DepthRange)
}

/// Cause of a low support, and remedy.
fn cause(outcome: &ColdStartOutcome, searched: &Searched, limits: &DirectVerdictConfig) -> String {
    let range = &searched.range;
    // With less support it would not be a valid result either.
    let steeper = searched.steeper.filter(|steeper| steeper.share >= limits.support_min);
    if let Some(Steeper { tilt_deg, share }) = steeper {
        return format!(
            "a plane tilted by {tilt_deg:.0} degrees explains {:.0} %, but the tilt limit is {:.0} degrees: raise it ({})",
            100.0 * share,
            range.tilt_max_rad.to_degrees(),
            Argument::TiltLimit
        );
    }
    if let Some(period_px) = outcome.repeats_px {
        return format!("the texture repeats every {period_px:.0} px: {}", may_be_outside());
    }
    if outcome.unlimited.is_none_or(|found| found.share < ANY_SHARE_MIN) {
        return format!(
            "no match in the right image at {:.0} to {:.0} mm: check the depth range ({}) and the calibration, and check the images for noise and blur",
            1e3 * range.z_min_m,
            1e3 * range.z_max_m,
            Argument::DepthRange
        );
    }
    format!(
        "the region is not flat, contains several surfaces, or lies outside the depth range: mark a flat part, or widen the range ({})",
        Argument::DepthRange
    )
}

/// If no plane explains this share of the region, the cause is the range, the calibration or the images. Chosen by hand,
/// not varied: only the stated reason depends on it.
const ANY_SHARE_MIN: f64 = 0.1;

/// Planes whose disparities differ by less at the region's centre are at the same distance for a reader. Chosen by hand, not varied: only
/// the stated reason depends on it.
const SAME_PLACE_PX: f64 = 0.5;

/// Verdict if too little of the region has texture or agrees with the plane.
fn too_little(
    outcome: &ColdStartOutcome,
    searched: &Searched,
    limits: &DirectVerdictConfig,
    choice: &SurfaceChoice,
) -> Option<Verdict> {
    let (textured, support) = (outcome.finest.textured_share, support_of(&outcome.finest));
    let sure_min = limits.support_sure_min;
    if is_supported(outcome, limits, choice) {
        return None;
    }
    if textured < sure_min {
        let (textured, limit) = (100.0 * textured, 100.0 * sure_min);
        let evidence = format!("only {textured:.0} % of the region has texture (limit {limit:.0} %)");
        let reason = format!("{evidence}: choose a textured target or add light");
        return Some(Verdict { status: Status::NotObservable, reason });
    }
    // Patches that mix several surfaces support none of them; single disparities do.
    let on_plane = support.max(outcome.valid_share * outcome.first.share);
    let (status, limit) = match on_plane < limits.support_min {
        true => (Status::NotObservable, 100.0 * limits.support_min),
        false => (Status::Ambiguous, 100.0 * sure_min),
    };
    let evidence = match support < sure_min || status == Status::NotObservable {
        true => format!("only {:.0} % of the region agrees with one plane (limit {limit:.0} %)", 100.0 * support),
        false => format!(
            "{:.0} % of the region agrees with one plane, but only {:.0} % of what shows a depth (limit {:.0} %)",
            100.0 * support,
            100.0 * agreement(outcome),
            100.0 * choice.agreement_min
        ),
    };
    Some(Verdict { status, reason: format!("{evidence}; {}", cause(outcome, searched, limits)) })
}

/// Share of what says anything of the plane that agrees with it; see [`SurfaceChoice::agreement_min`].
fn agreement(outcome: &ColdStartOutcome) -> f64 {
    let agreeing = support_of(&outcome.finest) + outcome.pixels.on_plane;
    agreeing / (agreeing + outcome.pixels.elsewhere).max(f64::MIN_POSITIVE)
}

/// Whether enough of the region agrees with the plane, or less of it and enough of what says anything.
fn is_supported(outcome: &ColdStartOutcome, limits: &DirectVerdictConfig, choice: &SurfaceChoice) -> bool {
    let support = support_of(&outcome.finest);
    support >= choice.sure_area_min || support >= limits.support_sure_min && agreement(outcome) >= choice.agreement_min
}

/// Whether the region has texture but too little of it agrees with one plane for a confident estimate, or its disparities
/// scatter around every plane.
pub(super) fn is_no_plane(outcome: &ColdStartOutcome, limits: &DirectVerdictConfig, choice: &SurfaceChoice) -> bool {
    let has_texture = outcome.finest.textured_share >= limits.support_sure_min;
    lies_spread(outcome) || has_texture && !is_supported(outcome, limits, choice)
}

fn lies_spread(outcome: &ColdStartOutcome) -> bool {
    outcome.widest.is_some_and(|widest| widest.is_spread)
}

/// Reason if the disparities lie on no plane.
fn spread(outcome: &ColdStartOutcome, agreeing: f64) -> String {
    let evidence = match outcome.continued.is_some_and(|continued| continued.is_certain) {
        true => "the surface is curved; its plane of least squares is reported",
        false => "the disparities scatter around every plane; the plane with the most support is reported",
    };
    format!("{evidence} ({agreeing:.0} % of the region agrees): mark a flat part")
}

/// Where a rival of a plane lies: of a plane through the same place the distance says nothing.
fn other_plane(rival: &DisparityPlane, plane: &DisparityPlane) -> String {
    let gap_px = rival.d0_px - plane.d0_px;
    match gap_px.abs() < SAME_PLACE_PX {
        true => "a plane at the same distance with another tilt".to_owned(),
        false => format!("a plane {gap_px:+.1} px of disparity away"),
    }
}

/// A second surface that covers about as much of the region as the first.
pub(super) fn similar_second(outcome: &ColdStartOutcome, limits: &DirectVerdictConfig) -> Option<Rival> {
    outcome.second.filter(|second| second.own_share > limits.second_share_max * outcome.first_share())
}

/// Reason if another plane is nearly as good on the finest level.
fn contested(outcome: &ColdStartOutcome, limits: &DirectVerdictConfig) -> Option<String> {
    let other = outcome.contender.filter(|other| other.score_ratio > limits.alias_score_max)?;
    Some(format!(
        "{} is nearly as good, with {:.0} % of the score (limit {:.0} %): the texture is self-similar",
        other_plane(&other.plane, &outcome.patch_plane),
        100.0 * other.score_ratio,
        100.0 * limits.alias_score_max
    ))
}

/// The status of an outcome; `normal_sigma_rad` is the standard deviation of the estimated normal.
pub(super) fn judge(
    outcome: &ColdStartOutcome,
    normal_sigma_rad: Option<f64>,
    searched: &Searched,
    limits: &DirectVerdictConfig,
    choice: &SurfaceChoice,
) -> Verdict {
    let say = |status, reason: String| Verdict { status, reason };
    if let Some(verdict) = too_little(outcome, searched, limits, choice) {
        return verdict;
    }
    let finest = &outcome.finest;
    let support = support_of(finest);
    let agreeing = 100.0 * support;
    if lies_spread(outcome) {
        return say(Status::Ambiguous, spread(outcome, agreeing));
    }
    if let Some(alias) = outcome.alias.filter(|alias| alias.score_ratio > limits.alias_score_max) {
        return say(
            Status::Ambiguous,
            format!(
                "{} explains the same pixels with {:.0} % of the score (limit {:.0} %): the texture repeats",
                other_plane(&alias.plane, &outcome.patch_plane),
                100.0 * alias.score_ratio,
                100.0 * limits.alias_score_max
            ),
        );
    }
    if let Some(reason) = contested(outcome, limits) {
        return say(Status::Ambiguous, reason);
    }
    if let Some(period_px) = outcome.repeats_px {
        let evidence = format!(
            "the texture repeats every {period_px:.0} px, and only {agreeing:.0} % of the region agrees with the plane"
        );
        return say(Status::Ambiguous, format!("{evidence}: {}", may_be_outside()));
    }
    if let Some(second) = similar_second(outcome, limits) {
        return say(
            Status::Ambiguous,
            format!(
                "two surfaces cover similar shares of the region, {:.0} % and {:.0} %: mark one of them",
                100.0 * outcome.first_share(),
                100.0 * second.own_share
            ),
        );
    }
    let agreed = format!(
        "{:.0} % of the region agrees with the plane at a mean correlation of {:.2}",
        100.0 * support,
        finest.mean_correlation
    );
    match normal_sigma_rad.map(f64::to_degrees) {
        Some(sigma_deg) if sigma_deg <= limits.normal_sigma_max_deg => say(Status::Ok, agreed),
        Some(sigma_deg) => say(
            Status::WeakTilt,
            format!(
                "{agreed}, but the normal has a standard deviation of {sigma_deg:.1} degrees (limit {:.1}): mark a larger region",
                limits.normal_sigma_max_deg
            ),
        ),
        None => say(
            Status::WeakTilt,
            format!("{agreed}, but the tilt was not refined: too few textured pixels, or no time left"),
        ),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::outcome::Surface;
    use crate::patches::PatchOutcome;
    use crate::search::PixelShares;
    use pb3dp_estimation_views::region_pyramid::LevelPlane;

    /// Patches that mix several surfaces support none of them; single disparities lie on the plane.
    #[test]
    fn a_plane_on_which_disparities_lie_is_given_without_support_of_patches() {
        let plane = DisparityPlane { centre_px: Vector2::new(90.0, 70.0), d0_px: 40.0, slope: Vector2::zeros() };
        let finest = PatchOutcome {
            plane: LevelPlane { a: 0.0, b: 0.0, c: 40.0, row: 0 },
            textured_share: 1.0,
            support_share: 0.09,
            mean_correlation: 0.8,
        };
        let status = |share: f64| {
            let first = Surface { plane, share, patches: finest, score: 0.3, area_share: None, mask: 0 };
            let outcome = ColdStartOutcome {
                first,
                second: None,
                alias: None,
                contender: None,
                valid_share: 0.7,
                pixels: PixelShares { on_plane: 0.7 * share, elsewhere: 0.7 * (1.0 - share) },
                finest,
                patch_plane: plane,
                refined: None,
                at_refined: None,
                plane_at_refined: None,
                nearby: None,
                widest: None,
                continued: None,
                relief_px: 0.0,
                unlimited: None,
                repeats_px: None,
            };
            let searched = Searched { range: SearchRange::new(0.3, 1.0, 1.0).unwrap(), steeper: None };
            judge(&outcome, None, &searched, &DirectVerdictConfig::default(), &SurfaceChoice::default()).status
        };
        assert_eq!([0.2, 0.25].map(status), [Status::NotObservable, Status::Ambiguous]);
    }

    #[test]
    fn a_rival_at_the_same_distance_is_named_by_its_tilt() {
        let plane =
            DisparityPlane { centre_px: Vector2::new(90.0, 70.0), d0_px: 40.0, slope: Vector2::new(0.01, -0.02) };
        let words = |d0_px| other_plane(&DisparityPlane { d0_px, ..plane }, &plane);
        assert_eq!(words(39.9), "a plane at the same distance with another tilt");
        assert_eq!(words(31.6), "a plane -8.4 px of disparity away");
    }
}
