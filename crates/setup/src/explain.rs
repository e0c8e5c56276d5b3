//! What a key of a setup means: from the comments of the built-in setups, and from what refuses a wrong value, so that nothing is said twice.

use std::collections::BTreeMap;

use crate::layers::{Layers, built_in};
use crate::load::{nearest, unit_of};
use crate::setup::refusals_of;

/// What is known of one key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Explanation {
    /// The key.
    pub key: String,
    /// What the built-in setups say of it, or of its table.
    pub about: String,
    /// The unit in which it is stated.
    pub unit: Option<String>,
    /// What is allowed, if a wrong value is refused with that.
    pub allowed: Option<String>,
    /// Its values in the built-in setups that have it: name and value.
    pub values: Vec<(&'static str, String)>,
}

/// All texts that state keys: name, text.
fn texts() -> impl Iterator<Item = (&'static str, &'static str)> {
    built_in::SETUPS.iter().map(|setup| (setup.name, setup.text)).chain([("rig example", built_in::RIG_EXAMPLE)])
}

/// Explains `key`, or names the keys that are most alike. The name of an arm may be any.
///
/// # Errors
/// The keys that are most alike, if no built-in setup has this one.
pub fn explain(key: &str) -> Result<Vec<Explanation>, Vec<String>> {
    let of_sample = as_sample(key);
    let known = all_keys();
    let below: Vec<&String> = known.keys().filter(|known| is_within(known, &of_sample)).collect();
    if below.is_empty() && is_taken(&of_sample) {
        let about = "may be left out; no built-in setup states it".to_owned();
        let allowed = texts().find_map(|(name, text)| allowed_in(name, text, &of_sample, "1e12"));
        return Ok(vec![Explanation { unit: unit_of(&of_sample), key: of_sample, about, allowed, values: Vec::new() }]);
    }
    if below.is_empty() {
        let names: Vec<&str> = known.keys().map(String::as_str).collect();
        let last = key.rsplit('.').next().unwrap_or(key);
        let same_end = names.iter().filter(|name| name.rsplit('.').next() == Some(last)).map(|name| (*name).to_owned());
        let mut alike: Vec<String> = same_end.collect();
        alike.extend(nearest(&of_sample, &names).map(str::to_owned));
        alike.dedup();
        return Err(alike);
    }
    // The range of a key takes a whole check of a setup, so a table is listed without ranges.
    let allowed = if below.len() == 1 { allowed } else { |_: &str| None };
    Ok(below.into_iter().map(|key| explanation(key, known[key].clone(), allowed)).collect())
}

fn explanation(key: &str, values: Vec<(&'static str, String)>, allowed: fn(&str) -> Option<String>) -> Explanation {
    Explanation { key: key.to_owned(), about: about(key), unit: unit_of(key), allowed: allowed(key), values }
}

/// Explains every key of the built-in setups.
#[must_use]
pub fn explain_all() -> Vec<Explanation> {
    all_keys().into_iter().map(|(key, values)| explanation(&key, values, allowed)).collect()
}

/// Whether some setup takes a key that none states.
fn is_taken(key: &str) -> bool {
    let is_known = |line: &String| line.trim_start().starts_with(key) && !line.contains("unknown key");
    texts()
        .filter(|(name, _)| *name != "rig")
        .any(|(name, text)| refusals_of(name, text, key, "{ x = 1 }").iter().any(is_known))
}

/// An arm of any name has the keys of the built-in one.
fn as_sample(key: &str) -> String {
    let parts: Vec<&str> = key.split('.').collect();
    match parts.as_slice() {
        ["arms", name, rest @ ..] if !rest.is_empty() && *name != "tc" => {
            ["arms", "vs"].into_iter().chain(rest.iter().copied()).collect::<Vec<_>>().join(".")
        }
        _ => key.to_owned(),
    }
}

/// Whether a key is that of a table or lies below it.
#[must_use]
pub fn is_within(key: &str, table: &str) -> bool {
    key == table || key.strip_prefix(table).is_some_and(|rest| rest.starts_with('.'))
}

/// Every key of the built-in setups with its values.
fn all_keys() -> BTreeMap<String, Vec<(&'static str, String)>> {
    let mut found: BTreeMap<String, Vec<_>> = BTreeMap::new();
    for (name, text) in texts() {
        let layers = Layers::of_text(name, text).unwrap_or_default();
        for setting in layers.effective() {
            found.entry(setting.key).or_default().push((name, setting.value));
        }
    }
    found
}

/// What is allowed, from what refuses something absurd.
fn allowed(key: &str) -> Option<String> {
    let (name, text) = texts().filter(|(name, _)| *name != "rig").find(|(name, text)| {
        Layers::of_text(name, text).is_ok_and(|layers| layers.effective().iter().any(|setting| setting.key == key))
    })?;
    let value = Layers::of_text(name, text).ok()?.effective().into_iter().find(|setting| setting.key == key)?.value;
    let absurd = match value.strip_prefix('[') {
        Some(list) => format!("[{}]", vec!["1e12"; list.split(',').count()].join(", ")),
        None if value.contains('.') || value.parse::<i64>().is_err() => "1e12".to_owned(),
        None => "1000000000000".to_owned(),
    };
    allowed_in(name, text, key, &absurd)
}

fn allowed_in(name: &'static str, text: &str, key: &str, absurd: &str) -> Option<String> {
    let tries = [absurd, "\"?\""].map(|value| refusals_of(name, text, key, value));
    tries.iter().flatten().find_map(|line| {
        let line = line.trim_start().strip_prefix(key)?;
        let range = line.split_once(": allowed are ").map(|(_, range)| range);
        let choice =
            line.split_once("expected ").map(|(_, choice)| choice).filter(|_| line.contains("unknown variant"));
        let said = range.or(choice)?;
        Some(said.split(" [").next().unwrap_or(said).trim_matches('`').replace('`', "").to_owned())
    })
}

/// The comment behind or above a key, or else that of its table; of the first text that has one.
fn about(key: &str) -> String {
    let said = |key: &str| texts().find_map(|(_, text)| comment_of(key, text));
    let of_table = || key.rsplit_once('.').and_then(|(table, _)| Some(format!("of [{table}]: {}", said(table)?)));
    said(key).or_else(of_table).unwrap_or_default()
}

fn comment_of(key: &str, text: &str) -> Option<String> {
    let (mut table, mut above) = ("", Vec::new());
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        let (code, comment) = line.split_once('#').unwrap_or((line, ""));
        let (code, comment) = (code.trim(), comment.trim());
        if code.is_empty() {
            if comment.is_empty() {
                above.clear()
            } else {
                above.push(comment)
            }
            continue;
        }
        let header = code.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).filter(|_| !code.contains('='));
        let here = match header {
            Some(name) => {
                table = name;
                name.to_owned()
            }
            None => format!("{table}.{}", code.split('=').next().unwrap_or_default().trim()),
        };
        let behind: Vec<&str> = std::iter::once(comment).filter(|comment| !comment.is_empty()).collect();
        let mut said = if header.is_some() { [std::mem::take(&mut above), behind].concat() } else { behind };
        while let Some(more) =
            lines.peek().filter(|next| next.starts_with(' ')).and_then(|next| next.trim().strip_prefix('#'))
        {
            said.push(more.trim());
            lines.next();
        }
        if here == key && !said.is_empty() {
            return Some(said.join(" "));
        }
        above.clear();
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_explained_by_comment_unit_range_and_values() {
        let found = explain("servo.speed.linear_max_mm_per_s").unwrap();
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].unit.as_deref(), Some("mm/s"));
        assert_eq!(found[0].allowed.as_deref(), Some("0.001 to 2000 mm/s"));
        assert!(found[0].values.contains(&("sim", "400.0".to_owned())), "{found:?}");
        assert!(found[0].values.contains(&("rig", "100.0".to_owned())), "{found:?}");
        let target = &explain("scene.target").unwrap()[0];
        assert!(target.about.contains("too round"), "{target:?}");
        assert!(target.allowed.as_ref().unwrap().contains("potato"), "{target:?}");
        let start = &explain("arms.left_arm.start_deg").unwrap()[0];
        assert!(start.values.len() > 1, "{start:?}");
        assert!(explain("camera.left.device").unwrap()[0].about.contains("plugged in"));
    }

    #[test]
    fn a_table_lists_its_keys_and_a_typo_names_the_nearest() {
        assert!(explain("servo.speed").unwrap().len() >= 4);
        assert_eq!(explain("servo.speed.linear_max_mm_per_ss").unwrap_err(), ["servo.speed.linear_max_mm_per_s"]);
        assert!(explain("seed").unwrap_err().contains(&"run.seed".to_owned()));
    }
}
