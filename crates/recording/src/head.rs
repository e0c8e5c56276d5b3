//! What a recording states before its first step and pair: version, settings with their files, and the begin of the run.

use std::path::Path;

use anyhow::{Result, bail};
use pb3dp_bag::messages::Text;
use pb3dp_bag::pairs::decoded;
use pb3dp_bag::reader::RawMessage;
use pb3dp_bag::run_messages::{RunBegin, SetupFile, SetupFiles};
use pb3dp_bag::topics::ours;
use pb3dp_estimation_core::status::SCHEMA_VERSION;

/// Topics of the head.
pub const TOPICS: [&str; 5] = [ours::VERSION, ours::SCHEMA_VERSION, ours::SETUP, ours::FILES, ours::BEGIN];

/// What has been read so far.
#[derive(Default)]
pub struct Head {
    /// Version of the program that has recorded it.
    pub version: String,
    /// Files that the settings name.
    pub files: Vec<SetupFile>,
    setup_text: Option<String>,
    begin: Option<RunBegin>,
}

impl Head {
    /// Takes a message of the head; returns whether it was one.
    ///
    /// # Errors
    /// A damaged message, or a form of results that this version does not know.
    pub fn take(&mut self, message: &RawMessage) -> Result<bool> {
        match message.channel.topic.as_str() {
            ours::VERSION => self.version = decoded::<Text>(message)?.data,
            ours::SCHEMA_VERSION => check_schema(&decoded::<Text>(message)?.data)?,
            ours::SETUP => self.setup_text = Some(decoded::<Text>(message)?.data),
            ours::FILES => self.files = decoded::<SetupFiles>(message)?.files,
            ours::BEGIN => self.begin = Some(decoded(message)?),
            _ => return Ok(false),
        }
        Ok(true)
    }

    /// The settings, as a TOML file, and the begin.
    ///
    /// # Errors
    /// If one of them is missing: the file is no recording of a run.
    pub fn run(&mut self, file: &Path) -> Result<(String, RunBegin)> {
        match (self.setup_text.take(), self.begin.take()) {
            (Some(setup_text), Some(begin)) => Ok((setup_text, begin)),
            _ => bail!(
                "{}: no recording of a run: {} or {} is missing; `pb3dp run --record FILE.mcap` records one, and `pb3dp track --sequence` \
                 estimates from the images of any recording",
                file.display(),
                ours::SETUP,
                ours::BEGIN
            ),
        }
    }
}

/// Recordings of before this number existed have the first form.
fn check_schema(found: &str) -> Result<()> {
    match found.parse::<u32>() {
        Ok(number) if number <= SCHEMA_VERSION => Ok(()),
        _ => bail!(
            "{} is {found:?}: this version reads recordings up to {SCHEMA_VERSION}; open it with the version that recorded it",
            ours::SCHEMA_VERSION
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_of_a_later_form_is_refused_by_its_number() {
        assert!(check_schema("1").is_ok());
        for later in ["2", "-1", ""] {
            let refused = check_schema(later).unwrap_err().to_string();
            assert!(refused.contains(&format!("/pb3dp/schema_version is {later:?}")), "{refused}");
            assert!(refused.contains("up to 1; open it with"), "{refused}");
        }
    }
}
