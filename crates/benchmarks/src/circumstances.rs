//! Commit, processor and compiler of a measurement.

use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

/// Files that the measurements write: one page must not make the next report uncommitted changes.
const WRITTEN: [&str; 2] = [":(exclude)docs/benchmarks", ":(exclude)docs/images"];

/// Machine, compiler and commit of a measurement; `unknown` if not available.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Circumstances {
    /// Commit of the workspace.
    pub commit: String,
    /// Whether files differ from the commit, except those that measurements write.
    pub changed: bool,
    /// Name of the processor.
    pub processor: String,
    /// The compiler.
    pub compiler: String,
}

impl Circumstances {
    /// The circumstances of this machine and of the workspace at `root`.
    pub fn of(root: &Path) -> Self {
        let output_of = |program: &str, args: &[&str]| {
            let output = Command::new(program).args(args).current_dir(root).output().ok()?;
            let text = String::from_utf8(output.stdout).ok()?;
            output.status.success().then(|| text.trim().to_owned())
        };
        let unknown = || "unknown".to_owned();
        let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").ok();
        Self {
            commit: output_of("git", &["rev-parse", "--short=12", "HEAD"]).unwrap_or_else(unknown),
            changed: output_of(
                "git",
                &["status", "--porcelain", "--untracked-files=all", "--", ".", WRITTEN[0], WRITTEN[1]],
            )
            .is_some_and(|changes| !changes.is_empty()),
            processor: cpuinfo.as_deref().and_then(processor_name).unwrap_or_else(unknown),
            compiler: output_of("rustc", &["--version"]).unwrap_or_else(unknown),
        }
    }

    /// As a line of a page.
    pub fn line(&self) -> String {
        let changed = if self.changed { ", with uncommitted changes" } else { "" };
        format!("Commit {}{changed}; {}; {}.", self.commit, self.processor, self.compiler)
    }

    /// As saved with the figures.
    pub fn to_json(&self) -> Value {
        json!({
            "commit": self.commit,
            "uncommitted_changes": self.changed,
            "processor": self.processor,
            "compiler": self.compiler,
        })
    }
}

/// # Errors
/// If this is not the root folder of the workspace.
pub fn check_root(root: &Path) -> anyhow::Result<()> {
    let is_root = root.join("Cargo.toml").is_file();
    anyhow::ensure!(
        is_root,
        "--root {} is not the workspace (no Cargo.toml): give the root folder of the clone",
        root.display()
    );
    Ok(())
}

fn processor_name(cpuinfo: &str) -> Option<String> {
    let line = cpuinfo.lines().find(|line| line.starts_with("model name"))?;
    line.split_once(':').map(|(_, name)| name.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_that_were_written_are_no_change_and_others_are() {
        let root = std::env::temp_dir().join(format!("pb3dp-bench-circumstances-{}", std::process::id()));
        std::fs::create_dir_all(root.join("docs/benchmarks")).unwrap();
        let made = Command::new("git").args(["init", "--quiet"]).current_dir(&root).status();
        // Without git the changes are unknown.
        if made.is_ok_and(|status| status.success()) {
            std::fs::write(root.join("docs/benchmarks/speed.md"), "1 ms").unwrap();
            assert!(!Circumstances::of(&root).changed);
            std::fs::write(root.join("docs/method.md"), "x").unwrap();
            assert!(Circumstances::of(&root).changed);
        }
        std::fs::remove_dir_all(&root).unwrap();
    }

    #[test]
    fn the_processor_is_the_first_that_is_named() {
        let text = "processor\t: 0\nmodel name\t: Some CPU 3000\nmodel name\t: Other\n";
        assert_eq!(processor_name(text).as_deref(), Some("Some CPU 3000"));
        assert_eq!(processor_name("BogoMIPS : 50"), None);
    }
}
