//! What a mistake of the program says of itself, and what a thread that moves arms has to tell: written by a thread of its own.
//!
//! Who panics may be the thread that moves an arm, and goes on to stop it: it must not wait for a log that nobody reads.

use std::backtrace::{Backtrace, BacktraceStatus};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use anyhow::Context;
use pb3dp_arm_pa10::io::signals::shielded;

/// Texts that wait to be written; of more, the first ones count.
const WAITING_MAX: usize = 16;

/// How long the end of the program waits for what is not yet written.
const LAST_WORDS_MAX: Duration = Duration::from_millis(500);

/// What waits to be written.
enum Words {
    /// Where and why somebody has panicked, and what led there.
    Panic {
        text: String,
        backtrace: Backtrace,
    },
    Error(String),
    Warning(String),
}

/// Where texts go that nobody waits for.
#[derive(Clone)]
struct Later {
    give: SyncSender<Words>,
    /// Handed over, and not yet written.
    waiting: Arc<AtomicU64>,
}

static LATER: OnceLock<Later> = OnceLock::new();

impl Later {
    fn give(&self, words: Words) {
        self.waiting.fetch_add(1, Ordering::SeqCst);
        if self.give.try_send(words).is_err() {
            self.waiting.fetch_sub(1, Ordering::SeqCst);
        }
    }
}

/// An error of a thread that moves arms: it does not wait for the log.
pub fn error_later(text: String) {
    later(Words::Error(text));
}

/// A warning, as [`error_later`].
pub fn warn_later(text: String) {
    later(Words::Warning(text));
}

fn later(words: Words) {
    match LATER.get() {
        Some(later) => later.give(words),
        // A program without the thread has no log that somebody may leave unread.
        None => write(words),
    }
}

/// Texts that are written later. Dropping it, at the end of the program, waits a little for those that are not yet written.
#[derive(Debug)]
pub struct PanicLog {
    /// Handed over, and not yet written.
    waiting: Arc<AtomicU64>,
}

/// From now on a panic of any thread goes to the log, and nobody who panics waits for that.
///
/// # Errors
/// If the system gives no thread.
pub fn install() -> anyhow::Result<PanicLog> {
    let waiting = Arc::new(AtomicU64::new(0));
    let (give, take) = sync_channel(WAITING_MAX);
    let written = Arc::clone(&waiting);
    let work = move || write_all(&take, &written);
    // A signal that ends the program is for those who stop an arm first.
    let started = shielded(|| std::thread::Builder::new().name("panics".into()).spawn(work));
    started.and_then(|thread| thread).context("no thread to write of panics")?;
    let later = LATER.get_or_init(|| Later { give, waiting }).clone();
    let waiting = Arc::clone(&later.waiting);
    std::panic::set_hook(Box::new(move |info| {
        let thread = std::thread::current();
        let text = format!("thread {} {info}", thread.name().unwrap_or("without a name"));
        later.give(Words::Panic { text, backtrace: Backtrace::capture() });
    }));
    Ok(PanicLog { waiting })
}

fn write_all(words: &Receiver<Words>, written: &AtomicU64) {
    for words in words {
        write(words);
        written.fetch_sub(1, Ordering::SeqCst);
    }
}

fn write(words: Words) {
    match words {
        Words::Panic { text, backtrace } if backtrace.status() == BacktraceStatus::Captured => {
            tracing::error!("a mistake of the program, report it: {text}\n{backtrace}");
        }
        Words::Panic { text, .. } => {
            tracing::error!("a mistake of the program, report it: {text} (with RUST_BACKTRACE=1 there is more to tell)")
        }
        Words::Error(text) => tracing::error!("{text}"),
        Words::Warning(text) => tracing::warn!("{text}"),
    }
}

impl Drop for PanicLog {
    fn drop(&mut self) {
        let begin = Instant::now();
        while self.waiting.load(Ordering::SeqCst) > 0 && begin.elapsed() < LAST_WORDS_MAX {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
