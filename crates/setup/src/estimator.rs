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
use super::units::in_deg;

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

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct HueSection {
    saturation_min: f64,
    value_min: f64,
    coloured_share_min: f64,
    coloured_points_min: i64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ModelSection {
    inner_points: i64,
    outer_points: i64,
    spacing_min_px: i64,
    band_gap_px: i64,
    band_width_px: i64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FitnessSection {
    hue_tolerance_deg: f64,
    unseen: UnseenName,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum UnseenName {
    Mismatch,
    Abstain,
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

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RegionSection {
    area_min_px: i64,
    click_hue_tolerance_deg: f64,
    click_luminance_tolerance: f64,
    click_chroma_min: f64,
    click_area_share_max: f64,
    coloured_share_warn: f64,
    luminance_deviation_warn: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct StatusSection {
    disparity_step_px: f64,
    depth_nodes_max: i64,
    coarse_tilt_step_deg: f64,
    fine_tilt_step_deg: f64,
    blocks_per_side: i64,
    resamples: i64,
    candidates_max: i64,
    fitness_tolerance: f64,
    height_min: f64,
    depth_spread_max: f64,
    depth_spread_sure: f64,
    runner_up_max: f64,
    fitness_sure: f64,
    tilt_spread_sure_deg: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TrackerSection {
    window_margin_px: i64,
    shift_steps_max: i64,
    shift_max_share: f64,
    contrast_min: f64,
    mass_share_min: f64,
    visible_share_min: f64,
    depth_spread_sure: f64,
    height_share_min: f64,
    assure_frames_max: i64,
}

impl PublishedSection {
    /// The parameters in the units of the estimator; values out of range are reported to `check` under `key`.
    pub fn build(&self, key: &str, check: &mut Checker) -> PublishedConfig {
        self.hue.check(&format!("{key}.hue"), check);
        self.model.check(&format!("{key}.model"), check);
        check.number(
            &format!("{key}.fitness.hue_tolerance_deg"),
            self.fitness.hue_tolerance_deg,
            FitnessConfig::HUE_TOLERANCE_DEG,
        );
        self.rmga.check(&format!("{key}.rmga"), check);
        self.region.check(&format!("{key}.region"), check);
        self.status.check(&format!("{key}.status"), check);
        self.tracker.check(&format!("{key}.tracker"), check);
        let config = PublishedConfig {
            hue: HueConfig { saturation_min: self.hue.saturation_min, value_min: self.hue.value_min },
            model: self.model.build(),
            fitness: FitnessConfig {
                hue_tolerance_deg: self.fitness.hue_tolerance_deg,
                unseen: match self.fitness.unseen {
                    UnseenName::Mismatch => Unseen::Mismatch,
                    UnseenName::Abstain => Unseen::Abstain,
                },
            },
            rmga: self.rmga.build(),
            cold_start: ColdStartConfig { generations: whole(self.rmga.generations_cold_start) },
            region: self.region.build(),
            observability: self.status.build(),
            hue_support: HueSupportConfig {
                coloured_share_min: self.hue.coloured_share_min,
                points_min: whole(self.hue.coloured_points_min),
            },
            tracker: self.tracker.build(),
            reference_optimum: false,
        };
        if let (true, Err(error)) = (check.is_clean(), config.validate()) {
            check.refuse(format!("{key}: {error}"));
        }
        config
    }
}

impl HueSection {
    fn check(&self, key: &str, check: &mut Checker) {
        check.number(&format!("{key}.saturation_min"), self.saturation_min, HueConfig::SATURATION_MIN);
        check.number(&format!("{key}.value_min"), self.value_min, HueConfig::VALUE_MIN);
        check.number(
            &format!("{key}.coloured_share_min"),
            self.coloured_share_min,
            HueSupportConfig::COLOURED_SHARE_MIN,
        );
        check.count(&format!("{key}.coloured_points_min"), self.coloured_points_min, HueSupportConfig::POINTS_MIN);
    }
}

impl ModelSection {
    fn check(&self, key: &str, check: &mut Checker) {
        check.count(&format!("{key}.inner_points"), self.inner_points, PhotoModelConfig::INNER_POINTS);
        check.count(&format!("{key}.outer_points"), self.outer_points, PhotoModelConfig::OUTER_POINTS);
        check.count(&format!("{key}.spacing_min_px"), self.spacing_min_px, PhotoModelConfig::SPACING_MIN_PX);
        check.count(&format!("{key}.band_gap_px"), self.band_gap_px, PhotoModelConfig::BAND_GAP_PX);
        check.count(&format!("{key}.band_width_px"), self.band_width_px, PhotoModelConfig::BAND_WIDTH_PX);
    }

    fn build(&self) -> PhotoModelConfig {
        PhotoModelConfig {
            inner_points: whole(self.inner_points),
            outer_points: whole(self.outer_points),
            spacing_min_px: whole(self.spacing_min_px),
            band_gap_px: whole(self.band_gap_px),
            band_width_px: whole(self.band_width_px),
        }
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

impl RegionSection {
    fn check(&self, key: &str, check: &mut Checker) {
        check.count(&format!("{key}.area_min_px"), self.area_min_px, 1..=10_000_000);
        check.number(&format!("{key}.click_hue_tolerance_deg"), self.click_hue_tolerance_deg, 0.0..=180.0);
        check.number(&format!("{key}.click_luminance_tolerance"), self.click_luminance_tolerance, 0.0..=255.0);
        check.number(&format!("{key}.click_chroma_min"), self.click_chroma_min, 0.0..=255.0);
        check.number(&format!("{key}.click_area_share_max"), self.click_area_share_max, 0.001..=1.0);
        check.number(&format!("{key}.coloured_share_warn"), self.coloured_share_warn, 0.0..=1.0);
        check.number(&format!("{key}.luminance_deviation_warn"), self.luminance_deviation_warn, 0.0..=127.0);
    }

    fn build(&self) -> RegionConfig {
        RegionConfig {
            area_min_px: whole(self.area_min_px),
            click_hue_tolerance_deg: self.click_hue_tolerance_deg,
            click_luminance_tolerance: self.click_luminance_tolerance,
            click_chroma_min: self.click_chroma_min,
            click_area_share_max: self.click_area_share_max,
            coloured_share_min: self.coloured_share_warn,
            luminance_deviation_min: self.luminance_deviation_warn,
        }
    }
}

impl TrackerSection {
    fn check(&self, key: &str, check: &mut Checker) {
        check.count(&format!("{key}.window_margin_px"), self.window_margin_px, TrackerConfig::WINDOW_MARGIN_PX);
        check.count(&format!("{key}.shift_steps_max"), self.shift_steps_max, TrackerConfig::SHIFT_STEPS_MAX);
        check.count(&format!("{key}.assure_frames_max"), self.assure_frames_max, TrackerConfig::ASSURE_FRAMES_MAX);
        check.number(&format!("{key}.shift_max_share"), self.shift_max_share, TrackerConfig::SHIFT_MAX_SHARE);
        for (name, value, allowed) in [
            ("contrast_min", self.contrast_min, TrackerConfig::CONTRAST_MIN),
            ("mass_share_min", self.mass_share_min, TrackerConfig::MASS_SHARE_MIN),
            ("visible_share_min", self.visible_share_min, TrackerConfig::VISIBLE_SHARE_MIN),
            ("depth_spread_sure", self.depth_spread_sure, TrackerConfig::DEPTH_SPREAD_SURE),
            ("height_share_min", self.height_share_min, TrackerConfig::HEIGHT_SHARE_MIN),
        ] {
            check.number(&format!("{key}.{name}"), value, allowed);
        }
    }

    fn build(&self) -> TrackerConfig {
        TrackerConfig {
            window_margin_px: whole(self.window_margin_px),
            shift_steps_max: whole(self.shift_steps_max),
            shift_max_share: self.shift_max_share,
            contrast_min: self.contrast_min,
            mass_share_min: self.mass_share_min,
            visible_share_min: self.visible_share_min,
            depth_spread_sure: self.depth_spread_sure,
            height_share_min: self.height_share_min,
            assure_frames_max: whole(self.assure_frames_max),
        }
    }
}

impl StatusSection {
    fn check(&self, key: &str, check: &mut Checker) {
        use ObservabilityConfig as Probe;
        check.count(&format!("{key}.depth_nodes_max"), self.depth_nodes_max, Probe::DEPTH_NODES_MAX);
        check.count(&format!("{key}.blocks_per_side"), self.blocks_per_side, Probe::BLOCKS_PER_SIDE);
        check.count(&format!("{key}.resamples"), self.resamples, Probe::RESAMPLES);
        check.count(&format!("{key}.candidates_max"), self.candidates_max, Probe::CANDIDATES_MAX);
        for (name, value, allowed) in [
            ("disparity_step_px", self.disparity_step_px, Probe::DISPARITY_STEP_PX),
            ("coarse_tilt_step_deg", self.coarse_tilt_step_deg, in_deg(Probe::COARSE_TILT_STEP_RAD)),
            ("fine_tilt_step_deg", self.fine_tilt_step_deg, in_deg(Probe::FINE_TILT_STEP_RAD)),
            ("fitness_tolerance", self.fitness_tolerance, Probe::FITNESS_TOLERANCE),
            ("height_min", self.height_min, Probe::HEIGHT_MIN),
            ("depth_spread_max", self.depth_spread_max, Probe::DEPTH_SPREAD_MAX),
            ("depth_spread_sure", self.depth_spread_sure, Probe::DEPTH_SPREAD_SURE),
            ("runner_up_max", self.runner_up_max, Probe::RUNNER_UP_MAX),
            ("fitness_sure", self.fitness_sure, Probe::FITNESS_SURE),
            ("tilt_spread_sure_deg", self.tilt_spread_sure_deg, in_deg(Probe::TILT_SPREAD_SURE_RAD)),
        ] {
            check.number(&format!("{key}.{name}"), value, allowed);
        }
    }

    fn build(&self) -> ObservabilityConfig {
        ObservabilityConfig {
            disparity_step_px: self.disparity_step_px,
            depth_nodes_max: whole(self.depth_nodes_max),
            coarse_tilt_step_rad: self.coarse_tilt_step_deg.to_radians(),
            fine_tilt_step_rad: self.fine_tilt_step_deg.to_radians(),
            blocks_per_side: whole(self.blocks_per_side),
            resamples: whole(self.resamples),
            candidates_max: whole(self.candidates_max),
            fitness_tolerance: self.fitness_tolerance,
            height_min: self.height_min,
            depth_spread_max: self.depth_spread_max,
            depth_spread_sure: self.depth_spread_sure,
            runner_up_max: self.runner_up_max,
            fitness_sure: self.fitness_sure,
            tilt_spread_sure_rad: self.tilt_spread_sure_deg.to_radians(),
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
