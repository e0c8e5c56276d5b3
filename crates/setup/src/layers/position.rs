//! Positions of keys in a TOML text: line and column, both from 1.

use std::collections::BTreeMap;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Line and column of every key of a text: `camera.faults[1].share`.
pub(super) type Positions = BTreeMap<String, (usize, usize)>;

/// The parts of a key: `camera.faults[0].share` is `camera`, `faults`, `0`, `share`.
pub(super) fn parts(key: &str) -> Vec<&str> {
    key.split(['.', '[']).map(|part| part.trim_end_matches(']')).filter(|part| !part.is_empty()).collect()
}

/// All keys of a text, with what it has been parsed to.
pub(super) fn all(text: &str, root: &DeTable<'_>) -> Positions {
    let mut found = Positions::new();
    of_table("", root, &Lines::of(text), &mut found);
    found
}

fn of_table(prefix: &str, table: &DeTable<'_>, lines: &Lines<'_>, found: &mut Positions) {
    for (name, value) in table {
        let key = if prefix.is_empty() { name.get_ref().to_string() } else { format!("{prefix}.{}", name.get_ref()) };
        found.insert(key.clone(), lines.position(name.span().start));
        of_value(&key, value, lines, found);
    }
}

fn of_value(key: &str, value: &Spanned<DeValue<'_>>, lines: &Lines<'_>, found: &mut Positions) {
    match value.get_ref() {
        DeValue::Table(table) => of_table(key, table, lines, found),
        DeValue::Array(items) => {
            for (index, item) in items.iter().enumerate() {
                let key = format!("{key}[{index}]");
                found.insert(key.clone(), lines.position(item.span().start));
                of_value(&key, item, lines, found);
            }
        }
        _ => {}
    }
}

/// A text by its lines: a setup asks for the position of each of its keys.
struct Lines<'a> {
    text: &'a str,
    /// Where each line but the first begins.
    starts: Vec<usize>,
}

impl<'a> Lines<'a> {
    fn of(text: &'a str) -> Self {
        Self { text, starts: text.match_indices('\n').map(|(end, _)| end + 1).collect() }
    }

    /// Line and column of a byte.
    fn position(&self, at: usize) -> (usize, usize) {
        let at = at.min(self.text.len());
        let number = self.starts.partition_point(|start| *start <= at);
        let start = number.checked_sub(1).map_or(0, |line| self.starts[line]);
        let before = self.text.get(start..at).unwrap_or_default();
        (number + 1, before.chars().count() + 1)
    }
}

/// Line and column of a byte of a text.
pub(super) fn line_and_column(text: &str, at: usize) -> (usize, usize) {
    Lines::of(text).position(at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_found_in_tables_lists_and_dotted_keys() {
        let text = "a.b = 1\n\n[camera]\nfaults = [\n  { kind = \"x\" },\n  { kind = \"y\", share = 2 },\n]\n[[list]]\nk = [1, 22]\n";
        let found = all(text, DeTable::parse(text).unwrap().get_ref());
        for (key, at) in
            [("a.b", (1, 3)), ("camera", (3, 2)), ("camera.faults[1].share", (6, 17)), ("list[0].k[1]", (9, 9))]
        {
            assert_eq!(found.get(key), Some(&at), "{key}");
        }
        for missing in ["b", "camera.no", "camera.faults[2]", "list[0].k[1].x"] {
            assert_eq!(found.get(missing), None, "{missing}");
        }
    }
}
