//! `cargo xtask reference`: generates the pages of docs/reference from the source.

use std::fs;

use anyhow::{Context, bail};

use crate::files::{read, write};
use crate::workspace::{Workspace, run_visibly};

/// Generates the reference pages in docs/reference from the source.
///
/// Commands come from the definition of the command line, keys from the built-in setups and their checks of values, messages
/// from the tables of their codes. A test of the orchestrator fails if a page differs from the source.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// Write nothing; fail if a page differs from the source.
    #[arg(long)]
    check: bool,
}

/// # Errors
/// If the program does not build, a page cannot be written, or a page differs with `--check`.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let made = workspace.target_folder()?.join("reference");
    let build = ["run", "--quiet", "--locked", "--package", "pb3dp-orchestrator", "--bin", "pb3dp", "--", "generate"];
    run_visibly(workspace.cargo().args(build).arg(&made))?;
    let pages = workspace.root().join("docs/reference");
    for entry in fs::read_dir(made.join("reference")).context("the program wrote no pages")? {
        let from = entry?.path();
        let to = pages.join(from.file_name().context("a page has no name")?);
        let text = read(&from)?;
        if read(&to).is_ok_and(|present| present == text) {
            continue;
        }
        if args.check {
            bail!("{}: differs from the source; run `cargo xtask reference`", to.display());
        }
        write(&to, &text)?;
        println!("wrote {}", to.display());
    }
    Ok(())
}
