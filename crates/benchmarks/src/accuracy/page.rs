//! The document and its figures.

use std::fmt::Write as _;

use super::cell::Cell;
use super::ensemble_summary::{self, EnsembleSummary};
use super::first_pose::FirstPoses;
use super::limits::{Check, Standing};
use super::plot::{AxisKind, Line, Panel, svg};
use super::sequence_summary::{self, SequenceSummary};
use super::summary::Summary;
use super::table;
use crate::common::circumstances::Circumstances;

/// All results of a run.
pub struct Findings {
    /// The measured configurations.
    pub cells: Vec<Cell>,
    /// Rows of the configurations.
    pub summaries: Vec<Summary>,
    /// Rows of the sequences.
    pub sequences: Vec<SequenceSummary>,
    /// Rows of the ensembles.
    pub ensembles: Vec<EnsembleSummary>,
    /// First poses of objects that are no planes.
    pub first_poses: Vec<FirstPoses>,
    /// Limits, and whether they are met.
    pub checks: Vec<Check>,
    /// Random seed.
    pub seed: u32,
    /// Fewer poses: limits have a tolerance.
    pub quick: bool,
}

/// Factors with a figure: name and axis label.
const FIGURES: [(&str, &str); 3] =
    [("noise", "noise, grey levels"), ("distance", "distance, mm"), ("baseline", "baseline, mm")];

/// Rms error of depth and angle over noise, distance and baseline, for each method, with the bound.
pub fn accuracy_figure(findings: &Findings) -> String {
    let mut panels = Vec::new();
    for (quantity, index) in [("depth, rms, mm", 0), ("normal, rms, degrees", 1)] {
        for (factor, label) in FIGURES {
            let cells: Vec<Cell> = findings.cells.iter().filter(|cell| cell.factor() == factor).cloned().collect();
            panels.push(cell_panel(&cells, &findings.summaries, (quantity, index), label));
        }
    }
    svg(&panels, FIGURES.len())
}

/// Rms error of depth (0) or normal (1) over the values of one factor, with the bound.
pub fn cell_panel(cells: &[Cell], summaries: &[Summary], (quantity, index): (&str, usize), label: &str) -> Panel {
    let mut methods: Vec<&'static str> = summaries.iter().map(|row| row.method).collect();
    methods.sort_unstable();
    methods.dedup();
    let value = |row: &Summary| if index == 0 { row.z_m[2] * 1e3 } else { row.angle_rad[2].to_degrees() };
    let bound = |row: &Summary| {
        let [z, angle] = row.bound.unwrap_or([f64::NAN; 2]);
        if index == 0 { z * 1e3 } else { angle.to_degrees() }
    };
    let points = |method: &str, of: &dyn Fn(&Summary) -> f64| {
        let row = |cell: &Cell| summaries.iter().find(|row| row.cell == cell.name && row.method == method);
        cells.iter().filter_map(|cell| row(cell).map(|row| [cell.value, of(row)])).collect::<Vec<_>>()
    };
    let mut lines: Vec<Line> = methods
        .iter()
        .map(|method| Line { name: (*method).to_owned(), points: points(method, &value), is_bound: false })
        .collect();
    if let Some(method) = methods.first() {
        lines.push(Line { name: "bound".to_owned(), points: points(method, &bound), is_bound: true });
    }
    Panel { title: quantity.to_owned(), x: label.to_owned(), axes: [AxisKind::Logarithmic; 2], lines }
}

/// Depth and rotation error of each frame of one sequence.
pub fn sequence_figure(findings: &Findings, name: &str) -> String {
    let rows: Vec<_> = findings.sequences.iter().filter(|row| row.sequence == name).collect();
    let line = |row: &SequenceSummary, values: &[f64], scale: f64| Line {
        name: row.method.to_owned(),
        points: (1..).zip(values).map(|(frame, value)| [f64::from(frame), value.abs() * scale]).collect(),
        is_bound: false,
    };
    let panel = |title: &str, of: &dyn Fn(&SequenceSummary) -> Line| Panel {
        title: format!("{name}: {title}"),
        x: "frame".to_owned(),
        axes: [AxisKind::Linear, AxisKind::Logarithmic],
        lines: rows.iter().map(|row| of(row)).collect(),
    };
    svg(
        &[
            panel("depth, mm", &|row| line(row, &row.z_errors_m, 1e3)),
            panel("rotation, degrees", &|row| line(row, &row.rotation_errors_rad, 1f64.to_degrees())),
        ],
        2,
    )
}

/// Text before the tables.
const INTRODUCTION: &str = "\
This file is written by `cargo xtask bench accuracy`; edit the program, not the file.

## What is measured

Each configuration differs from the nominal one in one factor, which its name gives.
The nominal configuration: a flat target of 110 mm with the crab's outline and texture, 30 mm in front of a panel of sand; 420 to 650 mm away, both tilts uniform within 25 degrees, any rotation about the normal; two cameras of 640 x 480 px and 740 px focal length, 100 mm apart; noise of 3 grey levels, lens blur of 0.6 px, and a right camera with the gains 1.06, 0.98, 0.93 and the offsets 3, 0, -2 grey levels.
Every answer is a cold start from one pair: the methods receive the depth range (330 to 840 mm, 300 to 1150 mm in the configurations `distance`), tilts of up to 45 degrees, and the region.
The region is the target's true outline, except in the configurations `rectangle`, with the bounding box of the outline, and `unobservable/uniform-interior`, with an area inside the target.

Images are sampled at twice the resolution and blurred before the pixels integrate them.
All methods see the same images; the seed of a pose depends only on the name of the configuration and the number of the pose.

| column | meaning |
|---|---|
| conf % | share of confident answers: status `ok` or `weak-tilt` |
| right % | share of answers with depth and normal within 2 mm and 3 degrees, or within four times the bound if that is more, with any status |
| wrong ok | answers with status `ok` and larger errors, or `weak-tilt` and a larger depth error |
| z | absolute depth error on the ray of the region's centroid, of the confident answers |
| angle | angle between the true and the estimated normal, of the answers with status `ok` |
| bound | the Cramér-Rao bound, rms over the poses |
| rms / bound | rms of the errors over the bound of the same poses |
| NEES | mean squared error, normalised by the covariance of the method, over its expected value: 1 is consistent |
| ms | CPU time of one call, median |

For a relief the true plane is that of robust least squares (Tukey's weights) through the inverse depths of the target's visible pixels, as in runs and the panel; the bound is that of a plane and cannot be reached.
A single pair that fits the larger surface of a relief finds another plane than least squares; the tracker's first pose is that of the visible surface (below).
There a plane is right within the relief's height, and within the tilt that this height gives over half of the target.

## The bound

At a left pixel x on the target, `I_R(W(x; q)) = g I_L(x) + o`, with the plane q, the map W between the images, and the unknown gain g and offset o of each channel.
Both images are noisy, so their difference has the variance `s^2 (1 + g^2)`, quantisation included.
The information about q is the sum over pixels and channels of the squared derivatives of this difference over its variance, minus the part that gain and offset take; its inverse is the bound.
Assumptions: white normal noise, exact calibration, known target pixels, information from these pixels alone (without saturated ones and those within 2 px of the outline), and equally sharp images.
Derivatives are differences of two renderings without noise whose left camera is moved by a quarter of a pixel in either direction.
A test fits a plane to every pixel, started at the truth: its rms lies between 1.0 and 1.7 times the bound, so the bound is neither too high nor far below the reachable error; the difference is lost in the interpolation between pixels.

## Sequences

The target moves along and about all axes at once (50 mm, 35 mm up and down, 20 degrees; periods of 4 to 7 s), in `fig7` along and about each axis in turn (100 mm, 20 degrees).
Errors are those of the motion since the first frame, at the target's origin, of the confident poses.
The trackers get no prediction.
In `hidden` an object slides in front of the target for 30 frames; `until back` is the number of frames from the end of the occlusion to the first right pose.
`jitter` is explained in [method.md](../method.md#jitter); `drift`, for long runs only, is the median error of the last tenth of the frames over that of the first tenth.
In `shaded` the lamp does not rotate with the target.

## Ensembles

All frames of a sequence share the errors of its first frame, so the NEES of one sequence tells little about a covariance.
An ensemble has many short sequences, each with its own start, motion and noise: 420 to 630 mm away, tilts and turns about the normal as for single pairs, up to 60 mm/s along and 30 degrees per second about each axis.
In `many`, 30 sequences have 20 frames each, 15 per second; in the others, 10 sequences have 30 frames each, 30 per second.
Errors are those of the motion since the first frame, over the frames of all sequences.
`NEES of the pose` compares with the true plane of the target; `NEES of the motion` takes the first answer as the definition of the frame `model`.
On a relief both are the latter, because the pose of the frame on a relief is a matter of definition.

The brackets contain a 95 % interval of the ratio of true to stated variance.
For single pairs, whose errors are independent, it is the NEES divided by the quantiles of the chi-square distribution with three degrees of freedom for each pair, over these degrees.
For ensembles the independent unit is the sequence: the NEES is the mean of the means of the sequences, and the degrees of freedom are those of a chi-square distribution whose mean scatters as these means do (Satterthwaite 1946).

| ensemble | condition of the cameras |
|---|---|
| `condition/none` | as in `track/crab` |
| `exposure/both-1.5x` | the exposure of both cameras changes at every sixth frame: normal, 1.5 times as long, normal, 1.5 times as short |
| `exposure/right-1.5x` | only that of the right camera does |
| `blur` | an exposure of this duration, in nine moments |
| `skew` | the right camera exposes later by this duration, which the trackers know; the truth is that of the left camera, and errors are those of the motion since the second frame, the first one whose depth is not that of a target at rest |
| `skew-unknown` | the same, but the trackers do not know it; errors since the first frame |
| `rolling` | both cameras read their rows one after the other, in this time for all rows; the truth is that of the moment at which the row of the target's origin is read |

## First poses

The tracker starts on objects that are no planes: whole outlines, their bounding boxes, and rectangles of 0.4 to 0.9 of their sides, 8 regions of each object in 5 views, with tilts of up to 25 degrees.
Regions of which the object covers less than half are left out: it is another question which surface is meant.
`stated / rms` is the median standard deviation over the rms error.
";

/// The document.
pub fn page(findings: &Findings, circumstances: &Circumstances) -> String {
    let mut text = String::from("# Accuracy on rendered scenes\n\n");
    text.push_str(INTRODUCTION);
    // Writing to a String does not fail.
    let _ = write!(
        text,
        "\n## Run\n\nSeed {}, commit `{}`{}, {}, {}.\n",
        findings.seed,
        circumstances.commit,
        if circumstances.changed { " with uncommitted changes" } else { "" },
        circumstances.processor,
        circumstances.compiler,
    );
    text.push_str("\n![rms of depth and normal against noise, distance and baseline](accuracy.svg)\n");
    let _ = write!(
        text,
        "\n### Single pairs\n\n{}",
        table::markdown(&table::HEADINGS, findings.summaries.iter().map(table::row))
    );
    let rows = findings.sequences.iter().map(sequence_summary::row);
    let _ = write!(text, "\n### Tracking\n\n{}", table::markdown(&sequence_summary::HEADINGS, rows));
    text.push_str("\n![errors of each frame](accuracy_sequence.svg)\n");
    let rows = findings.ensembles.iter().map(ensemble_summary::row);
    let _ = write!(text, "\n### Ensembles\n\n{}", table::markdown(&ensemble_summary::HEADINGS, rows));
    let rows = findings.first_poses.iter().map(FirstPoses::row);
    let _ = write!(text, "\n### First poses\n\n{}", table::markdown(&FirstPoses::HEADINGS, rows));
    let _ = write!(text, "\n### Limits\n\n{}", limits_table(findings));
    text
}

fn limits_table(findings: &Findings) -> String {
    let row = |check: &Check| {
        let kept = match check.standing(findings.quick) {
            Standing::Kept => "yes".to_owned(),
            Standing::Open(ceiling) => format!("open, at most {ceiling:.3}"),
            Standing::Broken => "no".to_owned(),
        };
        [
            check.name.clone(),
            check.method.to_owned(),
            check.figure.clone(),
            format!("{:.3}", check.measured),
            format!("{:.3}", check.max),
            kept,
        ]
    };
    table::markdown(&["configuration", "method", "figure", "measured", "limit", "met"], findings.checks.iter().map(row))
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector2};
    use pb3dp_estimation_core::status::Status;

    use super::super::measure::{Measured, Outcome};
    use super::super::trial::PlaneErrors;
    use super::*;

    fn findings() -> Findings {
        let cells: Vec<Cell> = super::super::cells::all().into_iter().filter(|cell| cell.factor() == "noise").collect();
        let summaries = cells
            .iter()
            .map(|cell| {
                let errors = Some(PlaneErrors { z_m: 1e-5 * cell.value, tilt_rad: Vector2::new(1e-3, 0.0) });
                let outcome = Outcome { status: Status::Ok, errors, normalised_error: None, cpu_millis: 1.0 };
                let bound = Some(Matrix3::identity() * 1e-10);
                Summary::of(cell, "direct", 0, &[Measured { bound, outcomes: vec![outcome] }])
            })
            .collect::<Vec<_>>();
        let checks = super::super::limits::checks(&summaries, &[], &[]);
        let (sequences, ensembles, first_poses) = (Vec::new(), Vec::new(), Vec::new());
        Findings { cells, summaries, sequences, ensembles, first_poses, checks, seed: 4, quick: false }
    }

    #[test]
    fn figures_show_methods_and_bound() {
        let svg = accuracy_figure(&findings());
        // Depth and angle against noise; six points each. The other panels are empty.
        assert_eq!(svg.matches("<circle").count(), 12);
        assert!(svg.contains(">bound<") && svg.contains(">direct<"));
    }

    #[test]
    fn the_page_tells_what_was_not_kept_and_where_it_was_measured() {
        let circumstances = Circumstances {
            commit: "abc".into(),
            changed: true,
            processor: "Some CPU".into(),
            compiler: "rustc 9".into(),
        };
        let text = page(&findings(), &circumstances);
        assert!(text.contains("commit `abc` with uncommitted changes, Some CPU, rustc 9"), "{text}");
        // 0.08 mm against a bound of 0.01 mm.
        assert!(text.contains("| noise/8 | direct | ZRatio | 8.000 | 1.500 | no |"), "{text}");
    }
}
