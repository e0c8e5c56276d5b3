//! The constants that choose the surface of a region, and where they stand.

use std::path::Path;

use anyhow::Context;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_direct::surface_choice::SurfaceChoice;

/// A constant that the fit may change.
#[derive(Clone, Debug)]
pub struct Constant {
    /// Its name.
    pub name: String,
    /// The values that the fit compares with the present one.
    pub tried: Vec<f64>,
    set: Setter,
    get: fn(&DirectConfig) -> f64,
}

#[derive(Clone, Copy, Debug)]
enum Setter {
    Choice(fn(&mut SurfaceChoice, f64)),
    Config(fn(&mut DirectConfig, f64)),
}

impl Constant {
    /// Sets it in a configuration.
    pub fn set(&self, config: &mut DirectConfig, value: f64) {
        match self.set {
            Setter::Choice(set) => set(&mut config.cold_start.choice, value),
            Setter::Config(set) => set(config, value),
        }
    }
}

/// A constant, its place in the source and its present value.
pub struct Listed {
    /// The constant.
    pub constant: Constant,
    /// File below the root of the workspace, and line.
    pub place: String,
    /// Its value.
    pub value: f64,
}

/// Name, file, words in the line of its value, other values, and how it is read and set.
type OfConfig =
    (&'static str, &'static str, &'static str, &'static [f64], fn(&DirectConfig) -> f64, fn(&mut DirectConfig, f64));

const OF_CONFIG: &[OfConfig] = &[
    (
        "search.noise_grey",
        "search.rs",
        "const NOISE_GREY",
        &[1.4, 2.8],
        |c| c.cold_start.search.noise,
        |c, v| {
            c.cold_start.search.noise = v;
        },
    ),
    (
        "search.penalty_small",
        "search.rs",
        "penalties: Penalties {",
        &[5.0, 12.0],
        |c| c.cold_start.search.penalties.small.into(),
        |c, v| c.cold_start.search.penalties.small = v as _,
    ),
    (
        "search.penalty_large",
        "search.rs",
        "penalties: Penalties {",
        &[28.0, 56.0],
        |c| c.cold_start.search.penalties.large.into(),
        |c, v| c.cold_start.search.penalties.large = v as _,
    ),
    (
        "search.uniqueness",
        "search.rs",
        "winner: WinnerRules {",
        &[0.025, 0.1],
        |c| c.cold_start.search.winner.uniqueness.into(),
        |c, v| c.cold_start.search.winner.uniqueness = v as _,
    ),
    (
        "search.left_right_max",
        "search.rs",
        "winner: WinnerRules {",
        &[0.0, 2.0],
        |c| c.cold_start.search.winner.left_right_max.into(),
        |c, v| c.cold_start.search.winner.left_right_max = v as _,
    ),
    (
        "search.tolerance_px",
        "search.rs",
        "hypotheses: HypothesisRules {",
        &[0.35, 0.7],
        |c| c.cold_start.search.hypotheses.tolerance_px,
        |c, v| c.cold_start.search.hypotheses.tolerance_px = v,
    ),
    (
        "search.distinct_px",
        "search.rs",
        "hypotheses: HypothesisRules {",
        &[0.7, 1.4],
        |c| c.cold_start.search.hypotheses.distinct_px,
        |c, v| c.cold_start.search.hypotheses.distinct_px = v,
    ),
    (
        "search.alias_share",
        "search.rs",
        "alias_share: 0.5",
        &[0.35, 0.7],
        |c| c.cold_start.search.alias_share,
        |c, v| c.cold_start.search.alias_share = v,
    ),
    (
        "search.quick_area_px",
        "cold_start.rs",
        "quick_area_px: 6000",
        &[4000.0, 9000.0],
        |c| c.cold_start.quick_area_px as f64,
        |c, v| c.cold_start.quick_area_px = v as usize,
    ),
    (
        "search.search_area_px",
        "cold_start.rs",
        "search_area_px: 12_000",
        &[8000.0, 18_000.0],
        |c| c.cold_start.search_area_px as f64,
        |c, v| c.cold_start.search_area_px = v as usize,
    ),
    (
        "search.quick_share_min",
        "cold_start.rs",
        "quick_share_min: 0",
        &[0.5, 0.75],
        |c| c.cold_start.quick_share_min,
        |c, v| c.cold_start.quick_share_min = v,
    ),
    (
        "patches.patch_area_px",
        "cold_start.rs",
        "patch_area_px: 24_000",
        &[16_000.0, 36_000.0],
        |c| c.cold_start.patch_area_px as f64,
        |c, v| c.cold_start.patch_area_px = v as usize,
    ),
    (
        "patches.reach",
        "patches.rs",
        "Self { reach: 2",
        &[1.0, 3.0],
        |c| c.cold_start.patches.reach as f64,
        |c, v| c.cold_start.patches.reach = v as usize,
    ),
    (
        "patches.support_px",
        "patches.rs",
        "Self { reach: 2",
        &[0.28, 0.5],
        |c| c.cold_start.patches.support_px,
        |c, v| c.cold_start.patches.support_px = v,
    ),
    (
        "refine.erosion_min_px",
        "photometric/config.rs",
        "erosion_min_px: 1",
        &[0.0, 2.0],
        |c| c.cold_start.refine.erosion_min_px,
        |c, v| c.cold_start.refine.erosion_min_px = v,
    ),
    (
        "refine.place_sigma_px",
        "photometric/config.rs",
        "place_sigma_px: 0",
        &[0.05, 0.18],
        |c| c.cold_start.refine.place_sigma_px,
        |c, v| c.cold_start.refine.place_sigma_px = v,
    ),
    (
        "patches.correlation_min",
        "patches.rs",
        "Self { reach: 2",
        &[0.4, 0.6],
        |c| c.cold_start.patches.correlation_min,
        |c, v| c.cold_start.patches.correlation_min = v,
    ),
    (
        "patches.texture_min",
        "patches.rs",
        "Self { reach: 2",
        &[1.0, 3.0],
        |c| c.cold_start.patches.texture_min,
        |c, v| c.cold_start.patches.texture_min = v,
    ),
    (
        "patches.gradient_half",
        "patches.rs",
        "Self { reach: 2",
        &[0.5, 2.0],
        |c| c.cold_start.patches.gradient_half,
        |c, v| c.cold_start.patches.gradient_half = v,
    ),
    (
        "status.support_min",
        "verdict.rs",
        "support_min: 0.15",
        &[0.1, 0.2],
        |c| c.verdict.support_min,
        |c, v| c.verdict.support_min = v,
    ),
    (
        "status.support_sure_min",
        "verdict.rs",
        "support_sure_min: 0.4",
        &[0.3, 0.5],
        |c| c.verdict.support_sure_min,
        |c, v| c.verdict.support_sure_min = v,
    ),
    (
        "status.alias_score_max",
        "verdict.rs",
        "alias_score_max: 0.85",
        &[0.75, 0.95],
        |c| c.verdict.alias_score_max,
        |c, v| c.verdict.alias_score_max = v,
    ),
    (
        "status.second_share_max",
        "verdict.rs",
        "second_share_max: 0.7",
        &[0.5, 0.8],
        |c| c.verdict.second_share_max,
        |c, v| c.verdict.second_share_max = v,
    ),
    (
        "status.normal_sigma_max_deg",
        "verdict.rs",
        "normal_sigma_max_deg: 5.0",
        &[3.5, 7.0],
        |c| c.verdict.normal_sigma_max_deg,
        |c, v| c.verdict.normal_sigma_max_deg = v,
    ),
];

const SOURCES: &str = "crates/estimation-direct/src";

/// All constants that are fitted, with their places in the sources below `root`.
///
/// # Errors
/// A source file that cannot be read, or that does not contain a constant.
pub fn all(root: &Path) -> anyhow::Result<Vec<Listed>> {
    let config = DirectConfig::default();
    let of_config = OF_CONFIG.iter().map(|&(name, file, words, tried, get, set)| {
        let constant = Constant { name: name.to_owned(), tried: tried.to_vec(), set: Setter::Config(set), get };
        Ok(Listed { place: place(root, file, words)?, value: (constant.get)(&config), constant })
    });
    let of_choice = SurfaceChoice::ALL.iter().map(|known| {
        let constant = Constant {
            name: known.name.to_owned(),
            tried: known.tried.to_vec(),
            set: Setter::Choice(known.set),
            get: |_| f64::NAN,
        };
        let words = format!("    {} = ", known.name);
        Ok(Listed {
            place: place(root, "surface_choice.rs", &words)?,
            value: (known.get)(&config.cold_start.choice),
            constant,
        })
    });
    of_config.chain(of_choice).collect()
}

fn place(root: &Path, file: &str, words: &str) -> anyhow::Result<String> {
    let path = root.join(SOURCES).join(file);
    let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let line = text.lines().position(|line| line.contains(words));
    let line = line.with_context(|| format!("{} has no line with {words:?}", path.display()))?;
    Ok(format!("{SOURCES}/{file}:{}", line + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A default that changes leaves its line here behind, and the benchmark would fail after a minute of work.
    #[test]
    fn every_constant_has_its_line() {
        let listed = all(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")).unwrap();
        assert!(listed.len() > 70, "{}", listed.len());
        assert!(listed.iter().all(|constant| constant.value.is_finite()));
    }
}
