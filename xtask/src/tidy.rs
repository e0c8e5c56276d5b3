//! `cargo xtask tidy`: style rules beyond rustfmt and clippy.

mod configs;
mod dependencies;
mod deploy;
mod exceptions;
mod layout;
mod links;
mod markdown;
mod method_table;
mod plain_words;
mod routes;
mod rust;
mod summary;
mod test_files;
mod text;

use crate::violation::{Violation, conclude};
use crate::workspace::{SourceFile, Workspace};

use exceptions::Exceptions;

/// Extensions of our text files.
const TEXT_ENDINGS: [&str; 14] = [
    ".rs", ".toml", ".md", ".json", ".yaml", ".yml", ".urdf", ".sh", ".html", ".svg", ".ci/run", ".rules", ".service",
    ".conf",
];

/// Checks style rules beyond rustfmt and clippy.
///
/// * Rust: files of at most 600 lines, functions of at most 70 (exceptions only in xtask/tidy-exceptions.toml, and they may
///   only shrink), no `todo!`, `unimplemented!`, `dbg!`, no ignored tests, no tests that expect a panic by attribute.
/// * Tests: each file in a folder `tests` belongs to a test program.
/// * Text: no absolute paths of one machine, no paths outside the repository, reminders only as `TODO(name, issue)`.
/// * Markdown: one sentence per line; all links and paths exist.
/// * docs/: every page is exactly once in the table of contents of the site, docs/SUMMARY.md; each file of a route in docs/routes.md
///   exists and is linked to the next one.
/// * configs/: every TOML file, every robot description and every file of configs/deploy parses; docs/parameters.md lists each parameter of
///   configs/estimator.toml with the same default.
/// * Layout: the top level contains exactly the agreed entries; every package uses the workspace's lints, version and
///   dependencies, no profile of a release has debug assertions, and its root file starts with a `//!` text; every third-party dependency is used, and has its reason in
///   docs/adr/0002-dependencies.md.
///
/// Each violation is printed as `file:line: [rule] remedy`.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {}

/// # Errors
/// If a rule is violated or a file cannot be read.
pub fn run(workspace: &Workspace, _: &Args) -> anyhow::Result<()> {
    let files = workspace.files()?;
    let texts = workspace.texts(&TEXT_ENDINGS)?;
    let mut exceptions = Exceptions::load(workspace)?;
    let mut violations = layout::top_level(&files);
    for file in &texts {
        violations.extend(check_text(file, &files, &mut exceptions));
    }
    violations.extend(dependencies::check(&texts));
    violations.extend(method_table::check(&texts));
    violations.extend(summary::check(&texts));
    violations.extend(routes::check(&texts));
    violations.extend(test_files::check(&texts));
    violations.extend(plain_words::check(workspace, &texts)?);
    violations.extend(exceptions.unused());
    conclude("tidy", &format!("{} files, {} of them text", files.len(), texts.len()), violations)
}

fn check_text(file: &SourceFile, files: &[String], exceptions: &mut Exceptions) -> Vec<Violation> {
    let SourceFile { path, text } = file;
    let mut violations = text::check(path, text);
    if path.ends_with(".rs") {
        violations.extend(rust::check(path, text, exceptions));
        violations.extend(layout::crate_docs(path, text));
    }
    if path.ends_with(".md") {
        violations.extend(markdown::check(path, text));
        violations.extend(links::check(path, text, files));
    }
    if path == "Cargo.toml" {
        violations.extend(layout::profiles(path, text));
    }
    if path.ends_with("/Cargo.toml") {
        violations.extend(layout::manifest(path, text));
        violations.extend(layout::readme(path, text, files));
    }
    if path.starts_with("configs/") {
        violations.extend(configs::check(path, text));
    }
    violations
}
