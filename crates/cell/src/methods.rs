//! Figures of each estimation method in a run. All methods process the same pairs.

use std::collections::BTreeMap;

use pb3dp_record::metrics::motion::{MotionSummary, compare_motion};
use pb3dp_record::metrics::{Statistics, percentile};
use pb3dp_record::report::{LinePlot, Series, SeriesColor, Table};
use serde::Serialize;

use super::log::{FrameSample, MethodLog, RunLog};
use crate::figures::MedianP95;
use crate::marks::with_marks;

/// Errors, jitter and latency of one method.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MethodSummary {
    /// Name of the method.
    pub method: String,
    /// Whether it led the hand; the other methods only estimated.
    pub leads: bool,
    /// Absolute depth error, mm.
    pub depth_mm: Option<MedianP95>,
    /// Normal error, degrees.
    pub normal_deg: Option<MedianP95>,
    /// Error of the motion since the first pose, at one point of the target, mm.
    pub motion_mm: Option<MedianP95>,
    /// Error of the rotation since the first pose, degrees; includes the rotation about the normal, observed or not.
    pub rotation_deg: Option<MedianP95>,
    /// Jitter of that point, mm (definition: docs/method.md).
    pub jitter_mm: Option<f64>,
    /// Jitter of the rotation, degrees.
    pub jitter_deg: Option<f64>,
    /// Median wall time from the pair in memory to the estimate, milliseconds.
    pub latency_p50_millis: Option<f64>,
    /// 99th percentile of the same time, milliseconds.
    pub latency_p99_millis: Option<f64>,
    /// Number of frames with each status.
    pub frames_by_status: BTreeMap<String, usize>,
    /// Whether the rotation about the model's normal was measured.
    pub rotation_about_normal_observed: bool,
}

/// All methods of a run, the leading one first.
pub fn summaries(log: &RunLog, leading: MethodSummary) -> Vec<MethodSummary> {
    std::iter::once(leading).chain(log.compared.iter().map(MethodSummary::of)).collect()
}

impl MethodSummary {
    /// The method that leads the hand.
    pub fn leading(log: &RunLog) -> Self {
        Self { leads: true, ..Self::of(&log.leading) }
    }

    fn of(log: &MethodLog) -> Self {
        let column =
            |pick: fn(&FrameSample) -> Option<f64>| -> Vec<f64> { log.frames.iter().filter_map(pick).collect() };
        let latencies = column(|f| Some(f.latency_millis));
        let motion = MotionSummary::of(&compare_motion(&log.estimated, &log.truth));
        let scaled = |s: &Statistics, scale: f64| MedianP95 { median: s.median * scale, p95: s.p95 * scale };
        let degrees = 1_f64.to_degrees();
        Self {
            method: log.method.clone(),
            leads: false,
            depth_mm: MedianP95::of(&column(|f| f.depth_error_m.map(|e| e.abs() * 1e3))),
            normal_deg: MedianP95::of(&column(|f| f.normal_error_rad.map(f64::to_degrees))),
            motion_mm: motion.as_ref().map(|m| scaled(&m.translation_m, 1e3)),
            rotation_deg: motion.as_ref().map(|m| scaled(&m.rotation_rad, degrees)),
            jitter_mm: motion.as_ref().and_then(|m| m.translation_jitter_m).map(|j| j * 1e3),
            jitter_deg: motion.as_ref().and_then(|m| m.rotation_jitter_rad).map(f64::to_degrees),
            latency_p50_millis: percentile(&latencies, 50.0),
            latency_p99_millis: percentile(&latencies, 99.0),
            frames_by_status: log.frames.iter().fold(BTreeMap::new(), |mut counts, frame| {
                *counts.entry(frame.status.clone()).or_default() += 1;
                counts
            }),
            rotation_about_normal_observed: log.rotation_about_normal_observed,
        }
    }

    fn cells(&self) -> [String; 9] {
        let digits = |x: f64| if x.abs() < 0.1 { format!("{x:.3}") } else { format!("{x:.2}") };
        let pair = |value: Option<MedianP95>| {
            value.map_or("-".into(), |v| format!("{} / {}", digits(v.median), digits(v.p95)))
        };
        let number = |value: Option<f64>| value.map_or("-".into(), digits);
        let statuses: Vec<String> = self.frames_by_status.iter().map(|(status, n)| format!("{n} {status}")).collect();
        [
            format!("{}{}", self.method, if self.leads { " (leads)" } else { "" }),
            pair(self.depth_mm),
            pair(self.normal_deg),
            pair(self.motion_mm),
            pair(self.rotation_deg),
            number(self.jitter_mm),
            number(self.jitter_deg),
            number(self.latency_p50_millis),
            statuses.join(", "),
        ]
    }
}

const HEADINGS: [&str; 9] =
    ["method", "depth, mm", "normal, deg", "motion, mm", "rotation, deg", "jitter, mm", "jitter, deg", "ms", "frames"];

/// The figures as a report table.
pub fn table(methods: &[MethodSummary]) -> Table {
    methods.iter().fold(Table::new(HEADINGS), |table, method| table.row(method.cells()))
}

/// The figures as terminal lines.
pub fn text_table(methods: &[MethodSummary]) -> String {
    let rows: Vec<[String; 9]> =
        std::iter::once(HEADINGS.map(str::to_owned)).chain(methods.iter().map(MethodSummary::cells)).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..HEADINGS.len()).map(width).collect();
    let line = |row: &[String; 9]| {
        let cells: Vec<String> = row.iter().zip(&widths).map(|(cell, &width)| format!("{cell:<width$}")).collect();
        cells.join("  ").trim_end().to_owned() + "\n"
    };
    rows.iter().map(line).collect()
}

/// Depth and normal errors of all methods over time, in the same axes.
pub fn panels(log: &RunLog) -> Vec<LinePlot> {
    type Pick = fn(&FrameSample) -> Option<f64>;
    let figures: [(&str, (&str, &str), Pick); 2] = [
        ("estimate: depth error", ("error", "mm"), |f| f.depth_error_m.map(|e| e * 1e3)),
        ("estimate: normal error", ("error", "deg"), |f| f.normal_error_rad.map(f64::to_degrees)),
    ];
    let colours = [SeriesColor::Blue, SeriesColor::Red, SeriesColor::Green];
    let logs: Vec<&MethodLog> = std::iter::once(&log.leading).chain(&log.compared).collect();
    let panel = |(title, axis, pick): (&str, (&str, &str), Pick)| {
        // The leading method is drawn last, over the others.
        let plot = LinePlot::new(title, ("time", "s"), axis);
        let plot = logs.iter().enumerate().rev().fold(plot, |plot, (index, method)| {
            let colour = colours[index % colours.len()];
            let points = method.frames.iter().map(|f| [f.t_s, pick(f).unwrap_or(f64::NAN)]).collect();
            plot.series(Series::line(method.method.clone(), colour, points))
        });
        with_marks(plot, log)
    };
    figures.into_iter().map(panel).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use pb3dp_geometry::Pose;
    use pb3dp_geometry::frames::{CamLeft, Model};

    use super::*;

    /// A method with 3 mm depth error that measures half of the turn and has no pose in every fifth frame.
    fn log() -> MethodLog {
        let turn = |angle: f64| UnitQuaternion::from_scaled_axis(Vector3::new(0.6, 0.0, 0.8) * angle);
        let pose = |t: f64, share: f64| -> Pose<CamLeft, Model> {
            Pose::from_parts(Vector3::new(0.01 * t, 0.02, 0.5), turn(0.01 * t * share))
        };
        let has_pose = |i: usize| i % 5 != 4;
        MethodLog {
            method: "half-blind".into(),
            frames: (0..50)
                .map(|i| FrameSample {
                    t_s: i as f64 * 0.1,
                    status: if has_pose(i) { "ok" } else { "lost" }.into(),
                    fitness: None,
                    depth_error_m: has_pose(i).then_some(0.003),
                    normal_error_rad: has_pose(i).then_some(0.01),
                    latency_millis: i as f64,
                    age_millis: None,
                    covariance: None,
                    pose_covariance: None,
                })
                .collect(),
            estimated: (0..50).map(|i| has_pose(i).then(|| pose(i as f64, 0.5))).collect(),
            truth: (0..50).map(|i| pose(i as f64, 1.0)).collect(),
            rotation_about_normal_observed: true,
        }
    }

    #[test]
    fn the_figures_are_those_that_were_put_in() {
        let run = RunLog { leading: log(), compared: vec![log()], ..RunLog::default() };
        let methods = summaries(&run, MethodSummary::leading(&run));
        assert!(methods[0].leads && !methods[1].leads);
        let method = &methods[1];
        assert!((method.depth_mm.unwrap().median - 3.0).abs() < 1e-9);
        assert_eq!((method.frames_by_status["ok"], method.frames_by_status["lost"]), (40, 10));
        // Half of the turn is missing: 0.005 rad per frame, up to frame 48.
        let largest = 0.005_f64.to_degrees() * 48.0;
        assert!(method.rotation_deg.unwrap().p95 > 0.9 * largest && method.rotation_deg.unwrap().p95 <= largest + 1e-9);
        assert!(method.motion_mm.unwrap().p95 < 1e-6, "{method:?}");
        let text = text_table(&methods);
        assert!(text.contains("half-blind (leads)") && text.contains("40 ok"), "{text}");
        assert_eq!(panels(&run).len(), 2);
    }

    #[test]
    fn a_method_without_poses_has_no_errors() {
        let summary = MethodSummary::of(&MethodLog::default());
        assert!(summary.depth_mm.is_none() && summary.motion_mm.is_none() && summary.latency_p50_millis.is_none());
    }
}
