//! The licences of all crates and scripts of others in the program, which each copy of the program must include.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::Context;

use super::linked;
use crate::workspace::Workspace;

/// Folders of scripts of others, with their licences.
const SCRIPTS: [(&str, &str); 1] = [("uPlot 1.6.32: MIT", "crates/record/assets/uplot")];

/// One text: name, version and licence of each crate or script, then its licence files.
pub fn text(workspace: &Workspace) -> anyhow::Result<String> {
    let mut text =
        String::from("pb3dp contains these crates and scripts. Their authors permit it under the licences below.\n");
    for package in linked::crates(workspace)?.iter().filter(|package| package["source"].is_string()) {
        let key = |key: &str| package[key].as_str().unwrap_or("not stated");
        let name = format!("{} {}: {}", key("name"), key("version"), key("license"));
        let folder = Path::new(key("manifest_path")).parent().context("a manifest has no folder")?;
        text += &notice(&name, folder)?;
    }
    for (name, folder) in SCRIPTS {
        text += &notice(name, &workspace.root().join(folder))?;
    }
    Ok(text)
}

fn notice(name: &str, folder: &Path) -> anyhow::Result<String> {
    let mut text = format!("\n{:=<100}\n{name}\n", "");
    for file in licence_files(folder)? {
        let _ = write!(text, "\n{}\n", fs::read_to_string(&file).unwrap_or_default().trim_end());
    }
    Ok(text)
}

fn licence_files(folder: &Path) -> anyhow::Result<Vec<std::path::PathBuf>> {
    let entries = fs::read_dir(folder).with_context(|| format!("cannot list {}", folder.display()))?;
    let is_licence = |path: &std::path::PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default().to_ascii_uppercase();
        path.is_file()
            && ["LICENSE", "LICENCE", "COPYING", "NOTICE", "UNLICENSE"].iter().any(|start| name.starts_with(start))
    };
    let mut files: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).filter(is_licence).collect();
    files.sort();
    Ok(files)
}
