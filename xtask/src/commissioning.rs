//! `cargo xtask commissioning`: calibrates the bare rig by the commands of the documentation, and then runs the experiment.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, bail};

use crate::files::{copy_folder, read, remove_folder, write};
use crate::workspace::{PROGRAM, Workspace};

const DOCUMENT: &str = "docs/commissioning.md";
/// The section whose commands are run.
const HEADING: &str = "## 10. Calibrate cameras and hand";
const PLACE: &str = "out/commissioning";
/// Largest allowed ratio of the tracking error to that of a workcell that equals its setup exactly.
const RATIO_MAX: f64 = 1.3;
/// The compared figures, with their names.
const FIGURES: [(&str, &str); 2] = [
    ("tracking_position_mm", "hand, position, mm rms"),
    ("tracking_orientation_deg", "hand, orientation, degrees rms"),
];

/// Calibrates configs/bare.toml by the commands of docs/commissioning.md, step 10, word by word, in a copy of configs in
/// out/commissioning; stops if a gate rejects a calibration.
///
/// Then runs the experiment of Fig. 7 with this calibration, and with a workcell that equals its setup exactly: fails if the
/// tracking error is more than 1.3 times as large. Takes some minutes.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// Skip the experiments.
    #[arg(long)]
    pub calibrate_only: bool,
    /// Build with optimisation; the experiments then take a third of the time.
    #[arg(long)]
    pub release: bool,
}

/// With the programs in a folder, or after a build.
///
/// # Errors
/// If a command fails, or the tracking error is too large.
pub fn run(workspace: &Workspace, args: &Args, programs: Option<&Path>) -> anyhow::Result<()> {
    let all = [&PROGRAM[..2], &["--package", "pb3dp-calibration", "--bins"]].concat();
    let programs = &programs.map_or_else(|| workspace.build(args.release, &all), |folder| Ok(folder.to_path_buf()))?;
    let place = workspace.root().join(PLACE);
    remove_folder(&place)?;
    copy_folder(&workspace.root().join("configs"), &place.join("configs"))?;
    for command in commands(&read(&workspace.root().join(DOCUMENT))?)? {
        in_shell(&place, programs, &command)?;
    }
    if args.calibrate_only {
        return Ok(());
    }
    exact_cell(&place)?;
    let [found, exact] = ["calibrated", "exact"].map(|name| experiment(&place, programs, name));
    compare(&found?, &exact?)
}

/// The lines of the section's shell blocks.
fn commands(document: &str) -> anyhow::Result<Vec<String>> {
    let (_, section) = document.split_once(HEADING).with_context(|| format!("{DOCUMENT} has no {HEADING:?}"))?;
    let section = section.split("\n## ").next().unwrap_or(section);
    let blocks = section.split("```sh\n").skip(1).filter_map(|rest| rest.split("```").next());
    let commands: Vec<String> =
        blocks.flat_map(str::lines).filter(|line| !line.is_empty()).map(str::to_owned).collect();
    if commands.is_empty() {
        bail!("{DOCUMENT}: {HEADING:?} has no commands");
    }
    Ok(commands)
}

/// Runs a command in the copy, by a shell with our programs first in its PATH.
fn in_shell(place: &Path, programs: &Path, command: &str) -> anyhow::Result<()> {
    println!("$ {command}");
    let path = std::env::var_os("PATH").unwrap_or_default();
    let paths = std::iter::once(programs.to_path_buf()).chain(std::env::split_paths(&path));
    let mut shell = Command::new("sh");
    shell.current_dir(place).env("PATH", std::env::join_paths(paths)?).args(["-c", command]);
    let status = shell.status().context("cannot run sh")?;
    if status.success() { Ok(()) } else { bail!("command failed ({status}): {command}") }
}

/// The calibrated setup in a workcell that equals it exactly, except for the second arm.
fn exact_cell(place: &Path) -> anyhow::Result<()> {
    let file = place.join("configs/calibrated.toml");
    let setup: toml::Table = read(&file)?.parse()?;
    let calibration = setup["camera"].get("calibration").context("camera.calibration is not set")?;
    let exact = format!(
        "base = \"calibrated.toml\"\nwithout = [\"truth.flange_from_cam_left\"]\n\n[truth]\ncalibration = {calibration}\n"
    );
    write(&place.join("configs/exact.toml"), &exact)
}

/// The summary of a run.
fn experiment(place: &Path, programs: &Path, name: &str) -> anyhow::Result<serde_json::Value> {
    println!("Fig. 7, {name}");
    in_shell(place, programs, &format!("pb3dp run --config configs/{name}.toml --out out/{name}"))?;
    let file = place.join("out").join(name).join("summary.json");
    Ok(serde_json::from_str(&read(&file)?)?)
}

fn compare(found: &serde_json::Value, exact: &serde_json::Value) -> anyhow::Result<()> {
    println!("\n| | calibrated | exactly known | ratio |\n|---|---|---|---|");
    let mut too_far = Vec::new();
    for (key, name) in FIGURES {
        let rms = |of: &serde_json::Value| of["summary"][key]["rms"].as_f64().with_context(|| format!("no {key}"));
        let (found, exact) = (rms(found)?, rms(exact)?);
        println!("| {name} | {found:.2} | {exact:.2} | {:.2} |", found / exact);
        // NaN counts as too large.
        let is_near = found <= RATIO_MAX * exact;
        if !is_near {
            too_far.push(name);
        }
    }
    if too_far.is_empty() {
        return Ok(());
    }
    bail!("the error is more than {RATIO_MAX} times that of an exactly known workcell: {}", too_far.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_those_of_the_section() {
        let text = format!(
            "# a\n```sh\nno\n```\n{HEADING}\n\ntext\n\n```sh\none x\ntwo\n```\n\n```toml\nno\n```\n```sh\nthree\n```\n## b\n```sh\nno\n```\n"
        );
        assert_eq!(commands(&text).unwrap(), ["one x", "two", "three"]);
        assert!(commands("# a\n").is_err());
        assert!(commands(&format!("{HEADING}\n")).is_err());
    }

    #[test]
    fn a_hand_that_is_too_far_off_is_named() {
        let summary = |mm: f64, deg: f64| serde_json::json!({ "summary": { "tracking_position_mm": { "rms": mm }, "tracking_orientation_deg": { "rms": deg } } });
        assert!(compare(&summary(1.29, 0.5), &summary(1.0, 0.5)).is_ok());
        let error = compare(&summary(1.0, 0.7), &summary(1.0, 0.5)).unwrap_err().to_string();
        assert!(error.contains("orientation") && !error.contains("position"), "{error}");
        assert!(compare(&serde_json::json!({}), &summary(1.0, 1.0)).is_err());
    }
}
