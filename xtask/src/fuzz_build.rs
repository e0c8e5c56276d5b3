//! `cargo xtask fuzz-build`: checks that the fuzz targets build.

use crate::toolchains::nightly;
use crate::workspace::{Workspace, run_visibly};

/// Builds the fuzz targets of `tests/fuzz` with the nightly compiler, so that interface changes cannot break them unnoticed.
///
/// Runs nothing: the bodies of all targets also run as seeded tests in `cargo xtask test`, on the stable compiler. To fuzz, see
/// CONTRIBUTING.md. Needs the nightly toolchain (`rustup toolchain install nightly --profile minimal`), a C++ compiler, and
/// the network once, for libfuzzer-sys; the check is skipped without a nightly toolchain. Does not need cargo-fuzz.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {}

const MANIFEST: &str = "tests/fuzz/Cargo.toml";

/// # Errors
/// [`NotPossible`](crate::not_possible::NotPossible) without the nightly toolchain; otherwise if a target does not build.
pub fn run(workspace: &Workspace) -> anyhow::Result<()> {
    let mut command = nightly(workspace, None)?;
    command.args(["build", "--locked", "--bins", "--manifest-path", MANIFEST]);
    // cargo-fuzz sets `fuzzing`. The targets also link without its sanitizers and counters.
    command.env("RUSTFLAGS", "--cfg fuzzing").env("CARGO_TARGET_DIR", workspace.target_folder()?.join("fuzz"));
    run_visibly(&mut command)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    const FOLDER: &str = "tests/fuzz/fuzz_targets/";

    /// The call by which a seeded test names its fuzz target.
    const SEEDED: &str = "survives_seeded_bytes(";

    /// The name of the function that a text calls as `abuse::NAME(bytes)` or passes as `abuse::NAME)`.
    fn body(text: &str) -> Option<&str> {
        let (_, rest) = text.rsplit_once("abuse::")?;
        rest.split(|c: char| !(c.is_alphanumeric() || c == '_')).next()
    }

    /// Target and body of each call of [`SEEDED`].
    fn seeded(text: &str) -> impl Iterator<Item = (String, String)> {
        text.split(SEEDED).skip(1).filter_map(|call| {
            let (arguments, _) = call.split_once(';')?;
            let target = arguments.trim_start().strip_prefix('"')?.split('"').next()?;
            Some((target.to_owned(), body(arguments)?.to_owned()))
        })
    }

    #[test]
    fn every_fuzz_target_runs_as_a_seeded_test() {
        let workspace = Workspace::find().unwrap();
        let sources = workspace.texts(&[".rs"]).unwrap();
        let targets: BTreeSet<(String, String)> = sources
            .iter()
            .filter_map(|source| {
                let target = source.path.strip_prefix(FOLDER)?.strip_suffix(".rs")?;
                Some((target.to_owned(), body(&source.text).expect("a fuzz target calls `abuse::NAME`").to_owned()))
            })
            .collect();
        let in_tests = |path: &str| path.contains("/tests/") && !path.starts_with("tests/fuzz/");
        let tested = sources.iter().filter(|source| in_tests(&source.path)).flat_map(|source| seeded(&source.text));
        assert!(targets.len() >= 5, "{targets:?}");
        assert_eq!(tested.collect::<BTreeSet<_>>(), targets, "seeded tests (left), fuzz targets (right)");
    }

    #[test]
    fn every_file_of_a_fuzz_target_is_built() {
        let workspace = Workspace::find().unwrap();
        let manifest = std::fs::read_to_string(workspace.root().join(MANIFEST)).unwrap();
        for path in workspace.files().unwrap() {
            let Some(file) = path.strip_prefix("tests/fuzz/").filter(|_| path.starts_with(FOLDER)) else { continue };
            assert!(manifest.contains(&format!("path = \"{file}\"")), "{MANIFEST} does not name {file}");
        }
    }
}
