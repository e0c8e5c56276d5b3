//! Calibrations in other formats.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Args;
use pb3dp_geometry::StereoRig;
use pb3dp_record::calibration_files::{
    Judgement, load_stereo, save_json, save_judged, save_kalibr, save_opencv, save_ros_pair,
};

/// Arguments of `pb3dp calibrate convert`.
#[derive(Debug, Args)]
pub(super) struct ConvertArgs {
    /// The calibration: one file, a left and a right one, or a folder; the format is found from the contents.
    #[arg(required = true, value_name = "FILE", num_args = 1..=2)]
    from: Vec<PathBuf>,
    /// Where to write it: .json (ours), a Kalibr camchain (.kalibr.yaml), OpenCV (.opencv.yaml), or a folder for the ROS pair
    /// left.yaml and right.yaml; what a .toml of ours says of the calibration's worth is lost there.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

pub(super) fn run(args: &ConvertArgs) -> Result<ExitCode> {
    let calibration = load_stereo(&args.from)?;
    for note in &calibration.notes {
        super::tell(&format!("note: {note}"))?;
    }
    super::tell(&format!("read {}: {}", calibration.format, calibration.source))?;
    super::tell(&write(&calibration.rig, calibration.judgement.as_ref(), &args.out)?)?;
    Ok(ExitCode::SUCCESS)
}

/// Refuses a name that asks for no format.
pub(super) fn check_name(out: &Path) -> Result<()> {
    let name = out.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let known = [".toml", ".json", ".kalibr.yaml", ".kalibr.yml", ".opencv.yaml", ".opencv.yml"];
    if known.iter().any(|ending| name.ends_with(ending)) || out.extension().is_none() {
        return Ok(());
    }
    anyhow::bail!(
        "{}: the format cannot be told from the name: use .toml, .json, .kalibr.yaml, .opencv.yaml, or a folder",
        out.display()
    )
}

/// Writes a rig in the format that the name asks for, and says so.
pub(super) fn write(rig: &StereoRig, judgement: Option<&Judgement>, out: &Path) -> Result<String> {
    let name = out.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let ends = |suffixes: &[&str]| suffixes.iter().any(|suffix| name.ends_with(suffix));
    let format = if ends(&[".toml"]) {
        let judgement = judgement.with_context(|| {
            format!(
                "{}: a .toml of ours says how good a calibration is, which this one does not know: calibrate",
                out.display()
            )
        })?;
        save_judged(rig, judgement, out)?;
        "a calibration with what is known of it"
    } else if ends(&[".json"]) {
        save_json(rig, out)?;
        "calib.json"
    } else if ends(&[".kalibr.yaml", ".kalibr.yml"]) {
        save_kalibr(rig, out)?;
        "a Kalibr camchain"
    } else if ends(&[".opencv.yaml", ".opencv.yml"]) {
        save_opencv(rig, out)?;
        "OpenCV stereo YAML"
    } else if out.extension().is_none() {
        std::fs::create_dir_all(out).with_context(|| format!("{}: the folder cannot be made", out.display()))?;
        save_ros_pair(rig, &out.join("left.yaml"), &out.join("right.yaml"))?;
        "a ROS camera_info pair"
    } else {
        anyhow::bail!(
            "{}: the format cannot be told from the name: use .toml, .json, .kalibr.yaml, .opencv.yaml, or a folder",
            out.display()
        );
    };
    Ok(format!("wrote {}: {format}", out.display()))
}
