//! Rows of sequences, and of ensembles of many short ones. Errors are those of the motion since the first frame, at the target's origin,
//! over the frames with a confident pose.

use nalgebra::Vector3;
use pb3dp_benchmarks::table::Column;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_record::metrics::{MotionErrors, compare_motion, median, percentile, rms};
use serde_json::{Value, json};

use super::chi_square::{freedom_of_mean, interval};
use super::ensembles::EnsembleSpec;
use super::sequences::SequenceSpec;

/// Errors above these are wrong: metres, radians.
const TOLERANCE: (f64, f64) = (2e-3, 3.0 * std::f64::consts::PI / 180.0);

/// Answer of a tracker for one frame.
#[derive(Clone, Debug)]
pub struct Tracked {
    /// Its status.
    pub status: Status,
    /// Its pose.
    pub pose: Option<Pose<CamLeft, Model>>,
    /// Squared error of the pose, normalised by the covariance of the tracker, over its expected value 6. On a relief the
    /// first answer is the definition of the model, so this is the error of the motion.
    pub normalised_error: Option<f64>,
    /// The same for the motion since the first answer; `None` in the first frame.
    pub normalised_motion_error: Option<f64>,
    /// Whether the rotation about the normal is measured; if not, the direction of the normal is judged instead.
    pub turn_observed: bool,
    /// CPU time, milliseconds.
    pub cpu_millis: f64,
}

impl Tracked {
    /// The answer of a tracker that failed.
    pub fn without_answer(cpu_millis: f64) -> Self {
        Self {
            status: Status::Error,
            pose: None,
            normalised_error: None,
            normalised_motion_error: None,
            turn_observed: false,
            cpu_millis,
        }
    }

    /// The pose, if it is confident.
    pub fn sure_pose(&self) -> Option<Pose<CamLeft, Model>> {
        self.pose.filter(|_| self.status.depth_is_sure())
    }
}

/// Answers of some trackers to one sequence, and the truth.
pub struct Run {
    /// Per tracker: the method and its answers.
    pub tracked: Vec<(&'static str, Vec<Tracked>)>,
    /// Pose of the target in each frame.
    pub truth: Vec<Pose<CamLeft, Model>>,
}

/// The columns of the table of sequences.
pub const COLUMNS: [Column<'_>; 14] = [
    ("sequence", "{sequence}"),
    ("method", "{method}"),
    ("frames", "{frames}"),
    ("lost", "{lost}"),
    ("wrong ok", "{wrong_ok}"),
    ("until back", "{frames_until_back}"),
    ("xy mm med / p95", "{xy_mm.median:3} / {xy_mm.p95:3}"),
    ("z mm med / p95", "{z_mm.median:3} / {z_mm.p95:3}"),
    ("rotation deg med / p95", "{rotation_deg.median:3} / {rotation_deg.p95:3}"),
    ("tilt deg med / p95", "{tilt_deg.median:3} / {tilt_deg.p95:3}"),
    ("jitter z mm, deg", "{jitter.z_mm:3}, {jitter.rotation_deg:3}"),
    ("drift", "{drift_ratio:2}"),
    ("NEES", "{nees:2}"),
    ("ms", "{cpu_ms:2}"),
];

/// The columns of the table of ensembles.
pub const ENSEMBLE_COLUMNS: [Column<'_>; 10] = [
    ("ensemble", "{ensemble}"),
    ("sequences", "{sequences}"),
    ("frames", "{frames}"),
    ("lost", "{lost}"),
    ("wrong ok", "{wrong_ok}"),
    ("xy mm med / p95", "{xy_mm.median:3} / {xy_mm.p95:3}"),
    ("z mm med / p95", "{z_mm.median:3} / {z_mm.p95:3}"),
    ("rotation deg med / p95", "{rotation_deg.median:3} / {rotation_deg.p95:3}"),
    ("NEES of the pose", "{pose.nees:2} ({pose.interval.0:2} to {pose.interval.1:2})"),
    ("NEES of the motion", "{motion.nees:2} ({motion.interval.0:2} to {motion.interval.1:2})"),
];

/// The row of one method on one sequence, and the errors of its frames.
pub struct SequenceRow {
    /// The row. `lost`: frames without a confident pose while the target was visible; frames until recovery from an occlusion
    /// (`frames_until_back`: to the first right pose) do not count. `drift_ratio`: median error of the last tenth of the frames over that of
    /// the first. `cpu_ms`: of a frame after the first.
    pub row: Value,
    /// The errors of each frame, for the figures.
    pub errors: Vec<Option<MotionErrors>>,
}

impl SequenceRow {
    /// For one method's answers; `truth` is the pose of any frame fixed to the body.
    pub fn of(spec: &SequenceSpec, method: &str, tracked: &[Tracked], truth: &[Pose<CamLeft, Model>]) -> Self {
        let errors = compare_motion(&tracked.iter().map(Tracked::sure_pose).collect::<Vec<_>>(), truth);
        let whole = tracked.iter().any(|t| t.turn_observed);
        let nees: Vec<f64> =
            tracked.iter().filter(|t| t.status == Status::Ok).filter_map(|t| t.normalised_error).collect();
        let times: Vec<f64> = tracked.iter().skip(1).map(|t| t.cpu_millis).collect();
        let back = frames_until_back(spec, &errors, whole);
        let jitter =
            jitter(&errors, |e| Vector3::new(0.0, 0.0, e.translation_m.z)).zip(jitter(&errors, |e| e.rotation_rad));
        let row = json!({
            "sequence": spec.name, "method": method, "frames": tracked.len(), "lost": lost(spec, &errors, back),
            "wrong_ok": errors.iter().flatten().filter(|e| !is_right(e, whole)).count(), "frames_until_back": back,
            "jitter": jitter.map(|(z, rad)| json!({"z_mm": 1e3 * z, "rotation_deg": rad.to_degrees()})),
            "drift_ratio": drift(&errors), "nees": mean(&nees), "cpu_ms": median(&times),
        });
        Self { row: with_errors(row, errors.iter().flatten()), errors }
    }
}

/// The row of one method on an ensemble. The first frame defines the motion: its error is zero, or there is no motion. `pose`: consistency of
/// the pose with its covariance, of a relief that of the motion.
pub fn ensemble_row(spec: &EnsembleSpec, method: &str, runs: &[Run]) -> Value {
    let answers: Vec<&Vec<Tracked>> = runs.iter().flat_map(|run| run.tracked.iter().map(|(_, t)| t)).collect();
    let sure = |tracked: &[Tracked]| tracked.iter().map(Tracked::sure_pose).collect::<Vec<_>>();
    let compared = runs.iter().zip(&answers).map(|(run, tracked)| compare_motion(&sure(tracked), &run.truth));
    let errors: Vec<Vec<Option<MotionErrors>>> = compared.collect();
    let whole = answers.iter().any(|tracked| tracked.iter().any(|t| t.turn_observed));
    let later = || errors.iter().flat_map(|sequence| sequence.iter().skip(1)).flatten();
    let consistent = |of: fn(&Tracked) -> Option<f64>| {
        let ok = |tracked: &&Vec<Tracked>| -> Vec<f64> {
            tracked.iter().filter(|t| t.status == Status::Ok).filter_map(of).collect()
        };
        consistency(&answers.iter().map(ok).collect::<Vec<_>>())
    };
    let row = json!({
        "ensemble": spec.common.name, "method": method, "sequences": runs.len(),
        "frames": answers.iter().map(|tracked| tracked.len()).sum::<usize>(),
        "lost": errors.iter().flatten().filter(|error| error.is_none()).count(),
        "wrong_ok": later().filter(|e| !is_right(e, whole)).count(),
        "pose": consistent(|t| t.normalised_error), "motion": consistent(|t| t.normalised_motion_error),
    });
    with_errors(row, later())
}

/// Mean normalised squared error over independent sequences, by the normalised errors of each, with the interval by the spread of their
/// means. A sequence counts once, whatever its number of frames.
fn consistency(sequences: &[Vec<f64>]) -> Option<Value> {
    let means: Vec<f64> = sequences.iter().filter_map(|values| mean(values)).collect();
    let nees = mean(&means)?;
    Some(json!({"nees": nees, "interval": freedom_of_mean(&means).map(|freedom| interval(nees, freedom))}))
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Adds the errors across and along the optical axis, of the rotation, and of the normal's direction.
fn with_errors<'a>(mut row: Value, errors: impl Iterator<Item = &'a MotionErrors> + Clone) -> Value {
    let of = |value: fn(&MotionErrors) -> f64| {
        let values: Vec<f64> = errors.clone().map(value).collect();
        json!({"median": median(&values), "p95": percentile(&values, 95.0)})
    };
    row["xy_mm"] = of(|e| 1e3 * e.translation_m.xy().norm());
    row["z_mm"] = of(|e| 1e3 * e.translation_m.z.abs());
    row["rotation_deg"] = of(|e| e.rotation_rad.norm().to_degrees());
    row["tilt_deg"] = of(|e| e.tilt_rad.to_degrees());
    row
}

/// Whether a pose is right; `whole`: the rotation about the normal counts.
fn is_right(errors: &MotionErrors, whole: bool) -> bool {
    let angle = if whole { errors.rotation_rad.norm() } else { errors.tilt_rad };
    errors.translation_m.norm() <= TOLERANCE.0 && angle <= TOLERANCE.1
}

/// Frames from the first fully visible frame after the occlusion to the first right pose; all frames if there is none.
fn frames_until_back(spec: &SequenceSpec, errors: &[Option<MotionErrors>], whole: bool) -> Option<usize> {
    let free = super::sequences::HIDING[3];
    let after = spec.hides.then(|| errors.get(free..))??;
    Some(after.iter().position(|e| e.as_ref().is_some_and(|e| is_right(e, whole))).unwrap_or(after.len()))
}

fn lost(spec: &SequenceSpec, errors: &[Option<MotionErrors>], back: Option<usize>) -> usize {
    let excused = |frame: usize| {
        !spec.is_free(frame)
            || back.is_some_and(|back| {
                let free = super::sequences::HIDING[3];
                (free..free + back).contains(&frame)
            })
    };
    errors.iter().enumerate().filter(|(frame, error)| error.is_none() && !excused(*frame)).count()
}

/// Rms of the second differences over consecutive tracked frames, over sqrt(6).
fn jitter(errors: &[Option<MotionErrors>], of: impl Fn(&MotionErrors) -> Vector3<f64>) -> Option<f64> {
    let second_difference = |w: &[Option<MotionErrors>]| match w {
        [Some(a), Some(b), Some(c)] => Some((of(a) - 2.0 * of(b) + of(c)).norm()),
        _ => None,
    };
    let differences: Vec<_> = errors.windows(3).filter_map(second_difference).collect();
    Some(rms(&differences)? / 6_f64.sqrt())
}

/// Only long runs have a drift.
fn drift(errors: &[Option<MotionErrors>]) -> Option<f64> {
    let tenth = errors.len() / 10;
    let typical = |part: &[Option<MotionErrors>]| {
        median(&part.iter().flatten().map(|e| e.translation_m.norm()).collect::<Vec<_>>())
    };
    (tenth >= 100).then(|| Some(typical(&errors[errors.len() - tenth..])? / typical(&errors[..tenth])?))?
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;
    use pb3dp_benchmarks::table::number;

    use super::*;

    #[test]
    fn a_wrong_pose_behind_what_hides_it_is_counted_and_the_way_back_too() {
        let spec = super::super::sequences::all().into_iter().find(|s| s.hides).unwrap();
        let truth: Vec<Pose<CamLeft, Model>> =
            (0..spec.frames).map(|frame| spec.cam_left_from_target(frame).relabel()).collect();
        let moved = |pose: &Pose<CamLeft, Model>, by_mm: f64| {
            Pose::from_parts(pose.translation_m() + Vector3::new(0.0, 0.0, by_mm * 1e-3), pose.rotation())
        };
        let tracked: Vec<Tracked> = (0..spec.frames)
            .map(|frame| {
                let (status, pose) = match frame {
                    70 => (Status::Ok, Some(moved(&truth[frame], 5.0))),
                    62..108 => (Status::Lost, None),
                    120 => (Status::Ambiguous, Some(truth[frame])),
                    _ => (Status::Ok, Some(moved(&truth[frame], if frame % 2 == 0 { 0.0 } else { 0.1 }))),
                };
                Tracked {
                    status,
                    pose,
                    normalised_error: Some(1.5),
                    normalised_motion_error: None,
                    turn_observed: true,
                    cpu_millis: 1.0,
                }
            })
            .collect();
        let row = SequenceRow::of(&spec, "some", &tracked, &truth).row;
        let figure = |path: &str| number(&row, path).unwrap();
        assert_eq!(["wrong_ok", "frames_until_back", "lost", "nees"].map(figure), [1.0, 2.0, 1.0, 1.5]);
        assert!(figure("z_mm.p95") < 0.11 && figure("xy_mm.p95") < 1e-6, "{row}");
        // Alternating between 0 and 0.1 mm: second differences of 0.2 mm.
        assert!(
            (figure("jitter.z_mm") - 0.2 / 6f64.sqrt()).abs() < 1e-6 && figure("jitter.rotation_deg") < 1e-7,
            "{row}"
        );
        let shown = pb3dp_benchmarks::table::row(&COLUMNS, &row);
        assert!(shown.contains("| some | 150 | 1 | 1 | 2 |") && !shown.contains('?'), "{shown}");
    }

    #[test]
    fn rotations_are_compared_since_the_first_frame() {
        let spec = super::super::sequences::all().remove(0);
        let truth: Vec<Pose<CamLeft, Model>> = (0..50).map(|f| spec.cam_left_from_target(f).relabel()).collect();
        // Another frame on the same body, and from frame 1 on an error of 1 degree.
        let other: Pose<Model, Model> = Pose::from_parts(
            Vector3::new(0.01, -0.02, 0.0),
            UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 0.1, -0.8)),
        );
        let error = UnitQuaternion::from_scaled_axis(Vector3::new(0.6, 0.0, 0.8) * 1f64.to_radians());
        let tracked: Vec<Tracked> = truth
            .iter()
            .enumerate()
            .map(|(frame, pose)| {
                let turn = if frame == 0 { UnitQuaternion::identity() } else { error };
                let pose = Pose::from_parts(pose.translation_m(), turn * pose.rotation()) * other;
                Tracked {
                    status: Status::Ok,
                    pose: Some(pose),
                    normalised_error: None,
                    normalised_motion_error: None,
                    turn_observed: true,
                    cpu_millis: 1.0,
                }
            })
            .collect();
        let row = SequenceRow::of(&spec, "some", &tracked, &truth).row;
        assert!((number(&row, "rotation_deg.median").unwrap() - 1.0).abs() < 1e-6, "{row}");
        assert!(number(&row, "z_mm.p95").unwrap() < 1e-6 && row["nees"].is_null());
    }

    #[test]
    fn a_sequence_counts_once_and_the_first_frame_is_no_motion() {
        let spec = super::super::ensembles::all().remove(0);
        let truth: Vec<Pose<CamLeft, Model>> =
            (0..4).map(|k| Pose::from_translation(Vector3::new(0.0, 0.0, 0.5 + 0.01 * f64::from(k)))).collect();
        let run = |frames: usize, nees: f64, z_mm: f64| {
            let tracked = (0..frames).map(|frame| {
                let z = if frame == 0 { 0.0 } else { z_mm * 1e-3 };
                Tracked {
                    status: if frame == 3 { Status::Lost } else { Status::Ok },
                    pose: Some(Pose::from_translation(truth[frame].translation_m() + Vector3::new(0.0, 0.0, z))),
                    normalised_error: Some(nees),
                    normalised_motion_error: (frame > 0).then_some(nees),
                    turn_observed: true,
                    cpu_millis: 1.0,
                }
            });
            Run { tracked: vec![("direct", tracked.collect())], truth: truth[..frames].to_vec() }
        };
        let row = ensemble_row(&spec, "direct", &[run(4, 1.0, 0.1), run(2, 2.0, 3.0)]);
        let figure = |path: &str| number(&row, path).unwrap();
        assert_eq!(["sequences", "frames", "lost", "wrong_ok"].map(figure), [2.0, 6.0, 1.0, 1.0]);
        assert!((figure("pose.nees") - 1.5).abs() < 1e-12, "{row}");
        let [low, high] = ["pose.interval.0", "pose.interval.1"].map(figure);
        assert!(low < 1.5 && high > 1.5 && high - 1.5 > 1.5 - low, "{row}");
        assert!((figure("z_mm.median") - 0.1).abs() < 1e-6, "{row}");
        let shown = pb3dp_benchmarks::table::row(&ENSEMBLE_COLUMNS, &row);
        assert!(shown.contains("| 2 | 6 | 1 | 1 |") && !shown.contains('?'), "{shown}");
    }
}
