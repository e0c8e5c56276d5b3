//! The cameras: controls and checks of their images.

use pb3dp_cell::camera_controls::ShownCamera;
use pb3dp_cell::finding::Finding;
use serde::Serialize;

/// Answer of `GET` and `POST /api/controls`.
#[derive(Clone, Debug, Serialize)]
pub struct ControlsAnswer {
    /// Whether a control may be changed now.
    pub may_change: bool,
    /// Why not, in words.
    pub why_not: Option<&'static str>,
    /// Why no pairs come; `None` if all is well.
    pub problem: Option<String>,
    /// Left and right; empty without controls.
    pub cameras: Vec<ShownCamera>,
    /// What was set; `None` for `GET`.
    pub line: Option<String>,
}

/// Answer of `GET /api/cameras`: a pair against the limits of `pb3dp cameras check`.
#[derive(Clone, Debug, Serialize)]
pub struct CameraCheck {
    /// The pair.
    pub sequence: u64,
    /// Middle of its left exposure.
    pub time_ms: f64,
    /// Middle of the right exposure minus middle of the left one.
    pub skew_ms: f64,
    /// The same, of the worst pair that is kept; about a second.
    pub skew_worst_ms: f64,
    /// Exposure, sharpness and vertical alignment.
    pub findings: Vec<Finding>,
}
