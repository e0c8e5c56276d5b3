//! Logs: human text or JSON, on standard error, so that standard output carries results alone.

use std::io::IsTerminal;

use clap::ValueEnum;
use tracing_subscriber::EnvFilter;

/// How log lines look.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// One readable line per event.
    Human,
    /// One JSON object per event.
    Json,
}

/// Installs the program's log writer.
///
/// # Errors
/// If `filter` is not a level (`info`) or directive (`pb3dp_servo=debug,info`).
pub fn init(format: LogFormat, filter: &str) -> anyhow::Result<()> {
    let filter = EnvFilter::builder().parse(filter).map_err(|error| {
        anyhow::anyhow!("--log {filter:?} is not understood ({error}); write error, warn, info, debug or trace")
    })?;
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr)
        // A reader that is gone is no reason to panic.
        .log_internal_errors(false)
        .with_target(false);
    let installed = match format {
        LogFormat::Human => builder.compact().without_time().try_init(),
        LogFormat::Json => builder.json().try_init(),
    };
    installed.map_err(|error| anyhow::anyhow!("the log writer can not be installed: {error}"))
}
