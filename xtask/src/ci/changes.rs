//! Effect of a change: files since the merge base, mapped to packages and to all packages that depend on them.

use std::collections::BTreeSet;

use crate::packages::{self, Package};
use crate::workspace::{SourceFile, Workspace};

/// Environment variable that gives the base.
const BASE: &str = "PB3DP_CI_BASE";
/// Usual bases of a change; the first existing one counts.
const TRUNKS: [&str; 2] = ["origin/main", "main"];

/// Effect of a change.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Changes {
    /// All checks are needed, for this reason.
    Everything(String),
    /// Some packages are affected.
    Packages {
        /// Packages whose product may behave differently: they changed, or depend on changed ones.
        changed: BTreeSet<String>,
        /// These, and packages whose tests or examples use them.
        tested: BTreeSet<String>,
        /// The base commit of the change.
        base: String,
    },
}

impl Changes {
    /// Whether the tests or the product of one of these packages are affected.
    pub fn touch(&self, packages: &[&str]) -> bool {
        match self {
            Self::Everything(_) => true,
            Self::Packages { tested, .. } => packages.iter().any(|package| tested.contains(*package)),
        }
    }

    /// Whether the product of this package is affected.
    pub fn change(&self, package: &str) -> bool {
        match self {
            Self::Everything(_) => true,
            Self::Packages { changed, .. } => changed.contains(package),
        }
    }

    /// As text.
    pub fn text(&self) -> String {
        match self {
            Self::Everything(reason) => format!("all checks run: {reason}"),
            Self::Packages { tested, base, .. } if tested.is_empty() => format!("since {base} no package is touched"),
            Self::Packages { tested, base, .. } => {
                let names: Vec<&str> = tested.iter().map(String::as_str).collect();
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
    let packages = packages::of(&workspace.metadata()?)?;
    let sources = workspace.texts(&[".rs"])?;
    let readers = |page: &str| readers(page, &sources, &packages);
    Ok(touched(changed.lines().chain(new.lines()), &packages, readers, base))
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

/// Whether a file is written for people. Programs may read it too: [`readers`].
fn is_prose(path: &str) -> bool {
    path.ends_with(".md") || path.starts_with("docs/images/") || path.starts_with("LICENSE")
}

/// The package of a file.
fn owner<'a>(path: &str, packages: &'a [Package]) -> Option<&'a Package> {
    packages.iter().filter(|package| path.starts_with(&package.folder)).max_by_key(|package| package.folder.len())
}

/// The packages that may read a page, because their code names it or its folder (tests compare pages with the program).
fn readers(page: &str, sources: &[SourceFile], packages: &[Package]) -> BTreeSet<String> {
    let folder = page.rsplit_once('/').map_or(page, |(folder, _)| folder);
    let names = |line: &str| {
        let is_code = !line.trim_start().starts_with("//");
        is_code && (line.contains(page) || (folder.contains('/') && line.contains(&format!("{folder}\""))))
    };
    let own = owner(page, packages).map(|package| package.name.clone());
    let reading = sources.iter().filter(|file| file.text.lines().any(names));
    reading.filter_map(|file| Some(owner(&file.path, packages)?.name.clone())).chain(own).collect()
}

fn touched<'a>(
    paths: impl Iterator<Item = &'a str>,
    packages: &[Package],
    readers: impl Fn(&str) -> BTreeSet<String>,
    base: String,
) -> Changes {
    let (mut changed, mut tested) = (BTreeSet::new(), BTreeSet::new());
    for path in paths {
        if is_prose(path) {
            tested.extend(readers(path));
            continue;
        }
        match owner(path, packages) {
            // The project commands define the checks: a change of them may affect every result.
            Some(package) if package.name != "xtask" => changed.insert(package.name.clone()),
            _ => return Changes::Everything(format!("{path} affects every package")),
        };
    }
    loop {
        let depends = |package: &&Package| package.dependencies.iter().any(|name| changed.contains(name));
        let more: Vec<String> = packages.iter().filter(depends).map(|package| package.name.clone()).collect();
        let before = changed.len();
        changed.extend(more);
        if changed.len() == before {
            break;
        }
    }
    let uses = |package: &&Package| package.test_dependencies.iter().any(|name| changed.contains(name));
    tested.extend(packages.iter().filter(uses).map(|package| package.name.clone()));
    tested.extend(changed.iter().cloned());
    Changes::Packages { changed, tested, base }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn six() -> Vec<Package> {
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let package = |name: &str, folder: &str, dependencies: &[&str], test_dependencies: &[&str]| Package {
            name: name.to_owned(),
            folder: folder.to_owned(),
            dependencies: owned(dependencies),
            test_dependencies: owned(test_dependencies),
        };
        vec![
            package("pb3dp-geometry", "crates/geometry/", &["nalgebra"], &[]),
            package("pb3dp-servo", "crates/servo/", &["pb3dp-geometry"], &[]),
            package("pb3dp-record", "crates/record/", &["pb3dp-geometry"], &[]),
            package("system-tests", "tests/", &[], &["pb3dp-servo"]),
            package("pb3dp-benchmarks", "crates/benchmarks/", &["pb3dp-record"], &["system-tests"]),
            package("xtask", "xtask/", &[], &[]),
        ]
    }

    fn sources() -> Vec<SourceFile> {
        let file = |path: &str, text: &str| SourceFile { path: path.to_owned(), text: text.to_owned() };
        vec![
            file("crates/servo/src/lib.rs", "// docs/limits.md\nread(\"docs/servo.md\")"),
            file("crates/record/tests/main.rs", "let pages = \"../../docs/reference\";"),
        ]
    }

    /// Names of the changed packages and of those that only their tests use, if not everything is affected.
    fn names(paths: &[&str]) -> Option<[Vec<String>; 2]> {
        let readers = |page: &str| readers(page, &sources(), &six());
        match touched(paths.iter().copied(), &six(), readers, "abc".to_owned()) {
            Changes::Everything(_) => None,
            Changes::Packages { changed, tested, .. } => {
                let more = tested.difference(&changed).cloned().collect();
                Some([changed.into_iter().collect(), more])
            }
        }
    }

    #[test]
    fn a_package_is_touched_with_everything_above_it() {
        let found = names(&["crates/servo/src/law/hybrid.rs"]).unwrap();
        assert_eq!(found, [vec!["pb3dp-servo".to_owned()], vec!["system-tests".to_owned()]]);
        let [changed, more] = names(&["crates/geometry/src/lib.rs"]).unwrap();
        assert_eq!((changed.len(), more), (4, vec!["system-tests".to_owned()]));
    }

    #[test]
    fn a_page_touches_the_packages_that_read_it() {
        let readers = |page: &str| {
            let [changed, read] = names(&[page]).unwrap();
            assert_eq!(changed, [""; 0], "{page}");
            read
        };
        assert_eq!(readers("README.md"), [""; 0]);
        assert_eq!(readers("docs/limits.md"), [""; 0]);
        assert_eq!(readers("docs/servo.md"), ["pb3dp-servo"]);
        assert_eq!(readers("docs/reference/keys.md"), ["pb3dp-record"]);
        assert_eq!(readers("crates/geometry/README.md"), ["pb3dp-geometry"]);
    }

    #[test]
    fn what_belongs_to_no_package_touches_everything() {
        for path in ["Cargo.lock", "configs/sim.toml", ".ci/run", "xtask/src/ci.rs", "crates/new/src/lib.rs"] {
            assert_eq!(names(&["crates/servo/src/lib.rs", path]), None, "{path}");
        }
    }
}
