//! `pb3dp track`.
use crate::cli::TrackArgs;
/// x
pub fn run(_: &TrackArgs) -> anyhow::Result<std::process::ExitCode> {
    anyhow::bail!("x")
}
