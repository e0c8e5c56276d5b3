//! The software bill of materials: which crates the program contains, in CycloneDX 1.5 (ECMA-424) as JSON.

use std::collections::BTreeMap;

use anyhow::Context;
use serde_json::{Value, json};

use super::linked::{self, PROGRAM};
use crate::workspace::Workspace;

/// The bill as text, the same for the same sources: it has no time and no serial number.
///
/// # Errors
/// If cargo does not list the crates, or Cargo.lock cannot be read.
pub fn text(workspace: &Workspace) -> anyhow::Result<String> {
    let crates = linked::crates(workspace)?;
    let lock = std::fs::read_to_string(workspace.root().join("Cargo.lock")).context("cannot read Cargo.lock")?;
    let bill = bill(&crates, &checksums(&lock)?)?;
    Ok(serde_json::to_string_pretty(&bill)? + "\n")
}

/// SHA-256 of the packages from the registry, by name and version.
fn checksums(lock: &str) -> anyhow::Result<BTreeMap<(String, String), String>> {
    let table: toml::Table = lock.parse().context("in Cargo.lock")?;
    let packages = table.get("package").and_then(toml::Value::as_array).context("Cargo.lock lists no package")?;
    let text = |package: &toml::Value, key: &str| Some(package.get(key)?.as_str()?.to_owned());
    let of_one = |package| Some(((text(package, "name")?, text(package, "version")?), text(package, "checksum")?));
    Ok(packages.iter().filter_map(of_one).collect())
}

fn bill(crates: &[Value], checksums: &BTreeMap<(String, String), String>) -> anyhow::Result<Value> {
    let is_program = |package: &&Value| package["name"] == PROGRAM;
    let program = crates.iter().find(is_program).context("the program is not among its crates")?;
    let others = crates.iter().filter(|package| !is_program(package));
    let components: Vec<Value> = others.map(|package| component("library", package, checksums)).collect();
    Ok(json!({
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": { "component": component("application", program, checksums) },
        "components": components,
    }))
}

fn component(kind: &str, package: &Value, checksums: &BTreeMap<(String, String), String>) -> Value {
    let key = |key: &str| package[key].as_str().unwrap_or_default().to_owned();
    let url = format!("pkg:cargo/{}@{}", key("name"), key("version"));
    let mut component = json!({
        "type": kind,
        "bom-ref": url,
        "name": key("name"),
        "version": key("version"),
        "purl": url,
        // Cargo accepts `/` for OR; SPDX does not.
        "licenses": [{ "expression": key("license").replace('/', " OR ") }],
    });
    if let Some(checksum) = checksums.get(&(key("name"), key("version"))) {
        component["hashes"] = json!([{ "alg": "SHA-256", "content": checksum }]);
    }
    component
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bill_names_each_crate_with_licence_and_checksum() {
        let lock = "[[package]]\nname = \"a\"\nversion = \"1.2.3\"\nchecksum = \"00ff\"\n\
            [[package]]\nname = \"pb3dp-orchestrator\"\nversion = \"0.1.0\"\n";
        let crates = [
            json!({"name": "a", "version": "1.2.3", "license": "MIT/Apache-2.0"}),
            json!({"name": PROGRAM, "version": "0.1.0", "license": "MIT OR Apache-2.0"}),
        ];
        let bill = bill(&crates, &checksums(lock).expect("a lock file")).expect("a bill");
        assert_eq!(bill["metadata"]["component"]["purl"], "pkg:cargo/pb3dp-orchestrator@0.1.0");
        let [only] = &bill["components"].as_array().expect("components")[..] else { panic!("{bill}") };
        assert_eq!(only["licenses"][0]["expression"], "MIT OR Apache-2.0");
        assert_eq!(only["hashes"][0]["content"], "00ff");
        assert!(bill["metadata"]["component"].get("hashes").is_none());
        assert!(super::bill(&crates[..1], &BTreeMap::new()).is_err(), "a bill without its program");
    }
}
