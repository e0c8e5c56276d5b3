//! The setup options of a command.

use std::path::{Path, PathBuf};

use clap::Args;

/// Options of every command that reads a setup.
#[derive(Clone, Debug, Default, Args)]
pub struct SetupArgs {
    /// A TOML file or a built-in setup (sim, playground, hil, rig, bare, published); may be repeated, later ones override.
    #[arg(long = "config", value_name = "FILE|NAME", required = true)]
    pub configs: Vec<PathBuf>,
    /// Set one key, for instance `scene.target=card`; may be repeated. `pb3dp config explain KEY` describes a key.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Keys set by other options: option, key, value.
    #[arg(skip)]
    pub by_options: Vec<(&'static str, &'static str, String)>,
}

impl SetupArgs {
    /// One file only.
    pub fn of_file(file: &Path) -> Self {
        Self { configs: vec![file.to_path_buf()], ..Self::default() }
    }

    /// Adds a key that an option of its own sets, with the highest precedence; without a value, no change.
    #[must_use]
    pub fn with(mut self, option: &'static str, key: &'static str, value: Option<String>) -> Self {
        self.by_options.extend(value.map(|value| (option, key, value)));
        self
    }

    /// The first file or name, which represents the setup in messages.
    pub fn name(&self) -> &Path {
        self.configs.first().map_or(Path::new("(no setup)"), PathBuf::as_path)
    }

    /// The same options as command-line arguments.
    pub fn words(&self) -> Vec<std::ffi::OsString> {
        let configs = self.configs.iter().flat_map(|file| ["--config".into(), file.clone().into_os_string()]);
        configs.chain(self.set.iter().flat_map(|set| ["--set".into(), set.into()])).collect()
    }
}

impl std::fmt::Display for SetupArgs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let configs: Vec<String> = self.configs.iter().map(|file| file.display().to_string()).collect();
        f.write_str(&configs.join(" + "))?;
        self.set.iter().try_for_each(|set| write!(f, " --set {set}"))
    }
}
