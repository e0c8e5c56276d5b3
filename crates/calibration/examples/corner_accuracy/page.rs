//! Tables, limits and the page.

use std::fmt::Write as _;

use pb3dp_record::metrics::percentile;

use crate::real::OfSet;
use crate::rendered::{CONDITIONS, LOCALIZERS, OfCondition};

/// Error of a corner in a row or column at image noise 2, px. Required.
const RMS_MAX_PX: f64 = 0.035;
/// Numbers within one stated standard deviation: 68.3 % if the deviations are right; the allowed difference is four standard
/// deviations of the share of a full run, whose numbers are correlated within a rig (about one in four is independent).
const COVERED_PERCENT: f64 = 68.3;
const COVERED_OFF_MAX: f64 = 12.0;
/// The error of held-out views, after / before. At most as large, within the 1 % by which it differs for other parts of the views.
const HELD_OUT_RATIO_MAX: f64 = 1.01;

/// All figures.
pub struct Findings {
    pub rendered: Vec<OfCondition>,
    pub real: Vec<OfSet>,
    pub seed: u32,
    pub rigs: u32,
}

/// A limit and the measured value.
pub struct Check {
    what: String,
    measured: f64,
    max: f64,
}

impl Check {
    pub fn is_kept(&self) -> bool {
        self.measured <= self.max
    }
}

fn median_and_p95(values: &[f64], digits: usize) -> String {
    let of = |percent| percentile(values, percent).unwrap_or(f64::NAN);
    format!("{:.digits$} / {:.digits$}", of(50.0), of(95.0))
}

impl Findings {
    pub fn checks(&self) -> Vec<Check> {
        let mut checks = Vec::new();
        let after = LOCALIZERS.len() - 1;
        if let Some(standard) = self.rendered.first() {
            let measured = standard.by_localizer[after].rms_px();
            checks.push(Check { what: "error of a corner at noise 2, px".to_owned(), measured, max: RMS_MAX_PX });
        }
        for ((condition, _), of) in CONDITIONS.iter().zip(&self.rendered) {
            let measured = (of.by_localizer[after].covered_percent(1) - COVERED_PERCENT).abs();
            let what = format!("{condition}: covered by one sigma, difference from 68.3 %");
            checks.push(Check { what, measured, max: COVERED_OFF_MAX });
        }
        for pair in self.real.chunks(LOCALIZERS.len()) {
            let (Some(before), Some(after)) = (pair.first(), pair.last()) else { continue };
            checks.push(Check {
                what: format!("{}: held-out error, after / before", after.name),
                measured: after.held_out_px / before.held_out_px,
                max: HELD_OUT_RATIO_MAX,
            });
        }
        checks
    }

    fn corner_table(&self) -> String {
        let mut text = String::from(
            "| images | localizer | error per axis, px | distance, median / p95 / max, px | bound, 5 x 5 px | bound, half a square | boards missed | ms per image |\n|---|---|---:|---:|---:|---:|---:|---:|\n",
        );
        for ((condition, _), of) in CONDITIONS.iter().zip(&self.rendered) {
            for ((_, name), measured) in LOCALIZERS.iter().zip(&of.by_localizer) {
                let _ = writeln!(
                    text,
                    "| {condition} | {name} | {:.4} | {:.3} / {:.3} / {:.3} | {:.4} | {:.4} | {} | {:.1} |",
                    measured.rms_px(),
                    measured.distance_px(50.0),
                    measured.distance_px(95.0),
                    measured.distance_px(100.0),
                    of.bound_px(0),
                    of.bound_px(1),
                    measured.missed_boards,
                    percentile(&measured.detection_ms, 50.0).unwrap_or(f64::NAN),
                );
            }
        }
        text
    }

    fn calibration_table(&self) -> String {
        let mut text = String::from(
            "| images | localizer | reprojection, px | held out, px | focal length, px | principal point, px | baseline, mm | rotation, deg | within 1 sigma | within 2 sigma | no fit | ms |\n|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n",
        );
        for ((condition, _), of) in CONDITIONS.iter().zip(&self.rendered) {
            for ((_, name), measured) in LOCALIZERS.iter().zip(&of.by_localizer) {
                let _ = writeln!(
                    text,
                    "| {condition} | {name} | {} | {} | {} | {} | {} | {} | {:.1} % | {:.1} % | {} | {:.0} |",
                    median_and_p95(&measured.reprojection_px, 4),
                    median_and_p95(&measured.held_out_px, 4),
                    median_and_p95(&measured.focal_px, 3),
                    median_and_p95(&measured.principal_point_px, 3),
                    median_and_p95(&measured.baseline_mm, 4),
                    median_and_p95(&measured.rotation_deg, 4),
                    measured.covered_percent(1),
                    measured.covered_percent(2),
                    measured.failed_fits,
                    percentile(&measured.calibration_ms, 50.0).unwrap_or(f64::NAN),
                );
            }
        }
        text
    }

    fn real_table(&self) -> String {
        let mut text = String::from(
            "| boards | localizer | views | blur of edges, px | lens | reprojection, px | held out, px | rows, px | sigma of a corner, px | view scatter | ms per image |\n|---|---|---:|---:|---|---:|---:|---:|---:|---:|---:|\n",
        );
        for of in &self.real {
            let _ = writeln!(
                text,
                "| {} | {} | {} of {} | {:.2} | {} | {:.4} | {:.4} | {:.4} | {:.4} | {:.1} | {:.1} |",
                of.name,
                of.localizer,
                of.views,
                of.pairs,
                of.blur_px,
                of.lens,
                of.reprojection_px,
                of.held_out_px,
                of.rows_px,
                of.corner_sigma_px,
                of.view_scatter,
                of.detection_ms,
            );
        }
        text
    }

    pub fn text(&self, checks: &[Check]) -> String {
        let tables = [self.corner_table(), self.calibration_table(), self.real_table(), check_table(checks)];
        tables.join("\n")
    }

    pub fn page(&self, checks: &[Check], origin: &str) -> String {
        let missed = checks.iter().filter(|check| !check.is_kept()).count();
        let (seed, rigs, limits) = (self.seed, self.rigs, checks.len());
        let (corners, calibrations, real, limit_table) =
            (self.corner_table(), self.calibration_table(), self.real_table(), check_table(checks));
        format!(
            "# Calibration\n
This page is written by the command below; change the program, not the page.

```text
cargo xtask bench calibration
```

{origin}
Seed {seed}.

{missed} of {limits} limits are missed: [limits](#limits).

Before: `centre of mass`, the centre of the corner detector's response.
Now: `saddle point`, the saddle of a quadratic surface fitted to 5 x 5 pixels that are centred on the corner.

## Corners of rendered boards

{rigs} random stereo rigs, 15 views each, 640 x 480, 9 x 6 corners, tilted by up to 40 degrees, 15 to 60 px apart.
The true corners are exact; edges are rendered with 64 samples per pixel.
Where not stated otherwise, the lens blurs by 0.5 px (standard deviation) and the squares have the grey levels 35 and 225; `dim` has a quarter of this contrast.
The error per axis is the root mean square over all corners.
The bound is that of Cramér and Rao for one corner with unknown edge directions, grey levels and blur: from the 5 x 5 nearest pixels, and from all pixels up to half the distance to the next corner.
`saddle point` uses 5 x 5 pixels.
It does not model the blur, so part of its error does not fall with the noise; in sharp images this part is the larger one.

{corners}
## Calibrations from these corners

Each rig is calibrated from its 15 views with the lens model brown-4 and the estimated board shape.
Errors are absolute differences from the truth: median / p95 over all rigs, for focal lengths and principal points over both cameras.
Held out: error of views that the fit has not used, as in `pb3dp calibrate`.
Within 1 sigma: share of all estimated numbers (focal lengths, principal points, lens coefficients, pose between the cameras) that differ from the truth by at most one stated standard deviation; 68.3 % and 95.4 % are right.
The time is that of fit and held-out fits, without detection.

{calibrations}
## Real boards

There is no truth for these corners.
The error of held-out views measures them: a fit cannot absorb errors of views that it has not used.
Sets that are not in this repository (here the ZED, if it is listed) are added with `-- --boards name,folder,prefix,COLUMNSxROWS,square_mm`, repeated; every subfolder with the prefix has a `left.png` and a `right.png`.

{real}
## Limits

{limit_table}"
        )
    }
}

fn check_table(checks: &[Check]) -> String {
    let mut text = String::from("| limit | measured | at most | met |\n|---|---:|---:|---|\n");
    for check in checks {
        let _ = writeln!(
            text,
            "| {} | {:.4} | {:.3} | {} |",
            check.what,
            check.measured,
            check.max,
            if check.is_kept() { "yes" } else { "no" }
        );
    }
    text
}
