//! `pb3dp config`: values of a setup with their origin, meaning of keys, and templates.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::SystemTime;

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand, ValueEnum};
use pb3dp_cell::paths::check_stated_paths;
use pb3dp_cell::terminal::print_line;
use pb3dp_commissioning::commissioned::needed_records;
use pb3dp_setup::explain::{explain, is_within};
use pb3dp_setup::layers::{Effective, Layers, SetupArgs, built_in, toml_of};
use pb3dp_setup::setup::{CalibrationInUse, is_for_cameras_only, read_cameras, read_layers};
use pb3dp_wiring::check_key_files;

use crate::arguments::UNSURE;

/// Beginning of the arms in the example of a rig.
const ARMS: &str = "[arms]\n";

/// Arguments of `pb3dp config`.
#[derive(Debug, Args)]
pub struct ConfigArgs {
    #[command(subcommand)]
    command: ConfigCommand,
}

#[derive(Debug, Subcommand)]
enum ConfigCommand {
    /// Print every value of a setup with its file and line.
    Show(ShowArgs),
    /// Check a setup: exit code 0 if a run would accept it, 1 with all errors.
    Check(CheckArgs),
    /// Print the values that differ between two setups: exit code 0 without differences, 3 otherwise.
    Diff(DiffArgs),
    /// Print a template of a setup.
    Init(InitArgs),
    /// Describe a key, all keys of a table, or all keys that mention a word: unit, range, built-in values.
    Explain(ExplainArgs),
}

#[derive(Debug, Args)]
struct ShowArgs {
    #[command(flatten)]
    setup: SetupArgs,
    /// Only this key or table; may be repeated.
    #[arg(long = "key", value_name = "KEY")]
    keys: Vec<String>,
    /// One JSON object with value and origin of each key.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct CheckArgs {
    #[command(flatten)]
    setup: SetupArgs,
}

#[derive(Debug, Args)]
struct DiffArgs {
    /// A TOML file or a built-in setup.
    #[arg(value_name = "FILE|NAME")]
    a: PathBuf,
    /// The second setup.
    #[arg(value_name = "FILE|NAME")]
    b: PathBuf,
    /// Set one key of the second setup.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
}

#[derive(Debug, Args)]
struct InitArgs {
    /// Purpose of the setup.
    #[arg(value_enum)]
    kind: Kind,
}

/// Templates of setups.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// A modified simulation.
    Sim,
    /// Emulated arms on the clock of the computer.
    Hil,
    /// Two cameras of this computer, for `pb3dp cameras`.
    Cameras,
    /// Two real arms, with cameras simulated at the measured arm poses.
    Arms,
    /// Two real arms and cameras.
    Rig,
}

#[derive(Debug, Args)]
struct ExplainArgs {
    /// A key (`servo.speed.linear_max_mm_per_s`), a table (`servo.speed`) or a word (`delay`).
    key: String,
}

/// Runs the command.
///
/// # Errors
/// An unreadable or refused setup, or an unknown key.
pub fn run(args: &ConfigArgs) -> Result<ExitCode> {
    match &args.command {
        ConfigCommand::Show(args) => show(args),
        ConfigCommand::Check(args) => check(args),
        ConfigCommand::Diff(args) => diff(args),
        ConfigCommand::Init(args) => init(args.kind),
        ConfigCommand::Explain(args) => explain_key(&args.key),
    }
}

/// Warns of keys that no setup has: values are shown as they are stated, also those of a setup that is not complete.
fn warn_of_unknown_keys(setup: &SetupArgs) -> Result<()> {
    let checked = match is_for_cameras_only(setup)? {
        true => read_cameras(setup).map(drop),
        false => read_layers(setup).map(drop),
    };
    let why = checked.err().map(|why| why.to_string()).unwrap_or_default();
    why.lines().filter(|line| line.contains("unknown key")).for_each(|line| tracing::warn!("{}", line.trim()));
    Ok(())
}

fn show(args: &ShowArgs) -> Result<ExitCode> {
    warn_of_unknown_keys(&args.setup)?;
    let all = Layers::read(&args.setup)?.effective();
    let is_wanted =
        |setting: &&Effective| args.keys.is_empty() || args.keys.iter().any(|key| is_within(&setting.key, key));
    let wanted: Vec<&Effective> = all.iter().filter(is_wanted).collect();
    if let (true, Some(key)) = (wanted.is_empty(), args.keys.first()) {
        bail!("--key {key}: the setup states no such key; `pb3dp config explain {key}` names the nearest");
    }
    if args.json {
        let entry = |setting: &&Effective| {
            let value = json_of(&setting.value).with_context(|| setting.key.clone())?;
            Ok((setting.key.clone(), serde_json::json!({ "value": value, "origin": setting.origin })))
        };
        let object = wanted.iter().map(entry).collect::<Result<serde_json::Map<String, serde_json::Value>>>()?;
        print_line(&serde_json::to_string_pretty(&object)?)?;
        return Ok(ExitCode::SUCCESS);
    }
    let wanted: Vec<Effective> = wanted.into_iter().cloned().collect();
    print_line(toml_of(&wanted).trim_end())?;
    Ok(ExitCode::SUCCESS)
}

/// A TOML value as a JSON value.
fn json_of(value: &str) -> Result<serde_json::Value> {
    let table: toml::Table = format!("value = {value}").parse()?;
    Ok(serde_json::to_value(table.get("value"))?)
}

/// The same value with floating point numbers only: 17 and 17.0 are the same setting.
fn with_floats(value: serde_json::Value) -> serde_json::Value {
    match value {
        serde_json::Value::Number(number) => number.as_f64().into(),
        serde_json::Value::Array(list) => list.into_iter().map(with_floats).collect(),
        other => other,
    }
}

fn check(args: &CheckArgs) -> Result<ExitCode> {
    if is_for_cameras_only(&args.setup)? {
        return check_cameras(&args.setup);
    }
    let setup = read_layers(&args.setup)?;
    let would_refuse = "`pb3dp run` would refuse this setup";
    check_stated_paths(&setup).context(would_refuse)?;
    check_key_files(&setup).context(would_refuse)?;
    needed_records(&setup, SystemTime::now()).context(would_refuse)?;
    for doubt in setup.rig.calibrations.iter().flat_map(CalibrationInUse::doubts) {
        tracing::warn!("{doubt}");
    }
    print_line(&format!("{}: {} values, accepted", args.setup, setup.layers.effective().len()))?;
    Ok(ExitCode::SUCCESS)
}

/// Checks a setup without arms. A calibration that does not exist yet is no fault.
fn check_cameras(setup: &SetupArgs) -> Result<ExitCode> {
    let (cameras, _) = read_cameras(setup)?;
    let missing: Vec<String> =
        cameras.calibration_files.iter().filter(|file| !file.exists()).map(|file| file.display().to_string()).collect();
    if missing.is_empty() {
        for warning in cameras.calibration()?.warnings {
            tracing::warn!("camera.calibration: {warning}");
        }
    }
    print_line(&format!(
        "{setup}: accepted for `pb3dp cameras`; `pb3dp run` also needs the tables [mounts] and [arms.NAME]"
    ))?;
    if !missing.is_empty() {
        print_line(&format!("{}: does not exist yet; `pb3dp calibrate stereo` writes it", missing.join(", ")))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn diff(args: &DiffArgs) -> Result<ExitCode> {
    let of = |config: &PathBuf, set: &[String]| -> Result<BTreeMap<String, Effective>> {
        let layers =
            Layers::read(&SetupArgs { configs: vec![config.clone()], set: set.to_vec(), ..SetupArgs::default() })?;
        Ok(layers.effective().into_iter().map(|setting| (setting.key.clone(), setting)).collect())
    };
    let (a, b) = (of(&args.a, &[])?, of(&args.b, &args.set)?);
    let keys: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    let value = |setups: &BTreeMap<String, Effective>, key: &str| {
        setups.get(key).map(|setting| json_of(&setting.value).map(with_floats)).transpose()
    };
    let mut differing = Vec::new();
    for key in keys {
        if value(&a, key)? != value(&b, key)? {
            differing.push(key);
        }
    }
    for key in &differing {
        print_line(key)?;
        for setups in [&a, &b] {
            print_line(&match setups.get(*key) {
                Some(setting) => format!("    {:<56} # {}", setting.value, setting.origin),
                None => "    (not stated)".to_owned(),
            })?;
        }
    }
    Ok(if differing.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(UNSURE) })
}

fn init(kind: Kind) -> Result<ExitCode> {
    let text = match kind {
        Kind::Sim => include_str!("config/sim.toml"),
        Kind::Hil => include_str!("config/hil.toml"),
        Kind::Cameras => include_str!("config/cameras.toml"),
        Kind::Rig => built_in::RIG_EXAMPLE,
        Kind::Arms => include_str!("config/arms.toml"),
    };
    print_line(text.trim_end())?;
    if kind == Kind::Arms {
        let arms = built_in::RIG_EXAMPLE.split_once(ARMS).map_or("", |(_, arms)| arms);
        print_line(&format!("{ARMS}{}", arms.trim_end()))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn explain_key(key: &str) -> Result<ExitCode> {
    let found = match explain(key) {
        Ok(found) => found,
        Err(alike) if alike.is_empty() => {
            bail!("{key}: no setup has this key; `pb3dp config show --config sim` prints all keys of a simulation")
        }
        Err(alike) => bail!("{key}: no setup has this key; did you mean {}?", alike.join(" or ")),
    };
    for explanation in found {
        print_line(&explanation.key)?;
        let unit = explanation.unit.map(|unit| format!("unit: {unit}"));
        let allowed = explanation.allowed.map(|allowed| format!("allowed: {allowed}"));
        let about = Some(explanation.about).filter(|about| !about.is_empty());
        let mut values: BTreeMap<String, Vec<&str>> = BTreeMap::new();
        explanation.values.into_iter().for_each(|(name, value)| values.entry(value).or_default().push(name));
        let values = values.into_iter().map(|(value, names)| format!("{}: {value}", names.join(", ")));
        for line in [about, unit, allowed].into_iter().flatten().chain(values) {
            print_line(&format!("    {line}"))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}
