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

use super::load::{Checker, whole};

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

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SearchSection {
    quick_area_max_px: i64,
    quick_share_min: f64,
    area_max_px: i64,
    noise_grey: f64,
    draws: i64,
    tolerance_px: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PatchesSection {
    area_max_px: i64,
    support_px: f64,
    correlation_min: f64,
    texture_min: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RefineSection {
    area_max_px: i64,
    points_max: i64,
    iterations_max: i64,
    place_sigma_px: f64,
    row_sigma_px: f64,
    calibration_sigma_px: f64,
    blur_sigma_px2: f64,
    surroundings_px: i64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct StatusSection {
    support_min: f64,
    support_sure_min: f64,
    alias_score_max: f64,
    second_share_max: f64,
    normal_sigma_max_deg: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TrackerSection {
    points: i64,
    erosion_px: i64,
    steps_max: i64,
    views_max: i64,
    view_turn_deg: f64,
    view_scale: f64,
    relief_sigma_px: f64,
    inlier_share_min: f64,
    correlation_min: f64,
    tilt_sigma_sure_deg: f64,
    #[serde(default)]
    rolling_shutter_millis: f64,
}

impl DirectSection {
    /// The parameters of tracking; values out of range are reported to `check` under `key`.
    pub fn build_tracker(&self, key: &str, check: &mut Checker) -> DirectTrackerConfig {
        let config = self.tracker.build(&format!("{key}.tracker"), check);
        if let (true, Err(error)) = (check.is_clean(), config.validate()) {
            check.refuse(format!("{key}: {error}"));
        }
        config
    }

    /// The parameters in the units of the estimator, for regions as in `region`; values out of range are reported to `check` under
    /// `key`.
    pub fn build(&self, key: &str, region: RegionConfig, check: &mut Checker) -> DirectConfig {
        let defaults = ColdStartConfig::default();
        let config = DirectConfig {
            region,
            cold_start: ColdStartConfig {
                quick_area_px: whole(self.search.quick_area_max_px),
                quick_share_min: self.search.quick_share_min,
                search_area_px: whole(self.search.area_max_px),
                patch_area_px: whole(self.patches.area_max_px),
                search: self.search.build(&format!("{key}.search"), defaults.search, check),
                patches: self.patches.build(&format!("{key}.patches"), defaults.patches, check),
                refine: self.refine.build(&format!("{key}.refine"), defaults.refine, check),
                surroundings_px: whole(self.refine.surroundings_px),
                choice: defaults.choice,
            },
            verdict: self.status.build(&format!("{key}.status"), check),
        };
        if let (true, Err(error)) = (check.is_clean(), config.validate()) {
            check.refuse(format!("{key}: {error}"));
        }
        config
    }
}

impl SearchSection {
    fn build(&self, key: &str, defaults: PlaneSearchConfig, check: &mut Checker) -> PlaneSearchConfig {
        check.count(&format!("{key}.quick_area_max_px"), self.quick_area_max_px, ColdStartConfig::QUICK_AREA_PX);
        check.number(&format!("{key}.quick_share_min"), self.quick_share_min, ColdStartConfig::QUICK_SHARE_MIN);
        check.count(&format!("{key}.area_max_px"), self.area_max_px, ColdStartConfig::SEARCH_AREA_PX);
        check.number(&format!("{key}.noise_grey"), self.noise_grey, PlaneSearchConfig::NOISE);
        check.count(&format!("{key}.draws"), self.draws, HypothesisRules::DRAWS);
        check.number(&format!("{key}.tolerance_px"), self.tolerance_px, HypothesisRules::TOLERANCE_PX);
        PlaneSearchConfig {
            noise: self.noise_grey,
            hypotheses: HypothesisRules {
                draws: whole(self.draws),
                tolerance_px: self.tolerance_px,
                ..defaults.hypotheses
            },
            ..defaults
        }
    }
}

impl PatchesSection {
    fn build(&self, key: &str, defaults: PatchConfig, check: &mut Checker) -> PatchConfig {
        check.count(&format!("{key}.area_max_px"), self.area_max_px, ColdStartConfig::PATCH_AREA_PX);
        check.number(&format!("{key}.support_px"), self.support_px, PatchConfig::SUPPORT_PX);
        check.number(&format!("{key}.correlation_min"), self.correlation_min, PatchConfig::CORRELATION_MIN);
        check.number(&format!("{key}.texture_min"), self.texture_min, PatchConfig::TEXTURE_MIN);
        PatchConfig {
            support_px: self.support_px,
            correlation_min: self.correlation_min,
            texture_min: self.texture_min,
            ..defaults
        }
    }
}

impl RefineSection {
    fn build(&self, key: &str, defaults: RefineConfig, check: &mut Checker) -> RefineConfig {
        check.count(&format!("{key}.area_max_px"), self.area_max_px, RefineConfig::AREA_MAX_PX);
        check.count(&format!("{key}.points_max"), self.points_max, RefineConfig::POINTS_MAX);
        check.count(&format!("{key}.iterations_max"), self.iterations_max, RefineConfig::ITERATIONS_MAX);
        check.number(&format!("{key}.place_sigma_px"), self.place_sigma_px, RefineConfig::PLACE_SIGMA_PX);
        check.number(&format!("{key}.row_sigma_px"), self.row_sigma_px, RefineConfig::ROW_SIGMA_PX);
        check.number(
            &format!("{key}.calibration_sigma_px"),
            self.calibration_sigma_px,
            RefineConfig::CALIBRATION_SIGMA_PX,
        );
        check.number(&format!("{key}.blur_sigma_px2"), self.blur_sigma_px2, RefineConfig::BLUR_SIGMA_PX2);
        check.count(&format!("{key}.surroundings_px"), self.surroundings_px, ColdStartConfig::SURROUNDINGS_PX);
        RefineConfig {
            area_max_px: whole(self.area_max_px),
            points_max: whole(self.points_max),
            iterations_max: whole(self.iterations_max),
            place_sigma_px: self.place_sigma_px,
            row_sigma_px: self.row_sigma_px,
            calibration_sigma_px: self.calibration_sigma_px,
            blur_sigma_px2: self.blur_sigma_px2,
            ..defaults
        }
    }
}

impl StatusSection {
    fn build(&self, key: &str, check: &mut Checker) -> DirectVerdictConfig {
        check.number(&format!("{key}.support_min"), self.support_min, DirectVerdictConfig::SUPPORT_MIN);
        check.number(&format!("{key}.support_sure_min"), self.support_sure_min, DirectVerdictConfig::SUPPORT_SURE_MIN);
        check.number(&format!("{key}.alias_score_max"), self.alias_score_max, DirectVerdictConfig::ALIAS_SCORE_MAX);
        check.number(&format!("{key}.second_share_max"), self.second_share_max, DirectVerdictConfig::SECOND_SHARE_MAX);
        check.number(
            &format!("{key}.normal_sigma_max_deg"),
            self.normal_sigma_max_deg,
            DirectVerdictConfig::NORMAL_SIGMA_MAX_DEG,
        );
        DirectVerdictConfig {
            support_min: self.support_min,
            support_sure_min: self.support_sure_min,
            alias_score_max: self.alias_score_max,
            second_share_max: self.second_share_max,
            normal_sigma_max_deg: self.normal_sigma_max_deg,
        }
    }
}

impl TrackerSection {
    fn build(&self, key: &str, check: &mut Checker) -> DirectTrackerConfig {
        check.count(&format!("{key}.points"), self.points, DirectTrackerConfig::POINTS);
        check.count(&format!("{key}.erosion_px"), self.erosion_px, DirectTrackerConfig::EROSION_PX);
        check.count(&format!("{key}.steps_max"), self.steps_max, DirectTrackerConfig::STEPS_MAX);
        check.count(&format!("{key}.views_max"), self.views_max, DirectTrackerConfig::VIEWS_MAX);
        check.number(&format!("{key}.view_turn_deg"), self.view_turn_deg, DirectTrackerConfig::VIEW_TURN_DEG);
        check.number(&format!("{key}.view_scale"), self.view_scale, DirectTrackerConfig::VIEW_SCALE);
        check.number(&format!("{key}.relief_sigma_px"), self.relief_sigma_px, DirectTrackerConfig::RELIEF_SIGMA_PX);
        check.number(&format!("{key}.inlier_share_min"), self.inlier_share_min, DirectTrackerConfig::INLIER_SHARE_MIN);
        check.number(&format!("{key}.correlation_min"), self.correlation_min, DirectTrackerConfig::CORRELATION_MIN);
        check.number(
            &format!("{key}.tilt_sigma_sure_deg"),
            self.tilt_sigma_sure_deg,
            DirectTrackerConfig::TILT_SIGMA_SURE_DEG,
        );
        check.number(
            &format!("{key}.rolling_shutter_millis"),
            self.rolling_shutter_millis,
            DirectTrackerConfig::ROLLING_SHUTTER_MILLIS,
        );
        DirectTrackerConfig {
            points: whole(self.points),
            erosion_px: whole(self.erosion_px),
            steps_max: whole(self.steps_max),
            views_max: whole(self.views_max),
            view_turn_deg: self.view_turn_deg,
            view_scale: self.view_scale,
            relief_sigma_px: self.relief_sigma_px,
            inlier_share_min: self.inlier_share_min,
            correlation_min: self.correlation_min,
            tilt_sigma_sure_deg: self.tilt_sigma_sure_deg,
            rolling_shutter_millis: self.rolling_shutter_millis,
        }
    }
}
