//! Deserialisation of configurations: TOML to raw structs, with errors that name file, line, key and allowed values.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use figment::Figment;
use figment::error::Kind;
use figment::providers::Serialized;
use figment::value::{Dict, Value};
use serde::de::DeserializeOwned;

use crate::error::text_of;
pub use crate::error::{ConfigError, FileKind};
use crate::layers::{Layers, built_in};

/// Kind of a file by its tables; `None` if it has no table of any kind.
///
/// # Errors
/// An unreadable file.
pub fn kind_of(file: &Path) -> Result<Option<FileKind>, ConfigError> {
    let values: Dict = toml::from_str(&text_of(file)?).unwrap_or_default();
    Ok(FileKind::ALL.into_iter().find(|kind| values.contains_key(kind.own_table())))
}

/// A configuration that is read table by table: the keys of a table may depend on its values.
///
/// Problems with keys are collected: an unusable value is replaced by a sample, so that all other problems are found too.
/// [`Self::finish`] reports all of them.
pub struct ConfigFile {
    name: PathBuf,
    wanted: FileKind,
    layers: Layers,
    values: RefCell<Dict>,
    problems: RefCell<Vec<String>>,
}

impl ConfigFile {
    /// Reads one file, which should be of the kind `wanted`.
    ///
    /// # Errors
    /// An unreadable file, or a text that is not valid TOML.
    pub fn read(file: &Path, wanted: FileKind) -> Result<Self, ConfigError> {
        Ok(Self::of(file.to_path_buf(), wanted, Layers::one_file(file)?))
    }

    pub(crate) fn of(name: PathBuf, wanted: FileKind, layers: Layers) -> Self {
        let values = layers.figment().extract().unwrap_or_default();
        Self { name, wanted, layers, values: RefCell::new(values), problems: RefCell::default() }
    }

    /// Its layers.
    pub fn layers(&self) -> &Layers {
        &self.layers
    }

    /// The whole configuration; `None` if a wrong key has no sample.
    pub fn all<T: DeserializeOwned>(&self) -> Option<T> {
        self.extract("", "")
    }

    /// One key with everything below it; messages call `owner` the owner of its keys.
    pub fn at<T: DeserializeOwned>(&self, key: &str, owner: &str) -> Option<T> {
        self.extract(key, owner)
    }

    /// The table `key`: its own keys form an `All`; its subtables, named by the user, are a `One` each.
    pub fn named_tables<All: DeserializeOwned, One: DeserializeOwned>(
        &self,
        key: &str,
    ) -> Option<(All, BTreeMap<String, One>)> {
        let whole = self.values.borrow().get(key).and_then(Value::as_dict).cloned().unwrap_or_default();
        let (tables, own): (Dict, Dict) = whole.into_iter().partition(|(_, value)| value.as_dict().is_some());
        let own = self.extract_from(&mut Dict::from([(key.to_owned(), own.into())]), key, "");
        let named = |name: String| Some((name.clone(), self.extract(&format!("{key}.{name}"), "")?));
        let named: Vec<Option<(String, One)>> = tables.into_keys().map(named).collect();
        Some((own?, named.into_iter().collect::<Option<_>>()?))
    }

    fn extract<T: DeserializeOwned>(&self, key: &str, owner: &str) -> Option<T> {
        let mut values = self.values.borrow_mut();
        self.extract_from(&mut values, key, owner)
    }

    /// The value of `key`, or all values; replaces wrong values by samples.
    fn extract_from<T: DeserializeOwned>(&self, values: &mut Dict, key: &str, owner: &str) -> Option<T> {
        let parts = key.split('.').filter(|part| !part.is_empty()).count();
        for _ in 0..PROBLEMS_MAX {
            let figment = Figment::from(Serialized::defaults(values.clone()));
            let found = if key.is_empty() { figment.extract() } else { figment.extract_inner(key) };
            let errors = match found {
                Ok(found) => return Some(found),
                Err(errors) => errors,
            };
            for mut error in errors {
                if !key.is_empty() {
                    // The path starts below the key, so the key is moved to the front.
                    let length = error.path.len();
                    error.path.rotate_right(parts.min(length));
                }
                let owner = if owner.is_empty() { String::new() } else { format!(" {owner}") };
                let choices = choices::<T>(values, key, &error);
                self.note(format!("{}{owner}", choices.unwrap_or_else(|| describe(&error))));
                if !repair(values, &error) {
                    return None;
                }
            }
        }
        None
    }

    fn note(&self, line: String) {
        let mut problems = self.problems.borrow_mut();
        if !problems.contains(&line) {
            problems.push(line);
        }
    }

    /// Success, or all problems in one error: keys first, then the refusals of `check`.
    ///
    /// # Errors
    /// If there is any problem.
    pub fn finish(&self, check: Checker) -> Result<(), ConfigError> {
        let keys = self.problems.borrow();
        let key_of = |line: &str| line.split([' ', ':', '=']).next().unwrap_or_default().to_owned();
        let replaced: Vec<String> = keys.iter().map(|line| key_of(line)).collect();
        // Consequences of a sample are not the user's mistake.
        let is_own = |line: &String| {
            let key = key_of(line);
            let is_stated = line.contains(MISSING) || self.layers.origin_of(&key).is_some();
            keys.is_empty() || is_stated && !replaced.iter().any(|other| key.starts_with(other.as_str()))
        };
        let refused: Vec<String> = check.lines.into_iter().filter(is_own).collect();
        if keys.is_empty() && refused.is_empty() {
            return Ok(());
        }
        let file = self.name.clone();
        let is_another =
            |kind: &FileKind| *kind != self.wanted && self.layers.figment().find_value(kind.own_table()).is_ok();
        if let (false, Some(found)) = (keys.is_empty(), FileKind::ALL.into_iter().find(is_another)) {
            return Err(ConfigError::OtherKind { file, found, wanted: self.wanted });
        }
        let located = |line: &String| match self.layers.origin_of(&key_of(line)) {
            Some(origin) => format!("  {line} [{origin}]"),
            None => format!("  {line}"),
        };
        let mut lines: Vec<String> = keys.iter().chain(&refused).map(located).collect();
        let missing = keys.iter().filter(|line| line.contains(MISSING)).count();
        let is_of_arms = |line: &String| line.starts_with("arms.") && line.contains(MISSING);
        if self.wanted == FileKind::Setup && self.layers.has_base() && keys.iter().any(is_of_arms) {
            lines.push(
                "  no built-in setup has these keys of real arms; `pb3dp config init arms` prints a file with all of them (with real \
                 cameras: `pb3dp config init rig`)"
                    .to_owned(),
            );
        }
        if self.wanted == FileKind::Setup && missing > 0 && !self.layers.has_base() {
            lines.push(
                format!(
                    "  add the first line base = \"sim\" to take all other values from this built-in setup; the others are {}",
                    built_in::SETUPS.iter().map(|setup| setup.name).filter(|name| *name != "sim").collect::<Vec<_>>().join(", ")
                ),
            );
        }
        Err(ConfigError::Values { file, lines: lines.join("\n") })
    }
}

/// Keys of earlier versions, by their ends, and what to do instead.
const REMOVED: [(&str, &str); 3] = [("gateway.certificate", NO_TLS), ("access.tls", NO_TLS), (".bus", NO_BUS)];

const NO_TLS: &str = "the key file alone protects the link to a gateway; remove this one, and where joint angles must be secret, run the \
                      link through an encrypted tunnel (docs/gateway.md)";

const NO_BUS: &str = "the gateway is the only program on the bus of an arm: run `pb3dp gateway` on this computer, then write backend = \"local\" \
                      and the table gateway here; docs/gateway.md has the new place of each key of bus";

/// What to do instead of a key of an earlier version, or of one in a table of an earlier version.
pub(crate) fn removed(key: &str) -> Option<String> {
    let is_it = |(removed, _): &&(&str, &str)| key.ends_with(removed) || key.contains(&format!("{removed}."));
    REMOVED.iter().find(is_it).map(|(_, advice)| format!("this key is gone: {advice}"))
}

/// The same for a word.
const REMOVED_WORDS: [(&str, &str, &str); 2] = [
    (".backend", "arcnet", NO_BUS),
    ("gateway.dialect", "transparent", "host and gateway have one set of messages; remove the key"),
];

/// More problems are not reported.
const PROBLEMS_MAX: usize = 300;
const MISSING: &str = ": missing";
const ALLOWED: &str = ": allowed are ";

/// For a value of the wrong type where one of several words is required: the message with these words.
fn choices<T: DeserializeOwned>(values: &Dict, key: &str, error: &figment::Error) -> Option<String> {
    let Kind::InvalidType(actual, expected) = &error.kind else { return None };
    if !expected.starts_with("enum ") {
        return None;
    }
    let mut with_word = values.clone();
    put(&mut with_word, &error.path, Value::from("?"));
    let figment = Figment::from(Serialized::defaults(with_word));
    let refused = if key.is_empty() { figment.extract::<T>() } else { figment.extract_inner::<T>(key) }.err()?;
    let words = refused.into_iter().find_map(|refused| match refused.kind {
        Kind::UnknownVariant(_, words) => Some(words.join(", ")),
        _ => None,
    })?;
    let actual = actual.to_string();
    let found = actual.rsplit(' ').next().unwrap_or_default().replace('`', "");
    Some(format!("{}: found {found}, expected one of {words}", error.path.join(".")))
}

/// Replaces the value of an error by a usable one; returns whether that was possible.
fn repair(values: &mut Dict, error: &figment::Error) -> bool {
    let mut path: Vec<String> = error.path.clone();
    match &error.kind {
        Kind::UnknownField(field, _) => {
            if path.last() != Some(field) {
                path.push(field.clone());
            }
            return take(values, &path);
        }
        Kind::MissingField(field) => path.push(field.to_string()),
        _ => {}
    }
    let found = built_in::sample(&path).filter(|sample| value_of(values, &path) != Some(sample));
    found.is_some_and(|sample| put(values, &path, sample))
}

fn value_of<'a>(values: &'a Dict, path: &[String]) -> Option<&'a Value> {
    let (first, rest) = path.split_first()?;
    rest.iter().try_fold(values.get(first)?, |value, part| value.as_dict()?.get(part))
}

fn table_of<'a>(values: &'a mut Dict, path: &[String]) -> Option<&'a mut Dict> {
    path.iter().try_fold(values, |table, part| match table.entry(part.clone()).or_insert_with(|| Dict::new().into()) {
        Value::Dict(_, inner) => Some(inner),
        _ => None,
    })
}

fn put(values: &mut Dict, path: &[String], value: Value) -> bool {
    let Some((last, tables)) = path.split_last() else { return false };
    table_of(values, tables).map(|table| table.insert(last.clone(), value)).is_some()
}

fn take(values: &mut Dict, path: &[String]) -> bool {
    let Some((last, tables)) = path.split_last() else { return false };
    table_of(values, tables).and_then(|table| table.remove(last)).is_some()
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
            if let Some(gone) = removed(&key) {
                return format!("{key}: {gone}");
            }
            match nearest(field, expected) {
                Some(nearest) => format!("{key}: unknown key; did you mean {nearest}?"),
                None => format!("{key}: unknown key; known here: {}", expected.join(", ")),
            }
        }
        Kind::MissingField(field) => {
            let key = if path.is_empty() { field.to_string() } else { format!("{path}.{field}") };
            format!("{key}{MISSING}; the setup must state it")
        }
        Kind::UnknownVariant(found, known) => {
            let is_it = |(key, word, _): &&(&str, &str, &str)| path.ends_with(key) && found == word;
            if let Some((_, word, advice)) = REMOVED_WORDS.iter().find(is_it) {
                return format!("{at} = {word:?}: this word is gone: {advice}");
            }
            let meant = nearest(found, known).map(|word| format!("; did you mean {word}?")).unwrap_or_default();
            format!("{at}: {}{meant}", plain(&error.kind.to_string()))
        }
        kind => format!("{at}: {}", plain(&kind.to_string())),
    }
}

/// A message of serde without the names of Rust types.
fn plain(plain_text: &str) -> String {
    let words = [
        ("`", ""),
        ("f64", "a number"),
        ("u64", "a whole number"),
        ("i64", "a whole number"),
        ("a sequence", "a list"),
    ];
    words.into_iter().fold(plain_text.to_owned(), |text, (from, to)| text.replace(from, to))
}

/// The known key that a mistyped one probably means.
pub(crate) fn nearest<'a>(key: &str, known: &[&'a str]) -> Option<&'a str> {
    let likeness = |other: &&str| strsim::jaro_winkler(key, other);
    let best = known.iter().copied().max_by(|a, b| likeness(a).total_cmp(&likeness(b)))?;
    // Two exchanged letters of a short word: `tpc` and `tcp` have a similarity of 0.55.
    let one_slip = || known.iter().copied().find(|other| key.len() > 2 && strsim::osa_distance(key, other) == 1);
    (likeness(&best) > LIKE).then_some(best).or_else(one_slip)
}

/// Minimum Jaro-Winkler similarity of two keys; chosen: `serach` and `search` have 0.95, `port` and `baud` 0.
const LIKE: f64 = 0.85;

fn at_or(path: &str, field: &str) -> String {
    if path.is_empty() { field.to_owned() } else { path.to_owned() }
}

/// The unit in the name of a key: `mm/s` for `speed_max_mm_per_s`.
pub fn unit_of(key: &str) -> Option<String> {
    let name = key.rsplit('.').next().unwrap_or(key).split(['[', ' ']).next().unwrap_or_default();
    let words: Vec<&str> = name.split('_').collect();
    fn symbol(word: &str) -> Option<&str> {
        Some(match word {
            "millis" => "ms",
            "s" | "mm" | "m" | "deg" | "rad" | "px" | "days" => word,
            "s2" => "s^2",
            "s3" => "s^3",
            "px2" => "px^2",
            "hz" => "Hz",
            "grey" => "grey levels",
            "kelvin" => "K",
            "percent" => "%",
            _ => return None,
        })
    }
    match words.iter().position(|word| *word == "per") {
        Some(at) => {
            let above = at.checked_sub(1).and_then(|before| symbol(words[before])).unwrap_or("1");
            let below = words.get(at + 1).and_then(|word| symbol(word))?;
            Some(format!("{above}/{below}"))
        }
        None => words.last().and_then(|word| symbol(word)).map(str::to_owned),
    }
}

/// Collects values out of range, so that a user sees all of them at once.
#[derive(Debug, Default)]
pub struct Checker {
    lines: Vec<String>,
}

impl Checker {
    /// Refuses a value that is not in `allowed` or not finite.
    pub fn number(&mut self, key: &str, value: f64, allowed: RangeInclusive<f64>) {
        if !allowed.contains(&value) {
            self.refuse_range(key, value, allowed);
        }
    }

    /// As [`Self::number`]; returns the value limited to `allowed` (its start for NaN), for bounds and times that depend on it.
    pub fn limited(&mut self, key: &str, value: f64, allowed: RangeInclusive<f64>) -> f64 {
        self.number(key, value, allowed.clone());
        within(value, *allowed.start(), *allowed.end())
    }

    fn refuse_range<T: std::fmt::Display>(&mut self, key: &str, value: T, allowed: RangeInclusive<T>) {
        let unit = unit_of(key).map(|unit| format!(" {unit}")).unwrap_or_default();
        self.lines.push(format!("{key} = {value}{ALLOWED}{} to {}{unit}", allowed.start(), allowed.end()));
    }

    /// Refuses each of several values that is not in `allowed` or not finite.
    pub fn numbers(&mut self, key: &str, values: &[f64], allowed: RangeInclusive<f64>) {
        for (index, value) in values.iter().enumerate() {
            self.number(&format!("{key}[{index}]"), *value, allowed.clone());
        }
    }

    /// Refuses a whole number that is not in `allowed`. Sections read whole numbers as `i64`, so that a refusal states the range
    /// and not a type; [`whole`] converts them.
    pub fn count<T: TryInto<i64>>(&mut self, key: &str, value: i64, allowed: RangeInclusive<T>) {
        let (min, max) = allowed.into_inner();
        let allowed = min.try_into().unwrap_or(i64::MAX)..=max.try_into().unwrap_or(i64::MAX);
        if !allowed.contains(&value) {
            self.refuse_range(key, value, allowed);
        }
    }

    /// Refuses what a part finds wrong with its parameters together, if each value is allowed.
    pub fn together(&mut self, key: &str, found: Result<(), impl std::fmt::Display>) {
        if let (true, Err(error)) = (self.is_clean(), found) {
            self.refuse(format!("{key}: {error}"));
        }
    }

    /// Number of refusals.
    pub fn refused(&self) -> usize {
        self.lines.len()
    }

    /// Whether there is no refusal.
    pub fn is_clean(&self) -> bool {
        self.lines.is_empty()
    }

    /// Refuses with a line that names key, value and allowed values.
    pub fn refuse(&mut self, line: String) {
        self.lines.push(line);
    }
}

/// `value` limited to `min` to `max` (at least `min`); `min` for NaN. For bounds that depend on another key: that key is refused
/// separately, and the bound stays sensible.
pub fn within(value: f64, min: f64, max: f64) -> f64 {
    if value.is_nan() { min } else { value.clamp(min, max) }
}

/// A whole number checked by [`Checker::count`], in the type of its parameter; 0 if it does not fit and is refused already.
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

    fn read<T: DeserializeOwned>(file: &Path, wanted: FileKind) -> Result<T, ConfigError> {
        let config = ConfigFile::read(file, wanted)?;
        let all = config.all();
        config.finish(Checker::default())?;
        Ok(all.unwrap())
    }

    fn message(text: &str) -> String {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("x.toml");
        std::fs::write(&file, text).unwrap();
        match read::<Sample>(&file, FileKind::Setup) {
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
    fn a_mistyped_word_names_the_nearest_known_one() {
        #[derive(Debug, Deserialize)]
        #[serde(rename_all = "kebab-case")]
        enum Shape {
            Crab,
            Card,
            Box,
        }
        let refused = |word: &str| {
            let figment = Figment::from(Serialized::defaults(Dict::from([("target".to_owned(), Value::from(word))])));
            describe(&figment.extract_inner::<Shape>("target").unwrap_err())
        };
        assert!(
            refused("crd").contains("found crd, expected one of crab, card, box; did you mean card?"),
            "{}",
            refused("crd")
        );
        assert!(refused("obx").contains("did you mean box?"), "{}", refused("obx"));
        assert!(!refused("sphere").contains("did you mean"), "{}", refused("sphere"));
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
            let text = read::<Sample>(&repository.join(file), wanted).map(|_| ()).unwrap_err().to_string();
            assert!(parts.iter().all(|part| text.contains(part)), "{text}");
        }
    }

    #[test]
    fn out_of_range_values_are_all_named() {
        let mut check = Checker::default();
        check.number("servo.gain", f64::NAN, 0.0..=10.0);
        check.numbers("arm.speed", &[1.0, 7.5], 0.0..=5.0);
        check.count("ga.population", 1, 4..=4096);
        check.number("servo.speed.linear_max_mm_per_s", -1.0, 0.0..=400.0);
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/sim.toml");
        let text = ConfigFile::read(&file, FileKind::Setup).unwrap().finish(check).unwrap_err().to_string();
        for part in [
            "sim.toml",
            "servo.gain = NaN",
            "0 to 10",
            "0 to 400 mm/s",
            "configs/sim.toml:",
            "arm.speed[1] = 7.5",
            "ga.population = 1",
            "4 to 4096",
        ] {
            assert!(text.contains(part), "{part} not in {text}");
        }
    }
}
