//! Commissioning records: which steps of `pb3dp arm test` an arm has passed, when, and which arm that was. A run checks them before arms
//! that are not emulated move faster, or resume with less care, than on their first run.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result, bail};
use pb3dp_arm_pa10::arm::{ArmMonitor, ArmSnapshot};
use pb3dp_arm_pa10_protocol::codec::{Signal, StatusSignals};
use pb3dp_cell::parts::ArmChoice;
use pb3dp_record::text_file::read_text;
use pb3dp_setup::setup::{ArmLink, ArmSetup, Setup};
use serde::{Deserialize, Serialize};

/// A passed step counts for this many days. Chosen: a cable or a brake that wears out goes unnoticed for at most a quarter of a year; half
/// would ask for the 20 minutes of the checklist every six weeks, double would leave half a year.
pub const VALID_DAYS: u64 = 90;

/// Version of the file format.
const FORMAT: u32 = 1;

/// Steps that a record must contain for each arm; `interlock` in addition if the other arm is not emulated either.
const STEPS: [&str; 5] = ["comms", "jog", "e-stop", "cable", "kill"];
const INTERLOCK: &str = "interlock";

/// Largest difference of a limit in the EEPROM to the recorded one, degrees: the record has four decimals.
const SAME_DEG: f64 = 0.01;

/// Record of one arm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommissioningRecord {
    format: u32,
    arm: String,
    fingerprint: Fingerprint,
    /// By the name of the step: when it was passed, UTC.
    steps: BTreeMap<String, String>,
    /// By the key of the signal: how it is noticed, as `pb3dp arm signals` has measured it.
    #[serde(default)]
    signals: BTreeMap<String, String>,
}

/// Properties that tell one arm from another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fingerprint {
    /// Number of the arm in every frame.
    arm_number: u8,
    /// Name and version that the gateway reports.
    gateway: String,
    /// Geometry that the gateway reports.
    geometry: String,
    /// Lower and upper limit of each axis in the EEPROM of its controller, degrees.
    eeprom_deg: Vec<[f64; 2]>,
}

impl Fingerprint {
    /// The fingerprint of a connected arm; its limits must have been read.
    ///
    /// # Errors
    /// What the arm has not reported.
    pub fn of(arm_number: u8, seen: &ArmSnapshot) -> Result<Self> {
        let gateway = seen.gateway.as_ref().context("the arm has no gateway that identifies it")?;
        let limits = seen.limits.iter().map(|limits| {
            let limits = limits.as_ref().context("the limits in the EEPROM of the controller were not read")?;
            Ok([limits.lower_rad, limits.upper_rad].map(|rad| (rad.to_degrees() * 1e4).round() / 1e4))
        });
        Ok(Self {
            arm_number,
            gateway: gateway.firmware.as_str().to_owned(),
            geometry: gateway.geometry.to_string(),
            eeprom_deg: limits.collect::<Result<_>>()?,
        })
    }

    /// The first difference, as recorded and as found.
    fn difference(&self, found: &Self) -> Option<String> {
        let text = |name: &str, old: &dyn std::fmt::Display, new: &dyn std::fmt::Display| {
            Some(format!("{name} is {new}, recorded {old}"))
        };
        if self.arm_number != found.arm_number {
            return text("the arm number", &self.arm_number, &found.arm_number);
        }
        if self.gateway != found.gateway {
            return text("the gateway", &self.gateway, &found.gateway);
        }
        if self.geometry != found.geometry {
            return text("the geometry", &self.geometry, &found.geometry);
        }
        if self.eeprom_deg.len() != found.eeprom_deg.len() {
            return text("the number of axes", &self.eeprom_deg.len(), &found.eeprom_deg.len());
        }
        let mut axes = self.eeprom_deg.iter().zip(&found.eeprom_deg).enumerate();
        axes.find_map(|(axis, (old, new))| {
            let is_same = old.iter().zip(new).all(|(old, new)| (old - new).abs() <= SAME_DEG);
            (!is_same).then(|| format!("axis {} has EEPROM limits of {new:?} degrees, recorded {old:?}", axis + 1))
        })
    }
}

impl CommissioningRecord {
    /// An empty record of this arm.
    pub fn new(arm: ArmChoice, fingerprint: Fingerprint) -> Self {
        Self {
            format: FORMAT,
            arm: arm.name().to_owned(),
            fingerprint,
            steps: BTreeMap::new(),
            signals: BTreeMap::new(),
        }
    }

    /// The record in a file.
    ///
    /// # Errors
    /// A file that cannot be read, or is no such record.
    pub fn load(path: &Path) -> Result<Self> {
        let text = read_text(path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let record: Self = serde_json::from_str(&text).with_context(|| format!("{}: no record", path.display()))?;
        if record.format != FORMAT {
            bail!("{}: format {}, this program reads {FORMAT}", path.display(), record.format);
        }
        Ok(record)
    }

    /// Writes the record; an interrupted write leaves the old one.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let new = path.with_extension("new");
        let text = serde_json::to_string_pretty(self)? + "\n";
        let written = std::fs::write(&new, text).and_then(|()| std::fs::rename(&new, path));
        written.with_context(|| format!("{}: cannot be written", path.display()))
    }

    /// The record with the results of a new test: passed steps are dated, failed ones are removed; others stay if it is the same arm.
    #[must_use]
    pub fn with_results<'a>(self, new: Self, results: impl Iterator<Item = (&'a str, bool)>, date: &str) -> Self {
        let is_same = self.arm == new.arm && self.fingerprint.difference(&new.fingerprint).is_none();
        let mut steps = if is_same { self.steps } else { new.steps };
        for (step, has_passed) in results {
            match has_passed {
                true => drop(steps.insert(step.to_owned(), date.to_owned())),
                false => drop(steps.remove(step)),
            }
        }
        let signals = if is_same { self.signals } else { new.signals };
        Self { steps, signals, ..new }
    }

    /// The record with the measured sources of the signals.
    #[must_use]
    pub fn with_signals(self, signals: &StatusSignals) -> Self {
        let texts = Signal::ALL.iter().map(|signal| (signal.key().to_owned(), signals.get(*signal).to_string()));
        Self { signals: texts.collect(), ..self }
    }

    /// Why the record does not permit motion of this arm now; `None` if it does.
    pub fn doubt(&self, arm: &str, has_interlock: bool, now: SystemTime) -> Option<String> {
        if self.arm != arm {
            return Some(format!("it is the record of {}", self.arm));
        }
        let interlock = has_interlock.then_some(INTERLOCK);
        STEPS.into_iter().chain(interlock).find_map(|step| {
            let Some(date) = self.steps.get(step) else { return Some(format!("the step {step} was not passed")) };
            let Ok(at) = humantime::parse_rfc3339_weak(date) else {
                return Some(format!("the step {step} has no valid date ({date})"));
            };
            match now.duration_since(at) {
                Ok(age) if age <= Duration::from_secs(VALID_DAYS * 24 * 3600) => None,
                Ok(_) => Some(format!("the step {step} was passed on {date}, more than {VALID_DAYS} days ago")),
                Err(_) => Some(format!("the step {step} has a date in the future ({date})")),
            }
        })
    }
}

/// The arms of a setup that are not emulated.
pub fn real_arms(setup: &Setup) -> Vec<ArmChoice> {
    [ArmChoice::Vs, ArmChoice::Tc].into_iter().filter(|choice| !choice.of(setup).link.is_toy()).collect()
}

/// The records that a setup needs, of arms that are not emulated; none if no setting needs one. Opens no port.
///
/// # Errors
/// The settings that need a record, and the arm that has no valid one.
pub fn needed_records(setup: &Setup, now: SystemTime) -> Result<Vec<NeededRecord>> {
    let (real, settings) = (real_arms(setup), setup.settings_that_need_commissioning());
    if settings.is_empty() {
        return Ok(Vec::new());
    }
    let read = |choice: &ArmChoice| {
        NeededRecord::read(choice.of(setup), *choice, real.len() > 1, now).with_context(|| {
            let name = choice.name();
            format!(
                "{name} is not emulated and may not move with {}: it has no valid commissioning record",
                settings.join(", ")
            )
        })
    };
    real.iter().map(read).collect()
}

/// Number of an arm on its link; 0 without a link.
pub fn arm_number(arm: &ArmSetup) -> u8 {
    arm.link.number().map_or(0, |(number, _)| number.0)
}

/// A valid record, and the arm of the setup that needs it.
#[derive(Clone, Debug)]
pub struct NeededRecord {
    arm: &'static str,
    arm_number: u8,
    key: String,
    path: PathBuf,
    record: CommissioningRecord,
}

impl NeededRecord {
    fn read(arm: &ArmSetup, choice: ArmChoice, has_interlock: bool, now: SystemTime) -> Result<Self> {
        let key = format!("{}.commissioning_record", arm.key);
        let word = if choice == ArmChoice::Vs { "vs" } else { "tc" };
        let remedy = format!("run `pb3dp arm test --arm {word} --move`, or use the values that need no record");
        if matches!(arm.link, ArmLink::Bus(_)) {
            bail!(
                "an arm on a bus has no gateway that `pb3dp arm test` could check; use the values that need no record"
            );
        }
        let Some(path) = &arm.commissioning_record else {
            bail!("{key} is not set; name a file there, then {remedy}");
        };
        let record = CommissioningRecord::load(path).with_context(|| format!("{key} = {path:?}; {remedy}"))?;
        match record.doubt(choice.name(), has_interlock, now) {
            Some(doubt) => bail!("{key} = {path:?}: {doubt}; {remedy}"),
            None => Ok(Self { arm: choice.name(), arm_number: arm_number(arm), key, path: path.clone(), record }),
        }
    }

    /// Checks that this is the record of the connected arm; its brakes are still closed.
    ///
    /// # Errors
    /// The first difference.
    pub fn check(&self, monitors: &[(&'static str, ArmMonitor)]) -> Result<()> {
        let Self { arm, key, path, record, .. } = self;
        let monitor = monitors.iter().find(|(name, _)| name == arm);
        let (_, monitor) = monitor.with_context(|| format!("{arm} has no link"))?;
        let found = Fingerprint::of(self.arm_number, &monitor.snapshot())?;
        if let Some(difference) = record.fingerprint.difference(&found) {
            bail!(
                "{arm} may not move: {} is the record of another arm: {difference}; run `pb3dp arm test --move` again, or correct {key}",
                path.display()
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DATE: &str = "2026-03-01T12:00:00Z";

    fn fingerprint() -> Fingerprint {
        Fingerprint {
            arm_number: 1,
            gateway: "gateway 1".to_owned(),
            geometry: "second-generation".to_owned(),
            eeprom_deg: vec![[-177.0, 177.0]; 7],
        }
    }

    fn record(passed: &[&str]) -> CommissioningRecord {
        let empty = CommissioningRecord::new(ArmChoice::Vs, fingerprint());
        empty.clone().with_results(empty, passed.iter().map(|step| (*step, true)), DATE)
    }

    fn days_later(days: u64) -> SystemTime {
        humantime::parse_rfc3339(DATE).unwrap() + Duration::from_secs(days * 24 * 3600)
    }

    #[test]
    fn a_record_expires_and_needs_every_step() {
        let whole = record(&STEPS);
        assert_eq!(whole.doubt("vs-robot", false, days_later(VALID_DAYS)), None);
        let doubt = |record: &CommissioningRecord, interlock, days| {
            record.doubt("vs-robot", interlock, days_later(days)).unwrap_or_default()
        };
        assert!(doubt(&whole, false, VALID_DAYS + 1).contains("more than 90 days ago"));
        assert!(doubt(&whole, true, 1).contains("interlock was not passed"), "two real arms stop each other");
        assert_eq!(doubt(&record(&[&STEPS[..], &[INTERLOCK]].concat()), true, 1), "");
        assert!(doubt(&record(&STEPS[1..]), false, 1).contains("comms was not passed"));
        let before = humantime::parse_rfc3339(DATE).unwrap() - Duration::from_secs(60);
        assert!(whole.doubt("vs-robot", false, before).unwrap().contains("in the future"));
        assert!(whole.doubt("tc-robot", false, days_later(1)).unwrap().contains("record of vs-robot"));
    }

    #[test]
    fn a_failed_step_leaves_the_record_and_another_arm_begins_a_new_one() {
        let empty = CommissioningRecord::new(ArmChoice::Vs, fingerprint());
        let failed = record(&STEPS).with_results(empty, [("cable", false)].into_iter(), "2026-03-02T12:00:00Z");
        assert!(failed.doubt("vs-robot", false, days_later(1)).unwrap().contains("cable was not passed"));
        let mut other = fingerprint();
        other.eeprom_deg[2] = [-170.0, 177.0];
        let other = CommissioningRecord::new(ArmChoice::Vs, other);
        let new = record(&STEPS).with_results(other, [("jog", true)].into_iter(), DATE);
        assert!(new.doubt("vs-robot", false, days_later(1)).unwrap().contains("comms was not passed"));
    }

    #[test]
    fn each_property_of_the_arm_tells_it_from_another_one() {
        let same = fingerprint();
        assert_eq!(same.difference(&same), None);
        let mut close = fingerprint();
        close.eeprom_deg[6][1] += 0.5 * SAME_DEG;
        assert_eq!(same.difference(&close), None);
        let changes: [fn(&mut Fingerprint); 5] = [
            |other| other.arm_number = 2,
            |other| other.gateway = "gateway 2".to_owned(),
            |other| other.geometry = "first-generation".to_owned(),
            |other| other.eeprom_deg[6][1] += 2.0 * SAME_DEG,
            |other| other.eeprom_deg.truncate(6),
        ];
        for change in changes {
            let mut other = fingerprint();
            change(&mut other);
            assert!(same.difference(&other).is_some(), "{other:?}");
        }
    }

    #[test]
    fn a_record_is_written_and_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vs.json");
        let missing = CommissioningRecord::load(&path).unwrap_err();
        assert!(format!("{missing:#}").contains("cannot be read"), "{missing:#}");
        record(&STEPS).save(&path).unwrap();
        assert_eq!(CommissioningRecord::load(&path).unwrap(), record(&STEPS));
    }
}
