//! Output of `pb3dp rig plan`.

use std::fmt::Write as _;

use pb3dp_estimation::rig_plan::{Conditions, Lens, PixelNoise, PlannedView, StereoHead};
use pb3dp_estimation_direct::cramer_rao::PlaneSigma;
use serde::Serialize;

/// Rows of the table.
const ROWS: u32 = 6;

/// The tilt of a target with shorter sides is uncertain (docs/getting-started.md).
const TARGET_MIN_PX: f64 = 80.0;

/// More blur removes texture that the estimate needs.
const BLUR_MAX_PX: f64 = 1.0;

/// The result, in the units of the interface.
#[derive(Debug, Serialize)]
pub(super) struct Plan {
    head: Head,
    conditions: Given,
    lens: Option<LensLine>,
    /// At the requested distance.
    at: Line,
    /// Over the range.
    table: Vec<Line>,
    warnings: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Head {
    baseline_mm: f64,
    focal_px: f64,
    width_px: u32,
    height_px: u32,
    view_deg: [f64; 2],
    /// Nearest distance at which the whole target is in both images.
    nearest_in_both_mm: f64,
}

#[derive(Debug, Serialize)]
struct Given {
    target_mm: f64,
    noise_grey: Option<f64>,
    gradient_grey_per_px: Option<f64>,
    /// Of one pixel.
    disparity_noise_px: f64,
    calibration_px: f64,
    speed_mm_per_s: f64,
    exposure_ms: f64,
    skew_ms: f64,
}

#[derive(Debug, Serialize)]
struct LensLine {
    pixel_um: f64,
    focal_mm: f64,
    f_number: f64,
    focused_at_mm: f64,
}

/// One distance. Errors are standard deviations, null if a part of the target is not in both images.
#[derive(Debug, Serialize)]
struct Line {
    distance_mm: f64,
    disparity_px: f64,
    depth_per_px_mm: f64,
    overlap_percent: f64,
    target_px: f64,
    depth_noise_mm: Option<f64>,
    depth_calibration_mm: Option<f64>,
    depth_mm: Option<f64>,
    tilt_noise_deg: Option<f64>,
    tilt_calibration_deg: Option<f64>,
    tilt_deg: Option<f64>,
    blur_px: f64,
    /// Null if nothing moves.
    one_pixel_exposure_ms: Option<f64>,
    skew_px: f64,
    skew_depth_mm: f64,
    /// Null without a lens.
    defocus_px: Option<f64>,
}

impl Line {
    fn of(view: &PlannedView, defocus_px: Option<f64>) -> Self {
        let errors = view.errors.as_ref();
        let mm = |sigma: &PlaneSigma| sigma.depth_m * 1e3;
        let deg = |sigma: &PlaneSigma| sigma.normal_rad.to_degrees();
        Self {
            distance_mm: view.z_m * 1e3,
            disparity_px: view.disparity_px,
            depth_per_px_mm: view.depth_per_px_m * 1e3,
            overlap_percent: view.overlap_share * 100.0,
            target_px: view.target_px,
            depth_noise_mm: errors.map(|errors| mm(&errors.noise)),
            depth_calibration_mm: errors.map(|errors| mm(&errors.calibration)),
            depth_mm: errors.map(|errors| mm(&errors.both)),
            tilt_noise_deg: errors.map(|errors| deg(&errors.noise)),
            tilt_calibration_deg: errors.map(|errors| deg(&errors.calibration)),
            tilt_deg: errors.map(|errors| deg(&errors.both)),
            blur_px: view.blur_px,
            one_pixel_exposure_ms: Some(view.one_pixel_exposure_s * 1e3).filter(|ms| ms.is_finite()),
            skew_px: view.skew_px,
            skew_depth_mm: view.skew_depth_m * 1e3,
            defocus_px,
        }
    }

    /// A row of the table.
    fn row(&self) -> String {
        let error = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
        let mut row = format!(
            "| {:.0} | {:.1} | {:.0} | {:.0} | {} | {} | {} | {} | {:.2} | {:.2} |",
            self.distance_mm,
            self.disparity_px,
            self.overlap_percent,
            self.target_px,
            error(self.depth_noise_mm),
            error(self.depth_mm),
            error(self.tilt_noise_deg),
            error(self.tilt_deg),
            self.blur_px,
            self.skew_depth_mm,
        );
        if let Some(defocus_px) = self.defocus_px {
            let _ = write!(row, " {defocus_px:.1} |");
        }
        row
    }
}

impl Plan {
    /// Plan of a rig at a distance, and over a range.
    pub(super) fn of(
        head: &StereoHead,
        conditions: &Conditions,
        lens: Option<&Lens>,
        z_m: f64,
        [min_mm, max_mm]: [f64; 2],
    ) -> Self {
        let line = |z_m: f64| Line::of(&head.at(z_m, conditions), lens.map(|lens| lens.defocus_px(head.focal_px, z_m)));
        let step_mm = (max_mm - min_mm) / f64::from(ROWS - 1);
        let at = line(z_m);
        let (noise_grey, gradient_grey_per_px) = match conditions.noise {
            PixelNoise::Image { noise_grey, gradient_grey_per_px } => (Some(noise_grey), Some(gradient_grey_per_px)),
            PixelNoise::Disparity { .. } => (None, None),
        };
        let mut plan = Self {
            head: Head {
                baseline_mm: head.baseline_m * 1e3,
                focal_px: head.focal_px,
                width_px: head.size.width,
                height_px: head.size.height,
                view_deg: head.view_rad().map(f64::to_degrees),
                nearest_in_both_mm: head.nearest_in_both_m(conditions.target_m) * 1e3,
            },
            conditions: Given {
                target_mm: conditions.target_m * 1e3,
                noise_grey,
                gradient_grey_per_px,
                disparity_noise_px: conditions.noise.disparity_sigma_px(),
                calibration_px: conditions.calibration_px,
                speed_mm_per_s: conditions.speed_m_per_s * 1e3,
                exposure_ms: conditions.exposure_s * 1e3,
                skew_ms: conditions.skew_s * 1e3,
            },
            lens: lens.map(|lens| LensLine {
                pixel_um: lens.pixel_m * 1e6,
                focal_mm: lens.focal_m(head.focal_px) * 1e3,
                f_number: lens.f_number,
                focused_at_mm: lens.focused_at_m * 1e3,
            }),
            at,
            table: (0..ROWS).map(|row| line((min_mm + f64::from(row) * step_mm) * 1e-3)).collect(),
            warnings: Vec::new(),
        };
        plan.warnings = plan.warned();
        plan
    }

    /// Warnings about this stereo rig.
    fn warned(&self) -> Vec<String> {
        let (at, head, given) = (&self.at, &self.head, &self.conditions);
        let mut warnings = Vec::new();
        if at.depth_mm.is_none() {
            warnings.push(format!(
                "at {:.0} mm the target is not wholly in both images, which begins at {:.0} mm: a shorter focal length or baseline, or a \
                 smaller target",
                at.distance_mm, head.nearest_in_both_mm
            ));
        }
        if at.target_px < TARGET_MIN_PX {
            warnings.push(format!(
                "at {:.0} mm the target has {:.0} px; with less than {TARGET_MIN_PX:.0} px its tilt is often not sure: a longer focal length \
                 in pixels",
                at.distance_mm, at.target_px
            ));
        }
        if at.blur_px > BLUR_MAX_PX {
            warnings.push(format!(
                "{:.1} px of motion blur: expose for at most {:.1} ms, with more light",
                at.blur_px,
                at.one_pixel_exposure_ms.unwrap_or(f64::INFINITY)
            ));
        }
        if at.depth_mm.is_some_and(|depth_mm| at.skew_depth_mm > depth_mm) {
            warnings.push(format!(
                "a skew of {:.1} ms costs {:.2} mm at {:.0} mm/s, more than noise and calibration: trigger both cameras",
                given.skew_ms, at.skew_depth_mm, given.speed_mm_per_s
            ));
        }
        warnings
    }

    /// As text; the table is Markdown.
    pub(super) fn text(&self) -> String {
        let mut text = self.text_of_given();
        let at = &self.at;
        let mut line = |what: &str, value: String| {
            let _ = writeln!(text, "{what:<22} {value}");
        };
        line("distance", format!("{:.0} mm", at.distance_mm));
        line("disparity", format!("{:.1} px; a pixel of it is {:.2} mm of depth", at.disparity_px, at.depth_per_px_mm));
        if let (Some(near), Some(far)) = (self.table.first(), self.table.last()) {
            let (from, to) = (format!("{:.0} mm", near.distance_mm), format!("{:.0} mm", far.distance_mm));
            line("disparities", format!("{:.1} px at {from} to {:.1} px at {to}", near.disparity_px, far.disparity_px));
        }
        line("seen by both", format!("{:.0} % of an image; the target has {:.0} px", at.overlap_percent, at.target_px));
        let errors = |values: [Option<f64>; 3], unit: &str| match values {
            [Some(noise), Some(calibration), Some(both)] => {
                format!("{both:.3} {unit}: {noise:.3} {unit} of noise at best, {calibration:.3} {unit} of calibration")
            }
            _ => "none: the target is not wholly in both images".to_owned(),
        };
        line("depth error, sigma", errors([at.depth_noise_mm, at.depth_calibration_mm, at.depth_mm], "mm"));
        line("tilt error, rms", errors([at.tilt_noise_deg, at.tilt_calibration_deg, at.tilt_deg], "deg"));
        let longest = at.one_pixel_exposure_ms.map_or_else(String::new, |ms| format!("; 1 px in {ms:.1} ms"));
        line("motion blur", format!("{:.2} px{longest}", at.blur_px));
        line("skew", format!("{:.2} mm of depth, or {:.2} px of rows", at.skew_depth_mm, at.skew_px));
        if let (Some(lens), Some(defocus_px)) = (&self.lens, at.defocus_px) {
            line(
                "lens",
                format!(
                    "{:.2} mm at f/{}, focused at {:.0} mm; a point becomes {defocus_px:.1} px wide",
                    lens.focal_mm, lens.f_number, lens.focused_at_mm
                ),
            );
        }
        let _ = write!(text, "\n{}", self.table_text());
        for warning in &self.warnings {
            let _ = write!(text, "\nWARNING {warning}");
        }
        text.truncate(text.trim_end().len());
        text
    }

    fn text_of_given(&self) -> String {
        let (head, given) = (&self.head, &self.conditions);
        let mut text = format!(
            "head: baseline {} mm, focal length {} px, {}x{} px: {:.1} x {:.1} deg\n",
            head.baseline_mm, head.focal_px, head.width_px, head.height_px, head.view_deg[0], head.view_deg[1]
        );
        let _ = writeln!(
            text,
            "target: {} mm square, wholly in both images from {:.0} mm on",
            given.target_mm, head.nearest_in_both_mm
        );
        let source = match (given.noise_grey, given.gradient_grey_per_px) {
            (Some(noise), Some(gradient)) => format!(" (noise {noise} grey levels, texture {gradient} per px)"),
            _ => String::new(),
        };
        let _ = writeln!(
            text,
            "errors: a pixel knows its disparity to {:.3} px{source}; calibration leaves {} px",
            given.disparity_noise_px, given.calibration_px
        );
        let _ = writeln!(
            text,
            "motion: {} mm/s along the baseline, exposure {} ms, skew {} ms\n",
            given.speed_mm_per_s, given.exposure_ms, given.skew_ms
        );
        text
    }

    fn table_text(&self) -> String {
        let mut columns = vec![
            "distance mm",
            "disparity px",
            "overlap %",
            "target px",
            "depth, noise mm",
            "depth mm",
            "tilt, noise deg",
            "tilt deg",
            "blur px",
            "skew mm",
        ];
        columns.extend(self.lens.as_ref().map(|_| "defocus px"));
        let mut text = format!("| {} |\n|{}\n", columns.join(" | "), "---|".repeat(columns.len()));
        for line in &self.table {
            let _ = writeln!(text, "{}", line.row());
        }
        text
    }
}
