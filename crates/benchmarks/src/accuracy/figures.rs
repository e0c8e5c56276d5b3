//! The figures of docs/method.md: scores over depth, error over noise, and a track.

use std::path::{Path, PathBuf};

use anyhow::Context;
use pb3dp_benchmarks::circumstances::Circumstances;
use pb3dp_benchmarks::figure::{AxisKind, Line, Panel, panels};
use pb3dp_benchmarks::page::save;
use pb3dp_estimation::estimator::Method;
use pb3dp_sim::targets::Paint;

use super::cell::Cell;
use super::cells;
use super::measure::{Options, Worker, measure_cell};
use super::page::{cell_panel, sequence_panels};
use super::scenes::SceneStore;
use super::score_curve::{Sample, scores};
use super::sequences::{self, SequenceSpec};
use super::summary::summary;
use super::track::run_sequence;

const FOLDER: &str = "docs/images";

/// The plotted methods.
const METHODS: [Method; 2] = [Method::Direct, Method::Published];

/// Draws the figures of docs/method.md on rendered scenes and writes them to docs/images.
#[derive(clap::Args)]
pub struct Args {
    /// Poses per noise level.
    #[arg(long, default_value_t = 40, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(4..=1000))]
    poses: u32,
    /// Frames of the track.
    #[arg(long, default_value_t = 240, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(10..=300))]
    frames: u32,
    /// Number of threads.
    #[arg(long, default_value_t = 2, value_name = "NUMBER")]
    threads: usize,
    /// Seed of poses and noise.
    #[arg(long, default_value_t = 1, value_name = "NUMBER")]
    seed: u32,
    /// Root folder of the workspace.
    #[arg(long, default_value = ".", value_name = "DIR")]
    root: PathBuf,
}

/// # Errors
/// If a part fails or a file cannot be written.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let circumstances = Circumstances::of(&args.root);
    let made = format!("Made by cargo xtask bench figures, seed {}. {}", args.seed, circumstances.line());
    let mut scenes = SceneStore::default();
    keep(&args.root, "score.svg", &score_figure(args, &mut scenes, &made)?)?;
    keep(&args.root, "noise.svg", &noise_figure(args, &mut scenes, &made)?)?;
    keep(&args.root, "track.svg", &track_figure(args, &mut scenes, &made)?)
}

fn keep(root: &Path, name: &str, svg: &str) -> anyhow::Result<()> {
    let file = root.join(FOLDER).join(name);
    save(&file, svg)?;
    println!("{FOLDER}/{name}: {} bytes", svg.len());
    Ok(())
}

fn cell(name: &str) -> anyhow::Result<Cell> {
    cells::all().into_iter().find(|cell| cell.name == name).with_context(|| format!("no configuration {name}"))
}

/// The targets whose scores are plotted, and the pose.
const SCORED: [(&str, &str); 2] = [("target/crab", "mostly one hue"), ("target/grey", "grey")];
const SCORED_POSE: usize = 0;

/// Both scores over disparity, far from the truth and near it.
fn score_figure(args: &Args, scenes: &mut SceneStore, made: &str) -> anyhow::Result<String> {
    let reaches = [(-40.0, 40.0, 0.25), (-2.0, 2.0, 0.02)];
    let mut drawn = Vec::new();
    for (name, what) in SCORED {
        let cell = cell(name)?;
        let mut worker = Worker::new(&cell, &scenes.scene(&cell.setup)?, args.seed, &[])?;
        let pair = worker.render(SCORED_POSE)?;
        let rig = worker.stated_rig();
        let depth_m = 1.0 / pair.trial.plane.z;
        let px_mm = 1e3 * depth_m * depth_m / (rig.left().pinhole().fx * rig.baseline_m());
        for (from, to, step) in reaches {
            let count = ((to - from) / step) as i32;
            let offsets: Vec<f64> = (0..=count).map(|i| from + f64::from(i) * step).collect();
            let title = format!("target {what}, 1 px = {px_mm:.1} mm");
            drawn.push(score_panel(title, &scores(&cell, rig, &pair, &offsets)?));
        }
    }
    let caption = [
        "Scores of one region for planes with the true tilt at other depths: left a wide range around the truth, right a narrow one."
            .to_owned(),
        "direct: correlation of luminance, which refinement maximises. published: the fitness of eq. (10).".to_owned(),
        made.to_owned(),
    ];
    Ok(panels(&drawn, 2, &caption))
}

fn score_panel(title: String, samples: &[Sample]) -> Panel {
    let line = |name: &str, of: &dyn Fn(&Sample) -> f64| Line {
        name: name.to_owned(),
        points: samples.iter().map(|sample| [sample.off_px, of(sample)]).collect(),
        is_bound: false,
    };
    let lines =
        vec![line("direct", &|s| s.correlation), line("published", &|s| s.fitness.unwrap_or(f64::NAN)), truth(samples)];
    Panel { title, x: "disparity offset from the truth, px".to_owned(), axes: [AxisKind::Linear; 2], lines }
}

/// A vertical line at the truth over the height of all values.
fn truth(samples: &[Sample]) -> Line {
    let values = samples.iter().flat_map(|s| [Some(s.correlation), s.fitness]).flatten();
    let [low, high] = values
        .filter(|value| value.is_finite())
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)]);
    Line { name: "truth".to_owned(), points: vec![[0.0, low], [0.0, high]], is_bound: true }
}

/// Rms error of depth and normal over the noise, with the bound, for the target that suits the published method best.
fn noise_figure(args: &Args, scenes: &mut SceneStore, made: &str) -> anyhow::Result<String> {
    let options = Options {
        methods: METHODS.to_vec(),
        seed: args.seed,
        threads: args.threads,
        poses: Some(args.poses as usize),
        quick: false,
    };
    let mut cells: Vec<Cell> = cells::all().into_iter().filter(|cell| cell.factor() == "noise").collect();
    cells.iter_mut().for_each(|cell| cell.setup.paint = Paint::Colourful);
    let mut rows = Vec::new();
    for cell in &cells {
        let measured = measure_cell(cell, &options, scenes)?;
        rows.extend((0..METHODS.len()).map(|index| summary(cell, METHODS[index].name(), index, &measured)));
    }
    let cells: Vec<&Cell> = cells.iter().collect();
    let drawn = ["z_mm", "angle_deg"].map(|quantity| cell_panel(&cells, &rows, quantity, "noise, grey levels"));
    let caption = [
        format!(
            "Single pairs of a flat colourful target, {} poses for each noise; depths with status ok or weak-tilt, normals with status ok.",
            args.poses
        ),
        made.to_owned(),
    ];
    Ok(panels(&drawn, 2, &caption))
}

/// The plotted sequence.
const TRACK: &str = "track/crab-30fps";

/// Depth and rotation error of each frame.
fn track_figure(args: &Args, scenes: &mut SceneStore, made: &str) -> anyhow::Result<String> {
    let spec = sequences::all().into_iter().find(|spec| spec.name == TRACK);
    let spec = spec.with_context(|| format!("no sequence is called {TRACK}"))?;
    let spec = SequenceSpec { frames: args.frames as usize, ..spec };
    let rows = run_sequence(&spec, &METHODS, args.seed, scenes)?;
    let drawn = sequence_panels(rows.iter(), &format!("frame, {} per second", spec.rate_hz));
    let caption = [
        "A flat target moves along and about all axes at once, 50 mm and 20 degrees; errors of the motion since the first frame."
            .to_owned(),
        "The published method keeps the rotation about the normal constant instead of measuring it.".to_owned(),
        made.to_owned(),
    ];
    Ok(panels(&drawn, 2, &caption))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_drawn_exists() {
        for (name, _) in SCORED {
            assert!(cell(name).is_ok(), "{name}");
        }
        assert!(sequences::all().iter().any(|spec| spec.name == TRACK));
        assert!(cells::all().iter().any(|cell| cell.factor() == "noise"));
    }

    #[test]
    fn the_truth_stands_over_the_height_of_all_values() {
        let sample = |off_px, fitness, correlation| Sample { off_px, fitness, correlation };
        let samples = [sample(-1.0, Some(-0.4), 0.2), sample(0.0, None, 0.9), sample(1.0, Some(0.3), f64::NAN)];
        assert_eq!(truth(&samples).points, [[0.0, -0.4], [0.0, 0.9]]);
    }
}
