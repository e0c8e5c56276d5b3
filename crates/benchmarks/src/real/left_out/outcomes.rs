//! Outcomes of the cases with given values of the constants; measured once per set of values, then kept.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::thread;

use anyhow::Context;
use pb3dp_benchmarks::parallel::in_parallel;
use pb3dp_estimation::rig_watch::RigWatch;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};

use super::constants::{Constant, set};
use crate::real::cases::{self, Prepared};
use crate::real::ours::answer_of;
use crate::real::score::{Answer, CaseFacts, Entry, Grade, Maker};

/// Changed constants: index and index of the value tried; sorted.
pub type Setting = Vec<(usize, usize)>;

/// What became of a case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    status: Status,
    answer: Option<Answer>,
    /// What it costs, see [`loss`].
    pub loss: f64,
}

impl Outcome {
    /// As a result of these values of the constants.
    pub fn entry(&self, facts: &Rc<CaseFacts>, values: &str) -> Entry {
        let status = Some(self.status.as_str());
        Entry { status, answer: self.answer, ..Entry::new(facts, values, Maker::Ours) }
    }
}

/// A wrong `ok` costs this many missed passes.
const WRONG_OK_LOSS: f64 = 5.0;
/// A correct plane that is not `ok` is of less use.
const UNSURE_LOSS: f64 = 0.2;

/// What a result costs; non-planar regions, which are judged by their disparities and not by a plane, cost nothing.
fn loss(entry: &Entry) -> f64 {
    match () {
        () if !entry.case.is_planar() => 0.0,
        () if entry.is_wrong_ok() => WRONG_OK_LOSS,
        () if entry.grade() != Some(Grade::Pass) => 1.0,
        () if !entry.is_ok() => UNSURE_LOSS,
        () => 0.0,
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
        let work = |_: &mut (), index: usize| of_case(&self.folders[index], &configs);
        let cases = in_parallel(self.folders.len(), threads, || Ok(()), work)?;
        for (index, setting) in missing.into_iter().enumerate() {
            self.known.insert(setting, cases.iter().map(|outcomes| outcomes[index]).collect());
        }
        Ok(())
    }

    fn config(&self, setting: &Setting) -> DirectConfig {
        let mut config = DirectConfig::default();
        for &(constant, value) in setting {
            set(&mut config, constant, self.constants[constant].tried[value]);
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
    let mut request = EstimateRequest::new_target(&case.images.left, &case.images.right, &case.region, &case.range);
    let estimate = estimator.answer(&mut request)?;
    let mut outcome = Outcome { status: estimate.status, answer: answer_of(case, &estimate), loss: 0.0 };
    outcome.loss = loss(&outcome.entry(&case.facts, ""));
    Ok(outcome)
}

#[cfg(test)]
mod tests {
    use pb3dp_record::metrics::Group;

    use super::*;
    use crate::real::score::tests::{answer, case, entry};

    #[test]
    fn a_wrong_answer_that_is_sure_costs_most() {
        let known = case("a", Group::Small, (0.1, 0.1));
        let passed = entry(&known, "m", Some(answer(1.0, 1.0)));
        let unsure = Entry { status: Some("weak-tilt"), ..passed.clone() };
        let wrong = entry(&known, "m", Some(answer(50.0, 1.0)));
        let losses = [passed, unsure, entry(&known, "m", None), wrong].map(|entry| loss(&entry));
        assert_eq!(losses, [0.0, UNSURE_LOSS, 1.0, WRONG_OK_LOSS]);
        assert_eq!(loss(&entry(&case("b", Group::NonPlanar, (0.1, 0.1)), "m", None)), 0.0);
    }
}
