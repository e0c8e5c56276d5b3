//! Effect of a change: files since the merge base, mapped to packages and to all packages that depend on them.

use std::collections::BTreeSet;

use anyhow::Context;
use serde_json::Value;

use crate::workspace::Workspace;

/// Environment variable that gives the base.
const BASE: &str = "PB3DP_CI_BASE";
/// Usual bases of a change; the first existing one counts.
const TRUNKS: [&str; 2] = ["origin/main", "main"];

/// Effect of a change.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Changes {
    /// All checks are needed, for this reason.
    Everything(String),
    /// These packages changed, or depend on changed ones.
    Packages {
        /// Names of the packages.
        names: BTreeSet<String>,
        /// The base commit of the change.
        base: String,
    },
}

impl Changes {
    /// Whether one of these packages is affected.
    pub fn touch(&self, packages: &[&str]) -> bool {
        match self {
            Self::Everything(_) => true,
            Self::Packages { names, .. } => packages.iter().any(|package| names.contains(*package)),
        }
    }

    /// As text.
    pub fn text(&self) -> String {
        match self {
            Self::Everything(reason) => format!("all checks run: {reason}"),
            Self::Packages { names, base } if names.is_empty() => format!("since {base} no package is touched"),
            Self::Packages { names, base } => {
                let names: Vec<&str> = names.iter().map(String::as_str).collect();
                format!("touched since {base}: {}", names.join(", "))
            }
        }
    }
}

/// The change in the work tree and in the commits since its base.
///
/// # Errors
/// Those of [`Workspace::metadata`].
pub fn find(workspace: &Workspace) -> anyhow::Result<Changes> {
    let Some(base) = base(workspace) else {
        let reason = format!("no base is known (this is {}; set {BASE} to give one)", TRUNKS[0]);
        return Ok(Changes::Everything(reason));
    };
    let changed = workspace.output_of("git", &["diff", "--name-only", &base]);
    let new = workspace.output_of("git", &["ls-files", "--others", "--exclude-standard"]);
    let (Some(changed), Some(new)) = (changed, new) else {
        return Ok(Changes::Everything(format!("git cannot list the changes since {base}")));
    };
    let packages = packages(&workspace.metadata()?)?;
    Ok(touched(changed.lines().chain(new.lines()), &packages, base))
}

/// The base commit of the change; `None` if unknown.
fn base(workspace: &Workspace) -> Option<String> {
    let short = |name: &str| workspace.output_of("git", &["rev-parse", "--short", name]);
    if let Some(name) = std::env::var_os(BASE) {
        return short(&format!("{}^{{commit}}", name.to_string_lossy()));
    }
    let head = short("HEAD")?;
    let trunk = TRUNKS.into_iter().find(|trunk| short(trunk).is_some())?;
    let base = short(&workspace.output_of("git", &["merge-base", "HEAD", trunk])?)?;
    // On the trunk itself only uncommitted changes are known.
    let is_dirty = !workspace.output_of("git", &["status", "--porcelain"])?.is_empty();
    (base != head || is_dirty).then_some(base)
}

/// A package of the workspace.
#[derive(Clone, Debug)]
struct Package {
    name: String,
    /// Folder inside the workspace, with a slash at the end.
    folder: String,
    /// Names of all its dependencies and those of its tests.
    dependencies: Vec<String>,
}

fn packages(metadata: &Value) -> anyhow::Result<Vec<Package>> {
    let root = metadata["workspace_root"].as_str().context("the output of cargo metadata has no workspace")?;
    let all = metadata["packages"].as_array().context("the output of cargo metadata has no packages")?;
    let package = |package: &Value| {
        let manifest = package["manifest_path"].as_str()?;
        let folder = manifest.strip_prefix(root)?.trim_start_matches('/').strip_suffix("Cargo.toml")?.to_owned();
        let dependencies =
            package["dependencies"].as_array()?.iter().filter_map(|d| Some(d["name"].as_str()?.to_owned()));
        Some(Package { name: package["name"].as_str()?.to_owned(), folder, dependencies: dependencies.collect() })
    };
    Ok(all.iter().filter(|p| p["source"].is_null()).filter_map(package).collect())
}

/// Whether no program reads a file, only people.
fn is_prose(path: &str) -> bool {
    path.ends_with(".md") || path.starts_with("docs/images/") || path.starts_with("LICENSE")
}

fn touched<'a>(paths: impl Iterator<Item = &'a str>, packages: &[Package], base: String) -> Changes {
    let mut names = BTreeSet::new();
    for path in paths.filter(|path| !is_prose(path)) {
        let owner = packages.iter().filter(|package| path.starts_with(&package.folder));
        match owner.max_by_key(|package| package.folder.len()) {
            // The project commands define the checks: a change of them may affect every result.
            Some(package) if package.name != "xtask" => names.insert(package.name.clone()),
            _ => return Changes::Everything(format!("{path} affects every package")),
        };
    }
    loop {
        let depends = |package: &&Package| package.dependencies.iter().any(|name| names.contains(name));
        let more: Vec<String> = packages.iter().filter(depends).map(|package| package.name.clone()).collect();
        let before = names.len();
        names.extend(more);
        if names.len() == before {
            return Changes::Packages { names, base };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn three() -> Vec<Package> {
        let package = |name: &str, folder: &str, dependencies: &[&str]| Package {
            name: name.to_owned(),
            folder: folder.to_owned(),
            dependencies: dependencies.iter().map(|name| (*name).to_owned()).collect(),
        };
        vec![
            package("pb3dp-geometry", "crates/geometry/", &["nalgebra"]),
            package("pb3dp-servo", "crates/servo/", &["pb3dp-geometry"]),
            package("pb3dp-record", "crates/record/", &["pb3dp-geometry"]),
            package("system-tests", "tests/", &["pb3dp-servo"]),
            package("xtask", "xtask/", &[]),
        ]
    }

    fn names(paths: &[&str]) -> Option<Vec<String>> {
        match touched(paths.iter().copied(), &three(), "abc".to_owned()) {
            Changes::Everything(_) => None,
            Changes::Packages { names, .. } => Some(names.into_iter().collect()),
        }
    }

    #[test]
    fn a_package_is_touched_with_everything_above_it() {
        assert_eq!(names(&["crates/servo/src/law/hybrid.rs"]).unwrap(), ["pb3dp-servo", "system-tests"]);
        assert_eq!(names(&["crates/geometry/src/lib.rs"]).unwrap().len(), 4);
        assert_eq!(names(&["README.md", "docs/servo.md"]).unwrap(), [""; 0]);
    }

    #[test]
    fn what_belongs_to_no_package_touches_everything() {
        for path in ["Cargo.lock", "configs/sim.toml", ".ci/run", "xtask/src/ci.rs", "crates/new/src/lib.rs"] {
            assert_eq!(names(&["crates/servo/src/lib.rs", path]), None, "{path}");
        }
    }

    #[test]
    fn packages_are_those_of_the_workspace() {
        let metadata = serde_json::json!({
            "workspace_root": "/w",
            "packages": [
                { "name": "serde", "source": "registry", "manifest_path": "/r/serde/Cargo.toml", "dependencies": [] },
                { "name": "pb3dp-servo", "source": null, "manifest_path": "/w/crates/servo/Cargo.toml",
                  "dependencies": [{ "name": "serde" }] },
            ],
        });
        let found = packages(&metadata).unwrap();
        assert_eq!((found.len(), found[0].folder.as_str()), (1, "crates/servo/"));
    }
}
