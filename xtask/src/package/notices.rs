//! The licences of all crates in the program, which each copy of the program must include.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::Context;
use serde_json::Value;

use crate::workspace::Workspace;

/// One text: name, version and licence of each crate, then its licence files.
pub fn text(workspace: &Workspace) -> anyhow::Result<String> {
    let tree = ["tree", "--locked", "--package", "pb3dp-orchestrator", "--edges", "normal", "--prefix", "none"];
    let output = workspace.cargo().args(tree).args(["--format", "{p}"]).output().context("cannot run `cargo tree`")?;
    let listed = String::from_utf8(output.stdout).context("`cargo tree` printed no text")?;
    let linked: BTreeSet<(&str, &str)> = listed.lines().filter_map(name_and_version).collect();
    let metadata = workspace.metadata()?;
    let packages = metadata["packages"].as_array().context("`packages` is missing from cargo metadata")?;
    let is_linked = |package: &&Value| {
        let key = |key: &str| package[key].as_str().unwrap_or_default();
        package["source"].is_string() && linked.contains(&(key("name"), key("version")))
    };
    let mut text = String::from("pb3dp contains these crates. Their authors permit it under the licences below.\n");
    for package in packages.iter().filter(is_linked) {
        let key = |key: &str| package[key].as_str().unwrap_or("not stated");
        let _ = write!(text, "\n{:=<100}\n{} {}: {}\n", "", key("name"), key("version"), key("license"));
        let folder = Path::new(key("manifest_path")).parent().context("a manifest has no folder")?;
        for file in licence_files(folder)? {
            let _ = write!(text, "\n{}\n", fs::read_to_string(&file).unwrap_or_default().trim_end());
        }
    }
    Ok(text)
}

/// `serde v1.0.228 (proc-macro)`.
fn name_and_version(line: &str) -> Option<(&str, &str)> {
    let mut words = line.split_whitespace();
    Some((words.next()?, words.next()?.strip_prefix('v')?))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_cargo_tree_give_name_and_version() {
        assert_eq!(name_and_version("serde v1.0.228"), Some(("serde", "1.0.228")));
        assert_eq!(name_and_version("serde_derive v1.0.228 (proc-macro) (*)"), Some(("serde_derive", "1.0.228")));
        assert_eq!(name_and_version(""), None);
    }
}
