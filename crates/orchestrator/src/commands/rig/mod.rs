//! `pb3dp rig`: accuracy of a stereo rig before it is built (docs/rig.md).

mod report;

use std::process::ExitCode;

use anyhow::Result;
use clap::{Args, Subcommand};
use pb3dp_cell::terminal::print_line;
use pb3dp_estimation::rig_plan::{Conditions, Lens, PixelNoise, StereoHead};
use pb3dp_geometry::ImageSize;

use self::report::Plan;
use crate::numbers::{Span, distance, grey, micrometres, millimetres, millis, number, pixels, size, span};

/// Arguments of `pb3dp rig`.
#[derive(Debug, Args)]
pub struct RigArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Errors of depth and tilt, common field of view, motion blur and effect of skew for a baseline, a focal length and a
    /// distance.
    Plan(PlanArgs),
}

/// Arguments of `pb3dp rig plan`.
#[derive(Debug, Args)]
struct PlanArgs {
    /// Baseline, mm.
    #[arg(long, value_name = "MM", value_parser = millimetres(5.0..=2000.0), allow_hyphen_values = true)]
    baseline: f64,
    /// Focal length of both cameras, pixels (see docs/rig.md for that of a lens).
    #[arg(long, value_name = "PX", value_parser = pixels(50.0..=20_000.0), allow_hyphen_values = true)]
    focal: f64,
    /// Distance from the cameras to the target, mm.
    #[arg(long, value_name = "MM", value_parser = distance(), allow_hyphen_values = true)]
    distance: f64,
    /// Range of distances of the table, mm.
    #[arg(long, value_name = "MIN,MAX", value_parser = span, default_value = "300,800", allow_hyphen_values = true)]
    range: Span,
    /// Image size, pixels.
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "640x480")]
    size: ImageSize,
    /// Side of a flat square target that faces the cameras, mm.
    #[arg(long, value_name = "MM", value_parser = millimetres(2.0..=2000.0), default_value = "100", allow_hyphen_values = true)]
    target: f64,
    /// Standard deviation of the noise of a pixel, grey levels.
    #[arg(long, value_name = "GREY", value_parser = grey(0.05..=50.0), default_value = "3", allow_hyphen_values = true)]
    noise: f64,
    /// Texture of the target: rms of the gradient along rows, all three channels together, grey levels per pixel.
    #[arg(long, value_name = "GREY", value_parser = grey(0.1..=200.0), default_value = "8", allow_hyphen_values = true)]
    gradient: f64,
    /// Replaces --noise and --gradient: standard deviation of the disparity of one pixel, px.
    #[arg(long, value_name = "PX", value_parser = pixels(1e-3..=10.0), conflicts_with_all = ["noise", "gradient"], allow_hyphen_values = true)]
    disparity_noise: Option<f64>,
    /// Residual calibration error, px of disparity: at the target's middle, and the same additionally at its borders.
    #[arg(long, value_name = "PX", value_parser = pixels(0.0..=5.0), default_value = "0.1", allow_hyphen_values = true)]
    calibration: f64,
    /// Speed of the target relative to the cameras, along the baseline, mm/s.
    #[arg(long, value_name = "MM/S", value_parser = number("mm/s", 0.0..=10_000.0), default_value = "100", allow_hyphen_values = true)]
    speed: f64,
    /// Exposure time, ms.
    #[arg(long, value_name = "MS", value_parser = millis(0.01..=1000.0), default_value = "5", allow_hyphen_values = true)]
    exposure: f64,
    /// Time between the midpoints of the two exposures, ms.
    #[arg(long, value_name = "MS", value_parser = millis(0.0..=1000.0), default_value = "5", allow_hyphen_values = true)]
    skew: f64,
    /// Pixel pitch of the sensor, um: adds the lens to the result.
    #[arg(long, value_name = "UM", value_parser = micrometres(), allow_hyphen_values = true)]
    pixel: Option<f64>,
    /// Aperture of the lens, N of f/N.
    #[arg(long, value_name = "N", value_parser = number("as in f/4", 0.7..=64.0), default_value = "4", requires = "pixel", allow_hyphen_values = true)]
    f_number: f64,
    /// Focus distance of the lens, mm; default: --distance.
    #[arg(long, value_name = "MM", value_parser = distance(), requires = "pixel", allow_hyphen_values = true)]
    focused_at: Option<f64>,
    /// One JSON object on standard output instead of text.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// If standard output cannot be written.
pub fn run(args: &RigArgs) -> Result<ExitCode> {
    let What::Plan(args) = &args.what;
    let plan = args.plan();
    let text = if args.json { serde_json::to_string(&plan)? } else { plan.text() };
    print_line(&text)?;
    Ok(ExitCode::SUCCESS)
}

impl PlanArgs {
    fn plan(&self) -> Plan {
        let head = StereoHead { baseline_m: self.baseline * 1e-3, focal_px: self.focal, size: self.size };
        let noise = match self.disparity_noise {
            Some(sigma_px) => PixelNoise::Disparity { sigma_px },
            None => PixelNoise::Image { noise_grey: self.noise, gradient_grey_per_px: self.gradient },
        };
        let conditions = Conditions {
            target_m: self.target * 1e-3,
            noise,
            calibration_px: self.calibration,
            speed_m_per_s: self.speed * 1e-3,
            exposure_s: self.exposure * 1e-3,
            skew_s: self.skew * 1e-3,
        };
        let lens = self.pixel.map(|pixel_um| Lens {
            pixel_m: pixel_um * 1e-6,
            f_number: self.f_number,
            focused_at_m: self.focused_at.unwrap_or(self.distance) * 1e-3,
        });
        Plan::of(&head, &conditions, lens.as_ref(), self.distance * 1e-3, [self.range.min_mm, self.range.max_mm])
    }
}
