//! How the method fares on scenes that its constants have not seen: each scene is left out once, all constants that choose the
//! surface are fitted on the other scenes, and the result is judged on the scene that was left out.
//!
//! [`constants`] lists what is fitted, [`outcomes`] measures the cases with given values, [`fit`] chooses the values, and
//! [`report`] writes the tables.

mod constants;
mod fit;
mod outcomes;
mod report;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use anyhow::{Context, bail};
use pb3dp_benchmarks::circumstances::Circumstances;
use pb3dp_benchmarks::page::{save, text, update};
use pb3dp_record::dataset::{Case, load_case};

use self::fit::Fold;
use self::outcomes::Measurements;
use super::score::CaseFacts;
use super::table::failures;
use super::{Args, cases, peers};

/// Options of the measurement on scenes left out.
#[derive(clap::Args)]
pub struct LeftOutArgs {
    /// Refits the constants that choose the surface once for each scene, without that scene, and judges them on it.
    #[arg(long, requires = "cases")]
    leave_one_scene_out: bool,
    /// With --leave-one-scene-out: a further folder with cases; may be repeated.
    #[arg(long, value_name = "DIR", requires = "leave_one_scene_out")]
    more_cases: Vec<PathBuf>,
    /// With --leave-one-scene-out: the largest number of constants that a fit may change; 0: only measures the present values.
    #[arg(long, value_name = "NUMBER", default_value_t = 3, requires = "leave_one_scene_out")]
    changes: usize,
    /// With --leave-one-scene-out: judges on the scenes of crates/benchmarks/held_back.txt only, with the present values. Open
    /// them once.
    #[arg(long, requires = "leave_one_scene_out")]
    open_held_back: bool,
}

impl LeftOutArgs {
    /// Whether the measurement is wanted.
    pub fn is_wanted(&self) -> bool {
        self.leave_one_scene_out
    }
}

const HELD_BACK: &str = include_str!("../../held_back.txt");
const KEPT: &str = "out/bench/left_out.json";
const PAGE: &str = "docs/benchmarks/left_out.md";

/// Measures, fits, prints the tables and saves them.
///
/// # Errors
/// A folder or file that cannot be used, by name.
pub fn run(args: &Args, folder: &Path) -> anyhow::Result<()> {
    let options = &args.left_out;
    let mut found = Vec::new();
    for folder in std::iter::once(folder).chain(options.more_cases.iter().map(PathBuf::as_path)) {
        found.extend(cases::find(folder, args.filter.as_deref())?);
    }
    let chosen = choose(found, options.open_held_back)?;
    eprintln!("{} cases of {} scenes", chosen.len(), count_of(chosen.iter().map(|case| case.scene.as_str())));
    let constants = constants::all();
    let facts = chosen.iter().map(|case| facts(&case.folder)).collect::<anyhow::Result<Vec<_>>>()?;
    let folders: Vec<PathBuf> = chosen.iter().map(|case| case.folder.clone()).collect();
    let mut measured = Measurements::new(folders, constants.clone());
    let changes = if options.open_held_back { 0 } else { options.changes };
    let scenes: Vec<&str> = chosen.iter().map(|case| case.scene.as_str()).collect();
    let fitted = fit::fit(&mut measured, &scenes, changes)?;
    let mut entries = report::entries(&facts, &fitted);
    entries.extend(peers::entries_of_files(&args.peer_results, &facts)?);
    let circumstances = Circumstances::of(&args.root);
    let kept = report::kept(&entries, &constants, circumstances.to_json());
    let parts = report::parts(&kept, &constants, &fitted, (changes, &circumstances.line()));
    print!("{}", text(&parts));
    if args.failures {
        eprint!("{}", failures(entries.iter().filter(|entry| entry.method == report::LEFT_OUT)));
    }
    if options.open_held_back || args.filter.is_some() {
        return Ok(());
    }
    save(&args.root.join(KEPT), &format!("{kept:#}\n"))?;
    if args.no_docs { Ok(()) } else { update(&args.root.join(PAGE), &parts) }
}

/// Whether a case stays closed, to judge the structure of the method once.
pub fn is_held_back(case: &Case) -> bool {
    HELD_BACK.lines().any(|line| line == scene_of(case))
}

fn scene_of(case: &Case) -> &str {
    case.scene.as_deref().unwrap_or(&case.name)
}

/// A case and the name of its scene.
struct Chosen {
    folder: PathBuf,
    scene: String,
}

/// The cases with a truth that is not marked as doubtful; without the scenes held back, or only those.
fn choose(found: Vec<PathBuf>, held_back: bool) -> anyhow::Result<Vec<Chosen>> {
    let mut chosen = Vec::new();
    for folder in found {
        let case = load_case(&folder)?;
        let is_doubtful = case.other_keys.iter().any(|key| key == "doubtful");
        if case.truth.is_some() && !is_doubtful && is_held_back(&case) == held_back {
            chosen.push(Chosen { folder, scene: Fold::name_of(scene_of(&case)) });
        }
    }
    if chosen.is_empty() {
        bail!("no case has a `truth` that is not doubtful, outside of the scenes held back");
    }
    Ok(chosen)
}

fn count_of<'a>(names: impl Iterator<Item = &'a str>) -> usize {
    names.collect::<BTreeSet<_>>().len()
}

fn facts(folder: &Path) -> anyhow::Result<Rc<CaseFacts>> {
    Ok(cases::load(folder)?.context("the truth is missing")?.facts)
}
