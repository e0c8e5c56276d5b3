//! `cargo xtask tidy`: style rules beyond rustfmt and clippy.

mod configs;
mod dependencies;
mod deploy;
mod layout;
mod links;
mod markdown;
mod method_table;
mod named_items;
mod plain_words;
mod routes;
mod rust;
mod summary;
mod test_files;
mod text;

use crate::violation::{Violation, conclude};
use crate::workspace::{SourceFile, Workspace};

/// Extensions of our text files.
const TEXT_ENDINGS: [&str; 14] = [
    ".rs", ".toml", ".md", ".json", ".yaml", ".yml", ".urdf", ".sh", ".html", ".svg", ".ci/run", ".rules", ".service",
    ".conf",
];

/// Checks style rules beyond rustfmt and clippy.
///
/// Files, tests, Markdown with its links, routes, configurations, manifests, words: the table of rules is in CONTRIBUTING.md. Clippy checks
/// the length of functions, and unfinished code.
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
    let mut violations = layout::top_level(&files);
    for file in &texts {
        violations.extend(check_text(file, &files));
    }
    violations.extend(dependencies::check(&texts));
    violations.extend(method_table::check(&texts));
    violations.extend(summary::check(&texts));
    violations.extend(named_items::check(&texts));
    violations.extend(routes::check(&texts));
    violations.extend(test_files::check(&texts));
    violations.extend(plain_words::check(workspace, &texts)?);
    conclude("tidy", &format!("{} files, {} of them text", files.len(), texts.len()), violations)
}

fn check_text(file: &SourceFile, files: &[String]) -> Vec<Violation> {
    let SourceFile { path, text } = file;
    let mut violations = text::check(path, text);
    if path.ends_with(".rs") {
        violations.extend(rust::check(path, text));
        violations.extend(layout::crate_docs(path, text));
    }
    if path.ends_with(".md") {
        violations.extend(markdown::check(path, text));
        violations.extend(links::check(path, text, files));
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
