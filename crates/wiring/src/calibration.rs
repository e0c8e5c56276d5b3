//! Checks calibrations before arms move: a failed, outdated or foreign calibration is refused unless the setup waives the failed check.

use std::time::{Duration, SystemTime};

use anyhow::{Result, bail};
use pb3dp_camera_v4l2::controls::Focus;
use pb3dp_record::calibration_files::{CameraIdentity, Judgement};
use pb3dp_setup::setup::{AGE, CalibrationInUse, Waiver, rounded};

const DAY: Duration = Duration::from_secs(86_400);
/// A waiver ends at most this many days later, as the commissioning record of an arm does.
const WAIVED_MAX_DAYS: u32 = 90;

/// Checks the quality data in calibration files.
///
/// # Errors
/// The first calibration that failed or is too old and is not waived, with the remedy.
pub(super) fn look_at(calibrations: &[CalibrationInUse], now: SystemTime) -> Result<()> {
    for calibration in calibrations {
        look_at_waivers(calibration, now)?;
        calibration.doubts().for_each(|doubt| tracing::warn!("{doubt}"));
        match &calibration.judgement {
            Some(judgement) => {
                look_at_gates(calibration, judgement)?;
                look_at_age(calibration, judgement, now)?;
            }
            None => tracing::warn!(
                "{}.calibration: {} states no quality, so the error of the estimates is unknown; `pb3dp calibrate` writes the quality",
                calibration.table,
                calibration.source
            ),
        }
    }
    Ok(())
}

/// A waiver holds to the end of its day, so that somebody decides again.
fn look_at_waivers(calibration: &CalibrationInUse, now: SystemTime) -> Result<()> {
    for Waiver { gate, last_day } in &calibration.waived {
        let ends = humantime::parse_rfc3339(&format!("{last_day}T00:00:00Z"))? + DAY;
        let reason = if ends <= now {
            "the day has passed".to_owned()
        } else if ends > now + DAY * (WAIVED_MAX_DAYS + 1) {
            format!("the day is more than {WAIVED_MAX_DAYS} days ahead")
        } else {
            continue;
        };
        bail!(
            "{}.waived_gates: \"{gate} until {last_day}\": {reason}; calibrate again, or decide again and set a day within {WAIVED_MAX_DAYS} \
             days",
            calibration.table
        );
    }
    Ok(())
}

fn look_at_gates(calibration: &CalibrationInUse, judgement: &Judgement) -> Result<()> {
    let table = calibration.table;
    for gate in judgement.refusals() {
        let found =
            format!("{} of {} was {}, limit {}", gate.name, calibration.source, rounded(gate.measured), gate.refused);
        if !calibration.waives(&gate.name) {
            bail!(
                "{found}: the calibration failed this gate; calibrate again (gates: docs/calibration.md), or waive the gate with \
                 {table}.waived_gates = [\"{} until YYYY-MM-DD\"] if you know why the value is acceptable",
                gate.name
            );
        }
        tracing::warn!("{found}: waived by {table}.waived_gates");
    }
    Ok(())
}

fn look_at_age(calibration: &CalibrationInUse, judgement: &Judgement, now: SystemTime) -> Result<()> {
    let (table, source) = (calibration.table, &calibration.source);
    let days = |time: Duration| time.as_secs_f64() / DAY.as_secs_f64();
    let found = match humantime::parse_rfc3339(&judgement.date) {
        Err(error) => format!("the date of {source}, {:?}, cannot be read: {error}", judgement.date),
        // Clocks of two computers may differ by some hours.
        Ok(made) => match now.duration_since(made) {
            Err(ahead) if ahead.duration() > DAY => format!(
                "{source} is dated {}, {:.0} days in the future: one of the clocks is wrong",
                judgement.date,
                days(ahead.duration())
            ),
            Ok(age) if age > calibration.age_max => format!(
                "{source} is dated {}, {:.0} days old, limit {:.0} ({table}.calibration_age_max_days)",
                judgement.date,
                days(age),
                days(calibration.age_max)
            ),
            _ => return Ok(()),
        },
    };
    if !calibration.waives(AGE) {
        bail!("{found}: calibrate again, or waive it with {table}.waived_gates = [\"{AGE} until YYYY-MM-DD\"]");
    }
    tracing::warn!("{found}: waived by {table}.waived_gates");
    Ok(())
}

/// Converts to the type used in calibration files.
pub fn identity(camera: pb3dp_camera_v4l2::CameraIdentity) -> CameraIdentity {
    let focus = match camera.focus {
        Focus::Fixed(value) => Some(value),
        Focus::ByHand | Focus::Automatic => None,
    };
    CameraIdentity { serial: camera.serial, place: Some(camera.place).filter(|place| !place.is_empty()), focus }
}

#[cfg(test)]
pub(super) mod tests {
    use pb3dp_record::calibration_files::JudgedGate;

    use super::*;

    pub fn camera(serial: Option<&str>, place: &str, focus: Option<i32>) -> CameraIdentity {
        CameraIdentity { serial: serial.map(str::to_owned), place: Some(place.to_owned()), focus }
    }

    pub fn cameras() -> [CameraIdentity; 2] {
        [camera(Some("A0"), "usb-1", Some(30)), camera(None, "usb-2", None)]
    }

    pub fn in_use(waived: &[&str]) -> CalibrationInUse {
        let gate = |name: &str, measured: f64, grade: &str| JudgedGate {
            name: name.to_owned(),
            measured,
            good: 0.3,
            refused: 0.5,
            grade: grade.to_owned(),
        };
        let judgement = Judgement {
            date: "2026-11-01T10:00:00Z".to_owned(),
            tool: "pb3dp-calibrate 0.1.0".to_owned(),
            source: "15 views".to_owned(),
            cameras: cameras(),
            numbers: Vec::new(),
            covariance: None,
            gates: vec![gate("rows_px", 0.1, "good"), gate("reprojection_rms_px", 0.71234, "refused")],
        };
        CalibrationInUse {
            table: "camera",
            source: "head.toml".to_owned(),
            judgement: Some(judgement),
            waived: waived.iter().map(|gate| Waiver::parse(&format!("{gate} until 2026-12-01")).unwrap()).collect(),
            age_max: 10 * DAY,
            warnings: Vec::new(),
        }
    }

    fn at(date: &str) -> SystemTime {
        humantime::parse_rfc3339(date).unwrap()
    }

    fn refusal(waived: &[&str], date: &str) -> Option<String> {
        look_at(&[in_use(waived)], at(date)).err().map(|error| error.to_string())
    }

    #[test]
    fn a_calibration_that_was_refused_is_refused_until_its_gate_is_waived() {
        let text = refusal(&[], "2026-11-02T10:00:00Z").unwrap();
        for part in ["reprojection_rms_px of head.toml was 0.7123, limit 0.5", "camera.waived_gates"] {
            assert!(text.contains(part), "{text}");
        }
        assert!(refusal(&["rows_px"], "2026-11-02T10:00:00Z").is_some());
        assert_eq!(refusal(&["reprojection_rms_px"], "2026-11-02T10:00:00Z"), None);
    }

    #[test]
    fn a_waiver_holds_to_the_end_of_its_day_and_is_given_for_a_quarter_at_most() {
        let waived = |date: &str| refusal(&["rows_px", "reprojection_rms_px"], date).unwrap_or_default();
        for (date, part) in [
            ("2026-12-02T00:00:00Z", "\"rows_px until 2026-12-01\": the day has passed; calibrate again"),
            ("2026-09-01T00:00:00Z", "more than 90 days ahead"),
        ] {
            assert!(
                waived(date).starts_with("camera.waived_gates: ") && waived(date).contains(part),
                "{}",
                waived(date)
            );
        }
        // Waivers hold; the calibration is too old, or of the future.
        for date in ["2026-12-01T23:59:59Z", "2026-09-02T00:00:00Z"] {
            assert!(!waived(date).contains("waived_gates: "), "{}", waived(date));
        }
    }

    #[test]
    fn a_calibration_that_is_too_old_or_of_the_future_is_refused() {
        let waived = ["reprojection_rms_px"];
        assert_eq!(refusal(&waived, "2026-11-11T09:00:00Z"), None);
        let text = refusal(&waived, "2026-11-13T10:00:00Z").unwrap();
        assert!(text.contains("12 days old, limit 10 (camera.calibration_age_max_days)"), "{text}");
        assert_eq!(refusal(&["reprojection_rms_px", "age"], "2026-11-13T10:00:00Z"), None);
        // Clocks may differ, but not by days.
        assert_eq!(refusal(&waived, "2026-10-31T15:00:00Z"), None);
        assert!(refusal(&waived, "2026-10-20T10:00:00Z").is_some_and(|text| text.contains("clocks is wrong")));
        let mut undated = in_use(&waived);
        undated.judgement.as_mut().unwrap().date = "yesterday".to_owned();
        let text = look_at(&[undated], at("2026-11-02T10:00:00Z")).unwrap_err().to_string();
        assert!(text.contains("\"yesterday\", cannot be read"), "{text}");
    }
}
