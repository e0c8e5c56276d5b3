//! The table `[direct]` of `configs/estimator.toml`, and `[estimator.direct]` of a setup.
//!
//! The settings that are useful to users; all others keep the defaults of the method.

use pb3dp_estimation_core::region::RegionConfig;
use pb3dp_estimation_direct::cold_start::ColdStartConfig;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_direct::patches::PatchConfig;
use pb3dp_estimation_direct::photometric::RefineConfig;
use pb3dp_estimation_direct::search::PlaneSearchConfig;
use pb3dp_estimation_direct::search::hypotheses::HypothesisRules;
use pb3dp_estimation_direct::verdict::DirectVerdictConfig;
use pb3dp_estimation_track::DirectTrackerConfig;
use serde::Deserialize;

use super::load::Checker;
use super::table::{Builds, table};

/// Parameters of the direct method; its regions are those of `[published]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DirectSection {
    search: SearchSection,
    patches: PatchesSection,
    refine: RefineSection,
    status: StatusSection,
    tracker: TrackerSection,
}

table! {
    struct SearchSection sets ColdStartConfig {
        quick_area_max_px: i64 => quick_area_px = count(ColdStartConfig::QUICK_AREA_PX);
        quick_share_min: f64 => quick_share_min = number(ColdStartConfig::QUICK_SHARE_MIN);
        area_max_px: i64 => search_area_px = count(ColdStartConfig::SEARCH_AREA_PX);
        noise_grey: f64 => search.noise = number(PlaneSearchConfig::NOISE);
        draws: i64 => search.hypotheses.draws = count(HypothesisRules::DRAWS);
        tolerance_px: f64 => search.hypotheses.tolerance_px = number(HypothesisRules::TOLERANCE_PX);
    }
}

table! {
    struct PatchesSection sets ColdStartConfig {
        area_max_px: i64 => patch_area_px = count(ColdStartConfig::PATCH_AREA_PX);
        support_px: f64 => patches.support_px = number(PatchConfig::SUPPORT_PX);
        correlation_min: f64 => patches.correlation_min = number(PatchConfig::CORRELATION_MIN);
        texture_min: f64 => patches.texture_min = number(PatchConfig::TEXTURE_MIN);
    }
}

table! {
    struct RefineSection sets ColdStartConfig {
        area_max_px: i64 => refine.area_max_px = count(RefineConfig::AREA_MAX_PX);
        points_max: i64 => refine.points_max = count(RefineConfig::POINTS_MAX);
        iterations_max: i64 => refine.iterations_max = count(RefineConfig::ITERATIONS_MAX);
        place_sigma_px: f64 => refine.place_sigma_px = number(RefineConfig::PLACE_SIGMA_PX);
        row_sigma_px: f64 => refine.row_sigma_px = number(RefineConfig::ROW_SIGMA_PX);
        calibration_sigma_px: f64 => refine.calibration_sigma_px = number(RefineConfig::CALIBRATION_SIGMA_PX);
        blur_sigma_px2: f64 => refine.blur_sigma_px2 = number(RefineConfig::BLUR_SIGMA_PX2);
        surroundings_px: i64 => surroundings_px = count(ColdStartConfig::SURROUNDINGS_PX);
    }
}

table! {
    struct StatusSection builds DirectVerdictConfig {
        support_min: f64 => support_min = number(DirectVerdictConfig::SUPPORT_MIN);
        support_sure_min: f64 => support_sure_min = number(DirectVerdictConfig::SUPPORT_SURE_MIN);
        alias_score_max: f64 => alias_score_max = number(DirectVerdictConfig::ALIAS_SCORE_MAX);
        second_share_max: f64 => second_share_max = number(DirectVerdictConfig::SECOND_SHARE_MAX);
        normal_sigma_max_deg: f64 => normal_sigma_max_deg = number(DirectVerdictConfig::NORMAL_SIGMA_MAX_DEG);
    }
}

table! {
    struct TrackerSection builds DirectTrackerConfig {
        points: i64 => points = count(DirectTrackerConfig::POINTS);
        erosion_px: i64 => erosion_px = count(DirectTrackerConfig::EROSION_PX);
        steps_max: i64 => steps_max = count(DirectTrackerConfig::STEPS_MAX);
        views_max: i64 => views_max = count(DirectTrackerConfig::VIEWS_MAX);
        view_turn_deg: f64 => view_turn_deg = number(DirectTrackerConfig::VIEW_TURN_DEG);
        view_scale: f64 => view_scale = number(DirectTrackerConfig::VIEW_SCALE);
        relief_sigma_px: f64 => relief_sigma_px = number(DirectTrackerConfig::RELIEF_SIGMA_PX);
        inlier_share_min: f64 => inlier_share_min = number(DirectTrackerConfig::INLIER_SHARE_MIN);
        correlation_min: f64 => correlation_min = number(DirectTrackerConfig::CORRELATION_MIN);
        tilt_sigma_sure_deg: f64 => tilt_sigma_sure_deg = number(DirectTrackerConfig::TILT_SIGMA_SURE_DEG);
        #[serde(default)]
        rolling_shutter_millis: f64 => rolling_shutter_millis = number(DirectTrackerConfig::ROLLING_SHUTTER_MILLIS);
    }
}

impl DirectSection {
    /// The parameters of tracking; values out of range are reported to `check` under `key`.
    pub fn build_tracker(&self, key: &str, check: &mut Checker) -> DirectTrackerConfig {
        let config = self.tracker.build(&format!("{key}.tracker"), check);
        check.together(key, config.validate());
        config
    }

    /// The parameters in the units of the estimator, for regions as in `region`; values out of range are reported to `check` under
    /// `key`.
    pub fn build(&self, key: &str, region: RegionConfig, check: &mut Checker) -> DirectConfig {
        let mut cold_start = ColdStartConfig::default();
        self.search.set(&mut cold_start, &format!("{key}.search"), check);
        self.patches.set(&mut cold_start, &format!("{key}.patches"), check);
        self.refine.set(&mut cold_start, &format!("{key}.refine"), check);
        let config = DirectConfig { region, cold_start, verdict: self.status.build(&format!("{key}.status"), check) };
        check.together(key, config.validate());
        config
    }
}
