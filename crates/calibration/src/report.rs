//! HTML reports of calibrations on one page: verdict with advice, gates, and errors over the images.

mod hand_eye;

use std::collections::BTreeMap;

use nalgebra::Vector2;
use pb3dp_geometry::ImageSize;
use pb3dp_record::report::{Bars, ImagePlot, Report, SeriesColor, Table, Tone, VectorAt};

use crate::board::Sighting;
use crate::fit::{CornerError, Covariance, Fit, View, sides};
use crate::gates::{Gate, Grade, HELD_OUT, Judged, SCALE, verdict};
use crate::held_out::Chosen;
use crate::quality::{Quality, QualityError, row_differences};
use crate::stand::{CELLS, cell_of};
pub use hand_eye::of_hand_eye;

/// Adds the verdict with advice, worst gate first, and the table of all gates. For every kind of calibration.
#[must_use]
pub fn add_gates(report: Report, judged: &[Judged]) -> Report {
    let (worst, words) = verdict(judged);
    let tone = match worst {
        Grade::Good => Tone::Good,
        Grade::Fair => Tone::Fair,
        Grade::Refused => Tone::Bad,
    };
    let mut open: Vec<&Judged> = judged.iter().filter(|judged| judged.grade() != Grade::Good).collect();
    open.sort_by_key(|judged| std::cmp::Reverse(judged.grade()));
    let mut table = Table::new(["gate", "grade", "measured", "good", "refused"]);
    let line = |Judged { gate, measured }: &Judged| format!("{} = {}: {}", gate.key, number(*measured), gate.advice);
    let lines: Vec<String> = open.iter().map(|judged| format!("{}, {}", judged.grade().name(), line(judged))).collect();
    for judged in judged {
        let Judged { gate, measured } = judged;
        let [good, refused] = gate.limits();
        table = table.row([gate.key.to_owned(), judged.grade().name().to_owned(), number(*measured), good, refused]);
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
    judged: &[Judged],
    views: &[View<1>],
    size: ImageSize,
) -> Report {
    let report = beginning("Calibration of a camera", quality, judged);
    ending(errors(report, chosen, views, size), chosen, quality, judged)
}

/// The report of a stereo rig with working distance `depth_m`.
///
/// # Errors
/// The stereo pair cannot be rectified, and the errors of [`Fit::rig`].
pub fn of_stereo(
    chosen: &Chosen<2>,
    quality: &Quality,
    judged: &[Judged],
    views: &[View<2>],
    depth_m: f64,
) -> Result<Report, QualityError> {
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
    let report = beginning("Calibration of a stereo rig", quality, judged).figures(&figures);
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
    Ok(ending(report, chosen, quality, judged))
}

fn beginning(title: &str, quality: &Quality, judged: &[Judged]) -> Report {
    let scale = if judged.iter().any(|judged| judged.gate.key == SCALE.key) {
        String::new()
    } else {
        " Not judged: the size of the squares, which images cannot reveal; measure a known length with the calibrated cameras.".to_owned()
    };
    add_gates(Report::new(title), judged)
        .paragraph(&format!("{} views, {} corners.{scale}", quality.views, quality.corners))
}

/// Errors and coverage over the images of each camera.
fn errors<const N: usize>(report: Report, chosen: &Chosen<N>, views: &[View<N>], size: ImageSize) -> Report {
    let of_camera = |camera: usize| chosen.fit.errors().iter().flat_map(move |of_view| &of_view[camera]);
    let by_camera: Vec<Vec<VectorAt>> = (0..N).map(|camera| vectors(of_camera(camera))).collect();
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
fn ending<const N: usize>(report: Report, chosen: &Chosen<N>, quality: &Quality, judged: &[Judged]) -> Report {
    let mut by_view = Bars::new("error of each view, px rms", 3);
    for (_, name, rms_px) in quality.views_by_error() {
        by_view = by_view.bar(name, rms_px);
    }
    by_view = with_limits(by_view, judged, HELD_OUT);
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
    let noise = format!("Marginal standard deviations, {}.", noise(chosen.fit.covariance()));
    report.heading("Numbers").table(&of_fit(&chosen.fit)).paragraph(&noise)
}

/// Origin of the standard deviations.
pub(crate) fn noise(covariance: &Covariance) -> String {
    let Covariance { corner_sigma_px, view_scatter, .. } = covariance;
    let raised = format!(", raised {:.1} times because views differ by more than corner noise", view_scatter.sqrt());
    format!("from {corner_sigma_px:.3} px per corner{}", if *view_scatter > 1.0 { &raised } else { "" })
}

/// The limits of a gate as lines in a plot.
fn with_limits(bars: Bars, judged: &[Judged], gate: Gate) -> Bars {
    match judged.iter().find(|judged| judged.gate.key == gate.key) {
        Some(Judged { gate, .. }) => bars.limit("good", gate.good).limit("refused", gate.refused),
        None => bars,
    }
}

/// All estimated parameters with their standard deviations.
fn of_fit<const N: usize>(fit: &Fit<N>) -> Table {
    let values: BTreeMap<String, f64> = fit.parameters().into_iter().collect();
    let value = |name: &String| values.get(name).copied().unwrap_or(f64::NAN);
    let sigma = |name: &String| Some(fit.covariance().sigma(name).unwrap_or(f64::NAN));
    let names = fit.covariance().names.iter();
    parameters(names.map(|name| (name.clone(), value(name), sigma(name))), 5)
}

/// A table of named parameters with their standard deviations; lengths in millimetres and angles in degrees.
fn parameters(numbers: impl Iterator<Item = (String, f64, Option<f64>)>, decimals: usize) -> Table {
    let mut table = Table::new(["parameter", "value", "standard deviation"]);
    for (name, value, sigma) in numbers {
        let (shown, factor) = in_shown_units(&name);
        let number = |value: f64| format!("{:.decimals$}", value * factor);
        table = table.row([shown, number(value), sigma.map_or("-".to_owned(), number)]);
    }
    table
}

/// Name of a parameter with the unit in which it is shown, and the factor to that unit.
pub(crate) fn in_shown_units(name: &str) -> (String, f64) {
    match (name.strip_suffix("_m"), name.strip_suffix("_rad")) {
        (Some(stem), _) => (format!("{stem}, mm"), 1e3),
        (_, Some(stem)) => (format!("{stem}, degrees"), 1_f64.to_degrees()),
        _ => (name.to_owned(), 1.0),
    }
}

fn wide(size: ImageSize) -> [u32; 2] {
    [size.width, size.height]
}

/// Errors of corners as vectors.
pub(crate) fn vectors<'a>(errors: impl IntoIterator<Item = &'a CornerError>) -> Vec<VectorAt> {
    errors
        .into_iter()
        .map(|error| VectorAt { at_px: error.corner.pixel.into(), vector_px: error.error_px.into() })
        .collect()
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
fn mean_by_cell(values: impl Iterator<Item = (Vector2<f64>, f64)>, size: ImageSize) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); (CELLS[0] * CELLS[1]) as usize];
    for (pixel, value) in values {
        let [column, row] = cell_of(&pixel, size);
        let (sum, count) = &mut sums[(row * CELLS[0] + column) as usize];
        *sum += value;
        *count += 1.0;
    }
    sums.into_iter().map(|(sum, count)| sum / count).collect()
}
