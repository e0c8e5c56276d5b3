//! The line of one target in one frame of a sequence.

use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::status::SCHEMA_VERSION;
use pb3dp_record::plain_zero::plain_zero;
use serde::Serialize;

use super::millimetres::{covariance_mm, row_major_mm};

/// The result of one frame, in the units of the interface; the order of the fields is that of the JSON line.
#[derive(Clone, Debug, Serialize)]
pub struct TrackLine {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Frame number, from 0.
    pub frame: usize,
    /// Target number, only for several targets: 0 is that of the sequence, followed by those of the command line.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<usize>,
    /// Mid-exposure, seconds.
    pub t_s: f64,
    /// `ok`, `weak-tilt`, `partly-observed`, `ambiguous`, `miscalibrated`, `not-observable`, `lost` or `error`.
    pub status: &'static str,
    /// Row-major homogeneous matrix, millimetres.
    pub cam_left_from_model: Option<[f64; 16]>,
    /// Covariance of the pose since the first one, in the first frame that of the first one; row-major, of `xi` = translation (mm), then
    /// rotation (radians), along the axes of `model`: true pose = pose exp(xi).
    pub covariance: Option<Vec<f64>>,
    /// The same of the first pose against the visible surface of the target.
    pub first_pose_covariance: Option<Vec<f64>>,
    /// The sum: the same of this pose against the visible surface.
    pub pose_covariance: Option<Vec<f64>>,
    /// The share of the calibration in `pose_covariance`; only if the calibration file has a covariance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration_covariance: Option<Vec<f64>>,
    /// The same for the motion since the first pose, not contained in `covariance`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration_covariance_of_motion: Option<Vec<f64>>,
    /// The visible surface beside `model`, as the frames so far show it: row-major homogeneous matrix, millimetres.
    pub surface_from_model: Option<[f64; 16]>,
    /// Covariance of `surface` against the visible surface, as `covariance`.
    pub surface_covariance: Option<Vec<f64>>,
    /// Number of frames that have improved it; 0: it is `model`.
    pub surface_version: Option<u32>,
    /// Whether the images determine each direction of the pose, in the order of `covariance`; null if the method does not tell.
    pub observed: Option<[bool; 6]>,
    /// Agreement of the images, at most 1; eq. (10) for the published method.
    pub fitness: Option<f64>,
    /// CPU time of one thread from images in memory to pose, milliseconds.
    pub ms: Option<f64>,
    /// Reason for the status.
    pub reason: String,
    /// Warnings: what may make the pose worse than its status.
    pub warnings: Vec<String>,
}

impl TrackLine {
    /// Heading of the human table, with a column for the target if there are several.
    pub fn heading(several: bool) -> String {
        let target = if several { " target" } else { "" };
        format!(
            "frame{target}      t s  status           x mm      y mm      z mm  rotation vector deg         fitness       ms"
        )
    }

    /// The lines of a frame that could not be read, with the reason.
    pub fn all_of_error(frame: usize, t_s: f64, targets: usize, reason: &str) -> Vec<Self> {
        let number = |index: usize| (targets > 1).then_some(index);
        (0..targets).map(|index| Self { target: number(index), ..Self::of_error(frame, t_s, reason) }).collect()
    }

    /// A frame or a target without an estimate, with the reason.
    pub fn of_error(frame: usize, t_s: f64, reason: &str) -> Self {
        Self {
            schema_version: SCHEMA_VERSION,
            frame,
            target: None,
            t_s,
            status: "error",
            cam_left_from_model: None,
            covariance: None,
            first_pose_covariance: None,
            pose_covariance: None,
            calibration_covariance: None,
            calibration_covariance_of_motion: None,
            surface_from_model: None,
            surface_covariance: None,
            surface_version: None,
            observed: None,
            fitness: None,
            ms: None,
            reason: reason.to_owned(),
            warnings: Vec::new(),
        }
    }

    /// The line of an estimate.
    pub fn of(frame: usize, t_s: f64, estimate: &TrackEstimate, ms: f64) -> Self {
        let surface = estimate.surface.as_ref();
        Self {
            status: estimate.status.as_str(),
            cam_left_from_model: estimate.cam_left_from_model.as_ref().map(row_major_mm),
            covariance: estimate.covariance.as_ref().map(covariance_mm),
            first_pose_covariance: estimate.first_pose_covariance.as_ref().map(covariance_mm),
            pose_covariance: estimate.pose_covariance.as_ref().map(covariance_mm),
            calibration_covariance: estimate.calibration.map(|share| covariance_mm(&share.pose)),
            calibration_covariance_of_motion: estimate.calibration.map(|share| covariance_mm(&share.motion)),
            surface_from_model: surface.map(|known| row_major_mm(&known.surface_from_model)),
            surface_covariance: surface.map(|known| covariance_mm(&known.covariance)),
            surface_version: surface.map(|known| known.version),
            observed: estimate.observed,
            fitness: estimate.fitness,
            ms: Some(ms),
            warnings: estimate.warnings.iter().map(ToString::to_string).collect(),
            ..Self::of_error(frame, t_s, &estimate.reason)
        }
    }

    /// The line of the human table, with the time since the first frame: the times of a recording may be dates.
    pub fn human(&self, first_s: f64) -> String {
        let number = |value: Option<f64>, decimals: usize| value.map_or("-".into(), |x| format!("{x:.decimals$}"));
        let at = |k: usize| number(self.cam_left_from_model.map(|m| m[k]), 2);
        let turn = self.cam_left_from_model.map_or("-".into(), |m| {
            let rotation = nalgebra::Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
            let v = nalgebra::Rotation3::from_matrix_unchecked(rotation).scaled_axis().map(f64::to_degrees);
            format!("{:+.2} {:+.2} {:+.2}", v.x, v.y, v.z)
        });
        plain_zero(&format!(
            "{:>5}{} {:>8.3}  {:<14} {:>9} {:>9} {:>9}  {:<25} {:>8} {:>8}",
            self.frame,
            self.target.map_or(String::new(), |target| format!(" {target:>6}")),
            self.t_s - first_s,
            self.status,
            at(3),
            at(7),
            at(11),
            turn,
            number(self.fitness, 3),
            number(self.ms, 2)
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_target_is_counted_only_if_there_are_several() {
        let json = |lines: &[TrackLine]| -> Vec<String> {
            lines.iter().map(|line| serde_json::to_string(line).unwrap()).collect()
        };
        let one = json(&TrackLine::all_of_error(4, 0.25, 1, "no file"));
        assert_eq!(one.len(), 1);
        assert!(
            one[0].starts_with(r#"{"schema_version":1,"frame":4,"t_s":0.25,"status":"error","#)
                && !one[0].contains("target")
        );
        let two = json(&TrackLine::all_of_error(4, 0.25, 2, "no file"));
        assert!(two[1].starts_with(r#"{"schema_version":1,"frame":4,"target":1,"t_s":0.25,"#), "{two:?}");
    }

    #[test]
    fn columns_stay_below_their_headings_if_the_times_are_dates() {
        let first_s = 1_700_000_000.0;
        for several in [false, true] {
            let [heading, line] = [TrackLine::heading(several), {
                let line = TrackLine::of_error(7, first_s + 12.5, "no file");
                TrackLine { target: several.then_some(1), ..line }.human(first_s)
            }];
            assert_eq!(heading.find("status"), line.find("error"), "{heading}\n{line}");
            assert!(line.contains(" 12.500  error"), "{line}");
        }
    }
}
