//! Freshness of the lock file of the fuzz targets, which are a workspace of their own: `--locked` refuses a stale one, but only
//! where a nightly compiler builds them.

use std::collections::BTreeSet;

use anyhow::Context;
use serde_json::Value;

use crate::violation::Violation;

/// The lock file.
pub const FILE: &str = "tests/fuzz/Cargo.lock";

/// Compares the dependencies of our packages in the lock file with those of their manifests (`cargo metadata`). Optional ones and
/// those of single platforms are left out: a lock file may have or lack them.
///
/// # Errors
/// If the lock file or the metadata is not as cargo writes them.
pub fn check(lock: &str, metadata: &Value) -> anyhow::Result<Vec<Violation>> {
    let table: toml::Table = lock.parse().context(FILE)?;
    let locked = table.get("package").and_then(toml::Value::as_array).with_context(|| format!("{FILE}: no package"))?;
    let packages = metadata["packages"].as_array().context("`packages` is missing from cargo metadata")?;
    let mut violations = Vec::new();
    for package in locked.iter().filter(|package| package.get("source").is_none()) {
        let name = package.get("name").and_then(toml::Value::as_str).with_context(|| format!("{FILE}: no name"))?;
        let Some(known) = packages.iter().find(|known| known["name"] == name) else { continue };
        let listed = package.get("dependencies").and_then(toml::Value::as_array).into_iter().flatten();
        let listed: BTreeSet<&str> = listed.filter_map(|word| word.as_str()?.split_whitespace().next()).collect();
        let needed = known["dependencies"].as_array().into_iter().flatten();
        let is_needed = |one: &&Value| one["kind"].is_null() && one["optional"] == false && one["target"].is_null();
        let needed = needed.filter(is_needed).filter_map(|one| one["name"].as_str());
        let missing: BTreeSet<&str> = needed.filter(|needed| !listed.contains(needed)).collect();
        if let Some(missing) = missing.first() {
            let message = format!(
                "{name} depends on {missing}, which its entry lacks; run `cargo metadata --manifest-path \
                 tests/fuzz/Cargo.toml --format-version 1` and commit the lock file"
            );
            violations.push(Violation::of(FILE, "fuzz-lock", message));
        }
    }
    Ok(violations)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_dependency_that_the_lock_file_lacks_is_named() {
        let needs = |name: &str, kind: Value| json!({"name": name, "kind": kind, "optional": false, "target": null});
        let metadata = json!({"packages": [{"name": "pb3dp-a", "dependencies": [
            needs("libc", Value::Null), needs("sha2", Value::Null), needs("proptest", json!("dev")),
        ]}]});
        let lock = |dependencies: &str| {
            format!("[[package]]\nname = \"pb3dp-a\"\nversion = \"0.1.0\"\ndependencies = [{dependencies}]\n")
        };
        assert!(check(&lock("\"libc\", \"sha2 0.10.9\""), &metadata).expect("readable").is_empty());
        let found = check(&lock("\"libc\""), &metadata).expect("readable");
        assert!(found[0].message.contains("pb3dp-a depends on sha2"), "{found:?}");
    }
}
