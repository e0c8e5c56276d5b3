//! Licences, sources and banned crates of all dependencies, checked against `deny.toml`.
//!
//! The same rules as `cargo deny check licenses bans sources`, without that tool; reads the allowed values from `deny.toml`.

use anyhow::{Context, bail};
use serde_json::Value;

use crate::not_possible::NotPossible;
use crate::violation::{Violation, conclude};
use crate::workspace::{Workspace, run_visibly};

/// The rules that `deny.toml` states.
#[derive(Debug)]
struct Policy {
    licences: Vec<String>,
    /// Additional licences for single crates.
    exceptions: Vec<(String, Vec<String>)>,
    banned: Vec<Banned>,
    registries: Vec<String>,
}

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

/// A crate that no package may depend on, but for the wrappers.
#[derive(Debug)]
struct Banned {
    name: String,
    reason: String,
    wrappers: Vec<String>,
}

/// Names of the packages that depend on a package, with the features of this build.
fn dependents<'a>(metadata: &'a Value, package: &Value) -> Vec<&'a str> {
    let items = |value: &'a Value| value.as_array().into_iter().flatten();
    let name_of = |id: &Value| {
        items(&metadata["packages"]).find(|package| package["id"] == *id).and_then(|package| package["name"].as_str())
    };
    let uses = |node: &&Value| node["deps"].as_array().into_iter().flatten().any(|dep| dep["pkg"] == package["id"]);
    items(&metadata["resolve"]["nodes"]).filter(uses).filter_map(|node| name_of(&node["id"])).collect()
}

/// Checks every package of the dependency graph; also runs cargo-deny if it is installed.
///
/// # Errors
/// If a package violates the policy, or `deny.toml` or the metadata cannot be read.
pub fn run(workspace: &Workspace) -> anyhow::Result<()> {
    let text = std::fs::read_to_string(workspace.root().join("deny.toml")).context("cannot read deny.toml")?;
    let policy = Policy::parse(&text).context("in deny.toml")?;
    let metadata = workspace.metadata()?;
    let packages = metadata["packages"].as_array().context("`packages` is missing from cargo metadata")?;
    let dependents = |package: &Value| dependents(&metadata, package);
    let violations = packages.iter().flat_map(|package| policy.check(package, &dependents(package))).collect();
    conclude("licences", &format!("{} packages", packages.len()), violations)?;
    if workspace.output_of("cargo-deny", &["--version"]).is_some() {
        run_visibly(workspace.cargo().args(["deny", "--locked", "check", "licenses", "bans", "sources"]))?;
    }
    Ok(())
}

impl Policy {
    fn parse(text: &str) -> anyhow::Result<Self> {
        let table: toml::Table = text.parse()?;
        let list = |section: &str, key: &str| -> anyhow::Result<Vec<toml::Value>> {
            let list = table.get(section).and_then(|section| section.get(key)).and_then(toml::Value::as_array);
            list.cloned().with_context(|| format!("[{section}] {key} is missing"))
        };
        let words = |section: &str, key: &str| -> anyhow::Result<Vec<String>> {
            let word = |value: toml::Value| value.as_str().map(str::to_owned);
            let words: Option<Vec<String>> = list(section, key)?.into_iter().map(word).collect();
            words.with_context(|| format!("[{section}] {key}: every entry must be a string"))
        };
        let mut banned = Vec::new();
        for entry in list("bans", "deny")? {
            let key = |key: &str| entry.get(key).and_then(toml::Value::as_str).map(str::to_owned);
            let wrappers = entry.get("wrappers").and_then(toml::Value::as_array);
            banned.push(Banned {
                name: key("crate").context("[bans] deny: an entry has no `crate`")?,
                reason: key("reason").context("[bans] deny: an entry has no `reason`")?,
                wrappers: wrappers.into_iter().flatten().filter_map(toml::Value::as_str).map(str::to_owned).collect(),
            });
        }
        let mut exceptions = Vec::new();
        for entry in list("licenses", "exceptions")? {
            let name = entry.get("crate").and_then(toml::Value::as_str);
            let licences = entry.get("allow").and_then(toml::Value::as_array);
            let (Some(name), Some(licences)) = (name, licences) else {
                bail!("[licenses] exceptions: an entry needs `crate` and `allow`");
            };
            let licences = licences.iter().filter_map(toml::Value::as_str).map(str::to_owned).collect();
            exceptions.push((name.to_owned(), licences));
        }
        let (licences, registries) = (words("licenses", "allow")?, words("sources", "allow-registry")?);
        Ok(Self { licences, exceptions, banned, registries })
    }

    /// The violations of a package that these packages depend on.
    fn check(&self, package: &Value, dependents: &[&str]) -> Vec<Violation> {
        let text = |key: &str| package[key].as_str();
        let place = format!("package {} {}", text("name").unwrap_or("?"), text("version").unwrap_or("?"));
        let mut violations = Vec::new();
        let exceptions = self.exceptions.iter().filter(|(name, _)| Some(name.as_str()) == text("name"));
        let excepted: Vec<&str> = exceptions.flat_map(|(_, licences)| licences).map(String::as_str).collect();
        match text("license").map(|licence| self.accepts(licence, &excepted)) {
            Some(Ok(true)) => {}
            Some(Ok(false)) => {
                let message =
                    format!("its licence `{}` is not allowed by deny.toml", text("license").unwrap_or_default());
                violations.push(Violation::of(&place, "licence", message));
            }
            Some(Err(error)) => violations.push(Violation::of(&place, "licence", format!("{error:#}"))),
            None => violations.push(Violation::of(&place, "licence", "has no SPDX licence in its manifest")),
        }
        let is_wrapped = |banned: &Banned| {
            !dependents.is_empty() && dependents.iter().all(|of| banned.wrappers.iter().any(|wrapper| wrapper == of))
        };
        let banned = self.banned.iter().find(|banned| Some(banned.name.as_str()) == text("name"));
        if let Some(banned) = banned.filter(|banned| !is_wrapped(banned)) {
            violations.push(Violation::of(&place, "banned", banned.reason.clone()));
        }
        let known = |source: &str| self.registries.iter().any(|registry| source == format!("registry+{registry}"));
        if let Some(source) = text("source").filter(|source| !known(source)) {
            violations.push(Violation::of(
                &place,
                "source",
                format!("comes from {source}, which deny.toml does not allow"),
            ));
        }
        violations
    }

    /// Whether allowed licences, and those excepted for this crate, satisfy an SPDX expression.
    fn accepts(&self, expression: &str, excepted: &[&str]) -> anyhow::Result<bool> {
        let spaced = expression.replace('(', " ( ").replace(')', " ) ").replace('/', " OR ");
        let words: Vec<&str> = spaced.split_whitespace().collect();
        let mut at = 0;
        let accepted = self.any_of(&words, excepted, &mut at).with_context(|| format!("licence `{expression}`"))?;
        if at < words.len() {
            bail!("licence `{expression}`: unexpected `{}`", words[at]);
        }
        Ok(accepted)
    }

    fn any_of(&self, words: &[&str], excepted: &[&str], at: &mut usize) -> anyhow::Result<bool> {
        let mut accepted = self.all_of(words, excepted, at)?;
        while words.get(*at) == Some(&"OR") {
            *at += 1;
            accepted |= self.all_of(words, excepted, at)?;
        }
        Ok(accepted)
    }

    fn all_of(&self, words: &[&str], excepted: &[&str], at: &mut usize) -> anyhow::Result<bool> {
        let mut accepted = self.one(words, excepted, at)?;
        while words.get(*at) == Some(&"AND") {
            *at += 1;
            accepted &= self.one(words, excepted, at)?;
        }
        Ok(accepted)
    }

    fn one(&self, words: &[&str], excepted: &[&str], at: &mut usize) -> anyhow::Result<bool> {
        let word = *words.get(*at).context("ends too early")?;
        *at += 1;
        match word {
            "(" => {
                let accepted = self.any_of(words, excepted, at)?;
                if words.get(*at) != Some(&")") {
                    bail!("`)` is missing");
                }
                *at += 1;
                Ok(accepted)
            }
            ")" | "OR" | "AND" | "WITH" => bail!("`{word}` found, but a licence is expected"),
            name if words.get(*at) == Some(&"WITH") => {
                let exception = words.get(*at + 1).context("no exception after `WITH`")?;
                *at += 2;
                Ok(self.allows(&format!("{name} WITH {exception}"), excepted))
            }
            name => Ok(self.allows(name, excepted)),
        }
    }

    fn allows(&self, licence: &str, excepted: &[&str]) -> bool {
        self.licences.iter().map(String::as_str).chain(excepted.iter().copied()).any(|allowed| allowed == licence)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn policy() -> Policy {
        let text = "[licenses]\nallow = [\"MIT\", \"Zlib\", \"Unicode-3.0\"]\n\
            exceptions = [{ crate = \"port\", allow = [\"MPL-2.0\"] }]\n\
            [bans]\ndeny = [{ crate = \"clang-sys\", reason = \"needs libclang\", wrappers = [\"wrapper\"] }]\n\
            [sources]\nallow-registry = [\"https://example.org/index\"]\n";
        Policy::parse(text).expect("valid")
    }

    #[test]
    fn expressions_are_judged_as_spdx_says() {
        for (expression, expected) in [
            ("MIT", true),
            ("GPL-3.0", false),
            ("GPL-3.0 OR MIT", true),
            ("MIT AND GPL-3.0", false),
            ("(GPL-3.0 OR MIT) AND Unicode-3.0", true),
            ("GPL-3.0 OR MIT AND GPL-2.0", false),
            ("Apache-2.0/MIT", true),
            ("MIT WITH LLVM-exception", false),
            ("Apache-2.0 WITH LLVM-exception OR Zlib", true),
        ] {
            assert_eq!(policy().accepts(expression, &[]).expect("readable"), expected, "{expression}");
        }
        for broken in ["", "MIT OR", "(MIT", "MIT MIT", "AND MIT", "MIT WITH"] {
            assert!(policy().accepts(broken, &[]).is_err(), "{broken}");
        }
    }

    #[test]
    fn each_rule_catches_its_package() {
        let good =
            json!({"name": "a", "version": "1.0.0", "license": "MIT", "source": "registry+https://example.org/index"});
        assert_eq!(policy().check(&good, &[]), []);
        for (key, value, rule) in [
            ("license", json!("GPL-3.0"), "licence"),
            ("license", json!(null), "licence"),
            ("name", json!("clang-sys"), "banned"),
            ("source", json!("git+https://example.org/a"), "source"),
        ] {
            let mut bad = good.clone();
            bad[key] = value;
            let rules: Vec<_> = policy().check(&bad, &["a"]).into_iter().map(|v| v.rule).collect();
            assert_eq!(rules, [rule], "{key}");
        }
    }

    /// Only where nobody else depends on it.
    #[test]
    fn a_banned_crate_is_permitted_in_its_wrapper() {
        let package = json!({"name": "clang-sys", "version": "1.0.0", "license": "MIT", "source": "registry+https://example.org/index"});
        assert_eq!(policy().check(&package, &["wrapper"]), []);
        for dependents in [&[][..], &["other"], &["wrapper", "other"]] {
            assert_eq!(policy().check(&package, dependents).len(), 1, "{dependents:?}");
        }
    }

    #[test]
    fn an_exception_is_for_one_crate_and_one_licence() {
        let package = |name: &str, licence: &str| json!({"name": name, "version": "1.0.0", "license": licence, "source": "registry+https://example.org/index"});
        assert_eq!(policy().check(&package("port", "MPL-2.0"), &[]), []);
        assert_eq!(policy().check(&package("port", "(MIT OR GPL-3.0) AND MPL-2.0"), &[]), []);
        for (name, licence) in [("port", "GPL-3.0"), ("other", "MPL-2.0")] {
            let rules: Vec<_> = policy().check(&package(name, licence), &[]).into_iter().map(|v| v.rule).collect();
            assert_eq!(rules, ["licence"], "{name} {licence}");
        }
    }

    #[test]
    fn the_policy_of_the_project_is_complete() {
        let policy = Policy::parse(include_str!("../../deny.toml")).expect("valid");
        assert!(policy.allows("MIT", &[]) && policy.allows("Apache-2.0", &[]) && !policy.banned.is_empty());
        assert!(!policy.licences.iter().any(|licence| licence.contains("GPL")));
    }
}
