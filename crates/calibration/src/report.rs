//! HTML reports of calibrations on one page: verdict with advice, gates, and errors over the images.

mod hand_eye;

use std::collections::BTreeMap;
use std::fmt;

use pb3dp_geometry::{ImageSize, RectificationError};
use pb3dp_record::report::{Bars, ImagePlot, Report, SeriesColor, Table, Tone, VectorAt};

use crate::board::Sighting;
use crate::fit::{Fit, View, sides};
use crate::gates::{Gate, Grade, Verdict};
use crate::held_out::Chosen;
use crate::quality::{Quality, row_differences};
use crate::stand::{CELLS, cell_of};
pub use hand_eye::of_hand_eye;

/// A gate as shown in a report, for any kind of calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct GateLine {
    /// Its name, with the unit.
    pub name: String,
    /// The measured value.
    pub measured: f64,
    /// Good up to this value, inclusive.
    pub good: f64,
    /// Refused if worse than this value.
    pub refused: f64,
    /// The grade.
    pub grade: Grade,
    /// Advice if the grade is not good.
    pub advice: String,
}

impl From<&Verdict> for GateLine {
    fn from(verdict: &Verdict) -> Self {
        Self {
            name: verdict.gate.key().to_owned(),
            measured: verdict.measured,
            good: verdict.limit.good,
            refused: verdict.limit.refused,
            grade: verdict.grade(),
            advice: verdict.gate.advice().to_owned(),
        }
    }
}

impl fmt::Display for GateLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let word = if self.good > self.refused { "from" } else { "up to" };
        let Self { name, measured, good, refused, grade, advice } = self;
        write!(
            f,
            "{:<8} {name} = {measured:.3} (good {word} {good}, refused {} {refused})",
            grade.name(),
            if self.good > self.refused { "below" } else { "above" }
        )?;
        if *grade == Grade::Good { Ok(()) } else { write!(f, ": {advice}") }
    }
}

/// The verdict as text: good, usable, or the number of gates that refuse.
pub fn verdict_in_words(gates: &[GateLine]) -> (Tone, String) {
    let of = |grade: Grade| gates.iter().filter(|gate| gate.grade == grade).count();
    match (of(Grade::Refused), of(Grade::Fair)) {
        (0, 0) => (Tone::Good, "good".to_owned()),
        (0, fair) => (Tone::Fair, format!("usable; {fair} of {} gates could be better", gates.len())),
        (refused, _) => (Tone::Bad, format!("refused by {refused} of {} gates", gates.len())),
    }
}

/// Adds the verdict with advice, worst gate first, and the table of all gates. For every kind of calibration.
#[must_use]
pub fn add_gates(report: Report, gates: &[GateLine]) -> Report {
    let (tone, words) = verdict_in_words(gates);
    let mut open: Vec<&GateLine> = gates.iter().filter(|gate| gate.grade != Grade::Good).collect();
    open.sort_by_key(|gate| std::cmp::Reverse(gate.grade));
    let advice =
        |gate: &&GateLine| format!("{}, {} = {}: {}", gate.grade.name(), gate.name, number(gate.measured), gate.advice);
    let lines: Vec<String> = open.iter().map(advice).collect();
    let mut table = Table::new(["gate", "grade", "measured", "good", "refused"]);
    for gate in gates {
        let (word, beyond) = if gate.good > gate.refused { ("from", "below") } else { ("up to", "above") };
        let cells = [
            gate.name.clone(),
            gate.grade.name().to_owned(),
            number(gate.measured),
            format!("{word} {}", gate.good),
            format!("{beyond} {}", gate.refused),
        ];
        table = table.row(cells);
    }
    report.verdict(tone, &format!("Verdict: {words}"), &lines).heading("Gates").table(&table)
}

fn number(value: f64) -> String {
    format!("{value:.3}")
}

/// The report of one camera.
pub fn of_camera(
    chosen: &Chosen<1>,
    quality: &Quality,
    verdicts: &[Verdict],
    views: &[View<1>],
    size: ImageSize,
) -> Report {
    let report = beginning("Calibration of a camera", quality, verdicts);
    ending(errors(report, chosen, views, size), chosen, quality, verdicts)
}

/// The report of a stereo rig with working distance `depth_m`.
///
/// # Errors
/// The stereo pair cannot be rectified, and the errors of [`Fit::rig`].
pub fn of_stereo(
    chosen: &Chosen<2>,
    quality: &Quality,
    verdicts: &[Verdict],
    views: &[View<2>],
    depth_m: f64,
) -> Result<Report, ReportError> {
    let rig = chosen.fit.rig()?;
    let mut figures = vec![
        ("baseline", format!("{:.2} mm", rig.baseline_m() * 1e3)),
        ("reprojection, rms", format!("{:.3} px", quality.reprojection_rms_px)),
    ];
    figures.extend(quality.rows.map(|rows| ("vertical misalignment, rms", format!("{:.3} px", rows.rms_px))));
    let sigma = quality.depth_sigma_share;
    let at = format!("standard deviation of depth at {:.0} mm", depth_m * 1e3);
    figures.extend(sigma.map(|share| (at.as_str(), format!("{:.3} mm", share * depth_m * 1e3))));
    let size = rig.left().size();
    let report = beginning("Calibration of a stereo rig", quality, verdicts).figures(&figures);
    let rows = row_differences(&rig, views)?;
    let vectors: Vec<VectorAt> =
        rows.iter().map(|row| VectorAt { at_px: row.left_px.into(), vector_px: [0.0, row.difference_px] }).collect();
    let magnified = ImagePlot::magnification(&vectors, size.width);
    let by_cell = mean_by_cell(rows.iter().map(|row| (row.left_px, row.difference_px.powi(2))), size);
    let plots = [
        ImagePlot::new(
            "right row minus left row, at the position in the left image (down: lower in the right image)",
            wide(size),
        )
        .vectors(vectors, SeriesColor::Purple, magnified),
        ImagePlot::new("vertical misalignment by cell, px rms", wide(size)).cells(
            CELLS[0] as usize,
            by_cell.into_iter().map(f64::sqrt).collect(),
            2,
        ),
    ];
    let report = errors(report, chosen, views, size)
        .heading("Vertical misalignment of the rectified images")
        .paragraph("After rectification a scene point must lie in the same row of both images. A uniform misalignment means that the cameras have moved relative to each other; a misalignment that varies over the image means that a lens or focus has changed.")
        .image_plots(&plots);
    Ok(ending(report, chosen, quality, verdicts))
}

/// Why no report could be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ReportError {
    /// The cameras do not form a valid stereo rig.
    #[error(transparent)]
    Fit(#[from] crate::fitted_rig::FitError),
    /// The stereo pair cannot be rectified.
    #[error("the stereo pair cannot be rectified")]
    Rectification(#[from] RectificationError),
}

fn beginning(title: &str, quality: &Quality, verdicts: &[Verdict]) -> Report {
    let gates: Vec<GateLine> = verdicts.iter().map(GateLine::from).collect();
    let scale = if verdicts.iter().any(|verdict| verdict.gate.key().starts_with("scale")) {
        String::new()
    } else {
        " Not judged: the size of the squares, which images cannot reveal; measure a known length with the calibrated cameras.".to_owned()
    };
    add_gates(Report::new(title), &gates)
        .paragraph(&format!("{} views, {} corners.{scale}", quality.views, quality.corners))
}

/// Errors and coverage over the images of each camera.
fn errors<const N: usize>(report: Report, chosen: &Chosen<N>, views: &[View<N>], size: ImageSize) -> Report {
    let by_camera: Vec<Vec<VectorAt>> = (0..N).map(|camera| vectors_of(&chosen.fit, camera)).collect();
    // A common scale, so that the cameras can be compared.
    let magnified = ImagePlot::magnification(&by_camera.concat(), size.width);
    let plots: Vec<ImagePlot> = sides::<N>()
        .into_iter()
        .zip(by_camera)
        .map(|(side, vectors)| {
            ImagePlot::new(format!("{side}: predicted minus detected corners"), wide(size)).vectors(
                vectors,
                SeriesColor::Red,
                magnified,
            )
        })
        .collect();
    report
        .heading("Reprojection errors")
        .paragraph("The vectors should point in random directions. If neighbouring vectors point in the same direction, the lens model does not fit, the board is bent, or a camera has changed.")
        .image_plots(&plots)
        .heading("Image coverage")
        .image_plots(&coverage_plots(views, size))
}

/// Number of corners detected in each cell, camera by camera.
pub fn coverage_plots<const N: usize>(views: &[View<N>], size: ImageSize) -> Vec<ImagePlot> {
    let plot = |(camera, side): (usize, &str)| {
        let counts = counts_by_cell(views.iter().map(|view| &view.sightings[camera]), size);
        ImagePlot::new(format!("{side}: detected corners per cell"), wide(size)).cells(CELLS[0] as usize, counts, 0)
    };
    sides::<N>().into_iter().enumerate().map(plot).collect()
}

/// Views, lens models and parameters.
fn ending<const N: usize>(report: Report, chosen: &Chosen<N>, quality: &Quality, verdicts: &[Verdict]) -> Report {
    let mut by_view = Bars::new("error of each view, px rms", 3);
    let mut views: Vec<_> = quality.reprojection_rms_by_view_px.iter().collect();
    views.sort_by(|a, b| b.1.total_cmp(&a.1));
    for (name, rms_px) in views {
        by_view = by_view.bar(name, *rms_px);
    }
    let gate = verdicts.iter().find(|verdict| verdict.gate == Gate::HeldOut);
    for (name, value) in gate.into_iter().flat_map(|gate| [("good", gate.limit.good), ("refused", gate.limit.refused)])
    {
        by_view = by_view.limit(name, value);
    }
    let mut by_lens = Bars::new("error of each lens model on held-out views, px rms", 4);
    let mut failed = Vec::new();
    for held_out in &chosen.tried {
        let mark = if held_out.lens == chosen.fit.lens() { " (chosen)" } else { "" };
        match &held_out.rms_px {
            Ok(rms_px) => by_lens = by_lens.bar(format!("{}{mark}", held_out.lens), *rms_px),
            Err(reason) => failed.push(format!("{} could not be fitted: {reason}", held_out.lens)),
        }
    }
    let mut report = report.heading("Views and lens models").bars(&[by_view, by_lens]);
    for line in failed {
        report = report.paragraph(&line);
    }
    let covariance = chosen.fit.covariance();
    let raised = if covariance.view_scatter > 1.0 {
        format!(", raised {:.1} times because views differ by more than corner noise", covariance.view_scatter.sqrt())
    } else {
        String::new()
    };
    report.heading("Numbers").table(&parameters(&chosen.fit)).paragraph(&format!(
        "Marginal standard deviations, from {:.3} px per corner{raised}.",
        covariance.corner_sigma_px
    ))
}

/// All estimated parameters with their standard deviations; the pose in millimetres and degrees.
fn parameters<const N: usize>(fit: &Fit<N>) -> Table {
    let values: BTreeMap<String, f64> = fit.parameters().into_iter().collect();
    let mut table = Table::new(["parameter", "value", "standard deviation"]);
    for name in &fit.covariance().names {
        let sigma = fit.covariance().sigma(name).unwrap_or(f64::NAN);
        let (shown, factor) = match (name.strip_suffix("_m"), name.strip_suffix("_rad")) {
            (Some(stem), _) => (format!("{stem}, mm"), 1e3),
            (_, Some(stem)) => (format!("{stem}, degrees"), 1_f64.to_degrees()),
            _ => (name.clone(), 1.0),
        };
        let value = values.get(name).copied().unwrap_or(f64::NAN);
        table = table.row([shown, format!("{:.5}", value * factor), format!("{:.5}", sigma * factor)]);
    }
    table
}

fn wide(size: ImageSize) -> [u32; 2] {
    [size.width, size.height]
}

/// Errors of all corners of a camera.
fn vectors_of<const N: usize>(fit: &Fit<N>, camera: usize) -> Vec<VectorAt> {
    let corners = fit.errors().iter().flat_map(|of_view| &of_view[camera]);
    corners.map(|error| VectorAt { at_px: error.corner.pixel.into(), vector_px: error.error_px.into() }).collect()
}

/// Number of corners in each cell, row by row.
fn counts_by_cell<'a>(sightings: impl Iterator<Item = &'a Sighting>, size: ImageSize) -> Vec<f64> {
    let mut counts = vec![0.0; (CELLS[0] * CELLS[1]) as usize];
    for corner in sightings.flat_map(Sighting::corners) {
        let [column, row] = cell_of(&corner.pixel, size);
        counts[(row * CELLS[0] + column) as usize] += 1.0;
    }
    counts
}

/// Mean of values by cell, row by row; NaN for cells without values.
fn mean_by_cell(values: impl Iterator<Item = (nalgebra::Vector2<f64>, f64)>, size: ImageSize) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); (CELLS[0] * CELLS[1]) as usize];
    for (pixel, value) in values {
        let [column, row] = cell_of(&pixel, size);
        let (sum, count) = &mut sums[(row * CELLS[0] + column) as usize];
        *sum += value;
        *count += 1.0;
    }
    sums.into_iter().map(|(sum, count)| sum / count).collect()
}
