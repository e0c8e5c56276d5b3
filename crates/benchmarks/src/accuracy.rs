//! In the making.

/// Options.
#[derive(clap::Args)]
pub struct Args {}

/// # Errors
/// Always, until it is there.
pub fn run(_args: &Args) -> anyhow::Result<()> {
    anyhow::bail!("this measurement is not there yet")
}
