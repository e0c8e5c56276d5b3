//! Meaning of a key: from the comments of the built-in setups and from the checks of its value, so that nothing is stated twice.

use std::collections::BTreeMap;

use crate::layers::built_in_keys::{Values, all_keys, texts};
use crate::load::{nearest, removed, unit_of};
use crate::setup::{camera_faults, refusals_of};

/// Keys that mean the same in each table of their kind, which has the comment.
const OF_MANY_TABLES: [(&str, &str); 5] = [
    ("action", "what the supervisor does about it (docs/supervisor.md)"),
    ("resume", "whether the hand continues when the cause is gone, or after the command `resume`"),
    ("for_s", "time for which it must last before it counts"),
    ("translation_mm", "translation [x, y, z]"),
    ("rotation_vector_deg", "rotation as axis times angle [x, y, z]"),
];

/// A list that no built-in setup has, and whose elements differ in their keys.
const FAULTS: &str = "camera.faults";

/// Meaning, unit, range and built-in values of one key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Explanation {
    /// The key.
    pub key: String,
    /// The comment of the key in the built-in setups, or else that of its table.
    pub about: String,
    /// The unit of the value.
    pub unit: Option<String>,
    /// The allowed range or choice, if it is limited.
    pub allowed: Option<String>,
    /// Values in the built-in setups: name and value.
    pub values: Vec<(&'static str, String)>,
}

/// Explains a key, all keys of a table, or all keys with a word in their name or else in their comment. Any name of an arm is accepted.
///
/// # Errors
/// The most similar keys, if no built-in setup has this one.
pub fn explain(key: &str) -> Result<Vec<Explanation>, Vec<String>> {
    let of_sample = as_sample(key);
    let known = all_keys();
    let below: Vec<&String> = known.keys().filter(|known| is_within(known, &of_sample)).collect();
    if is_within(&of_sample, FAULTS) {
        let about = format!("may be left out; {}", camera_faults::help());
        return Ok(vec![Explanation { key: FAULTS.to_owned(), about, unit: None, allowed: None, values: Vec::new() }]);
    }
    if let Some(about) = removed(&of_sample) {
        return Ok(vec![Explanation { key: of_sample, about, unit: None, allowed: None, values: Vec::new() }]);
    }
    if below.is_empty() && is_taken(&of_sample) {
        let about = "may be left out; no built-in setup states it".to_owned();
        let allowed = texts().find_map(|(name, text)| allowed_in(name, text, &of_sample, "1e12"));
        return Ok(vec![Explanation { unit: unit_of(&of_sample), key: of_sample, about, allowed, values: Vec::new() }]);
    }
    let below = if below.is_empty() { mentioning(&of_sample, known) } else { below };
    if below.is_empty() {
        let names: Vec<&str> = known.keys().map(String::as_str).collect();
        return Err(nearest(&of_sample, &names).map(str::to_owned).into_iter().collect());
    }
    // The range of a key needs a complete check of a setup, so a table is listed without ranges.
    let allowed = if below.len() == 1 { allowed } else { |_: &str, _: &Values| None };
    Ok(below.into_iter().map(|key| explanation(key, known[key].clone(), allowed)).collect())
}

/// Keys with this word in their name, or else in their own comment.
fn mentioning<'a>(word: &str, known: &'a BTreeMap<String, Values>) -> Vec<&'a String> {
    let named: Vec<&String> = known.keys().filter(|key| key.contains(word)).collect();
    if !named.is_empty() {
        return named;
    }
    let is_about = |key: &&String| own_comment(key).is_some_and(|comment| comment.to_lowercase().contains(word));
    known.keys().filter(is_about).collect()
}

fn explanation(key: &str, values: Values, allowed: fn(&str, &Values) -> Option<String>) -> Explanation {
    let allowed = allowed(key, &values);
    Explanation { key: key.to_owned(), about: about(key), unit: unit_of(key), allowed, values }
}

/// Explains every key of the built-in setups.
#[must_use]
pub fn explain_all() -> Vec<Explanation> {
    all_keys().iter().map(|(key, values)| explanation(key, values.clone(), allowed)).collect()
}

/// Whether a setup accepts a key that no built-in setup has.
fn is_taken(key: &str) -> bool {
    let is_known = |line: &String| line.trim_start().starts_with(key) && !line.contains("unknown key");
    texts()
        .filter(|(name, _)| *name != "rig")
        .any(|(name, text)| refusals_of(name, text, key, "{ x = 1 }").iter().any(is_known))
}

/// Replaces the name of an arm by that of the built-in one.
fn as_sample(key: &str) -> String {
    let parts: Vec<&str> = key.split('.').collect();
    match parts.as_slice() {
        ["arms", name, rest @ ..] if !rest.is_empty() && *name != "tc" => {
            ["arms", "vs"].into_iter().chain(rest.iter().copied()).collect::<Vec<_>>().join(".")
        }
        _ => key.to_owned(),
    }
}

/// Whether a key is that of a table or below it.
#[must_use]
pub fn is_within(key: &str, table: &str) -> bool {
    key == table || key.strip_prefix(table).is_some_and(|rest| rest.starts_with('.'))
}

/// The allowed values, from the refusal of an absurd value.
fn allowed(key: &str, values: &Values) -> Option<String> {
    let (name, value) = values.iter().find(|(name, _)| *name != "rig")?;
    let (name, text) = texts().find(|(other, _)| other == name)?;
    let absurd = match value.strip_prefix('[') {
        Some(list) => format!("[{}]", vec!["1e12"; list.split(',').count()].join(", ")),
        None if value.contains('.') || value.parse::<i64>().is_err() => "1e12".to_owned(),
        None => "1000000000000".to_owned(),
    };
    allowed_in(name, text, key, &absurd)
}

fn allowed_in(name: &'static str, text: &str, key: &str, absurd: &str) -> Option<String> {
    let mut lines = [absurd, "\"?\""].into_iter().flat_map(|value| refusals_of(name, text, key, value));
    lines.find_map(|line| {
        let line = line.trim_start().strip_prefix(key)?;
        let range = line.split_once(": allowed are ").map(|(_, range)| range);
        let choice =
            line.split_once("expected ").map(|(_, choice)| choice).filter(|_| line.contains("unknown variant"));
        let sentence = range.or(choice)?;
        Some(sentence.split(" [").next().unwrap_or(sentence).trim_matches('`').replace('`', "").to_owned())
    })
}

/// The comment behind or above a key, or else that of its table, from the first text that has one.
fn about(key: &str) -> String {
    // Both arms of the built-in setups have the same keys; the first one has the comments.
    let of_twin = key.strip_prefix("arms.tc.").map_or_else(|| key.to_owned(), |rest| format!("arms.vs.{rest}"));
    let of_table = || {
        let (table, name) = of_twin.rsplit_once('.')?;
        let own = OF_MANY_TABLES.iter().find(|(known, _)| *known == name).map_or("", |(_, meaning)| meaning);
        let separator = if own.is_empty() { "" } else { "; " };
        Some(format!("{own}{separator}of [{table}]: {}", own_comment(table)?))
    };
    own_comment(key).or_else(|| own_comment(&of_twin)).or_else(of_table).unwrap_or_default()
}

/// The comment of this very key or table.
fn own_comment(key: &str) -> Option<String> {
    texts().find_map(|(_, text)| comment_of(key, text))
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
        let mut sentence = match header.is_some() || behind.is_empty() {
            true => [std::mem::take(&mut above), behind].concat(),
            false => behind,
        };
        while let Some(more) =
            lines.peek().filter(|next| next.starts_with(' ')).and_then(|next| next.trim().strip_prefix('#'))
        {
            sentence.push(more.trim());
            lines.next();
        }
        if here == key && !sentence.is_empty() {
            return Some(sentence.join(" "));
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
        assert!(target.about.contains("rejects it"), "{target:?}");
        assert!(target.allowed.as_ref().unwrap().contains("potato"), "{target:?}");
        let start = &explain("arms.left_arm.start_deg").unwrap()[0];
        assert!(start.values.len() > 1, "{start:?}");
        assert!(explain("camera.left.device").unwrap()[0].about.contains("USB port"));
        for key in ["camera.faults", "camera.faults.0.kind", "camera.faults.share"] {
            let about = &explain(key).unwrap()[0].about;
            assert!(about.contains("dropped (share)") && about.contains("frozen, black (cameras)"), "{about}");
        }
    }

    #[test]
    fn a_table_lists_its_keys_and_a_typo_names_the_nearest() {
        assert!(explain("servo.speed").unwrap().len() >= 4);
        assert_eq!(explain("servo.speed.linear_max_mm_per_ss").unwrap_err(), ["servo.speed.linear_max_mm_per_s"]);
        for key in ["arms.vs.bus", "arms.left_arm.bus.port", "arms.tc.gateway.certificate"] {
            let about = &explain(key).unwrap()[0].about;
            assert!(about.starts_with("this key is gone: "), "{key}: {about}");
        }
    }

    #[test]
    fn a_word_lists_the_keys_that_mention_it() {
        let seeds = explain("seed").unwrap();
        assert!(seeds.iter().any(|found| found.key == "run.seed"), "{seeds:?}");
        assert!(seeds.iter().all(|found| found.key.contains("seed")), "{seeds:?}");
        let round = explain("millimetres off").unwrap();
        assert!(round.iter().any(|found| found.key == "scene.target"), "{round:?}");
        assert_eq!(explain("nothing has this").unwrap_err(), Vec::<String>::new());
    }
}
