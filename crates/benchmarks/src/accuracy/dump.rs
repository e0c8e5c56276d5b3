//! Writes the measured images as folders that all other commands read.

use std::path::PathBuf;

use anyhow::{Context, bail};
use image::RgbImage;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_geometry::MonotonicTime;
use pb3dp_record::dataset::{self, CaseDraft, PlaneTruth, SequenceDraft, SequenceWriter, WrittenFrame, write_case};
use pb3dp_record::images::StoredFormat;

use super::cell::Cell;
use super::cells;
use super::ensembles::{self, EnsembleSpec};
use super::measure::Worker;
use super::scenes::SceneStore;
use super::sequences::{self, SEARCH, SequenceSpec, long};
use super::track::Frames;

/// Writes one configuration as case folders, or one sequence as a sequence folder (docs/dataset-format.md).
#[derive(clap::Args)]
pub struct Args {
    /// Name of the configuration or sequence.
    #[arg(long)]
    cell: String,
    /// New folder for the output.
    #[arg(long)]
    out: PathBuf,
    /// Number of poses or frames.
    #[arg(long)]
    poses: Option<usize>,
    /// Seed of poses and noise.
    #[arg(long, default_value_t = 1)]
    seed: u32,
}

/// # Errors
/// If no configuration has this name, or a file cannot be written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    if let Some(cell) = cells::all().into_iter().find(|cell| cell.name == args.cell) {
        return dump_cell(&cell, args);
    }
    match sequences(args.seed).find(|sequence| sequence.name == args.cell) {
        Some(sequence) => dump_sequence(&sequence, args),
        None => {
            let cells = cells::all().into_iter().map(|cell| cell.name);
            let names: Vec<_> = cells.chain(sequences(args.seed).map(|sequence| sequence.name)).collect();
            bail!("no configuration or sequence is called `{}`; known are {}", args.cell, names.join(", "))
        }
    }
}

/// All sequences; those of an ensemble have its name and a number, from 0.
fn sequences(seed: u32) -> impl Iterator<Item = SequenceSpec> {
    let members = move |ensemble: EnsembleSpec| (0..ensemble.sequences).map(move |index| ensemble.member(seed, index));
    sequences::all().into_iter().chain([long()]).chain(ensembles::all().into_iter().flat_map(members))
}

fn recorded(search: &SearchRange) -> dataset::SearchRange {
    dataset::SearchRange { z_min_m: search.z_min_m, z_max_m: search.z_max_m, tilt_max_rad: search.tilt_max_rad }
}

fn dump_cell(cell: &Cell, args: &Args) -> anyhow::Result<()> {
    let scene = SceneStore::default().scene(&cell.setup)?;
    let mut worker = Worker::new(cell, &scene, args.seed, &[])?;
    for index in 0..args.poses.unwrap_or(10) {
        let pair = worker.render(index)?;
        let mask = pair.trial.region.rasterize(&pair.left, &Default::default())?;
        let centroid_px = mask.centroid_px().context("the region is empty")?;
        let ray = worker.stated_rig().left().unproject(&centroid_px)?;
        let plane = pair.trial.plane;
        let name = format!("{}_{index:04}", cell.name.replace('/', "_"));
        let draft = CaseDraft {
            name: name.clone(),
            region_polygon_left_px: pair.trial.outline_px.iter().map(|p| [p.x, p.y]).collect(),
            region_centroid_px: Some(centroid_px.into()),
            search: recorded(&cell.search),
            planar: cell.setup.is_planar(),
            hard: None,
            truth: Some(PlaneTruth::exact(ray / plane.dot(&ray), plane)),
        };
        write_case(&args.out.join(&name), &draft, worker.stated_rig(), &pair.left, &pair.right)?;
    }
    println!("cases of {} are in {}", cell.name, args.out.display());
    Ok(())
}

fn dump_sequence(spec: &SequenceSpec, args: &Args) -> anyhow::Result<()> {
    let mut frames = Frames::new(spec, args.seed, &mut SceneStore::default())?;
    let draft = SequenceDraft {
        region_polygon_left_px: frames.outline_px()?.iter().map(|p| [p.x, p.y]).collect(),
        search: recorded(&SEARCH),
        images: StoredFormat::Png,
    };
    let mut writer = SequenceWriter::create(&args.out, &frames.rig, draft)?;
    let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    for frame in 0..args.poses.unwrap_or(spec.frames) {
        frames.render(frame, &mut left, &mut right)?;
        writer.push(WrittenFrame {
            left: &left,
            right: &right,
            exposed_at: MonotonicTime::from_secs_f64(frame as f64 / spec.rate_hz),
            skew_nanos: (1e9 * spec.condition.skew_s()).round() as i64,
            cam_left_from_model: Some(spec.cam_left_from_target(frame).relabel()),
        })?;
    }
    let summary = writer.finish()?;
    println!("{} frames of {}: {}", summary.frames, spec.name, summary.file.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use pb3dp_record::dataset::{load_case, load_sequence};

    use super::*;

    #[test]
    fn what_is_written_can_be_read_with_its_truth() {
        let folder = std::env::temp_dir().join(format!("pb3dp-bench-dump-{}", std::process::id()));
        let args = |cell: &str| Args {
            cell: cell.to_owned(),
            out: folder.join(cell.replace('/', "_")),
            poses: Some(1),
            seed: 3,
        };
        run(&args("unrectified/grey")).unwrap();
        let case = load_case(&folder.join("unrectified_grey/unrectified_grey_0000")).unwrap();
        let truth = case.truth.clone().unwrap();
        assert!((0.4..0.7).contains(&truth.z_m) && truth.normal_in_cam_left.z < -0.8, "{truth:?}");
        assert!(!case.load_calibration().unwrap().rig.is_rectified());
        run(&args("hidden/crab")).unwrap();
        let sequence = load_sequence(&folder.join("hidden_crab")).unwrap();
        let pose = sequence.cam_left_from_model.unwrap()[0];
        let spec = sequences::all().into_iter().find(|s| s.name == "hidden/crab").unwrap();
        assert!((pose.translation_m() - spec.cam_left_from_target(0).translation_m()).norm() < 1e-9);
        assert!(run(&args("no such cell")).unwrap_err().to_string().contains("target/crab"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
