//! Limits of the gates in a TOML file.

use std::path::Path;

use anyhow::{Context, Result, bail};
use pb3dp_calibration::gates::{Gate, Limit, Limits};

/// Reads a file like `configs/calibration_gates.toml`: a table `gates` with all gates, each with `good` and `refused`.
pub(super) fn read(file: &Path) -> Result<Limits> {
    let text = std::fs::read_to_string(file).with_context(|| format!("{}: can not be read", file.display()))?;
    parse(&text).with_context(|| format!("{}: no limits of gates", file.display()))
}

fn parse(text: &str) -> Result<Limits> {
    let root: toml::Table = text.parse()?;
    if let Some(key) = root.keys().find(|key| *key != "gates") {
        bail!("{key}: is not known here: the one table is gates");
    }
    let gates = root.get("gates").and_then(toml::Value::as_table).context("the table gates is missing")?;
    if let Some(key) = gates.keys().find(|key| Gate::ALL.iter().all(|gate| gate.key() != *key)) {
        bail!("gates.{key}: there is no such gate: {}", Gate::ALL.map(Gate::key).join(", "));
    }
    let mut limits = Limits::default();
    for gate in Gate::ALL {
        let key = gate.key();
        let table = gates.get(key).and_then(toml::Value::as_table);
        let table = table.with_context(|| format!("gates.{key} is missing: {{ good = ..., refused = ... }}"))?;
        if let Some(other) = table.keys().find(|name| !["good", "refused"].contains(&name.as_str())) {
            bail!("gates.{key}.{other}: is not known here: good and refused are");
        }
        let number = |name: &str| {
            let value = table.get(name);
            let value = value.and_then(|value| value.as_float().or_else(|| value.as_integer().map(|n| n as f64)));
            value.with_context(|| format!("gates.{key}.{name}: must be a number"))
        };
        limits = limits.with(gate, Limit { good: number("good")?, refused: number("refused")? })?;
    }
    Ok(limits)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = include_str!("../../../../configs/calibration_gates.toml");

    #[test]
    fn the_file_states_the_built_in_limits() {
        assert_eq!(parse(FILE).expect("limits"), Limits::default());
    }

    #[test]
    fn mistakes_are_named() {
        for (from, to, named) in [
            ("tilt_deg", "tilt", "gates.tilt"),
            ("good = 0.3", "good = 0.9", "reprojection_rms_px"),
            ("good = 0.3", "god = 0.3", "gates.reprojection_rms_px.god"),
            ("good = 0.3", "good = \"0.3\"", "gates.reprojection_rms_px.good"),
            ("[gates]", "[limits]", "limits"),
        ] {
            let text = FILE.replacen(from, to, 1);
            let error = format!("{:#}", parse(&text).expect_err(to));
            assert!(error.contains(named), "{error}");
        }
        let without = FILE.lines().filter(|line| !line.starts_with("views")).collect::<Vec<_>>().join("\n");
        assert!(format!("{:#}", parse(&without).expect_err("a gate is missing")).contains("gates.views is missing"));
    }
}
