//! `pb3dp calibrate convert`: calibrations in other formats.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Args;
use pb3dp_camera_recordings::{CalibrationOptions, parse_size};
use pb3dp_geometry::{ImageSize, StereoRig};
use pb3dp_record::calibration_files::{
    Judgement, load_stated, save_json, save_judged, save_kalibr, save_opencv, save_ros_pair,
};

/// Arguments of `pb3dp calibrate convert`.
#[derive(Debug, Args)]
pub(super) struct ConvertArgs {
    /// The calibration: one file, a left and a right file, or a folder. The format is detected from the contents.
    #[arg(required = true, value_name = "FILE", num_args = 1..=2)]
    from: Vec<PathBuf>,
    /// Size of the images that the new file is for: that of the old one if it states none, otherwise the old one is scaled (--calib-size).
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    size: Option<ImageSize>,
    /// What the old file does not state.
    #[command(flatten)]
    calibration: CalibrationOptions,
    /// Output file: .json (our own), Kalibr camchain (.kalibr.yaml), OpenCV (.opencv.yaml), or a folder for the ROS pair
    /// left.yaml and right.yaml. These formats lose the quality data of our .toml.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

pub(super) fn run(args: &ConvertArgs) -> Result<ExitCode> {
    let calibration = load_stated(&args.from, args.size, &args.calibration.stated())?.decided()?;
    for note in calibration.notes.iter().chain(&calibration.warnings) {
        super::tell(&format!("note: {note}"))?;
    }
    super::tell(&format!("read {}: {}", calibration.format, calibration.source))?;
    super::tell(&write(&calibration.rig, calibration.judgement.as_ref(), &args.out)?)?;
    Ok(ExitCode::SUCCESS)
}

/// Refuses an output name with an unknown format.
pub(super) fn check_name(out: &Path) -> Result<()> {
    let name = out.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let known = [".toml", ".json", ".kalibr.yaml", ".kalibr.yml", ".opencv.yaml", ".opencv.yml"];
    if known.iter().any(|ending| name.ends_with(ending)) || out.extension().is_none() {
        return Ok(());
    }
    anyhow::bail!(
        "{}: unknown file extension; use .toml, .json, .kalibr.yaml, .opencv.yaml, or a folder",
        out.display()
    )
}

/// Writes a rig in the format given by the file name, and returns the message to print.
pub(super) fn write(rig: &StereoRig, judgement: Option<&Judgement>, out: &Path) -> Result<String> {
    let name = out.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let ends = |suffixes: &[&str]| suffixes.iter().any(|suffix| name.ends_with(suffix));
    let format = if ends(&[".toml"]) {
        let judgement = judgement.with_context(|| {
            format!(
                "{}: a .toml needs quality data, which this calibration does not have; use another format, or calibrate again",
                out.display()
            )
        })?;
        save_judged(rig, judgement, out)?;
        "a calibration with its quality data"
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
        std::fs::create_dir_all(out).with_context(|| format!("{}: cannot create folder", out.display()))?;
        save_ros_pair(rig, &out.join("left.yaml"), &out.join("right.yaml"))?;
        "a ROS camera_info pair"
    } else {
        anyhow::bail!(
            "{}: unknown file extension; use .toml, .json, .kalibr.yaml, .opencv.yaml, or a folder",
            out.display()
        );
    };
    Ok(format!("wrote {}: {format}", out.display()))
}
