//! What `pb3dp estimate` prints: a line per case, and the errors by group where the truth is known.

use std::io::{self, Write};

use pb3dp_estimation::estimate::PlaneEstimate;
use serde::Serialize;

/// The result of one case, in the units of the interface; the order of the fields is that of the JSON line.
#[derive(Clone, Debug, Serialize)]
pub struct EstimateLine {
    /// Name of the case.
    pub case: String,
    /// Name of the method.
    pub method: &'static str,
    /// `ok`, `weak-tilt`, `ambiguous`, `not-observable` or `error`.
    pub status: &'static str,
    /// Depth of the plane on the ray of the region's centroid, millimetres.
    pub z_mm: Option<f64>,
    /// Unit normal in `cam_left`, towards the camera.
    pub normal: Option<[f64; 3]>,
    /// Fitness, eq. (10).
    pub fitness: Option<f64>,
    /// Standard deviation of the depth, millimetres.
    pub z_sigma_mm: Option<f64>,
    /// Standard deviation of the normal, degrees.
    pub normal_sigma_deg: Option<f64>,
    /// CPU time of one thread from images in memory to pose, milliseconds.
    pub ms: Option<f64>,
}

impl EstimateLine {
    /// A case that could not be worked on.
    pub fn of_error(case: &str, method: &'static str) -> Self {
        Self {
            case: case.to_owned(),
            method,
            status: "error",
            z_mm: None,
            normal: None,
            fitness: None,
            z_sigma_mm: None,
            normal_sigma_deg: None,
            ms: None,
        }
    }

    /// The line of an estimate; `z_m` is the depth where it is to be reported.
    pub fn of(case: &str, method: &'static str, estimate: &PlaneEstimate, z_m: Option<f64>, ms: f64) -> Self {
        Self {
            status: estimate.status.as_str(),
            z_mm: z_m.map(|z| z * 1e3),
            normal: estimate.normal_in_cam_left().map(Into::into),
            fitness: estimate.fitness,
            z_sigma_mm: estimate.z_sigma_m.map(|sigma| sigma * 1e3),
            normal_sigma_deg: estimate.normal_sigma_rad.map(f64::to_degrees),
            ms: Some(ms),
            ..Self::of_error(case, method)
        }
    }

    /// Heading of the human table.
    pub const HEADING: &'static str =
        "case                      status              z mm  normal (x, y, z)         fitness       ms";

    /// The line of the human table.
    pub fn human(&self) -> String {
        let number = |value: Option<f64>, decimals: usize| value.map_or("-".into(), |x| format!("{x:.decimals$}"));
        let normal = self.normal.map_or("-".into(), |[x, y, z]| format!("{x:+.3} {y:+.3} {z:+.3}"));
        format!(
            "{:<25} {:<14} {:>9}  {:<24} {:>7} {:>8}",
            self.case,
            self.status,
            number(self.z_mm, 2),
            normal,
            number(self.fitness, 3),
            number(self.ms, 2)
        )
    }
}

/// Writes one line to standard output; a closed pipe is no error.
///
/// # Errors
/// If standard output can not be written for another reason.
pub fn print_line(line: &str) -> io::Result<()> {
    match writeln!(io::stdout().lock(), "{line}") {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}
