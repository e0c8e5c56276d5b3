//! What a mistake of the program says of itself: written by a thread of its own.
//!
//! Who panics may be the thread that moves an arm, and goes on to stop it: it must not wait for a log that nobody reads.

use std::backtrace::{Backtrace, BacktraceStatus};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};

use anyhow::Context;
use pb3dp_arm_pa10::io::signals::shielded;

/// Panics that wait to be written; of more, the first ones count.
const WAITING_MAX: usize = 16;

/// How long the end of the program waits for what is not yet written.
const LAST_WORDS_MAX: Duration = Duration::from_millis(500);

/// Where and why, and what led there.
struct LastWords {
    text: String,
    backtrace: Backtrace,
}

/// The texts of panics. Dropping it, at the end of the program, waits a little for those that are not yet written.
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
    let write = move || write_all(&take, &written);
    // A signal that ends the program is for those who stop an arm first.
    let started = shielded(|| std::thread::Builder::new().name("panics".into()).spawn(write));
    started.and_then(|thread| thread).context("no thread to write of panics")?;
    let counted = Arc::clone(&waiting);
    std::panic::set_hook(Box::new(move |info| {
        let thread = std::thread::current();
        let text = format!("thread {} {info}", thread.name().unwrap_or("without a name"));
        counted.fetch_add(1, Ordering::SeqCst);
        if give.try_send(LastWords { text, backtrace: Backtrace::capture() }).is_err() {
            counted.fetch_sub(1, Ordering::SeqCst);
        }
    }));
    Ok(PanicLog { waiting })
}

fn write_all(words: &Receiver<LastWords>, written: &AtomicU64) {
    for LastWords { text, backtrace } in words {
        if backtrace.status() == BacktraceStatus::Captured {
            tracing::error!("a mistake of the program, report it: {text}\n{backtrace}");
        } else {
            tracing::error!(
                "a mistake of the program, report it: {text} (with RUST_BACKTRACE=1 there is more to tell)"
            );
        }
        written.fetch_sub(1, Ordering::SeqCst);
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
