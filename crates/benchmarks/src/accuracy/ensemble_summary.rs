//! Statistics of the direct method on one ensemble of sequences.

use pb3dp_estimation_core::status::Status;
use pb3dp_record::metrics::{MotionErrors, compare_motion, median, percentile};
use serde_json::{Value, json};

use super::chi_square::{freedom_of_mean, interval};
use super::ensembles::EnsembleSpec;
use super::sequence_summary::{Tracked, is_right};
use super::table::with_interval;
use super::track::Run;

/// Mean normalised squared error over independent sequences, with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Consistency {
    /// The mean over the means of the sequences; 1 is consistent.
    pub nees: f64,
    /// The interval by the spread of these means; `None` for a single sequence.
    pub interval: Option<[f64; 2]>,
}

impl Consistency {
    /// By the normalised errors of each sequence. A sequence counts once, whatever its number of frames.
    fn of(sequences: &[Vec<f64>]) -> Option<Self> {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let means: Vec<f64> = sequences.iter().filter(|values| !values.is_empty()).map(|v| mean(v)).collect();
        let nees = (!means.is_empty()).then(|| mean(&means))?;
        Some(Self { nees, interval: freedom_of_mean(&means).map(|freedom| interval(nees, freedom)) })
    }

    fn to_json(self) -> Value {
        json!({"nees": self.nees, "interval": self.interval})
    }
}

/// Row of a table for one ensemble; metres and radians. Errors are those of the motion since the first frame, at the
/// target's origin, over the frames of all sequences with a confident pose.
#[derive(Clone, Debug)]
pub struct EnsembleSummary {
    /// The ensemble.
    pub ensemble: String,
    /// The method.
    pub method: &'static str,
    /// Number of sequences, and of their frames in all.
    pub sequences: usize,
    /// Frames of all sequences.
    pub frames: usize,
    /// Frames without a confident pose.
    pub lost: usize,
    /// Frames with a confident pose that is wrong.
    pub wrong_ok: usize,
    /// Error across the optical axis: median, 95th percentile.
    pub xy_m: [f64; 2],
    /// Error along it.
    pub z_m: [f64; 2],
    /// Rotation error.
    pub rotation_rad: [f64; 2],
    /// Consistency of the pose with its covariance; of a relief, that of the motion.
    pub pose: Option<Consistency>,
    /// Consistency of the motion since the first answer.
    pub motion: Option<Consistency>,
}

impl EnsembleSummary {
    /// Statistics of all runs of the ensemble, each of one method.
    pub fn of(spec: &EnsembleSpec, method: &'static str, runs: &[Run]) -> Self {
        let answers: Vec<&Vec<Tracked>> = runs.iter().flat_map(|run| run.tracked.iter().map(|(_, t)| t)).collect();
        let errors: Vec<Vec<Option<MotionErrors>>> = runs
            .iter()
            .zip(&answers)
            .map(|(run, tracked)| {
                compare_motion(&tracked.iter().map(Tracked::sure_pose).collect::<Vec<_>>(), &run.truth)
            })
            .collect();
        let whole = answers.iter().any(|tracked| tracked.iter().any(|t| t.turn_observed));
        // The first frame defines the motion: its error is zero, or there is no motion.
        let later = || errors.iter().flat_map(|sequence| sequence.iter().skip(1));
        let of = |value: &dyn Fn(&MotionErrors) -> f64| {
            let values: Vec<f64> = later().flatten().map(value).collect();
            [median(&values).unwrap_or(f64::NAN), percentile(&values, 95.0).unwrap_or(f64::NAN)]
        };
        let consistency = |of: &dyn Fn(&Tracked) -> Option<f64>| {
            let ok = |tracked: &&Vec<Tracked>| -> Vec<f64> {
                tracked.iter().filter(|t| t.status == Status::Ok).filter_map(of).collect()
            };
            Consistency::of(&answers.iter().map(ok).collect::<Vec<_>>())
        };
        Self {
            ensemble: spec.name.clone(),
            method,
            sequences: runs.len(),
            frames: answers.iter().map(|tracked| tracked.len()).sum(),
            lost: errors.iter().flatten().filter(|error| error.is_none()).count(),
            wrong_ok: later().flatten().filter(|e| !is_right(e, whole)).count(),
            xy_m: of(&|e| e.translation_m.xy().norm()),
            z_m: of(&|e| e.translation_m.z.abs()),
            rotation_rad: of(&|e| e.rotation_rad.norm()),
            pose: consistency(&|t| t.normalised_error),
            motion: consistency(&|t| t.normalised_motion_error),
        }
    }

    /// For the JSON file; millimetres and degrees.
    pub fn to_json(&self) -> Value {
        let pair = |values: [f64; 2], scale: f64| {
            let finite = |value: f64| value.is_finite().then_some(value * scale);
            json!({"median": finite(values[0]), "p95": finite(values[1])})
        };
        json!({
            "ensemble": self.ensemble, "method": self.method, "sequences": self.sequences, "frames": self.frames,
            "lost": self.lost, "wrong_ok": self.wrong_ok,
            "xy_mm": pair(self.xy_m, 1e3), "z_mm": pair(self.z_m, 1e3),
            "rotation_deg": pair(self.rotation_rad, 1f64.to_degrees()),
            "pose": self.pose.map(Consistency::to_json), "motion": self.motion.map(Consistency::to_json),
        })
    }
}

/// Headings of the table.
pub const HEADINGS: [&str; 10] = [
    "ensemble",
    "sequences",
    "frames",
    "lost",
    "wrong ok",
    "xy mm med / p95",
    "z mm med / p95",
    "rotation deg med / p95",
    "NEES of the pose",
    "NEES of the motion",
];

/// Column widths on the terminal.
const WIDTHS: [usize; 10] = [30, 11, 8, 6, 10, 17, 17, 24, 21, 21];

/// The cells of a row.
pub fn row(s: &EnsembleSummary) -> [String; 10] {
    let number = |value: f64| if value.is_finite() { format!("{value:.3}") } else { "-".to_owned() };
    let pair = |values: [f64; 2], scale: f64| format!("{} / {}", number(values[0] * scale), number(values[1] * scale));
    let consistency = |c: Option<Consistency>| with_interval(c.map(|c| c.nees), c.and_then(|c| c.interval));
    [
        s.ensemble.clone(),
        s.sequences.to_string(),
        s.frames.to_string(),
        s.lost.to_string(),
        s.wrong_ok.to_string(),
        pair(s.xy_m, 1e3),
        pair(s.z_m, 1e3),
        pair(s.rotation_rad, 1f64.to_degrees()),
        consistency(s.pose),
        consistency(s.motion),
    ]
}

/// A row for the terminal.
pub fn line(cells: &[String; 10]) -> String {
    let mut line = String::new();
    for (index, (cell, width)) in cells.iter().zip(WIDTHS).enumerate() {
        line += &if index < 1 { format!("{cell:<width$}") } else { format!("{cell:>width$}") };
    }
    line
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use pb3dp_geometry::Pose;
    use pb3dp_geometry::frames::{CamLeft, Model};

    use super::*;

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
        let summary = EnsembleSummary::of(&spec, "direct", &[run(4, 1.0, 0.1), run(2, 2.0, 3.0)]);
        assert_eq!((summary.sequences, summary.frames, summary.lost, summary.wrong_ok), (2, 6, 1, 1));
        let pose = summary.pose.unwrap();
        assert!((pose.nees - 1.5).abs() < 1e-12, "{pose:?}");
        let [low, high] = pose.interval.unwrap();
        assert!(low < 1.5 && high > 1.5 && high - 1.5 > 1.5 - low, "{pose:?}");
        assert!((summary.z_m[0] - 1e-4).abs() < 1e-9, "{summary:?}");
    }
}
