//! Reads the limits of the `verify` checks from a TOML file.

use std::path::Path;

use crate::gates::Limit;
use crate::verify::limits::{Check, VerifyLimits};
use anyhow::{Context, Result, bail};
use pb3dp_record::text_file::read_text;

/// Reads a file like `configs/calibration_verify.toml`: a table `checks` with all checks, each with `good` and `refused`.
pub(super) fn read(file: &Path) -> Result<VerifyLimits> {
    let text = read_text(file).with_context(|| format!("{}: cannot read file", file.display()))?;
    parse(&text).with_context(|| format!("{}: invalid check limits", file.display()))
}

fn parse(text: &str) -> Result<VerifyLimits> {
    let root: toml::Table = text.parse()?;
    if let Some(key) = root.keys().find(|key| *key != "checks") {
        bail!("unknown key {key}: the only table is checks");
    }
    let checks = root.get("checks").and_then(toml::Value::as_table).context("missing table checks")?;
    if let Some(key) = checks.keys().find(|key| Check::ALL.iter().all(|check| check.key() != *key)) {
        bail!("unknown check checks.{key}; the checks are {}", Check::ALL.map(Check::key).join(", "));
    }
    let mut limits = VerifyLimits::default();
    for check in Check::ALL {
        let key = check.key();
        let table = checks.get(key).and_then(toml::Value::as_table);
        let table = table.with_context(|| format!("checks.{key} is missing; add {{ good = ..., refused = ... }}"))?;
        if let Some(other) = table.keys().find(|name| !["good", "refused"].contains(&name.as_str())) {
            bail!("unknown key checks.{key}.{other}; use good and refused");
        }
        let number = |name: &str| {
            let value = table.get(name);
            let value = value.and_then(|value| value.as_float().or_else(|| value.as_integer().map(|n| n as f64)));
            value.with_context(|| format!("checks.{key}.{name}: must be a number"))
        };
        limits = limits.with(check, Limit { good: number("good")?, refused: number("refused")? })?;
    }
    Ok(limits)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = include_str!("../../../../configs/calibration_verify.toml");

    #[test]
    fn the_file_states_the_built_in_limits() {
        assert_eq!(parse(FILE).expect("limits"), VerifyLimits::default());
    }

    #[test]
    fn mistakes_are_named() {
        for (from, to, named) in [
            ("touch_mm", "touch", "checks.touch"),
            ("good = 0.2", "good = 0.9", "row_error_rms_px"),
            ("good = 0.2", "god = 0.2", "checks.row_error_rms_px.god"),
            ("[checks]", "[gates]", "gates"),
        ] {
            let error = format!("{:#}", parse(&FILE.replacen(from, to, 1)).expect_err(to));
            assert!(error.contains(named), "{error}");
        }
    }
}
