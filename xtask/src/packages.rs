//! The packages of the workspace and their dependencies, from `cargo metadata`.

use anyhow::Context;
use serde_json::Value;

/// One of our packages.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Package {
    /// Its name.
    pub name: String,
    /// Folder inside the workspace, with a slash at the end.
    pub folder: String,
    /// Names of its dependencies, also of those of its build script.
    pub dependencies: Vec<String>,
    /// Names of the dependencies of its tests and examples.
    pub test_dependencies: Vec<String>,
}

/// The packages of the workspace, also those of others in `hal/vendor`.
///
/// # Errors
/// If the output of cargo lacks a key.
pub fn of(metadata: &Value) -> anyhow::Result<Vec<Package>> {
    let all = metadata["packages"].as_array().context("`packages` is missing from cargo metadata")?;
    let ours = all.iter().filter(|package| package["source"].is_null());
    ours.map(|package| read(package, metadata).with_context(|| format!("{} lacks a key", package["id"]))).collect()
}

fn read(package: &Value, metadata: &Value) -> Option<Package> {
    let manifest = package["manifest_path"].as_str()?.strip_prefix(metadata["workspace_root"].as_str()?)?;
    let folder = manifest.trim_start_matches('/').strip_suffix("Cargo.toml")?.to_owned();
    let (for_tests, others): (Vec<&Value>, _) =
        package["dependencies"].as_array()?.iter().partition(|dependency| dependency["kind"] == "dev");
    let names = |list: Vec<&Value>| list.iter().filter_map(|entry| Some(entry["name"].as_str()?.to_owned())).collect();
    let (dependencies, test_dependencies) = (names(others), names(for_tests));
    Some(Package { name: package["name"].as_str()?.to_owned(), folder, dependencies, test_dependencies })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packages_are_those_of_the_workspace() {
        let metadata = serde_json::json!({
            "workspace_root": "/w",
            "packages": [
                { "name": "serde", "source": "registry", "manifest_path": "/r/serde/Cargo.toml", "dependencies": [] },
                { "name": "pb3dp-servo", "source": null, "manifest_path": "/w/crates/servo/Cargo.toml",
                  "dependencies": [{ "name": "serde", "kind": null }, { "name": "tempfile", "kind": "dev" }] },
            ],
        });
        let expected = Package {
            name: "pb3dp-servo".to_owned(),
            folder: "crates/servo/".to_owned(),
            dependencies: vec!["serde".to_owned()],
            test_dependencies: vec!["tempfile".to_owned()],
        };
        assert_eq!(of(&metadata).unwrap(), [expected]);
        assert!(of(&serde_json::json!({ "packages": [{ "source": null, "name": "a" }] })).is_err());
    }
}
