//! The workspace on disk: its root, its files, its packages, and running programs in it.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, bail};

/// Folders without files of the project.
const GENERATED: [&str; 3] = [".git", "target", "out"];

/// The arguments of cargo that name the program of the product.
pub const PROGRAM: [&str; 4] = ["--package", "pb3dp-orchestrator", "--bin", "pb3dp"];

/// The workspace of this program.
pub struct Workspace {
    root: PathBuf,
}

/// One text file of the project.
pub struct SourceFile {
    /// Path inside the workspace, with slashes.
    pub path: String,
    /// Its content.
    pub text: String,
}

impl Workspace {
    /// Finds the root through cargo's environment variable.
    ///
    /// # Errors
    /// If the folder is not the workspace.
    pub fn find() -> anyhow::Result<Self> {
        let package = std::env::var_os("CARGO_MANIFEST_DIR").context("run this program as `cargo xtask <command>`")?;
        let root = Path::new(&package).parent().context("xtask has no parent folder")?.to_path_buf();
        if !root.join("Cargo.toml").is_file() || !root.join("xtask").is_dir() {
            bail!("{} is not the pb3dp workspace: run `cargo xtask <command>` there", root.display());
        }
        Ok(Self { root })
    }

    /// Folder of the root `Cargo.toml`.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// A command that runs in the workspace's root. It does not see what cargo told us about our own package: build scripts that read
    /// the same variables, as that of ring does, would run again whenever cargo is called with and without us in turn.
    pub fn command(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new(program);
        command.current_dir(&self.root);
        let names = std::env::vars_os().map(|(name, _)| name);
        for name in names.filter(|name| name.to_str().is_some_and(is_of_our_package)) {
            command.env_remove(name);
        }
        command
    }

    /// The cargo that runs us.
    pub fn cargo(&self) -> Command {
        self.cargo_after(&[])
    }

    /// The cargo that runs us, with a command prefix: `["nice", "-n", "10"]`.
    pub fn cargo_after(&self, before: &[&str]) -> Command {
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let mut words = before.iter().map(|word| OsString::from(*word)).chain([cargo]);
        let mut command = self.command(words.next().unwrap_or_default());
        command.args(words);
        command
    }

    /// All files of the project (tracked, or new and not ignored), sorted, as paths inside the workspace with slashes.
    ///
    /// # Errors
    /// If the folder cannot be listed.
    pub fn files(&self) -> anyhow::Result<Vec<String>> {
        let mut files = match self.files_known_to_git() {
            Some(files) => files,
            None => self.files_on_disk()?,
        };
        files.sort();
        files.dedup();
        Ok(files)
    }

    /// The tracked symbolic links to folders, as paths inside the workspace. Without git there are none: [`Self::files`] follows them.
    pub fn folder_links(&self) -> Vec<String> {
        let listed = self.output_of("git", &["ls-files", "-z", "--cached"]).unwrap_or_default();
        let is_link = |path: &&str| {
            let path = self.root.join(path);
            path.is_symlink() && path.is_dir()
        };
        listed.split('\0').filter(is_link).map(str::to_owned).collect()
    }

    /// The text files among [`Self::files`] with one of these extensions.
    ///
    /// # Errors
    /// If a file cannot be read as UTF-8.
    pub fn texts(&self, endings: &[&str]) -> anyhow::Result<Vec<SourceFile>> {
        let wanted = |path: &String| endings.iter().any(|ending| path.ends_with(ending));
        self.files()?.into_iter().filter(wanted).map(|path| self.text(path)).collect()
    }

    fn text(&self, path: String) -> anyhow::Result<SourceFile> {
        let text = fs::read_to_string(self.root.join(&path)).with_context(|| format!("cannot read {path} as text"))?;
        Ok(SourceFile { path, text })
    }

    /// `cargo metadata` of the locked dependencies.
    ///
    /// # Errors
    /// If cargo fails: the lock file is out of date, or a package cannot be fetched.
    pub fn metadata(&self) -> anyhow::Result<serde_json::Value> {
        let output = output_of(self.cargo().args(["metadata", "--format-version", "1", "--locked"]))?;
        serde_json::from_str(&output).context("`cargo metadata` did not print JSON")
    }

    /// Cargo's target folder.
    ///
    /// # Errors
    /// Those of [`Self::metadata`].
    pub fn target_folder(&self) -> anyhow::Result<PathBuf> {
        let metadata = self.metadata()?;
        let folder = metadata["target_directory"].as_str().context("`cargo metadata` has no target folder")?;
        Ok(PathBuf::from(folder))
    }

    /// Builds programs, with optimisation or as for tests; returns their folder.
    ///
    /// # Errors
    /// If they do not build.
    pub fn build(&self, is_release: bool, programs: &[&str]) -> anyhow::Result<PathBuf> {
        let profile = is_release.then_some("--release");
        run_visibly(self.cargo().args(["build", "--locked"]).args(profile).args(programs))?;
        Ok(self.target_folder()?.join(if is_release { "release" } else { "debug" }))
    }

    /// The folder of the program `pb3dp`, which is built unless the folder is given.
    ///
    /// # Errors
    /// If it does not build.
    pub fn programs(&self, given: Option<&Path>, is_release: bool) -> anyhow::Result<PathBuf> {
        given.map_or_else(|| self.build(is_release, &PROGRAM), |folder| Ok(folder.to_path_buf()))
    }

    /// The command that builds and runs an example with optimisation; its options follow.
    pub fn example(&self, package: &str, example: &str) -> Command {
        let mut command = self.cargo();
        command.args(["run", "--release", "--locked", "--package", package, "--example", example, "--"]);
        command
    }

    /// Trimmed standard output of a program, `None` if it is missing or fails.
    pub fn output_of(&self, program: &str, args: &[&str]) -> Option<String> {
        output_of(self.command(program).args(args)).ok().map(|text| text.trim().to_owned())
    }

    fn files_known_to_git(&self) -> Option<Vec<String>> {
        if !self.root.join(".git").exists() {
            return None;
        }
        let listed = self.output_of("git", &["ls-files", "-z", "--cached", "--others", "--exclude-standard"])?;
        let exists = |path: &&str| !path.is_empty() && self.root.join(path).is_file();
        Some(listed.split('\0').filter(exists).map(str::to_owned).collect())
    }

    fn files_on_disk(&self) -> anyhow::Result<Vec<String>> {
        let mut files = Vec::new();
        let mut folders = vec![self.root.clone()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(&folder).with_context(|| format!("cannot list {}", folder.display()))? {
                let path = entry?.path();
                let relative = path.strip_prefix(&self.root)?.to_string_lossy().replace('\\', "/");
                if GENERATED.contains(&relative.as_str()) {
                    continue;
                }
                if path.is_dir() { folders.push(path) } else { files.push(relative) }
            }
        }
        Ok(files)
    }
}

/// Runs a program with this terminal's input and output.
///
/// # Errors
/// If it cannot be started or fails; the message contains the command.
pub fn run_visibly(command: &mut Command) -> anyhow::Result<()> {
    let shown = shown(command);
    println!("$ {shown}");
    let status = command.status().with_context(|| format!("cannot start `{shown}`"))?;
    if !status.success() {
        bail!("`{shown}` failed ({status})");
    }
    Ok(())
}

/// Standard output of a command.
///
/// # Errors
/// If it does not start, prints no text, or fails; then with its standard error.
pub fn output_of(command: &mut Command) -> anyhow::Result<String> {
    let output = command.stdin(Stdio::null()).output().with_context(|| format!("cannot start `{}`", shown(command)))?;
    if !output.status.success() {
        bail!("`{}` failed: {}", shown(command), String::from_utf8_lossy(&output.stderr).trim_end());
    }
    String::from_utf8(output.stdout).with_context(|| format!("`{}` printed no text", shown(command)))
}

/// The command as typed in a shell, with its environment variables.
fn shown(command: &Command) -> String {
    let quoted = |text: &OsStr| {
        let text = text.to_string_lossy();
        if text.contains(' ') { format!("\"{text}\"") } else { text.into_owned() }
    };
    let variables = command.get_envs().filter_map(|(k, v)| v.map(|v| format!("{}={}", k.to_string_lossy(), quoted(v))));
    let program = Path::new(command.get_program()).file_stem().unwrap_or(command.get_program());
    let words = std::iter::once(quoted(program)).chain(command.get_args().map(quoted));
    variables.chain(words).collect::<Vec<_>>().join(" ")
}

/// Whether cargo sets this variable for the package that it runs.
fn is_of_our_package(name: &str) -> bool {
    name.starts_with("CARGO_PKG_") || name.starts_with("CARGO_MANIFEST_")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn here() -> Workspace {
        Workspace { root: Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("a parent").to_path_buf() }
    }

    /// As if no cargo had started us: otherwise half of the workspace would be built again after each `cargo xtask`.
    #[test]
    fn commands_do_not_see_our_package() {
        let command = here().cargo();
        let removed = |wanted: &str| command.get_envs().any(|(name, value)| name == wanted && value.is_none());
        assert!(removed("CARGO_MANIFEST_DIR") && removed("CARGO_PKG_NAME"));
    }

    #[test]
    fn a_command_is_shown_as_one_types_it() {
        let mut command = Command::new("/somewhere/bin/cargo");
        command.args(["doc", "--no-deps"]).env("RUSTDOCFLAGS", "-D warnings");
        assert_eq!(shown(&command), "RUSTDOCFLAGS=\"-D warnings\" cargo doc --no-deps");
    }

    #[test]
    fn a_failing_program_is_an_error_with_its_command() {
        let error = run_visibly(here().cargo().arg("no-such-command-of-ours").stderr(Stdio::null()))
            .expect_err("it cannot succeed");
        assert!(error.to_string().contains("cargo no-such-command-of-ours"), "{error}");
    }

    #[test]
    fn the_walk_finds_what_git_finds_and_nothing_generated() {
        let on_disk = here().files_on_disk().expect("readable");
        assert!(on_disk.iter().any(|path| path == "xtask/src/workspace.rs"));
        assert!(on_disk.iter().all(|path| !path.starts_with("target/") && !path.starts_with(".git/")));
        if let Some(known) = here().files_known_to_git() {
            assert!(known.iter().any(|path| path == "xtask/src/main.rs"));
        }
    }
}
