//! Outcomes of the cases with given values of the constants; measured once per set of values, then kept.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::thread;

use anyhow::Context;
use pb3dp_estimation::rig_watch::RigWatch;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};

use super::constants::Constant;
use crate::real::cases::{self, Prepared};
use crate::real::ours::answer_of;
use crate::real::score::{Answer, CaseFacts, Grade};

/// Changed constants: index and index of the value tried; sorted.
pub type Setting = Vec<(usize, usize)>;

/// What became of a case.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// There is a plane.
    pub answered: bool,
    /// It passes.
    pub passed: bool,
    /// The status is `ok`.
    pub ok: bool,
    /// The status is `ok`, but the plane is off by more than 3 standard deviations and by more than 5 degrees or 1 % of the
    /// depth.
    pub wrong_ok: bool,
    /// The depth is within two standard deviations; `None` without one.
    pub depth_covered: Option<bool>,
    /// The same for the normal.
    pub normal_covered: Option<bool>,
    /// Share of the true disparities within 1 px of the plane.
    pub within_1px: Option<f64>,
    /// The plane compared with the truth.
    pub answer: Option<Answer>,
}

/// An answer is wrong if it is off by more than three standard deviations, the truth's included, and by more than 1 % of the
/// depth or 5 degrees.
const WRONG_SIGMAS: f64 = 3.0;
const WRONG_Z_RATIO: f64 = 0.01;
const WRONG_NORMAL_DEG: f64 = 5.0;
const COVERED_SIGMAS: f64 = 2.0;

impl Outcome {
    fn of(facts: &CaseFacts, status: Status, answer: Option<Answer>) -> Self {
        let Some(found) = answer else { return Self::default() };
        let z_sigmas = found.z_sigma_m.map(|own| found.z_m.abs() / own.hypot(facts.sigma.z_m));
        let normal_sigmas = found.normal_sigma_rad.map(|own| found.normal_rad / own.hypot(facts.sigma.normal_rad));
        let beyond = |sigmas: Option<f64>| sigmas.is_none_or(|sigmas| sigmas > WRONG_SIGMAS);
        let z_is_wrong = found.z_m.abs() > WRONG_Z_RATIO * facts.z_m && beyond(z_sigmas);
        let normal_is_wrong =
            facts.is_planar() && found.normal_rad.to_degrees() > WRONG_NORMAL_DEG && beyond(normal_sigmas);
        let ok = status == Status::Ok;
        let covered = |sigmas: Option<f64>| sigmas.map(|sigmas| sigmas <= COVERED_SIGMAS);
        Self {
            answered: true,
            passed: facts.grade(found.z_m, found.normal_rad) == Grade::Pass,
            ok,
            wrong_ok: ok && (z_is_wrong || normal_is_wrong),
            depth_covered: covered(z_sigmas),
            normal_covered: covered(normal_sigmas).filter(|_| facts.is_planar()),
            within_1px: found.map.map(|(_, share)| share),
            answer,
        }
    }
}

/// Outcomes of all cases per setting; measures those that are missing.
pub struct Measurements {
    folders: Vec<PathBuf>,
    constants: Vec<Constant>,
    known: BTreeMap<Setting, Vec<Outcome>>,
}

impl Measurements {
    /// Nothing is measured yet.
    pub fn new(folders: Vec<PathBuf>, constants: Vec<Constant>) -> Self {
        Self { folders, constants, known: BTreeMap::new() }
    }

    /// All settings that change one constant of `base`.
    pub fn neighbours(&self, base: &Setting) -> Vec<Setting> {
        let mut found = Vec::new();
        for (constant, known) in self.constants.iter().enumerate() {
            for value in 0..known.tried.len() {
                let mut setting: Setting = base.iter().copied().filter(|(index, _)| *index != constant).collect();
                setting.push((constant, value));
                setting.sort_unstable();
                if setting != *base {
                    found.push(setting);
                }
            }
        }
        found
    }

    /// The outcomes with a setting that was measured.
    pub fn of(&self, setting: &Setting) -> &[Outcome] {
        self.known.get(setting).map_or(&[], Vec::as_slice)
    }

    /// Measures the settings that are not known yet, on all cores.
    ///
    /// # Errors
    /// A case that cannot be loaded.
    pub fn measure(&mut self, settings: &[Setting]) -> anyhow::Result<()> {
        let mut missing: Vec<Setting> =
            settings.iter().filter(|setting| !self.known.contains_key(*setting)).cloned().collect();
        missing.sort();
        missing.dedup();
        if missing.is_empty() {
            return Ok(());
        }
        let configs: Vec<DirectConfig> = missing.iter().map(|setting| self.config(setting)).collect();
        let threads = thread::available_parallelism().map_or(1, usize::from);
        let per_thread = self.folders.len().div_ceil(threads);
        let (folders, configs) = (&self.folders, &configs);
        let parts: Vec<anyhow::Result<Vec<Vec<Outcome>>>> = thread::scope(|scope| {
            let started: Vec<_> = folders
                .chunks(per_thread)
                .map(|part| scope.spawn(move || part.iter().map(|folder| of_case(folder, configs)).collect()))
                .collect();
            started
                .into_iter()
                .map(|part| part.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
                .collect()
        });
        let mut cases = Vec::new();
        for part in parts {
            cases.extend(part?);
        }
        for (index, setting) in missing.into_iter().enumerate() {
            self.known.insert(setting, cases.iter().map(|outcomes| outcomes[index]).collect());
        }
        Ok(())
    }

    fn config(&self, setting: &Setting) -> DirectConfig {
        let mut config = DirectConfig::default();
        for &(constant, value) in setting {
            let constant = &self.constants[constant];
            constant.set(&mut config, constant.tried[value]);
        }
        config
    }
}

/// The outcomes of one case for all configurations.
fn of_case(folder: &Path, configs: &[DirectConfig]) -> anyhow::Result<Vec<Outcome>> {
    let case = cases::load(folder)?.context("the truth is missing")?;
    let mut watch = RigWatch::new(&case.rig)?;
    watch.look(&case.images.left, &case.images.right)?;
    configs
        .iter()
        .map(|config| {
            let mut estimator = DirectEstimator::new(&case.rig, config.clone())?;
            if let Some(errors) = watch.errors() {
                estimator.correct_rig(watch.rig(), errors)?;
            }
            answer(&case, &mut estimator).with_context(|| case.facts.name.clone())
        })
        .collect()
}

fn answer(case: &Prepared, estimator: &mut DirectEstimator) -> anyhow::Result<Outcome> {
    let mut request = EstimateRequest::of_target(&case.images.left, &case.images.right, &case.region, &case.range);
    let estimate = estimator.answer(&mut request)?;
    Ok(Outcome::of(&case.facts, estimate.status, answer_of(case, &estimate)))
}
