//! The parameter tables and the configuration agree: every key of the estimator's file is in the document of the
//! parameters, with the same default.

use crate::violation::Violation;
use crate::workspace::SourceFile;

const DOCUMENT: &str = "docs/parameters.md";
const FILE: &str = "configs/estimator.toml";
/// Keys of this table are in the document without its name, other keys with the name of their table.
const SECTION: &str = "published";

/// Compares document and file; both are required.
pub fn check(texts: &[SourceFile]) -> Vec<Violation> {
    let find = |path: &str| texts.iter().find(|file| file.path == path).map(|file| file.text.as_str());
    let (document, file) = match (find(DOCUMENT), find(FILE)) {
        (Some(document), Some(file)) => (document, file),
        (None, None) => return Vec::new(),
        (found, _) => {
            let missing = if found.is_none() { DOCUMENT } else { FILE };
            return vec![Violation::of(missing, "method-table", "is missing: both document and file are needed")];
        }
    };
    let Ok(table) = file.parse::<toml::Table>() else { return Vec::new() };
    let mut parameters = Vec::new();
    for (name, section) in &table {
        flatten(if name == SECTION { "" } else { name }, section, &mut parameters);
    }
    let rows: Vec<(&str, &str)> = document.lines().filter_map(row).collect();
    let mut violations = Vec::new();
    for (key, value) in &parameters {
        match rows.iter().find(|(name, _)| name == key) {
            Some((_, shown)) if same(shown, value) => {}
            Some((_, shown)) => {
                let message = format!("`{key}` is {shown} here and {value} in {FILE}");
                violations.push(Violation::of(DOCUMENT, "method-table", message));
            }
            None => violations.push(Violation::of(DOCUMENT, "method-table", format!("`{key}` of {FILE} has no row"))),
        }
    }
    let unknown = rows.iter().filter(|(name, _)| name.contains('.') && !parameters.iter().any(|(key, _)| key == name));
    violations.extend(
        unknown.map(|(name, _)| Violation::of(DOCUMENT, "method-table", format!("`{name}` is not a key of {FILE}"))),
    );
    violations
}

/// Key and default of a table row that starts with a key in backticks.
fn row(line: &str) -> Option<(&str, &str)> {
    let (key, rest) = line.strip_prefix("| `")?.split_once("` | ")?;
    Some((key, rest.split(" |").next()?.trim()))
}

fn flatten(prefix: &str, value: &toml::Value, parameters: &mut Vec<(String, String)>) {
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                let key = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
                flatten(&key, value, parameters);
            }
        }
        toml::Value::String(text) => parameters.push((prefix.to_owned(), text.clone())),
        other => parameters.push((prefix.to_owned(), other.to_string())),
    }
}

fn same(shown: &str, value: &str) -> bool {
    match (shown.parse::<f64>(), value.parse::<f64>()) {
        (Ok(a), Ok(b)) => (a - b).abs() < 1e-9,
        _ => shown == value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn messages(document: &str, file: &str) -> Vec<String> {
        let text = |path: &str, text: &str| SourceFile { path: path.to_owned(), text: text.to_owned() };
        check(&[text(DOCUMENT, document), text(FILE, file)]).into_iter().map(|v| v.message).collect()
    }

    #[test]
    fn document_and_file_must_agree() {
        let file = "[published.hue]\nsaturation_min = 0.15\n[published.rmga]\ncoding = \"gray\"\n";
        let document =
            "| `hue.saturation_min` | 0.150 | gate |\n| `rmga.coding` | gray | genes |\n| `ok` | a status |\n";
        assert_eq!(messages(document, file), [""; 0]);
        assert!(messages(&document.replace("0.150", "0.2"), file)[0].contains("0.2 here and 0.15"));
        assert!(messages(&document.replace("rmga.coding", "rmga.code"), file).len() == 2);
        let both = format!("{file}[other]\npoints = 7\n");
        assert_eq!(messages(document, &both), ["`other.points` of configs/estimator.toml has no row"]);
        assert_eq!(messages(&format!("{document}| `other.points` | 7 | count |\n"), &both), [""; 0]);
    }

    #[test]
    fn neither_document_nor_file_may_go_alone() {
        for path in [DOCUMENT, FILE] {
            let alone = [SourceFile { path: path.to_owned(), text: String::new() }];
            let missing: Vec<_> = check(&alone).into_iter().map(|v| v.to_string()).collect();
            assert!(missing.len() == 1 && missing[0].contains("is missing"), "{missing:?}");
        }
        assert!(check(&[]).is_empty());
    }
}
