//! How far an answer of the direct method can be trusted, and why.

use super::cold_start::ColdStartOutcome;
use crate::error::{EstimationError, check_range};
use crate::status::{Status, Verdict};

/// Limits between the statuses. They were chosen on real pairs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectVerdictConfig {
    /// Smallest share of the region's pixels whose patch has texture and agrees with the plane; below: `not-observable`.
    /// 0 to 1. Default 0.3.
    pub support_min: f64,
    /// Another explanation of the same pixels whose score reaches this share of the best one's makes the answer
    /// `ambiguous`. 0 to 1. Default 0.85.
    pub alias_score_max: f64,
    /// Another surface with this share of the number of pixels of the first makes the answer `ambiguous`. 0 to 1.
    /// Default 0.65.
    pub second_share_max: f64,
    /// Largest standard deviation of the normal, degrees; above: `weak-tilt`. 0 to 90. Default 5.
    pub normal_sigma_max_deg: f64,
}

impl Default for DirectVerdictConfig {
    fn default() -> Self {
        Self { support_min: 0.3, alias_score_max: 0.85, second_share_max: 0.65, normal_sigma_max_deg: 5.0 }
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
        share("direct.status.alias_score_max", self.alias_score_max)?;
        share("direct.status.second_share_max", self.second_share_max)?;
        let degrees = self.normal_sigma_max_deg;
        check_range("direct.status.normal_sigma_max_deg", degrees, (0.0, 90.0), "must be between 0 and 90 degrees")
    }
}

/// The status of an outcome; `normal_sigma_rad` is the standard deviation of the answer's normal.
pub(super) fn judge(
    outcome: &ColdStartOutcome,
    normal_sigma_rad: Option<f64>,
    limits: &DirectVerdictConfig,
) -> Verdict {
    let say = |status, reason: String| Verdict { status, reason };
    let finest = &outcome.finest;
    let support = finest.textured_share * finest.support_share;
    if support < limits.support_min {
        let (textured, agreeing) = (100.0 * finest.textured_share, 100.0 * support);
        let seen = if finest.textured_share < limits.support_min {
            format!("only {textured:.0} % of the region have texture, {agreeing:.0} % agree with one plane")
        } else {
            format!("{textured:.0} % of the region have texture, but {agreeing:.0} % agree with one plane")
        };
        let limit = 100.0 * limits.support_min;
        return say(
            Status::NotObservable,
            format!("{seen} (limit {limit:.0} %): choose a target with texture, or check range and calibration"),
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
    let first_share = outcome.first.patches.textured_share * outcome.first.patches.support_share;
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
