//! Messages of the program in the guest on its console.

/// A message; the guest's `report.rs` has the same words.
#[derive(Debug, PartialEq, Eq)]
pub enum Said {
    /// A check passed.
    Passed(String),
    /// A check failed.
    Failed(String),
    /// A note.
    Note(String),
    /// Unplug the device of this name.
    Unplug(String),
    /// Plug the device in again.
    Plug(String),
    /// The tests are over.
    End {
        /// Number of tests.
        checks: u32,
    },
}

/// Parses a line of the console; `None` for lines of the kernel.
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
        // Kernel output before it on the line does not hide it.
        assert_eq!(parse("\u{1b}[0mvm: plug host"), Some(Said::Plug("host".into())));
        for other in ["", "[    0.1] Linux version 6.1", "vm: end", "vm: end soon", "vm: passe"] {
            assert_eq!(parse(other), None, "{other}");
        }
    }
}
