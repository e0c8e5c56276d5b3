//! Panic messages in the log.

use std::backtrace::{Backtrace, BacktraceStatus};

/// Sends the message of a panic in any thread to the log, which never blocks: a panicking thread may be the one that moves an arm,
/// and still has to stop it.
pub fn install() {
    std::panic::set_hook(Box::new(|info| {
        let thread = std::thread::current();
        let (name, backtrace) = (thread.name().unwrap_or("without a name"), Backtrace::capture());
        match backtrace.status() {
            BacktraceStatus::Captured => {
                tracing::error!("internal error; please report it: thread {name} {info}\n{backtrace}");
            }
            _ => tracing::error!(
                "internal error; please report it: thread {name} {info} (with RUST_BACKTRACE=1 there is more to tell)"
            ),
        }
    }));
}
