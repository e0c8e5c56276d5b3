//! The layers of a setup: built-in setups, files, variables of the environment and `--set`; later ones win.
//!
//! A file states only what differs from its `base`, which is a built-in setup or another file. figment merges the layers and
//! records the origin of each value.

mod arguments;
pub mod built_in;
pub(crate) mod built_in_keys;
mod position;
mod tables;
#[cfg(test)]
mod tests;
mod variables;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use figment::value::{Dict, Map, Value};
use figment::{Figment, Metadata, Profile, Provider};
use serde::Deserialize;

pub use self::arguments::SetupArgs;
use self::position::Positions;
use self::tables::{change, flatten, remove_at, toml_text};
use crate::arm_backend::is_real_backend;
use crate::error::{ConfigError, text_of};

/// Origin of a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// A built-in setup.
    BuiltIn(&'static str),
    /// A file.
    File(PathBuf),
    /// An environment variable.
    Variable(String),
    /// A command-line option.
    Option(&'static str),
}

impl Origin {
    /// Base folder of relative paths: the folder of a file, otherwise the working directory.
    fn folder(&self) -> &Path {
        match self {
            Self::File(file) => file.parent().unwrap_or(Path::new(".")),
            Self::BuiltIn(_) | Self::Variable(_) | Self::Option(_) => Path::new("."),
        }
    }
}

impl std::fmt::Display for Origin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::BuiltIn(name) => write!(f, "built-in {name}"),
            Self::File(file) => write!(f, "{}", file.display()),
            Self::Variable(name) => write!(f, "variable {name}"),
            Self::Option(name) => f.write_str(name),
        }
    }
}

/// An effective value of a setup.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Effective {
    /// Its key: `arms.vs.start_deg`.
    pub key: String,
    /// The value, as TOML text.
    pub value: String,
    /// Its origin: `configs/hil.toml:12`.
    pub origin: String,
}

/// The values of one source.
#[derive(Clone, Debug)]
struct Layer {
    origin: Origin,
    /// Positions of its keys in its text, if it has one.
    positions: Positions,
    /// The values, as nested tables.
    stated: Dict,
}

impl Provider for Layer {
    fn metadata(&self) -> Metadata {
        Metadata::named(self.origin.to_string())
    }

    fn data(&self) -> Result<Map<Profile, Dict>, figment::Error> {
        Ok(Map::from([(Profile::Default, self.stated.clone())]))
    }
}

impl Layer {
    /// The layer of a TOML text.
    ///
    /// # Errors
    /// A text that is not valid TOML, with line and column.
    fn of_text(origin: Origin, text: String) -> Result<Self, ConfigError> {
        let root = toml::de::DeTable::parse(&text).map_err(|error| {
            let (line, column) = position::line_and_column(&text, error.span().map_or(0, |span| span.start));
            let place = PathBuf::from(format!("{origin}:{line}:{column}"));
            ConfigError::Syntax { place, reason: error.message().to_owned() }
        })?;
        let positions = position::all(&text, root.get_ref());
        let stated = Dict::deserialize(toml::de::Deserializer::from(root)).map_err(|error| ConfigError::Syntax {
            place: PathBuf::from(origin.to_string()),
            reason: error.to_string(),
        })?;
        Ok(Self { origin, positions, stated })
    }

    /// The value of the option `--set KEY=VALUE`.
    ///
    /// # Errors
    /// A text without `=`, or with an invalid key.
    fn of_option(set: &str) -> Result<Self, ConfigError> {
        match set.split_once('=') {
            Some((key, value)) if !key.trim().is_empty() => {
                Self::of_words(Origin::Option("--set"), key.trim(), value.trim())
            }
            _ => Err(ConfigError::Values {
                file: PathBuf::from("--set"),
                lines: format!("  {set:?}: write KEY=VALUE, for instance --set scene.target=card"),
            }),
        }
    }

    /// One key with its value as TOML; a value that is not TOML is text, so that words need no quotes.
    ///
    /// # Errors
    /// An invalid key.
    fn of_words(origin: Origin, key: &str, value: &str) -> Result<Self, ConfigError> {
        let quoted = format!("{key} = {}", toml::Value::from(value));
        let text = [format!("{key} = {value}"), quoted].into_iter().find(|text| toml::de::DeTable::parse(text).is_ok());
        let text = text.ok_or_else(|| ConfigError::Values {
            file: PathBuf::from(origin.to_string()),
            lines: format!("  {key:?}: is no key; keys look like arms.vs.start_deg"),
        })?;
        Ok(Self { positions: Positions::new(), ..Self::of_text(origin, text)? })
    }

    /// The table `named_arm` of an arm's file, as the table of an arm in a setup.
    ///
    /// # Errors
    /// A file without that table.
    fn into_arm(mut self, name: &str) -> Result<Self, ConfigError> {
        let file = || PathBuf::from(self.origin.to_string());
        let Some(arm) = self.stated.remove("named_arm") else {
            let lines = "  named_arm: missing; a file of an arm has it, as configs/arms/ur5e.toml".to_owned();
            return Err(ConfigError::Values { file: file(), lines });
        };
        let arms = Dict::from([(name.to_owned(), arm)]);
        self.stated = Dict::from([("arms".to_owned(), Value::from(arms))]);
        // Its keys are below another table than in the setup.
        let in_setup = |(key, at): (String, _)| (key.replacen("named_arm", &format!("arms.{name}"), 1), at);
        self.positions = self.positions.into_iter().map(in_setup).collect();
        Ok(self)
    }
}

/// All layers of a setup, lowest first.
#[derive(Clone, Debug, Default)]
pub struct Layers {
    list: Vec<Layer>,
    /// Origins of the values of a file that [`toml_of`] has made.
    recorded: BTreeMap<String, String>,
}

/// A key that selects a kind, and the keys of lower layers that are invalid for another kind.
const KINDS: [(&str, &[&str]); 5] = [
    ("camera.backend", &["camera", "scene", "truth", "estimator.geometric"]),
    (
        "servo.law",
        &[
            "servo.arm_response",
            "servo.feed_forward",
            "servo.null_motion",
            "servo.unstated",
            "servo.target",
            "servo.gains",
            "servo.image_based",
            "servo.hybrid",
            "servo.smoothing",
        ],
    ),
    ("experiment.kind", &["experiment.move_s", "experiment.hold_s", "experiment.period_s", "experiment.periods"]),
    ("mounts.hand_eye", &["mounts.hand_from_cam_left"]),
    ("mounts.hand_from_cam_left", &["mounts.hand_eye"]),
];

/// The only key that environment variables may set for a setup with real arms: every other one decides what moves, how fast, or
/// which pose is believed.
const BY_VARIABLE: &str = "run.seed";

/// Keys that name input files, besides the robot descriptions of the arms. A region names one if it is a mask.
const INPUTS: [&str; 4] = ["camera.calibration", "truth.calibration", "mounts.hand_eye", "camera.region"];

/// Keys of a file that control its layers.
const BASE: &str = "base";
const WITHOUT: &str = "without";

/// Maximum depth of references between files.
const DEPTH_MAX: usize = 8;

impl Layers {
    /// One file without base and variables.
    ///
    /// # Errors
    /// An unreadable file, or a text that is not valid TOML.
    pub fn one_file(file: &Path) -> Result<Self, ConfigError> {
        let layer = Layer::of_text(Origin::File(file.to_path_buf()), text_of(file)?)?;
        Ok(Self { list: vec![layer], ..Self::default() })
    }

    /// One text with its base and options; without environment variables.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub(crate) fn of_text_with(name: &'static str, text: &str, set: &[String]) -> Result<Self, ConfigError> {
        let mut layers = Self::default();
        layers.add(Layer::of_text(Origin::BuiltIn(name), text.to_owned())?, 0)?;
        for set in set {
            layers.push(Layer::of_option(set)?);
        }
        layers.add_named_arms()?;
        layers.resolve_paths();
        Ok(layers)
    }

    /// One text with its base.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub(crate) fn of_text(name: &'static str, text: &str) -> Result<Self, ConfigError> {
        Self::of_text_with(name, text, &[])
    }

    /// All layers of `args` and the environment.
    ///
    /// # Errors
    /// An unreadable file, a text that is not valid TOML, a missing or circular base, an option without effect; a variable that
    /// sets a key which only a file may set.
    pub fn read(args: &SetupArgs) -> Result<Self, ConfigError> {
        let mut layers = Self::default();
        for config in &args.configs {
            layers.add_config(config, Path::new("."), 0)?;
        }
        layers.add_named_arms()?;
        let real_in_files = layers.real_arms();
        let variables = variables::layers()?;
        for layer in &variables {
            layers.push(layer.clone());
        }
        for set in &args.set {
            layers.push(Layer::of_option(set)?);
        }
        for (option, key, value) in &args.by_options {
            layers.push(Layer::of_words(Origin::Option(option), key, value)?);
        }
        // An option may have named another arm.
        layers.add_named_arms()?;
        layers.keep_simulation_from_real_arms();
        layers.check_variables(&variables, real_in_files)?;
        layers.resolve_paths();
        Ok(layers)
    }

    /// The merged values.
    pub fn figment(&self) -> Figment {
        self.list.iter().fold(Figment::new(), Figment::merge)
    }

    /// Origin of a key, with line and column in a text; `None` if nothing states it.
    pub fn origin_of(&self, key: &str) -> Option<String> {
        let path = position::parts(key);
        let layer = self.list.iter().rev().find(|layer| value_at(&layer.stated, &path).is_some())?;
        if let (Origin::File(_), Some(origin)) = (&layer.origin, self.recorded.get(key)) {
            return Some(origin.clone());
        }
        let at = layer.positions.get(key).map(|(line, column)| format!(":{line}:{column}"));
        Some(format!("{}{}", layer.origin, at.unwrap_or_default()))
    }

    /// The same with the origins that a text of [`toml_of`] states, for the values of files.
    #[must_use]
    pub fn with_origins_of(mut self, text: &str) -> Self {
        let mut table = String::new();
        for line in text.lines() {
            if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
                table = format!("{name}.");
            } else if let (Some((name, _)), Some((_, origin))) = (line.split_once(" = "), line.rsplit_once(" # ")) {
                self.recorded.insert(format!("{table}{name}"), origin.to_owned());
            }
        }
        self
    }

    /// Every effective value, by key.
    pub fn effective(&self) -> Vec<Effective> {
        let mut found = Vec::new();
        let all: Dict = self.figment().extract().unwrap_or_default();
        flatten(&all, "", &mut |key, value| {
            let origin = self.origin_of(key).unwrap_or_default();
            found.push(Effective { key: key.to_owned(), value: toml_text(value), origin });
        });
        found
    }

    /// Files whose content decides how a run goes, as their keys state them; built-in files and keys are not among them.
    pub fn input_files(&self) -> Vec<String> {
        let is_input = |key: &str| INPUTS.contains(&key) || (key.starts_with("arms.") && key.ends_with(".robot"));
        let effective = self.effective();
        let stated = effective.iter().filter(|setting| is_input(&setting.key));
        let values = stated.filter_map(|setting| format!("value = {}", setting.value).parse::<toml::Table>().ok());
        let words = values.flat_map(|table| match table.get("value") {
            Some(toml::Value::String(word)) => vec![word.clone()],
            Some(toml::Value::Array(words)) => {
                words.iter().filter_map(|word| word.as_str().map(str::to_owned)).collect()
            }
            _ => Vec::new(),
        });
        let files = words.map(|word| word.strip_prefix("mask:").map_or(word.clone(), str::to_owned));
        files.filter(|file| Path::new(file).is_file()).collect()
    }

    /// Whether more than one file or built-in setup takes part.
    pub fn has_base(&self) -> bool {
        self.list.iter().filter(|layer| !matches!(layer.origin, Origin::Variable(_) | Origin::Option(_))).count() > 1
    }

    /// Adds a layer on top. Another kind removes the keys of the former kind from lower layers.
    fn push(&mut self, layer: Layer) {
        for (kind, dropped) in KINDS {
            let Some(new) = value_at(&layer.stated, &position::parts(kind)) else { continue };
            let old = self.value(kind);
            let is_other = if kind.starts_with("mounts.") { true } else { old.is_some_and(|old| old != *new) };
            if is_other {
                dropped.iter().for_each(|key| self.remove(key));
            }
        }
        let arms = value_at(&layer.stated, &["arms"]).and_then(Value::as_dict);
        let changed: Vec<String> = arms
            .into_iter()
            .flatten()
            .filter_map(|(name, arm)| {
                let new = arm.as_dict()?.get("backend")?.as_str()?.to_owned();
                let old = self.value(&format!("arms.{name}.backend"))?;
                (old.as_str() != Some(new.as_str())).then(|| name.clone())
            })
            .collect();
        for name in &changed {
            self.remove(&format!("arms.{name}.gateway"));
        }
        // Only the action `hold` has the key `resume`.
        let policies = value_at(&layer.stated, &["supervisor", "policies"]).and_then(Value::as_dict);
        for (name, policy) in policies.into_iter().flatten() {
            if policy.as_dict().and_then(|policy| policy.get("action")?.as_str()).is_some_and(|action| action != "hold")
            {
                self.remove(&format!("supervisor.policies.{name}.resume"));
            }
        }
        self.list.push(layer);
    }

    fn has(&self, origin: &Origin) -> bool {
        self.list.iter().any(|layer| layer.origin == *origin)
    }

    fn value(&self, key: &str) -> Option<Value> {
        let path = position::parts(key);
        self.list.iter().rev().find_map(|layer| value_at(&layer.stated, &path).cloned())
    }

    fn remove(&mut self, key: &str) {
        let path = position::parts(key);
        self.list.iter_mut().for_each(|layer| remove_at(&mut layer.stated, &path));
    }

    /// Adds a file or a built-in setup, with its base.
    fn add_config(&mut self, config: &Path, folder: &Path, depth: usize) -> Result<(), ConfigError> {
        let (origin, text) = find(config, folder)?;
        if depth >= DEPTH_MAX {
            let lines = format!("  base: more than {DEPTH_MAX} files build on each other; does one build on itself?");
            return Err(ConfigError::Values { file: config.to_path_buf(), lines });
        }
        self.add(Layer::of_text(origin, text)?, depth)
    }

    fn add(&mut self, mut layer: Layer, depth: usize) -> Result<(), ConfigError> {
        let refuse = |key: &str, why: &str| ConfigError::Values {
            file: PathBuf::from(layer.origin.to_string()),
            lines: format!("  {key}: {why}"),
        };
        let base = layer.stated.get(BASE).map(|base| {
            base.as_str().ok_or_else(|| refuse(BASE, "must be the name of a built-in setup or a file, as text"))
        });
        if let Some(base) = base.transpose()?.map(str::to_owned) {
            let own_folder = layer.origin.folder().to_path_buf();
            let known = find(Path::new(&base), &own_folder).is_ok_and(|(origin, _)| self.has(&origin));
            match () {
                // On top of a setup with the same base, the base must not override that setup.
                () if known => {}
                () if depth == 0 && !self.list.is_empty() => {
                    let why = format!(
                        "{base:?} is not what the file or setup before it builds on; leave base out, or name this file first"
                    );
                    return Err(refuse(BASE, &why));
                }
                () => self
                    .add_config(Path::new(&base), &own_folder, depth + 1)
                    .map_err(|error| refuse(BASE, &error.to_string()))?,
            }
        }
        let without = layer.stated.get(WITHOUT).map(|keys| {
            let keys = keys.as_array().map(|keys| keys.iter().map(Value::as_str).collect::<Option<Vec<_>>>());
            keys.flatten().ok_or_else(|| refuse(WITHOUT, "must be a list of keys of the base, as text"))
        });
        for key in without.transpose()?.unwrap_or_default() {
            if self.value(key).is_none() {
                return Err(refuse(WITHOUT, &format!("{key:?} is not in the base; leave it out of the list")));
            }
            self.remove(key);
        }
        for key in [BASE, WITHOUT] {
            layer.stated.remove(key);
        }
        self.push(layer);
        Ok(())
    }

    /// Adds the file of an arm that is named without a table: `arms/NAME.toml` beside the file that names it, or a built-in one. It
    /// is below all other statements about the arm.
    fn add_named_arms(&mut self) -> Result<(), ConfigError> {
        for key in ["carries_cameras", "carries_target"] {
            let path = ["arms", key];
            let stating = self.list.iter().rev().find(|layer| value_at(&layer.stated, &path).is_some());
            let Some(layer) = stating else { continue };
            let Some(name) = value_at(&layer.stated, &path).and_then(Value::as_str).map(str::to_owned) else {
                continue;
            };
            if self.value(&format!("arms.{name}.robot")).is_some() {
                continue;
            }
            let file = layer.origin.folder().join("arms").join(format!("{name}.toml"));
            let found = match built_in::path_of(&format!("{name}.toml")).as_deref().and_then(built_in::text_at) {
                _ if file.is_file() => Layer::of_text(Origin::File(file.clone()), text_of(&file)?)?,
                Some(text) => Layer::of_text(Origin::BuiltIn("arm"), text.to_owned())?,
                None => continue,
            };
            self.list.insert(0, found.into_arm(&name)?);
        }
        Ok(())
    }

    /// Names of the arms of a run, from all layers.
    fn arms(&self) -> [String; 2] {
        [("arms.carries_cameras", "vs"), ("arms.carries_target", "tc")].map(|(key, usual)| {
            self.value(key).and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_else(|| usual.to_owned())
        })
    }

    /// Arms that are neither simulated nor emulated in this program.
    fn real_arms(&self) -> Vec<String> {
        let is_real = |name: &String| {
            let backend = self.value(&format!("arms.{name}.backend"));
            backend.and_then(|word| word.as_str().map(is_real_backend)).unwrap_or(false)
        };
        self.arms().into_iter().filter(is_real).collect()
    }

    /// The limits, poses and mounts of a built-in setup are those of the simulation; a real arm needs its own.
    fn keep_simulation_from_real_arms(&mut self) {
        let real = self.real_arms();
        if real.is_empty() {
            return;
        }
        let of_arms = real.iter().map(|name| format!("arms.{name}"));
        let keys: Vec<String> =
            of_arms.chain(["mounts", "arms.speed_scale", "arms.first_run"].map(str::to_owned)).collect();
        for layer in self.list.iter_mut().filter(|layer| matches!(layer.origin, Origin::BuiltIn(_))) {
            keys.iter().for_each(|key| remove_at(&mut layer.stated, &position::parts(key)));
        }
    }

    /// A variable may have been set long ago by somebody else. `real`: arms that are real according to files and built-in setups; a
    /// variable must not hide them.
    fn check_variables(&self, variables: &[Layer], mut real: Vec<String>) -> Result<(), ConfigError> {
        real.extend(self.real_arms());
        real.sort();
        real.dedup();
        let mut lines = Vec::new();
        for layer in variables.iter().filter(|_| !real.is_empty()) {
            flatten(&layer.stated, "", &mut |key, _| {
                if key != BY_VARIABLE {
                    lines.push(format!(
                        "  {}: sets {key}, and real arms are used (arms.{}); state it in a file or with --set",
                        layer.origin,
                        real.join(", arms.")
                    ));
                }
            });
        }
        if lines.is_empty() {
            return Ok(());
        }
        Err(ConfigError::Values { file: PathBuf::from("environment"), lines: lines.join("\n") })
    }

    /// Relative paths start at the file that states them; a robot is also found by its name among the built-in ones.
    fn resolve_paths(&mut self) {
        for layer in &mut self.list {
            let folder = match &layer.origin {
                Origin::BuiltIn(_) => None,
                origin => Some(origin.folder().to_path_buf()),
            };
            let resolved = |path: &str| match &folder {
                Some(folder) if folder.join(path).exists() || path.contains('/') => {
                    folder.join(path).display().to_string()
                }
                // A name without a folder may be a built-in file; a built-in setup refers to built-in files only.
                folder => built_in::path_of(path)
                    .unwrap_or_else(|| folder.clone().unwrap_or_default().join(path).display().to_string()),
            };
            // These files need not exist yet: `pb3dp gateway key` and `pb3dp arm test` write them.
            let beside = |path: &str| folder.clone().unwrap_or_default().join(path).display().to_string();
            for key in ["camera.calibration", "truth.calibration", "mounts.hand_eye"] {
                change(&mut layer.stated, &position::parts(key), &resolved);
            }
            if let Some(Value::Dict(_, arms)) = layer.stated.get_mut("arms") {
                for arm in arms.values_mut() {
                    if let Value::Dict(_, arm) = arm {
                        change(arm, &["robot"], &resolved);
                        change(arm, &["commissioning_record"], &beside);
                        change(arm, &["gateway", "key_file"], &beside);
                        change(arm, &["gateway", "socket"], &beside);
                    }
                }
            }
            let mask = |text: &str| match (text.strip_prefix("mask:"), &folder) {
                (Some(file), Some(folder)) => format!("mask:{}", folder.join(file).display()),
                _ => text.to_owned(),
            };
            change(&mut layer.stated, &["camera", "region"], &mask);
        }
    }
}

/// A file, if the word is a path or has an extension; else a built-in setup.
fn find(config: &Path, folder: &Path) -> Result<(Origin, String), ConfigError> {
    let name = config.to_str().unwrap_or_default();
    if let Some(setup) = built_in::setup(name) {
        return Ok((Origin::BuiltIn(setup.name), setup.text.to_owned()));
    }
    if config.extension().is_none() && config.components().count() == 1 && !folder.join(config).exists() {
        let known = built_in::SETUPS.map(|setup| setup.name).join(", ");
        return Err(ConfigError::NoSuchSetup { name: name.to_owned(), known });
    }
    let file = folder.join(config);
    let file = file.strip_prefix("./").map(Path::to_path_buf).unwrap_or(file);
    let text = text_of(&file)?;
    Ok((Origin::File(file), text))
}

/// A value in nested tables.
fn value_at<'a>(dict: &'a Dict, path: &[impl AsRef<str>]) -> Option<&'a Value> {
    let (first, rest) = path.split_first()?;
    rest.iter().map(AsRef::as_ref).try_fold(dict.get(first.as_ref())?, |value, part| match value {
        Value::Dict(_, inner) => inner.get(part),
        Value::Array(_, items) => items.get(part.parse::<usize>().ok()?),
        _ => None,
    })
}

/// A complete setup as one file, each value with its origin.
pub fn toml_of(settings: &[Effective]) -> String {
    // A table is stated once, before its subtables.
    let mut tables: BTreeMap<&str, String> = BTreeMap::new();
    for setting in settings {
        let (table, name) = setting.key.rsplit_once('.').unwrap_or(("", &setting.key));
        let line = format!("{:<60} # {}\n", format!("{name} = {}", setting.value), setting.origin);
        tables.entry(table).or_default().push_str(&line);
    }
    let text = |(table, lines): (&str, String)| if table.is_empty() { lines } else { format!("[{table}]\n{lines}") };
    tables.into_iter().map(text).collect::<Vec<_>>().join("\n")
}
