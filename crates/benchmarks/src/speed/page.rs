//! The document with the results.

use std::fmt::Write as _;

use serde_json::Value;

use super::Findings;
use super::cold::KernelRow;
use super::goals::goals;
use super::times::Times;
use crate::common::circumstances::Circumstances;

const HEAD: &str = "\
# Speed

This page is written by the command below; change the program, not the page.

All times are CPU time of one thread in milliseconds, after warm-up, with images in memory and reused buffers.
";

/// The whole page; `published` is the result of the example `published_speed` in the same run.
pub fn markdown(
    findings: &Findings,
    published: Option<&Value>,
    circumstances: &Circumstances,
    command: &str,
) -> String {
    let mut page = HEAD.to_owned();
    let changed = if circumstances.changed { ", with uncommitted changes" } else { "" };
    let Circumstances { commit, processor, compiler, .. } = circumstances;
    // Writing to a String does not fail.
    let _ = write!(page, "\n```text\n{command}\n```\n\nCommit {commit}{changed}; {processor}; {compiler}.\n");
    goal_table(&mut page, findings);
    real_cases(&mut page, findings);
    sizes(&mut page, findings);
    raw(&mut page, findings);
    tracking(&mut page, findings);
    kernels(&mut page, &findings.kernels);
    if let Some(published) = published {
        published_kernels(&mut page, published);
    }
    scaling(&mut page, findings);
    page
}

fn section(page: &mut String, title: &str, text: &str, headings: &[&str]) {
    let _ = write!(page, "\n## {title}\n\n{text}\n\n");
    row(page, &headings.iter().map(|&heading| heading.to_owned()).collect::<Vec<_>>());
    row(page, &vec!["---".to_owned(); headings.len()]);
}

fn row(page: &mut String, cells: &[String]) {
    let _ = writeln!(page, "| {} |", cells.join(" | "));
}

fn three(times: &Times) -> [String; 3] {
    [times.median_ms, times.p90_ms, times.p99_ms].map(|ms| format!("{ms:.3}"))
}

fn goal_table(page: &mut String, findings: &Findings) {
    section(page, "Goals", "Goals for the direct method, in milliseconds.", &["figure", "goal", "found", "reached"]);
    for goal in goals(findings) {
        let reached = if goal.is_reached() { "yes" } else { "no" };
        row(
            page,
            &[
                goal.name.to_owned(),
                format!("{:.1}", goal.limit_ms),
                format!("{:.2}", goal.found_ms),
                reached.to_owned(),
            ],
        );
    }
}

fn real_cases(page: &mut String, findings: &Findings) {
    let Some(real) = &findings.real else { return };
    let text = "From two images in memory to a pose with its covariance.\nEach case counts with the median of its calls; stages are medians over the cases, each measured alone at the pyramid level of the answer.";
    let mut headings = vec!["group", "cases", "median", "p90", "max"];
    let first = real.rows.first().map(|row| row.stages.as_slice()).unwrap_or_default();
    headings.extend(first.iter().map(|(stage, _)| stage.name()));
    section(page, "Cold start on real cases", text, &headings);
    for found in &real.rows {
        let times = &found.whole;
        let mut cells = vec![found.name.to_owned(), times.count.to_string()];
        cells.extend([times.median_ms, times.p90_ms, times.max_ms].map(|ms| format!("{ms:.2}")));
        cells.extend(found.stages.iter().map(|(_, ms)| format!("{ms:.3}")));
        row(page, &cells);
    }
    let rows = &real.row_measurement;
    let _ = write!(
        page,
        "\nThe vertical misalignment of the rig is measured once before and is not part of these times: median {:.1} ms, p90 {:.1} ms, max {:.1} ms.\n",
        rows.median_ms, rows.p90_ms, rows.max_ms
    );
    let first = &real.first_call;
    let _ = writeln!(
        page,
        "The first call of an estimator also allocates its memory: median {:.2} ms, p90 {:.2} ms, max {:.2} ms.",
        first.median_ms, first.p90_ms, first.max_ms
    );
}

fn sizes(page: &mut String, findings: &Findings) {
    let text = "Squares on a rendered textured wall, images of 640 x 480, search range of 60 px of disparity.\nStages are medians.";
    let mut headings = vec!["region px", "status", "median", "p90", "p99"];
    let first = findings.sizes.first().map(|row| row.stages.as_slice()).unwrap_or_default();
    headings.extend(first.iter().map(|(stage, _)| stage.name()));
    section(page, "Cold start by size of the region", text, &headings);
    for found in &findings.sizes {
        let mut cells = vec![format!("{0} x {0}", found.side_px), found.status.to_owned()];
        cells.extend(three(&found.whole));
        cells.extend(found.stages.iter().map(|(_, times)| format!("{:.3}", times.median_ms)));
        row(page, &cells);
    }
    page.push_str("\n![Time of a cold start by size of the region](speed.svg)\n");
}

fn raw(page: &mut String, findings: &Findings) {
    let text = "The same wall through lenses with distortion, in rotated cameras; 60 px of disparity at every size.\nAll rigs are measured in turn, so other load affects all of them alike.\nRatios are those of the medians: to rectified images of 640 x 480, and to images of 640 x 480 with the same lenses.\nCreation is the time to create the estimator, once per rig.";
    let mut headings = vec![
        "region px",
        "images",
        "lenses",
        "status",
        "median",
        "p90",
        "p99",
        "to rectified",
        "to 640 x 480",
        "creation",
    ];
    let first = findings.raw.first().map(|row| row.stages.as_slice()).unwrap_or_default();
    headings.extend(first.iter().map(|(stage, _)| stage.name()));
    section(page, "Cold start on raw images", text, &headings);
    for found in &findings.raw {
        let size = format!("{} x {}", found.size.width, found.size.height);
        let (lenses, status) = (found.lenses.name().to_owned(), found.status.to_owned());
        let mut cells = vec![format!("{0} x {0}", found.side_px), size, lenses, status];
        cells.extend(three(&found.times));
        cells.extend([found.ratio, found.ratio_to_small, found.creation_ms].map(|number| format!("{number:.2}")));
        cells.extend(found.stages.iter().map(|(_, ms)| format!("{ms:.3}")));
        row(page, &cells);
    }
}

fn tracking(page: &mut String, findings: &Findings) {
    let found = &findings.tracking;
    let text = "The flat crab of the simulator moves along and about all axes; images of 640 x 480, 1000 points.\nFor a lost target, all stored views are searched in the whole images.";
    section(page, "Tracking", text, &["frame", "frames", "median", "p90", "p99", "max"]);
    for (name, times) in [("followed", &found.followed), ("lost", &found.lost)] {
        let mut cells = vec![name.to_owned(), times.count.to_string()];
        cells.extend(three(times));
        cells.push(format!("{:.3}", times.max_ms));
        row(page, &cells);
    }
    let _ = write!(page, "\nThe first frame, with cold start and model, took {:.2} ms.\n", found.start_ms);
}

fn kernels(page: &mut String, rows: &[KernelRow]) {
    let text = "Nanoseconds per sample and, in brackets, the speed-up over the scalar family in the same run.\nA region of 100 x 100 px; all families give bit-identical results.";
    let names: Vec<&str> =
        rows.first().map(|row| row.sets.iter().map(|(name, ..)| *name).collect()).unwrap_or_default();
    let headings: Vec<&str> = ["part", "a sample is a"].into_iter().chain(names).collect();
    section(page, "Kernels of the direct method", text, &headings);
    for found in rows {
        let mut cells = vec![found.name.clone(), found.unit.to_owned()];
        cells.extend(found.sets.iter().map(|(_, ns, ratio)| format!("{ns:.3} ({ratio:.1})")));
        row(page, &cells);
    }
}

/// The JSON output of the example.
fn published_kernels(page: &mut String, published: &Value) {
    let text = "Scoring of 60 hypotheses; the naive version computes the formula directly.\nA frame is both hue images, the model and nine generations.";
    let headings = ["pair", "kernels", "ns per sample", "ratio to naive", "frame ms"];
    section(page, "Kernels of the published method", text, &headings);
    let pairs = published["pairs"].as_array().map(Vec::as_slice).unwrap_or_default();
    for pair in pairs {
        for found in pair["kernels"].as_array().map(Vec::as_slice).unwrap_or_default() {
            let number = |key: &str, digits: usize| format!("{:.digits$}", found[key].as_f64().unwrap_or(f64::NAN));
            row(
                page,
                &[
                    pair["pair"].as_str().unwrap_or("?").to_owned(),
                    found["kernels"].as_str().unwrap_or("?").to_owned(),
                    number("ns_per_sample", 3),
                    number("ratio_to_naive", 1),
                    number("frame_ms", 3),
                ],
            );
        }
    }
}

fn scaling(page: &mut String, findings: &Findings) {
    let text = "Targets of 100 x 100 px on the moving wall (160 x 160 where points are varied), the same field of view at every image size.\nFor several targets the time is the total; for several threads, each with its own target, the time is per thread.\nThe ratio is relative to the first row of its kind.";
    section(page, "Scaling", text, &["varied", "value", "what", "median", "p90", "p99", "ratio"]);
    for found in &findings.scaling {
        let mut cells = vec![found.varied.to_owned(), found.value.clone(), found.what.to_owned()];
        cells.extend(three(&found.times));
        cells.push(format!("{:.2}", found.ratio));
        row(page, &cells);
    }
}
