//! Requirements on a calibration before arms move with it.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result};
use pb3dp_geometry::ImageSize;
use pb3dp_record::calibration_files::{Judgement, StereoCalibration, load_stereo_for, parse_stereo};

use super::super::layers::built_in;
use super::super::load::Checker;

/// The table of a setup that names the calibration of the cameras.
pub const CAMERA_TABLE: &str = "camera";
/// Waives the age of a calibration.
pub const AGE: &str = "age";
/// Waives the check that a calibration belongs to the connected cameras.
pub const CAMERAS: &str = "cameras";

const DAY: Duration = Duration::from_secs(86_400);

/// Default age limit, days.
const AGE_MAX_DAYS: f64 = 180.0;

/// A gate that a person accepts although it failed, until a day: `rows_px until 2027-01-31`.
#[derive(Clone, Debug, PartialEq)]
pub struct Waiver {
    /// Name of the gate, [`AGE`] or [`CAMERAS`].
    pub gate: String,
    /// Last day, in UTC, as YYYY-MM-DD.
    pub last_day: String,
}

impl Waiver {
    /// Reads a waiver; `None` if it has another form.
    pub fn parse(text: &str) -> Option<Self> {
        let (gate, day) = text.split_once(" until ")?;
        let (gate, last_day) = (gate.trim().to_owned(), day.trim().to_owned());
        humantime::parse_rfc3339(&format!("{last_day}T00:00:00Z")).ok()?;
        Some(Self { gate, last_day })
    }
}

/// A calibration of a setup, with the statements in its file.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationInUse {
    /// The table of the setup that names it: `camera` or `mounts`.
    pub table: &'static str,
    /// Its files, for messages and reports.
    pub source: String,
    /// Statements on its origin and quality; most formats have none.
    pub judgement: Option<Judgement>,
    /// Waived gates.
    pub waived: Vec<Waiver>,
    /// Age limit.
    pub age_max: Duration,
    /// Assumptions of the reader that can be wrong.
    pub warnings: Vec<String>,
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
        let gates = judgement.iter().flat_map(|judgement| &judgement.gates).map(|gate| gate.name.as_str());
        let known: Vec<&str> = gates.chain([AGE, CAMERAS]).collect();
        let mut waivers = Vec::new();
        for text in waived.unwrap_or_default() {
            match Waiver::parse(text) {
                Some(waiver) if known.contains(&waiver.gate.as_str()) => waivers.push(waiver),
                Some(Waiver { gate, .. }) => check.refuse(format!(
                    "{table}.waived_gates: {gate:?} is no gate of {source}: {} can be waived",
                    known.join(", ")
                )),
                None => check.refuse(format!(
                    "{table}.waived_gates: {text:?} has no last day; write for example \"{AGE} until 2027-01-31\""
                )),
            }
        }
        Self { table, source, judgement, waived: waivers, age_max: DAY.mul_f64(age_max_days), warnings: Vec::new() }
    }

    /// Whether the setup waives this gate.
    pub fn waives(&self, gate: &str) -> bool {
        self.waived.iter().any(|waiver| waiver.gate == gate)
    }

    /// The assumptions of the reader, with key and file.
    pub fn doubts(&self) -> impl Iterator<Item = String> {
        self.warnings.iter().map(|warning| format!("{}.calibration: {}: {warning}", self.table, self.source))
    }

    /// Text for reports: file, date, refusals and waivers, or the assumptions of the reader.
    pub fn text(&self) -> String {
        let Some(judgement) = &self.judgement else {
            let nothing = format!("{}, which says nothing of its worth", self.source);
            return [std::slice::from_ref(&nothing), &self.warnings].concat().join("; ");
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
///
/// # Errors
/// Unusable files, with the remedy for those that leave something unstated: setups have no options for calibrations.
pub(super) fn load_files(files: &[PathBuf], size: ImageSize) -> Result<StereoCalibration> {
    let built_in = files.first().and_then(|file| Some((file, built_in::text_at(file.to_str()?)?)));
    let loaded = match (built_in, files.len()) {
        (Some((name, text)), 1) => parse_stereo(name, text, Some(size)),
        _ => load_stereo_for(files, size),
    };
    let asks_for_option = loaded.as_ref().err().is_some_and(|error| error.to_string().contains("--calib-"));
    loaded.context(match asks_for_option {
        true => {
            "camera.calibration: a setup states nothing about its calibration; `pb3dp calibrate convert` with the option writes a file that \
             states everything"
        }
        false => "camera.calibration",
    })
}

/// A measured number with four digits.
pub fn rounded(value: f64) -> String {
    let digits = (3.0 - value.abs().max(1e-9).log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_waiver_without_a_day_is_none() {
        for text in ["age", "age until", "age until tomorrow", "age until 2027-02-30", "age 2027-01-31"] {
            assert_eq!(Waiver::parse(text), None, "{text}");
        }
    }
}
