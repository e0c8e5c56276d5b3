//! Commit, processor and compiler of a measurement.

use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

/// Where and with what the figures were made; `unknown` where the machine does not tell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Circumstances {
    /// Commit of the workspace.
    pub commit: String,
    /// Whether files differ from the commit.
    pub changed: bool,
    /// Name of the processor.
    pub processor: String,
    /// The compiler.
    pub compiler: String,
}

impl Circumstances {
    /// Those of this machine and of the workspace at `root`.
    pub fn of(root: &Path) -> Self {
        let told = |program: &str, args: &[&str]| {
            let output = Command::new(program).args(args).current_dir(root).output().ok()?;
            let text = String::from_utf8(output.stdout).ok()?;
            output.status.success().then(|| text.trim().to_owned())
        };
        let unknown = || "unknown".to_owned();
        let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").ok();
        Self {
            commit: told("git", &["rev-parse", "--short=12", "HEAD"]).unwrap_or_else(unknown),
            changed: told("git", &["status", "--porcelain"]).is_some_and(|changes| !changes.is_empty()),
            processor: cpuinfo.as_deref().and_then(processor_name).unwrap_or_else(unknown),
            compiler: told("rustc", &["--version"]).unwrap_or_else(unknown),
        }
    }

    /// As kept beside the figures.
    pub fn to_json(&self) -> Value {
        json!({
            "commit": self.commit,
            "uncommitted_changes": self.changed,
            "processor": self.processor,
            "compiler": self.compiler,
        })
    }
}

fn processor_name(cpuinfo: &str) -> Option<String> {
    let line = cpuinfo.lines().find(|line| line.starts_with("model name"))?;
    line.split_once(':').map(|(_, name)| name.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_processor_is_the_first_that_is_named() {
        let text = "processor\t: 0\nmodel name\t: Some CPU 3000\nmodel name\t: Other\n";
        assert_eq!(processor_name(text).as_deref(), Some("Some CPU 3000"));
        assert_eq!(processor_name("BogoMIPS : 50"), None);
    }
}
