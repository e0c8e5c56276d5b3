//! Files in `configs/`: each must parse. The crates that read them check their values.

use quick_xml::Reader;
use quick_xml::events::Event;

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
    let mut reader = Reader::from_str(text);
    let (mut depth, mut roots, mut links) = (0_usize, Vec::new(), 0_usize);
    loop {
        let event = reader.read_event();
        let event = event.map_err(|error| format!("byte {}: {error}", reader.error_position()))?;
        let tag = match &event {
            Event::Start(tag) | Event::Empty(tag) => Some(String::from_utf8_lossy(tag.name().as_ref()).into_owned()),
            _ => None,
        };
        if let Some(name) = tag {
            if depth == 0 {
                roots.push(name.clone());
            }
            links += usize::from(name == "link" && depth == 1);
        }
        match event {
            Event::Start(_) => depth += 1,
            Event::End(_) => depth = depth.saturating_sub(1),
            Event::Eof if depth > 0 => return Err("the file ends inside an element".to_owned()),
            Event::Eof => break,
            _ => {}
        }
    }
    match roots.as_slice() {
        [root] if root == "robot" && links > 0 => Ok(()),
        [root] if root == "robot" => Err("<robot> has no <link>".to_owned()),
        _ => Err(format!("the root elements are {roots:?}: a robot description has one, <robot>")),
    }
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
