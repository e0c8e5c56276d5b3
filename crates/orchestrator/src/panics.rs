//! What a mistake of the program says of itself.

use std::backtrace::{Backtrace, BacktraceStatus};

/// From now on a panic of any thread goes to the log, for which nobody waits: who panics may be the thread that moves an arm, and goes
/// on to stop it.
pub fn install() {
    std::panic::set_hook(Box::new(|info| {
        let thread = std::thread::current();
        let (name, backtrace) = (thread.name().unwrap_or("without a name"), Backtrace::capture());
        match backtrace.status() {
            BacktraceStatus::Captured => {
                tracing::error!("a mistake of the program, report it: thread {name} {info}\n{backtrace}");
            }
            _ => tracing::error!(
                "a mistake of the program, report it: thread {name} {info} (with RUST_BACKTRACE=1 there is more to tell)"
            ),
        }
    }));
}
