//! The table `[rmga_photometric]` of `configs/estimator.toml`.

use pb3dp_estimation::published::PublishedConfig;
use pb3dp_estimation::rmga_photometric::RmgaPhotometricConfig;
use pb3dp_estimation::search::rmga::RmGaConfig;
use serde::Deserialize;

use super::load::{Checker, whole};

/// What RM-GA with a photometric score has of its own; genetic algorithm, region and status are those of `[published]`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RmgaPhotometricSection {
    points: i64,
    margin_px: i64,
    smoothing_px: f64,
    area_max_px: i64,
    coarse_levels: i64,
    blocks_per_side: i64,
    texture_share_min: f64,
    generations: i64,
}

impl RmgaPhotometricSection {
    /// The parameters in the units of the estimator; what is out of range goes to `check` under `key`.
    pub fn build(&self, key: &str, published: &PublishedConfig, check: &mut Checker) -> RmgaPhotometricConfig {
        check.count(&format!("{key}.points"), self.points, 100..=20_000);
        check.count(&format!("{key}.margin_px"), self.margin_px, 0..=8);
        check.number(&format!("{key}.smoothing_px"), self.smoothing_px, 0.3..=4.0);
        check.count(&format!("{key}.area_max_px"), self.area_max_px, 200..=1_000_000);
        check.count(&format!("{key}.coarse_levels"), self.coarse_levels, 0..=4);
        check.count(&format!("{key}.blocks_per_side"), self.blocks_per_side, 2..=8);
        check.number(&format!("{key}.texture_share_min"), self.texture_share_min, 0.0..=1.0);
        check.count(&format!("{key}.generations"), self.generations, 1..=100_000);
        let config = RmgaPhotometricConfig {
            points: whole(self.points),
            margin_px: whole(self.margin_px),
            smoothing_px: self.smoothing_px,
            area_max_px: whole(self.area_max_px),
            coarse_levels: whole(self.coarse_levels),
            blocks_per_side: whole(self.blocks_per_side),
            texture_share_min: self.texture_share_min,
            rmga: RmGaConfig { generations: whole(self.generations), ..published.rmga },
            region: published.region,
            observability: published.observability,
        };
        if let (true, Err(error)) = (check.is_clean(), config.validate()) {
            check.refuse(format!("{key}: {error}"));
        }
        config
    }
}
