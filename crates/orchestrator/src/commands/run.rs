//! `pb3dp run`.
use crate::cli::RunArgs;
/// x
pub fn run(_: &RunArgs) -> anyhow::Result<std::process::ExitCode> {
    anyhow::bail!("x")
}
