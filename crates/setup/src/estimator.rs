//! The estimator's parameters: the file `configs/estimator.toml`, and the table `[estimator]` of a setup.

use std::path::Path;

use pb3dp_estimation::estimator::EstimatorConfig;
use pb3dp_estimation_core::region::RegionConfig;
use pb3dp_estimation_published::estimator::{ColdStartConfig, HueSupportConfig, PublishedConfig, TrackerConfig};
use pb3dp_estimation_published::fitness::{FitnessConfig, Unseen};
use pb3dp_estimation_published::hue::HueConfig;
use pb3dp_estimation_published::observability::ObservabilityConfig;
use pb3dp_estimation_published::photo_model::PhotoModelConfig;
use pb3dp_estimation_published::search::chromosome::Coding;
use pb3dp_estimation_published::search::rmga::{Mutation, RmGaConfig};
use serde::Deserialize;

use super::direct::DirectSection;
use super::load::{Checker, ConfigError, ConfigFile, FileKind, whole};
use super::table::{Builds, table};

/// The whole file `configs/estimator.toml`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct EstimatorFile {
    published: PublishedSection,
    direct: DirectSection,
}

/// Reads a file of estimator parameters.
///
/// # Errors
/// An unreadable file, unknown or missing keys, values out of range; the error names file, key and allowed values.
pub fn read_estimator(file: &Path) -> Result<EstimatorConfig, ConfigError> {
    let config = ConfigFile::read(file, FileKind::Estimator)?;
    let mut check = Checker::default();
    let found = config.all().map(|raw: EstimatorFile| {
        let published = raw.published.build("published", &mut check);
        let direct = raw.direct.build("direct", published.region, &mut check);
        let track = raw.direct.build_tracker("direct", &mut check);
        EstimatorConfig { published, direct, track }
    });
    config.finish(check)?;
    Ok(found.unwrap_or_default())
}

/// Parameters of the methods: of this file, or the documented defaults; with this seed of the search, if there is one.
///
/// # Errors
/// As [`read_estimator`].
pub fn estimator_config(file: Option<&Path>, seed: Option<u64>) -> Result<EstimatorConfig, ConfigError> {
    let mut config = file.map_or_else(|| Ok(EstimatorConfig::default()), read_estimator)?;
    if let Some(seed) = seed {
        config.published.rmga.seed = seed;
    }
    Ok(config)
}

/// Parameters of the published method.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedSection {
    hue: HueSection,
    model: ModelSection,
    fitness: FitnessSection,
    rmga: RmGaSection,
    region: RegionSection,
    status: StatusSection,
    tracker: TrackerSection,
}

table! {
    struct HueSection sets PublishedConfig {
        saturation_min: f64 => hue.saturation_min = number(HueConfig::SATURATION_MIN);
        value_min: f64 => hue.value_min = number(HueConfig::VALUE_MIN);
        coloured_share_min: f64 => hue_support.coloured_share_min = number(HueSupportConfig::COLOURED_SHARE_MIN);
        coloured_points_min: i64 => hue_support.points_min = count(HueSupportConfig::POINTS_MIN);
    }
}

table! {
    struct ModelSection builds PhotoModelConfig {
        inner_points: i64 => inner_points = count(PhotoModelConfig::INNER_POINTS);
        outer_points: i64 => outer_points = count(PhotoModelConfig::OUTER_POINTS);
        spacing_min_px: i64 => spacing_min_px = count(PhotoModelConfig::SPACING_MIN_PX);
        band_gap_px: i64 => band_gap_px = count(PhotoModelConfig::BAND_GAP_PX);
        band_width_px: i64 => band_width_px = count(PhotoModelConfig::BAND_WIDTH_PX);
    }
}

table! {
    struct FitnessSection builds FitnessConfig {
        hue_tolerance_deg: f64 => hue_tolerance_deg = number(FitnessConfig::HUE_TOLERANCE_DEG);
        unseen: UnseenName => unseen = plain();
    }
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum UnseenName {
    Mismatch,
    Abstain,
}

impl From<UnseenName> for Unseen {
    fn from(name: UnseenName) -> Self {
        match name {
            UnseenName::Mismatch => Self::Mismatch,
            UnseenName::Abstain => Self::Abstain,
        }
    }
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RmGaSection {
    population: i64,
    survivors: i64,
    elite: i64,
    generations_per_frame: i64,
    generations_cold_start: i64,
    mutation: MutationName,
    mutation_rate: f64,
    mutate_survivors: bool,
    coding: CodingName,
    seed: u64,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum MutationName {
    PerBit,
    PerIndividual,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum CodingName {
    Gray,
    Binary,
}

table! {
    struct RegionSection builds RegionConfig {
        area_min_px: i64 => area_min_px = count(1..=10_000_000);
        click_hue_tolerance_deg: f64 => click_hue_tolerance_deg = number(0.0..=180.0);
        click_luminance_tolerance: f64 => click_luminance_tolerance = number(0.0..=255.0);
        click_chroma_min: f64 => click_chroma_min = number(0.0..=255.0);
        click_area_share_max: f64 => click_area_share_max = number(0.001..=1.0);
        coloured_share_warn: f64 => coloured_share_min = number(0.0..=1.0);
        luminance_deviation_warn: f64 => luminance_deviation_min = number(0.0..=127.0);
    }
}

table! {
    struct StatusSection builds ObservabilityConfig {
        disparity_step_px: f64 => disparity_step_px = number(ObservabilityConfig::DISPARITY_STEP_PX);
        depth_nodes_max: i64 => depth_nodes_max = count(ObservabilityConfig::DEPTH_NODES_MAX);
        coarse_tilt_step_deg: f64 => coarse_tilt_step_rad = deg(ObservabilityConfig::COARSE_TILT_STEP_RAD);
        fine_tilt_step_deg: f64 => fine_tilt_step_rad = deg(ObservabilityConfig::FINE_TILT_STEP_RAD);
        blocks_per_side: i64 => blocks_per_side = count(ObservabilityConfig::BLOCKS_PER_SIDE);
        resamples: i64 => resamples = count(ObservabilityConfig::RESAMPLES);
        candidates_max: i64 => candidates_max = count(ObservabilityConfig::CANDIDATES_MAX);
        fitness_tolerance: f64 => fitness_tolerance = number(ObservabilityConfig::FITNESS_TOLERANCE);
        height_min: f64 => height_min = number(ObservabilityConfig::HEIGHT_MIN);
        depth_spread_max: f64 => depth_spread_max = number(ObservabilityConfig::DEPTH_SPREAD_MAX);
        depth_spread_sure: f64 => depth_spread_sure = number(ObservabilityConfig::DEPTH_SPREAD_SURE);
        runner_up_max: f64 => runner_up_max = number(ObservabilityConfig::RUNNER_UP_MAX);
        fitness_sure: f64 => fitness_sure = number(ObservabilityConfig::FITNESS_SURE);
        tilt_spread_sure_deg: f64 => tilt_spread_sure_rad = deg(ObservabilityConfig::TILT_SPREAD_SURE_RAD);
    }
}

table! {
    struct TrackerSection builds TrackerConfig {
        window_margin_px: i64 => window_margin_px = count(TrackerConfig::WINDOW_MARGIN_PX);
        shift_steps_max: i64 => shift_steps_max = count(TrackerConfig::SHIFT_STEPS_MAX);
        shift_max_share: f64 => shift_max_share = number(TrackerConfig::SHIFT_MAX_SHARE);
        contrast_min: f64 => contrast_min = number(TrackerConfig::CONTRAST_MIN);
        mass_share_min: f64 => mass_share_min = number(TrackerConfig::MASS_SHARE_MIN);
        visible_share_min: f64 => visible_share_min = number(TrackerConfig::VISIBLE_SHARE_MIN);
        depth_spread_sure: f64 => depth_spread_sure = number(TrackerConfig::DEPTH_SPREAD_SURE);
        height_share_min: f64 => height_share_min = number(TrackerConfig::HEIGHT_SHARE_MIN);
        assure_frames_max: i64 => assure_frames_max = count(TrackerConfig::ASSURE_FRAMES_MAX);
    }
}

impl PublishedSection {
    /// The parameters in the units of the estimator; values out of range are reported to `check` under `key`.
    pub fn build(&self, key: &str, check: &mut Checker) -> PublishedConfig {
        self.rmga.check(&format!("{key}.rmga"), check);
        let mut config = PublishedConfig {
            model: self.model.build(&format!("{key}.model"), check),
            fitness: self.fitness.build(&format!("{key}.fitness"), check),
            rmga: self.rmga.build(),
            cold_start: ColdStartConfig { generations: whole(self.rmga.generations_cold_start) },
            region: self.region.build(&format!("{key}.region"), check),
            observability: self.status.build(&format!("{key}.status"), check),
            tracker: self.tracker.build(&format!("{key}.tracker"), check),
            ..PublishedConfig::default()
        };
        self.hue.set(&mut config, &format!("{key}.hue"), check);
        check.together(key, config.validate());
        config
    }
}

impl RmGaSection {
    fn check(&self, key: &str, check: &mut Checker) {
        let config = self.build();
        let (per_frame, cold_start) = (self.generations_per_frame, self.generations_cold_start);
        check.count(&format!("{key}.population"), self.population, RmGaConfig::POPULATION);
        check.count(&format!("{key}.survivors"), self.survivors, config.survivors_allowed());
        check.count(&format!("{key}.elite"), self.elite, config.elite_allowed());
        check.count(&format!("{key}.generations_per_frame"), per_frame, RmGaConfig::GENERATIONS);
        check.count(&format!("{key}.generations_cold_start"), cold_start, RmGaConfig::GENERATIONS);
        check.number(&format!("{key}.mutation_rate"), self.mutation_rate, RmGaConfig::MUTATION_RATE);
    }

    fn build(&self) -> RmGaConfig {
        RmGaConfig {
            population: whole(self.population),
            survivors: whole(self.survivors),
            elite: whole(self.elite),
            generations: whole(self.generations_per_frame),
            mutation: match self.mutation {
                MutationName::PerBit => Mutation::PerBit(self.mutation_rate),
                MutationName::PerIndividual => Mutation::PerIndividual(self.mutation_rate),
            },
            mutate_survivors: self.mutate_survivors,
            coding: match self.coding {
                CodingName::Gray => Coding::Gray,
                CodingName::Binary => Coding::Binary,
            },
            seed: self.seed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/estimator.toml");

    #[test]
    fn the_file_states_the_defaults() {
        assert_eq!(read_estimator(Path::new(FILE)).unwrap(), EstimatorConfig::default());
    }

    #[test]
    fn values_out_of_range_are_named() {
        let text = std::fs::read_to_string(FILE).unwrap();
        let check = |from: &str, to: &str, expected: &[&str]| {
            assert!(text.contains(from), "{from}");
            let folder = tempfile::tempdir().unwrap();
            let file = folder.path().join("e.toml");
            std::fs::write(&file, text.replace(from, to)).unwrap();
            let error = read_estimator(&file).unwrap_err().to_string();
            assert!(error.contains("e.toml"), "{error}");
            for part in expected {
                assert!(error.contains(part), "{part} is not in {error}");
            }
        };
        check("population = 60", "population = 1", &["published.rmga.population = 1", "2 to 10000"]);
        check("hue_tolerance_deg = 20.0", "hue_tolerance_deg = nan", &["published.fitness.hue_tolerance_deg = NaN"]);
        check("coding = \"gray\"", "coding = \"grey\"", &["published.rmga.coding", "grey", "gray"]);
        check("seed = 1", "sed = 1", &["published.rmga.sed", "seed"]);
        check("views_max = 12", "views_max = 0", &["direct.tracker.views_max = 0", "1 to 100"]);
        check("row_sigma_px = 0.3", "row_sigma_px = -0.3", &["direct.refine.row_sigma_px = -0.3", "0 to 5"]);
        check("[direct.status]", "[direct.verdict]", &["direct.verdict", "status"]);
    }
}
