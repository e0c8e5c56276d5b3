//! Reading a configuration file: TOML to raw structs, with errors that name the file, the key and what is allowed.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use figment::Figment;
use figment::error::Kind;
use figment::providers::{Format, Toml};
use figment::value::Dict;
use serde::de::DeserializeOwned;

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file can not be read.
    #[error("configuration {file}: can not be read", file = file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// The reason.
        #[source]
        source: std::io::Error,
    },
    /// The file is another kind of configuration.
    #[error("configuration {file}: this is {found}, but {wanted} is needed here", file = file.display())]
    OtherKind {
        /// The file.
        file: PathBuf,
        /// What it is.
        found: FileKind,
        /// What it should be.
        wanted: FileKind,
    },
    /// Keys are unknown, missing or of the wrong type. One line per key.
    #[error("configuration {file}:\n{lines}", file = file.display())]
    Keys {
        /// The file.
        file: PathBuf,
        /// What is wrong, one line per key.
        lines: String,
    },
    /// Values are out of range. One line per key.
    #[error("configuration {file}:\n{lines}", file = file.display())]
    Values {
        /// The file.
        file: PathBuf,
        /// What is wrong, one line per key.
        lines: String,
    },
}

/// What a configuration file is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// Parameters of the estimators, for `pb3dp estimate` and `pb3dp track`.
    Estimator,
    /// A whole setup, for `pb3dp run`.
    Setup,
    /// A gateway, for `pb3dp gateway`.
    Gateway,
    /// One arm, for setups that name it.
    Arm,
}

impl FileKind {
    const ALL: [Self; 4] = [Self::Estimator, Self::Setup, Self::Gateway, Self::Arm];

    /// A table that this kind has, and the others have not.
    fn own_table(self) -> &'static str {
        match self {
            Self::Estimator => "published",
            Self::Setup => "arms",
            Self::Gateway => "bus",
            Self::Arm => "named_arm",
        }
    }
}

impl std::fmt::Display for FileKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Estimator => "a file of estimator parameters (as configs/estimator.toml)",
            Self::Setup => "a setup of `pb3dp run` (as configs/sim.toml)",
            Self::Gateway => "a gateway (as configs/gateway.toml)",
            Self::Arm => "an arm (as configs/arms/ur5e.toml)",
        })
    }
}

/// What a file is for, by the tables that it has; none if by them it is nothing.
///
/// # Errors
/// An unreadable file.
pub fn kind_of(file: &Path) -> Result<Option<FileKind>, ConfigError> {
    let figment = Figment::from(Toml::string(&text_of(file)?));
    Ok(FileKind::ALL.into_iter().find(|kind| figment.find_value(kind.own_table()).is_ok()))
}

fn text_of(file: &Path) -> Result<String, ConfigError> {
    std::fs::read_to_string(file).map_err(|source| ConfigError::Unreadable { file: file.to_path_buf(), source })
}

/// Reads `file`, which should be of the kind `wanted`, into the raw struct `T`, whose fields must match the file's keys exactly.
///
/// # Errors
/// An unreadable file, bad TOML, a file of the other kind, unknown or missing keys, wrong types.
pub fn read_toml<T: DeserializeOwned>(file: &Path, wanted: FileKind) -> Result<T, ConfigError> {
    ConfigFile::read(file, wanted)?.all()
}

/// A file whose tables are taken one by one: which keys one of them has may depend on what it says itself.
pub struct ConfigFile {
    file: PathBuf,
    wanted: FileKind,
    figment: Figment,
}

impl ConfigFile {
    /// Reads `file`, which should be of the kind `wanted`.
    ///
    /// # Errors
    /// An unreadable file.
    pub fn read(file: &Path, wanted: FileKind) -> Result<Self, ConfigError> {
        Ok(Self { file: file.to_path_buf(), wanted, figment: Figment::from(Toml::string(&text_of(file)?)) })
    }

    /// The whole file.
    ///
    /// # Errors
    /// Bad TOML, a file of the other kind, unknown or missing keys, wrong types.
    pub fn all<T: DeserializeOwned>(&self) -> Result<T, ConfigError> {
        self.figment.extract().map_err(|errors| self.refusal(errors, ""))
    }

    /// One key of it, with everything below; `owner` is what its keys are those of, for messages.
    ///
    /// # Errors
    /// As [`Self::all`].
    pub fn at<T: DeserializeOwned>(&self, key: &str, owner: &str) -> Result<T, ConfigError> {
        self.figment.extract_inner(key).map_err(|mut error| {
            // What is below the key is named before the key itself.
            let (parts, length) = (key.split('.').count(), error.path.len());
            error.path.rotate_right(parts.min(length));
            self.refusal(error, owner)
        })
    }

    /// The table `key`, which is `whole`: its own keys are those of `All`; the tables in it, which the user names, are each a `One`.
    ///
    /// # Errors
    /// As [`Self::all`].
    pub fn named_tables<All: DeserializeOwned, One: DeserializeOwned>(
        &self,
        key: &str,
        whole: &Dict,
    ) -> Result<(All, BTreeMap<String, One>), ConfigError> {
        let (tables, own): (Dict, Dict) = whole.clone().into_iter().partition(|(_, value)| value.as_dict().is_some());
        let own = Self { file: self.file.clone(), wanted: self.wanted, figment: Figment::from((key, own)) };
        let named = |name: String| Ok((name.clone(), self.at(&format!("{key}.{name}"), "")?));
        Ok((own.at(key, "")?, tables.into_keys().map(named).collect::<Result<_, ConfigError>>()?))
    }

    fn refusal(&self, errors: figment::Error, owner: &str) -> ConfigError {
        let (file, wanted) = (self.file.clone(), self.wanted);
        let is_another = |kind: &FileKind| *kind != wanted && self.figment.find_value(kind.own_table()).is_ok();
        if let Some(found) = FileKind::ALL.into_iter().find(is_another) {
            return ConfigError::OtherKind { file, found, wanted };
        }
        let owner = if owner.is_empty() { String::new() } else { format!(" {owner}") };
        let mut lines = String::new();
        for error in errors {
            let _ = writeln!(lines, "  {}{owner}", describe(&error));
        }
        ConfigError::Keys { file, lines: lines.trim_end().to_owned() }
    }
}

/// One line for one figment error, key first.
fn describe(error: &figment::Error) -> String {
    let path = error.path.join(".");
    let at = if path.is_empty() { String::from("(top level)") } else { path.clone() };
    match &error.kind {
        Kind::UnknownField(field, expected) => {
            let key = if path.ends_with(field.as_str()) || path.is_empty() {
                at_or(&path, field)
            } else {
                format!("{path}.{field}")
            };
            format!("{key}: unknown key; known here: {}", expected.join(", "))
        }
        Kind::MissingField(field) => {
            let key = if path.is_empty() { field.to_string() } else { format!("{path}.{field}") };
            format!("{key}: missing; the file must set it")
        }
        kind => format!("{at}: {kind}"),
    }
}

fn at_or(path: &str, field: &str) -> String {
    if path.is_empty() { field.to_owned() } else { path.to_owned() }
}

/// Collects what is out of range, so that a user sees everything at once.
#[derive(Debug, Default)]
pub struct Checker {
    lines: Vec<String>,
}

impl Checker {
    /// Refuses a value outside `allowed` or not finite.
    pub fn number(&mut self, key: &str, value: f64, allowed: RangeInclusive<f64>) {
        if !allowed.contains(&value) {
            self.lines.push(format!("{key} = {value}: allowed are {} to {}", allowed.start(), allowed.end()));
        }
    }

    /// Refuses each of several values outside `allowed` or not finite.
    pub fn numbers(&mut self, key: &str, values: &[f64], allowed: RangeInclusive<f64>) {
        for (index, value) in values.iter().enumerate() {
            self.number(&format!("{key}[{index}]"), *value, allowed.clone());
        }
    }

    /// Refuses a whole number outside `allowed`. Sections read whole numbers as `i64`, so that any of them is refused with its
    /// range and not with the type it does not fit; [`whole`] turns them into what the parts want.
    pub fn count(&mut self, key: &str, value: i64, allowed: RangeInclusive<i64>) {
        if !allowed.contains(&value) {
            self.lines.push(format!("{key} = {value}: allowed are {} to {}", allowed.start(), allowed.end()));
        }
    }

    /// How much was refused so far.
    pub fn refused(&self) -> usize {
        self.lines.len()
    }

    /// Whether nothing was refused so far.
    pub fn is_clean(&self) -> bool {
        self.lines.is_empty()
    }

    /// Refuses with a line that names key, value and what is allowed.
    pub fn refuse(&mut self, line: String) {
        self.lines.push(line);
    }

    /// Success, or all refusals in one error.
    ///
    /// # Errors
    /// If anything was refused.
    pub fn finish(self, file: &Path) -> Result<(), ConfigError> {
        if self.lines.is_empty() {
            return Ok(());
        }
        let lines = self.lines.iter().map(|line| format!("  {line}")).collect::<Vec<_>>().join("\n");
        Err(ConfigError::Values { file: file.to_path_buf(), lines })
    }
}

/// The number nearest to `value` within `min` to `max` (not below `min`); `min` if it is none. For bounds that depend on another key: that key is
/// refused by itself, and the bound stays sensible.
pub fn within(value: f64, min: f64, max: f64) -> f64 {
    if value.is_nan() { min } else { value.clamp(min, max) }
}

/// A whole number that [`Checker::count`] has checked, in the type that a part wants; 0 if it does not fit, which is refused
/// by then.
pub fn whole<T: TryFrom<i64> + Default>(checked: i64) -> T {
    T::try_from(checked).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Sample {
        camera: SampleCamera,
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct SampleCamera {
        rate_hz: f64,
    }

    fn message(text: &str) -> String {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("x.toml");
        std::fs::write(&file, text).unwrap();
        match read_toml::<Sample>(&file, FileKind::Setup) {
            Ok(sample) => format!("ok {}", sample.camera.rate_hz),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn errors_name_file_and_key() {
        assert_eq!(message("[camera]\nrate_hz = 30.0"), "ok 30");
        let unknown = message("[camera]\nrate_hz = 30.0\nratio = 2");
        assert!(
            unknown.contains("x.toml") && unknown.contains("camera.ratio") && unknown.contains("rate_hz"),
            "{unknown}"
        );
        let missing = message("[camera]\n");
        assert!(missing.contains("camera.rate_hz: missing"), "{missing}");
        let wrong = message("[camera]\nrate_hz = \"fast\"");
        assert!(wrong.contains("camera.rate_hz") && wrong.contains("fast"), "{wrong}");
        let syntax = message("[camera\n");
        assert!(syntax.contains("x.toml"), "{syntax}");
    }

    #[test]
    fn a_file_of_the_other_kind_is_named() {
        let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        for (file, wanted, parts) in [
            ("configs/sim.toml", FileKind::Estimator, ["sim.toml: this is a setup", "configs/estimator.toml"]),
            ("configs/estimator.toml", FileKind::Setup, ["estimator.toml: this is a file of est", "configs/sim.toml"]),
            ("configs/gateway.toml", FileKind::Setup, ["gateway.toml: this is a gateway", "configs/sim.toml"]),
            ("configs/sim.toml", FileKind::Gateway, ["sim.toml: this is a setup", "configs/gateway.toml"]),
        ] {
            let text = read_toml::<Sample>(&repository.join(file), wanted).map(|_| ()).unwrap_err().to_string();
            assert!(parts.iter().all(|part| text.contains(part)), "{text}");
        }
    }

    #[test]
    fn out_of_range_values_are_all_named() {
        let mut check = Checker::default();
        check.number("servo.gain", f64::NAN, 0.0..=10.0);
        check.numbers("arm.speed", &[1.0, 7.5], 0.0..=5.0);
        check.count("ga.population", 1, 4..=4096);
        let text = check.finish(Path::new("c.toml")).unwrap_err().to_string();
        for part in ["c.toml", "servo.gain = NaN", "0 to 10", "arm.speed[1] = 7.5", "ga.population = 1", "4 to 4096"] {
            assert!(text.contains(part), "{part} not in {text}");
        }
    }
}
