//! Errors of refused configurations, and the kinds of configuration files.

use std::path::{Path, PathBuf};

use pb3dp_record::text_file::read_text;

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("configuration {file}: cannot be read", file = file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// The reason.
        #[source]
        source: std::io::Error,
    },
    /// The file is another kind of configuration.
    #[error("configuration {file}: this is {found}, but {wanted} is needed here", file = file.display())]
    OtherKind {
        /// Its kind.
        file: PathBuf,
        /// The found kind.
        found: FileKind,
        /// The needed kind.
        wanted: FileKind,
    },
    /// The text is not valid TOML.
    #[error("configuration {place}: {reason}", place = place.display())]
    Syntax {
        /// File, line and column.
        place: PathBuf,
        /// Message of the parser.
        reason: String,
    },
    /// Neither a file nor a built-in setup.
    #[error("configuration {name}: there is no such file, and no built-in setup of this name; built-in are {known}")]
    NoSuchSetup {
        /// The given name.
        name: String,
        /// The built-in names.
        known: String,
    },
    /// Keys are unknown, missing or of the wrong type, or values are out of range. One line per key.
    #[error("configuration {file}:\n{lines}", file = file.display())]
    Values {
        /// The file.
        file: PathBuf,
        /// One line per key.
        lines: String,
    },
}

impl ConfigError {
    /// The same for values of a file that the user knows by this name.
    #[must_use]
    pub fn named(self, name: &Path) -> Self {
        match self {
            Self::Values { lines, .. } => Self::Values { file: name.to_path_buf(), lines },
            other => other,
        }
    }
}

/// Kind of a configuration file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// Parameters of the estimators, for `pb3dp estimate` and `pb3dp track`.
    Estimator,
    /// A complete setup, for `pb3dp run`.
    Setup,
    /// A gateway, for `pb3dp gateway`.
    Gateway,
    /// One arm, for setups that refer to it.
    Arm,
}

impl FileKind {
    pub(crate) const ALL: [Self; 4] = [Self::Estimator, Self::Setup, Self::Gateway, Self::Arm];

    /// A table that only this kind has.
    pub(crate) fn own_table(self) -> &'static str {
        match self {
            Self::Estimator => "published",
            Self::Setup => "arms",
            Self::Gateway => "bus",
            Self::Arm => "named_arm",
        }
    }
}

impl std::fmt::Display for FileKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Estimator => "a file of estimator parameters (as configs/estimator.toml)",
            Self::Setup => "a setup of `pb3dp run` (as configs/sim.toml)",
            Self::Gateway => "a gateway (as configs/gateway.toml)",
            Self::Arm => "an arm (as configs/arms/ur5e.toml)",
        })
    }
}

/// Reads a configuration file.
///
/// # Errors
/// If the file cannot be read.
pub(crate) fn text_of(file: &Path) -> Result<String, ConfigError> {
    read_text(file).map_err(|source| ConfigError::Unreadable { file: file.to_path_buf(), source })
}
