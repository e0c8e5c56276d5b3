//! Commissioning records: which steps of `pb3dp arm test` an arm has passed, when, and which arm that was. A run checks them before arms
//! that are not emulated move faster, or resume with less care, than on their first run.

mod tested;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result, bail};
use pb3dp_arm_pa10::arm::{ArmMonitor, ArmSnapshot};
use pb3dp_arm_pa10_protocol::codec::StatusSignals;
use pb3dp_cell::parts::ArmChoice;
use pb3dp_record::text_file::read_text;
use pb3dp_record::unique_json;
use pb3dp_setup::setup::{ArmSetup, Setup};
use serde::{Deserialize, Serialize};

pub use self::tested::{GatewaySettings, SetupSettings};

/// A passed step counts for this many days. Chosen: a cable or a brake that wears out goes unnoticed for at most a quarter of a year; half
/// would ask for the 20 minutes of the checklist every six weeks, double would leave half a year.
pub const VALID_DAYS: u64 = 90;

/// Version of the file format.
const FORMAT: u32 = 2;

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
    /// Settings of the setup with which the steps were passed.
    setup: SetupSettings,
    /// Settings of the gateway with which the steps were passed.
    gateway: GatewaySettings,
    /// By the name of the step: when it was passed, UTC.
    steps: BTreeMap<String, String>,
}

/// The version of a record of any format.
#[derive(Debug, Deserialize)]
struct Version {
    format: u32,
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
    pub fn of(arm_number: u8, snapshot: &ArmSnapshot) -> Result<Self> {
        let gateway = snapshot.gateway.as_ref().context("the arm has no gateway that identifies it")?;
        let limits = snapshot.limits.iter().map(|limits| {
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
        let facts = |of: &Self| {
            let (number, axes) = (of.arm_number.to_string(), of.eeprom_deg.len().to_string());
            let names = ["the arm number", "the gateway", "the geometry", "the number of axes"];
            names.into_iter().zip([number, of.gateway.clone(), of.geometry.clone(), axes])
        };
        if let Some(((name, old), (_, new))) = facts(self).zip(facts(found)).find(|(old, new)| old != new) {
            return Some(format!("{name} is {new}, recorded {old}"));
        }
        let mut axes = self.eeprom_deg.iter().zip(&found.eeprom_deg).enumerate();
        axes.find_map(|(axis, (old, new))| {
            let is_same = old.iter().zip(new).all(|(old, new)| (old - new).abs() <= SAME_DEG);
            (!is_same).then(|| format!("axis {} has EEPROM limits of {new:?} degrees, recorded {old:?}", axis + 1))
        })
    }
}

impl CommissioningRecord {
    /// An empty record of a connected arm; its limits must have been read.
    ///
    /// # Errors
    /// What the arm has not reported.
    pub fn of(choice: ArmChoice, arm: &ArmSetup, snapshot: &ArmSnapshot) -> Result<Self> {
        let gateway = snapshot.gateway.as_ref().context("the arm has no gateway that identifies it")?;
        Ok(Self {
            format: FORMAT,
            arm: choice.name().to_owned(),
            fingerprint: Fingerprint::of(arm_number(arm), snapshot)?,
            setup: SetupSettings::of(arm),
            gateway: GatewaySettings::of(gateway),
            steps: BTreeMap::new(),
        })
    }

    /// The record in a file.
    ///
    /// # Errors
    /// A file that cannot be read, is no such record, or has another format.
    pub fn load(path: &Path) -> Result<Self> {
        let old = || format!("{}: its format is too old and does not state the tested settings", path.display());
        Self::read(path)?.with_context(old)
    }

    /// The record in a file; `None` if its format is older than [`FORMAT`].
    fn read(path: &Path) -> Result<Option<Self>> {
        let text = read_text(path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let no_record = || format!("{}: no record", path.display());
        let value = unique_json::from_str(&text).with_context(no_record)?;
        let Version { format } = Version::deserialize(&value).with_context(no_record)?;
        match format {
            ..FORMAT => Ok(None),
            FORMAT => Self::deserialize(value).map(Some).with_context(no_record),
            _ => bail!("{}: format {format}, this program reads {FORMAT}", path.display()),
        }
    }

    /// This empty record with the steps of the one in a file, if that one is of the same arm and was passed with the same settings.
    /// Writes nothing.
    ///
    /// # Errors
    /// A file that cannot be read, is no such record, or has a newer format.
    pub fn continued(self, path: &Path) -> Result<Self> {
        let exists = path.try_exists().with_context(|| format!("{}: cannot be read", path.display()))?;
        let old = if exists { Self::read(path)? } else { None };
        let steps = old.filter(|old| {
            let is_same_arm = old.arm == self.arm && old.fingerprint.difference(&self.fingerprint).is_none();
            is_same_arm && old.setup.difference(&self.setup).or(old.gateway.difference(&self.gateway)).is_none()
        });
        Ok(Self { steps: steps.map(|old| old.steps).unwrap_or_default(), ..self })
    }

    /// Writes the record to the disk; an interrupted write leaves the old one.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let new = path.with_extension("new");
        let text = serde_json::to_string_pretty(self)? + "\n";
        let write = || {
            let mut file = File::create(&new)?;
            file.write_all(text.as_bytes())?;
            // A name that points to no content yet would lose the record in a power failure.
            file.sync_all()?;
            std::fs::rename(&new, path)?;
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
            File::open(folder)?.sync_all()
        };
        write().with_context(|| format!("{}: cannot be written", path.display()))
    }

    /// Removes the earlier pass of a step from the record and its file. The step may begin only afterwards, so that nothing that interrupts
    /// it leaves an earlier pass.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn begin(&mut self, step: &str, path: &Path) -> Result<()> {
        self.steps.remove(step);
        self.save(path).context("the commissioning record")
    }

    /// Notes in the record and its file that a step was passed.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn pass(&mut self, step: &str, date: String, path: &Path) -> Result<()> {
        self.steps.insert(step.to_owned(), date);
        self.save(path).context("the commissioning record")
    }

    /// The record with the measured sources of the signals.
    #[must_use]
    pub fn with_signals(self, signals: &StatusSignals) -> Self {
        Self { setup: self.setup.with_signals(signals), ..self }
    }

    /// Why the record does not permit motion of this arm with these settings now; `None` if it does.
    pub fn doubt(
        &self,
        (arm, settings): (&str, &SetupSettings),
        has_interlock: bool,
        now: SystemTime,
    ) -> Option<String> {
        if self.arm != arm {
            return Some(format!("it is the record of {}", self.arm));
        }
        if let Some(difference) = self.setup.difference(settings) {
            return Some(difference);
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

/// Checks, before a port opens, that every signal of both arms is noticed; returns the records that the setup needs.
///
/// # Errors
/// A signal that would not be noticed, or an arm without a valid record for the settings that need one.
pub fn check_arms(setup: &Setup, now: SystemTime) -> Result<Vec<NeededRecord>> {
    [&setup.rig.arms.vs, &setup.rig.arms.tc].into_iter().try_for_each(ArmSetup::check_signals)?;
    needed_records(setup, now)
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
    arm.link.number().map_or(0, |number| number.0)
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
        let Some(path) = &arm.commissioning_record else {
            bail!("{key} is not set; name a file there, then {remedy}");
        };
        let record = CommissioningRecord::load(path).with_context(|| format!("{key} = {path:?}; {remedy}"))?;
        match record.doubt((choice.name(), &SetupSettings::of(arm)), has_interlock, now) {
            Some(doubt) => bail!("{key} = {path:?}: {doubt}; {remedy}"),
            None => Ok(Self { arm: choice.name(), arm_number: arm_number(arm), key, path: path.clone(), record }),
        }
    }

    /// Checks that this is the record of the connected arm and of the settings of its gateway; its brakes are still closed.
    ///
    /// # Errors
    /// The first difference.
    pub fn check(&self, monitors: &[(&'static str, ArmMonitor)]) -> Result<()> {
        let Self { arm, key, path, record, .. } = self;
        let monitor = monitors.iter().find(|(name, _)| name == arm);
        let (_, monitor) = monitor.with_context(|| format!("{arm} has no link"))?;
        let snapshot = monitor.snapshot();
        let found = Fingerprint::of(self.arm_number, &snapshot)?;
        if let Some(difference) = record.fingerprint.difference(&found) {
            bail!(
                "{arm} may not move: {} is the record of another arm: {difference}; run `pb3dp arm test --move` again, or correct {key}",
                path.display()
            );
        }
        let gateway = snapshot.gateway.as_ref().context("the arm has no gateway that identifies it")?;
        if let Some(difference) = record.gateway.difference(&GatewaySettings::of(gateway)) {
            bail!(
                "{arm} may not move: {}: {difference}; run `pb3dp arm test --move` again, or correct the file of the gateway",
                path.display()
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::tested::tests::{gateway_settings, setup_settings};
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

    /// The record of an arm that has passed no step.
    fn empty() -> CommissioningRecord {
        CommissioningRecord {
            format: FORMAT,
            arm: "vs-robot".to_owned(),
            fingerprint: fingerprint(),
            setup: setup_settings(),
            gateway: gateway_settings(),
            steps: BTreeMap::new(),
        }
    }

    fn record(passed: &[&str]) -> CommissioningRecord {
        let mut record = empty();
        record.steps.extend(passed.iter().map(|step| ((*step).to_owned(), DATE.to_owned())));
        record
    }

    fn days_later(days: u64) -> SystemTime {
        humantime::parse_rfc3339(DATE).unwrap() + Duration::from_secs(days * 24 * 3600)
    }

    #[test]
    fn a_record_expires_and_needs_every_step() {
        let whole = record(&STEPS);
        assert_eq!(whole.doubt(("vs-robot", &setup_settings()), false, days_later(VALID_DAYS)), None);
        let doubt = |record: &CommissioningRecord, interlock, days| {
            record.doubt(("vs-robot", &setup_settings()), interlock, days_later(days)).unwrap_or_default()
        };
        assert!(doubt(&whole, false, VALID_DAYS + 1).contains("more than 90 days ago"));
        assert!(doubt(&whole, true, 1).contains("interlock was not passed"), "two real arms stop each other");
        assert_eq!(doubt(&record(&[&STEPS[..], &[INTERLOCK]].concat()), true, 1), "");
        assert!(doubt(&record(&STEPS[1..]), false, 1).contains("comms was not passed"));
        let before = humantime::parse_rfc3339(DATE).unwrap() - Duration::from_secs(60);
        assert!(whole.doubt(("vs-robot", &setup_settings()), false, before).unwrap().contains("in the future"));
        assert!(
            whole.doubt(("tc-robot", &setup_settings()), false, days_later(1)).unwrap().contains("record of vs-robot")
        );
    }

    #[test]
    fn another_arm_or_another_setting_begins_a_new_record() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vs.json");
        assert_eq!(empty().continued(&path).unwrap(), empty(), "there is no file");
        record(&STEPS).save(&path).unwrap();
        assert_eq!(empty().continued(&path).unwrap(), record(&STEPS));
        let mut other_arm = empty();
        other_arm.fingerprint.eeprom_deg[2] = [-170.0, 177.0];
        let other_signals = empty().with_signals(&StatusSignals::UNKNOWN);
        let mut other_gateway = empty();
        other_gateway.gateway = serde_json::from_value({
            let mut value = serde_json::to_value(gateway_settings()).unwrap();
            value["brake_us"] = 300_000.into();
            value
        })
        .unwrap();
        for other in [other_arm, other_signals, other_gateway] {
            assert_eq!(other.clone().continued(&path).unwrap(), other);
        }
    }

    /// The e-stop on another bit, or a dead-man switch that the setup calls absent, was not tested.
    #[test]
    fn steps_that_were_passed_with_other_signals_count_for_nothing() {
        let whole = record(&STEPS);
        let found = setup_settings().with_signals(&StatusSignals::UNKNOWN);
        let doubt = whole.doubt(("vs-robot", &found), false, days_later(1)).unwrap();
        assert!(
            doubt.starts_with("signals.") && doubt.contains("is \"unknown\", its steps were passed with"),
            "{doubt}"
        );
    }

    #[test]
    fn an_old_record_is_refused_and_a_new_one_replaces_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vs.json");
        std::fs::write(&path, "{ \"format\": 1, \"arm\": \"vs-robot\", \"steps\": {}, \"signals\": {} }").unwrap();
        let old = CommissioningRecord::load(&path).unwrap_err().to_string();
        assert!(old.contains("format is too old and does not state the tested settings"), "{old}");
        assert_eq!(empty().continued(&path).unwrap(), empty());
        for (text, part) in [("{ \"format\": 3 }", "format 3, this program reads 2"), ("{", "no record")] {
            std::fs::write(&path, text).unwrap();
            let refused = format!("{:#}", empty().continued(&path).unwrap_err());
            assert!(refused.contains(part), "{refused}");
        }
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
    #[test]
    fn a_step_that_has_begun_has_no_earlier_pass_on_the_disk() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vs.json");
        let passed = |step: &str| CommissioningRecord::load(&path).unwrap().steps.contains_key(step);
        let mut record = empty().continued(&path).unwrap();
        assert!(!path.exists(), "nothing has begun");
        for step in ["comms", "e-stop"] {
            record.begin(step, &path).unwrap();
            record.pass(step, DATE.to_owned(), &path).unwrap();
        }
        assert!(passed("comms") && passed("e-stop"));
        // Whatever ends this program now: no later call is needed.
        let mut again = empty().continued(&path).unwrap();
        assert!(passed("e-stop"), "it has not begun yet");
        again.begin("e-stop", &path).unwrap();
        assert!(passed("comms") && !passed("e-stop"));
        std::fs::remove_dir_all(folder.path()).unwrap();
        assert!(again.begin("comms", &path).is_err(), "a step whose pass cannot be removed does not begin");
    }
}
