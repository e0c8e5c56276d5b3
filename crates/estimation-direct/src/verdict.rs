//! How far an answer of the direct method can be trusted, and why.

use pb3dp_estimation_core::error::{EstimationError, check_range};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::status::{Status, Verdict};

use crate::outcome::{ColdStartOutcome, support_of};

/// Limits between the statuses. They were chosen on real pairs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectVerdictConfig {
    /// Smallest share of the region's pixels whose patch has texture and agrees with the plane; below: `not-observable`.
    /// 0 to 1. Default 0.15.
    pub support_min: f64,
    /// With a smaller share than this the answer is `ambiguous` at best, because the region is no plane. 0 to 1. Default 0.4.
    pub support_sure_min: f64,
    /// Another explanation of the same pixels, in the range or beyond it, whose score reaches this share of the best one's
    /// makes the answer `ambiguous`, on the level of the search or on the finest one. 0 to 1.
    /// Default 0.85.
    pub alias_score_max: f64,
    /// Another surface with this share of the number of pixels of the first makes the answer `ambiguous`. 0 to 1.
    /// Default 0.65.
    pub second_share_max: f64,
    /// Largest standard deviation of the normal, degrees; above: `weak-tilt`. 0 to 90. Default 5.
    pub normal_sigma_max_deg: f64,
}

impl Default for DirectVerdictConfig {
    fn default() -> Self {
        Self {
            support_min: 0.15,
            support_sure_min: 0.4,
            alias_score_max: 0.85,
            second_share_max: 0.65,
            normal_sigma_max_deg: 5.0,
        }
    }
}

impl DirectVerdictConfig {
    /// Checks all ranges.
    ///
    /// # Errors
    /// The parameter that is out of its range.
    pub fn validate(&self) -> Result<(), EstimationError> {
        let share = |name, value| check_range(name, value, (0.0, 1.0), "must be between 0 and 1");
        share("direct.status.support_min", self.support_min)?;
        share("direct.status.support_sure_min", self.support_sure_min)?;
        share("direct.status.alias_score_max", self.alias_score_max)?;
        share("direct.status.second_share_max", self.second_share_max)?;
        let degrees = self.normal_sigma_max_deg;
        check_range("direct.status.normal_sigma_max_deg", degrees, (0.0, 90.0), "must be between 0 and 90 degrees")
    }
}

/// A plane that the search was not to look for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Steeper {
    /// The larger of its two tilts, degrees.
    pub tilt_deg: f64,
    /// Share of the region's pixels that lie on it.
    pub share: f64,
}

/// What was searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Searched {
    /// Depths and tilts.
    pub range: SearchRange,
    /// A plane within the depths that explains more, but is tilted by more than the range allows.
    pub steeper: Option<Steeper>,
}

/// Why the search found nothing to begin with.
pub(super) fn nothing_found(range: &SearchRange) -> String {
    format!(
        "at {:.0} to {:.0} mm the right image shows nothing of the region: check the depth range (--z-range), the region and the calibration",
        1e3 * range.z_min_m,
        1e3 * range.z_max_m
    )
}

/// What is said where a plane beyond the range of depths, at `z_m` if it lies in front of the camera, explains the region as
/// well as the answer or better.
pub(super) fn lies_beyond(z_m: Option<f64>, score_ratio: f64) -> String {
    let place = z_m.map_or("far away".to_owned(), |z_m| format!("at about {:.0} mm", 1e3 * z_m));
    format!(
        "a plane {place}, outside the depth range, explains the region with {:.0} % of the score: the target may lie there, widen the range (--z-range)",
        100.0 * score_ratio
    )
}

/// Where some of the searched depths are out of the right image's sight, the patches that agree must correlate so well: a texture that
/// resembles itself correlates less with another part of it. Chosen; no sweep is on record.
pub(super) const UNSEEN_CORRELATION_MIN: f64 = 0.75;

/// What is said where the region may be at a depth nearer than `z_m`, at which the right image does not show it.
pub(super) fn may_be_unseen(z_m: f64, correlation: f64) -> String {
    format!(
        "nearer than {:.0} mm the right image would not show the middle of the region, and what it shows correlates by {correlation:.2} only (limit {UNSEEN_CORRELATION_MIN}): mark what both cameras see, or narrow the range (--z-range)",
        1e3 * z_m
    )
}

/// What is said where both images are one.
pub(super) const SAME_IMAGE: &str =
    "left and right are the same image: they say nothing of depth; check the file names or the cameras";

/// Why few pixels agree with one plane, and what to do.
fn cause(outcome: &ColdStartOutcome, searched: &Searched, limits: &DirectVerdictConfig) -> String {
    let range = &searched.range;
    // With less it would be no answer either.
    let steeper = searched.steeper.filter(|steeper| steeper.share >= limits.support_min);
    if let Some(Steeper { tilt_deg, share }) = steeper {
        return format!(
            "a plane tilted by {tilt_deg:.0} degrees explains {:.0} %, but the largest tilt is {:.0} degrees: raise it (--tilt-max)",
            100.0 * share,
            range.tilt_max_rad.to_degrees()
        );
    }
    if outcome.unlimited.is_none_or(|(_, share)| share < ANY_SHARE_MIN) {
        return format!(
            "at {:.0} to {:.0} mm the right image shows nothing that matches: check the depth range (--z-range) and the calibration; noise and blur do the same",
            1e3 * range.z_min_m,
            1e3 * range.z_max_m
        );
    }
    "it is not flat, or shows several surfaces: mark a part that is flat".to_owned()
}

/// If no plane explains this share of the region, range, calibration or images are to blame. Chosen; no sweep is on record.
const ANY_SHARE_MIN: f64 = 0.1;

/// Too little of a region has texture if its share is smaller than this. Chosen; no sweep is on record.
const TEXTURED_MIN: f64 = 0.3;

/// What is said where too little of the region has texture or agrees with the plane.
fn too_little(outcome: &ColdStartOutcome, searched: &Searched, limits: &DirectVerdictConfig) -> Option<Verdict> {
    let (textured, support) = (outcome.finest.textured_share, support_of(&outcome.finest));
    let sure_min = limits.support_sure_min;
    if support >= sure_min {
        return None;
    }
    if textured < TEXTURED_MIN {
        let (textured, limit) = (100.0 * textured, 100.0 * TEXTURED_MIN);
        let seen = format!("only {textured:.0} % of the region have texture (limit {limit:.0} %)");
        let reason = format!("{seen}: choose a target with texture, or more light");
        return Some(Verdict { status: Status::NotObservable, reason });
    }
    let (status, limit) = match support < limits.support_min {
        true => (Status::NotObservable, 100.0 * limits.support_min),
        false => (Status::Ambiguous, 100.0 * sure_min),
    };
    let seen = format!("only {:.0} % of the region agree with one plane (limit {limit:.0} %)", 100.0 * support);
    Some(Verdict { status, reason: format!("{seen}; {}", cause(outcome, searched, limits)) })
}

/// Whether the region has texture, but not enough of it agrees with one plane for a sure answer, or its disparities lie
/// spread around every plane.
pub(super) fn is_no_plane(outcome: &ColdStartOutcome, limits: &DirectVerdictConfig) -> bool {
    let sure_min = limits.support_sure_min;
    let lacks_support = outcome.finest.textured_share >= TEXTURED_MIN && support_of(&outcome.finest) < sure_min;
    lies_spread(outcome) || lacks_support
}

fn lies_spread(outcome: &ColdStartOutcome) -> bool {
    outcome.widest.is_some_and(|widest| widest.is_spread)
}

/// What is said where another plane is nearly as good on the finest level.
fn contested(outcome: &ColdStartOutcome, limits: &DirectVerdictConfig) -> Option<String> {
    let other = outcome.contender.filter(|other| other.score_ratio > limits.alias_score_max)?;
    let gap_px = other.plane.d0_px - outcome.patch_plane.d0_px;
    Some(format!(
        "a plane {gap_px:+.1} px of disparity away is nearly as good, with {:.0} % of the score (limit {:.0} %): the texture resembles itself",
        100.0 * other.score_ratio,
        100.0 * limits.alias_score_max
    ))
}

/// The status of an outcome; `normal_sigma_rad` is the standard deviation of the answer's normal.
pub(super) fn judge(
    outcome: &ColdStartOutcome,
    normal_sigma_rad: Option<f64>,
    searched: &Searched,
    limits: &DirectVerdictConfig,
) -> Verdict {
    let say = |status, reason: String| Verdict { status, reason };
    if let Some(verdict) = too_little(outcome, searched, limits) {
        return verdict;
    }
    let finest = &outcome.finest;
    let support = support_of(finest);
    let agreeing = 100.0 * support;
    if lies_spread(outcome) {
        let seen = "disparities lie spread around every plane, and the one that explains the most is given";
        return say(
            Status::Ambiguous,
            format!("{seen} ({agreeing:.0} % of the region agree): mark a part that is flat"),
        );
    }
    if let Some(alias) = outcome.alias.filter(|alias| alias.score_ratio > limits.alias_score_max) {
        let gap_px = alias.plane.d0_px - outcome.patch_plane.d0_px;
        return say(
            Status::Ambiguous,
            format!(
                "a plane {gap_px:+.1} px of disparity away explains the same pixels with {:.0} % of the score (limit {:.0} %): the texture repeats",
                100.0 * alias.score_ratio,
                100.0 * limits.alias_score_max
            ),
        );
    }
    if let Some(reason) = contested(outcome, limits) {
        return say(Status::Ambiguous, reason);
    }
    if let Some(period_px) = outcome.repeats_px {
        let seen = format!("the texture repeats every {period_px:.0} px, and only {agreeing:.0} % of the region agree");
        let advice = "the target may lie outside the depth range: widen it (--z-range)";
        return say(Status::Ambiguous, format!("{seen}: {advice}"));
    }
    let first_share = support_of(&outcome.first.patches);
    if let Some(second) = outcome.second.filter(|second| second.own_share > limits.second_share_max * first_share) {
        return say(
            Status::Ambiguous,
            format!(
                "two surfaces have nearly the same share of the region, {:.0} % and {:.0} %: mark one of them",
                100.0 * first_share,
                100.0 * second.own_share
            ),
        );
    }
    let agreed = format!(
        "{:.0} % of the region agree with the plane at a mean correlation of {:.2}",
        100.0 * support,
        finest.mean_correlation
    );
    match normal_sigma_rad.map(f64::to_degrees) {
        Some(sigma_deg) if sigma_deg <= limits.normal_sigma_max_deg => say(Status::Ok, agreed),
        Some(sigma_deg) => say(
            Status::WeakTilt,
            format!(
                "{agreed}, but the normal is known to {sigma_deg:.1} degrees only (limit {:.1})",
                limits.normal_sigma_max_deg
            ),
        ),
        None => say(
            Status::WeakTilt,
            format!("{agreed}, but the tilt was not refined: too few pixels with texture, or no time"),
        ),
    }
}
