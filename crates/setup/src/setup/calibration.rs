//! Requirements on a calibration before arms move with it.

use std::path::PathBuf;
use std::time::Duration;

use pb3dp_geometry::ImageSize;
use pb3dp_record::calibration_files::{
    CalibrationFileError, Judgement, StereoCalibration, load_stereo_for, parse_stereo,
};

use super::super::layers::built_in;
use super::super::load::Checker;

/// Waives the age of a calibration.
pub const AGE: &str = "age";
/// Waives the check that a calibration belongs to the connected cameras.
pub const CAMERAS: &str = "cameras";

/// Default age limit, days.
const AGE_MAX_DAYS: f64 = 180.0;

/// A calibration of a setup, with the statements in its file.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationInUse {
    /// The table of the setup that names it: `camera` or `mounts`.
    pub table: &'static str,
    /// Its files, for messages and reports.
    pub source: String,
    /// Statements on its origin and quality; most formats have none.
    pub judgement: Option<Judgement>,
    /// Waived gates: names of gates, [`AGE`] and [`CAMERAS`].
    pub waived: Vec<String>,
    /// Age limit.
    pub age_max: Duration,
}

impl CalibrationInUse {
    /// With the waivers of the setup; the age is in days.
    pub(super) fn new(
        (table, source): (&'static str, String),
        judgement: Option<Judgement>,
        (waived, age_max_days): (Option<&[String]>, Option<f64>),
        check: &mut Checker,
    ) -> Self {
        let age_max_days = age_max_days.unwrap_or(AGE_MAX_DAYS);
        let key = format!("{table}.calibration_age_max_days");
        let age_max_days = check.limited(&key, age_max_days, 1.0..=3650.0);
        let waived = waived.unwrap_or_default().to_vec();
        let gates = judgement.iter().flat_map(|judgement| &judgement.gates).map(|gate| gate.name.as_str());
        let known: Vec<&str> = gates.chain([AGE, CAMERAS]).collect();
        for name in waived.iter().filter(|name| !known.contains(&name.as_str())) {
            check.refuse(format!(
                "{table}.waived_gates: {name:?} is no gate of {source}: {} can be waived",
                known.join(", ")
            ));
        }
        Self { table, source, judgement, waived, age_max: Duration::from_secs_f64(86_400.0 * age_max_days) }
    }

    /// Whether the setup waives this gate.
    pub fn waives(&self, gate: &str) -> bool {
        self.waived.iter().any(|name| name == gate)
    }

    /// Text for reports: file, date, refusals and waivers.
    pub fn text(&self) -> String {
        let Some(judgement) = &self.judgement else {
            return format!("{}, which says nothing of its worth", self.source);
        };
        let refused = judgement
            .refusals()
            .map(|gate| format!("{} was {} ({} allowed), WAIVED", gate.name, rounded(gate.measured), gate.refused));
        let others = [AGE, CAMERAS].into_iter().filter(|gate| self.waives(gate)).map(|gate| format!("{gate} WAIVED"));
        let waivers: Vec<String> = refused.chain(others).collect();
        let worth = if waivers.is_empty() { "all gates passed".to_owned() } else { waivers.join("; ") };
        format!("{}, of {}: {worth}", self.source, judgement.date)
    }
}

/// Reads the files of a calibration; a file may be built in.
pub(super) fn load_files(files: &[PathBuf], size: ImageSize) -> Result<StereoCalibration, CalibrationFileError> {
    let built_in = files.first().and_then(|file| Some((file, built_in::text_at(file.to_str()?)?)));
    match (built_in, files.len()) {
        (Some((name, text)), 1) => parse_stereo(name, text, Some(size)),
        _ => load_stereo_for(files, size),
    }
}

/// A measured number with four digits.
pub fn rounded(value: f64) -> String {
    let digits = (3.0 - value.abs().max(1e-9).log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.digits$}")
}
