//! What the program in the guest says on its console.

/// What it can say; the same words stand in the guest's `report.rs`.
#[derive(Debug, PartialEq, Eq)]
pub enum Said {
    /// A check passed.
    Passed(String),
    /// A check failed.
    Failed(String),
    /// Something to be told.
    Note(String),
    /// Pull the device of this name out.
    Unplug(String),
    /// Plug it in again.
    Plug(String),
    /// The tests are over.
    End {
        /// How many there were.
        checks: u32,
    },
}

/// A line of the console, if it is from the program and not from the kernel.
pub fn parse(line: &str) -> Option<Said> {
    let (_, said) = line.split_once("vm: ")?;
    let (word, rest) = said.split_once(' ').unwrap_or((said, ""));
    let rest = rest.to_owned();
    match word {
        "passed" => Some(Said::Passed(rest)),
        "failed" => Some(Said::Failed(rest)),
        "note" => Some(Said::Note(rest)),
        "unplug" => Some(Said::Unplug(rest)),
        "plug" => Some(Said::Plug(rest)),
        "end" => Some(Said::End { checks: rest.parse().ok()? }),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_of_the_program_are_found() {
        assert_eq!(parse("vm: passed ports are found: 3"), Some(Said::Passed("ports are found: 3".into())));
        assert_eq!(parse("vm: unplug host"), Some(Said::Unplug("host".into())));
        assert_eq!(parse("vm: end 12"), Some(Said::End { checks: 12 }));
        // What the kernel has left on the line before does not hide it.
        assert_eq!(parse("\u{1b}[0mvm: plug host"), Some(Said::Plug("host".into())));
        for other in ["", "[    0.1] Linux version 6.1", "vm: end", "vm: end soon", "vm: passe"] {
            assert_eq!(parse(other), None, "{other}");
        }
    }
}
