//! Accuracy on real stereo cases: our methods and other tools on pairs with known truth.
//!
//! Every method gets the same input: both images, the region, the calibration and the search range of the case. [`score`]
//! defines the pass criteria; [`table`] computes the rows, and [`page`] has tables and figure.

pub mod cases;
mod first_poses;
mod left_out;
mod ours;
mod page;
mod peers;
mod score;
mod sequences;
mod table;

use std::path::{Path, PathBuf};

use anyhow::bail;
use pb3dp_benchmarks::circumstances::{Circumstances, check_root};
use pb3dp_benchmarks::page::{save, text, update};
use pb3dp_estimation::estimator::Method;
use pb3dp_record::dataset::load_case;
use serde_json::json;

use self::score::Entry;

/// The boards of this repository, used without `--cases`.
const OWN_CASES: &str = "tests/data/cases";
const KEPT: &str = "out/bench/real.json";
const PAGE: &str = "docs/benchmarks/real.md";
const FIGURE: &str = "docs/benchmarks/real.svg";

/// Options.
#[derive(clap::Args)]
pub struct Args {
    /// Folder with cases (docs/dataset-format.md); default: the few boards in this repository.
    #[arg(long, value_name = "DIR")]
    cases: Option<PathBuf>,
    /// Folder with `peers.py`, which runs other tools on the same cases; it prints one JSON line per case and tool.
    #[arg(long, value_name = "DIR")]
    peers: Option<PathBuf>,
    /// The Python that runs `peers.py`; it needs OpenCV and NumPy.
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    python: PathBuf,
    /// Output lines of an earlier run of `peers.py` on these cases; replaces a new run.
    #[arg(long, value_name = "FILE", conflicts_with = "peers")]
    peer_results: Vec<PathBuf>,
    /// Our methods to measure, separated by commas; default: all.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    methods: Vec<Method>,
    /// Only cases whose name contains this.
    #[arg(long, value_name = "TEXT")]
    filter: Option<String>,
    /// Calls per case and method; the time is their median.
    #[arg(long, value_name = "NUMBER", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    repeat: u32,
    /// One JSON line per case and method instead of the tables.
    #[arg(long)]
    json: bool,
    /// Also list every case that one of our methods did not pass.
    #[arg(long)]
    failures: bool,
    #[command(flatten)]
    left_out: left_out::LeftOutArgs,
    #[command(flatten)]
    sequences: sequences::SequenceArgs,
    /// Compares the first poses of tracks on planar cases with their stated standard deviations, instead of measuring methods.
    #[arg(long)]
    first_poses: bool,
    /// Does not change docs/benchmarks.
    #[arg(long)]
    no_docs: bool,
    /// Root folder of the workspace, where results are saved.
    #[arg(long, value_name = "DIR", default_value = ".")]
    root: PathBuf,
}

/// Runs our methods and, if given, other tools, and saves the results.
///
/// # Errors
/// A folder or file that cannot be used, by name; an unknown method; a failure of the other tools.
pub fn run(args: &Args) -> anyhow::Result<()> {
    check_root(&args.root)?;
    if args.sequences.is_wanted() {
        return sequences::run(args);
    }
    let folder = args.cases.clone().unwrap_or_else(|| args.root.join(OWN_CASES));
    if args.cases.is_none() {
        eprintln!("no --cases given: measuring on the boards of this repository, {OWN_CASES}");
    }
    if args.left_out.is_wanted() {
        return left_out::run(args, &folder);
    }
    if args.first_poses {
        return first_poses::run(args, &folder);
    }
    let peers_script = args.peers.as_deref().map(peers::script_in).transpose()?;
    let entries = measure(args, &folder, peers_script.as_deref())?;
    let circumstances = Circumstances::of(&args.root);
    let parts = page::parts(&entries, &command_line(args), &circumstances.line());
    if args.json {
        entries.iter().for_each(|entry| println!("{}", entry.to_json()));
    } else {
        print!("{}", text(&parts));
    }
    if args.failures {
        eprint!("{}", table::failures(entries.iter()));
    }
    let kept = json!({
        "bench": "real",
        "cases": args.cases.as_ref().map_or(OWN_CASES, |_| "given"),
        "where": circumstances.to_json(),
        "summary": table::groups(&entries).into_iter().flat_map(|(_, rows)| rows).collect::<Vec<_>>(),
        "results": entries.iter().map(Entry::to_json).collect::<Vec<_>>(),
    });
    save(&args.root.join(KEPT), &format!("{kept:#}\n"))?;
    // The page is that of given cases.
    if args.no_docs || args.cases.is_none() || args.filter.is_some() {
        return Ok(());
    }
    save(&args.root.join(FIGURE), &page::figure(&entries))?;
    update(&args.root.join(PAGE), &parts)
}

/// Runs our methods and then the other tools on all cases.
fn measure(args: &Args, folder: &Path, peers_script: Option<&Path>) -> anyhow::Result<Vec<Entry>> {
    let found = cases::find(folder, args.filter.as_deref())?;
    // The other tools run first, so that a missing Python package is reported at once.
    let peers = peers_script.map(|script| peers::run(&args.python, script, folder, args.repeat)).transpose()?;
    let methods = if args.methods.is_empty() { Method::ALL.to_vec() } else { args.methods.clone() };
    let (mut entries, mut facts) = (Vec::new(), Vec::new());
    for (index, case) in found.iter().enumerate() {
        if args.cases.is_some() && left_out::is_held_back(&load_case(case)?) {
            continue;
        }
        let Some(prepared) = cases::load(case)? else {
            eprintln!("{}: no truth, skipped", case.display());
            continue;
        };
        entries.extend(methods.iter().map(|method| ours::run(&prepared, *method, args.repeat)));
        facts.push(prepared.facts);
        if (index + 1) % 25 == 0 {
            eprintln!("{} of {} cases", index + 1, found.len());
        }
    }
    if facts.is_empty() {
        bail!("no case in {} has a `truth`: nothing to compare with", folder.display());
    }
    if let Some(lines) = peers {
        entries.extend(peers::entries(&lines, &facts, "peers.py")?);
    }
    entries.extend(peers::entries_of_files(&args.peer_results, &facts)?);
    Ok(entries)
}

/// The command that writes the page again, without the folders of this machine.
fn command_line(args: &Args) -> String {
    let mut words = vec!["cargo xtask bench real --cases DIR".to_owned()];
    if args.peers.is_some() {
        words.push("--peers DIR".into());
    }
    if !args.peer_results.is_empty() {
        words.push("--peer-results FILE".into());
    }
    if !args.methods.is_empty() {
        words.push(format!("--methods {}", args.methods.iter().map(|m| m.name()).collect::<Vec<_>>().join(",")));
    }
    if args.repeat != 3 {
        words.push(format!("--repeat {}", args.repeat));
    }
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    fn args(words: &[&str]) -> Args {
        Cli::try_parse_from(std::iter::once("real").chain(words.iter().copied())).expect("valid").args
    }

    fn root() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
    }

    #[test]
    fn wrong_paths_are_named() {
        let check = |words: &[&str], parts: &[&str]| {
            let mut given = args(words);
            if given.root == Path::new(".") {
                given.root = root();
            }
            let message = format!("{:#}", run(&given).expect_err("refused"));
            parts.iter().for_each(|part| assert!(message.contains(part), "{message:?} must contain {part:?}"));
        };
        check(&["--root", "no/such/clone"], &["no/such/clone", "Cargo.toml"]);
        check(&["--cases", "no/such/cases"], &["no/such/cases"]);
        check(&["--peers", "no/such/peers"], &["no/such/peers", "peers.py"]);
        check(&["--filter", "no-such-name"], &["no-such-name"]);
        check(
            &["--filter", "bb201", "--peer-results", "no/lines.jsonl", "--methods", "published"],
            &["no/lines.jsonl"],
        );
        assert!(Cli::try_parse_from(["real", "--methods", "magic"]).is_err());
    }

    #[test]
    fn the_command_on_the_page_names_no_folder_of_this_machine() {
        let given = args(&["--cases", "/somewhere/cases", "--peers", "/else/peers", "--methods", "published"]);
        assert_eq!(command_line(&given), "cargo xtask bench real --cases DIR --peers DIR --methods published");
    }
}
