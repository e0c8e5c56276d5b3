//! Licences, sources and banned crates of all dependencies, checked against `deny.toml`.
//!
//! The same rules as `cargo deny check licenses bans sources`, for machines without that tool: CI compiles no tool from source.

use anyhow::Context;
use serde_json::Value;

use crate::not_possible::NotPossible;
use crate::violation::{Violation, conclude};
use crate::workspace::{Workspace, run_visibly};

/// Checks the dependency graph against the RustSec database of known vulnerabilities, where cargo-deny and the database are
/// within reach.
///
/// # Errors
/// A dependency with an advisory, or [`NotPossible`].
pub fn advisories(workspace: &Workspace) -> anyhow::Result<()> {
    if workspace.output_of("cargo-deny", &["--version"]).is_none() {
        return Err(NotPossible::because("no cargo-deny: run `cargo install --locked cargo-deny`"));
    }
    let fetched =
        workspace.cargo().args(["deny", "--locked", "fetch", "db"]).status().context("cannot run cargo-deny")?;
    if !fetched.success() {
        return Err(NotPossible::because("the RustSec database is not within reach, see the message above"));
    }
    run_visibly(workspace.cargo().args(["deny", "--locked", "check", "--disable-fetch", "advisories"]))
}

/// Checks every package of the dependency graph; also runs cargo-deny if it is installed.
///
/// # Errors
/// If a package violates the policy, or `deny.toml` or the metadata cannot be read.
pub fn run(workspace: &Workspace) -> anyhow::Result<()> {
    let text = std::fs::read_to_string(workspace.root().join("deny.toml")).context("cannot read deny.toml")?;
    let policy: Value = toml::from_str(&text).context("in deny.toml")?;
    let metadata = workspace.metadata()?;
    let packages = metadata["packages"].as_array().context("`packages` is missing from cargo metadata")?;
    let violations = packages.iter().flat_map(|package| check(&policy, package, &dependents(&metadata, package)));
    conclude("licences", &format!("{} packages", packages.len()), violations.collect())?;
    if workspace.output_of("cargo-deny", &["--version"]).is_some() {
        run_visibly(workspace.cargo().args(["deny", "--locked", "check", "licenses", "bans", "sources"]))?;
    }
    Ok(())
}

fn items(list: &Value) -> impl Iterator<Item = &Value> {
    list.as_array().into_iter().flatten()
}

/// Names of the packages that depend on a package, with the features of this build.
fn dependents<'a>(metadata: &'a Value, package: &Value) -> Vec<&'a Value> {
    let uses = |node: &&Value| items(&node["deps"]).any(|dep| dep["pkg"] == package["id"]);
    let of = |node: &'a Value| items(&metadata["packages"]).find(|package| package["id"] == node["id"]);
    items(&metadata["resolve"]["nodes"]).filter(uses).filter_map(of).map(|package| &package["name"]).collect()
}

/// The violations of a package that these packages depend on.
fn check(policy: &Value, package: &Value, dependents: &[&Value]) -> Vec<Violation> {
    let text = |key: &str| package[key].as_str().unwrap_or_default();
    let place = format!("package {} {}", text("name"), text("version"));
    let of_package = |entry: &&Value| entry["crate"] == package["name"];
    let mut violations = Vec::new();
    let excepted = items(&policy["licenses"]["exceptions"]).filter(of_package).flat_map(|entry| items(&entry["allow"]));
    let allowed: Vec<&str> = items(&policy["licenses"]["allow"]).chain(excepted).filter_map(Value::as_str).collect();
    // Cargo accepts `/` for OR.
    if !accepts(&text("license").replace('/', " OR "), &allowed) {
        let message = format!("its licence `{}` is not allowed by deny.toml", text("license"));
        violations.push(Violation::of(&place, "licence", message));
    }
    let is_wrapped = |banned: &&Value| {
        let wraps = |of: &&Value| items(&banned["wrappers"]).any(|wrapper| wrapper == *of);
        !dependents.is_empty() && dependents.iter().all(wraps)
    };
    let banned = items(&policy["bans"]["deny"]).filter(of_package).find(|banned| !is_wrapped(banned));
    violations.extend(banned.map(|banned| Violation::of(&place, "banned", banned["reason"].to_string())));
    let mut registries = items(&policy["sources"]["allow-registry"]).filter_map(Value::as_str);
    let source = package["source"].as_str();
    if source.is_some_and(|source| !registries.any(|registry| source == format!("registry+{registry}"))) {
        let message = format!("comes from {}, which deny.toml does not allow", text("source"));
        violations.push(Violation::of(&place, "source", message));
    }
    violations
}

/// Whether these licences satisfy an SPDX expression. One that cannot be read is not satisfied.
fn accepts(expression: &str, allowed: &[&str]) -> bool {
    let expression = expression.trim();
    if let Some((left, right)) = split(expression, " OR ") {
        return accepts(left, allowed) | accepts(right, allowed);
    }
    if let Some((left, right)) = split(expression, " AND ") {
        return accepts(left, allowed) & accepts(right, allowed);
    }
    match expression.strip_prefix('(').and_then(|rest| rest.strip_suffix(')')) {
        Some(inner) => accepts(inner, allowed),
        None => allowed.contains(&expression),
    }
}

/// The parts before and after the first of these words that is in no parentheses.
fn split<'a>(expression: &'a str, word: &str) -> Option<(&'a str, &'a str)> {
    let is_outside = |at: &usize| expression[..*at].matches('(').count() == expression[..*at].matches(')').count();
    let at = expression.match_indices(word).map(|(at, _)| at).find(is_outside)?;
    Some((&expression[..at], &expression[at + word.len()..]))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn rules(package: &Value, dependents: &[&str]) -> Vec<&'static str> {
        let policy = json!({
            "licenses": { "allow": ["MIT", "Zlib"], "exceptions": [{ "crate": "port", "allow": ["MPL-2.0"] }] },
            "bans": { "deny": [{ "crate": "clang-sys", "reason": "needs libclang", "wrappers": ["wrapper"] }] },
            "sources": { "allow-registry": ["https://example.org/index"] },
        });
        let dependents: Vec<Value> = dependents.iter().map(|name| json!(name)).collect();
        let found = check(&policy, package, &dependents.iter().collect::<Vec<_>>());
        found.into_iter().map(|violation| violation.rule).collect()
    }

    fn package(name: &str, licence: &str) -> Value {
        json!({"name": name, "version": "1.0.0", "license": licence, "source": "registry+https://example.org/index"})
    }

    #[test]
    fn expressions_are_judged_as_spdx_says() {
        let allowed = ["MIT", "Zlib", "Unicode-3.0"];
        for (expression, expected) in [
            ("MIT", true),
            ("GPL-3.0", false),
            ("GPL-3.0 OR MIT", true),
            ("MIT AND GPL-3.0", false),
            ("(GPL-3.0 OR MIT) AND Unicode-3.0", true),
            ("(GPL-3.0 OR GPL-2.0) AND (MIT OR Zlib)", false),
            ("GPL-3.0 OR MIT AND GPL-2.0", false),
            ("MIT WITH LLVM-exception", false),
            ("Apache-2.0 WITH LLVM-exception OR Zlib", true),
        ] {
            assert_eq!(accepts(expression, &allowed), expected, "{expression}");
        }
        for broken in ["", "MIT OR", "(MIT", "MIT MIT", "AND MIT", "MIT WITH"] {
            assert!(!accepts(broken, &allowed), "{broken}");
        }
    }

    #[test]
    fn each_rule_catches_its_package() {
        let good = package("a", "GPL-3.0/MIT");
        assert_eq!(rules(&good, &[]), [""; 0]);
        for (key, value, rule) in [
            ("license", json!("GPL-3.0"), "licence"),
            ("license", json!(null), "licence"),
            ("name", json!("clang-sys"), "banned"),
            ("source", json!("git+https://example.org/a"), "source"),
        ] {
            let mut bad = good.clone();
            bad[key] = value;
            assert_eq!(rules(&bad, &["a"]), [rule], "{key}");
        }
    }

    /// Only where nobody else depends on it.
    #[test]
    fn a_banned_crate_is_permitted_in_its_wrapper() {
        let package = package("clang-sys", "MIT");
        assert_eq!(rules(&package, &["wrapper"]), [""; 0]);
        for dependents in [&[][..], &["other"], &["wrapper", "other"]] {
            assert_eq!(rules(&package, dependents), ["banned"], "{dependents:?}");
        }
    }

    #[test]
    fn an_exception_is_for_one_crate_and_one_licence() {
        assert_eq!(rules(&package("port", "MPL-2.0"), &[]), [""; 0]);
        assert_eq!(rules(&package("port", "(MIT OR GPL-3.0) AND MPL-2.0"), &[]), [""; 0]);
        for (name, licence) in [("port", "GPL-3.0"), ("other", "MPL-2.0")] {
            assert_eq!(rules(&package(name, licence), &[]), ["licence"], "{name} {licence}");
        }
    }

    #[test]
    fn the_policy_of_the_project_is_complete() {
        let policy: Value = toml::from_str(include_str!("../../deny.toml")).unwrap();
        let allowed: Vec<&Value> = items(&policy["licenses"]["allow"]).collect();
        assert!(allowed.contains(&&json!("MIT")) && allowed.contains(&&json!("Apache-2.0")));
        assert!(!allowed.iter().any(|licence| licence.to_string().contains("GPL")));
        let banned = || items(&policy["bans"]["deny"]);
        assert!(
            banned().count() > 0 && banned().all(|entry| entry["crate"].is_string() && entry["reason"].is_string())
        );
        assert_eq!(items(&policy["sources"]["allow-registry"]).count(), 1);
    }
}
