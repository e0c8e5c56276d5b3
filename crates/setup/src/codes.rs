//! Codes of refused configurations.

use pb3dp_message_codes::codes;

use crate::error::ConfigError;

codes! {
    ConfigError, "A configuration is refused" {
        Unreadable = "PB3DP-CFG-001": "A configuration file does not exist or cannot be read."; "Check the path and the permissions. `--config` also takes the name of a built-in setup.";
        OtherKind = "PB3DP-CFG-002": "The file is a configuration of another kind, for instance of a gateway where a setup is needed."; "Name a file of the kind that the message asks for. `pb3dp config init` prints one.";
        Syntax = "PB3DP-CFG-003": "The text is not valid TOML."; "Correct the file at the line and column of the message.";
        NoSuchSetup = "PB3DP-CFG-004": "There is neither a file nor a built-in setup of this name."; "Use one of the names that the message lists, or a path with an ending or a slash.";
        Values = "PB3DP-CFG-005": "Keys are unknown, missing or of the wrong type, or values are out of range."; "Correct each line of the message. `pb3dp config explain KEY` prints meaning, unit and range of a key.";
    }
}
