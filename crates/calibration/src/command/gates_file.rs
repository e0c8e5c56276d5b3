//! Reads gate limits from a TOML file.

use std::path::Path;

use crate::gates::{Gate, Limit, Limits};
use crate::hand_eye::gates::{HandEyeGate, HandEyeLimits};
use anyhow::{Context, Result, bail};
use pb3dp_record::text_file::read_text;

/// Reads a file like `configs/calibration_gates.toml`: a table `gates` with all gates, each with `good` and `refused`.
pub(super) fn read(file: &Path) -> Result<Limits> {
    read_with(file, parse)
}

/// Reads a file like `configs/hand_eye_gates.toml`.
pub(super) fn read_hand_eye(file: &Path) -> Result<HandEyeLimits> {
    read_with(file, parse_hand_eye)
}

fn read_with<T>(file: &Path, parse: impl Fn(&str) -> Result<T>) -> Result<T> {
    let text = read_text(file).with_context(|| format!("{}: cannot read file", file.display()))?;
    parse(&text).with_context(|| format!("{}: invalid gate limits", file.display()))
}

fn parse(text: &str) -> Result<Limits> {
    let limits = table(text, "gates", &Gate::ALL.map(Gate::key))?;
    let with = |all: Limits, (gate, limit)| all.with(gate, limit);
    Ok(Gate::ALL.into_iter().zip(limits).try_fold(Limits::default(), with)?)
}

fn parse_hand_eye(text: &str) -> Result<HandEyeLimits> {
    let limits = table(text, "hand_eye_gates", &HandEyeGate::ALL.map(HandEyeGate::key))?;
    let with = |all: HandEyeLimits, (gate, limit)| all.with(gate, limit);
    Ok(HandEyeGate::ALL.into_iter().zip(limits).try_fold(HandEyeLimits::default(), with)?)
}

/// The gate limits for the given keys, in their order, from the only table of a file.
fn table(text: &str, name: &str, keys: &[&str]) -> Result<Vec<Limit>> {
    let root: toml::Table = text.parse()?;
    if let Some(key) = root.keys().find(|key| *key != name) {
        bail!("unknown key {key}: the only table is {name}");
    }
    let gates = root.get(name).and_then(toml::Value::as_table).with_context(|| format!("missing table {name}"))?;
    if let Some(key) = gates.keys().find(|key| !keys.contains(&key.as_str())) {
        bail!("unknown gate {name}.{key}; the gates are {}", keys.join(", "));
    }
    let limit = |key: &&str| {
        let table = gates.get(*key).and_then(toml::Value::as_table);
        let table = table.with_context(|| format!("{name}.{key} is missing; add {{ good = ..., refused = ... }}"))?;
        if let Some(other) = table.keys().find(|name| !["good", "refused"].contains(&name.as_str())) {
            bail!("unknown key {name}.{key}.{other}; use good and refused");
        }
        let number = |which: &str| {
            let value = table.get(which);
            let value = value.and_then(|value| value.as_float().or_else(|| value.as_integer().map(|n| n as f64)));
            value.with_context(|| format!("{name}.{key}.{which}: must be a number"))
        };
        Ok(Limit { good: number("good")?, refused: number("refused")? })
    };
    keys.iter().map(limit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = include_str!("../../../../configs/calibration_gates.toml");
    const HAND_EYE_FILE: &str = include_str!("../../../../configs/hand_eye_gates.toml");

    #[test]
    fn the_file_states_the_built_in_limits() {
        assert_eq!(parse(FILE).expect("limits"), Limits::default());
        assert_eq!(parse_hand_eye(HAND_EYE_FILE).expect("limits"), HandEyeLimits::default());
    }

    #[test]
    fn mistakes_are_named() {
        for (from, to, named) in [
            ("tilt_deg", "tilt", "gates.tilt"),
            ("good = 0.2,", "good = 0.9,", "held_out_rms_px"),
            ("good = 0.2,", "god = 0.2,", "gates.held_out_rms_px.god"),
            ("good = 0.2,", "good = \"0.2\",", "gates.held_out_rms_px.good"),
            ("[gates]", "[limits]", "limits"),
        ] {
            let text = FILE.replacen(from, to, 1);
            let error = format!("{:#}", parse(&text).expect_err(to));
            assert!(error.contains(named), "{error}");
        }
        let error = format!("{:#}", parse_hand_eye(FILE).expect_err("gates of cameras"));
        assert!(error.contains("the only table is hand_eye_gates"), "{error}");
        let without = FILE.lines().filter(|line| !line.starts_with("views")).collect::<Vec<_>>().join("\n");
        assert!(format!("{:#}", parse(&without).expect_err("a gate is missing")).contains("gates.views is missing"));
    }
}
