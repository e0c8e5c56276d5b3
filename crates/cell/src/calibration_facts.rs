//! What a calibration file states about itself, for pages and reports.

use pb3dp_record::calibration_files::Judgement;
use serde::Serialize;

/// Origin and quality of a calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibrationFacts {
    /// Table of the setup that names it: `camera` or `mounts`.
    pub table: &'static str,
    /// Its files.
    pub source: String,
    /// When it was made, RFC 3339; `None` if the file does not state it.
    pub date: Option<String>,
    /// Results of its gates; empty if the file states none.
    pub gates: Vec<GateFacts>,
}

/// Result of a gate when the calibration was made.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GateFacts {
    /// Name with the unit: `held_out_rms_px`.
    pub name: String,
    /// Measured value.
    pub measured: f64,
    /// Good up to this value.
    pub good: f64,
    /// Refused if worse than this value.
    pub refused: f64,
    /// `good`, `fair` or `refused`.
    pub grade: String,
}

impl CalibrationFacts {
    /// The facts of a calibration; most formats state no quality.
    pub fn of(table: &'static str, source: &str, judgement: Option<&Judgement>) -> Self {
        let gates = judgement.iter().flat_map(|judgement| &judgement.gates).map(|gate| GateFacts {
            name: gate.name.clone(),
            measured: gate.measured,
            good: gate.good,
            refused: gate.refused,
            grade: gate.grade.clone(),
        });
        Self {
            table,
            source: source.to_owned(),
            date: judgement.map(|judgement| judgement.date.clone()),
            gates: gates.collect(),
        }
    }
}
