//! Reads gate limits from a TOML file.

use std::path::Path;

use crate::gates::Limits;
use anyhow::{Context, Result, bail};
use pb3dp_record::text_file::read_text;

use super::numbers::of_toml;

/// The limits of a file like `configs/calibration_gates.toml`, `hand_eye_gates.toml` or `calibration_verify.toml`: one table with all
/// gates, each with `good` and `refused`. The built-in limits without a file.
pub(super) fn read(file: Option<&Path>, built_in: Limits) -> Result<Limits> {
    let Some(file) = file else { return Ok(built_in) };
    let text = read_text(file).with_context(|| format!("{}: cannot read file", file.display()))?;
    parse(&text, built_in).with_context(|| format!("{}: invalid gate limits", file.display()))
}

fn parse(text: &str, built_in: Limits) -> Result<Limits> {
    let (name, gates) = (built_in.table, built_in.gates().to_vec());
    let root: toml::Table = text.parse()?;
    if let Some(key) = root.keys().find(|key| *key != name) {
        bail!("unknown key {key}: the only table is {name}");
    }
    let tables = root.get(name).and_then(toml::Value::as_table).with_context(|| format!("missing table {name}"))?;
    let keys: Vec<&str> = gates.iter().map(|gate| gate.key).collect();
    if let Some(key) = tables.keys().find(|key| !keys.contains(&key.as_str())) {
        bail!("unknown gate {name}.{key}; the gates are {}", keys.join(", "));
    }
    gates.into_iter().try_fold(built_in, |limits, gate| {
        let key = gate.key;
        let table = tables.get(key).and_then(toml::Value::as_table);
        let table = table.with_context(|| format!("{name}.{key} is missing; add {{ good = ..., refused = ... }}"))?;
        if let Some(other) = table.keys().find(|name| !["good", "refused"].contains(&name.as_str())) {
            bail!("unknown key {name}.{key}.{other}; use good and refused");
        }
        let number = |which: &str| {
            table.get(which).and_then(of_toml).with_context(|| format!("{name}.{key}.{which}: must be a number"))
        };
        Ok(limits.with(gate, [number("good")?, number("refused")?])?)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = include_str!("../../../../configs/calibration_gates.toml");
    const HAND_EYE_FILE: &str = include_str!("../../../../configs/hand_eye_gates.toml");
    const CHECKS_FILE: &str = include_str!("../../../../configs/calibration_verify.toml");

    #[test]
    fn the_file_states_the_built_in_limits() {
        for (file, built_in) in
            [(FILE, Limits::of_cameras()), (HAND_EYE_FILE, Limits::of_hand_eye()), (CHECKS_FILE, Limits::of_checks())]
        {
            assert_eq!(parse(file, built_in.clone()).expect("limits"), built_in);
        }
    }

    #[test]
    fn mistakes_are_named() {
        let cameras = |text: &str| format!("{:#}", parse(text, Limits::of_cameras()).expect_err("a mistake"));
        for (from, to, named) in [
            ("tilt_deg", "tilt", "gates.tilt"),
            ("good = 0.2,", "good = 0.9,", "held_out_rms_px"),
            ("good = 0.2,", "god = 0.2,", "gates.held_out_rms_px.god"),
            ("good = 0.2,", "good = \"0.2\",", "gates.held_out_rms_px.good"),
            ("[gates]", "[limits]", "limits"),
        ] {
            let error = cameras(&FILE.replacen(from, to, 1));
            assert!(error.contains(named), "{error}");
        }
        let error = cameras(HAND_EYE_FILE);
        assert!(error.contains("the only table is gates"), "{error}");
        let without = FILE.lines().filter(|line| !line.starts_with("views")).collect::<Vec<_>>().join("\n");
        assert!(cameras(&without).contains("gates.views is missing"));
        for (from, to, named) in
            [("touch_mm", "touch", "checks.touch"), ("good = 0.2", "good = 0.9", "checks.row_error_rms_px")]
        {
            let checks = parse(&CHECKS_FILE.replacen(from, to, 1), Limits::of_checks());
            let error = format!("{:#}", checks.expect_err(to));
            assert!(error.contains(named), "{error}");
        }
    }
}
