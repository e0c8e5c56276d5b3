//! Tracking of real sequences with known truth: every method follows the region of the first frame, as `pb3dp track` does.

use std::path::PathBuf;

use anyhow::{Context, bail};
use nalgebra::Vector2;
use pb3dp_benchmarks::circumstances::Circumstances;
use pb3dp_benchmarks::page::{save, text, update};
use pb3dp_benchmarks::table::{Column, markdown};
use pb3dp_estimation::estimator::{EstimatorConfig, FramePrior, Method, Tracker};
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_hal_platform::cpu_time::timed;
use pb3dp_record::dataset::{Sequence, is_sequence, load_sequence};
use pb3dp_record::metrics::{MotionErrors, MotionSummary, Statistics, compare_motion, median};
use serde_json::{Value, json};

use super::Args;

const KEPT: &str = "out/bench/sequences.json";
const PAGE: &str = "docs/benchmarks/sequences.md";

/// An `ok` answer with a larger error of the motion is wrong: share of the distance, and angle.
const WRONG_SHARE: f64 = 0.01;
const WRONG_DEG: f64 = 5.0;

/// Frames in which the target is turned by at most this angle from the first one, and is this many times as far away: those in which a tracker
/// with one marked pair can find it.
const REACHABLE_DEG: f64 = 30.0;
const REACHABLE_DISTANCES: std::ops::RangeInclusive<f64> = 0.6..=1.7;

/// Options of the measurement on sequences.
#[derive(clap::Args)]
pub struct SequenceArgs {
    /// Tracks sequences instead of measuring cases: a sequence folder with true poses, or a folder of such folders; may be repeated.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["cases", "peers", "peer_results", "filter", "failures"])]
    sequences: Vec<PathBuf>,
}

impl SequenceArgs {
    /// Whether the measurement is wanted.
    pub fn is_wanted(&self) -> bool {
        !self.sequences.is_empty()
    }
}

/// Tracks every sequence with every method, prints the table and saves it.
///
/// # Errors
/// A folder or file that cannot be used, by name; no sequence with truth.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let methods = if args.methods.is_empty() { Method::ALL.to_vec() } else { args.methods.clone() };
    let mut rows = Vec::new();
    for folder in folders(&args.sequences.sequences)? {
        let sequence = load_sequence(&folder)?;
        let Some(truth) = &sequence.cam_left_from_model else {
            eprintln!("{}: no truth, skipped", folder.display());
            continue;
        };
        for method in &methods {
            rows.push(follow(&sequence, truth, *method).with_context(|| format!("{}: {method}", folder.display()))?);
        }
    }
    if rows.is_empty() {
        bail!("no sequence has a `truth`: nothing to compare with");
    }
    let circumstances = Circumstances::of(&args.root);
    let parts = [("run", format!("{}\n\n{}", circumstances.line(), markdown(&COLUMNS, &rows)))];
    if args.json {
        rows.iter().for_each(|line| println!("{line}"));
    } else {
        print!("{}", text(&parts));
    }
    let kept = json!({"bench": "sequences", "where": circumstances.to_json(), "results": rows});
    save(&args.root.join(KEPT), &format!("{kept:#}\n"))?;
    if args.no_docs { Ok(()) } else { update(&args.root.join(PAGE), &parts) }
}

/// The sequence folders among the given folders and in them, by name.
fn folders(given: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for folder in given {
        if is_sequence(folder) {
            found.push(folder.clone());
            continue;
        }
        let entries =
            std::fs::read_dir(folder).with_context(|| format!("cannot read --sequences {}", folder.display()))?;
        let mut inside = entries.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>()?;
        inside.retain(|path| is_sequence(path));
        inside.sort();
        if inside.is_empty() {
            bail!("--sequences {}: no sequence.json in it or in a folder in it", folder.display());
        }
        found.extend(inside);
    }
    Ok(found)
}

const COLUMNS: [Column<'_>; 12] = [
    ("sequence", "{sequence}"),
    ("method", "{method}"),
    ("frames", "{frames}"),
    ("with a pose", "{with_pose}"),
    ("ok", "{ok}"),
    ("wrong ok", "{wrong_ok}"),
    ("within reach", "{within_reach}"),
    ("of them right", "{right_within_reach}"),
    ("translation mm med / p95", "{translation_m_median_p95.0*1e3:3} / {translation_m_median_p95.1*1e3:3}"),
    ("depth mm med / p95", "{depth_m_median_p95.0*1e3:3} / {depth_m_median_p95.1*1e3:3}"),
    ("rotation deg med / p95", "{rotation_rad_median_p95.0*57.29577951:3} / {rotation_rad_median_p95.1*57.29577951:3}"),
    ("ms med", "{ms_median:2}"),
];

fn follow(sequence: &Sequence, truth: &[Pose<CamLeft, Model>], method: Method) -> anyhow::Result<Value> {
    let calibration = sequence.load_calibration()?;
    let mut tracker = Tracker::new(method, &calibration.rig, &EstimatorConfig::default())?;
    let corners = sequence.region_polygon_left_px.iter().map(|[u, v]| Vector2::new(*u, *v));
    let region = Region::Polygon { vertices_px: corners.collect() };
    let range = &sequence.search;
    let range = SearchRange { z_min_m: range.z_min_m, z_max_m: range.z_max_m, tilt_max_rad: range.tilt_max_rad };
    let (mut poses, mut statuses, mut millis) = (Vec::new(), Vec::new(), Vec::new());
    for frame in 0..truth.len() {
        let images = sequence.load_images(frame as u64, calibration.rig.left().size())?;
        let before_s = frame.checked_sub(1).map(|before| sequence.times_s[before]);
        let skew_s = sequence.skew_s.get(frame).copied().unwrap_or_default();
        let prior = FramePrior {
            dt_s: before_s.map(|before_s| sequence.times_s[frame] - before_s),
            ..FramePrior::of_skew(skew_s)
        };
        // Until a method has a target, the region of the first frame is the best that there is for a target that moves little.
        let request = match frame == 0 || tracker.needs_new_region() {
            true => EstimateRequest::new_target(&images.left, &images.right, &region, &range).with_skew(skew_s),
            false => EstimateRequest::next_frame(&images.left, &images.right, &prior),
        };
        let (estimate, ms) = timed(|| tracker.estimate(request));
        let estimate = estimate?;
        poses.push(estimate.cam_left_from_model);
        statuses.push(estimate.status);
        millis.push(ms);
    }
    // A first pair whose exposures differ does not show how the target moved in between.
    let first = usize::from(sequence.skew_s.first().is_some_and(|skew_s| *skew_s != 0.0));
    let errors = compare_motion(&poses[first..], &truth[first..]);
    let (mut ok, mut wrong_ok, mut depths) = (0, 0, Vec::new());
    let (mut within_reach, mut right_within_reach) = (0, 0);
    for (frame, ((error, pose), status)) in errors.iter().zip(&poses[first..]).zip(&statuses[first..]).enumerate() {
        let is_later_within_reach = frame > 0 && is_within_reach(&truth[first], &truth[first + frame]);
        within_reach += usize::from(is_later_within_reach);
        let (Some(error), Some(pose)) = (error, pose) else { continue };
        let is_right = status.depth_is_sure() && !is_wrong(error, pose);
        right_within_reach += usize::from(is_later_within_reach && is_right);
        ok += usize::from(*status == Status::Ok);
        wrong_ok += usize::from(*status == Status::Ok && is_wrong(error, pose));
        depths.push(error.translation_m.dot(&pose.translation_m().normalize()).abs());
    }
    let summary = MotionSummary::of(&errors);
    let two = |of: Option<&Statistics>| of.map(|s| [s.median, s.p95]);
    Ok(json!({
        "sequence": sequence.folder.file_name().unwrap_or_default().to_string_lossy(),
        "method": method.name(),
        "frames": errors.len(),
        "with_pose": summary.as_ref().map_or(0, |s| s.frames - s.without_pose),
        "ok": ok,
        "wrong_ok": wrong_ok,
        "within_reach": within_reach,
        "right_within_reach": right_within_reach,
        "translation_m_median_p95": two(summary.as_ref().map(|s| &s.translation_m)),
        "depth_m_median_p95": two(Statistics::of(&depths).as_ref()),
        "rotation_rad_median_p95": two(summary.as_ref().map(|s| &s.rotation_rad)),
        "ms_median": median(&millis).unwrap_or_default(),
    }))
}

fn is_within_reach(first: &Pose<CamLeft, Model>, now: &Pose<CamLeft, Model>) -> bool {
    first.rotation().angle_to(&now.rotation()).to_degrees() <= REACHABLE_DEG
        && REACHABLE_DISTANCES.contains(&(now.translation_m().norm() / first.translation_m().norm()))
}

fn is_wrong(error: &MotionErrors, pose: &Pose<CamLeft, Model>) -> bool {
    error.translation_m.norm() > WRONG_SHARE * pose.translation_m().norm()
        || error.rotation_rad.norm().to_degrees() > WRONG_DEG
}
