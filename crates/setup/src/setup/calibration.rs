//! Requirements on a calibration before arms move with it.

use std::path::PathBuf;
use std::time::{Duration, SystemTime};

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

/// A waiver expires at most this long after the day on which it is used, days: as the commissioning record of an arm.
pub const WAIVED_MAX_DAYS: u64 = 90;
const DAY: Duration = Duration::from_secs(86_400);

/// Default age limit, days.
const AGE_MAX_DAYS: f64 = 180.0;

/// A gate that a person accepts although it failed, until a day: `rows_px until 2027-01-31`.
#[derive(Clone, Debug, PartialEq)]
pub struct Waiver {
    /// Name of the gate, [`AGE`] or [`CAMERAS`].
    pub gate: String,
    /// Last day, as in the setup.
    pub last_day: String,
    /// End of this day, UTC.
    pub ends: SystemTime,
}

impl Waiver {
    /// Reads a waiver; `None` if it has another form.
    pub fn parse(text: &str) -> Option<Self> {
        let (gate, day) = text.split_once(" until ")?;
        let begins = humantime::parse_rfc3339(&format!("{}T00:00:00Z", day.trim())).ok()?;
        Some(Self { gate: gate.trim().to_owned(), last_day: day.trim().to_owned(), ends: begins + DAY })
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
        Self { table, source, judgement, waived: waivers, age_max: DAY.mul_f64(age_max_days) }
    }

    /// The first waiver that does not hold now, with the reason.
    pub fn refused_waiver(&self, now: SystemTime) -> Option<String> {
        self.waived.iter().find_map(|Waiver { gate, last_day, ends }| {
            let reason = if *ends <= now {
                "the day has passed".to_owned()
            } else if *ends > now + DAY * (WAIVED_MAX_DAYS as u32 + 1) {
                format!("the day is more than {WAIVED_MAX_DAYS} days ahead")
            } else {
                return None;
            };
            Some(format!("{}.waived_gates: \"{gate} until {last_day}\": {reason}", self.table))
        })
    }

    /// Whether the setup waives this gate.
    pub fn waives(&self, gate: &str) -> bool {
        self.waived.iter().any(|waiver| waiver.gate == gate)
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

#[cfg(test)]
mod tests {
    use super::*;

    fn at(date: &str) -> SystemTime {
        humantime::parse_rfc3339(date).unwrap()
    }

    #[test]
    fn a_waiver_holds_to_the_end_of_its_day_and_no_longer_than_a_quarter() {
        let waived = vec![Waiver::parse("age until 2027-01-31").unwrap()];
        let judgement = None;
        let (table, source) = ("camera", String::new());
        let calibration = CalibrationInUse { table, source, judgement, waived, age_max: DAY };
        for (now, expected) in [
            ("2027-01-31T23:00:00Z", None),
            ("2027-02-01T00:00:00Z", Some("the day has passed")),
            ("2026-11-02T00:00:00Z", None),
            ("2026-11-01T00:00:00Z", Some("more than 90 days ahead")),
        ] {
            let found = calibration.refused_waiver(at(now));
            let is_expected = match expected {
                Some(part) => {
                    found.as_ref().is_some_and(|text| text.contains(part) && text.contains("camera.waived_gates"))
                }
                None => found.is_none(),
            };
            assert!(is_expected, "{now}: {found:?}");
        }
    }

    #[test]
    fn a_waiver_without_a_day_is_none() {
        for text in ["age", "age until", "age until tomorrow", "age until 2027-02-30", "age 2027-01-31"] {
            assert_eq!(Waiver::parse(text), None, "{text}");
        }
    }
}
