//! Free space for the checks.

use std::path::Path;

use anyhow::{Context, bail};

use crate::workspace::Workspace;

/// Free space that all checks need, GiB: 5.7 in the target folder of a clean checkout, measured 2026-11-25 without incremental builds,
/// and a quarter more, and what tests need for temporary files.
const CLEAN_GIB: f64 = 8.0;
/// The same in a checkout in which tests were built before: temporary files, and what a change builds anew.
const BUILT_GIB: f64 = 3.0;

/// Fails at once where the disk would be full in the middle of the tests.
///
/// # Errors
/// If the target folder or the folder for temporary files has too little space, or it cannot be measured.
pub fn check(workspace: &Workspace) -> anyhow::Result<()> {
    let target = workspace.target_folder()?;
    let is_built = target.join("debug/deps").is_dir();
    let temporary = std::env::temp_dir();
    let place = if target.is_dir() { target.as_path() } else { workspace.root() };
    for (folder, needed_gib) in [(place, if is_built { BUILT_GIB } else { CLEAN_GIB }), (&temporary, BUILT_GIB)] {
        let free_gib = free_gib(workspace, folder)?;
        if free_gib < needed_gib {
            bail!(
                "{} has {free_gib:.1} GiB of free space, the checks need {needed_gib} GiB: remove files (`cargo clean` empties the target folder)",
                folder.display()
            );
        }
    }
    Ok(())
}

fn free_gib(workspace: &Workspace, folder: &Path) -> anyhow::Result<f64> {
    let shown = folder.display().to_string();
    let output_text = workspace.output_of("df", &["-Pk", &shown]).with_context(|| format!("`df -Pk {shown}` fails"))?;
    available_gib(&output_text)
        .with_context(|| format!("`df -Pk {shown}` says no number of free blocks: {output_text:?}"))
}

/// The fourth column of the second line, in GiB.
fn available_gib(output_text: &str) -> Option<f64> {
    let kib: f64 = output_text.lines().nth(1)?.split_whitespace().nth(3)?.parse().ok()?;
    Some(kib / f64::from(1 << 20))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn free_space_is_read_from_the_table_of_df() {
        let output_text =
            "Filesystem 1024-blocks Used Available Capacity Mounted on\n/dev/vda 264165404 89128960 6501172 94% /\n";
        assert_eq!(available_gib(output_text).map(|gib| (gib * 10.0).round()), Some(62.0));
        assert_eq!(available_gib("df: no such file"), None);
    }
}
