//! Files in `configs/`: each must parse. The crates that read them check their values.

use super::deploy;
use crate::violation::Violation;

/// Checks one file below `configs/`.
pub fn check(path: &str, text: &str) -> Vec<Violation> {
    let problem = match path.rsplit('.').next() {
        _ if path.starts_with("configs/deploy/") => match deploy::check(path, text) {
            Some(judged) => judged.err(),
            None => Some("only .rules, .service and .conf belong here".to_owned()),
        },
        Some("toml") => text.parse::<toml::Table>().err().map(|error| error.to_string()),
        Some("urdf") => robot_description(text).err(),
        Some("json") => serde_json::from_str::<serde_json::Value>(text).err().map(|error| error.to_string()),
        Some("md") => None,
        _ => Some("only .toml, .urdf, .json and .md belong here".to_owned()),
    };
    problem.into_iter().map(|problem| Violation::of(path, "config-parses", problem)).collect()
}

/// Well-formed XML whose root is one `<robot>` with at least one link.
fn robot_description(text: &str) -> Result<(), String> {
    let document = roxmltree::Document::parse(text).map_err(|error| error.to_string())?;
    let root = document.root_element();
    if !root.has_tag_name("robot") {
        return Err(format!("the root element is <{}>: a robot description has <robot>", root.tag_name().name()));
    }
    let has_link = root.children().any(|child| child.has_tag_name("link"));
    has_link.then_some(()).ok_or_else(|| "<robot> has no <link>".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn broken_configurations_are_caught() {
        for (path, text) in [
            ("configs/a.toml", "key = = 1"),
            ("configs/a.json", "{"),
            ("configs/a.urdf", "<robot><link></robot>"),
            ("configs/a.urdf", "<robot><link/>"),
            ("configs/a.urdf", "<model><link/></model>"),
            ("configs/a.urdf", "<robot/>"),
            ("configs/a.ini", "[a]"),
            ("configs/deploy/a.ini", "[a]"),
            ("configs/deploy/a.rules", "MODE=0660"),
        ] {
            assert_eq!(check(path, text).len(), 1, "{path}: {text}");
        }
    }

    #[test]
    fn good_configurations_pass() {
        for (path, text) in [
            ("configs/a.toml", "[camera]\nbaseline_mm = 100.0"),
            (
                "configs/a.urdf",
                "<?xml version=\"1.0\"?>\n<!-- note -->\n<robot name=\"a\"><link name=\"base\"/></robot>\n",
            ),
        ] {
            assert_eq!(check(path, text), [], "{path}");
        }
    }
}
