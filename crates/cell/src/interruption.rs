//! Ends a run on signals: the first signal stops both arms, the second one skips the report.

use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use pb3dp_hal_platform::signals::StopSignals;
use rustix::event::{PollFd, PollFlags, poll};

/// Exit code of a run that was ended by a signal.
pub const INTERRUPTED: u8 = 130;

/// Ends the run on the first signal, with both arms stopped. A second signal ends the program at once. Returns the
/// flag that a signal has arrived. `final_flush` is called before the program ends at once.
///
/// # Errors
/// If the system provides no thread.
pub fn watch(mut signals: StopSignals, interrupt: &Arc<AtomicBool>, final_flush: fn()) -> Result<Arc<AtomicBool>> {
    let (interrupt, was_interrupted) = (Arc::clone(interrupt), Arc::new(AtomicBool::new(false)));
    let flag = Arc::clone(&was_interrupted);
    let work = move || {
        loop {
            // A failed poll only shortens the wait.
            let _ = poll(&mut [PollFd::from_borrowed_fd(signals.as_fd(), PollFlags::IN)], None);
            let Ok(Some(signal)) = signals.try_take() else { continue };
            interrupt.store(true, Ordering::SeqCst);
            if !flag.swap(true, Ordering::SeqCst) {
                tracing::info!("{signal}: stopping both arms, then writing the report");
                continue;
            }
            tracing::warn!("{signal} again: exiting at once; the gateway stops an arm that still moves");
            final_flush();
            std::process::exit(i32::from(INTERRUPTED));
        }
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(work).context("no thread for signals")?;
    Ok(was_interrupted)
}
