//! Log output: human-readable text or JSON, on standard error; standard output carries only results.
//!
//! A separate thread writes the log. Log calls come from threads that move an arm, capture an image or handle a signal: none of
//! them may wait for a slow reader.

use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::Context as _;
use clap::ValueEnum;
use pb3dp_hal_api::Clock;
use pb3dp_hal_platform::signals::shielded;
use pb3dp_panel::LogLines;
use tracing::field::{Field, Visit};
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::FormatTime;
use tracing_subscriber::layer::{Context, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

use crate::progress;

/// Capacity of the queue of lines; further lines are dropped and counted.
const WAITING_MAX: usize = 16_384;

/// Longest wait for lines that are not written yet before the program ends at once: an arm may still move.
const FINAL_FLUSH_MAX: Duration = Duration::from_millis(500);

/// The same at the usual end of the program: on a busy machine their thread runs late.
const END_MAX: Duration = Duration::from_secs(3);

/// Polling interval of that wait.
const LOOK: Duration = Duration::from_millis(1);

/// Format of log lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// One readable line per event.
    Human,
    /// One JSON object per event.
    Json,
}

/// UTC time of day with milliseconds.
struct WallTime;

impl FormatTime for WallTime {
    fn format_time(&self, writer: &mut Writer<'_>) -> std::fmt::Result {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let (s, millis) = (since.as_secs() % 86_400, since.subsec_millis());
        write!(writer, "{:02}:{:02}:{:02}.{millis:03}Z", s / 3600, s / 60 % 60, s % 60)
    }
}

/// The log of the program. Its drop at the end calls [`final_flush`].
#[derive(Debug)]
pub struct Log(());

/// Counts of lines handed over to the writing thread.
#[derive(Debug, Default)]
struct Counts {
    waiting: AtomicU64,
    lost: AtomicU64,
}

/// Sink of log lines that never blocks.
#[derive(Clone, Debug)]
struct Lines {
    give: SyncSender<Vec<u8>>,
    counts: Arc<Counts>,
}

static COUNTS: OnceLock<Arc<Counts>> = OnceLock::new();

/// Installs the program's log writer.
///
/// # Errors
/// If `filter` is neither a level (`info`) nor a directive (`pb3dp_cell=debug,info`), or the system provides no thread.
pub fn init(format: LogFormat, filter: &str) -> anyhow::Result<Log> {
    let refused = |why: &dyn std::fmt::Display| {
        anyhow::anyhow!("--log {filter:?} is not understood ({why}); write error, warn, info, debug or trace")
    };
    for part in filter.split(',').map(str::trim) {
        if is_mistaken_level(part) {
            return Err(refused(&format!("{part:?} is no level")));
        }
        if let Some(name) = mistaken_crate(part) {
            return Err(refused(&format!("nothing logs as {name}; these do: {}", CRATES.join(", "))));
        }
    }
    let filter = EnvFilter::builder().parse(filter).map_err(|error| refused(&error))?;
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(io::stderr().is_terminal())
        .with_writer(Lines::begin()?)
        // A closed standard error must not cause a panic.
        .log_internal_errors(false)
        .with_target(false);
    let installed = match format {
        LogFormat::Human => builder.compact().with_timer(WallTime).finish().with(ForPanel).try_init(),
        LogFormat::Json => builder.json().finish().with(ForPanel).try_init(),
    };
    installed.map_err(|error| anyhow::anyhow!("the log writer cannot be installed: {error}"))?;
    Ok(Log(()))
}

/// The panel that shows the log, with the clock of its run.
static PANEL: OnceLock<(LogLines, Arc<dyn Clock>)> = OnceLock::new();

/// From now on a panel shows the log, too; only the first call has an effect.
pub fn show_in_panel(clock: Arc<dyn Clock>) -> LogLines {
    PANEL.get_or_init(|| (LogLines::default(), clock)).0.clone()
}

/// Copies each event to the panel, if there is one.
struct ForPanel;

impl<S: tracing::Subscriber> Layer<S> for ForPanel {
    fn on_event(&self, event: &tracing::Event<'_>, _context: Context<'_, S>) {
        let Some((lines, clock)) = PANEL.get() else { return };
        let level = match *event.metadata().level() {
            tracing::Level::ERROR => "error",
            tracing::Level::WARN => "warn",
            tracing::Level::INFO => "info",
            tracing::Level::DEBUG | tracing::Level::TRACE => return,
        };
        let mut text = Text::default();
        event.record(&mut text);
        lines.push(clock.now(), level, &text.0);
    }
}

/// The message of an event.
#[derive(Default)]
struct Text(String);

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        if field.name() == "message" {
            self.0 = format!("{value:?}");
        }
    }
}

/// Our crates that log; directives select by these names.
const CRATES: [&str; 6] =
    ["pb3dp_cell", "pb3dp_commissioning", "pb3dp_orchestrator", "pb3dp_panel", "pb3dp_recording", "pb3dp_wiring"];

/// One of our names that never logs: the filter would accept it and show nothing.
fn mistaken_crate(part: &str) -> Option<&str> {
    let target = part.split(['=', '[']).next().unwrap_or_default();
    let name = target.split("::").next().unwrap_or_default();
    (name.starts_with("pb3dp") && !CRATES.contains(&name)).then_some(name)
}

/// To the filter a single word that is no level is a target, and everything else would be silent.
fn is_mistaken_level(part: &str) -> bool {
    let is_directive = part.contains(['=', '[']) || part.starts_with("pb3dp");
    !part.is_empty() && !is_directive && part.parse::<tracing_subscriber::filter::LevelFilter>().is_err()
}

/// Waits briefly for lines that are not written yet, before the program ends at once.
pub fn final_flush() {
    wait_for_lines(FINAL_FLUSH_MAX);
}

fn wait_for_lines(longest: Duration) {
    let Some(counts) = COUNTS.get() else { return };
    let begin = Instant::now();
    while counts.waiting.load(Ordering::SeqCst) > 0 && begin.elapsed() < longest {
        std::thread::sleep(LOOK);
    }
}

impl Drop for Log {
    fn drop(&mut self) {
        wait_for_lines(END_MAX);
    }
}

impl Lines {
    fn begin() -> anyhow::Result<Self> {
        let counts = Arc::clone(COUNTS.get_or_init(Arc::default));
        let (give, take) = sync_channel(WAITING_MAX);
        let written = Arc::clone(&counts);
        let work = move || write_all(&take, &written);
        // Signals are handled by the threads that stop an arm first.
        let started = shielded(|| std::thread::Builder::new().name("log".into()).spawn(work));
        started.and_then(|thread| thread).context("no thread to write the log")?;
        Ok(Self { give, counts })
    }
}

fn write_all(lines: &Receiver<Vec<u8>>, counts: &Counts) {
    for line in lines {
        // A closed standard error loses the line.
        let _ = progress::beside(|| io::stderr().write_all(&line));
        // Reported when there is space again.
        if counts.waiting.fetch_sub(1, Ordering::SeqCst) == 1 {
            let lost = counts.lost.swap(0, Ordering::SeqCst);
            if lost > 0 {
                tracing::warn!("{lost} lines are missing in this log: nobody read it for too long");
            }
        }
    }
}

impl Write for Lines {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        self.counts.waiting.fetch_add(1, Ordering::SeqCst);
        if self.give.try_send(line.to_vec()).is_err() {
            self.counts.waiting.fetch_sub(1, Ordering::SeqCst);
            self.counts.lost.fetch_add(1, Ordering::SeqCst);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl MakeWriter<'_> for Lines {
    type Writer = Self;

    fn make_writer(&self) -> Self {
        self.clone()
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn words_that_select_nothing_are_refused() {
        for good in
            ["info", "pb3dp_cell=trace,info", "pb3dp_cell::sight=debug", "tokio=warn", "pb3dp_wiring[span]=debug"]
        {
            assert!(good.split(',').all(|part| !is_mistaken_level(part) && mistaken_crate(part).is_none()), "{good}");
        }
        assert!(is_mistaken_level("inof"));
        assert_eq!(mistaken_crate("pb3dp_servvo=trace"), Some("pb3dp_servvo"));
        assert_eq!(mistaken_crate("pb3dp"), Some("pb3dp"));
    }

    #[test]
    fn every_crate_that_logs_is_known() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let mut logging = Vec::new();
        for group in ["crates", "hal"] {
            for folder in std::fs::read_dir(root.join(group)).unwrap() {
                let folder = folder.unwrap().path();
                let is_tool = folder.ends_with("benchmarks") || folder.ends_with("test-support");
                if !is_tool && logs(&folder.join("src")) {
                    let name = folder.file_name().unwrap().to_str().unwrap().replace('-', "_");
                    logging.push(format!("pb3dp_{name}"));
                }
            }
        }
        logging.sort();
        assert_eq!(logging, CRATES);
    }

    fn logs(folder: &Path) -> bool {
        let Ok(entries) = std::fs::read_dir(folder) else { return false };
        entries.flatten().map(|entry| entry.path()).any(|path| match path.is_dir() {
            true => logs(&path),
            false => std::fs::read_to_string(&path).is_ok_and(|text| {
                ["error", "warn", "info", "debug", "trace"]
                    .iter()
                    .any(|level| text.contains(&format!("tracing::{level}!")))
            }),
        })
    }
}
