//! Statistics of one method on one sequence.

use nalgebra::Vector3;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_record::metrics::{MotionErrors, compare_motion, median, percentile, rms};
use serde_json::{Value, json};

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

/// Row of a table for one method on one sequence; metres and radians. Errors are those of the motion since the first
/// frame, at the target's origin, over the frames with a confident pose.
#[derive(Clone, Debug)]
pub struct SequenceSummary {
    /// The sequence.
    pub sequence: String,
    /// The method.
    pub method: &'static str,
    /// Number of frames.
    pub frames: usize,
    /// Frames without a confident pose while the target was visible; frames until recovery from an occlusion do not count.
    pub lost: usize,
    /// Frames with a confident pose that is wrong.
    pub wrong_ok: usize,
    /// Frames from the end of the occlusion to the first right and confident pose; `None` without an occlusion.
    pub frames_until_back: Option<usize>,
    /// Error across the optical axis: median, 95th percentile.
    pub xy_m: [f64; 2],
    /// Error along it.
    pub z_m: [f64; 2],
    /// Rotation error.
    pub rotation_rad: [f64; 2],
    /// Error of the normal's direction.
    pub tilt_rad: [f64; 2],
    /// Jitter from frame to frame: along the axis and of the rotation (see `record::metrics::motion`).
    pub jitter: Option<[f64; 2]>,
    /// Median error of the last tenth of the frames over that of the first tenth: drift of a long run.
    pub drift_ratio: Option<f64>,
    /// Mean normalised squared error of the confident poses; 1 is consistent.
    pub nees: Option<f64>,
    /// CPU time of a frame after the first, milliseconds, median.
    pub cpu_millis: f64,
    /// Depth error per frame, for the figure; NaN without a confident pose.
    pub z_errors_m: Vec<f64>,
    /// Rotation error per frame.
    pub rotation_errors_rad: Vec<f64>,
}

impl SequenceSummary {
    /// Statistics of one method's answers; `truth` is the pose of any frame fixed to the body.
    pub fn of(spec: &SequenceSpec, method: &'static str, tracked: &[Tracked], truth: &[Pose<CamLeft, Model>]) -> Self {
        let sure: Vec<_> = tracked.iter().map(Tracked::sure_pose).collect();
        let errors = compare_motion(&sure, truth);
        let whole = tracked.iter().any(|t| t.turn_observed);
        let of = |value: &dyn Fn(&MotionErrors) -> f64| {
            let values: Vec<f64> = errors.iter().flatten().map(value).collect();
            [median(&values).unwrap_or(f64::NAN), percentile(&values, 95.0).unwrap_or(f64::NAN)]
        };
        let nees: Vec<f64> =
            tracked.iter().filter(|t| t.status == Status::Ok).filter_map(|t| t.normalised_error).collect();
        let times: Vec<f64> = tracked.iter().skip(1).map(|t| t.cpu_millis).collect();
        let back = frames_until_back(spec, &errors, whole);
        let per_frame =
            |value: &dyn Fn(&MotionErrors) -> f64| errors.iter().map(|e| e.as_ref().map_or(f64::NAN, value)).collect();
        Self {
            sequence: spec.name.clone(),
            method,
            frames: tracked.len(),
            lost: lost(spec, &errors, back),
            wrong_ok: errors.iter().flatten().filter(|e| !is_right(e, whole)).count(),
            frames_until_back: back,
            xy_m: of(&|e| e.translation_m.xy().norm()),
            z_m: of(&|e| e.translation_m.z.abs()),
            rotation_rad: of(&|e| e.rotation_rad.norm()),
            tilt_rad: of(&|e| e.tilt_rad),
            jitter: jitter(&errors, |e| Vector3::new(0.0, 0.0, e.translation_m.z))
                .zip(jitter(&errors, |e| e.rotation_rad))
                .map(|(z, rotation)| [z, rotation]),
            drift_ratio: drift(&errors),
            nees: (!nees.is_empty()).then(|| nees.iter().sum::<f64>() / nees.len() as f64),
            cpu_millis: median(&times).unwrap_or(f64::NAN),
            z_errors_m: per_frame(&|e| e.translation_m.z),
            rotation_errors_rad: per_frame(&|e| e.rotation_rad.norm()),
        }
    }

    /// For the JSON file; millimetres and degrees.
    pub fn to_json(&self) -> Value {
        let pair = |values: [f64; 2], scale: f64| {
            let finite = |value: f64| value.is_finite().then_some(value * scale);
            json!({"median": finite(values[0]), "p95": finite(values[1])})
        };
        let degrees = 1f64.to_degrees();
        json!({
            "sequence": self.sequence, "method": self.method, "frames": self.frames,
            "lost": self.lost, "wrong_ok": self.wrong_ok, "frames_until_back": self.frames_until_back,
            "xy_mm": pair(self.xy_m, 1e3), "z_mm": pair(self.z_m, 1e3),
            "rotation_deg": pair(self.rotation_rad, degrees), "tilt_deg": pair(self.tilt_rad, degrees),
            "jitter": self.jitter.map(|[z, rotation]| json!({"z_mm": z * 1e3, "rotation_deg": rotation * degrees})),
            "drift_ratio": self.drift_ratio, "nees": self.nees,
            "cpu_ms": self.cpu_millis.is_finite().then_some(self.cpu_millis),
        })
    }
}

/// Whether a pose is right; `whole`: the rotation about the normal counts.
pub fn is_right(errors: &MotionErrors, whole: bool) -> bool {
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

/// Headings of the sequence table.
pub const HEADINGS: [&str; 14] = [
    "sequence",
    "method",
    "frames",
    "lost",
    "wrong ok",
    "until back",
    "xy mm med / p95",
    "z mm med / p95",
    "rotation deg med / p95",
    "tilt deg med / p95",
    "jitter z mm, deg",
    "drift",
    "NEES",
    "ms",
];

/// Column widths on the terminal.
const WIDTHS: [usize; 14] = [30, 16, 7, 6, 9, 11, 17, 17, 23, 20, 17, 7, 8, 8];

/// The cells of a row.
pub fn row(s: &SequenceSummary) -> [String; 14] {
    let number = |value: Option<f64>, digits: usize| match value {
        Some(value) if value.is_finite() => format!("{value:.digits$}"),
        _ => "-".to_owned(),
    };
    let pair = |values: [f64; 2], scale: f64| {
        format!("{} / {}", number(Some(values[0] * scale), 3), number(Some(values[1] * scale), 3))
    };
    let degrees = 1f64.to_degrees();
    [
        s.sequence.clone(),
        s.method.to_owned(),
        s.frames.to_string(),
        s.lost.to_string(),
        s.wrong_ok.to_string(),
        s.frames_until_back.map_or("-".to_owned(), |frames| frames.to_string()),
        pair(s.xy_m, 1e3),
        pair(s.z_m, 1e3),
        pair(s.rotation_rad, degrees),
        pair(s.tilt_rad, degrees),
        s.jitter.map_or("-".to_owned(), |[z, turn]| format!("{:.3}, {:.3}", z * 1e3, turn * degrees)),
        number(s.drift_ratio, 2),
        number(s.nees, 2),
        number(Some(s.cpu_millis), 2),
    ]
}

/// A row for the terminal.
pub fn line(cells: &[String; 14]) -> String {
    let mut line = String::new();
    for (index, (cell, width)) in cells.iter().zip(WIDTHS).enumerate() {
        line += &if index < 2 { format!("{cell:<width$}") } else { format!("{cell:>width$}") };
    }
    line
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

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
        let summary = SequenceSummary::of(&spec, "some", &tracked, &truth);
        assert_eq!((summary.wrong_ok, summary.frames_until_back, summary.lost), (1, Some(2), 1));
        assert!(summary.z_m[1] < 1.1e-4 && summary.xy_m[1] < 1e-9, "{summary:?}");
        assert_eq!(summary.nees, Some(1.5));
        // Alternating between 0 and 0.1 mm: second differences of 0.2 mm.
        let [z, turn] = summary.jitter.unwrap();
        assert!((z - 0.2e-3 / 6f64.sqrt()).abs() < 1e-9 && turn < 1e-9, "{z}");
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
        let summary = SequenceSummary::of(&spec, "some", &tracked, &truth);
        assert!((summary.rotation_rad[0].to_degrees() - 1.0).abs() < 1e-6, "{summary:?}");
        assert!(summary.z_m[1] < 1e-9 && summary.nees.is_none());
    }
}
