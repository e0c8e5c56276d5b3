//! The report of a run: one self-contained page, and the same figures as text and JSON.

use std::fmt::Write as _;
use std::io;
use std::path::Path;

use anyhow::{Context, Result};
use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_estimation_core::status::SCHEMA_VERSION;
use pb3dp_record::estimates_csv::{self, EstimateRow};
use pb3dp_record::plain_zero::plain_zero;
use pb3dp_record::report::{LinePlot, Report, ReportImage, Series, SeriesColor, Table};
use pb3dp_record::text_file::write_text;
use pb3dp_setup::layers::toml_of;
use pb3dp_setup::setup::{CalibrationInUse, Setup};

use super::channels::ChannelSummary;
use super::journal::Outcome;
use super::log::{ControlSample, MethodLog, RunLog};
use super::machine::machine;
use super::summary::{RunSummary, summarize};
use super::{commands, cycles, drift, methods};
use crate::figures::{MedianP95, RmsMax, TrackingError};
use crate::marks::with_marks;

/// Expected share of the time in which the hand follows.
const FOLLOWING_EXPECTED: f64 = 0.9;

/// How a run was made; only the program knows these facts.
#[derive(Clone, Debug, Default)]
pub struct Made {
    /// Source of the setup, as on the command line.
    pub configuration: String,
    /// Commit that the program was built from.
    pub commit: &'static str,
    /// Duration of the run, seconds of wall time.
    pub wall_s: f64,
}

/// Writes the report of a run and prints its figures with `print`; returns how well the hand followed, unless the run failed.
///
/// # Errors
/// The failure that ended the run early (`how`), and failures to write the report.
pub fn write_report(
    folder: &Path,
    setup: &Setup,
    made: &Made,
    outcome: &Outcome,
    how: Result<()>,
    print: impl Fn(&str) -> io::Result<()>,
) -> Result<Following> {
    let ended_by = how.as_ref().err().map(|failure| format!("{failure:#}"));
    combine_errors(how, write_report_of_recording(folder, setup, made, (outcome, ended_by), print))
}

/// The same for a run that is over; `ended_by` is the failure that ended it early.
///
/// # Errors
/// Failures to write the report.
pub fn write_report_of_recording(
    folder: &Path,
    setup: &Setup,
    made: &Made,
    (outcome, ended_by): (&Outcome, Option<String>),
    print: impl Fn(&str) -> io::Result<()>,
) -> Result<Following> {
    let summary = RunSummary { ended_by, ..summarize(&outcome.log, &outcome.plan) };
    write_all(folder, setup, made, (outcome, &summary), print)
}

/// Combines the end of the run with the outcome of its report.
fn combine_errors<T>(how: Result<()>, written: Result<T>) -> Result<T> {
    match (how, written) {
        (Err(failure), Err(report_failure)) => {
            Err(failure.context(format!("the run failed, and its report is incomplete ({report_failure:#})")))
        }
        (how, written) => how.and(written),
    }
}

/// Writes `report.html`, `summary.json`, `estimates.csv`, `timeseries.csv` and `settings.toml` into `folder`; prints the figures and the
/// path of the report.
fn write_all(
    folder: &Path,
    setup: &Setup,
    made: &Made,
    (outcome, summary): (&Outcome, &RunSummary),
    print: impl Fn(&str) -> io::Result<()>,
) -> Result<Following> {
    let provenance = provenance(made, setup, summary.duration_s);
    let facts: std::collections::BTreeMap<_, _> = provenance.iter().cloned().collect();
    let json = serde_json::json!({ "schema_version": SCHEMA_VERSION, "provenance": facts, "summary": summary });
    let write = |name: &str, text: String| {
        let file = folder.join(name);
        write_text(&file, &text).with_context(|| format!("{}: cannot be written", file.display()))
    };
    write("summary.json", serde_json::to_string_pretty(&json)? + "\n")?;
    let joints = [&setup.rig.arms.vs, &setup.rig.arms.tc].map(|arm| arm.chain.joints());
    write("timeseries.csv", timeseries_csv(&outcome.log, joints))?;
    write("estimates.csv", estimates_csv(&outcome.log.leading))?;
    let settings = setup.layers.effective();
    write("settings.toml", toml_of(&settings))?;
    let origin = Table::new(["run", ""]);
    let origin = provenance.iter().fold(origin, |table, (key, value)| table.row([key.clone(), value.clone()]));
    let settings = settings.iter().fold(Table::new(["key", "value", "origin"]), |table, setting| {
        table.row([setting.key.clone(), setting.value.clone(), setting.origin.clone()])
    });
    let page = page(outcome, summary, &outcome.plan.world_from_axes).heading("Provenance").table(&origin);
    page.folded("All settings and their origin", &settings).write(&folder.join("report.html"))?;
    print(&plain_zero(&text_table(summary)))?;
    let following = summary.supervisor.share_following;
    print(&format!("report: {}", folder.join("report.html").display()))?;
    Ok(if following < FOLLOWING_EXPECTED { Following::TooLittle { share: following } } else { Following::Well })
}

/// Whether the hand followed the target for the expected share of the time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Following {
    /// At least 90 % of the time.
    Well,
    /// Less.
    TooLittle {
        /// Share of the time, 0 to 1.
        share: f64,
    },
}

impl Following {
    /// Logs that the hand followed for too little time, if it did.
    pub fn warn(self) {
        let Self::TooLittle { share } = self else { return };
        tracing::warn!(
            "the hand followed the target for {:.1} % of the time, expected {:.0} %; see the statuses above and the supervisor in the report",
            100.0 * share,
            100.0 * FOLLOWING_EXPECTED
        );
    }
}

/// Information for repeating the run.
fn provenance(made: &Made, setup: &Setup, simulated_s: f64) -> Vec<(String, String)> {
    let calibrations: Vec<String> = setup.rig.calibrations.iter().map(CalibrationInUse::text).collect();
    let compared: Vec<&str> = setup.compared.iter().map(|method| method.name()).collect();
    let images = match setup.rig.real_cameras.as_ref() {
        Some(cameras) => cameras.names(),
        None if setup.leader.needs_images() => "rendered".to_owned(),
        None => "none".to_owned(),
    };
    let or = |list: String, nothing: &str| if list.is_empty() { nothing.to_owned() } else { list };
    [
        ("program", format!("pb3dp {}", env!("CARGO_PKG_VERSION"))),
        ("commit", made.commit.to_owned()),
        ("configuration", made.configuration.clone()),
        ("method", setup.leader.name().to_owned()),
        ("pictures", images),
        ("calibrations", or(calibrations.join("; "), "none: nominal")),
        ("compared", or(compared.join(", "), "none")),
        ("seed", setup.seed.to_string()),
        ("machine", machine()),
        ("duration", format!("{simulated_s:.1} s of experiment in {:.1} s", made.wall_s)),
    ]
    .map(|(key, value)| (key.to_owned(), value))
    .to_vec()
}

fn page(outcome: &Outcome, summary: &RunSummary, world_from_axes: &UnitQuaternion<f64>) -> Report {
    let log = &outcome.log;
    let (motion, errors) = (motion_panels(log, world_from_axes), error_panels(log, summary));
    let strip: Vec<_> =
        outcome.strip.images.iter().map(|(image, caption)| (ReportImage::Photo(image), caption.clone())).collect();
    let report = Report::new("pb3dp: a hand follows an unknown object");
    let report = match &summary.ended_by {
        Some(failure) => report.heading("The run ended early").paragraph(failure),
        None => report,
    };
    let report = report
        .paragraph(introduction(summary))
        .figures(&figures(summary))
        .heading("Target and hand")
        .paragraph(
            "Displacement since the start, and vector part of the unit quaternion of the rotation since the start (0.17 for 20 degrees). \
             Both are along the axes of the experiment: by default those of the target at the start, with x right, y down, z away \
             from the cameras. When the target rotates, the hand moves around it. Wanted: the desired hand pose in front of the \
             true target.",
        )
        .panels(&motion)
        .heading("Tracking error per axis")
        .paragraph(
            "Error and lag of the hand along the moving axis. Lag: by cross-correlation over the moves out and back. Rise delay: \
             10 to 90 % rise time of the hand minus that of the desired displacement. The desired pose is in front of the \
             target's true plane. The residual at hold therefore contains the error of the plane that the method fitted in the \
             first pair: its depth error, and its tilt error times the distance of the hand.",
        )
        .table(&channel_table(summary))
        .paragraph(
            "The same errors against the desired pose by the initial lock, the mean of the estimates before the first move: distance \
             and angle, not along one axis only. The residual comes from the servo and from the noise of the estimates.",
        )
        .table(&locked_table(summary))
        .paragraph(&lock_note(summary))
        .paragraph(&normal_note(summary))
        .heading("Comparison of methods")
        .paragraph(
            "All methods processed the same pairs; the leading one moved the hand, the others only estimated. Depth and normal: \
             error against the true plane of the target. It contains a constant from the first pair, which is larger on a target \
             with relief. Motion and rotation: error since the first pose. All as median / p95.",
        )
        .table(&methods::table(&summary.methods))
        .panels(&methods::panels(log))
        .heading("Commands")
        .paragraph(&commands::paragraph())
        .table(&commands::table(&summary.commands));
    let report = with_cycles(report, summary).heading("Errors over time").panels(&errors);
    with_images(with_drift(report, summary), &strip)
        .heading("Supervisor")
        .paragraph(&summary.supervisor.paragraph())
        .table(&summary.supervisor.transition_table())
}

/// Kind of the run.
fn introduction(summary: &RunSummary) -> &'static str {
    if summary.without_truth {
        "The cameras are real: the true target pose is unknown, so this report has no errors of hand and estimates. Target and hand \
         poses are from the measured joints of the arms."
    } else if summary.without_images {
        "No image was rendered. The controller received the true pose of the target at mid-exposure with the configured noise \
         (estimator.geometric) while the target was in view of both cameras. \
         Such a run tests the motion of the hand, not the vision."
    } else {
        "At the marks the configured moves of the target begin. The hand carries the two cameras and keeps its pose in \
         front of the target. Its only information about the target is the region marked in the first left image. The true poses \
         are from the simulation."
    }
}

/// Adds the strip of images, if there is one.
fn with_images(report: Report, strip: &[(ReportImage<'_>, String)]) -> Report {
    if strip.is_empty() {
        return report;
    }
    report
        .heading("Camera images")
        .paragraph("Left: region and axes of the model. Right: the outline of the region, reprojected with the estimated pose.")
        .images(strip)
}

/// Adds the camera drift, if it was measured.
fn with_drift(report: Report, summary: &RunSummary) -> Report {
    if summary.drift.is_empty() {
        return report;
    }
    report
        .heading("Camera drift")
        .paragraph(
            "Each value is the median of five samples; blur and brightness count as change since calibration. All values are zero if \
             the calibration holds and both cameras are alike. Drift over its limit degrades the estimates: calibrate again.",
        )
        .table(&drift::table(&summary.drift))
}

/// Adds the cycle times of a real-time run.
fn with_cycles(report: Report, summary: &RunSummary) -> Report {
    if summary.cycles.is_empty() {
        return report;
    }
    report
        .heading("Cycles")
        .paragraph(
            "Lateness of the cycles in real time. Cycles whose time had passed were skipped. A link tolerates two consecutive lost \
             replies.",
        )
        .table(&cycles::table(&summary.cycles))
}

/// Which methods observe the rotation about the normal.
fn normal_note(summary: &RunSummary) -> String {
    let leading = if summary.rotation_about_normal_observed {
        "The rotation about the model's normal (rz) is observed."
    } else {
        "The rotation about the model's normal (rz) was not observed by the leading method; it is held at its first value."
    };
    let blind: Vec<&str> = summary
        .methods
        .iter()
        .filter(|method| !method.leads && !method.rotation_about_normal_observed)
        .map(|method| method.method.as_str())
        .collect();
    match blind.is_empty() {
        true => leading.to_owned(),
        false => format!("{leading} Compared methods that do not observe it: {}.", blind.join(", ")),
    }
}

/// Orientation error of the hand in the observed directions: complete, or without the rotation about the normal.
fn orientation(summary: &RunSummary) -> (&'static str, Option<RmsMax>) {
    match summary.rotation_about_normal_observed {
        true => ("hand orientation error, rms", summary.tracking_orientation_deg),
        false => ("camera axis error, rms", summary.tracking_tilt_deg),
    }
}

fn figures(summary: &RunSummary) -> Vec<(&'static str, String)> {
    let rms = |value: Option<RmsMax>, unit: &str| {
        value.map_or("-".into(), |v| format!("{:.1} {unit}, at most {:.1}", v.rms, v.max))
    };
    let median = |value: Option<MedianP95>, unit: &str| value.map_or("-".into(), |v| format!("{:.2} {unit}", v.median));
    let (orientation_name, orientation) = orientation(summary);
    vec![
        ("hand position error, rms", rms(summary.tracking_position_mm, "mm")),
        (orientation_name, rms(orientation, "deg")),
        ("lag, median over the axes", summary.lag_s.map_or("-".into(), |lag_s| format!("{:.0} ms", lag_s * 1e3))),
        ("estimated depth, median error", median(summary.estimation_depth_mm, "mm")),
        ("estimated normal, median error", median(summary.estimation_normal_deg, "deg")),
        ("frame to estimate, p50", summary.latency_p50_millis.map_or("-".into(), |ms| format!("{ms:.1} ms"))),
    ]
}

/// The six panels of Fig. 7.
fn motion_panels(log: &RunLog, world_from_axes: &UnitQuaternion<f64>) -> Vec<LinePlot> {
    let Some(first) = log.control.first() else { return Vec::new() };
    type Way = fn(&ControlSample) -> (Vector3<f64>, UnitQuaternion<f64>);
    let ways: [(&str, SeriesColor, Way); 3] = [
        ("target", SeriesColor::Ink, |s| (s.world_from_target.translation_m(), s.world_from_target.rotation())),
        ("wanted", SeriesColor::Grey, |s| {
            (s.world_from_hand_wanted.translation_m(), s.world_from_hand_wanted.rotation())
        }),
        ("hand", SeriesColor::Red, |s| (s.world_from_hand.translation_m(), s.world_from_hand.rotation())),
    ];
    let ways: Vec<_> = ways.into_iter().filter(|(label, ..)| !(log.without_truth && *label == "wanted")).collect();
    let position = |way: Way, axis: usize| -> Vec<[f64; 2]> {
        let moved = |s| world_from_axes.inverse() * (way(s).0 - way(first).0) * 1e3;
        log.control.iter().map(|s| [s.t_s, moved(s)[axis]]).collect()
    };
    let orientation = |way: Way, axis: usize| -> Vec<[f64; 2]> {
        let start = way(first).1.inverse();
        log.control
            .iter()
            .map(|s| {
                let turned = way(s).1 * start;
                let about = world_from_axes.inverse() * turned.imag();
                [s.t_s, about[axis] * turned.w.signum()]
            })
            .collect()
    };
    let mut panels = Vec::new();
    for (axis, name) in ["x", "y", "z"].iter().enumerate() {
        let plot =
            LinePlot::new(format!("({}) position {name}", ["a", "b", "c"][axis]), ("time", "s"), ("position", "mm"));
        let plot =
            ways.iter().fold(plot, |plot, (label, color, way)| plot.series(line(label, *color, position(*way, axis))));
        panels.push(with_marks(plot, log));
    }
    for (axis, name) in ["1", "2", "3"].iter().enumerate() {
        let title = format!("({}) orientation, quaternion part {name}", ["d", "e", "f"][axis]);
        let plot = LinePlot::new(title, ("time", "s"), ("vector part", ""));
        let plot = ways
            .iter()
            .fold(plot, |plot, (label, color, way)| plot.series(line(label, *color, orientation(*way, axis))));
        panels.push(with_marks(plot, log));
    }
    panels
}

fn line(label: &str, color: SeriesColor, points: Vec<[f64; 2]>) -> Series {
    let series = Series::line(label, color, points);
    if color == SeriesColor::Grey { series.dashed() } else { series }
}

fn error_panels(log: &RunLog, summary: &RunSummary) -> Vec<LinePlot> {
    let control = |pick: fn(&TrackingError) -> f64| -> Vec<[f64; 2]> {
        log.judged().iter().map(|s| [s.t_s, pick(&TrackingError::of(s))]).collect()
    };
    let frames = |pick: fn(&super::log::FrameSample) -> Option<f64>| -> Vec<[f64; 2]> {
        log.leading.frames.iter().map(|f| [f.t_s, pick(f).unwrap_or(f64::NAN)]).collect()
    };
    let plot = |title: &str, y: (&str, &str), color: SeriesColor, points: Vec<[f64; 2]>| {
        with_marks(LinePlot::new(title, ("time", "s"), y).series(Series::line(title, color, points)), log)
    };
    let orientation = match summary.rotation_about_normal_observed {
        true => ("hand: orientation error", control(|e| e.orientation_rad.to_degrees())),
        false => ("camera axis error", control(|e| e.tilt_rad.to_degrees())),
    };
    let mut panels = vec![
        plot("hand: position error", ("error", "mm"), SeriesColor::Red, control(|e| e.position_m * 1e3)),
        plot(orientation.0, ("error", "deg"), SeriesColor::Red, orientation.1),
    ];
    // Not every method has a fitness.
    if log.leading.frames.iter().any(|f| f.fitness.is_some()) {
        panels.push(plot("fitness", ("fitness", ""), SeriesColor::Green, frames(|f| f.fitness)));
    }
    let latency = frames(|f| Some(f.latency_millis));
    panels.push(plot("frame to estimate", ("wall time", "ms"), SeriesColor::Purple, latency));
    panels
}

fn number(value: Option<f64>) -> String {
    value.map_or("-".to_owned(), |x| format!("{x:.2}"))
}

fn channel_table(summary: &RunSummary) -> Table {
    let has = |pick: fn(&ChannelSummary) -> Option<f64>| summary.channels.iter().any(|c| pick(c).is_some());
    type Pick = fn(&ChannelSummary) -> Option<f64>;
    let columns: [(&str, Pick); 10] = [
        ("moving, rms", |c| c.moving.map(|e| e.rms)),
        ("moving, max", |c| c.moving.map(|e| e.max)),
        ("hold, rms", |c| c.hold.map(|e| e.rms)),
        ("hold, max", |c| c.hold.map(|e| e.max)),
        ("lag, ms", |c| c.lag_s.map(|lag_s| lag_s * 1e3)),
        ("rise delay, s", |c| c.rise_delay_s),
        ("gain, dB", |c| c.gain_db),
        ("phase, deg", |c| c.phase_deg),
        ("settled after, s", |c| c.settled_after_s),
        ("overshoot, %", |c| c.overshoot_percent),
    ];
    // Figures that this kind of motion does not have are left out.
    let columns: Vec<_> = columns.into_iter().filter(|(_, pick)| has(*pick)).collect();
    let headings = ["axis", "unit"].into_iter().chain(columns.iter().map(|(name, _)| *name));
    summary.channels.iter().fold(Table::new(headings), |table, c| {
        let names = [c.channel.clone(), c.unit.to_owned()];
        table.row(names.into_iter().chain(columns.iter().map(|(_, pick)| number(pick(c)))))
    })
}

fn locked_table(summary: &RunSummary) -> Table {
    let headings =
        ["axis", "moving, rms mm", "max", "moving, rms deg", "max", "hold, rms mm", "max", "hold, rms deg", "max"];
    let all = ("all".to_owned(), summary.locked);
    let rows = summary.channels.iter().map(|c| (c.channel.clone(), c.locked)).chain(std::iter::once(all));
    rows.fold(Table::new(headings), |table, (name, locked)| {
        let errors = [locked.moving_mm, locked.moving_deg, locked.hold_mm, locked.hold_deg];
        let cells = errors.into_iter().flat_map(|e| [number(e.map(|e| e.rms)), number(e.map(|e| e.max))]);
        table.row(std::iter::once(name).chain(cells))
    })
}

/// Text about the initial pose error.
fn lock_note(summary: &RunSummary) -> String {
    let Some(lock) = &summary.lock else { return summary.why_no_lock().to_owned() };
    let stated = lock.tilt_sigma_deg.zip(lock.hand_by_tilt_sigma_mm).map_or_else(String::new, |(deg, mm)| {
        format!("; stated standard deviation: {mm:.1} mm at the hand, {deg:.2} deg tilt")
    });
    let (hand, tilt) = (lock.hand_mm, lock.tilt_deg);
    format!("Initial pose error: {hand:.1} mm at the hand, {tilt:.2} deg tilt{stated}.")
}

/// The summary as a plain table for a terminal.
pub fn text_table(summary: &RunSummary) -> String {
    let mut text = String::new();
    let rms_max = |name: &str, value: Option<RmsMax>, unit: &str| {
        let figures = value.map_or("-".to_owned(), |v| format!("rms {:.2}, max {:.2} {unit}", v.rms, v.max));
        format!("{name:<34} {figures}\n")
    };
    let median_p95 = |name: &str, value: Option<MedianP95>, unit: &str| {
        let figures = value.map_or("-".to_owned(), |v| format!("median {:.2}, p95 {:.2} {unit}", v.median, v.p95));
        format!("{name:<34} {figures}\n")
    };
    text += &rms_max("hand, position", summary.tracking_position_mm, "mm");
    text += &rms_max("camera axis", summary.tracking_tilt_deg, "deg");
    text += &rms_max("hand, orientation", summary.tracking_orientation_deg, "deg");
    text +=
        &format!("{:<34} {}\n", "lag, median over the axes", summary.lag_s.map_or("-".into(), |s| format!("{s:.3} s")));
    text += &median_p95("estimate, depth", summary.estimation_depth_mm, "mm");
    text += &median_p95("estimate, normal", summary.estimation_normal_deg, "deg");
    let latency = summary.latency_p50_millis.zip(summary.latency_p99_millis);
    let latency = latency.map_or("-".into(), |(p50, p99)| format!("p50 {p50:.2}, p99 {p99:.2} ms"));
    text += &format!("{:<34} {latency}\n", "frame in memory to estimate");
    text += &format!("{:<34} {} of {}\n", "frames without a pose", summary.frames_without_pose, summary.frames);
    let statuses: Vec<String> = summary.frames_by_status.iter().map(|(status, n)| format!("{n} {status}")).collect();
    text += &format!("{:<34} {}\n", "frames by status", statuses.join(", "));
    let modes: Vec<String> =
        summary.share_by_mode.iter().map(|(mode, share)| format!("{mode} {:.0} %", 100.0 * share)).collect();
    text += &format!("{:<34} {}\n", "controller", modes.join(", "));
    let sigma = summary.smallest_singular_value.map_or("-".into(), |s| format!("{s:.3}"));
    text += &format!("{:<34} {sigma}\n", "smallest singular value");
    text += &summary.supervisor.text_lines();
    text += &commands::text_lines(&summary.commands);
    if summary.without_truth {
        text += "the cameras are real: without true poses the errors of hand and estimates are unknown\n";
    }
    if summary.without_images {
        text += "no image was rendered: the estimates are the true poses with the noise of estimator.geometric\n";
    }
    text += &drift::text_lines(&summary.drift);
    text.push('\n');
    text += &methods::text_table(&summary.methods);
    text.push('\n');
    let _ = writeln!(text, "axis unit  moving rms    max   hold rms    max   lag s");
    for c in &summary.channels {
        let _ = writeln!(
            text,
            "{:<4} {:<4} {:>11} {:>6} {:>10} {:>6} {:>7}",
            c.channel,
            c.unit,
            number(c.moving.map(|e| e.rms)),
            number(c.moving.map(|e| e.max)),
            number(c.hold.map(|e| e.rms)),
            number(c.hold.map(|e| e.max)),
            number(c.lag_s)
        );
    }
    for c in &summary.channels {
        text += &response_line(c);
    }
    let _ = writeln!(text, "{}", lock_note(summary));
    text += &cycles::text_table(&summary.cycles);
    if summary.lock.is_some() && !summary.rotation_about_normal_observed {
        text += "this method does not observe rz, the rotation about the normal: rz is held\n";
    }
    text
}

/// Gain and phase, or settling and overshoot, of a channel that has them.
fn response_line(c: &ChannelSummary) -> String {
    let mut line = String::new();
    if let Some((gain_db, phase_deg)) = c.gain_db.zip(c.phase_deg) {
        let _ = writeln!(line, "{}: gain {gain_db:.2} dB, phase {phase_deg:.1} deg", c.channel);
    }
    if let Some(overshoot) = c.overshoot_percent {
        let settled = c.settled_after_s.map_or("has not settled".to_owned(), |s| format!("settled after {s:.2} s"));
        let _ = writeln!(line, "{}: {settled}, overshoot {overshoot:.1} %", c.channel);
    }
    line
}

/// A line per estimate of the method that leads the hand.
fn estimates_csv(log: &MethodLog) -> String {
    let lines = log.frames.iter().zip(&log.estimated).map(|(frame, pose)| {
        let row = EstimateRow {
            t_s: frame.t_s,
            status: &frame.status,
            age_millis: frame.age_millis,
            latency_millis: Some(frame.latency_millis),
            fitness: frame.fitness,
            cam_left_from_model: pose.as_ref(),
            covariance: frame.covariance.as_ref(),
            pose_covariance: frame.pose_covariance.as_ref(),
        };
        row.line() + "\n"
    });
    std::iter::once(estimates_csv::heading() + "\n").chain(lines).collect()
}

/// A line per control step: times in seconds, positions in millimetres, quaternions as x, y, z, w; `joints`: number of joints of each arm.
fn timeseries_csv(log: &RunLog, joints: [usize; 2]) -> String {
    let mut text = String::from("t_s,mode");
    for body in ["target", "hand", "wanted"] {
        let _ = write!(text, ",{body}_x_mm,{body}_y_mm,{body}_z_mm,{body}_qx,{body}_qy,{body}_qz,{body}_qw");
    }
    for (arm, joints) in ["vs", "tc"].into_iter().zip(joints) {
        (1..=joints).for_each(|joint| text += &format!(",{arm}_joint{joint}_deg"));
        (1..=joints).for_each(|joint| text += &format!(",{arm}_requested{joint}_deg_per_s"));
    }
    text.push('\n');
    for s in &log.control {
        let _ = write!(text, "{:.4},{}", s.t_s, s.mode_name());
        let poses = [
            (s.world_from_target.translation_m(), s.world_from_target.rotation()),
            (s.world_from_hand.translation_m(), s.world_from_hand.rotation()),
            (s.world_from_hand_wanted.translation_m(), s.world_from_hand_wanted.rotation()),
        ];
        let known = if log.without_truth { 2 } else { 3 };
        for (p, q) in &poses[..known] {
            let _ = write!(text, ",{:.4},{:.4},{:.4}", p.x * 1e3, p.y * 1e3, p.z * 1e3);
            let _ = write!(text, ",{:.7},{:.7},{:.7},{:.7}", q.i, q.j, q.k, q.w);
        }
        text += &",".repeat(7 * (poses.len() - known));
        for (arm, joints) in s.arms.iter().zip(joints) {
            for position_rad in arm.position_rad.iter().take(joints) {
                let _ = write!(text, ",{:.5}", position_rad.to_degrees());
            }
            match &arm.requested_rad_per_s {
                Some(requested) => requested.iter().take(joints).for_each(|rad_per_s| {
                    let _ = write!(text, ",{:.5}", rad_per_s.to_degrees());
                }),
                // The command was to hold.
                None => text += &",".repeat(joints),
            }
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use anyhow::anyhow;

    use super::*;

    #[test]
    fn the_failure_of_a_run_is_reported_also_without_a_report() {
        let (arm, disk) = (|| Err(anyhow!("an overcurrent")), || Err(anyhow!("no space is left")));
        let text = format!("{:#}", combine_errors(arm(), disk()).unwrap_err());
        assert!(text.contains("an overcurrent") && text.contains("no space is left"), "{text}");
        assert_eq!(combine_errors(arm(), Ok(())).unwrap_err().to_string(), "an overcurrent");
        assert_eq!(combine_errors::<()>(Ok(()), disk()).unwrap_err().to_string(), "no space is left");
        assert!(combine_errors(Ok(()), Ok(())).is_ok());
    }
}
